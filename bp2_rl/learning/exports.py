"""Export a run's policies, and submit them to the judge during the training.

`policy` describes, writes and reads a policy; `judged` chooses the run's own."""

import dataclasses
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Protocol, runtime_checkable

from bp2_rl.base.errors import one_line
from bp2_rl.base.serialization import save_config
from bp2_rl.learning.judged import (
    JUDGED,
    POLICIES,
    Judged,
    JudgedPolicy,
    JudgeResult,
    best_policy,
    exported_steps,
    policy_folder,
    read_judged,
)
from bp2_rl.learning.monitor import Monitor, count
from bp2_rl.learning.policy import Policy, save_policy
from bp2_rl.settings.training import CONFIG

PAUSE = 0.05  # s, interval of polling the judge


@runtime_checkable
class Judge(Protocol):
    """Measures exported policies in other processes, while the training goes on."""

    places: int  # policies that are measured at a time

    def submit(self, policy: Path, *, slower: bool) -> Future[JudgeResult]:
        """Queue the policy in this folder behind those submitted before; return at
        once.

        If the robot falls under the fastest command, `slower` requests the speed that
        it holds.
        """
        ...


class ExportedPolicies:
    """Exports a run's policies, submits them to the judge, and keeps its results in
    judged.json.

    Training depends only on `reached`.

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
        self._run_dir, self._monitor = run_dir, monitor
        self._judge, self._until = judge, until
        self._pending: dict[int, Future[JudgeResult]] = {}
        before = read_judged(run_dir)
        self._began = before.began or (run_dir / CONFIG).stat().st_mtime
        self._judged = {
            policy.control_steps: policy
            for policy in before.policies
            if policy.control_steps <= kept
        }
        if judge is None:
            return
        for steps in exported_steps(run_dir):
            if 0 < steps <= kept and steps not in self._judged:
                self._submit(steps)
        if self._judged:
            self._show(max(self._judged))
            self._write(self._best)

    @property
    def idle(self) -> bool:
        """Return whether the judge could begin to measure another policy at once."""
        return self._judge is not None and len(self._pending) < self._judge.places

    @property
    def reached(self) -> bool:
        """Return whether a policy has reached the speed that ends the run."""
        return any(
            policy.result.reaches(self._until) for policy in self._judged.values()
        )

    def export(self, policy: Policy, steps: int) -> None:
        """Write the policy of control step `steps`, and submit it to the judge.

        Raises:
            PolicyError: see `save_policy`.
        """
        save_policy(self._run_dir / POLICIES / str(steps), policy)
        self._submit(steps)

    def collect(self) -> None:
        """Take in the judge's results that are ready, without waiting for others."""
        for steps, pending in list(self._pending.items()):
            try:
                result = pending.result() if pending.done() else None
            except Exception as error:
                self._continue_without_judge(error)
                return
            if result is not None:
                del self._pending[steps]
                self._add_result(steps, result)

    def wait(self, enough: Callable[[], bool]) -> None:
        """Wait until the judge's last result is there, `enough` says so, or a policy
        has reached the run's speed.

        Where all policies fell on the way to that speed, the newest make slower
        launches.
        """
        self._wait(enough)
        fell = all(
            policy.result.falls and not policy.result.speed
            for policy in self._judged.values()
        )
        late = self._until is not None and fell and not enough()
        if self._judge is not None and late:
            for steps in sorted(self._judged)[-self._judge.places :]:
                self._submit(steps, slower=True)
            self._wait(enough)

    def _wait(self, enough: Callable[[], bool]) -> None:
        if self._pending and not self.reached and not enough():
            self._monitor.note(
                f"waiting for the judge: {len(self._pending)} of the policies are left"
            )
        while self._pending and not self.reached and not enough():
            time.sleep(PAUSE)
            self.collect()

    def _submit(self, steps: int, *, slower: bool = False) -> None:
        """Submit a policy to the judge; in a run that ends at a speed without slower
        launches, which take longer than the fastest, unless they are asked for."""
        slower = slower or self._until is None
        if self._judge is not None:
            try:
                folder = policy_folder(self._run_dir, steps)
                self._pending[steps] = self._judge.submit(folder, slower=slower)
            except Exception as error:
                self._continue_without_judge(error)

    def _add_result(self, steps: int, result: JudgeResult) -> None:
        seconds = time.time() - self._began
        late = self.reached
        self._judged[steps] = JudgedPolicy(steps, seconds, result)
        self._write(self._best)
        metrics = {
            f"judged/{name}": value
            for name, value in dataclasses.asdict(result).items()
        }
        self._monitor.log(steps, metrics, late=True)
        self._monitor.record(f"judged the policy of {steps:,} control steps: {result}")
        self._show(steps)
        if self.reached and not late:
            when = f"after {steps:,} control steps, known {seconds:.1f} s after the run began"
            held = f"holds {result.held:.1f} m/s"
            self._monitor.note(f"reached {self._until:g} m/s: {held}, {result} {when}")

    @property
    def _best(self) -> int | None:
        """Return the control steps of the best policy that was judged."""
        results = {steps: one.result for steps, one in self._judged.items()}
        return best_policy(results, self._until)

    def _write(self, own: int | None) -> None:
        judged = Judged(self._began, tuple(self._judged.values()), own)
        save_config(self._run_dir / JUDGED, judged)

    def _show(self, last: int) -> None:
        words = f"judged: {self._judged[last].result} at {count(last)}"
        best = self._best
        if best is not None and best != last:
            words += f"; best {self._judged[best].result} at {count(best)}"
        self._monitor.show(words)

    def _continue_without_judge(self, error: Exception) -> None:
        """Continue without the judge: the newest policy becomes the run's own."""
        self._judge = None
        self._pending = {}
        self._write(None)
        why = one_line(str(error)) or type(error).__name__
        self._monitor.note(
            f"warning: no policy is judged any more, the newest is the run's own: {why}"
        )
