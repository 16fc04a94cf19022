"""Flags of the paper's deep benchmarks: endurance, mechanism, efficiency, stability."""

import dataclasses

from bp2_rl.evaluation.benchmarks.options import BenchmarkOptions
from bp2_rl.paper.thermal_specs import MotorHeat


@dataclasses.dataclass(frozen=True)
class DeepBenchmarkOptions(BenchmarkOptions):
    """Flags of a deep benchmark (`bp2 paper eval`); None leaves the choice to the
    benchmark."""

    heat: MotorHeat = MotorHeat()
    quick: bool = False
    """The short version, in half a minute. Of endurance: heat runs four times as fast
    as motion. Of mechanism and efficiency: two speeds. Of stability: 30 strides at
    10.74 m/s, no return map, pushes in four directions."""
