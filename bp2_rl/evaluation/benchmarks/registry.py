"""What a policy is put to: each benchmark runs it under a stated schedule and measures what comes of it."""

from collections.abc import Callable
from typing import NamedTuple

from bp2_rl.errors import UserError
from bp2_rl.evaluation.benchmarks.convergence import convergence
from bp2_rl.evaluation.benchmarks.efficiency.benchmark import efficiency, ramp_to_efficiency
from bp2_rl.evaluation.benchmarks.endurance.benchmark import endurance, ramp_to_endurance
from bp2_rl.evaluation.benchmarks.losses import losses, ramp_to_losses
from bp2_rl.evaluation.benchmarks.manoeuvres.benchmark import manoeuvres, ramp_to_manoeuvres
from bp2_rl.evaluation.benchmarks.mechanism.benchmark import mechanism, ramp_to_mechanism
from bp2_rl.evaluation.benchmarks.options import Setup
from bp2_rl.evaluation.benchmarks.outcome import Evaluation
from bp2_rl.evaluation.benchmarks.robustness import ramp_to_robustness, robustness
from bp2_rl.evaluation.benchmarks.sensitivity import ramp_to_sensitivity, sensitivity
from bp2_rl.evaluation.benchmarks.sprint import race, sprint
from bp2_rl.evaluation.benchmarks.stability.benchmark import ramp_to_stability, stability
from bp2_rl.evaluation.benchmarks.topspeed import ramp_to_topspeed, topspeed
from bp2_rl.evaluation.runs.schedule import Ramp
from bp2_rl.learning.policy import Policy

ALL = "all"


class Benchmark(NamedTuple):
    """What a policy is told, how it is run and measured, and which flags it knows."""

    schedule: Callable[[Policy, Setup], Ramp]
    run: Callable[[Policy, Ramp, Setup], Evaluation]
    flags: tuple[str, ...]  # fields of Setup


BENCHMARKS = {
    "topspeed": Benchmark(
        ramp_to_topspeed, topspeed, ("backend", "robot", "speed", "acceleration", "hold", "operator")
    ),
    "sprint": Benchmark(race, sprint, ("backend", "robot", "speed", "acceleration", "operator")),
    "robustness": Benchmark(
        ramp_to_robustness,
        robustness,
        ("backend", "robot", "speed", "acceleration", "hold", "robots", "seed", "operator"),
    ),
    "manoeuvres": Benchmark(ramp_to_manoeuvres, manoeuvres, ("robot", "speed", "seed", "operator")),
    "convergence": Benchmark(ramp_to_topspeed, convergence, ("robot", "speed", "acceleration", "hold", "operator")),
    "losses": Benchmark(ramp_to_losses, losses, ("speed", "acceleration", "hold", "operator")),
    "sensitivity": Benchmark(ramp_to_sensitivity, sensitivity, ("robot", "speed", "acceleration", "hold", "operator")),
    "endurance": Benchmark(
        ramp_to_endurance,
        endurance,
        ("robot", "speed", "acceleration", "hold", "robots", "seed", "operator", "heat", "quick"),
    ),
    "mechanism": Benchmark(
        ramp_to_mechanism, mechanism, ("robot", "speed", "acceleration", "hold", "operator", "quick")
    ),
    "efficiency": Benchmark(
        ramp_to_efficiency, efficiency, ("robot", "speed", "acceleration", "hold", "operator", "quick")
    ),
    "stability": Benchmark(
        ramp_to_stability, stability, ("robot", "speed", "acceleration", "robots", "seed", "operator", "quick")
    ),
}


def choose(name: str, setup: Setup) -> dict[str, Setup]:
    """The benchmarks of this name, each with what is chosen of it; of `all`, each is given the flags that it knows.

    Raises:
        UserError: no benchmark of this name, or a flag that it does not know.
    """
    if name == ALL:
        return {each: setup.only(benchmark.flags) for each, benchmark in BENCHMARKS.items()}
    if name not in BENCHMARKS:
        raise UserError(f"--benchmark {name}: there are {', '.join(BENCHMARKS)}, and {ALL}")
    known = BENCHMARKS[name].flags
    for flag in setup.chosen:
        if flag not in known:
            raise UserError(f"--{flag} is not of --benchmark {name}, which takes {', '.join(f'--{f}' for f in known)}")
    return {name: setup}
