"""`bp2 train`, also `python train.py`: train a stage, or continue a stopped run.

The command line is read in two steps: first the flags on which the defaults of all
others and the start of JAX depend (`EarlyFlags`), then all (`TrainArguments`), with the
preset as default. A mistake is answered before JAX is imported, where that is possible.
"""

import contextlib
import dataclasses
import datetime
import sys
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Annotated, Literal

import tyro

from bp2_rl.base.errors import UserError
from bp2_rl.base.files import require_name
from bp2_rl.base.processes import (
    end_with_caller,
    jax_is_on_cpu,
    left_out,
    use_all_processors,
)
from bp2_rl.base.serialization import merge
from bp2_rl.cli import app
from bp2_rl.robot.hardware import robot_name
from bp2_rl.robot.named import find_robot
from bp2_rl.settings import presets
from bp2_rl.settings.env import EnvConfig, Impl
from bp2_rl.settings.ppo import PPOConfig
from bp2_rl.settings.presets.robots import on_robot
from bp2_rl.settings.task import TaskConfig
from bp2_rl.settings.tracker import Tracker, choose_tracker
from bp2_rl.settings.training import (
    ClusterConfig,
    Preset,
    RobotFlag,
    RunConfig,
    Stage,
    TaskFlag,
    TrainConfig,
    Weights,
    load_run_config,
)

RUNS = Path("runs")
PROG = "bp2 train"
WORDS = "docs/words.md"
SCREEN = """usage: {prog} [FLAGS]

{what}

task and robot:
  --stage {imitation,relaxed}  imitation: learn the reference motion; then
                               relaxed: run faster for less effort [imitation]
  --preset {gpu,cpu,first,smoke,auto}
                               size of the training [auto: gpu if JAX finds an
                               accelerator, else cpu]; first: a slow trot, in
                               minutes; smoke: a test, in a minute
  --robot NAME|FILE            built, ideal, real, go1, ... or a robot file
                               [the robot of --from, else built]
  --weights {ours,paper}       reward weights: ours, or the paper's Table S4
  --reference {collocation,kinematic,none}
                               motion to imitate: trots from trajectory
                               optimisation, a trot in closed form, or standing
  --task FILE[:NAME]           your own rewards, terminations, observations
                               and settings; --task.reward.NAME: a term's weight
                               [the task of --from]

runs:
  --out PATH                   the run's folder [runs/STAGE-DATE-TIME]
  --from PATH                  start with networks and settings of this run
                               [relaxed: the newest imitation run]
  --resume PATH                continue this run from its last checkpoint
  --replay PATH                repeat this run's train step that gave NaN or
                               infinity, and name the value that became so first

length:
  --run.steps INT              control steps, summed over all robots
  --until M/S                  stop when a policy reaches this speed from a stand
                               in C MuJoCo and holds it for 5 s
  --run.seed INT               random seed [0]

compute:
  --impl {kernel,jax,warp}     physics: kernel: fused, the fastest; jax: stock
                               MJX; warp: MJX-Warp
  --ppo.num-envs INT           number of parallel environments
  --deterministic              bit-for-bit reproducible on GPUs; slower
  --track wandb                also log metrics to this tracker
  --cluster.coordinator STR    several machines: HOST:PORT of process 0;
                               auto: from Slurm or Open MPI

all settings, with the preset's values: {prog} --preset cpu --help-all
  --env.hardware.*  --env.control.*  --env.commands.*  --env.reward.*  --env.reset.*
  --env.randomization.*  --env.curriculum.*  --env.termination.*  --env.gait.*
  --env.library.*  --ppo.*  --run.*  --cluster.*

examples:
  python train.py --stage imitation
  python train.py --stage relaxed        # continues the newest imitation run
  python train.py --resume runs/RUN"""
"""What `--help` prints."""


