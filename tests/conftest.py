"""Setting of every test: JAX on the CPU, compiled code kept between runs, shapes and
types checked."""

import dataclasses
import functools
import gc
import hashlib
import importlib.metadata
import inspect
import os
import platform
from pathlib import Path


def _compilation_cache() -> Path | None:
    """Return the folder of this user for code compiled on this very processor; None
    where there is no place for one."""
    try:
        features = (
            Path("/proc/cpuinfo").read_text().split("flags", 1)[1].split("\n", 1)[0]
        )
    except (OSError, IndexError):
        features = platform.processor()
    machine = hashlib.sha256(f"{platform.machine()} {features}".encode()).hexdigest()[
        :12
    ]
    try:
        root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        folder = root / "bp2_rl" / f"tests-{machine}"
        (folder / "jax").mkdir(parents=True, exist_ok=True, mode=0o700)
    except (OSError, RuntimeError):
        return None
    return folder if os.access(folder, os.W_OK) else None


def pytest_addoption(parser):
    parser.addoption(
        "--kills",
        type=int,
        default=2,
        help="how often the killed run of test_stops.py is killed",
    )
    parser.addoption(
        "--fuzz",
        action="store_true",
        help="draw other examples in each run of the property tests",
    )


def pytest_configure(config):
    """Make property tests try the same examples in every run, unless the command says
    --fuzz."""
    hypothesis.settings.register_profile("repeatable", derandomize=True)
    hypothesis.settings.load_profile(
        "default" if config.getoption("--fuzz") else "repeatable"
    )


# In the environment, so that the commands which tests start have them too, and before
# JAX reads it on import.
os.environ.setdefault("JAX_PLATFORMS", "cpu")
# IPOPT's matrices are small: threads would only wait
os.environ.setdefault("OMP_NUM_THREADS", "1")
if cache := _compilation_cache():
    os.environ.setdefault("BP2_CACHE", str(cache))
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache / "jax"))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
# Tests compile far longer than they run: XLA optimises little, which takes a third of
# the time, and emits a program in one piece, which takes a third less again. Each
# command that a test starts does so, too. What is compared bit for bit is compiled
# alike.
os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "true")
FUSION = (
    "--xla_cpu_use_fusion_emitters=false"
    if importlib.metadata.version("jaxlib").startswith("0.10.")
    else ""
)
"""Later ones do not know the flag, and end at it."""
COMPILER = f"--xla_cpu_parallel_codegen_split_count=1 {FUSION}"
os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {COMPILER}".strip()

import flax.struct  # noqa: E402
import hypothesis  # noqa: E402
import jax  # noqa: E402
import jaxtyping  # noqa: E402
import numpy as np  # noqa: E402
from tyro._parsers import ParserSpecification  # noqa: E402

# What JAX makes while it traces stays: looking through all of it for garbage takes some
# per cent of the time.
gc.set_threshold(100_000, 50, 50)

# Every annotated shape and type of the package is checked as tests call it. Two
# allowances: the package's pure functions take NumPy arrays where the signature says
# Array, and an int is a fine float (PEP 484).
jaxtyping.Array = jax.Array | np.ndarray

# `jax_numpy_rank_promotion = "raise"` is not for us: MJX's step (mjx/_src/smooth.py,
# constraint.py, passive.py) and Brax's normaliser (running_statistics.py) promote ranks
# themselves, within every program that a test compiles.

# JAX rebuilds its pytrees with whatever it maps over them: batches, shapes, shardings.
# So these are not checked when made; the functions that make and take their parts are.
# `flax.struct.PyTreeNode` makes its subclasses by it, too.
_struct_dataclass = flax.struct.dataclass


def _unchecked(*args, **kwargs):
    made = _struct_dataclass(*args, **kwargs)
    made.__no_type_check__ = True
    return made


flax.struct.dataclass = _unchecked

# Checks take ten times as long as a robot's millisecond, and a function within another
# is decorated anew at each call of that one. So a function is checked at its first
# calls in each test, and decorated at the first of all.
CHECKED_CALLS = 30
_jaxtyped = jaxtyping.jaxtyped
_calls: dict[str, int] = {}  # of each function by its name, in the test that runs


def pytest_runtest_logstart():
    _calls.clear()


def _checked_at_first(function, *, typechecker):
    if inspect.isclass(function):
        if dataclasses.is_dataclass(function) and not getattr(
            function, "__no_type_check__", False
        ):
            checked = _checked_at_first(function.__init__, typechecker=typechecker)
            setattr(function, "__init__", checked)  # noqa: B010
        return function
    name, checked = f"{function.__module__}.{function.__qualname__}", None

    @functools.wraps(function)
    def call(*args, **kwargs):
        nonlocal checked
        calls = _calls.get(name, 0)
        if calls == CHECKED_CALLS:
            return function(*args, **kwargs)
        _calls[name] = calls + 1
        if checked is None:
            checked = _jaxtyped(function, typechecker=typechecker)
        return checked(*args, **kwargs)

    return call


# tyro reads a command's settings anew for each command line, types, docstrings and all:
# 0.2 s for those of a training, three times a command. What it has read of equal
# settings is kept.
_read_settings = ParserSpecification.from_callable_or_type
_settings_read: dict[tuple, ParserSpecification] = {}


def _read_once(f, **options):
    key = f, repr(options)
    if key not in _settings_read:
        _settings_read[key] = _read_settings(f, **options)
    return _settings_read[key]


setattr(ParserSpecification, "from_callable_or_type", staticmethod(_read_once))  # noqa: B010

jaxtyping.jaxtyped = lambda typechecker: functools.partial(
    _checked_at_first, typechecker=typechecker
)
jaxtyping.install_import_hook(
    "bp2_rl", "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))"
)
# runs, cards and policies for tests of the evidence, the study and the commands
pytest_plugins = ["synthetic"]
