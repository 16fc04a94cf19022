"""The trainings of a study: processes of their own, one on each GPU (or one after the other on the processors).

A study is a folder of runs, VARIANT-SEED-STAGE. What is finished is not done again, so that a study can be stopped and
gone on with.
"""

import concurrent.futures
import dataclasses
import datetime
import os
import queue
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

import jax

from bp2_rl import NPROC_IS_OURS
from bp2_rl.config import claim_folder, config_hash
from bp2_rl.errors import UserError
from bp2_rl.folders import find_folder, lock_folder, make_folder
from bp2_rl.learning.checkpoint import latest_step
from bp2_rl.learning.loop import control_steps
from bp2_rl.learning.policies import POLICIES
from bp2_rl.robot.specs import RobotName
from bp2_rl.settings.training import CONFIG, Preset, load_run_config, make_config
from bp2_rl.study.judging import Judgement, judge
from bp2_rl.study.plan import STAGES, Plan, Training
from bp2_rl.workers import PARENT, spawned

RECIPE = "recipe.json"


def visible_gpus() -> tuple[str, ...]:
    """NVIDIA's GPUs as CUDA_VISIBLE_DEVICES names them; empty where there are none."""
    named = os.environ.get("CUDA_VISIBLE_DEVICES")
    if named is not None:
        return tuple(filter(None, named.split(",")))
    if shutil.which("nvidia-smi") is None:
        return ()
    listed = subprocess.run(["nvidia-smi", "-L"], capture_output=True, text=True).stdout
    return tuple(map(str, range(sum(line.startswith("GPU") for line in listed.splitlines()))))


def run(plan: Plan, folder: Path, *, gpus: Sequence[str], judges: int, say: Callable[[str], None]) -> list[Training]:
    """Train and judge what is not there yet; returns the trainings that failed, with those that needed them.

    An interruption ends the trainings, too, which save what they have.

    Args:
        plan: what to do.
        folder: of the study, made if need be.
        gpus: as CUDA_VISIBLE_DEVICES names them; none: one training at a time, on what JAX finds.
        judges: processes that judge policies.
        say: takes lines of progress.

    Raises:
        UserError: the folder holds a study of another recipe or size, or another process is at work on it.
    """
    make_folder(folder)
    busy = f"another study is at work in {folder}: wait for it, or name another --out"
    with lock_folder(folder, busy) as lock:
        _claim(plan, folder)
        with (
            spawned(judges, _on_the_processor) as judging,
            concurrent.futures.ThreadPoolExecutor(len(gpus) or 1) as threads,
        ):
            # Judges end with the thread that starts them, so this one does.
            trained: queue.SimpleQueue[Training | None] = queue.SimpleQueue()
            verdicts: list[concurrent.futures.Future[list[Judgement]]] = []
            trainer = _Trainer(plan, folder, gpus, lock, say, trained.put)
            try:
                chains = [threads.submit(trainer.follow, chain) for chain in plan.chains]
                for chain in chains:
                    chain.add_done_callback(lambda _: trained.put(None))
                for _ in chains:
                    while (training := trained.get()) is not None:
                        say(f"{training.name} trained")
                        verdicts.append(judging.submit(judge, folder / training.name))
                    for chain in chains:
                        if chain.done():
                            chain.result()
                for verdict in verdicts:
                    verdict.result()
            except BaseException:
                trainer.stop()
                threads.shutdown(wait=False, cancel_futures=True)
                raise
    return trainer.failed


class _Trainer:
    """Runs train.py, one process on each GPU at a time.

    The processes end with this one, and save first; meanwhile they hold the folder's lock, a file descriptor.
    """

    def __init__(
        self,
        plan: Plan,
        folder: Path,
        gpus: Sequence[str],
        lock: int,
        say: Callable[[str], None],
        trained: Callable[[Training], None],
    ):
        self.failed: list[Training] = []
        self._plan, self._folder, self._lock, self._say, self._trained = plan, folder, lock, say, trained
        self._slots: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        for gpu in gpus or (None,):
            self._slots.put(gpu)
        self._processes: set[subprocess.Popen[bytes]] = set()
        self._stopped = threading.Event()

    def follow(self, chain: list[Training]) -> None:
        """Train a chain's runs one after the other."""
        slot = self._slots.get()
        try:
            for this in chain:
                if chain[0] in self.failed:  # all the others go on from it
                    self.failed.append(this)
                elif _is_finished(self._folder / this.name) or self._train(this, slot):
                    self._trained(this)
                else:
                    outcome = "stopped" if self._stopped.is_set() else "failed"
                    self._say(f"{this.name} {outcome}: see {self._folder / this.name}.txt")
                    self.failed.append(this)
        finally:
            self._slots.put(slot)

    def stop(self) -> None:
        """Ask the running trainings to save and end, and begin no other."""
        self._stopped.set()
        for process in list(self._processes):
            process.terminate()

    def _train(self, training: Training, gpu: str | None) -> bool:
        """Run train.py, anew or from where it was stopped, and wait; whether it came to its end."""
        if self._stopped.is_set():
            return False
        run_dir = self._folder / training.name
        arguments = self._plan.command(training, self._folder)
        if latest_step(run_dir) is not None:
            arguments = ["--resume", str(run_dir)]
        elif run_dir.exists() and not (run_dir / POLICIES).exists():
            try:
                with lock_folder(run_dir, f"{training.name}: another process trains it"):
                    shutil.rmtree(run_dir)  # killed before its first checkpoint: nothing to go on from
            except UserError as busy:
                self._say(str(busy))
                return False
        environment = os.environ | {PARENT: str(os.getpid())}
        if NPROC_IS_OURS:
            environment.pop("NPROC", None)  # it sets its own
        if gpu is not None:
            environment["CUDA_VISIBLE_DEVICES"] = gpu
        with run_dir.with_suffix(".txt").open("a") as log:
            log.write(f"{_now().isoformat()} {' '.join(arguments)}\n")
            log.flush()
            command = [sys.executable, "-m", "bp2_rl", "train", *arguments]
            process = subprocess.Popen(
                command, env=environment, stdout=log, stderr=subprocess.STDOUT, pass_fds=(self._lock,)
            )
        self._processes.add(process)
        try:
            if self._stopped.is_set():  # since it was looked at above
                process.terminate()
            return process.wait() == 0
        finally:
            self._processes.discard(process)


@dataclasses.dataclass(frozen=True)
class _Recipe:
    """What all runs of a study have in common."""

    preset: Preset
    steps: tuple[int, int]
    settings: tuple[str, ...]  # hashes of the stages' settings, by which a change of the defaults is seen
    robot: RobotName = "ideal"  # that of studies from before there were others


def _claim(plan: Plan, folder: Path) -> None:
    """What the folder holds already must have been trained by the same recipe."""
    settings = tuple(config_hash(make_config(stage, plan.preset, robot=plan.robot)) for stage in STAGES)
    claim_folder(folder, RECIPE, _Recipe(plan.preset, plan.steps, settings, plan.robot), "a study")


def _is_finished(run_dir: Path) -> bool:
    """Whether a run's last policy is there."""
    if not (run_dir / CONFIG).is_file():
        return False
    return find_folder(run_dir / POLICIES / str(control_steps(load_run_config(run_dir)))).is_dir()


def _now() -> datetime.datetime:
    return datetime.datetime.now(datetime.UTC)


def _on_the_processor() -> None:
    """Leave the GPUs to the trainings."""
    jax.config.update("jax_platforms", "cpu")
