"""`bp2 paper eval` as a user meets it."""

import pytest

from bp2_rl.paper.benchmarks.efficiency import benchmark as efficiency
from bp2_rl.paper.benchmarks.endurance import benchmark as endurance
from bp2_rl.paper.benchmarks.mechanism import benchmark as mechanism
from bp2_rl.paper.benchmarks.stability.tries import FULL
from bp2_rl.paper.cli.eval import main


def test_help_says_what_the_flags_do_here(capsys):
    assert main(["--help-all"]) == 0
    said = " ".join(capsys.readouterr().out.replace("│", "").split())
    assert "--backend" not in said
    assert "--sensor-noise" not in said
    assert f"run with noise; by default {FULL.robots}" in said
    assert (
        f"by default {efficiency.HOLD:g} in efficiency and {mechanism.HOLD:g} in mechanism"
        in said
    )
    assert f"in endurance {endurance.LONGEST:g} at most" in said


@pytest.mark.parametrize("flag", ["--backend", "--sensor-noise"])
def test_what_no_deep_benchmark_takes_is_unknown(flag, capsys):
    assert main([flag, "mjx"]) == 2
    assert flag in capsys.readouterr().err
