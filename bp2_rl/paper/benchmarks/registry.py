"""The deep benchmarks by name: tests of the paper's claims about BP2's gait on a
policy."""

from bp2_rl.evaluation.benchmarks.registry import Benchmark
from bp2_rl.paper.benchmarks.efficiency.benchmark import efficiency, ramp_to_efficiency
from bp2_rl.paper.benchmarks.endurance.benchmark import endurance, ramp_to_endurance
from bp2_rl.paper.benchmarks.mechanism.benchmark import mechanism, ramp_to_mechanism
from bp2_rl.paper.benchmarks.stability.benchmark import ramp_to_stability, stability

BENCHMARKS = {
    "endurance": Benchmark(
        ramp_to_endurance,
        endurance,
        (
            "robot",
            "speed",
            "acceleration",
            "hold",
            "operator",
            "heat",
            "quick",
        ),
    ),
    "mechanism": Benchmark(
        ramp_to_mechanism,
        mechanism,
        ("robot", "speed", "acceleration", "hold", "operator", "quick"),
    ),
    "efficiency": Benchmark(
        ramp_to_efficiency,
        efficiency,
        ("robot", "speed", "acceleration", "hold", "operator", "quick"),
    ),
    "stability": Benchmark(
        ramp_to_stability,
        stability,
        ("robot", "speed", "acceleration", "robots", "seed", "operator", "quick"),
    ),
}
