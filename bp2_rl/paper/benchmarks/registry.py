"""The deep benchmarks by name: tests of the paper's claims about BP2's gait on a
policy."""

from bp2_rl.evaluation.benchmarks.registry import Benchmark
from bp2_rl.paper.benchmarks.efficiency.benchmark import EFFICIENCY
from bp2_rl.paper.benchmarks.endurance.benchmark import endurance, ramp_to_endurance
from bp2_rl.paper.benchmarks.mechanism.benchmark import MECHANISM
from bp2_rl.paper.benchmarks.stability.benchmark import ramp_to_stability, stability

HELD = "robot", "speed", "acceleration", "hold", "operator", "quick"

BENCHMARKS = {
    "endurance": Benchmark(ramp_to_endurance, endurance, (*HELD, "heat")),
    "mechanism": Benchmark(MECHANISM.ramp, MECHANISM.evaluate, HELD),
    "efficiency": Benchmark(EFFICIENCY.ramp, EFFICIENCY.evaluate, HELD),
    "stability": Benchmark(
        ramp_to_stability,
        stability,
        ("robot", "speed", "acceleration", "robots", "seed", "operator", "quick"),
    ),
}
