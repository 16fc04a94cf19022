import dataclasses
import io
import json
import re
import subprocess
import sys
from html.parser import HTMLParser

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from bp2_rl.base.errors import UserError
from bp2_rl.base.metric import Row, Table, card_of, rows_of
from bp2_rl.base.serialization import from_json, to_json
from bp2_rl.evaluation.benchmarks.outcome import Evaluation
from bp2_rl.evaluation.benchmarks.run import run_pictures, run_tables
from bp2_rl.evaluation.report import folder, page, terminal
from bp2_rl.simulation import film as video
from bp2_rl.simulation.metrics import RunMetrics
from bp2_rl.simulation.trajectory import Trajectory


def evaluation_of(run, benchmark="topspeed", **changes):
    """Return the evaluation that a benchmark of a single run leaves, with the fewest
    pictures."""
    metrics = run.metrics
    fields = {
        "benchmark": benchmark,
        "subject": run.name,
        "backend": run.backend,
        "conditions": {
            "schedule": "ramp & <hold>",
            "policy": "a policy",
            "weights_sha256": "0" * 64,
        },
        "verdict": "It ran.",
        "good": True,
        "rows": rows_of(metrics),
        "tiles": ("Best speed", "Fall"),
        "pictures": run_pictures(run)[:1],
        "metrics": metrics,
        "results": card_of(metrics),
        "tables": run_tables(metrics),
        "trajectory": run,
    }
    return Evaluation(**(fields | changes))


