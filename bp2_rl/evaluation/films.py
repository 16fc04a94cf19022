"""Film the policies that the judge measures beside a training, and write a page of the
films.

The judge keeps the last seconds of a policy's first launch. A process of its own films
them, one policy after the other, with the time that everybody else leaves: results
never wait for films, and neither does the training.
"""

import contextlib
import threading
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from bp2_rl.base.assets import render
from bp2_rl.base.errors import one_line
from bp2_rl.base.files import write_text
from bp2_rl.evaluation.judge import JudgeProcesses
from bp2_rl.learning.judged import JudgeResult, best_policy, read_judged
from bp2_rl.learning.monitor import count
from bp2_rl.simulation.film import POSTER, NoVideo, Shot, make_video

FILMS, PAGE = "films", "films.html"
"""Folder of the films in a run's folder, named by control steps, and the page that
shows them."""
SHOT = Shot(
    length=3.0, frame_rate=25, width=432, height=240, to_the_end=True, beside=True
)
RELOAD = 10  # s after which a page of a run that goes on looks for more


@contextlib.contextmanager
def filming(
    workers: JudgeProcesses,
    say: Callable[[str], None],
    gl_library: str | None = None,
    until: float | None = None,
) -> Generator["Filmed"]:
    """Yield a judge that also films the launches of policies; at the end films are
    waited for, unless the training is stopped.

    Args:
        workers: the judge's.
        say: to whom it is told, in one line, where no film can be made.
        gl_library: to film with, or else the first that works.
        until: the speed, m/s, that ends the run.
    """
    filmed = Filmed(workers, say, gl_library, until)
    finished = False
    try:
        yield filmed
        finished = True
    finally:
        filmed.close(wait=finished)


class Filmed:
    """A `learning.exports.Judge` that films each policy it measures; see `filming`."""

    def __init__(
        self,
        workers: JudgeProcesses,
        say: Callable[[str], None],
        gl_library: str | None,
        until: float | None,
    ):
        self.places = workers.places
        self._until = until
        self._workers = workers
        self._say = say
        self._gl_library = gl_library
        self._results: dict[int, JudgeResult] | None = None  # not yet looked for
        self._run_dir = Path()
        self._no_film = ""  # why there are none
        self._writing = threading.RLock()
        self._closed = False
        self._camera = ThreadPoolExecutor(1, thread_name_prefix="films")

    def submit(self, policy: Path, *, slower: bool) -> Future[JudgeResult]:
        """Queue the policy folder for the judge, and film its launch; return the
        judge's future result."""
        if self._results is None:
            self._run_dir = policy.parent.parent
            self._results = {
                one.control_steps: one.result
                for one in read_judged(self._run_dir).policies
            }
        if not policy.name.isdecimal():  # one that a killed process has set aside
            return self._workers.submit(policy, slower=slower)
        kept = None
        if not self._no_film:
            (self._run_dir / FILMS).mkdir(exist_ok=True)
            kept = self._run_dir / FILMS / f"{policy.name}.npz"
        shown: Future[JudgeResult] = Future()

        def show(judged: Future[JudgeResult]) -> None:
            try:
                result = judged.result()
                self._take(int(policy.name), kept, result)
                shown.set_result(result)
            except Exception as error:
                shown.set_exception(error)

        judged = self._workers.submit(policy, kept, SHOT.length, slower=slower)
        judged.add_done_callback(show)
        return shown

    def close(self, *, wait: bool) -> None:
        """Finish the remaining films (if `wait`) or drop them, and write the final
        page."""
        with self._writing:
            self._closed = True
        self._camera.shutdown(wait=True, cancel_futures=not wait)
        for kept in (
            (self._run_dir / FILMS).glob("*.npz") if self._results is not None else ()
        ):
            kept.unlink(missing_ok=True)
        self._show(goes_on=False)

    def _take(self, steps: int, kept: Path | None, result: JudgeResult) -> None:
        """Add a judge's result to the page, and queue the film of the launch."""
        with self._writing:
            # the training has ended without this result
            if self._closed or self._results is None:
                return
            self._results[steps] = result
            self._show(goes_on=True)
            if kept is not None:
                self._camera.submit(self._film, kept)

    def _film(self, kept: Path) -> None:
        """Film a saved launch in a thread; no failure here may stop a training."""
        try:
            if kept.is_file() and not self._no_film:
                make_video(kept, kept.with_suffix(".mp4"), self._gl_library, SHOT)
        except NoVideo as reason:
            self._give_up(str(reason))
        except Exception as error:
            self._give_up(
                f"no more films: {one_line(str(error)) or type(error).__name__}"
            )
        finally:
            with contextlib.suppress(OSError):
                kept.unlink(missing_ok=True)
        self._show(goes_on=True)

    def _give_up(self, reason: str) -> None:
        self._no_film = reason
        self._say(f"warning: {reason}")

    def _show(self, *, goes_on: bool) -> None:
        """Write the page of films, if a result of the judge is known."""
        with self._writing, contextlib.suppress(OSError):
            if self._results:
                best = best_policy(self._results, self._until)
                write_text(
                    self._run_dir / PAGE,
                    films_page(
                        self._run_dir, self._results, best, self._no_film, goes_on
                    ),
                )


def films_page(
    run_dir: Path,
    results: dict[int, JudgeResult],
    best: int | None,
    no_film: str,
    goes_on: bool,
) -> str:
    """Return the HTML page of a training run, with the films that exist.

    Args:
        run_dir: the run's folder.
        results: by the policies' control steps.
        best: the control steps of the run's own policy.
        no_film: why there are no more films, if there are not.
        goes_on: whether to look for more.
    """
    shown = dict(sorted(results.items()))
    return render(
        "evaluation/films.html",
        name=run_dir.resolve().name,
        results=shown,
        best=best,
        last=max(shown),
        most=max(1.0, *(one.speed or one.held for one in shown.values())),
        films={
            steps: f"{FILMS}/{steps}"
            for steps in shown
            if (run_dir / FILMS / f"{steps}.mp4").is_file()
        },
        no_film=no_film,
        goes_on=goes_on,
        count=count,
        seconds=SHOT.length,
        reload=RELOAD,
        POSTER=POSTER,
    )
