"""The benchmarks by name, each with its command schedule, its run and its flags."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, Generic, TypeVar

from bp2_rl.base.errors import UserError
from bp2_rl.evaluation.benchmarks.convergence import convergence
from bp2_rl.evaluation.benchmarks.fleet import ramp_to_robustness, robustness
from bp2_rl.evaluation.benchmarks.losses import losses, ramp_to_losses
from bp2_rl.evaluation.benchmarks.options import POSTERIOR, BenchmarkOptions
from bp2_rl.evaluation.benchmarks.outcome import Evaluation
from bp2_rl.evaluation.benchmarks.posterior import posterior, ramp_to_posterior
from bp2_rl.evaluation.benchmarks.run import (
    ramp_to_sprint,
    ramp_to_topspeed,
    sprint,
    topspeed,
)
from bp2_rl.evaluation.benchmarks.sensitivity import ramp_to_sensitivity, sensitivity
from bp2_rl.evaluation.benchmarks.tries.benchmark import (
    disturbances,
    manoeuvres,
    ramp_to_disturbances,
)
from bp2_rl.learning.policy import Policy
from bp2_rl.simulation.schedule import Ramp

ALL = "all"
Flags = TypeVar("Flags", bound=BenchmarkOptions)


@dataclasses.dataclass(frozen=True)
class Benchmark(Generic[Flags]):
    """A benchmark: functions for its command schedule and its run, and the names of its
    flags."""

    schedule: Callable[[Policy, Flags], Ramp]
    run: Callable[[Policy, Ramp, Flags], Evaluation]
    flags: tuple[str, ...]  # fields of its setup


# the flags of a single run, of a fleet, of many tries, and of variants
RUN = (
    *("backend", "robot", "terrain", "speed", "acceleration"),
    *("seed", "operator"),
)
TRIES = "robot", "speed", "seed", "operator"
VARIANTS = "robot", "speed", "acceleration", "hold", "operator"

BENCHMARKS = {
    "topspeed": Benchmark(ramp_to_topspeed, topspeed, (*RUN, "sensor_noise", "hold")),
    "sprint": Benchmark(ramp_to_sprint, sprint, (*RUN, "sensor_noise")),
    "robustness": Benchmark(ramp_to_robustness, robustness, (*RUN, "hold", "robots")),
    "manoeuvres": Benchmark(ramp_to_topspeed, manoeuvres, TRIES),
    "disturbances": Benchmark(ramp_to_disturbances, disturbances, TRIES),
    "convergence": Benchmark(ramp_to_topspeed, convergence, VARIANTS),
    "losses": Benchmark(ramp_to_losses, losses, VARIANTS[1:]),
    "sensitivity": Benchmark(ramp_to_sensitivity, sensitivity, VARIANTS),
    POSTERIOR: Benchmark(ramp_to_posterior, posterior, ("robots",)),
}


def choose(
    name: str,
    setup: BenchmarkOptions,
    benchmarks: Mapping[str, Benchmark[Any]] = BENCHMARKS,
) -> dict[str, BenchmarkOptions]:
    """Return a setup for each benchmark that `name` selects, by the benchmark's name.

    `all` gives each benchmark the flags that the benchmark knows.

    Raises:
        UserError: no benchmark of this name, or a flag that it does not know.
    """
    if name == ALL:
        return {
            known: setup.only(benchmark.flags)
            for known, benchmark in benchmarks.items()
            if known != POSTERIOR  # of BP2 alone
        }
    if name not in benchmarks:
        raise UserError(
            f"--benchmark {name}: there are {', '.join(benchmarks)}, and {ALL}"
        )
    flags = benchmarks[name].flags
    for flag in setup.chosen:
        if flag not in flags:
            wrong, *others = (f"--{each.replace('_', '-')}" for each in (flag, *flags))
            raise UserError(
                f"{wrong} does not apply to --benchmark {name}, which takes {', '.join(others)}"
            )
    return {name: setup}
