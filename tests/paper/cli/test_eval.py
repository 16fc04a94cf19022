"""`bp2 paper eval` as a user meets it."""

import pytest

from bp2_rl.paper.cli.eval import main


@pytest.mark.parametrize("flag", ["--backend", "--sensor-noise"])
def test_what_no_deep_benchmark_takes_is_unknown(flag, capsys):
    assert main([flag, "mjx"]) == 2
    assert flag in capsys.readouterr().err
