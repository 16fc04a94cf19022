"""`bp2 train`, also `python train.py`: train a stage, or go on with a stopped run."""

import argparse
import contextlib
import dataclasses
import datetime
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal, NamedTuple, TypeVar, cast, get_args

import tyro

from bp2_rl.base.errors import OK, UserError
from bp2_rl.base.files import require_name
from bp2_rl.base.processes import end_with_caller, left_out, use_all_processors
from bp2_rl.base.serialization import merge
from bp2_rl.cli import app, usage
from bp2_rl.robot.hardware import robot_name
from bp2_rl.robot.named import find_robot
from bp2_rl.settings import presets
from bp2_rl.settings.cluster import ClusterConfig
from bp2_rl.settings.env import EnvConfig, Impl
from bp2_rl.settings.ppo import PPOConfig
from bp2_rl.settings.presets.robots import on_robot
from bp2_rl.settings.tracking import Tracker, choose_tracker
from bp2_rl.settings.training import (
    Preset,
    RobotWish,
    RunConfig,
    Stage,
    TrainConfig,
    Weights,
    load_run_config,
)

Config = TypeVar("Config")
EVERYDAY = {
    "what is trained": ("stage", "preset", "weights", "robot", "reference"),
    "runs": ("out", "from", "resume", "replay"),
    "how long": ("run.steps", "until", "run.seed", "run.films"),
    "by what": (
        "impl",
        "ppo.num-envs",
        "deterministic",
        "track",
        "cluster.coordinator",
    ),
}
"""Flags that --help shows, by its headings; --help-all shows all."""
RUNS = Path("runs")
PROG = "bp2 train"
WORDS = "docs/words.md"


@dataclasses.dataclass(frozen=True)
class ProcessOptions:
    """How the process runs, whatever it trains; also with --resume and --replay."""

    deterministic: bool = False
    """a GPU, too, repeats the same bits; slower, and not with --impl warp"""
    track: Tracker | None = None
    """send the metrics to this tracker, too"""
    cluster: ClusterConfig = ClusterConfig()


@dataclasses.dataclass(frozen=True)
class TrainArguments:
    """Train a robot to run. A preset chooses the settings; flags change them.

    Examples:
        python train.py --stage imitation
        python train.py --stage relaxed        # on from the newest imitation run
        python train.py --resume runs/RUN
    """

    stage: Stage = "imitation"
    """imitation first, then relaxed"""
    preset: Preset | Literal["auto"] = "auto"
    """auto: gpu or cpu; first: learn to trot, in minutes; smoke: tests"""
    weights: Weights | None = None
    """rewards: ours, or the paper's Table S4"""
    robot: RobotWish = None
    """built, ideal, go1 or another that ships, or a file; by default that of --from,
    else built"""
    out: Path | None = None
    """the run's folder [runs/STAGE-DATE-TIME]"""
    parent: Annotated[Path | None, tyro.conf.arg(name="from")] = None
    """take networks and settings from this run [relaxed: the newest imitation run]"""
    resume: Path | None = None
    """go on with this stopped run where it stands"""
    replay: Path | None = None
    """repeat this run's train step that was not finite, and say what was not finite
    first"""
    impl: Impl = "jax"
    """physics: jax: stock MJX; kernel: fused, the fastest; warp: MJX-Warp"""
    env: EnvConfig = EnvConfig()
    ppo: PPOConfig = PPOConfig()
    run: RunConfig = RunConfig()
    process: Annotated[ProcessOptions, tyro.conf.arg(name="")] = ProcessOptions()


def main(argv: Sequence[str] | None = None) -> int:
    """Parse, train, and return the exit status."""
    words, prog = (
        list(sys.argv[1:] if argv is None else argv),
        "python train.py" if argv is None else PROG,
    )
    status = app.run(lambda: _answer_early(words, prog))
    if status != OK:
        return status

    with unused_left_out(read_named(words)):
        from bp2_rl.cli import runtime  # noqa: F401  # isort: skip  # before all that imports MuJoCo
    from bp2_rl.learning import cluster

    return cluster.leave(app.run(lambda: _train(words, prog), patient=False))


def _answer_early(argv: list[str], prog: str) -> None:
    arguments = answer_early(argv, prog, train_arguments, EVERYDAY)
    if arguments is not None:
        _require_runs(argv, arguments)
        choose_tracker(arguments.process.track, arguments.resume)


