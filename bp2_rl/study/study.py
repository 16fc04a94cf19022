"""Trainings compared: variants of the recipe, several seeds each, every saved policy judged in C MuJoCo.

A study is a folder of runs, VARIANT-SEED-STAGE. Trainings are processes of their own, one on each GPU (or one after
the other on the processors); what is finished is not done again, so that a study can be stopped and gone on with.
"""

import concurrent.futures
import contextlib
import dataclasses
import datetime
import fcntl
import os
import queue
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float
from scipy import stats

from bp2_rl.config import config_hash, load_config, save_config
from bp2_rl.env.observations import LAYOUT
from bp2_rl.errors import UserError
from bp2_rl.evaluation.runs.metrics import RunMetrics, measure
from bp2_rl.evaluation.runs.rollout import Ramp, rollout_mujoco
from bp2_rl.learning.policy import Policy, load_policy
from bp2_rl.learning.stages import Preset, Stage, make_config
from bp2_rl.learning.train import POLICIES, control_steps, load_run_config
from bp2_rl.robot import specs
from bp2_rl.workers import spawned

STAGES: tuple[Stage, ...] = ("imitation", "relaxed")
RECIPE, JUDGED = "recipe.json", "judged.json"
GOAL = 10.74  # m/s; the paper's outdoor top speed
CRUISE = 10.0  # m/s, at which the cost of transport is measured
HOLD = 5.0  # s
LADDER = (1.0, 0.8, 0.6)  # commands at which the top speed is looked for, shares of the training's fastest
RESAMPLES = 10_000


@dataclasses.dataclass(frozen=True)
class Variant:
    """The recipe with one thing changed."""

    meaning: str
    flags: tuple[str, ...] = ()  # of train.py, in the imitation stage; the relaxed stage inherits what they set
    relaxed: tuple[str, ...] = ()  # further ones, in the relaxed stage
    imitation: str = ""  # the variant whose imitation runs it goes on from; empty: its own


VARIANTS: dict[str, Variant] = {
    "ours": Variant("collocation reference, our weights, episodes start on the reference"),
    "kinematic": Variant("the kinematic gait as reference", ("--reference", "kinematic")),
    "none": Variant("no reference: standing still", ("--reference", "none")),
    "standing": Variant("all episodes start at rest", ("--env.reset.standing-fraction", "1")),
    "paper": Variant("relaxed stage with Table S4's weights", relaxed=("--weights", "paper"), imitation="ours"),
}


@dataclasses.dataclass(frozen=True)
class Training:
    """One run of a study."""

    variant: str
    seed: int
    stage: Stage

    @property
    def name(self) -> str:
        """Its folder's name."""
        return f"{self.variant}-{self.seed}-{self.stage}"


@dataclasses.dataclass(frozen=True)
class Plan:
    """What a study consists of."""

    variants: tuple[str, ...]
    seeds: tuple[int, ...]
    preset: Preset
    steps: tuple[int, int]  # control steps of the imitation and of the relaxed stage

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        for name in self.variants:
            if name not in VARIANTS:
                raise UserError(f"no variant {name!r}; there are {', '.join(VARIANTS)}")
        for name, values in (("variant", self.variants), ("seed", self.seeds)):
            if not values or len(set(values)) < len(values):
                raise UserError(f"a study needs at least one {name}, and each once")
        if min(self.seeds) < 0:
            raise UserError(f"seeds must not be negative, got {min(self.seeds)}")
        if min(self.steps) < 1:
            raise UserError(f"steps must be positive, got {self.steps[0]} and {self.steps[1]}")

    @property
    def chains(self) -> list[list[Training]]:
        """Runs that need each other: an imitation run, and the relaxed ones that go on from it."""
        chains: dict[tuple[str, int], list[Training]] = {}
        for seed in self.seeds:
            for name in self.variants:
                origin = VARIANTS[name].imitation or name
                chain = chains.setdefault((origin, seed), [Training(origin, seed, "imitation")])
                chain.append(Training(name, seed, "relaxed"))
        return list(chains.values())

    def command(self, training: Training, folder: Path) -> list[str]:
        """The arguments of train.py."""
        variant, steps = VARIANTS[training.variant], self.steps[STAGES.index(training.stage)]
        words = ["--stage", training.stage, "--preset", self.preset, "--out", str(folder / training.name)]
        if training.stage == "imitation":
            words += variant.flags
        else:
            origin = Training(variant.imitation or training.variant, training.seed, "imitation")
            words += ["--from", str(folder / origin.name), *variant.relaxed]
        return [*words, "--run.seed", str(training.seed), "--run.steps", str(steps)]


