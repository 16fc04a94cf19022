"""`bp2 paper COMMAND`: hands over to the paper's evidence, which nothing else in the
core knows of."""

import importlib
from collections.abc import Sequence


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command of `bp2_rl.paper` that `argv` names; return its exit status."""
    return importlib.import_module("bp2_rl.paper.cli").main(argv)
