"""The policies in a run's folder: exported on the way and judged beside the training;
the best is the run's own.

What a policy is, and how one is written and read, is in `policy`."""

import dataclasses
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from bp2_rl.base.errors import one_line
from bp2_rl.base.folders import find_folder, folder_names
from bp2_rl.learning.monitor import Monitor, count, run_began
from bp2_rl.learning.policy import Policy, PolicyError, load_policy, save_policy
from bp2_rl.learning.writers import read_metrics
from bp2_rl.settings.training import CONFIG

POLICY, POLICIES = "policy", "policies"
"""A run's own policy: the best that was judged, without a judge the newest; and the
folder of all that it exported, each by its number of control steps."""
PAUSE = 0.05  # s between two looks at what is being judged


@dataclasses.dataclass(frozen=True)
class JudgeResult:
    """What the judge measured of a policy."""

    speed: float  # m/s, top speed in the launch that counts; 0 where the robot fell
    falls: int  # launches that ended in a fall
    launches: int
    # m/s, mean top speed over all launches, a fall counted as 0 and what is beyond the
    # command taken off,
    mean: float
    # and 0 after a fall in the first: the better policy has more
    fell_told: float = 0.0  # m/s, least command at which a robot fell; 0: none fell
    fell_after: float = 0.0  # m/s, best second of that launch before the fall

    def __str__(self) -> str:
        """Return the result in words."""
        speed = [f"{self.speed:.1f} m/s"] if self.speed or not self.falls else []
        return ", ".join(speed + ([self.fallen] if self.falls else []))

    @property
    def fallen(self) -> str:
        """Return how many launches fell, at which command, and what the robot had run
        before, in words."""
        told = f", first told {self.fell_told:.1f} m/s after a second at {self.fell_after:.1f} m/s"
        return f"{self.falls} of {self.launches} launches fell{told if self.fell_told else ''}"


@runtime_checkable
class Judge(Protocol):
    """Measures exported policies in other processes, while the training goes on."""

    places: int  # policies that are measured at a time

    def submit(self, policy: Path) -> Future[JudgeResult]:
        """Queue the policy in this folder behind those submitted before; return at
        once."""
        ...


