"""Entry point of `bp2 COMMAND ...` and `python -m bp2_rl COMMAND ...`, which calls the
command's own main."""

import sys
from collections.abc import Sequence

import bp2_rl
from bp2_rl.cli.app import choose, modules

COMMANDS = {
    "train": "train a policy, stage by stage",
    "eval": "run a policy and measure it",
    "play": "steer a policy's robot in real time, in a browser",
    "robot": "make a robot file from an MJCF or URDF, and check it",
    "trajopt": "optimise trajectories, verify them, build a library of reference motions",
    "study": "compare variants of the training over seeds",
    "identify": "estimate motor parameters from a recording of a real robot",
    "bench": "measure the speed of training on this machine",
    "export": "copy a policy, or write a bundle for a robot or a web page",
    "paper": "reproduce the paper's figures, and study its claims",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that `argv` (by default the process's arguments) names; return
    the exit status."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments[:1] == ["--version"]:
        print(f"bp2_rl {bp2_rl.__version__}")
        return 0
    return choose("bp2", modules("bp2_rl.cli", COMMANDS), arguments)


if __name__ == "__main__":
    sys.exit(main())
