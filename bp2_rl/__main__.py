"""`python -m bp2_rl COMMAND ...`, the same as the installed `bp2`."""

import sys

from bp2_rl.cli.__main__ import main

if __name__ == "__main__":
    sys.exit(main())
