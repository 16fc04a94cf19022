"""`bp2 paper eval`: put a policy to the deep benchmarks, with a table and a report as
`python eval.py` leaves them."""

import dataclasses
import shlex
from collections.abc import Sequence
from typing import Annotated, Literal

import tyro

from bp2_rl.cli import app
from bp2_rl.cli.eval import EvalConfig, evaluate
from bp2_rl.paper.benchmarks.options import DeepSetup
from bp2_rl.simulation.backend import Backend

SCREEN = """usage: {prog} [POLICY_OR_RUN] [FLAGS]

Measure what the paper says of a gait on a policy, and leave a report with table, plots
and film. Without a policy: the one that ships with bp2_rl.

what is run:
  POLICY_OR_RUN         a policy that ships, by its name, or the folder of a policy
                        or of a run
  --benchmark NAME      stability: whether the gait repeats itself under noise, and how
                        hard it may be pushed [stability]
                        endurance: how long the motors last
                        mechanism: whose inertia balances whose, at five speeds
                        efficiency: what running costs, at eight speeds
                        all: one after the other
  --robot NAME|FILE     built: BP2 with losses and solid legs; ideal: without; real:
                        one that BP2 may be
  --quick               the short version, in half a minute

how:
  --speed M/S           speed to command [as the card's result was measured]
  --acceleration M/S2   how fast the command rises
  --hold S              how long to hold a speed; not of stability
  --robots N            how many are drawn; of endurance and stability
  --seed N              what robots and noise are drawn from [0]

what is left:
  --out DIR             the report's folder [reports/BENCHMARK-DATE-TIME]
  --no-video            do not film the best seconds

all flags, with the operator's and the motors' heat: {prog} --help-all"""
"""What `--help` prints."""
DeepBenchmarkName = Literal["endurance", "mechanism", "efficiency", "stability", "all"]


@dataclasses.dataclass(frozen=True)
class DeepEvalConfig(EvalConfig, DeepSetup):
    """Measure what the paper says of a gait on a policy, and leave a report with table,
    plots and film.

    Without a policy: the one that ships with bp2_rl.
    """

    benchmark: DeepBenchmarkName = "stability"  # pyright: ignore[reportIncompatibleVariableOverride]
    """endurance: how long the motors last at 10.74 m/s and at the top speed. mechanism:
    whose inertia balances whose, at five speeds. efficiency: what running costs, at
    eight speeds, and where the energy goes. stability: whether the gait repeats itself
    under noise, and how hard it may be pushed, at 10.74 m/s and at the top speed. all:
    one after the other."""
    backend: Annotated[Backend, tyro.conf.Suppress] = "mujoco"
    hold: Annotated[float | None, tyro.conf.arg(metavar="S")] = None
    """How long to hold a speed; by default 10 in efficiency and 5 in mechanism, in
    endurance 180 at most. Not of stability."""
    robots: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """How many robots run with noise; by default 6. Of stability alone."""
    seed: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """What the sensors' noise is drawn from; by default 0. Of stability alone."""
    sensor_noise: Annotated[bool, tyro.conf.Suppress] = False


def main(words: Sequence[str]) -> int:
    """Run the command and return its exit status."""
    again = shlex.join(["bp2", "paper", "eval", *words])
    registry = "bp2_rl.paper.benchmarks.registry"
    return app.run(
        lambda: evaluate(
            app.parse(DeepEvalConfig, words, "bp2 paper eval", screen=SCREEN),
            DeepSetup,
            registry,
            again,
        )
    )
