"""A session in which a user steers, pushes and resets the robot, without a screen."""

import dataclasses
import math

import jax
import mujoco
import numpy as np
import pytest
from runs import run_one
from synthetic import still_policy

from bp2_rl.play.pace import FRAMES, Pace, play_on
from bp2_rl.play.session import RIPPLE, STEP, Session, Wish, readings
from bp2_rl.robot.conventions import CONTROL_STEP
from bp2_rl.settings.presets import preset
from bp2_rl.settings.terrain import Terrain
from bp2_rl.simulation.schedule import COMMAND_ACCELERATION, Ramp
from bp2_rl.simulation.world import World

DOWN = 0.1  # s, in place of the time that a robot lies after a fall
CREST = 9.8, 0.8  # m, a quarter of a wave of 1.6 m and whole ones from -5, -6


def run(session, seconds):
    """Run a session for some seconds, and return its commands (K, 3)."""
    commands = []
    for _ in range(round(seconds / CONTROL_STEP)):
        session.tick()
        commands.append(session.command.copy())
    return np.array(commands)


@pytest.fixture
def uphill(session, monkeypatch):
    """The robot on waves that rise."""
    monkeypatch.setattr("bp2_rl.simulation.simulator.SETTLING_TIME", 0.5)
    world = World(Terrain("waves", 0.2, slope=0.05))
    return Session(session._policy, session.hardware, world)


@pytest.mark.parametrize("ground", ["session", "uphill"])
def test_it_runs_as_the_judge_has_it_run(request, ground, monkeypatch):
    """A run of the same policy on the same robot under the same ramp, held."""
    monkeypatch.setattr("bp2_rl.simulation.simulator.SETTLING_TIME", 0.5)
    session = request.getfixturevalue(ground)
    policy, ramp = session._policy, Ramp((0.6, 0.0, 0.0), COMMAND_ACCELERATION, 0.15)
    robot = {"hardware": session.hardware, "world": session.world}
    judged = run_one(policy, ramp, session.config, **robot)
    session.wish = Wish(0.6)
    run(session, ramp.duration - CONTROL_STEP)
    # a sample is the state at the beginning of its millisecond
    k = len(judged) - round(CONTROL_STEP / judged.dt)
    # Sums of ramps differ in their last digits, and a policy in float32 makes 1e-7 of
    # that each step.
    np.testing.assert_allclose(session.qpos, judged.qpos[k], atol=1e-4)


def test_fall_and_ghost_are_over_the_ground_and_beyond_it_there_is_none(uphill):
    """On a crest of 0.2 m, at a height at which a robot on flat ground stands."""
    uphill.tick()
    uphill.data.qpos[:2] = CREST
    assert uphill.ground == pytest.approx(0.2, abs=1e-6)
    ghost = uphill.reference()[2]
    uphill.data.qpos[:2] = 0.0, 0.0  # even, at the start
    assert uphill.reference()[2] == pytest.approx(ghost - 0.2, abs=1e-6)
    for place, height in ((CREST, 0.45), ((-6.0, 0.0), 0.6)):
        uphill.reset()
        before = uphill.falls
        uphill.data.qpos[:3] = *place, height
        uphill.tick()
        assert uphill.falls == before + 1, place


def test_speed_and_turn_follow_their_commands_and_the_line_is_held_after_a_turn(
    session,
):
    session.wish = Wish(2.0)
    commands = run(session, 2.0)
    assert np.diff(commands[:, 0]).max() == pytest.approx(
        COMMAND_ACCELERATION * CONTROL_STEP, rel=1e-3
    )
    assert session.velocity[0] == pytest.approx(2.0, abs=0.5)
    session.wish = Wish(2.0, turn=0.8)
    run(session, 1.0)
    assert 0.2 < session.velocity[2] < 1.2  # policies turn by less than they are told
    session.wish = Wish(1.0)
    commands = run(session, 0.5)
    braking = COMMAND_ACCELERATION if session.config.control.stopping_time else 1.5
    assert np.diff(commands[:, 0]).min() == pytest.approx(
        -braking * CONTROL_STEP, rel=1e-3
    )
    x, y, yaw = session._line
    assert abs(yaw) > 0.1  # the line that it keeps to now is the one on which it was
    across = np.cos(yaw) * (session.qpos[1] - y) - np.sin(yaw) * (session.qpos[0] - x)
    assert abs(across) < 0.3
    assert session.falls == 0


