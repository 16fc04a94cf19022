"""The scaling study: robots' published and learned speeds beside the greatest speed
that their legs and motors allow.

For each legged robot of Table S1 whose legs and motors are published, and for each that
ships as a file, the greatest speed of its trot by the optimiser stands beside its
published speed and beside what policies learned. A speed above the optimiser's refutes
the model.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

from bp2_rl.base.assets import asset_path
from bp2_rl.base.bounds import Within
from bp2_rl.base.errors import UserError
from bp2_rl.base.metric import NOT_MEASURED, Table, show
from bp2_rl.base.serialization import load_config
from bp2_rl.paper.figures.scaling import shipped
from bp2_rl.paper.published import PublishedRobot, read_robots
from bp2_rl.paper.published_tables import ColumnHeading, read_table
from bp2_rl.paper.scaling.legs import read_legs, rigid_robot
from bp2_rl.paper.scaling.limits import Rules, SpeedLimit, find_limits
from bp2_rl.paper.scaling.variants import BP2, bp2_variants, leg_share
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.named import shipped_files
from bp2_rl.robot.robot_file import load_robot

LEARNED = "scaling/learned.csv"
CACHED = "scaling/limits.json"
SIMULATE = "bp2 paper scaling --simulate"


@dataclasses.dataclass(frozen=True)
class LearnedSpeed:
    """The top speed of a policy in C MuJoCo: the best mean of a ramp's holds of 6 s."""

    robot: str  # as in Table S1
    speed: Annotated[float, Within(0.0, 1e3), ColumnHeading("top speed [m/s]")]
    command: str  # that trained it


@dataclasses.dataclass(frozen=True)
class LimitSearch:
    """A search for greatest speeds: robots and BP2's variants by name, and the
    rules."""

    robots: dict[str, HardwareSpec]
    variants: dict[str, HardwareSpec]
    rules: Rules


@dataclasses.dataclass(frozen=True)
class SpeedLimits:
    """The speed limits that the optimiser found, by robot and variant; None where it
    found no trot."""

    command: str
    rules: Rules
    robots: dict[str, SpeedLimit | None]
    variants: dict[str, SpeedLimit | None]


@dataclasses.dataclass(frozen=True)
class LimitedRobot:
    """A robot's published and learned speeds, m/s, and its speed limit by the
    optimiser."""

    robot: str
    mass: float  # kg
    published: float
    learned: tuple[float, ...]  # one a policy
    limit: SpeedLimit
    links_published: bool

    @property
    def fastest(self) -> float:
        """Greatest published or learned speed of the robot, m/s."""
        return max(self.published, *self.learned, 0.0)

    @property
    def ratio(self) -> float:
        """Speed limit by the optimiser over the published speed."""
        return self.limit.speed / self.published


@dataclasses.dataclass(frozen=True)
class LimitedVariant:
    """A variant of BP2: its legs' share of mass and length, and its speed limit."""

    variant: str
    leg_share: float  # of the mass, in thighs and below
    leg_length: float  # m, hip to sole
    limit: SpeedLimit


@dataclasses.dataclass(frozen=True)
class ScalingStudy:
    """All results of the study: robots and BP2's variants with their speed limits."""

    # the least ratio of limit to published speed first
    robots: tuple[LimitedRobot, ...]
    variants: tuple[LimitedVariant, ...]
    not_found: tuple[str, ...]  # robots and variants without any trot
    # legged robots of Table S1 whose legs or motors are not published
    left_out: tuple[str, ...]


def find_robots() -> dict[str, HardwareSpec]:
    """Return the hardware of all robots whose speed limit is studied, by name in Table
    S1."""
    masses = {robot.robot: robot.mass for robot in read_robots()}
    files = {
        robot.name: robot.hardware
        for robot in map(load_robot, shipped_files().values())
    }
    return files | {
        legs.robot: rigid_robot(legs, masses[legs.robot]) for legs in read_legs()
    }


def find_variants() -> dict[str, HardwareSpec]:
    """Return the hardware of BP2 and its variants, by name."""
    return bp2_variants(
        {
            robot.name: robot.hardware
            for robot in map(load_robot, shipped_files().values())
        }
    )


def choose_robots(
    words: Sequence[str],
) -> tuple[dict[str, HardwareSpec], dict[str, HardwareSpec]]:
    """Return the robots, and the variants of BP2, whose names have one of these words;
    all of them without words.

    Raises:
        UserError: a word is in no name.
    """
    robots = find_robots()
    variants = find_variants()
    wanted = [word.replace("_", " ").casefold() for word in words]
    for word, shown in zip(wanted, words, strict=True):
        if not any(word in name.casefold() for name in (*robots, BP2)):
            raise UserError(
                f"--robots: no robot's name has {shown!r}; there are {', '.join((*robots, BP2))}"
            )
    if not words:
        return robots, variants
    chosen = {
        name: robot
        for name, robot in robots.items()
        if any(word in name.casefold() for word in wanted)
    }
    return chosen, variants if any(word in BP2.casefold() for word in wanted) else {}