class Page(HTMLParser):
    """Parser of a page that lists its tags, and fails where a tag is not closed in
    order."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.sources = [], [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.sources += [
            value
            for name, value in attrs
            if name in ("src", "srcset", "poster", "href")
        ]
        if tag not in ("meta", "img", "input", "source"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_report_folder_explains_itself(busy_run, tmp_path):
    evaluation = evaluation_of(busy_run, pictures=run_pictures(busy_run))
    assert folder.write_report(evaluation, tmp_path, video=False) is None
    names = {path.name for path in tmp_path.iterdir()}
    pictures = {"speed.png", "torque_speed.png", "gait.png", "joints.png"}
    assert names == pictures | {"metrics.json", "trajectory.npz", "index.html"}
    data = json.loads((tmp_path / "metrics.json").read_text())
    assert data["benchmark"] == "topspeed"
    assert from_json(RunMetrics, data["metrics"]) == evaluation.metrics
    assert data["results"] == {
        "topspeed": {"schedule": "ramp & <hold>"} | evaluation.results
    }
    np.testing.assert_array_equal(
        Trajectory.load(tmp_path / "trajectory.npz").qpos, busy_run.qpos
    )


def test_page_holds_all_that_it_shows(busy_run, tmp_path):
    folder.write_report(
        evaluation_of(busy_run),
        tmp_path,
        video=False,
        command="python eval.py --speed '<5>'",
    )
    text = (tmp_path / "index.html").read_text()
    shown = Page(text)
    wide, narrow, link = sorted(shown.sources)
    assert wide.startswith("data:image/svg+xml;base64,")
    assert narrow.startswith("data:image/svg+xml;base64,")
    assert wide != narrow
    assert link == "trajectory.npz"
    assert "://" not in text
    assert "python eval.py --speed &#39;&lt;5&gt;&#39;" in text
    assert "ramp &amp; &lt;hold&gt;" in text
    for leg in ("FR", "FL", "RR", "RL"):
        assert f"{leg}_knee" in text


def test_an_older_report_is_replaced_whole_by_one_of_its_benchmark(
    busy_run, make_run, tmp_path
):
    folder.write_report(evaluation_of(busy_run), tmp_path, video=False)
    for name in ("run.mp4", "run.jpg"):
        (tmp_path / name).write_bytes(b"of the older run")
    with pytest.raises(
        UserError, match="holds a report of topspeed: name another folder for sprint"
    ):
        folder.open_folder(tmp_path, "sprint")
    folder.open_folder(tmp_path, "topspeed")
    folder.write_report(evaluation_of(make_run(duration=2.0)), tmp_path, video=False)
    assert not list(tmp_path.glob("run.*"))
    assert len(Trajectory.load(tmp_path / "trajectory.npz")) == 2000


def test_a_benchmark_of_no_single_run_leaves_no_run(busy_run, tmp_path):
    evaluation = evaluation_of(busy_run, trajectory=None, tables=())
    assert folder.write_report(evaluation, tmp_path) is None
    assert {path.name for path in tmp_path.iterdir()} == {
        "metrics.json",
        "speed.png",
        "index.html",
    }


def test_a_page_shows_rows_tables_the_film_and_the_mood(busy_run):
    table = Table("Splits", ("Mark", "Time"), [("10 m", "1.23")])
    evaluation = evaluation_of(
        busy_run,
        rows=(Row("Lead", "0.6 s", "at <5 m"),),
        tiles=("Lead",),
        tables=(table,),
        pictures=(),
        good=False,
    )
    text = page.page(evaluation, has_video=True)
    assert Page(text).sources == ["run.mp4", "run.jpg", "trajectory.npz"]
    assert "<div><b>0.6 s</b><span>Lead</span></div>" in text
    assert "at &lt;5 m" in text
    assert "<h2>Splits</h2>" in text
    assert '<p class="verdict bad">It ran.</p>' in text


def test_the_overview_leads_to_every_page_and_shows_every_verdict(busy_run, tmp_path):
    evaluations = [
        evaluation_of(busy_run, name, verdict=f"{name} [bold]done.")
        for name in ("topspeed", "sprint")
    ]
    folder.write_overview(evaluations, tmp_path)
    text = (tmp_path / "index.html").read_text()
    assert Page(text).sources == ["topspeed/index.html", "sprint/index.html"]
    assert "sprint [bold]done." in text
    found = folder.read_report(tmp_path)
    assert found.benchmark == "all"
    assert found.conditions == {"policy": "a policy", "weights_sha256": "0" * 64}
    assert found.results == {
        each.benchmark: folder.card_results(each) for each in evaluations
    }
    printed = io.StringIO()
    Console(file=printed).print(terminal.verdict_of(evaluations[0]))
    assert printed.getvalue() == "topspeed [bold]done.\n"


def test_table_fits_a_terminal_of_eighty_columns(busy_run, make_run, assert_fits):
    for run in (busy_run, make_run(duration=0.5, fell_at=0.5)):
        assert_fits(evaluation_of(run))


def test_what_was_not_measured_is_null_in_the_file_and_a_dash_in_the_table(make_run):
    metrics = make_run(duration=0.5, fell_at=0.5).metrics
    assert to_json(metrics)["best_speed"] is None
    assert {row.label: row.value for row in rows_of(metrics)}["Best speed"] == "-"


# --- The film -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("duration", "shot", "best", "first", "last"),
    [
        (20.0, video.Shot(), 9.0, 7.5, 11.5),
        # of a short run as much as there is
        (4.5, video.Shot(), 3.5, 0.5, 4.5),
        (0.5, video.Shot(), 0.0, 0.0, 0.5),
    ],
)
def test_film_shows_the_seconds_around_the_best_one(
    make_run, duration, shot, best, first, last
):
    run = make_run(duration=duration)
    run.qvel[round(1e3 * best) :][:1000, 0] = 7.0
    times = video.frame_samples(run, shot) * 1e-3
    assert times[0] == pytest.approx(first, abs=1e-3)
    assert times[-1] == pytest.approx(last, abs=1.1 / shot.frame_rate)
    np.testing.assert_allclose(np.diff(times), 1 / shot.frame_rate, atol=1.1e-3)


def test_without_a_gl_library_one_line_says_how_to_mend_it(busy_run, tmp_path):
    reason = folder.write_report(
        evaluation_of(busy_run), tmp_path, gl_library="none-such"
    )
    assert re.fullmatch(
        r"no video: no GL library works here \(none-such: .*\); unset MUJOCO_GL, or .*",
        str(reason),
    )
    assert not list(tmp_path.glob("*.mp4"))
    assert "<video" not in (tmp_path / "index.html").read_text()


def test_film_is_a_film(make_run, tmp_path):
    """Where there is no GL library, the reason is all there is."""
    path, shot = tmp_path / "trajectory.npz", video.Shot(width=480, height=272)
    far = make_run(duration=0.2)
    far.qpos[:, 0] += 280.3  # where the scene has no lane lines any more
    far.save(path)
    try:
        video.make_video(path, tmp_path / "run.mp4", shot=shot)
    except video.NoVideo as reason:
        pytest.skip(str(reason))
    decode = [
        imageio_ffmpeg.get_ffmpeg_exe(),
        "-i",
        tmp_path / "run.mp4",
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "-",
    ]
    pixels = np.frombuffer(
        subprocess.run(decode, capture_output=True, check=True).stdout, np.uint8
    )
    frames = pixels.reshape(-1, shot.height, shot.width, 3)
    assert len(frames) == 6
    assert all(np.std(frame) > 10 for frame in frames)
    ground = (
        frames[:, -shot.height // 8 :, shot.width // 2 :]
        .astype(float)
        .mean(axis=(1, 2))
    )
    # the track is red, from the first frame on
    assert np.all(ground[:, 0] > 1.5 * ground[:, 2])
    # and has white lines
    assert np.max(frames[:, shot.height // 2 :].min(axis=-1)) > 180
    content = (tmp_path / "run.mp4").read_bytes()
    # a browser can begin before it has all
    assert content.index(b"moov") < content.index(b"mdat")
    with Image.open(tmp_path / "run.jpg") as still:
        far = np.abs(np.asarray(still.convert("RGB")).astype(float) - frames).mean(
            axis=(1, 2, 3)
        )
    assert np.argmin(far) == 3
    assert far[3] < 4.0  # of 255: the film and its still are compressed
    assert {entry.name for entry in tmp_path.iterdir()} == {
        "trajectory.npz",
        "run.mp4",
        "run.jpg",
    }


def test_without_the_package_that_writes_films_the_report_is_made_all_the_same(
    busy_run, tmp_path, monkeypatch
):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    monkeypatch.setattr(video.importlib.util, "find_spec", lambda name: None)
    reason = folder.write_report(evaluation_of(busy_run), tmp_path)
    assert (
        reason
        == "no video: the package imageio-ffmpeg is missing; pip install imageio-ffmpeg, or pass --no-video"
    )
    assert (tmp_path / "index.html").is_file()


def test_a_run_that_blew_up_on_other_hardware_leaves_its_report(busy_run, tmp_path):
    torque = busy_run.torque.copy()
    torque[-1, 3] = np.nan
    longer = busy_run.hardware.changed(leg_length=0.4)
    wrecked = dataclasses.replace(busy_run, torque=torque, fell_at=8.0, hardware=longer)
    folder.write_report(evaluation_of(wrecked), tmp_path, video=False)
    assert folder.read_report(tmp_path).results["topspeed"]["electrical_power"] is None
    assert Trajectory.load(tmp_path / "trajectory.npz").hardware == longer


def test_names_are_printed_as_they_are(busy_run):
    printed = io.StringIO()
    run = evaluation_of(dataclasses.replace(busy_run, name="[/foo]bar"))
    terminal.print_table(run, Console(file=printed, width=80))
    assert "[/foo]bar" in printed.getvalue()
