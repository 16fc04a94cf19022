"""Run the trainings of a study: as processes of this machine, one on each GPU, or as
jobs of a cluster (submitit).

A study is a folder of runs, VARIANT-SEED-STAGE. What is finished is not done again, so
that a study can be stopped and gone on with.
"""

import asyncio
import contextlib
import dataclasses
import itertools
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bp2_rl.base.errors import UserError
from bp2_rl.base.files import open_in_place
from bp2_rl.base.folders import lock_folder, make_folder
from bp2_rl.base.processes import command_environment, spawned
from bp2_rl.base.serialization import claim_folder, config_hash, utc_now
from bp2_rl.learning.checkpoint import latest_step
from bp2_rl.learning.judged import POLICIES
from bp2_rl.learning.loop import is_finished
from bp2_rl.settings.jobs import JobsConfig
from bp2_rl.settings.presets import preset
from bp2_rl.settings.task import TaskConfig, TaskSources, read_task
from bp2_rl.settings.training import Preset
from bp2_rl.simulation.parallel import compute_here
from bp2_rl.tools.study.outcome import measure_policies
from bp2_rl.tools.study.plan import STAGES, Plan, Training, label, variant_named

if TYPE_CHECKING:
    from submitit.helpers import DelayedSubmission

TRAIN = ("-m", "bp2_rl", "train")
GRACE = 120
"""Time between the scheduler's warning and the end of a job, in which the training
saves, s."""
OFTEN = 1000
"""Largest number of times that a job is queued again after its time limit."""
POLL = 0.5  # s


def begin(
    arguments: Sequence[str],
    run_dir: Path,
    *,
    train: Sequence[str] = TRAIN,
    gpu: str | None = None,
    keep: Sequence[int] = (),
) -> "subprocess.Popen[bytes]":
    """Start train.py for a run as a child process, with its output in RUN.txt; it saves
    and ends with this process.

    Args:
        arguments: for a new run; one that has a checkpoint is resumed.
        run_dir: the run's folder.
        train: what Python runs.
        gpu: the only one that it is to see; None for all.
        keep: file descriptors that it inherits.

    Raises:
        UserError: another process trains the run, or it lies elsewhere.
    """
    if run_dir.is_symlink():
        raise UserError(f"{run_dir} is a link to elsewhere: remove it")
    if latest_step(run_dir) is not None:
        arguments = ["--resume", str(run_dir)]
    elif run_dir.exists() and not (run_dir / POLICIES).exists():
        with lock_folder(run_dir, f"{run_dir.name}: another process trains it"):
            # killed before its first checkpoint: nothing to go on from
            shutil.rmtree(run_dir)
    environment = command_environment()
    if gpu is not None:
        environment["CUDA_VISIBLE_DEVICES"] = gpu
    with open_in_place(run_dir.with_suffix(".txt")) as log:
        log.write(f"{utc_now()} {' '.join(arguments)}\n")
        log.flush()
        command = [sys.executable, *train, *arguments]
        return subprocess.Popen(
            command,
            env=environment,
            stdout=log,
            stderr=subprocess.STDOUT,
            pass_fds=tuple(keep),
        )


@dataclasses.dataclass(frozen=True)
class Resources:
    """The GPUs, processes and jobs that a study's trainings may use."""

    # of this machine, as CUDA_VISIBLE_DEVICES names them; none: one training on what
    # JAX finds
    gpus: Sequence[str]
    judges: int  # processes that measure policies here
    say: Callable[[str], None]  # takes lines of progress
    # whether the trainings are jobs of a cluster; its machines then measure, too
    jobs: JobsConfig = JobsConfig()


def visible_gpus() -> tuple[str, ...]:
    """Return the names of NVIDIA's GPUs for CUDA_VISIBLE_DEVICES; empty without any."""
    named = os.environ.get("CUDA_VISIBLE_DEVICES")
    if named is not None:
        # CUDA ignores all from the first that there cannot be on, such as -1
        return tuple(
            itertools.takewhile(
                lambda name: name and not name.startswith("-"), named.split(",")
            )
        )
    if shutil.which("nvidia-smi") is None:
        return ()
    listed = subprocess.run(["nvidia-smi", "-L"], capture_output=True, text=True).stdout
    return tuple(
        map(str, range(sum(line.startswith("GPU") for line in listed.splitlines())))
    )