@dataclasses.dataclass(frozen=True)
class EarlyFlags:
    """The flags that are read first: the defaults of all others and JAX's start depend
    on them."""

    stage: Stage = "imitation"
    """imitation: learn the reference motion; then relaxed: run faster for less
    effort"""
    preset: Preset | Literal["auto"] = "auto"
    """size of the training: auto: gpu or cpu; first: a slow trot, in minutes; smoke: a
    test, in a minute"""
    weights: Weights | None = None
    """reward weights: ours, or the paper's Table S4"""
    robot: RobotFlag = None
    """built, ideal, real, go1, ... or a robot file [the robot of --from, else built]"""
    task: TaskFlag = None
    """your own rewards, terminations, observations and settings: FILE.py,
    FILE.py:NAME or package.module:NAME [the task of --from]"""
    parent: Annotated[Path | None, tyro.conf.arg(name="from")] = None
    """start with networks and settings of this run [relaxed: the newest imitation
    run]"""
    resume: Path | None = None
    """continue this run from its last checkpoint"""
    replay: Path | None = None
    """repeat this run's train step that gave NaN or infinity, and name the value that
    became so first"""
    impl: Impl | None = None
    deterministic: bool = False
    """bit-for-bit reproducible on GPUs; slower, and not with --impl warp"""
    track: Tracker | None = None
    """also log metrics to this tracker"""
    cluster: ClusterConfig = ClusterConfig()

    @property
    def existing_run(self) -> Path | None:
        """Folder of the run that is resumed or replayed with its own settings; None for
        a new run."""
        return self.replay if self.resume is None else self.resume

    @property
    def physics(self) -> Impl | None:
        """Physics engine of the training, with the preset `cpu` for `auto`; None if a
        run's settings cannot be read."""
        if self.impl is not None:
            return self.impl
        run = self.existing_run or self.parent
        if run is None and self.stage == "imitation":
            preset = "cpu" if self.preset == "auto" else self.preset
            return presets.preset(self.stage, preset).impl
        if run is None:
            # which of them has finished is not known yet; Warp must be importable
            engines: list[Impl] = [config.impl for _, config in _imitation_runs()]
            return "warp" if "warp" in engines else next(iter(engines), None)
        with contextlib.suppress(UserError):  # reported later
            return load_run_config(run).impl
        return None

    @property
    def known_without_jax(self) -> bool:
        """Return whether these flags determine all defaults without importing JAX.

        A parent's settings, a task and the machine's accelerator need JAX. In a cluster
        every process must learn of a mistake, so the processes connect first.
        """
        return self.cluster.coordinator is None and (
            self.existing_run is not None
            or (
                self.task is None
                and (self.preset != "auto" or jax_is_on_cpu())
                and (self.stage, self.parent) == ("imitation", None)
            )
        )


@dataclasses.dataclass(frozen=True)
class TrainArguments(EarlyFlags):
    """Train a robot to run. A preset chooses the settings; flags change them."""

    impl: Impl = "jax"
    """physics: jax: stock MJX; kernel: fused, the fastest; warp: MJX-Warp"""
    out: Path | None = None
    """the run's folder [runs/STAGE-DATE-TIME]"""
    coefficients: Annotated[dict[str, float], tyro.conf.arg(name="task.reward")] = (
        dataclasses.field(default_factory=dict[str, float])
    )
    """coefficients of the task's reward terms"""
    env: EnvConfig = EnvConfig()
    ppo: PPOConfig = PPOConfig()
    run: RunConfig = RunConfig()

    @property
    def weighted_task(self) -> TaskConfig:
        """The task with the coefficients of the flags.

        Raises:
            UserError: there is no task, or it has no such reward terms.
        """
        terms = dict(self.env.task.rewards)
        if unknown := [name for name in self.coefficients if name not in terms]:
            raise UserError(
                f"--task.reward: no reward term is {unknown[0]!r}; the task has {', '.join(terms) or 'none: name it, --task'}"
            )
        terms |= self.coefficients
        return dataclasses.replace(self.env.task, rewards=tuple(terms.items()))


