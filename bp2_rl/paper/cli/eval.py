"""`bp2 paper eval`: run a policy on the paper's benchmarks, with a table and a report
like those of `python eval.py`."""

import dataclasses
import shlex
from collections.abc import Sequence
from typing import Annotated, Literal

import tyro

from bp2_rl.cli import app
from bp2_rl.cli.eval import EvalConfig, evaluate
from bp2_rl.paper.benchmarks.options import DeepBenchmarkOptions
from bp2_rl.simulation.backend import Backend

SCREEN = """usage: {prog} [POLICY_OR_RUN] [FLAGS]

Test the paper's claims about a gait on a policy, and write a report with a
table, plots and a film.

policy and benchmark:
  POLICY_OR_RUN         name of a shipped policy (built, gentle, fastest, ideal,
                        rough), or folder of a policy or a training run [built]
  --benchmark NAME      stability: return map of the gait under noise, and the
                        largest push that the robot survives [stability]
                        endurance: time until a motor is too hot
                        mechanism: inertial coupling of the limbs, at five speeds
                        efficiency: cost of transport, at eight speeds
                        all: all of them
  --robot NAME|FILE     built: BP2 with losses and solid legs; ideal: without
                        both; real: a plausible BP2
  --quick               a short version, in half a minute

conditions:
  --speed M/S           commanded speed [as in the result on the policy's card]
  --acceleration M/S2   rate at which the commanded speed rises
  --hold S              time at the commanded speed; not for stability
  --robots N            number of robots with noise; for stability [6]
  --seed N              random seed of the noise; for stability [0]

output:
  --out DIR             the report's folder [reports/BENCHMARK-DATE-TIME]
  --no-video            no film of the best seconds

all flags, with --operator.* (steering) and --heat.*: {prog} --help-all"""
"""What `--help` prints."""
DeepBenchmarkName = Literal["endurance", "mechanism", "efficiency", "stability", "all"]


@dataclasses.dataclass(frozen=True)
class DeepEvalConfig(EvalConfig, DeepBenchmarkOptions):
    """Test the paper's claims about a gait on a policy, and write a report with a
    table, plots and a film."""

    benchmark: DeepBenchmarkName = "stability"  # pyright: ignore[reportIncompatibleVariableOverride]
    """endurance: time until a motor is too hot, at 10.74 m/s and at the top speed.
    mechanism: inertial coupling of the limbs, at five speeds. efficiency: cost of
    transport and losses, at eight speeds. stability: return map of the gait under noise,
    and the largest push that the robot survives, at 10.74 m/s and at the top speed.
    all: all of them."""
    backend: Annotated[Backend, tyro.conf.Suppress] = "mujoco"
    hold: Annotated[float | None, tyro.conf.arg(metavar="S")] = None
    """Time at the commanded speed; by default 10 in efficiency and 5 in mechanism, in
    endurance at most 180. Not for stability."""
    robots: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Number of robots with noise; by default 6. For stability."""
    seed: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Random seed of the sensor noise; by default 0. For stability."""
    sensor_noise: Annotated[bool, tyro.conf.Suppress] = False


def main(words: Sequence[str]) -> int:
    """Run the command and return its exit status."""
    again = shlex.join(["bp2", "paper", "eval", *words])
    registry = "bp2_rl.paper.benchmarks.registry"
    return app.run(
        lambda: evaluate(
            app.parse(DeepEvalConfig, words, "bp2 paper eval", screen=SCREEN),
            DeepBenchmarkOptions,
            registry,
            again,
        )
    )
