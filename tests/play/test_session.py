"""What hands can do to the robot, without a screen."""

import dataclasses

import jax
import mujoco
import numpy as np
import pytest
from runs import run_one

from bp2_rl.play.pace import FRAMES, Pace, play_on
from bp2_rl.play.session import BRAKING, RIPPLE, Wish
from bp2_rl.robot.easing import eased
from bp2_rl.robot.specs import CONTROL_STEP
from bp2_rl.simulation.schedule import COMMAND_ACCELERATION, Ramp

DOWN = 0.1  # s, in place of the time that a robot lies after a fall


def run(session, seconds):
    """The commands (K, 3) of so many seconds."""
    commands = []
    for _ in range(round(seconds / CONTROL_STEP)):
        session.tick()
        commands.append(session.command.copy())
    return np.array(commands)


def test_it_runs_as_the_judge_has_it_run(session):
    """A run of the same policy on the same robot under the same ramp, held."""
    ramp = Ramp((0.6, 0.0, 0.0), COMMAND_ACCELERATION, hold=0.15)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bp2_rl.simulation.simulator.SETTLING_TIME", 0.5)
        judged = run_one(session._policy, ramp, session.config, hardware=session.hardware)
    session.wish = Wish(0.6)
    run(session, ramp.duration - CONTROL_STEP)
    k = len(judged) - round(CONTROL_STEP / judged.dt)  # a sample is the state at the beginning of its millisecond
    # Sums of ramps differ in their last digits, and a policy in float32 makes 1e-7 of that each step.
    np.testing.assert_allclose(session.qpos, judged.qpos[k], atol=1e-4)
    np.testing.assert_allclose(session.worked[-1, 1], judged.torque[k - 1], atol=0.05)


def test_speed_and_turn_follow_their_commands_and_the_line_is_held_after_a_turn(session):
    session.wish = Wish(2.0)
    commands = run(session, 2.0)
    assert np.diff(commands[:, 0]).max() == pytest.approx(COMMAND_ACCELERATION * CONTROL_STEP, rel=1e-3)
    assert session.speed == pytest.approx(2.0, abs=0.5)
    session.wish = Wish(2.0, turn=0.8)
    run(session, 1.0)
    assert 0.2 < session.turn < 1.2  # policies turn by less than they are told
    session.wish = Wish(1.0)
    commands = run(session, 0.5)
    braking = COMMAND_ACCELERATION if session.config.control.stopping_time else BRAKING
    assert np.diff(commands[:, 0]).min() == pytest.approx(-braking * CONTROL_STEP, rel=1e-3)
    x, y, yaw = session._line
    assert abs(yaw) > 0.1  # the line that it keeps to now is the one on which it was
    across = np.cos(yaw) * (session.qpos[1] - y) - np.sin(yaw) * (session.qpos[0] - x)
    assert abs(across) < 0.3
    assert session.falls == 0


def test_who_launches_is_asked_for_no_more_than_the_policy_is_told_so_that_a_stop_comes_at_once(session):
    control = dataclasses.replace(session.config.control, launching=6.0, launching_speed=18.0)
    own, session.config = session.config, dataclasses.replace(session.config, control=control)
    try:
        told, tell = np.zeros(3, np.float32), jax.jit(lambda told, asked: eased(told, asked, control))
        for wish, steps in ((15.0, 520), (0.0, 40)):
            session.wish = Wish(wish)
            for _ in range(steps):
                session._lead()
                before, told = told, np.asarray(tell(told, np.array([session._asked.speed, 0.0, 0.0], np.float32)))
                assert told[0] == pytest.approx(session._asked.speed, abs=1e-3)
            if wish:
                assert 10.0 < told[0] < 11.0  # 18 (1 - exp(-2.6 / 3))
        assert told[0] < before[0] < 10.5
    finally:
        session.config = own


def test_no_more_turn_is_asked_for_than_friction_holds(session):
    session.wish = Wish(0.0, turn=99.0)
    session._asked = Wish(session.config.commands.max_forward)
    limits = session.config.commands
    for _ in range(400):
        session._lead()
    assert session._asked.turn == pytest.approx(limits.max_turn / session._asked.speed, rel=0.02)
    assert session._asked.turn < limits.max_yaw_rate


def test_a_push_is_a_jump_of_velocity_along_the_heading(session):
    data = session.data
    mujoco.mju_axisAngle2Quat(data.qpos[3:7], np.array([0.0, 0.0, 1.0]), np.pi / 2)  # it looks along y
    before = data.qvel.copy()
    session.push(0.5, 0.2)
    np.testing.assert_allclose(data.qvel - before, [-0.2, 0.5, *np.zeros(20)], atol=1e-12)


