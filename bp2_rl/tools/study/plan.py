"""Plan a study: the variants of the training recipe, and the training runs that compare
them."""

import dataclasses
import re
from pathlib import Path

from bp2_rl.base.errors import UserError
from bp2_rl.settings import presets
from bp2_rl.settings.training import Preset, Stage

STAGES: tuple[Stage, ...] = ("imitation", "relaxed")


@dataclasses.dataclass(frozen=True)
class Variant:
    """A variant of the training recipe with one thing changed, as flags of train.py."""

    meaning: str
    # of train.py, in the imitation stage; the relaxed stage inherits what they set
    flags: tuple[str, ...] = ()
    relaxed: tuple[str, ...] = ()  # further ones, in the relaxed stage
    # the variant whose imitation runs it goes on from; empty: its own
    imitation: str = ""
    task: str = ""  # a user's, as `--task` takes it; empty: none


def _both(meaning: str, *flags: str) -> Variant:
    """Make a variant with flags for both stages: the relaxed stage does not inherit
    rewards, PPO settings or physics."""
    return Variant(meaning, flags, flags)


VARIANTS: dict[str, Variant] = {
    "ours": Variant("the recipe"),
    "kinematic": Variant(
        "the kinematic gait as reference", ("--reference", "kinematic")
    ),
    "none": Variant("no reference: standing still", ("--reference", "none")),
    "standing": Variant(
        "all episodes start at rest", ("--env.reset.standing-fraction", "1")
    ),
    "paper": Variant(
        "relaxed stage with Table S4's weights",
        relaxed=("--weights", "paper"),
        imitation="ours",
    ),
    "published": Variant(
        "kinematic gait, absolute actions, Table S4's weights",
        (
            "--reference",
            "kinematic",
            "--env.control.mode",
            "absolute",
            "--weights",
            "paper",
        ),
        ("--weights", "paper"),
    ),
    "plain_networks": Variant(
        "networks without left-right symmetry", ("--ppo.no-symmetric",)
    ),
    "no_averaging": _both(
        "the newest weights instead of their average", "--ppo.averaging", "0"
    ),
    "hopping": Variant(
        "a motion library whose slow trots hop", ("--env.library.path", "bp2_trot")
    ),
    "no_history": Variant("no history in the observation", ("--env.control.history",)),
    "paper_kernel": _both(
        "the paper's tracking kernel",
        "--env.reward.tracking-shape.floor",
        "1",
        "--env.reward.tracking-shape.width",
        "inf",
        "--env.reward.tracking-shape.tail",
        "0",
        "--env.reward.tracking-shape.yaw-width",
        "1",
        "--env.reward.tracking-shape.yaw-reach",
        "1",
        "--env.reward.tracking-shape.memory",
        "0",
    ),
    "unscheduled": _both(
        "rewards that do not depend on speed", "--env.reward.schedule", "off"
    ),
    "no_symmetry_reward": Variant(
        "no reward for symmetry",
        relaxed=("--env.reward.symmetry", "0"),
        imitation="ours",
    ),
    "no_randomization": Variant(
        "no randomisation", ("--env.randomization.no-enabled",)
    ),
    "stock_mjx": _both("MJX's own solver instead of the kernel", "--impl", "jax"),
}


def variant_named(name: str) -> Variant:
    """Return the variant of this name, or the recipe with a user's task, by its
    file."""
    if name in VARIANTS:
        return VARIANTS[name]
    return Variant(f"the task {name}", ("--task", name), task=name)


def label(variant: str) -> str:
    """Return a variant's name for files: a task's is its file's, and its own where the
    file has several."""
    return Path(re.sub(r"\.py(?=$|:)", "", variant)).name.replace(":", "-")


@dataclasses.dataclass(frozen=True)
class Training:
    """One training run of a study: variant, seed and stage."""

    variant: str
    seed: int
    stage: Stage

    @property
    def name(self) -> str:
        """The name of the run's folder."""
        return f"{label(self.variant)}-{self.seed}-{self.stage}"


@dataclasses.dataclass(frozen=True)
class Plan:
    """The variants, seeds and size of a study, which determine its training runs."""

    variants: tuple[str, ...]
    seeds: tuple[int, ...]
    preset: Preset
    steps: tuple[int, int]  # control steps of the imitation and of the relaxed stage
    robot: str = "built"

    def __post_init__(self) -> None:
        """Raise UserError for unknown variants, and for missing or repeated variants
        and seeds."""
        for name in self.variants:
            if name not in VARIANTS and not re.search(r"\.py$|:\w+$", name):
                raise UserError(
                    f"no variant {name!r}; there are {', '.join(VARIANTS)}, or a task's file, my_task.py"
                )
        labels = tuple(map(label, self.variants))
        for name, values in (("variant", labels), ("seed", self.seeds)):
            if not values or len(set(values)) < len(values):
                raise UserError(f"a study needs at least one {name}, and each once")

    @property
    def chains(self) -> list[list[Training]]:
        """Training runs in order of dependence: each imitation run, then the relaxed
        runs that continue it."""
        chains: dict[tuple[str, int], list[Training]] = {}
        for seed in self.seeds:
            for name in self.variants:
                origin = variant_named(name).imitation or name
                chain = chains.setdefault(
                    (origin, seed), [Training(origin, seed, "imitation")]
                )
                chain.append(Training(name, seed, "relaxed"))
        return list(chains.values())

    def command(self, training: Training, folder: Path) -> list[str]:
        """Return the arguments of train.py for a training run in the study's
        `folder`."""
        variant = variant_named(training.variant)
        words = [
            "--stage",
            training.stage,
            "--preset",
            self.preset,
            "--out",
            str(folder / training.name),
        ]
        if training.stage == "imitation":
            words += ["--robot", self.robot, *variant.flags]
        else:
            origin = Training(
                variant.imitation or training.variant, training.seed, "imitation"
            )
            words += ["--from", str(folder / origin.name), *variant.relaxed]
        # The study judges what is saved, in its own way.
        return [
            *words,
            "--run.judged",
            "0",
            "--run.seed",
            str(training.seed),
            "--run.steps",
            str(self.steps[STAGES.index(training.stage)]),
        ]


def default_steps(preset: Preset) -> tuple[int, int]:
    """Return the control steps of a preset's imitation and relaxed stages."""
    imitation, relaxed = (presets.preset(stage, preset).run.steps for stage in STAGES)
    return imitation, relaxed
