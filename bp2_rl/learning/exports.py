"""The policies that a run leaves: exported on the way, judged beside the training, the best as the run's own."""

import dataclasses
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from bp2_rl.base.files import BadFileError, parse_json
from bp2_rl.base.folders import find_folder, folder_names
from bp2_rl.learning.monitor import METRICS, Monitor, count
from bp2_rl.learning.policy import Policy, PolicyError, load_policy, save_policy
from bp2_rl.settings.training import CONFIG, began

POLICY, POLICIES = "policy", "policies"
"""A run's own policy: the best that was judged, without a judge the newest; and the folder of all that it exported,
each by its number of control steps."""
PAUSE = 0.05  # s between two looks at what is being judged


@dataclasses.dataclass(frozen=True)
class Verdict:
    """What a judge says of a policy."""

    speed: float  # m/s, that it reaches and holds; 0 where it fell
    falls: int  # of the launches
    launches: int
    mean: float  # m/s, over the launches, each that ended in a fall counted as 0: of two policies the better has more

    def __str__(self) -> str:
        """In words."""
        speed = [f"{self.speed:.1f} m/s"] if self.speed or not self.falls else []
        falls = [f"{self.falls} of {self.launches} launches fell"] if self.falls else []
        return ", ".join(speed + falls)


@runtime_checkable
class Hearing(Protocol):
    """A policy that is being judged."""

    def speed(self) -> float:
        """m/s, the verdict's, which may be known before the rest of it; 0 until then."""
        ...

    def done(self) -> bool:
        """Whether the verdict is there, or there will be none."""
        ...

    def result(self) -> Verdict:
        """The verdict; raises whatever kept the judge from it."""
        ...


@runtime_checkable
class Judge(Protocol):
    """Judges policies elsewhere, while the training goes on."""

    places: int  # policies that it judges at a time

    def submit(self, policy: Path) -> Hearing:
        """Judge the policy in this folder when those before it have their verdicts; returns at once."""
        ...