def test_who_launches_is_asked_for_no_more_than_the_policy_is_told_so_that_a_stop_comes_at_once(
    session, monkeypatch
):
    control = dataclasses.replace(
        session.config.control, launching=6.0, launching_speed=18.0
    )
    config = dataclasses.replace(session.config, control=control)
    monkeypatch.setattr(session, "config", config)
    tell, told = jax.jit(control.tell), [np.zeros(3, np.float32)]
    for wish in (15.0,) * 520 + (0.0,) * 40:
        session.wish = Wish(wish)
        session._lead()
        told.append(np.asarray(tell(told[-1], np.asarray(session._asked, np.float32))))
        assert told[-1][0] == pytest.approx(session._asked[0], abs=1e-3)
    assert 10.0 < told[520][0] < 11.0  # 18 (1 - exp(-2.6 / 3))
    assert told[-1][0] < told[-2][0] < 10.5


def test_no_more_turn_is_asked_for_than_friction_holds(session):
    session.wish = Wish(0.0, turn=99.0)
    session._asked = np.array([session.config.commands.max_forward, 0.0, 0.0])
    limits = session.config.commands
    for _ in range(400):
        session._lead()
    assert session._asked[2] == pytest.approx(
        limits.max_turn / session._asked[0], rel=0.02
    )
    assert session._asked[2] < limits.max_yaw_rate


def test_a_wish_and_the_steps_of_keys_keep_to_what_the_policy_was_trained_for(session):
    limits = session.config.commands
    session.wish = Wish(-1.0, left=9.0)
    assert session.wish == (0.0, limits.max_lateral, 0.0)
    session.step(speed=1, left=-1)
    session.step(turn=-1)
    assert session.wish == (
        STEP.speed,
        pytest.approx(limits.max_lateral - STEP.left),
        -STEP.turn,
    )
    for _ in range(100):
        session.step(speed=1, left=-1, turn=-1)
    assert session.wish == (
        limits.max_forward,
        -limits.max_lateral,
        -limits.max_yaw_rate,
    )
    session.stand()
    assert session.wish == Wish()
    session.lean("speed", -1.0)  # there is no backward
    session.lean("left", 0.5)
    session.lean("turn", -0.333)
    half, third = 0.5 * limits.max_lateral, round(0.333 * limits.max_yaw_rate, 2)
    assert session.wish == (0.0, half, -third)


def test_it_goes_sideways_and_then_keeps_to_the_line_that_it_has_come_to(session):
    session.wish = Wish(1.0, left=0.5)
    commands = run(session, 2.0)
    # As in training: up to half as much at speed.
    limits = session.config.commands
    assert commands[-1, 1] == pytest.approx(
        0.5 * (1.0 - 0.5 * 1.0 / limits.max_forward), rel=1e-3
    )
    assert np.diff(commands[:, 1]).max() == pytest.approx(
        limits.turn_acceleration * CONTROL_STEP, rel=1e-3
    )
    assert session.velocity[1] == pytest.approx(0.5, abs=0.3)
    session.wish = Wish(1.0)
    run(session, 0.5)
    assert session._line[1] > 0.4  # m
    assert session.falls == 0


