"""The trainings of a study: processes of their own, one on each GPU, or jobs of a cluster (`places`).

A study is a folder of runs, VARIANT-SEED-STAGE. What is finished is not done again, so that a study can be stopped and
gone on with.
"""

import concurrent.futures
import dataclasses
import queue
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bp2_rl.base.folders import lock_folder, make_folder
from bp2_rl.base.serialization import claim_folder, config_hash
from bp2_rl.learning.loop import is_finished
from bp2_rl.robot.specs import RobotName
from bp2_rl.settings.training import Preset, make_config
from bp2_rl.tools.study.measuring import measure_policies
from bp2_rl.tools.study.places import Place, Resources
from bp2_rl.tools.study.plan import STAGES, Plan, Training

RECIPE = "recipe.json"


def run(
    plan: Plan, folder: Path, resources: Resources, measured: Callable[[Training], object] = lambda training: None
) -> list[Training]:
    """Train and measure what is not there yet; return the trainings that failed, with those that needed them.

    An interruption ends the trainings, too, which save what they have.

    Args:
        plan: what to do.
        folder: of the study, made if need be.
        resources: what the trainings run on.
        measured: called with each training whose policies have been measured, while others train.

    Raises:
        UserError: the folder holds a study of another recipe or size, or another process is at work on it.
    """
    make_folder(folder)
    busy = f"another study is at work in {folder}: wait for it, or name another --out"
    with lock_folder(folder, busy) as lock:
        settings = tuple(config_hash(make_config(stage, plan.preset, robot=plan.robot)) for stage in STAGES)
        claim_folder(folder, RECIPE, _Recipe(plan.preset, plan.steps, settings, plan.robot), "a study")
        with resources.open(folder, lock) as (place, measuring, threads):
            news: queue.SimpleQueue[Training | concurrent.futures.Future[Any]] = queue.SimpleQueue()
            results: dict[concurrent.futures.Future[Any], Training] = {}
            trainer = _Trainer(plan, folder, place, resources.say, news.put)
            try:
                chains = [threads.submit(trainer.follow, chain) for chain in plan.chains]
                for chain in chains:
                    chain.add_done_callback(news.put)
                ends = len(chains)  # of chains and of measurements, to come
                while ends:
                    one = news.get()
                    if isinstance(one, Training):
                        resources.say(f"{one.name} trained")
                        result = measuring.submit(measure_policies, folder / one.name)
                        results[result] = one
                        result.add_done_callback(news.put)
                        ends += 1
                        continue
                    ends -= 1
                    one.result()
                    if one in results:
                        measured(results.pop(one))
            except BaseException:
                trainer.stopped = True
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
        self.stopped = False  # an interruption has ended the trainings

    def follow(self, chain: list[Training]) -> None:
        """Train a chain's runs one after the other."""
        for this in chain:
            if chain[0] in self.failed:  # all the others go on from it
                self.failed.append(this)
            elif is_finished(self._folder / this.name) or self._train(this):
                self._trained(this)
            else:
                outcome = "stopped" if self.stopped else "failed"
                self._say(f"{this.name} {outcome}: see {self._folder / this.name}.txt")
                self.failed.append(this)

    def _train(self, training: Training) -> bool:
        return self._place.train(self._plan.command(training, self._folder), self._folder / training.name)


@dataclasses.dataclass(frozen=True)
class _Recipe:
    """What all runs of a study have in common."""

    preset: Preset
    steps: tuple[int, int]
    settings: tuple[str, ...]  # hashes of the stages' settings, by which a change of the defaults is seen
    robot: RobotName