def default_steps(preset: Preset) -> tuple[int, int]:
    """What the preset trains, control steps of the two stages."""
    imitation, relaxed = (make_config(stage, preset).run.steps for stage in STAGES)
    return imitation, relaxed


def visible_gpus() -> tuple[str, ...]:
    """NVIDIA's GPUs as CUDA_VISIBLE_DEVICES names them; empty where there are none."""
    named = os.environ.get("CUDA_VISIBLE_DEVICES")
    if named is not None:
        return tuple(filter(None, named.split(",")))
    if shutil.which("nvidia-smi") is None:
        return ()
    listed = subprocess.run(["nvidia-smi", "-L"], capture_output=True, text=True).stdout
    return tuple(map(str, range(sum(line.startswith("GPU") for line in listed.splitlines()))))


# --- Training ------------------------------------------------------------------------------------------------


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
    with _alone(folder):
        _claim(plan, folder)
        with (
            spawned(judges, _on_the_processor) as judging,
            concurrent.futures.ThreadPoolExecutor(len(gpus) or 1) as threads,
        ):
            verdicts: list[concurrent.futures.Future[list[Judgement]]] = []

            def trained(training: Training) -> None:
                say(f"{training.name} trained")
                verdicts.append(judging.submit(judge, folder / training.name))

            trainer = _Trainer(plan, folder, gpus, say, trained)
            try:
                for chain in [threads.submit(trainer.follow, chain) for chain in plan.chains]:
                    chain.result()
                for verdict in verdicts:
                    verdict.result()
            except BaseException:
                trainer.stop()
                threads.shutdown(wait=False, cancel_futures=True)
                raise
    return trainer.failed


class _Trainer:
    """Runs train.py, one process on each GPU at a time."""

    def __init__(
        self,
        plan: Plan,
        folder: Path,
        gpus: Sequence[str],
        say: Callable[[str], None],
        trained: Callable[[Training], None],
    ):
        self.failed: list[Training] = []
        self._plan, self._folder, self._say, self._trained = plan, folder, say, trained
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
        if any(run_dir.glob("checkpoints/[0-9]*")):
            arguments = ["--resume", str(run_dir)]
        elif run_dir.exists() and not (run_dir / POLICIES).exists():
            shutil.rmtree(run_dir)  # killed before its first checkpoint: nothing to go on from
        environment = os.environ | ({} if gpu is None else {"CUDA_VISIBLE_DEVICES": gpu})
        with run_dir.with_suffix(".txt").open("a") as log:
            log.write(f"{_now().isoformat()} {' '.join(arguments)}\n")
            log.flush()
            command = [sys.executable, "-m", "bp2_rl", "train", *arguments]
            process = subprocess.Popen(command, env=environment, stdout=log, stderr=subprocess.STDOUT)
        self._processes.add(process)
        try:
            return process.wait() == 0
        finally:
            self._processes.discard(process)


@contextlib.contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Make the folder, and keep other processes from working on it meanwhile."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / ".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UserError(f"another study is at work in {folder}: wait for it, or name another --out") from None
        yield


@dataclasses.dataclass(frozen=True)
class _Recipe:
    """What all runs of a study have in common."""

    preset: Preset
    steps: tuple[int, int]
    settings: tuple[str, ...]  # hashes of the stages' settings, by which a change of the defaults is seen


def _claim(plan: Plan, folder: Path) -> None:
    """What the folder holds already must have been trained by the same recipe."""
    settings = tuple(config_hash(make_config(stage, plan.preset)) for stage in STAGES)
    recipe, path = _Recipe(plan.preset, plan.steps, settings), folder / RECIPE
    if path.is_file():
        old = load_config(_Recipe, path)
        if (old.preset, old.steps) != (plan.preset, plan.steps):
            raise UserError(
                f"{folder} holds a study with --preset {old.preset} --steps {old.steps[0]} {old.steps[1]}: "
                "go on with these, or name another --out"
            )
        if old != recipe:
            raise UserError(f"{folder} holds a study of other default settings: name another --out")
    save_config(path, recipe)


def _is_finished(run_dir: Path) -> bool:
    """Whether a run's last policy is there."""
    if not (run_dir / "config.json").is_file():
        return False
    return (run_dir / POLICIES / str(control_steps(load_run_config(run_dir)))).is_dir()


