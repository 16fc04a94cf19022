"""A film of each policy that is judged beside a training, and a page that shows them as they come.

The judge keeps the last seconds of a policy's first launch. A process of its own films them, one policy after the
other, with the time that everybody else leaves: results never wait for films, and neither does the training.
"""

import contextlib
import html
import threading
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from bp2_rl.base.errors import one_line
from bp2_rl.base.files import write_text
from bp2_rl.evaluation.judge import JudgeProcesses, PendingLaunches
from bp2_rl.evaluation.report.page import document
from bp2_rl.learning.exports import JudgeResult, judge_results
from bp2_rl.learning.monitor import count
from bp2_rl.simulation.film import POSTER, NoVideo, Shot, make_video

FILMS, PAGE = "films", "films.html"
"""In a run's folder: the films, each by its policy's control steps, and the page that shows them."""
SHOT = Shot(length=3.0, frame_rate=25, width=432, height=240, to_the_end=True, beside=True)
RELOAD = 10  # s after which a page of a run that goes on looks for more
EVER = 10**18  # control steps


@contextlib.contextmanager
def filming(workers: JudgeProcesses, say: Callable[[str], None], gl_library: str | None = None) -> Generator["Filmed"]:
    """The judge who films, too. Films are waited for at the end, but not when the training is stopped.

    Args:
        workers: the judge's.
        say: to whom it is told, in one line, where no film can be made.
        gl_library: to film with, or else the first that works.
    """
    filmed, finished = Filmed(workers, say, gl_library), False
    try:
        yield filmed
        finished = True
    finally:
        filmed.close(wait=finished)


class Filmed:
    """A `learning.exports.Judge` whose results are followed by films; see `filming`."""

    def __init__(self, workers: JudgeProcesses, say: Callable[[str], None], gl_library: str | None):
        self.places = workers.places
        self._workers, self._say, self._gl_library = workers, say, gl_library
        self._results: dict[int, JudgeResult] | None = None  # not yet looked for
        self._run_dir = Path()
        self._no_film = ""  # why there are none
        self._writing = threading.Lock()
        self._camera = ThreadPoolExecutor(1, thread_name_prefix="films")

    def submit(self, policy: Path) -> "Filming":
        """See `Judge`; the folder's name is the policy's control steps, and it lies in the run's own."""
        if self._results is None:
            self._run_dir = policy.parent.parent
            self._results = judge_results(self._run_dir, EVER)
        if self._no_film or not policy.name.isdecimal():
            return Filming(self, policy, None, self._workers.submit(policy))
        (self._run_dir / FILMS).mkdir(exist_ok=True)
        kept = self._run_dir / FILMS / f"{policy.name}.npz"
        return Filming(self, policy, kept, self._workers.submit(policy, kept, SHOT.length))

    def take(self, policy: Path, kept: Path | None, result: JudgeResult) -> None:
        """Show a result, and film what was kept of the launch."""
        if self._results is not None and policy.name.isdecimal():
            self._results[int(policy.name)] = result
            self._show(goes_on=True)
        if kept is not None:
            self._camera.submit(self._film, kept)

    def close(self, *, wait: bool) -> None:
        """Film what is left, or leave it; the page's last form."""
        self._camera.shutdown(wait=True, cancel_futures=not wait)
        for kept in (self._run_dir / FILMS).glob("*.npz") if self._results is not None else ():
            kept.unlink(missing_ok=True)
        self._show(goes_on=False)

    def _film(self, kept: Path) -> None:
        """In the thread: films are a luxury, and whatever fails here must not stop a training."""
        try:
            if kept.is_file() and not self._no_film:
                make_video(kept, kept.with_suffix(".mp4"), self._gl_library, SHOT)
        except NoVideo as reason:
            self._give_up(str(reason))
        except Exception as error:
            self._give_up(f"no more films: {one_line(str(error)) or type(error).__name__}")
        finally:
            with contextlib.suppress(OSError):
                kept.unlink(missing_ok=True)
        self._show(goes_on=True)

    def _give_up(self, reason: str) -> None:
        self._no_film = reason
        self._say(f"warning: {reason}")

    def _show(self, *, goes_on: bool) -> None:
        """Write the page, if its run is there."""
        with self._writing, contextlib.suppress(OSError):
            if self._results:
                write_text(self._run_dir / PAGE, films_page(self._run_dir, self._results, self._no_film, goes_on))


class Filming:
    """A `learning.exports.PendingResult` that hands the result to `Filmed`, too."""

    def __init__(self, filmed: Filmed, policy: Path, kept: Path | None, launching: PendingLaunches):
        self._filmed, self._policy, self._kept, self._launching = filmed, policy, kept, launching
        self.speed, self.done = launching.speed, launching.done

    def result(self) -> JudgeResult:
        """The result."""
        result = self._launching.result()
        self._filmed.take(self._policy, self._kept, result)
        return result