class Here:
    """Runs trainings as processes of this machine, one on each GPU; without GPUs one at
    a time.

    Args:
        gpus: as CUDA_VISIBLE_DEVICES names them.
        lock: a file descriptor that the processes hold as long as they live.
    """

    def __init__(self, gpus: Sequence[str], lock: int):
        self.slots: tuple[str | None, ...] = tuple(gpus) or (None,)
        self._lock = lock

    async def train(
        self,
        arguments: Sequence[str],
        run_dir: Path,
        gpu: str | None,
        task: TaskSources | None = None,
    ) -> bool:
        """Run a training to its end, from its checkpoint if it has one; return whether
        it finished.

        A training that is cancelled saves first.

        Raises:
            UserError: as `begin` does.
        """
        del task  # who measures the policies needs it
        process = begin(arguments, run_dir, gpu=gpu, keep=(self._lock,))
        try:
            return await _status(process) == 0
        except asyncio.CancelledError:
            process.terminate()
            await _status(process)
            raise


async def _status(process: "subprocess.Popen[bytes]") -> int:
    while (status := process.poll()) is None:
        await asyncio.sleep(POLL)
    return status


class Jobs:
    """Runs trainings as jobs of a cluster, by submitit; each job also measures its
    policies. Logs are in `folder`/jobs.

    Args:
        config: which cluster, and what of it a job gets.
        folder: of the study, on a file system that the cluster's machines share.
        say: takes lines of progress.
    """

    def __init__(self, config: JobsConfig, folder: Path, say: Callable[[str], None]):
        import submitit

        self.slots: tuple[None, ...] = (None,) * config.most
        self._say = say
        try:
            self._executor = submitit.AutoExecutor(
                folder / "jobs", cluster=config.executor, slurm_max_num_timeout=OFTEN
            )
        except RuntimeError as error:
            raise UserError(f"--jobs.executor {config.executor}: {error}") from error
        slurm = {"slurm_partition": config.partition, "slurm_account": config.account}
        self._executor.update_parameters(
            name="bp2",
            timeout_min=round(60 * config.hours),
            gpus_per_node=config.gpus,
            cpus_per_task=config.cpus,
            slurm_signal_delay_s=GRACE,
            **{name: value for name, value in slurm.items() if value is not None},
        )

    async def train(
        self,
        arguments: Sequence[str],
        run_dir: Path,
        slot: str | None = None,
        task: TaskSources | None = None,
    ) -> bool:
        """Run a training as a job, as `Here.train` does in a process; return whether it
        finished.

        A training that is cancelled is told by Slurm to save.
        """
        del slot  # the scheduler finds a machine
        job = self._executor.submit(Job(arguments, run_dir, task))
        self._say(f"{run_dir.name}: job {job.job_id}")
        try:
            while not job.done():
                await asyncio.sleep(POLL)
        except asyncio.CancelledError:
            job.cancel(check=False)
            raise
        failure = job.exception()
        if failure is not None:
            self._say(f"{run_dir.name}: {' '.join(str(failure).split())[-300:]}")
        return failure is None and job.result()


class Job:
    """One training as a job on a cluster's machine; submitit pickles it."""

    def __init__(
        self,
        arguments: Sequence[str],
        run_dir: Path,
        task: TaskSources | None = None,
    ):
        self._arguments = tuple(arguments)
        self._task = task
        self._run_dir = run_dir.resolve()
        self._train = TRAIN
        self._process: subprocess.Popen[bytes] | None = None

    def __call__(self) -> bool:
        """Train, then measure the policies; return whether the training finished."""
        self._process = begin(self._arguments, self._run_dir, train=self._train)
        # Not `wait`, which holds a lock that `checkpoint` could not get past.
        os.waitid(os.P_PID, self._process.pid, os.WEXITED | os.WNOWAIT)
        if self._process.wait() != 0:
            return False
        self._process = None
        compute_here()
        measure_policies(self._run_dir, self._task)
        return True

    def checkpoint(self) -> "DelayedSubmission":
        """Let the training save, and return the job to be queued again; called when the
        scheduler wants the machine back.

        submitit calls this from a signal's handler, in the middle of `__call__`.
        """
        from submitit.helpers import DelayedSubmission

        if self._process is not None:
            with contextlib.suppress(ProcessLookupError, ChildProcessError):
                os.kill(self._process.pid, signal.SIGTERM)
                os.waitid(os.P_PID, self._process.pid, os.WEXITED | os.WNOWAIT)
            self._process = None
        return DelayedSubmission(self)


# --- The study ------------------------------------------------------------------------