def _now() -> datetime.datetime:
    return datetime.datetime.now(datetime.UTC)


# --- Judging -------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Judgement:
    """What one saved policy does in C MuJoCo, from a standing start."""

    control_steps: int  # of all its training, the stages before included
    weights_sha256: str  # of the policy
    wall_time: float | None  # s, from the start of the stage's process, compilation included; None if it was resumed
    top_speed: float  # m/s, best 1-s mean of the runs under LADDER that held for HOLD without a fall; 0 if none did
    falls: int  # of these runs
    cruise_speed: float  # m/s, mean under the command that should make it CRUISE; 0 unless held
    cruise_cost: float | None  # electrical cost of transport there; None unless held within 10 % of CRUISE


@dataclasses.dataclass(frozen=True)
class _Judged:
    """The file beside a run's policies."""

    ladder: tuple[float, ...]
    policies: tuple[Judgement, ...]


def judge(run_dir: Path) -> list[Judgement]:
    """Judge each saved policy of a run, in order, and write `JUDGED` beside them; what is there is not done again."""
    known = {j.weights_sha256: j for j in judgements(run_dir)}
    began = _began(run_dir)
    result = []
    for folder in sorted((run_dir / POLICIES).iterdir(), key=lambda folder: int(folder.name)):
        policy = load_policy(folder, expected_layout=LAYOUT)
        judgement = known.get(policy.card.weights_sha256)
        if judgement is None:
            made = datetime.datetime.fromisoformat(policy.card.created)
            judgement = _judge(policy, None if began is None else (made - began).total_seconds())
            jax.clear_caches()  # each policy is a program of its own
        result.append(judgement)
    save_config(run_dir / JUDGED, _Judged(LADDER, tuple(result)))
    return result


def judgements(run_dir: Path) -> list[Judgement]:
    """What `judge` has written, if it has."""
    path = run_dir / JUDGED
    if not path.is_file():
        return []
    judged = load_config(_Judged, path)
    return list(judged.policies) if judged.ladder == LADDER else []


def _judge(policy: Policy, wall_time: float | None) -> Judgement:
    top = policy.card.env.commands.max_forward

    def held(speed: float) -> RunMetrics:
        ramp = Ramp((min(speed, top), 0.0, 0.0), hold=HOLD)
        return measure(rollout_mujoco(policy, ramp, policy.card.env))

    best, falls = 0.0, 0
    for share in LADDER:
        if best >= share * top:
            break  # told so little it will not be faster
        attempt = held(share * top)
        falls += attempt.fell_at is not None
        if attempt.fell_at is None:
            best = max(best, attempt.best_speed or 0.0)
    cruise = held(CRUISE)
    if cruise.fell_at is None and cruise.mean_speed > 0.5 * CRUISE:
        cruise = held(CRUISE**2 / cruise.mean_speed)  # it runs slower than it is told, or faster
    cruising = cruise.fell_at is None and abs(cruise.mean_speed - CRUISE) <= 0.1 * CRUISE
    return Judgement(
        control_steps=policy.card.physics_steps // specs.SUBSTEPS,
        weights_sha256=policy.card.weights_sha256,
        wall_time=wall_time,
        top_speed=best,
        falls=falls,
        cruise_speed=cruise.mean_speed if cruise.fell_at is None else 0.0,
        cruise_cost=cruise.electrical_cost_of_transport if cruising else None,
    )


def _began(run_dir: Path) -> datetime.datetime | None:
    """When the process began that trained a run; None if there were several."""
    output = run_dir.with_suffix(".txt")
    starts = [line for line in output.read_text().splitlines() if " --out " in line or " --resume " in line]
    return datetime.datetime.fromisoformat(starts[0].split()[0]) if len(starts) == 1 else None


def _on_the_processor() -> None:
    """Leave the GPUs to the trainings."""
    jax.config.update("jax_platforms", "cpu")


# --- What came out -------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Outcome:
    """A variant over its seeds."""

    variant: str
    seeds: tuple[int, ...]  # those that were trained and judged to the end
    top_speeds: tuple[float, ...]  # m/s, of the last policies, by seed
    imitation_top_speeds: tuple[float, ...]  # m/s, of the policies that the relaxed stage began with
    best_imitation_top_speeds: tuple[float, ...]  # m/s, of the fastest ones before it
    cruise_costs: tuple[float | None, ...]
    imitation_cruise_costs: tuple[float | None, ...]
    steps_to_goal: tuple[int | None, ...]  # control steps of the first saved policy that reaches GOAL
    seconds_to_goal: tuple[float | None, ...]  # s of wall time until it was saved
    top_speed: float  # m/s, interquartile mean over seeds
    top_speed_interval: tuple[float, float]  # m/s, bootstrap, 95 %