# --- The page ------------------------------------------------------------------------------------------------


def films_page(run_dir: Path, results: dict[int, JudgeResult], no_film: str, goes_on: bool) -> str:
    """The page of a run, with the films that are there.

    Args:
        run_dir: the run's folder.
        results: by the policies' control steps.
        no_film: why there are no more films, if there are not.
        goes_on: whether to look for more.
    """
    shown = dict(sorted(results.items()))
    best = max(shown, key=lambda steps: (shown[steps].mean, steps))
    words = f"{len(shown)} policies judged; the best so far at {count(best)} control steps: {shown[best]}."
    if not goes_on:
        words = words.replace(" so far", "")
    why = f"<p class=quiet>{html.escape(no_film)}</p>" if no_film else ""
    cards = "".join(_card(run_dir, steps, result) for steps, result in shown.items())
    return document(
        f"How {run_dir.resolve().name} learns",
        f"<p class=quiet>{html.escape(words)} Each film shows the last {SHOT.length:g} s of a launch from a stand in C "
        f"MuJoCo; one that ends in a fall ends with it.</p>{why}",
        f"{_curve(shown)}<section class=films>{cards}</section>{_LIVE if goes_on else ''}",
        _STYLE,
    )


def _card(run_dir: Path, steps: int, result: JudgeResult) -> str:
    film = Path(FILMS) / f"{steps}.mp4"
    seen = (
        f'<video src="{film.as_posix()}" poster="{film.with_suffix(POSTER).as_posix()}" preload="none" controls loop '
        "muted playsinline></video>"
        if (run_dir / film).is_file()
        else "<div class=none>no film</div>"
    )
    fell = result.falls > 0
    falls = f"{result.falls} of {result.launches} launches fell" if fell else "no fall"
    speed = f"{result.speed:.1f} m/s" if result.speed or not fell else "fell"
    return (
        f"<figure>{seen}<figcaption><b>{speed}</b> at {count(steps)}"
        f'<span class="{"bad" if fell else "good"}">{falls}</span></figcaption></figure>'
    )


def _curve(results: dict[int, JudgeResult]) -> str:
    """Speed over control steps, a dot a policy, red where any of its launches fell."""
    last, most = max(results), max(1.0, *(result.speed for result in results.values()))
    top = most * 1.1
    places = [(40 + 940 * k / last, 150 - 140 * v.speed / top, v.falls > 0) for k, v in results.items()]
    line = " ".join(f"{x:.1f},{y:.1f}" for x, y, _ in places)
    dots = "".join(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" class="{"f" if f else "s"}"/>' for x, y, f in places)
    level = 150 - 140 * most / top
    words = (
        f'<text x="34" y="{level + 5:.1f}" class=left>{most:.1f}</text><text x="34" y="155" class=left>0</text>'
        f'<text x="46" y="14">m/s</text><text x="985" y="170" class=left>{count(last)} control steps</text>'
    )
    return (
        '<div class=wide><svg class=curve viewBox="0 0 1000 175" role="img" aria-label="Speed over control steps">'
        f'<path d="M40 5V150H990M40 {level:.1f}H990"/><polyline points="{line}"/>{dots}{words}</svg></div>'
    )


_LIVE = f"""<script>
setInterval(() => {{
  if ([...document.querySelectorAll("video")].every((film) => film.paused)) location.reload();
}}, {1000 * RELOAD});
</script>"""
_STYLE = """
.films { display: grid; grid-template-columns: repeat(auto-fill, minmax(17rem, 1fr)); gap: 1.5rem 1.2rem; }
.films figure { margin: 0; }
.films video, .films .none { aspect-ratio: 9 / 5; width: 100%; border-radius: 8px;
  background: #f3f5f7; }
.films .none { display: grid; place-items: center; color: var(--quiet); font-size: .9rem; }
.films figcaption { display: flex; gap: .4rem; align-items: baseline; }
.films b { color: var(--ink); font-size: 1.05rem; }
.films span { margin-left: auto; }
.curve { width: 100%; min-width: 34rem; margin: 1.5rem 0; font-size: 13px; }
.curve path, .curve polyline { fill: none; stroke: var(--line); }
.curve polyline { stroke: #0072b2; stroke-width: 2; vector-effect: non-scaling-stroke; }
.curve text { fill: var(--quiet); } .curve .left { text-anchor: end; }
.curve .s { fill: #0072b2; } .curve .f { fill: #d55e00; }
"""