class Policies:
    """Exports a run's policies and has them judged; the one of the best verdict is the run's own.

    Without a judge, and where he fails, the newest one is. Nothing here feeds back into training but `reached`.

    Args:
        run_dir: the run's folder.
        monitor: to whom verdicts are told.
        judge: if there is one.
        until: the speed, m/s, that ends the run when a policy reaches and holds it.
        kept: the control steps that the run has made, of which verdicts and policies may be there.
    """

    def __init__(self, run_dir: Path, monitor: Monitor, judge: Judge | None, until: float | None, kept: int):
        self._run_dir, self._monitor, self._judge, self._until = run_dir, monitor, judge, until
        self._hearings: dict[int, Hearing] = {}
        self._newest = 0
        self._verdicts = verdicts_of(run_dir, kept)
        if judge is None:
            return
        there = run_dir / POLICIES
        steps = sorted(int(name) for name in (folder_names(there) if there.is_dir() else ()) if name.isdecimal())
        for step in steps:
            if 0 < step <= kept:
                self._newest = step
                if step not in self._verdicts:
                    self._submit(step)
        if self._verdicts:
            self._show(max(self._verdicts))
            self._put_best()

    @property
    def idle(self) -> bool:
        """Whether the judge could begin with another policy at once."""
        return self._judge is not None and len(self._hearings) < self._judge.places

    @property
    def reached(self) -> bool:
        """Whether a policy was as fast as the run is to become, though it may be judged yet."""
        heard = (hearing.speed() for hearing in self._hearings.values())
        return self._until is not None and (self._sure or any(speed >= self._until for speed in heard))

    def export(self, policy: Policy, steps: int, *, newest: bool = True) -> None:
        """Write the policy after so many control steps, and hand it to the judge.

        Raises:
            PolicyError: see `save_policy`.
        """
        if newest:
            self._newest = steps
            if self._judge is None or not self._verdicts:
                save_policy(self._run_dir / POLICY, policy)
        save_policy(self._run_dir / POLICIES / str(steps), policy)
        self._submit(steps)

    def collect(self) -> None:
        """Take in the verdicts that are there."""
        for steps, hearing in list(self._hearings.items()):
            if not hearing.done() or self._judge is None:
                continue
            del self._hearings[steps]
            try:
                verdict = hearing.result()
            except Exception as error:
                self._give_up(error)
            else:
                self._take(steps, verdict)

    def wait(self, enough: Callable[[], bool]) -> None:
        """Until the last verdict is there, or it is `enough`, or the run has reached what it was to."""
        if self._hearings and not self._sure and not enough():
            left = "the rest of a verdict" if self.reached else f"{len(self._hearings)} of the policies are left"
            self._monitor.note(f"waiting for the judge: {left}")
        while self._hearings and not self._sure and not enough():
            time.sleep(PAUSE)
            self.collect()

    def _submit(self, steps: int) -> None:
        if self._judge is not None:
            try:
                self._hearings[steps] = self._judge.submit(self._place(steps))
            except Exception as error:
                self._give_up(error)

    def _take(self, steps: int, verdict: Verdict) -> None:
        seconds = time.time() - began(self._run_dir)
        best, late = self._best, self._sure
        self._verdicts[steps] = verdict
        self._monitor.add(steps, {f"judged/{name}": value for name, value in dataclasses.asdict(verdict).items()})
        self._monitor.record(f"judged the policy of {steps:,} control steps: {verdict}")
        self._show(steps)
        if self._best != best:
            self._put_best()
        if self._sure and not late:
            when = f"after {steps:,} control steps, known {seconds:.1f} s after the run began"
            self._monitor.note(f"reached {self._until:g} m/s: {verdict} {when}")

    @property
    def _sure(self) -> bool:
        """Whether a verdict says that a policy was as fast as the run is to become."""
        return reaches(self._verdicts, self._until)

    @property
    def _best(self) -> int | None:
        """The control steps of the best policy that was judged, of equal ones the latest."""
        return max(self._verdicts, key=lambda steps: (self._verdicts[steps].mean, steps), default=None)

    def _put_best(self) -> None:
        """Make the best policy the run's own, with its verdict on the card."""
        best = self._best
        if best is not None:
            judged = {"control_steps": best, **dataclasses.asdict(self._verdicts[best])}
            self._put(best, {"judged": judged})

    def _put(self, steps: int, results: dict[str, Any]) -> None:
        """Make a policy the run's own."""
        try:
            policy = load_policy(self._place(steps))
        except PolicyError as error:
            (self._run_dir / CONFIG).stat()  # an OSError where the run is gone
            self._monitor.note(f"warning: the run's own policy stays as it is: {error}")
            return
        card = dataclasses.replace(policy.card, results={**policy.card.results, **results})
        save_policy(self._run_dir / POLICY, dataclasses.replace(policy, card=card))

    def _place(self, steps: int) -> Path:
        return find_folder(self._run_dir / POLICIES / str(steps))

    def _show(self, last: int) -> None:
        best = self._best
        if best is not None:
            words = f"judged: {self._verdicts[last]} at {count(last)}"
            self._monitor.show(words + (f"; best {self._verdicts[best]} at {count(best)}" if best != last else ""))

    def _give_up(self, error: Exception) -> None:
        """Go on without the judge, as if there had been none."""
        self._judge, self._hearings = None, {}
        if self._newest:
            self._put(self._newest, {})
        why = " ".join(str(error).split()) or type(error).__name__
        self._monitor.note(f"warning: no policy is judged any more, the newest is the run's own: {why}")


def verdicts_of(run_dir: Path, kept: int) -> dict[int, Verdict]:
    """The verdicts in a run's metrics, by the control steps of the policies, up to `kept` of them."""
    return {record["step"]: verdict for record, verdict in told_verdicts(run_dir) if record["step"] <= kept}


def told_verdicts(run_dir: Path) -> Iterator[tuple[dict[str, Any], Verdict]]:
    """The lines of a run's metrics that tell of a verdict, each with it, in the order in which they became known."""
    path = Path(run_dir) / METRICS
    for line in path.read_bytes().split(b"\n")[:-1] if path.is_file() else ():
        try:
            record = parse_json(line, METRICS)
            speed, falls, launches, mean = (record[f"judged/{field.name}"] for field in dataclasses.fields(Verdict))
            verdict = Verdict(float(speed), int(falls), int(launches), float(mean))
            record["step"] = int(record["step"])
        except (BadFileError, KeyError, TypeError, ValueError):
            continue  # a line of other metrics, or a damaged one
        yield record, verdict


def reaches(verdicts: dict[int, Verdict], until: float | None) -> bool:
    """Whether one of these policies reaches that speed, m/s, and holds it."""
    return until is not None and any(verdict.speed >= until for verdict in verdicts.values())
