"""Evaluate a policy; see `python eval.py --help`."""

import sys

from bp2_rl.cli.app import run_module

if __name__ == "__main__":
    sys.exit(run_module("bp2_rl.cli.eval"))
