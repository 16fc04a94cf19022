"""`bp2 paper COMMAND`: call a command of `bp2_rl.paper`, the evidence for the paper."""

import importlib
from collections.abc import Sequence


def main(words: Sequence[str]) -> int:
    """Run the command of `bp2_rl.paper` that `words` name; return its exit status."""
    return importlib.import_module("bp2_rl.paper.cli").main(words)