def answer_early(
    argv: list[str],
    prog: str,
    with_defaults: Callable[[TrainConfig], Config],
    everyday: Mapping[str, Sequence[str]] | None = None,
) -> Config | None:
    """Print the help, and exit, or refuse a mistake before JAX is imported, which takes
    seconds.

    What a flag may be can hang on the machine's preset and on the parent's settings,
    which are not known yet. So help shows the defaults of the preset named, else of
    `cpu`. Only what is wrong with every preset is refused, and with a parent only what
    is no flag or of another type. In a cluster nothing is: there the others must hear
    of it, too.

    Return the arguments, where they can be told already; their defaults may yet be
    others.

    Args:
        argv: the command line.
        prog: the command as the user types it.
        with_defaults: the arguments with a preset's settings as their defaults.
        everyday: what the help shows, as of `usage.describe`.
    """
    named, mistakes = read_named(argv), []

    def defaults(preset: Preset) -> Config:
        return with_defaults(
            presets.preset(named.stage, preset, named.weights, named.robot or "built")
        )

    if usage.is_asked(argv):
        preset = named.preset or "cpu"
        note = f"Defaults are in brackets, here those of the preset {preset}."
        default = defaults(preset)
        print(
            usage.describe(
                type(default),
                prog,
                default,
                everyday,
                note,
                everything=usage.HELP_ALL in argv,
            )
        )
        raise SystemExit(OK)
    if any(word.startswith("--cluster.coordinator") for word in argv):
        return None
    for preset in (named.preset,) if named.preset else get_args(Preset):
        try:
            default = defaults(preset)
            return app.parse(type(default), argv, prog, default=default)
        except UserError as mistake:
            mistakes.append(mistake)
    if isinstance(mistakes[0], app.FlagError) or (
        named.parent is None and named.stage == "imitation"
    ):
        raise mistakes[0]
    return None


def _train(argv: list[str], prog: str) -> None:
    import numpy as np

    from bp2_rl.base.processes import keep_compiled
    from bp2_rl.cli.runtime import (
        find_backend,
        repeat_bit_for_bit,
        require_accelerator,
        wake_device,
    )
    from bp2_rl.learning import cluster

    end_with_caller()
    # First of all: the rest of the command line is read with what JAX says of the
    # machine.
    process = app.parse(ProcessOptions, argv, prog, part=True)
    use_processors(read_named(argv))
    if process.deterministic:
        repeat_bit_for_bit()
    keep_compiled()
    cluster.join(process.cluster)
    find_backend()  # where there is none, every further word to the others would fail
    wake_device()
    from bp2_rl.evaluation import judged_training
    from bp2_rl.learning.run import replay

    with cluster.together():
        arguments = _parse(argv, prog)
        tracker = (
            choose_tracker(process.track, arguments.resume)
            if cluster.is_first()
            else None
        )
    if arguments.replay is not None:
        with app.failures_into(arguments.replay):
            print(replay(arguments.replay))
        return
    if arguments.resume is not None:
        with app.failures_into(arguments.resume):
            judged_training.resume(arguments.resume, tracker=tracker)
        return
    require_accelerator(arguments.preset)
    if process.deterministic and arguments.impl == "warp":
        raise UserError(
            "--impl warp is never exactly repeatable: leave out --deterministic, or use --impl jax"
        )
    config = TrainConfig(
        arguments.stage, arguments.env, arguments.ppo, arguments.run, arguments.impl
    )
    if arguments.out is not None:
        require_name(arguments.out)
    clock = np.array(datetime.datetime.now().timetuple()[:6], np.int32)
    now = datetime.datetime(*cluster.from_first(clock).tolist())
    out = arguments.out or RUNS / f"{arguments.stage}-{now:%Y%m%d-%H%M%S}"
    say = print if cluster.is_first() else lambda _: None
    say(
        f"{arguments.stage}, preset {arguments.preset}, {config.ppo.num_envs} robots, into {out}"
    )
    say(
        "compiling: a minute or more at the first start, whatever XLA says of that; seconds at later ones"
    )
    say(f"what the words below mean: {WORDS}")
    if arguments.parent is not None:
        say(f"continues from {arguments.parent}")
    with app.failures_into(out):
        judged_training.train(config, out, parent=arguments.parent, tracker=tracker)
    say(f"see it run: python eval.py {out}")


class NamedDefaults(NamedTuple):
    """The flags of an unchecked command line on which the settings' defaults depend."""

    stage: Stage
    preset: Preset | None
    weights: Weights | None
    robot: RobotWish
    parent: Path | None
    goes_on: Path | None  # with this run's own settings
    impl: str | None


def _require_runs(argv: list[str], arguments: TrainArguments) -> None:
    """Look at the runs that are named: they must be there, and a run that goes on has
    its own settings."""
    for flag in ("--resume", "--replay"):
        allowed = (flag, "--cluster.", "--deterministic", "--track")
        others = [
            other
            for other in argv
            if other.startswith("--") and not other.startswith(allowed)
        ]
        if vars(arguments)[flag[2:]] is not None and others:
            raise UserError(
                f"{flag} takes the run's own settings: leave out {others[0].split('=')[0]}"
            )
    for folder in (arguments.resume, arguments.replay, arguments.parent):
        if folder is not None:
            load_run_config(folder)