def test_the_clock_runs_from_the_first_command_to_the_finish(session, monkeypatch):
    monkeypatch.setattr("bp2_rl.play.session.TRACK", 0.5)
    run(session, 0.1)
    assert (session.sprint, session.finished) == (0.0, False)  # not yet
    session.wish = Wish(2.0)
    times = []
    while not session.finished:
        session.tick()
        times.append(session.sprint)
        assert len(times) < 400
    assert session.qpos[0] == pytest.approx(0.5, abs=0.05)
    np.testing.assert_allclose(
        times, CONTROL_STEP * np.arange(1, len(times) + 1), atol=1e-9
    )
    first = session.best
    run(session, 0.1)
    assert session.sprint == session.best == first == times[-1]
    session.reset()
    monkeypatch.setattr("bp2_rl.play.session.TRACK", 1.0)  # takes longer
    session.wish = Wish(2.0)
    for _ in range(600):
        session.tick()
    assert session.finished
    assert session.sprint > session.best == first


def test_a_push_is_a_jump_of_velocity_along_the_heading(session):
    data = session.data
    # it looks along y
    mujoco.mju_axisAngle2Quat(data.qpos[3:7], np.array([0.0, 0.0, 1.0]), np.pi / 2)
    before = data.qvel.copy()
    session.push(0.5, 0.2)
    np.testing.assert_allclose(
        data.qvel - before, [-0.2, 0.5, *np.zeros(20)], atol=1e-12
    )


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


def test_after_a_fall_it_lies_a_while_and_stands_again_without_a_wish(
    session, monkeypatch
):
    monkeypatch.setattr("bp2_rl.play.session.DOWN", DOWN)
    stand = session.qpos.copy()
    session.wish = Wish(12.0, turn=1.0)
    session.push(0.0, 5.0)
    ticks = 0
    while session.down_since is None:
        session.tick()
        assert (ticks := ticks + 1) < 400
    fell = session.down_since
    assert (session.falls, session.wish) == (1, Wish())
    sprint = session.sprint
    session.wish = Wish(12.0)  # a hand that is still on the slider
    run(session, DOWN)
    assert session.time == pytest.approx(fell + DOWN)
    assert (session.sprint, session.best) == (sprint, math.inf)  # who falls has no time
    assert np.abs(session.qpos - stand).max() > 0.1
    session.tick()
    assert (session.falls, session.down_since, session.wish) == (1, None, Wish())
    np.testing.assert_allclose(session.qpos, stand, atol=0.02)
    assert session.time == pytest.approx(CONTROL_STEP)


def test_a_robot_whose_state_is_no_robots_any_more_is_set_on_its_feet_at_once(session):
    stand = session.qpos.copy()
    session.data.qvel[:] = np.nan
    session.tick()
    assert session.falls == 1
    np.testing.assert_array_equal(session.qpos, stand)
    session.tick()
    assert np.isfinite(session.velocity).all()


def test_after_a_reset_it_does_the_same_again(session):
    courses = []
    for _ in range(2):
        session.reset()
        session.wish = Wish(1.0)
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
    np.testing.assert_allclose(
        legs[:, :3].ravel(), np.asarray(reference.joint_position)[0]
    )
    # A policy that has learnt from the motion is near it: more than the trot's 1 rad of
    # swing is another motion.
    assert np.abs(legs - session.qpos[7:].reshape(4, 4)).max() < 1.0


# --- Real time ------------------------------------------------------------------------


@dataclasses.dataclass
class Wall:
    """A stand-in clock that goes on while one sleeps, while the robot moves, and while
    nobody looks."""

    now: float = 0.0
    step: float = 0.0  # s that a control step takes
    away: tuple[float, float] = (0.0, 0.0)  # from when to when nobody looks
    frames: list[float] = dataclasses.field(default_factory=list)
    ticks: int = 0

    def sleep(self, seconds):
        self.now += seconds

    def tick(self):
        self.now += self.step
        self.ticks += 1

    def watched(self):
        there = not self.away[0] <= self.now < self.away[1]
        if not there:
            self.now = min(self.now + 0.2, self.away[1])
        return there

    def show(self, pace):
        self.frames.append(self.now)

    def pace(self):
        return Pace(lambda: self.now, self.sleep)