def outcome(folder: Path, variant: str, seeds: Sequence[int]) -> Outcome | None:
    """A variant's outcome, of those seeds of which both stages were judged; None if there is none."""
    stages = both_stages(folder, variant, seeds)
    if not stages:
        return None
    final = np.array([second[-1].top_speed for _, second in stages.values()])
    goals = [_goal(*both) for both in stages.values()]
    firsts = [first for first, _ in stages.values()]
    return Outcome(
        variant=variant,
        seeds=tuple(stages),
        top_speeds=tuple(final.tolist()),
        imitation_top_speeds=tuple(first[-1].top_speed for first in firsts),
        best_imitation_top_speeds=tuple(max(j.top_speed for j in first) for first in firsts),
        cruise_costs=tuple(second[-1].cruise_cost for _, second in stages.values()),
        imitation_cruise_costs=tuple(first[-1].cruise_cost for first in firsts),
        steps_to_goal=tuple(steps for steps, _ in goals),
        seconds_to_goal=tuple(seconds for _, seconds in goals),
        top_speed=float(interquartile_mean(final)),
        top_speed_interval=bootstrap_interval(final),
    )


def both_stages(folder: Path, variant: str, seeds: Sequence[int]) -> dict[int, tuple[list[Judgement], list[Judgement]]]:
    """The judgements of a variant's imitation and relaxed runs by seed, where there are both."""
    origin = VARIANTS[variant].imitation or variant
    stages = {
        seed: (
            judgements(folder / Training(origin, seed, "imitation").name),
            judgements(folder / Training(variant, seed, "relaxed").name),
        )
        for seed in seeds
    }
    return {seed: both for seed, both in stages.items() if all(both)}


def _goal(first: list[Judgement], second: list[Judgement]) -> tuple[int | None, float | None]:
    """(control steps, wall time) of the first policy of a run and its sequel that reaches GOAL."""
    whole = first[-1].wall_time
    for judgement, before in [(j, 0.0) for j in first] + [(j, whole) for j in second]:
        if judgement.top_speed >= GOAL:
            here = judgement.wall_time
            return judgement.control_steps, None if here is None or before is None else before + here
    return None, None


def interquartile_mean(values: Float[np.ndarray, "n ..."]) -> Float[Any, "..."]:
    """Mean of the middle half along the first axis; with fewer than four values, of all."""
    return stats.trim_mean(values, 0.25, axis=0)


def bootstrap_interval(values: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """95 % percentile bootstrap interval of the interquartile mean (Agarwal et al. 2021)."""
    draws = np.random.default_rng(0).choice(values, (len(values), RESAMPLES))
    low, high = np.percentile(interquartile_mean(draws), [2.5, 97.5])
    return float(low), float(high)


def table(outcomes: Sequence[Outcome]) -> str:
    """The outcomes in Markdown."""
    head = (
        "variant", "seeds", "top speed [m/s]", "95 %", "by seed", "after imitation", "best of imitation",
        "cost at 10 m/s", "after imitation", f"M steps to {GOAL} m/s", f"s to {GOAL} m/s",
    )  # fmt: skip
    lines = [head, ("---", *("---:",) * (len(head) - 1))]
    for o in outcomes:
        low, high = o.top_speed_interval
        lines.append(
            (
                o.variant,
                ", ".join(map(str, o.seeds)),
                f"{o.top_speed:.2f}",
                f"{low:.2f}-{high:.2f}",
                _each(o.top_speeds, "{:.2f}"),
                _each(o.imitation_top_speeds, "{:.2f}"),
                _each(o.best_imitation_top_speeds, "{:.2f}"),
                _each(o.cruise_costs, "{:.2f}"),
                _each(o.imitation_cruise_costs, "{:.2f}"),
                _each([None if s is None else s / 1e6 for s in o.steps_to_goal], "{:.0f}"),
                _each(o.seconds_to_goal, "{:.0f}"),
            )
        )
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _each(values: Sequence[float | None], form: str) -> str:
    return ", ".join("-" if value is None else form.format(value) for value in values)