class ExportedPolicies:
    """Exports a run's policies and submits them to the judge; the policy with the best
    result is the run's own.

    Without a judge, and where the judge fails, the run's own policy is the newest one.
    Training depends on nothing in here but `reached`.

    Args:
        run_dir: the run's folder.
        monitor: shows and logs the results.
        judge: measures the policies, if the run has a judge.
        until: the speed, m/s, that ends the run when a policy reaches and holds it.
        kept: the control steps that the run has made; policies and results up to them
            may be there already.
    """

    def __init__(
        self,
        run_dir: Path,
        monitor: Monitor,
        judge: Judge | None,
        until: float | None,
        kept: int,
    ):
        self._run_dir, self._monitor, self._judge, self._until = (
            run_dir,
            monitor,
            judge,
            until,
        )
        self._pending: dict[int, Future[JudgeResult]] = {}
        self._newest = 0
        self._results = judge_results(run_dir, kept)
        if judge is None:
            return
        there = run_dir / POLICIES
        steps = sorted(
            int(name)
            for name in (folder_names(there) if there.is_dir() else ())
            if name.isdecimal()
        )
        for step in steps:
            if 0 < step <= kept:
                self._newest = step
                if step not in self._results:
                    self._submit(step)
        if self._results:
            self._show(max(self._results))
            self._choose_best()

    @property
    def idle(self) -> bool:
        """Whether the judge could begin to measure another policy at once."""
        return self._judge is not None and len(self._pending) < self._judge.places

    @property
    def reached(self) -> bool:
        """Whether a policy has reached the speed that ends the run."""
        return reaches(self._results, self._until)

    def export(self, policy: Policy, steps: int, *, newest: bool = True) -> None:
        """Write the policy after so many control steps, and submit it to the judge.

        Raises:
            PolicyError: see `save_policy`.
        """
        if newest:
            self._newest = steps
            if self._judge is None or not self._results:
                save_policy(self._run_dir / POLICY, policy)
        save_policy(self._run_dir / POLICIES / str(steps), policy)
        self._submit(steps)

    def collect(self) -> None:
        """Take in the results that are there."""
        for steps, pending in list(self._pending.items()):
            try:
                result = pending.result() if pending.done() else None
            except Exception as error:
                self._go_on_without_judge(error)
                return
            if result is not None:
                del self._pending[steps]
                self._add_result(steps, result)

    def wait(self, enough: Callable[[], bool]) -> None:
        """Wait until the last result is there, `enough` says so, or a policy has
        reached the run's speed."""
        if self._pending and not self.reached and not enough():
            self._monitor.note(
                f"waiting for the judge: {len(self._pending)} of the policies are left"
            )
        while self._pending and not self.reached and not enough():
            time.sleep(PAUSE)
            self.collect()

    def _submit(self, steps: int) -> None:
        if self._judge is not None:
            try:
                self._pending[steps] = self._judge.submit(self._place(steps))
            except Exception as error:
                self._go_on_without_judge(error)

    def _add_result(self, steps: int, result: JudgeResult) -> None:
        seconds = time.time() - run_began(self._run_dir)
        best, late = self._best, self.reached
        self._results[steps] = result
        self._monitor.add(
            steps,
            {
                f"judged/{name}": value
                for name, value in dataclasses.asdict(result).items()
            },
        )
        self._monitor.record(f"judged the policy of {steps:,} control steps: {result}")
        self._show(steps)
        if self._best != best:
            self._choose_best()
        if self.reached and not late:
            when = f"after {steps:,} control steps, known {seconds:.1f} s after the run began"
            self._monitor.note(f"reached {self._until:g} m/s: {result} {when}")

    @property
    def _best(self) -> int | None:
        """Return the control steps of the best policy that was judged."""
        return best_policy(self._results, self._until)

    def _choose_best(self) -> None:
        """Make the best policy the run's own, and write its result on the card."""
        best = self._best
        if best is not None:
            judged = {"control_steps": best, **dataclasses.asdict(self._results[best])}
            self._choose(best, {"judged": judged})

    def _choose(self, steps: int, results: dict[str, Any]) -> None:
        """Make the policy of these control steps the run's own, with further results on
        its card."""
        try:
            policy = load_policy(self._place(steps))
        except PolicyError as error:
            (self._run_dir / CONFIG).stat()  # an OSError where the run is gone
            self._monitor.note(f"warning: the run's own policy stays as it is: {error}")
            return
        card = dataclasses.replace(
            policy.card, results={**policy.card.results, **results}
        )
        save_policy(self._run_dir / POLICY, dataclasses.replace(policy, card=card))

    def _place(self, steps: int) -> Path:
        return find_folder(self._run_dir / POLICIES / str(steps))

    def _show(self, last: int) -> None:
        best = self._best
        if best is not None:
            words = f"judged: {self._results[last]} at {count(last)}"
            self._monitor.show(
                words
                + (
                    f"; best {self._results[best]} at {count(best)}"
                    if best != last
                    else ""
                )
            )

    def _go_on_without_judge(self, error: Exception) -> None:
        """Go on without the judge, as if there had been none: the newest policy becomes
        the run's own."""
        self._judge, self._pending = None, {}
        if self._newest:
            self._choose(self._newest, {})
        why = one_line(str(error)) or type(error).__name__
        self._monitor.note(
            f"warning: no policy is judged any more, the newest is the run's own: {why}"
        )


def judge_results(run_dir: Path, kept: int) -> dict[int, JudgeResult]:
    """Return the judge's results in a run's metrics, by the policies' control steps, up
    to `kept` of them."""
    return {
        record["step"]: result
        for record, result in read_judge_results(run_dir)
        if record["step"] <= kept
    }


def read_judge_results(run_dir: Path) -> Iterator[tuple[dict[str, Any], JudgeResult]]:
    """Yield the lines of a run's metrics that hold a judge's result, each with that
    result, in the order written."""
    for record in read_metrics(run_dir):
        try:
            speed, falls, *others = (
                float(record[f"judged/{field.name}"])
                for field in dataclasses.fields(JudgeResult)
            )
            result = JudgeResult(speed, int(falls), int(others[0]), *others[1:])
        except (KeyError, TypeError, ValueError, OverflowError):
            continue  # a line of other metrics
        yield record, result


def best_policy(results: dict[int, JudgeResult], until: float | None) -> int | None:
    """Return the control steps of the best policy, the latest of equals; one that ends
    the run comes before others."""
    return max(
        results,
        key=lambda k: (reaches({k: results[k]}, until), results[k].mean, k),
        default=None,
    )


def reaches(results: dict[int, JudgeResult], until: float | None) -> bool:
    """Return whether one of these policies reaches that speed, m/s, and holds it."""
    return until is not None and any(
        result.speed >= until for result in results.values()
    )
