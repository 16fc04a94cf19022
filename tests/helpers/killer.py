"""`killer.py FOLDER ACTION`: does ACTION to copies 1, 2, ... of FOLDER/run; in copy n
the process that does so is ended at its n-th operation on files. The last copy is the
one in which it came to its end."""

import dataclasses
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

from bp2_rl.learning import checkpoint
from bp2_rl.learning.policy import load_policy, save_policy

OPERATIONS = ("replace", "rename", "fsync", "mkdir", "rmdir", "unlink", "open")


def save_checkpoint(run, step, state, config=None, log=None):
    """Save, and wait until that is on disk."""
    with checkpoint.Saver(run, config or {}) as saver:
        saver.save(step, state, log)


def save_step(run, step):
    checkpoint.KEPT = 2
    save_checkpoint(run, int(step), {"x": np.full(1000, 7.0)})


def save_card(run):
    policy = load_policy(run)
    save_policy(
        run / "policies" / "64",
        dataclasses.replace(policy, card=dataclasses.replace(policy.card, seed=8)),
    )


def killed_at_every_operation(folder: Path, *action: object) -> list[Path]:
    """Run this program on a folder, and return the run's copies, in the order of the
    kills."""
    command = [sys.executable, __file__, folder, *map(str, action)]
    done = subprocess.run(
        command,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    copies = sorted(
        (path for path in folder.iterdir() if path.name.isdecimal()),
        key=lambda path: int(path.name),
    )
    assert len(copies) > 15
    return copies


def main(folder, action, *arguments):
    for n in range(1, 1000):
        run = Path(folder, str(n))
        shutil.copytree(Path(folder, "run"), run)
        child = os.fork()
        if not child:  # JAX has started no thread yet
            kill_at(n)
            {"save_step": save_step, "save_card": save_card}[action](run, *arguments)
            os._exit(0)
        if os.waitpid(child, 0)[1] == 0:
            break


def kill_at(n):
    left = iter(range(n - 1, -1, -1))

    def counting(real):
        def operation(*args, **kwargs):
            if next(left, 1) == 0:
                os._exit(9)
            return real(*args, **kwargs)

        return operation

    for name in OPERATIONS:
        setattr(os, name, counting(getattr(os, name)))


if __name__ == "__main__":
    main(*sys.argv[1:])