def test_friction_bounds_what_feet_can_push_with(session):
    session.friction = 0.15
    session.wish = Wish(3.0)
    ratios = []
    for _ in range(120):
        session.tick()
        force = session.foot_forces()
        loaded = force[:, 2] > 20.0
        ratios.extend(np.abs(force[loaded, :2]).max(axis=1) / force[loaded, 2])
    assert max(ratios) <= 0.15 + 1e-6  # MuJoCo's pyramid
    assert max(ratios) > 0.14  # and it slides


def test_after_a_fall_it_lies_a_while_and_stands_again(session, monkeypatch):
    monkeypatch.setattr("bp2_rl.play.session.DOWN", DOWN)
    stand = session.qpos.copy()
    session.push(0.0, 5.0)
    ticks = 0
    while session.down_since is None:
        session.tick()
        assert (ticks := ticks + 1) < 400
    fell = session.down_since
    assert session.falls == 1
    run(session, DOWN)
    assert session.time == pytest.approx(fell + DOWN)
    assert np.abs(session.qpos - stand).max() > 0.1
    session.tick()
    assert (session.falls, session.down_since) == (1, None)
    np.testing.assert_allclose(session.qpos, stand, atol=0.02)
    assert session.time == pytest.approx(CONTROL_STEP)


def test_a_robot_whose_state_is_no_robots_any_more_is_set_on_its_feet_at_once(session):
    stand = session.qpos.copy()
    session.data.qvel[:] = np.nan
    session.tick()
    assert session.falls == 1
    np.testing.assert_array_equal(session.qpos, stand)
    session.tick()
    assert np.isfinite(session.speed)


def test_after_a_reset_it_does_the_same_again(session):
    session.wish = Wish(1.0)
    courses = []
    for _ in range(2):
        session.reset()
        run(session, 0.1)
        courses.append(session.qpos.copy())
    np.testing.assert_array_equal(*courses)


def test_the_ghost_is_the_reference_under_the_robots_heading(session):
    session.wish = Wish(3.0)
    run(session, 1.0)
    ghost, reference = session.reference(), session._runner.reference
    np.testing.assert_array_equal(ghost[:2], session.qpos[:2])
    up = np.zeros(3)
    mujoco.mju_rotVecQuat(up, np.array([0.0, 0.0, 1.0]), ghost[3:7])
    np.testing.assert_allclose(up[2], np.asarray(reference.up)[0, 2], atol=1e-6)
    assert np.linalg.norm(ghost[3:7]) == pytest.approx(1.0)
    legs = ghost[7:].reshape(4, 4)
    np.testing.assert_allclose(legs[:, :3].ravel(), np.asarray(reference.joint_position)[0])
    # A policy that has learnt from the motion is near it: more than the trot's 1 rad of swing is another motion.
    assert np.abs(legs - session.qpos[7:].reshape(4, 4)).max() < 1.0


# --- Real time ---------------------------------------------------------------------------------------------------


@dataclasses.dataclass
class Wall:
    """A clock that goes on while one sleeps and while the robot moves."""

    now: float = 0.0
    step: float = 0.0  # s that a control step takes

    def sleep(self, seconds):
        self.now += seconds

    def tick(self):
        self.now += self.step


@pytest.mark.parametrize(
    ("step", "slow", "factor"), [(0.002, 1.0, 1.0), (0.002, 5.0, 1.0), (0.010, 1.0, 0.5), (0.010, 2.0, 1.0)]
)
def test_the_pace_is_the_walls_or_the_machines(step, slow, factor):
    wall, frames = Wall(step=step), []
    pace = Pace(lambda: wall.now, wall.sleep, work=lambda: 0.3 * wall.now)
    pace.slow = slow
    play_on(wall.tick, lambda: frames.append(wall.now) is None, pace, seconds=4.0)
    assert pace.factor == pytest.approx(factor, abs=0.01)
    assert pace.load == pytest.approx(0.3 / factor, abs=0.01)
    assert len(frames) == pytest.approx(4.0 * FRAMES, rel=0.2)


def test_who_closes_the_window_ends_it():
    wall = Wall(step=0.002)
    play_on(wall.tick, lambda: wall.now < 1.0, Pace(lambda: wall.now, wall.sleep))
    assert wall.now == pytest.approx(1.0, abs=2.0 / FRAMES)


def test_speeds_are_means_over_a_stride(session):
    run(session, 0.1)
    assert len(session._velocities) == round(0.1 / CONTROL_STEP)
    run(session, RIPPLE)
    assert len(session._velocities) == round(RIPPLE / CONTROL_STEP)
