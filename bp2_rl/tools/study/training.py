"""The trainings of a study: processes of their own, one on each GPU, or jobs of a
cluster (`places`).

A study is a folder of runs, VARIANT-SEED-STAGE. What is finished is not done again, so
that a study can be stopped and gone on with.
"""

import dataclasses
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path
from typing import Any

from bp2_rl.base.folders import lock_folder, make_folder
from bp2_rl.base.serialization import claim_folder, config_hash
from bp2_rl.learning.loop import is_finished
from bp2_rl.settings.presets import preset
from bp2_rl.settings.training import Preset
from bp2_rl.tools.study.measuring import measure_policies
from bp2_rl.tools.study.places import Place, Resources
from bp2_rl.tools.study.plan import STAGES, Plan, Training

RECIPE = "recipe.json"


@dataclasses.dataclass(frozen=True)
class _Recipe:
    """What all runs of a study have in common."""

    preset: Preset
    steps: tuple[int, int]
    # hashes of the stages' settings, by which a change of the defaults is seen
    settings: tuple[str, ...]
    robot: str


def run(
    plan: Plan,
    folder: Path,
    resources: Resources,
    measured: Callable[[Training], object] = lambda training: None,
) -> list[Training]:
    """Train and measure what is not there yet; return the trainings that failed, with
    those that needed them.

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


def _train(plan: Plan, folder: Path, place: Place, training: Training) -> bool:
    """Train a run, unless it is finished already; return whether it came to its end."""
    run_dir = folder / training.name
    return is_finished(run_dir) or place.train(plan.command(training, folder), run_dir)
