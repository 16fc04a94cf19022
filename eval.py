"""Evaluate a policy; see `python eval.py --help`."""

import sys

from bp2_rl.cli.eval import main

if __name__ == "__main__":
    sys.exit(main())
