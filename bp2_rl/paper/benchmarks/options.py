"""The flags of the deep benchmarks."""

import dataclasses

from bp2_rl.evaluation.benchmarks.options import Setup
from bp2_rl.paper.thermal_specs import MotorHeat


@dataclasses.dataclass(frozen=True)
class DeepSetup(Setup):
    """The flags of a deep benchmark; None leaves the choice to the benchmark."""

    heat: MotorHeat = MotorHeat()
    quick: bool = False