@pytest.mark.parametrize(
    ("step", "slow", "factor"),
    [(0.002, 1.0, 1.0), (0.002, 5.0, 1.0), (0.010, 1.0, 0.5), (0.010, 2.0, 1.0)],
)
def test_the_pace_is_the_walls_or_the_machines(step, slow, factor):
    wall = Wall(step=step)
    pace = wall.pace()
    pace.slow = slow
    play_on(wall.tick, wall.watched, wall.show, pace, seconds=4.0)
    assert pace.factor == pytest.approx(factor, abs=0.01)
    assert len(wall.frames) == pytest.approx(4.0 * FRAMES, rel=0.2)


def test_it_stands_still_while_nobody_looks_and_goes_on_at_once():
    wall = Wall(step=0.002, away=(1.0, 601.0))
    pace = wall.pace()
    play_on(wall.tick, wall.watched, wall.show, pace, seconds=602.0)
    # it does not catch up either
    assert wall.ticks * CONTROL_STEP == pytest.approx(2.0, abs=0.05)
    # of the time in which somebody looked
    assert pace.factor == pytest.approx(1.0, abs=0.01)
    after = [frame for frame in wall.frames if frame > 1.0 + 1.0 / FRAMES]
    assert after[0] == pytest.approx(601.0, abs=2.0 / FRAMES)


def test_nobody_has_looked_yet():
    wall = Wall(away=(0.0, 9.0))
    pace = wall.pace()
    play_on(wall.tick, wall.watched, wall.show, pace, seconds=1.0)
    assert (wall.ticks, wall.frames, str(pace)) == (0, [], "no browser was open")


def test_what_a_page_says_of_a_stand_a_sprint_and_a_fall(session):
    pace = Wall().pace()
    said = readings(session, pace)
    assert [said[name] for name in ("100 m", "pace")] == [
        "ready",
        "no browser was open",
    ]
    assert said["best"] == "none yet; the paper's robot: 12.2 s"
    session.wish = Wish(2.0)
    run(session, 0.5)
    assert readings(session, pace)["100 m"] == "0.50 s, 100 m left"
    session.finished, session.best = True, 9.74
    session.down_since, session.distance = 0.5, 70.4
    said = readings(session, pace)
    assert said["100 m"] == "0.50 s; reset for another"
    assert said["best"].startswith("9.74 s; ")
    assert said["run"].startswith("fell; 70 m in 0.5 s; ")


def test_speeds_are_means_over_a_stride(session):
    run(session, 0.1)
    assert len(session._velocities) == round(0.1 / CONTROL_STEP)
    run(session, RIPPLE)
    assert len(session._velocities) == round(RIPPLE / CONTROL_STEP)


def test_another_robot_is_played_within_its_own_speeds(make_card, monkeypatch):
    """A policy that follows the kinematic trot, as nobody trained it: what is asked for
    is clipped at its top speed."""
    monkeypatch.setattr("bp2_rl.simulation.simulator.SETTLING_TIME", 0.5)
    card = make_card(env=preset("imitation", "smoke", robot="go1").env)
    session = Session(still_policy(card))
    assert session.hardware.anatomy.name == "Unitree Go1"
    for _ in range(40):
        session.step(speed=1, turn=1)
    commands = card.env.commands
    most = commands.max_forward, 0.0, commands.max_yaw_rate
    assert session.wish == tuple(round(end, 2) for end in most)
    assert commands.max_forward != session.wish.speed
    assert commands.max_forward < 3.0  # of BP2's 3
    session.wish = Wish(0.3)
    run(session, 0.5)
    assert session.qpos.shape == session.reference().shape == (19,)
    assert session.down_since is None
    said = readings(session, Pace())
    assert "paper" not in " ".join(said.values())
