"""Evaluate a policy; see `python eval.py --help`."""

import sys

try:
    from bp2_rl.cli.eval import main
except ModuleNotFoundError as missing:
    print(
        f"error: this Python lacks {missing.name}: activate the environment, `. .venv/bin/activate`",
        file=sys.stderr,
    )
    sys.exit(2)

if __name__ == "__main__":
    sys.exit(main())
