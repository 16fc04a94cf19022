"""Operating points of motors whose torque and speed are known."""

import dataclasses

import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.base.serialization import from_json, to_json
from bp2_rl.paper.benchmarks.efficiency.measured import motors_of
from bp2_rl.paper.figures.operating import OperatingNumbers, measure_points, operating
from bp2_rl.paper.figures.settings import OperatingFigureSettings
from bp2_rl.robot.conventions import MOTOR_NAMES
from bp2_rl.robot.hardware import BUILT

HIND_HIPS = [MOTOR_NAMES.index("RR_hip"), MOTOR_NAMES.index("RL_hip")]


@pytest.fixture
def known(make_run):
    """Return a run whose hind hips have 100 Nm at w = 10 sin, and fore knees 120 Nm,
    their limit, at 22 rad/s against it for a tenth."""
    run = make_run(duration=6.0)
    speed, torque = np.zeros((len(run), 12)), np.zeros((len(run), 12))
    speed[:, HIND_HIPS] = 10.0 * np.sin(2 * np.pi * 4.0 * run.time)[:, None]
    torque[:, HIND_HIPS] = 100.0
    knees = [MOTOR_NAMES.index("FR_knee"), MOTOR_NAMES.index("FL_knee")]
    torque[:, knees] = -120.0
    speed[:, knees] = np.where(run.time % 1.0 < 0.1, 22.0, 0.0)[:, None]
    qvel = run.qvel.copy()
    qvel[:, [6 + 4 * (i // 3) + i % 3 for i in range(12)]] = speed
    return dataclasses.replace(run, qvel=qvel, torque=torque)


def test_motors_are_those_of_their_names():
    assert [MOTOR_NAMES[i] for i in motors_of("hind hip")] == ["RR_hip", "RL_hip"]
    assert [MOTOR_NAMES[i] for i in motors_of("fore knee")] == ["FR_knee", "FL_knee"]


def test_points_are_measured_in_all_quadrants(known):
    """Root mean squares of a sine; shares of time by construction, of the hold of whole
    cycles."""
    found = {kind.name: kind for kind in measure_points(known).kinds}
    hip, knee = found["hind hip"], found["fore knee"]
    # a sample may miss the peak
    assert (hip.driving, hip.braking) == pytest.approx((1000.0, 1000.0), rel=1e-3)
    assert (hip.torque, hip.speed) == pytest.approx((100.0, 10.0 / np.sqrt(2.0)))
    assert hip.on_envelope == 0.0
    assert hip.brakes == pytest.approx(0.5, abs=0.01)
    assert knee.on_envelope == 1.0
    assert knee.beyond_no_load == knee.brakes == pytest.approx(0.1, abs=0.001)
    assert (knee.driving, knee.braking) == pytest.approx((0.0, 22.0 * 120.0))
    assert found["hind knee"].torque == 0.0


def test_runs_of_one_robot_are_drawn(known, make_run, leave_report):
    slow = leave_report(known, name="slow")
    fast = leave_report(make_run(duration=6.0, speed=6.0), name="fast")
    drawn = operating(OperatingFigureSettings((slow, fast)))
    assert list(drawn.pictures) == ["operating"]
    assert [run.speed for run in drawn.results.runs] == pytest.approx([5.0, 6.0])
    assert drawn.results.peak == pytest.approx(1764.0)
    assert from_json(OperatingNumbers, to_json(drawn.results)) == drawn.results
    assert all(
        len(line) == len(table.head) for table in drawn.tables for line in table.lines
    )
    other = leave_report(make_run(duration=6.0, hardware=BUILT), name="other")
    with pytest.raises(UserError, match="of different robots"):
        operating(OperatingFigureSettings((slow, other)))