def main(argv: Sequence[str] | None = None) -> int:
    """Read the flags, train, and return the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    prog = "python train.py" if argv is None else PROG
    status = app.run(lambda: _run(words, prog), patient=False)
    if "jax" not in sys.modules:  # the flags are wrong, or help was asked for
        return status
    from bp2_rl.learning import cluster

    return cluster.leave(status)


def _run(words: list[str], prog: str) -> None:
    """Read the flags, before JAX is imported if the defaults are known by then; train,
    or go on with a run."""
    flags = read_early_flags(words, prog, SCREEN, TrainArguments)
    arguments = None
    if app.HELP_ALL in words or flags.known_without_jax:
        arguments = read_arguments(words, prog, flags)
        choose_tracker(flags.track, flags.resume)
    start_jax(flags)
    from bp2_rl.evaluation import judged_training
    from bp2_rl.learning import cluster
    from bp2_rl.learning.run import replay

    with cluster.together():
        arguments = arguments or read_arguments(words, prog, flags)
        tracker = (
            choose_tracker(flags.track, flags.resume) if cluster.is_first() else None
        )
    if flags.replay is not None:
        with app.failures_into(flags.replay):
            print(replay(flags.replay))
    elif flags.resume is not None:
        with app.failures_into(flags.resume):
            judged_training.resume(flags.resume, tracker=tracker)
    else:
        _train(arguments, tracker)


def read_early_flags(
    words: Sequence[str], prog: str, screen: str, arguments: type[object]
) -> EarlyFlags:
    """Return the early flags of a command line; for help, print the first screen and
    exit.

    The whole help is a new run's, of the preset `cpu` where none is named.
    """
    app.show_screen(words, prog, screen, arguments)
    flags = app.parse_known(EarlyFlags, words, prog)
    if app.HELP_ALL not in words:
        return flags
    preset = "cpu" if flags.preset == "auto" else flags.preset
    return dataclasses.replace(flags, preset=preset, resume=None, replay=None)


def start_jax(flags: EarlyFlags) -> None:
    """Import JAX and find its devices, set up as the flags say, with all processes of a
    cluster."""
    with unused_left_out(flags):
        from bp2_rl.cli import runtime  # isort: skip  # before all that imports MuJoCo
    from bp2_rl.base.processes import keep_compiled
    from bp2_rl.learning import cluster

    end_with_caller()
    use_processors(flags)
    if flags.deterministic:
        if flags.physics == "warp":
            raise UserError(
                "--impl warp is never exactly repeatable: leave out --deterministic, or use --impl jax"
            )
        runtime.repeat_bit_for_bit()
    keep_compiled()
    cluster.join(flags.cluster)
    # if the process has no connection, every further call to the others would fail
    runtime.find_backend()
    runtime.wake_device()


def _train(arguments: TrainArguments, tracker: Tracker | None) -> None:
    """Train with these settings, judged in C MuJoCo, in a new folder."""
    import numpy as np
    from jax.experimental import multihost_utils

    from bp2_rl.cli.runtime import require_accelerator
    from bp2_rl.evaluation import judged_training
    from bp2_rl.learning import cluster

    require_accelerator(arguments.preset)
    env = dataclasses.replace(arguments.env, task=arguments.weighted_task)
    config = TrainConfig(
        arguments.stage, env, arguments.ppo, arguments.run, arguments.impl
    )
    if arguments.out is not None:
        require_name(arguments.out)
    clock = np.array(datetime.datetime.now().timetuple()[:6], np.int32)
    now = datetime.datetime(*multihost_utils.broadcast_one_to_all(clock).tolist())
    out = arguments.out or RUNS / f"{arguments.stage}-{now:%Y%m%d-%H%M%S}"
    say = print if cluster.is_first() else lambda _: None
    say(
        f"{arguments.stage}, preset {arguments.preset}, {config.ppo.num_envs} robots, into {out}"
    )
    say(
        "compiling takes a minute or more at the first start, which XLA may call slow; later it takes seconds"
    )
    say(f"the meaning of the words below: {WORDS}")
    if arguments.parent is not None:
        say(f"continues from {arguments.parent}")
    with app.failures_into(out):
        judged_training.train(config, out, parent=arguments.parent, tracker=tracker)
    say(f"see it run: python eval.py {out}")


def read_arguments(
    words: list[str], prog: str = PROG, flags: EarlyFlags | None = None
) -> TrainArguments:
    """Return all arguments of the command line; defaults come from its stage, preset
    and parent.

    Raises:
        UserError: a flag is wrong, a run is not there, or one that goes on would get
            other settings than its own.
    """
    flags = flags or app.parse_known(EarlyFlags, words, prog)
    if flags.existing_run is not None:
        _require_own_settings(words, flags)
        app.parse(EarlyFlags, words, prog)  # refuses all words that are no flags
        load_run_config(flags.existing_run)
        return TrainArguments(resume=flags.resume, replay=flags.replay)
    preset, parent = find_preset(flags), flags.parent
    if parent is None and flags.stage == "relaxed" and app.HELP_ALL not in words:
        parent = _newest_imitation_run()
    if parent is None:
        defaults = presets.preset(
            flags.stage, preset, flags.weights, flags.robot or "built", flags.task
        )
    else:
        defaults = _continue(flags, preset, parent)
    default = TrainArguments(
        parent=parent,
        task=flags.task,
        coefficients=dict(defaults.env.task.rewards),
        impl=defaults.impl,
        env=defaults.env,
        ppo=defaults.ppo,
        run=defaults.run,
    )
    arguments = app.parse(TrainArguments, words, prog, default)
    return dataclasses.replace(arguments, preset=preset)


def _require_own_settings(words: list[str], flags: EarlyFlags) -> None:
    """Raise UserError for a flag that would change the settings of a continued run."""
    name = "--replay" if flags.resume is None else "--resume"
    allowed = (name, "--cluster.", "--deterministic", "--track")
    for word in words:
        if word.startswith("--") and not word.startswith(allowed):
            raise UserError(
                f"{name} takes the run's own settings: leave out {word.split('=')[0]}"
            )


def use_processors(flags: EarlyFlags) -> None:
    """Let XLA use all processors with the fused kernel; with MJX that may hang
    (`use_one_xla_thread`)."""
    if flags.physics == "kernel":
        use_all_processors()


def unused_left_out(flags: EarlyFlags) -> contextlib.AbstractContextManager[None]:
    """Let MJX be imported without NetworkX and, unless Warp simulates, without Warp:
    each takes a second."""
    return left_out("networkx", *(() if flags.physics == "warp" else ("warp",)))


def find_preset(flags: EarlyFlags) -> Preset:
    """Return the preset of the flags, or for `auto` the one that suits this machine."""
    if flags.preset != "auto":
        return flags.preset
    if flags.known_without_jax:
        return "cpu"
    from bp2_rl.cli.runtime import find_backend

    return "cpu" if find_backend() == "cpu" else "gpu"


def _continue(flags: EarlyFlags, preset: Preset, parent: Path) -> TrainConfig:
    """Return the settings of a stage that continues a parent run, with the parent's
    robot, physics, networks and changed settings."""
    from bp2_rl.learning import run

    old = run.load_own(parent)
    task = flags.task or old.env.task.code
    robot = (
        (robot_name(old.env.hardware) or "built")
        if old.env.hardware.is_bp2
        else old.env.hardware
    )
    before, now = (
        presets.preset(stage, preset, flags.weights, robot, task)
        for stage in (old.stage, flags.stage)
    )
    env = merge(before.env, old.env, now.env)
    if flags.robot and env.hardware != (other := find_robot(flags.robot)):
        if other.anatomy.name != env.hardware.anatomy.name:
            raise UserError(
                f"--robot {flags.robot}: {parent} was trained on {env.hardware.anatomy.name}, another robot"
            )
        env = on_robot(env, other)
    return dataclasses.replace(
        now,
        impl=old.impl,
        env=dataclasses.replace(env, reward=now.env.reward, task=now.env.task),
        ppo=dataclasses.replace(
            now.ppo, **{name: getattr(old.ppo, name) for name in run.NETWORK}
        ),
    )


def _imitation_runs() -> Generator[tuple[Path, TrainConfig]]:
    """Yield the folders of imitation runs and their settings, newest first."""
    for path in sorted(
        RUNS.glob("*/config.json"), key=lambda path: path.stat().st_mtime, reverse=True
    ):
        with contextlib.suppress(UserError):  # an older one serves as well
            config = load_run_config(path.parent)
            if config.stage == "imitation":
                yield path.parent, config


def _newest_imitation_run() -> Path:
    from bp2_rl.learning.loop import is_finished

    for folder, _ in _imitation_runs():
        with contextlib.suppress(UserError):
            if is_finished(folder):
                return folder
    raise UserError(
        f"no finished imitation run in {RUNS}/: run `python train.py --stage imitation` first, or name one with --from"
    )