RECIPE = "recipe.json"


@dataclasses.dataclass(frozen=True)
class _Recipe:
    """The settings that all runs of a study share."""

    preset: Preset
    steps: tuple[int, int]
    # hashes of the stages' settings, by which a change of the defaults is seen
    settings: tuple[str, ...]
    robot: str


def run_study(
    plan: Plan,
    folder: Path,
    resources: Resources,
    measured: Callable[[Training], object] = lambda training: None,
) -> list[Training]:
    """Run the trainings and measurements of a study that are missing; return the failed
    ones and their dependants.

    An interruption ends the trainings, too, which save what they have.

    Args:
        plan: what to do.
        folder: of the study, made if need be.
        resources: what the trainings run on.
        measured: called with each training whose policies have been measured, while
            others train.

    Raises:
        UserError: the folder holds a study of another recipe or size, or another
            process is at work on it.
    """
    make_folder(folder)
    busy = f"another study is at work in {folder}: wait for it, or name another --out"
    with lock_folder(folder, busy) as lock:
        settings = tuple(
            config_hash(preset(stage, plan.preset, robot=plan.robot))
            for stage in STAGES
        )
        claim_folder(
            folder,
            RECIPE,
            _Recipe(plan.preset, plan.steps, settings, plan.robot),
            "a study",
        )
        tasks = _read_tasks(plan, folder)
        place = (
            Here(resources.gpus, lock)
            if resources.jobs.executor == "here"
            else Jobs(resources.jobs, folder, resources.say)
        )
        try:
            return asyncio.run(
                _run_chains(plan, folder, place, resources, measured, tasks)
            )
        except BaseExceptionGroup as group:  # one that failed has stopped the others
            raise group.exceptions[0] from group


def _read_tasks(plan: Plan, folder: Path) -> dict[str, TaskSources]:
    """Return the tasks of a study by their variants' names; raise `UserError` for one
    that has changed since the study began."""
    tasks = {
        name: read_task(task)
        for name in plan.variants
        if (task := variant_named(name).task)
    }
    for name, task in tasks.items():
        claim_folder(
            folder,
            f"{label(name)}.task.json",
            TaskConfig(task.main, task.sha256),
            f"runs of {name}",
        )
    return tasks


async def _run_chains(
    plan: Plan,
    folder: Path,
    place: Here | Jobs,
    resources: Resources,
    measured: Callable[[Training], object],
    tasks: Mapping[str, TaskSources],
) -> list[Training]:
    """Run each chain of trainings in a slot of its own, and measure what ends."""
    failed: list[Training] = []
    slots: asyncio.Queue[str | None] = asyncio.Queue()
    for slot in place.slots:
        slots.put_nowait(slot)
    with spawned(resources.judges, compute_here) as measuring:

        async def measure(training: Training) -> None:
            await asyncio.get_running_loop().run_in_executor(
                measuring,
                measure_policies,
                folder / training.name,
                tasks.get(training.variant),
            )
            measured(training)

        async def run_chain(chain: Sequence[Training]) -> None:
            slot = await slots.get()
            for place_in_chain, training in enumerate(chain):
                task = tasks.get(training.variant)
                if await _train(
                    plan, folder, place, slot, training, resources.say, task
                ):
                    group.create_task(measure(training))
                elif training.stage == "imitation":  # the others go on from it
                    failed.extend(chain[place_in_chain:])
                    break
                else:
                    failed.append(training)
            slots.put_nowait(slot)

        # an interruption inside a task has ended the loop already, and is raised there
        with contextlib.suppress(KeyboardInterrupt):
            async with asyncio.TaskGroup() as group:
                for chain in plan.chains:
                    group.create_task(run_chain(chain))
    return failed


async def _train(
    plan: Plan,
    folder: Path,
    place: Here | Jobs,
    slot: str | None,
    training: Training,
    say: Callable[[str], None],
    task: TaskSources | None = None,
) -> bool:
    """Run a training unless it is finished; return whether it has finished."""
    run_dir = folder / training.name
    ended = is_finished(run_dir)
    if not ended:
        try:
            command = plan.command(training, folder)
            ended = await place.train(command, run_dir, slot, task)
        except UserError as busy:
            say(str(busy))
        except asyncio.CancelledError:
            say(f"{training.name} stopped: see {run_dir}.txt")
            raise
    say(
        f"{training.name} trained"
        if ended
        else f"{training.name} failed: see {run_dir}.txt"
    )
    return ended
