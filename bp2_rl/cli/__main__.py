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
    "robot": "make a robot file from a model, and look at what it says",
    "trajopt": "find trajectories, verify them, build the library of reference motions",
    "study": "compare recipes over seeds: the ablation, and the control steps to 10.74 m/s",
    "identify": "find the numbers of a robot's motors from a recording of the robot",
    "bench": "measure how fast training is on this machine",
    "export": "copy a run's policy, with what was measured of it on its card",
    "paper": "the paper's evidence: its figures, pendulums, studies of trajectories and deep benchmarks",
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