def simulate(
    search: LimitSearch, workers: int, begun: SpeedLimits | None = None
) -> Iterator[SpeedLimits]:
    """Search for robots' speed limits, and yield all limits found yet after each new
    one.

    Args:
        search: whose limits are found.
        workers: processes.
        begun: what the same search found before it was interrupted.
    """
    kinds = {"robots": search.robots, "variants": search.variants}
    before = {
        kind: dict[str, SpeedLimit | None](getattr(begun, kind, {})) for kind in kinds
    }
    found = {
        kind: {name: before[kind].get(name) for name in robots}
        for kind, robots in kinds.items()
    }
    left = {
        (kind, name): robot
        for kind, robots in kinds.items()
        for name, robot in robots.items()
        if found[kind][name] is None
    }
    yield SpeedLimits(SIMULATE, search.rules, **found)
    for (kind, name), limit in find_limits(left, search.rules, workers):
        found[kind] = found[kind] | {name: limit}
        yield SpeedLimits(SIMULATE, search.rules, **found)


def read_limits(path: Path | None = None) -> SpeedLimits:
    """Read the speed limits in a file, by default the file that ships.

    Raises:
        UserError: it cannot be read.
    """
    return load_config(SpeedLimits, asset_path(CACHED) if path is None else path)


def compare_limits(
    limits: SpeedLimits,
    published: Sequence[PublishedRobot],
    learned: Sequence[LearnedSpeed],
) -> ScalingStudy:
    """Return the study: speed limits beside published and learned speeds."""
    table = {robot.robot: robot for robot in published}
    variants = find_variants()
    assumed = {legs.robot for legs in read_legs() if not legs.links_published}
    speeds = {
        name: tuple(one.speed for one in learned if one.robot == name) for name in table
    }
    bp2 = limits.variants.get(BP2)
    found = {name: limit for name, limit in limits.robots.items() if limit} | (
        {BP2: bp2} if bp2 else {}
    )
    robots = [
        LimitedRobot(
            name,
            table[name].mass,
            table[name].top_speed,
            speeds[name],
            limit,
            name not in assumed,
        )
        for name, limit in found.items()
    ]
    bodies = {name: robot.anatomy for name, robot in variants.items()}
    return ScalingStudy(
        robots=tuple(sorted(robots, key=lambda robot: robot.ratio)),
        variants=tuple(
            LimitedVariant(
                name, leg_share(bodies[name]), 2.0 * bodies[name].leg_length, limit
            )
            for name, limit in limits.variants.items()
            if limit
        ),
        not_found=tuple(
            name
            for name, limit in (limits.robots | limits.variants).items()
            if limit is None
        ),
        left_out=tuple(
            r.robot
            for r in published
            if not r.wheels and r.robot not in {*find_robots(), BP2}
        ),
    )


def read_learned() -> tuple[LearnedSpeed, ...]:
    """Return the speeds that policies learned: the table that ships, and BP2's policy
    by its card."""
    own = (
        LearnedSpeed(BP2, robot.top_speed, "the policy that ships")
        for robot in shipped()
    )
    return (*read_table(asset_path(LEARNED), LearnedSpeed), *own)


# --- What comes of it -----------------------------------------------------------------


def refutations(study: ScalingStudy) -> list[str]:
    """Return a line for each robot that runs faster than its speed limit, published
    speeds first."""
    lines = [
        f"{robot.robot} runs {speed:.2f} m/s ({kind}), and its limit is {robot.limit.speed:.2f} m/s: the model is wrong"
        for kind in ("published", "learned")
        for robot in study.robots
        if (
            speed := robot.published
            if kind == "published"
            else max(robot.learned, default=0.0)
        )
        > robot.limit.speed
    ]
    return lines or [
        f"no speed of {len(study.robots)} robots, published or learned, is above the optimiser's limit"
    ]


def tables(study: ScalingStudy) -> tuple[Table, ...]:
    """Return the tables of robots beside their speed limits, and of BP2's variants."""
    robots = [
        (
            robot.robot + ("" if robot.links_published else " *"),
            f"{robot.mass:g}",
            f"{robot.published:.2f}",
            show(max(robot.learned, default=None), ".2f"),
            f"{robot.limit.speed:.2f}",
            f"{robot.ratio:.2f}",
            f"{1.0 / robot.limit.period:.1f}",
            f"{robot.limit.duty:.2f}",
            _binding(robot.limit),
        )
        for robot in study.robots
    ]
    base = next((one.limit.speed for one in study.variants if one.variant == BP2), None)
    variants = [
        (
            one.variant,
            f"{one.leg_share:.2f}",
            f"{one.leg_length:.2f}",
            f"{one.limit.speed:.2f}",
            NOT_MEASURED if base is None else f"{one.limit.speed - base:+.2f}",
            _binding(one.limit),
        )
        for one in study.variants
    ]
    head = (
        "Robot",
        "kg",
        "published, m/s",
        "learned",
        "limit",
        "limit / published",
        "Hz",
        "duty",
        "% for 1 % more",
    )
    other = (
        "BP2",
        "legs' share of mass",
        "legs, m",
        "limit, m/s",
        "change",
        "% for 1 % more",
    )
    titles = (
        "Robots beside their limits; *: masses of the links ASSUMED",
        "BP2 and its variants, at equal motors",
    )
    return tuple(
        Table(title, names, lines, words=True)
        for title, names, lines in zip(
            titles, (head, other), (robots, variants), strict=True
        )
        if lines
    )


def _binding(limit: SpeedLimit) -> str:
    """Return a cell's text: the limits that matter, by gain, and the verifier's
    objections."""
    ranked = sorted(limit.gains.items(), key=lambda gain: -gain[1])
    said = ", ".join(f"{name} {gain:.2f}" for name, gain in ranked if gain >= 0.05)
    return "; ".join((said, *limit.unsound))
