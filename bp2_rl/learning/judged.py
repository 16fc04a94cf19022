"""The choice of a run's own policy, by the judge's measurements.

    RUN/policies/<control steps>/    every policy that the run exported
    RUN/judged.json                  the judge's results, and the best policy's control steps

The run's own policy is the best that was judged, without a judge the newest.
"""

import dataclasses
from pathlib import Path

from bp2_rl.base.folders import find_folder, folder_names
from bp2_rl.base.serialization import ConfigError, load_config

POLICIES, JUDGED = "policies", "judged.json"


@dataclasses.dataclass(frozen=True)
class JudgeResult:
    """The judge's measurements of a policy."""

    # m/s, top speed in the first launch to the fastest command; 0 where the robot fell
    speed: float
    falls: int  # launches that ended in a fall
    launches: int
    # m/s, by which policies are ranked: mean top speed over all launches, a fall counted
    # as 0 and what is beyond the command taken off; after a fall in the first launch,
    # the mean under the slower command over the number of launches, 0 where none was
    # tried
    score: float
    fell_told: float = 0.0  # m/s, least command at which a robot fell; 0: none fell
    # m/s, held for 5 s in the first launch, or, where that fell, under the fastest of
    # the slower commands at which no robot falls; no more than the command
    held: float = 0.0
    told: float = 0.0  # m/s, the fastest command

    def __str__(self) -> str:
        """Return the result in words."""
        parts = (self.ran, self.fallen if self.falls else "")
        return ", ".join(part for part in parts if part)

    @property
    def ran(self) -> str:
        """Return the top speed under the fastest command, or else the speed held under
        a slower one, in words; empty where the robot always fell."""
        if self.speed or not self.falls:
            return f"{self.speed:.1f} m/s"
        return f"holds {self.held:.1f} m/s" if self.held else ""

    @property
    def fallen(self) -> str:
        """Return how many launches to the fastest command fell, and at which command,
        in words."""
        at_command = (
            f", the first at {self.fell_told:.1f} m/s" if self.fell_told else ""
        )
        return f"{self.falls} of {self.launches} launches fell{at_command}"

    def reaches(self, speed: float | None) -> bool:
        """Return whether the policy holds this speed, m/s, in the first launch."""
        return speed is not None and min(self.speed, self.held) >= speed


@dataclasses.dataclass(frozen=True)
class JudgedPolicy:
    """A judged policy, and the time at which its result was known."""

    control_steps: int
    seconds: float  # after the run began
    result: JudgeResult


@dataclasses.dataclass(frozen=True)
class Judged:
    """The content of judged.json."""

    began: float  # s since 1970: when the run's settings were written
    policies: tuple[JudgedPolicy, ...] = ()  # in the order of their results
    own: int | None = None  # control steps of the run's own policy; None: the newest


def read_judged(run_dir: Path) -> Judged:
    """Return the judge's results for a run's policies; none where there is no file.

    Raises:
        ConfigError: the file is damaged.
    """
    path = run_dir / JUDGED
    if not path.exists():
        return Judged(0.0)
    try:
        return load_config(Judged, path)
    except ConfigError as error:
        raise ConfigError(
            f"{error}; remove it, and a resumed run judges its policies again"
        ) from error


def best_policy(results: dict[int, JudgeResult], until: float | None) -> int | None:
    """Return the control steps of the best policy, the latest of equals; one that ends
    the run comes before others."""
    return max(
        results,
        key=lambda steps: (results[steps].reaches(until), results[steps].score, steps),
        default=None,
    )


def exported_steps(run_dir: Path) -> list[int]:
    """Return the control steps of a run's exported policies, in order."""
    folder = run_dir / POLICIES
    names = folder_names(folder) if folder.is_dir() else ()
    return sorted(int(name) for name in names if name.isdecimal())


def policy_folder(run_dir: Path, steps: int) -> Path:
    """Return the folder of the policy of control step `steps`."""
    return find_folder(run_dir / POLICIES / str(steps))


def own_policy(run_dir: Path) -> Path | None:
    """Return the folder of a run's own policy; None where it has exported none."""
    own = read_judged(run_dir).own
    if own is None:
        own = max(exported_steps(run_dir), default=None)
    return None if own is None else policy_folder(run_dir, own)


def results_of_judge(policy: Path) -> dict[str, object]:
    """Return what the card of the policy in this folder says under `judged`; empty
    where the policy is no run's, or was not judged."""
    if policy.parent.name != POLICIES:
        return {}
    for judged in read_judged(policy.parent.parent).policies:
        if str(judged.control_steps) == policy.name:
            steps = {"control_steps": judged.control_steps}
            return {"judged": steps | dataclasses.asdict(judged.result)}
    return {}
