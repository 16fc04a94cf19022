"""What macOS and Windows lack is taken away here, on Linux: everything can still be
imported, and folders made."""

import subprocess
import sys

POSIX_ONLY = (
    "fcntl",
    "grp",
    "posix",
    "pty",
    "pwd",
    "resource",
    "syslog",
    "termios",
    "tty",
)
"""Modules that Windows has not; macOS has them."""

PROGRAM = f"""
import builtins, importlib, os, pathlib, pkgutil, signal, sys
import jax, mujoco, brax.envs, matplotlib.figure  # others look after themselves, before anything is gone

real = builtins.__import__
def without_posix(name, globals=None, *rest):
    if name in {POSIX_ONLY} and (globals or {{}}).get("__name__", "").startswith("bp2_rl"):
        raise ModuleNotFoundError(f"no module {{name}} on this system", name=name)
    return real(name, globals, *rest)
builtins.__import__ = without_posix
for name in ("sched_getaffinity", "sched_setaffinity", "nice", "fork", "getuid", "geteuid", "O_DIRECTORY"):
    delattr(os, name)
for name in ("SIGKILL", "SIGHUP", "SIGUSR1", "SIGUSR2"):
    delattr(signal, name)

import bp2_rl
count = 0
for module in pkgutil.walk_packages(bp2_rl.__path__, "bp2_rl."):
    if module.name.endswith("__main__"):
        continue
    try:
        importlib.import_module(module.name)
        count += 1
    except ModuleNotFoundError as missing:  # a package of an extra is not this test's matter
        if missing.name in {POSIX_ONLY} or missing.name.startswith("bp2_rl"):
            sys.exit(f"{{module.name}} needs {{missing.name}}")
    except bp2_rl.base.errors.UserError:
        pass  # likewise, in one line
print(count, "modules")

from bp2_rl.base.folders import lock_folder, new_folder
from bp2_rl.base.processes import processors
assert processors() >= 1
with new_folder(pathlib.Path("made")) as folder:
    (folder / "file").write_text("content")
with lock_folder(pathlib.Path("made"), "busy"):
    assert pathlib.Path("made/file").read_text() == "content"
"""


def test_every_module_imports_without_what_other_systems_lack(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    counted = done.stdout.splitlines()[-1]  # MuJoCo's say of Warp comes before
    assert int(counted.split()[0]) > 200  # of the package, not of an empty folder
