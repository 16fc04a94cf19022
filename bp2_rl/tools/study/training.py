"""The trainings of a study: processes of their own, one on each GPU, or jobs of a cluster (`places`).

A study is a folder of runs, VARIANT-SEED-STAGE. What is finished is not done again, so that a study can be stopped and
gone on with.
"""

import concurrent.futures
import dataclasses
import os
import queue
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax

from bp2_rl.base.folders import lock_folder, make_folder
from bp2_rl.base.serialization import claim_folder, config_hash
from bp2_rl.base.workers import spawned
from bp2_rl.learning.loop import is_finished
from bp2_rl.robot.specs import RobotName
from bp2_rl.settings.jobs import JobsConfig
from bp2_rl.settings.training import Preset, make_config
from bp2_rl.tools.study.measuring import measure_policies
from bp2_rl.tools.study.places import Here, Jobs, Place
from bp2_rl.tools.study.plan import STAGES, Plan, Training

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


def run(
    plan: Plan,
    folder: Path,
    *,
    gpus: Sequence[str],
    judges: int,
    say: Callable[[str], None],
    jobs: JobsConfig = JobsConfig(),  # noqa: B008  # it is frozen
    judged: Callable[[Training], object] = lambda training: None,
) -> list[Training]:
    """Train and judge what is not there yet; returns the trainings that failed, with those that needed them.

    An interruption ends the trainings, too, which save what they have.

    Args:
        plan: what to do.
        folder: of the study, made if need be.
        gpus: as CUDA_VISIBLE_DEVICES names them; none: one training at a time, on what JAX finds.
        judges: processes that judge policies.
        say: takes lines of progress.
        jobs: whether the trainings are jobs of a cluster; its machines then judge, too.
        judged: hears of each training whose policies have been judged, while others train.

    Raises:
        UserError: the folder holds a study of another recipe or size, or another process is at work on it.
    """
    make_folder(folder)
    busy = f"another study is at work in {folder}: wait for it, or name another --out"
    with lock_folder(folder, busy) as lock:
        _claim(plan, folder)
        place = Here(gpus, lock, say) if jobs.executor == "here" else Jobs(jobs, folder, say)
        with (
            spawned(judges, on_the_processor) as judging,
            concurrent.futures.ThreadPoolExecutor(place.slots) as threads,
        ):
            # Judges end with the thread that starts them, so this one does.
            news: queue.SimpleQueue[Training | concurrent.futures.Future[Any]] = queue.SimpleQueue()
            verdicts: dict[concurrent.futures.Future[Any], Training] = {}
            trainer = _Trainer(plan, folder, place, say, news.put)
            try:
                chains = [threads.submit(trainer.follow, chain) for chain in plan.chains]
                for chain in chains:
                    chain.add_done_callback(news.put)
                ends = len(chains)  # of chains and of judges, to come
                while ends:
                    one = news.get()
                    if isinstance(one, Training):
                        say(f"{one.name} trained")
                        verdict = judging.submit(measure_policies, folder / one.name)
                        verdicts[verdict] = one
                        verdict.add_done_callback(news.put)
                        ends += 1
                        continue
                    ends -= 1
                    one.result()
                    if one in verdicts:
                        judged(verdicts.pop(one))
            except BaseException:
                trainer.stop()
                threads.shutdown(wait=False, cancel_futures=True)
                raise
    return trainer.failed


class _Trainer:
    """Follows chains of trainings, each in a thread."""

    def __init__(
        self,
        plan: Plan,
        folder: Path,
        place: Place,
        say: Callable[[str], None],
        trained: Callable[[Training], None],
    ):
        self.failed: list[Training] = []
        self._plan, self._folder, self._place, self._say, self._trained = plan, folder, place, say, trained
        self._stopped = False

    def follow(self, chain: list[Training]) -> None:
        """Train a chain's runs one after the other."""
        for this in chain:
            if chain[0] in self.failed:  # all the others go on from it
                self.failed.append(this)
            elif is_finished(self._folder / this.name) or self._train(this):
                self._trained(this)
            else:
                outcome = "stopped" if self._stopped else "failed"
                self._say(f"{this.name} {outcome}: see {self._folder / this.name}.txt")
                self.failed.append(this)

    def stop(self) -> None:
        """Ask the running trainings to save and end, and begin no other."""
        self._stopped = True
        self._place.stop()

    def _train(self, training: Training) -> bool:
        return self._place.train(self._plan.command(training, self._folder), self._folder / training.name)


@dataclasses.dataclass(frozen=True)
class _Recipe:
    """What all runs of a study have in common."""

    preset: Preset
    steps: tuple[int, int]
    settings: tuple[str, ...]  # hashes of the stages' settings, by which a change of the defaults is seen
    robot: RobotName


def _claim(plan: Plan, folder: Path) -> None:
    """What the folder holds already must have been trained by the same recipe."""
    settings = tuple(config_hash(make_config(stage, plan.preset, robot=plan.robot)) for stage in STAGES)
    claim_folder(folder, RECIPE, _Recipe(plan.preset, plan.steps, settings, plan.robot), "a study")


def on_the_processor() -> None:
    """Leave the GPUs to the trainings."""
    jax.config.update("jax_platforms", "cpu")
