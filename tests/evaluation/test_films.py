"""Films beside a training: they follow the results, on a page that is there from the
first result on."""

import re
import threading
from concurrent.futures import Future

import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.base.serialization import save_config
from bp2_rl.evaluation import films
from bp2_rl.evaluation.films import FILMS, PAGE, filming
from bp2_rl.evaluation.judge import JudgeProcesses
from bp2_rl.learning.exports import Judge
from bp2_rl.learning.judged import JUDGED, Judged, JudgedPolicy, JudgeResult
from bp2_rl.settings.training import RunConfig
from bp2_rl.simulation.film import NoVideo

FAST, FALLEN = JudgeResult(12.5, 0, 3, 12.5), JudgeResult(0.0, 1, 3, 6.0)
HOLDING = JudgeResult(0.0, 3, 3, 1.4, 8.0, 4.2)


class Fleet(JudgeProcesses):
    """JudgeProcesses with known results by control step, given at once or when a future
    ends."""

    def __init__(self, results):
        self.results, self.places = results, 1

    def submit(self, policy, kept=None, length=0.0, *, slower=True):
        if kept is not None:
            kept.write_bytes(b"the launch's last seconds")
        result = self.results[int(policy.name)]
        if isinstance(result, Future):
            return result
        future = Future()
        future.set_result(result)
        return future


@pytest.fixture
def camera(monkeypatch):
    """Replace the filming by a stand-in that takes no time, and can be held back."""
    free = threading.Event()
    free.set()

    def make_video(kept, output, gl_library, shot):
        assert free.wait(10)
        assert kept.read_bytes()
        output.write_bytes(b"film")

    monkeypatch.setattr(films, "make_video", make_video)
    return free


def hear(judge, run_dir, *steps):
    policies = [run_dir / "policies" / str(step) for step in steps]
    return [judge.submit(policy, slower=True).result() for policy in policies]


def page(run_dir):
    return (run_dir / PAGE).read_text()


def test_the_page_shows_policies_in_order_with_speed_falls_and_film(tmp_path, camera):
    results = {64: FALLEN, 96: HOLDING, 128: FAST}
    with filming(Fleet(results), print) as judge:
        assert isinstance(judge, Judge)
        assert hear(judge, tmp_path, 128, 64, 96) == [FAST, FALLEN, HOLDING]
    card = r"<video src=\"(.*?)\" poster=\"(.*?)\".*?<b>(.*?)</b>.*?<span class=\"(\w+)\">(.*?)</span>"
    shown = re.findall(card, page(tmp_path), re.DOTALL)
    assert shown == [
        ("films/64.mp4", "films/64.jpg", "fell", "bad", "1 of 3 launches fell"),
        ("films/96.mp4", "films/96.jpg", "holds 4.2 m/s", "bad", f"{HOLDING.fallen}"),
        ("films/128.mp4", "films/128.jpg", "12.5 m/s", "good", "no fall"),
    ]
    # nothing else is left
    assert {file.name for file in (tmp_path / FILMS).iterdir()} == {
        *("64.mp4", "96.mp4", "128.mp4")
    }
    assert "://" not in page(tmp_path)


def test_a_result_does_not_wait_for_its_film_and_the_page_looks_for_more(
    tmp_path, camera
):
    camera.clear()
    with filming(Fleet({64: FAST}), print) as judge:
        assert hear(judge, tmp_path, 64)
        assert "<video" not in page(tmp_path)
        assert "12.5 m/s" in page(tmp_path)
        assert "location.reload" in page(tmp_path)
        camera.set()
    assert "<video" in page(tmp_path)
    assert "location.reload" not in page(tmp_path)


def test_a_training_that_is_stopped_does_not_wait_for_films(tmp_path, camera):
    def stop():
        with filming(Fleet({64: FAST, 128: FAST, 192: FAST}), print) as judge:
            hear(judge, tmp_path, 64, 128, 192)
            threading.Timer(0.2, camera.set).start()
            raise KeyboardInterrupt

    camera.clear()
    with pytest.raises(KeyboardInterrupt):
        stop()
    # the one that was being filmed
    assert {file.name for file in (tmp_path / FILMS).iterdir()} == {"64.mp4"}


@pytest.mark.parametrize(
    "error",
    [NoVideo("no video: no GL library works here (egl: gone)"), OSError("disk full")],
)
def test_where_no_film_can_be_made_one_line_says_so_and_the_results_go_on(
    tmp_path, monkeypatch, error
):
    def make_video(*_):
        raise error

    said = []
    monkeypatch.setattr(films, "make_video", make_video)
    with filming(Fleet({64: FAST, 128: FAST, 192: FALLEN}), said.append) as judge:
        assert len(hear(judge, tmp_path, 64, 128, 192)) == 3
    assert [line.startswith("warning: no ") for line in said] == [True]
    assert str(error).split(": ")[-1] in page(tmp_path)
    assert page(tmp_path).count("no film<") == 3


def test_a_resumed_run_keeps_the_films_that_it_had(tmp_path, camera):
    with filming(Fleet({64: FAST}), print) as judge:
        hear(judge, tmp_path, 64)
    known = JudgedPolicy(64, 1.0, JudgeResult(12.5, 0, 3, 12.5))
    save_config(tmp_path / JUDGED, Judged(1.0, (known,), own=64))
    with filming(Fleet({128: FALLEN}), print) as judge:
        hear(judge, tmp_path, 128)
    assert re.findall(r"films/(\d+).mp4", page(tmp_path)) == ["64", "128"]


def test_a_run_whose_folder_is_gone_gets_no_new_one(tmp_path, camera):
    run_dir = tmp_path / "gone"
    with filming(Fleet({64: FAST}), print) as judge, pytest.raises(FileNotFoundError):
        judge.submit(run_dir / "policies" / "64", slower=True)
    assert not run_dir.exists()


def test_a_judge_that_fails_is_heard_of_and_leaves_no_page(tmp_path, camera):
    failed = Future()
    failed.set_exception(RuntimeError("killed"))
    with (
        filming(Fleet({64: failed}), print) as judge,
        pytest.raises(RuntimeError, match="killed"),
    ):
        hear(judge, tmp_path, 64)
    assert not (tmp_path / PAGE).exists()


def test_what_the_training_does_not_wait_for_is_not_on_the_page(tmp_path, camera):
    late = Future()
    judge = Fleet({64: FAST, 128: late})
    with filming(judge, print) as filmed:
        hear(filmed, tmp_path, 64)
        shown = filmed.submit(tmp_path / "policies" / "128", slower=True)
    before = page(tmp_path)
    threading.Thread(target=late.set_result, args=[FAST]).start()
    assert shown.result(timeout=10) == FAST
    assert page(tmp_path) == before
    assert "128" not in before


@pytest.mark.parametrize(("until", "best"), [(None, "64"), (10.5, "128")])
def test_the_best_on_the_page_is_the_runs_own(tmp_path, camera, until, best):
    """One that ends the run comes before one that falls less, as in `judged.json`."""
    slow, reaching = (
        JudgeResult(9.0, 0, 3, 9.0),
        JudgeResult(11.0, 2, 3, 4.0, held=10.8),
    )
    with filming(Fleet({64: slow, 128: reaching}), print, until=until) as judge:
        hear(judge, tmp_path, 64, 128)
    assert re.findall(r"the best at (\d+) control", page(tmp_path)) == [best]


def test_films_need_a_judge():
    with pytest.raises(UserError, match=r"let --run\.judged be 1"):
        RunConfig(films=True)
