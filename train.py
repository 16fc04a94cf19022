"""Train BP2: `python train.py --stage imitation`, then `python train.py --stage
relaxed`."""

import sys

from bp2_rl.cli.app import run_module

if __name__ == "__main__":
    sys.exit(run_module("bp2_rl.cli.train"))
