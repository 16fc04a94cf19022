"""Run the trainings of a study: as processes of this machine, one on each GPU, or as
jobs of a cluster (submitit).

A study is a folder of runs, VARIANT-SEED-STAGE. What is finished is not done again, so
that a study can be stopped and gone on with.
"""

import contextlib
import dataclasses
import os
import queue
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    Executor,
    Future,
    ThreadPoolExecutor,
    wait,
)
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from bp2_rl.settings.training import Preset
from bp2_rl.simulation.parallel import compute_here
from bp2_rl.tools.study.outcome import measure_policies
from bp2_rl.tools.study.plan import STAGES, Plan, Training

if TYPE_CHECKING:
    import submitit
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

    @contextlib.contextmanager
    def open(
        self, folder: Path, lock: int
    ) -> Generator[tuple["Here | Jobs", Executor, ThreadPoolExecutor]]:
        """Yield what runs the trainings, the processes that measure policies, and a
        thread for each training at a time.

        An exception in the block stops the trainings, which save what they have. The
        processes end with the thread that submits their first task: let one that
        outlives the block submit.

        Args:
            folder: of the work.
            lock: descriptor of the folder's lock, which the trainings on this machine
                hold as well.
        """
        here = self.jobs.executor == "here"
        place = (
            Here(self.gpus, lock, self.say)
            if here
            else Jobs(self.jobs, folder, self.say)
        )
        with (
            spawned(self.judges, compute_here) as measuring,
            ThreadPoolExecutor(place.slots) as threads,
        ):
            try:
                yield place, measuring, threads
            except BaseException:
                place.stop()
                threads.shutdown(wait=False, cancel_futures=True)
                raise


def visible_gpus() -> tuple[str, ...]:
    """Return the names of NVIDIA's GPUs for CUDA_VISIBLE_DEVICES; empty without any."""
    named = os.environ.get("CUDA_VISIBLE_DEVICES")
    if named is not None:
        return tuple(filter(None, named.split(",")))
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
        say: takes lines of progress.
    """

    def __init__(self, gpus: Sequence[str], lock: int, say: Callable[[str], None]):
        self.slots = len(gpus) or 1
        self._lock, self._say = lock, say
        self._gpus: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        for gpu in gpus or (None,):
            self._gpus.put(gpu)
        self._processes: set[subprocess.Popen[bytes]] = set()
        self._stopped = threading.Event()

    def train(self, arguments: Sequence[str], run_dir: Path) -> bool:
        """Run a training to its end, from its checkpoint if it has one; return whether
        it finished.

        Waits for it; called from as many threads as there are slots.
        """
        if self._stopped.is_set():
            return False
        gpu = self._gpus.get()
        try:
            process = begin(arguments, run_dir, gpu=gpu, keep=(self._lock,))
        except UserError as busy:
            self._say(str(busy))
            self._gpus.put(gpu)
            return False
        self._processes.add(process)
        try:
            if self._stopped.is_set():  # since it was looked at above
                process.terminate()
            ended = process.wait() == 0
            if self._stopped.is_set() and not ended:
                self._say(f"{run_dir.name} stopped: see {run_dir}.txt")
            return ended
        finally:
            self._processes.discard(process)
            self._gpus.put(gpu)

    def stop(self) -> None:
        """Ask all trainings to save and end, and begin no other."""
        self._stopped.set()
        for process in list(self._processes):
            process.terminate()


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

        self.slots, self._say = config.most, say
        self._lock = threading.Lock()  # submitit is not made for threads
        self._jobs: set["submitit.Job[bool]"] = set()
        self._stopped = threading.Event()
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

    def train(self, arguments: Sequence[str], run_dir: Path) -> bool:
        """Run a training as a job, as `Here.train` does in a process; return whether it
        finished."""
        with self._lock:
            if self._stopped.is_set():
                return False
            job = self._executor.submit(Job(arguments, run_dir))
            self._jobs.add(job)
        self._say(f"{run_dir.name}: job {job.job_id}")
        while not self._stopped.wait(POLL):
            with self._lock:
                if not job.done():
                    continue
                self._jobs.discard(job)
                failure = job.exception()
                if failure is not None:
                    self._say(
                        f"{run_dir.name}: {' '.join(str(failure).split())[-300:]}"
                    )
                return failure is None and job.result()
        self._say(f"{run_dir.name} stopped: see {run_dir}.txt")
        return False

    def stop(self) -> None:
        """Cancel all jobs; Slurm then tells the trainings to save."""
        self._stopped.set()
        with self._lock:
            for job in self._jobs:
                job.cancel(check=False)


class Job:
    """One training as a job on a cluster's machine; submitit pickles it."""

    def __init__(self, arguments: Sequence[str], run_dir: Path):
        self._arguments, self._run_dir = tuple(arguments), run_dir.resolve()
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
        measure_policies(self._run_dir)
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
        with resources.open(folder, lock) as (place, measuring, threads):
            waiting, failed = plan.chains, []
            # at work -> what is left of its chain, itself included
            trainings: dict[Future[bool], list[Training]] = {}
            measurements: dict[Future[Any], Training] = {}
            while waiting or trainings or measurements:
                while waiting and len(trainings) < place.slots:
                    chain = waiting.pop(0)
                    trainings[threads.submit(_train, plan, folder, place, chain[0])] = (
                        chain
                    )
                for one in wait(
                    [*trainings, *measurements], return_when=FIRST_COMPLETED
                ).done:
                    if one in measurements:
                        one.result()
                        measured(measurements.pop(one))
                        continue
                    this, *later = trainings.pop(one)
                    if one.result():
                        resources.say(f"{this.name} trained")
                        measurements[
                            measuring.submit(measure_policies, folder / this.name)
                        ] = this
                    else:
                        resources.say(
                            f"{this.name} failed: see {folder / this.name}.txt"
                        )
                        failed.append(this)
                        # the others of its chain go on from it
                        if this.stage == "imitation":
                            failed, later = failed + later, []
                    if later:
                        waiting.insert(0, later)
    return failed


def _train(plan: Plan, folder: Path, place: Here | Jobs, training: Training) -> bool:
    """Run a training unless it is finished; return whether it has finished."""
    run_dir = folder / training.name
    return is_finished(run_dir) or place.train(plan.command(training, folder), run_dir)