def read_named(argv: list[str]) -> NamedDefaults:
    """Read these flags alone, whatever else is on the command line."""
    first = argparse.ArgumentParser(
        add_help=False, allow_abbrev=False, exit_on_error=False
    )
    for flag in (
        "--stage",
        "--preset",
        "--weights",
        "--robot",
        "--from",
        "--resume",
        "--replay",
        "--impl",
    ):
        first.add_argument(flag, nargs="?")
    words = vars(
        first.parse_known_args([word for word in argv if word not in usage.HELP])[0]
    )
    run = words["replay"] if words["resume"] is None else words["resume"]
    return NamedDefaults(
        stage="relaxed" if words["stage"] == "relaxed" else "imitation",
        preset=cast(Preset, words["preset"])
        if words["preset"] in get_args(Preset)
        else None,
        weights=cast(Weights, words["weights"])
        if words["weights"] in get_args(Weights)
        else None,
        robot=words["robot"],
        parent=Path(words["from"]) if words["from"] else None,
        goes_on=None if run is None else Path(run),
        impl=words["impl"],
    )


def use_processors(named: NamedDefaults) -> None:
    """Let XLA compute on all processors where MJX does not simulate; with MJX it may
    hang (`use_one_xla_thread`)."""
    if _physics(named) == "kernel":
        use_all_processors()


def unused_left_out(named: NamedDefaults) -> contextlib.AbstractContextManager[None]:
    """Let MJX be imported without NetworkX, and without Warp unless Warp simulates:
    each takes a second."""
    return left_out("networkx", *(() if _physics(named) == "warp" else ("warp",)))


def _physics(named: NamedDefaults) -> str | None:
    """The physics of a command line, without an accelerator where it hangs on that;
    None where nothing tells it."""
    if named.impl is not None:
        return named.impl
    if named.goes_on is None:
        return presets.preset(named.stage, named.preset or "cpu").impl
    with contextlib.suppress(UserError):  # it is told of later
        return load_run_config(named.goes_on).impl
    return None


def train_arguments(
    defaults: TrainConfig, parent: Path | None = None
) -> TrainArguments:
    """Return the arguments of a command line without flags, whose defaults are
    these."""
    return TrainArguments(
        parent=parent,
        impl=defaults.impl,
        env=defaults.env,
        ppo=defaults.ppo,
        run=defaults.run,
    )


def _parse(argv: list[str], prog: str = PROG) -> TrainArguments:
    """The arguments, with the defaults of the stage, preset and parent that they
    name."""
    named = read_named(argv)
    preset, defaults = defaults_here(
        named.stage, named.preset, named.weights, named.robot
    )
    parent = named.parent
    if named.goes_on is None:
        if parent is None and named.stage == "relaxed":
            parent = _newest_imitation_run()
        if parent is not None:
            defaults = _continue(defaults.stage, preset, parent, named)
    arguments = app.parse(
        TrainArguments, argv, prog, default=train_arguments(defaults, parent)
    )
    _require_runs(argv, arguments)
    return dataclasses.replace(arguments, preset=preset)


def _continue(
    stage: Stage, preset: Preset, parent: Path, named: NamedDefaults
) -> TrainConfig:
    """The stage's settings on the parent's robot, or the one named, its networks, and
    what was set for it alone."""
    from bp2_rl.learning import run

    old = load_run_config(parent)
    theirs = (
        (robot_name(old.env.hardware) or "built")
        if old.env.hardware.is_bp2
        else old.env.hardware
    )
    before, now = (
        presets.preset(each, preset, named.weights, theirs)
        for each in (old.stage, stage)
    )
    env = merge(before.env, old.env, now.env)
    if named.robot and env.hardware != (other := find_robot(named.robot)):
        if other.anatomy.name != env.hardware.anatomy.name:
            raise UserError(
                f"--robot {named.robot}: {parent} was trained on {env.hardware.anatomy.name}, another robot"
            )
        env = on_robot(env, other)
    return dataclasses.replace(
        now,
        env=dataclasses.replace(env, reward=now.env.reward),
        ppo=dataclasses.replace(
            now.ppo, **{name: getattr(old.ppo, name) for name in run.NETWORK}
        ),
    )


def defaults_here(
    stage: Stage,
    named: str | None,
    weights: Weights | None = None,
    robot: RobotWish = None,
) -> tuple[Preset, TrainConfig]:
    """Return the named preset, or else the one for this machine, and its settings."""
    from bp2_rl.cli.runtime import find_backend

    on_cpu = find_backend() == "cpu"
    preset = cast(
        Preset, named if named in get_args(Preset) else "cpu" if on_cpu else "gpu"
    )
    return preset, presets.preset(stage, preset, weights, robot or "built")


def _newest_imitation_run() -> Path:
    from bp2_rl.learning.loop import is_finished

    runs = sorted(
        RUNS.glob("*/config.json"), key=lambda path: path.stat().st_mtime, reverse=True
    )
    for folder in (path.parent for path in runs):
        try:
            if load_run_config(folder).stage == "imitation" and is_finished(folder):
                return folder
        except UserError:
            continue  # a damaged run is no reason not to use an older one
    raise UserError(
        f"no finished imitation run in {RUNS}/: run `python train.py --stage imitation` first, or name one with --from"
    )
