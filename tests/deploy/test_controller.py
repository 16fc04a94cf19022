"""The controller without JAX gives the targets of training's controller, and its
watchdog stops wrong sensors."""

import dataclasses
import time
from functools import partial
from types import SimpleNamespace
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bp2_rl.deploy.bundle import write_bundle
from bp2_rl.deploy.onboard.watchdog import SensorReading
from bp2_rl.env.controller import Controller as Trained
from bp2_rl.env.observations import Measurement as Seen

TICKS = 2000
DT = 0.005
STAND = np.array([0.0, 0.62, -1.24] * 4)


@pytest.fixture
def fresh(controller):
    controller.reset()
    return controller


def standing(now: float, **changes) -> SensorReading:
    """Return a measurement of a robot that stands, with a little noise, as all working
    sensors have."""
    noise = 1e-9 * (round(now / DT) % 7)
    fields = {
        "joint_position": STAND + noise,
        "joint_velocity": np.zeros(12),
        "up": np.array([noise, 0.0, 1.0]),
        "angular_velocity": np.full(3, noise),
        "time": now,
    }
    return SensorReading(**(fields | changes))


def following(controller):
    """Return a function that measures a robot that hangs in the air: in each tick its
    joints go a fifth of the way to their targets."""
    position = STAND.copy()

    def measure(now):
        way = 0.2 * (controller._targets.position - position)
        position[:] += way
        return standing(now, joint_position=position.copy(), joint_velocity=way / DT)

    return measure


def run(controller, start, seconds, measure, command=(2.0, 0.0, 0.0)):
    """Run the controller for `seconds`; return its targets and the time after.
    `measure` makes a measurement, or none, of a time."""
    times = start + DT * np.arange(round(seconds / DT))
    return [controller.step(measure(now), command, now) for now in times], times[
        -1
    ] + DT


# --- The same as in training ----------------------------------------------------------


@pytest.fixture(scope="module")
def loop(onboard, bundle, controller, rehearse):
    """Simulate a robot and its controller for 2,000 ticks from a stand to 10.74 m/s;
    return measurements, commands, targets, and how the robot ran.

    Robot and controller in C MuJoCo; the fixture's arrays are what JAX's controller is
    shown afterwards.
    """
    plan = onboard.robot.RehearsalPlan(
        10.74, hold=TICKS * DT - 10.74 / 2.4, loss=0.0, late=0.0
    )
    world = onboard.robot.RehearsalWorld(bundle, "built", plan)
    found = as_arrays(rehearse(world, controller))
    assert controller.fault == ""
    assert world.fell_at is None
    assert world.outcome()["mean_speed"] > 10.0
    return found


def as_arrays(ticks):
    """Return measurements (K 30), commands (K 3) and targets (K 2 12) of a rehearsal's
    ticks."""
    measured, asked, targets = zip(*ticks, strict=True)
    return (
        np.stack([np.concatenate(one[:4]) for one in measured]),
        np.stack(asked),
        np.stack(targets),
    )


@pytest.mark.parametrize(
    ("double", "position_error", "velocity_error"),
    [
        # its law to the letter: what is left is the network's float32
        (True, 1e-5, 1e-4),
        # as it trains: float32 takes that much of JAX's own, where a knee is all but
        # straight
        (False, 2e-5, 1e-2),
    ],
    ids=["float64", "float32"],
)
def test_two_thousand_ticks_of_a_closed_loop_are_those_of_jax(
    loop, shipped, double, position_error, velocity_error
):
    """Each keeps its own phase and last action for all 10 s, so what differs would add
    up.

    On board targets are kept within the joints' range.

    Physics of its own for each would not do: contacts drive runs apart that begin a
    last bit apart.
    """
    position, velocity = apart(loop, shipped, double)
    assert len(loop[0]) == TICKS
    assert position <= position_error  # rad
    assert velocity <= velocity_error  # rad/s


@pytest.mark.parametrize("name", ["go1", "mini_cheetah"])
def test_the_loop_of_another_robot_is_that_of_jax(onboard, another, rehearse, name):
    """On the kinematic trot, from a stand to 0.8 m/s, as far as a robot comes whose
    policy nobody trained."""
    policy, folder = another(name)
    controller = onboard.controller.OnboardController(folder)
    plan = onboard.robot.RehearsalPlan(0.8, hold=1.5 - 0.8 / 2.4, loss=0.0, late=0.0)
    world = onboard.robot.RehearsalWorld(folder, "own", plan)
    loop = as_arrays(rehearse(world, controller))
    assert controller.fault == ""
    assert np.ptp(loop[2][:, 0], axis=0).max() > 0.2  # it trots
    position, velocity = apart(loop, policy, double=True)
    assert position <= 1e-5  # rad: the network's float32
    assert velocity <= 1e-4  # rad/s


def apart(loop, policy, double):
    """Return how far a loop's targets are from training's controller's, given the same
    measurements: rad, rad/s."""
    env = policy.card.env
    trained = Trained(env)

    def tick(carry, seen):
        (state, told), (measured, asked) = carry, seen
        told = env.control.tell(told, asked)
        state, observation = trained.observe(
            state, told, Seen(*jnp.split(measured, [12, 24, 27]))
        )
        state, targets, _ = trained.act(state, told, policy(observation))
        return (state, told), jnp.stack([targets.position, targets.velocity])

    measured, command, found = loop
    with jax.enable_x64(double):
        dtype = jnp.float64 if double else jnp.float32
        # The controller hears the command in float32, as every policy does.
        command = jnp.asarray(command.astype(np.float32), dtype)
        start = trained.init()
        start = start.replace(
            phase=start.phase.astype(dtype),
            last_action=start.last_action.astype(jnp.float32),
        )
        first = start, jnp.zeros(3, dtype)
        _, targets = jax.jit(lambda *seen: jax.lax.scan(tick, first, seen))(
            jnp.asarray(measured, dtype), command
        )
    expected = np.array(targets)
    ranges = np.array(
        [ends for leg in env.hardware.anatomy.legs for ends in leg.ranges]
    )
    expected[:, 0] = np.clip(expected[:, 0], *ranges.T)
    return np.abs(found - expected).max(axis=(0, 2))


@pytest.fixture
def altered(onboard, shipped, tmp_path):
    """Return a maker of the shipped policy's environment with other controller
    settings, and of its bundle's controller."""

    def make(**changes):
        control = dataclasses.replace(shipped.card.env.control, **changes)
        env = dataclasses.replace(shipped.card.env, control=control)
        card = dataclasses.replace(shipped.card, env=env)
        write_bundle(tmp_path / "bundle", dataclasses.replace(shipped, card=card))
        return env, onboard.controller.OnboardController(tmp_path / "bundle")

    return make


def test_a_clock_that_is_not_seen_at_rest_is_not_seen_here(altered, shipped):
    env, controller = altered(
        clock_at_rest=False, launching=np.inf, launching_speed=np.inf
    )
    trained = Trained(env)
    start = trained.init(0.2)
    measured = Seen(*(jnp.asarray(x) for x in standing(0.0)[:4]))
    for speed in (0.0, 0.2, 6.0):
        controller.reset(0.2)
        found = controller.step(standing(0.0), (speed, 0.0, 0.0), 0.0)
        command = jnp.array([speed, 0.0, 0.0])
        seen, observation = trained.observe(start, command, measured)
        _, targets, _ = trained.act(seen, command, shipped(observation))
        assert found.position == pytest.approx(np.asarray(targets.position), abs=2e-5)


@pytest.mark.parametrize(
    ("changes", "speeds", "at", "told", "last"),
    [
        ({}, [10.0] * 500 + [6.0] * 300 + [0.0] * 700, 499, (10.0, 10.0), (0.0, 0.0)),
        (
            {"launching": 6.0, "launching_speed": 18.0},
            [13.0] * 600 + [6.0] * 200 + [8.0] * 100,
            500,
            (10.0, 10.4),  # 18 (1 - exp(-2.5 / 3))
            (7.9, 8.0),
        ),
    ],
    ids=["stop", "launch"],
)
def test_a_stop_and_a_launch_are_as_gentle_here(
    altered, changes, speeds, at, told, last
):
    """Tick by tick the policy is told what JAX's law tells it."""
    env, controller = altered(**changes)
    assert np.isfinite(env.control.braking)
    assert env.control.stopping_time > 0.0
    tell, expected, forward = jax.jit(env.control.tell), jnp.zeros(3), []
    measure = following(controller)
    for k, speed in enumerate(speeds):
        asked = (speed, 0.1, 0.2)
        controller.step(measure(k * DT), asked, k * DT)
        expected = tell(expected, jnp.asarray(asked))
        np.testing.assert_allclose(controller.command, expected, atol=1e-5)
        forward.append(float(expected[0]))
    assert told[0] <= forward[at] <= told[1]
    assert last[0] <= forward[-1] <= last[1]


def test_a_tick_takes_less_than_a_millisecond(fresh):
    """Of the processor; of five batches the best, as others may share its core's
    caches."""
    batches = np.zeros((5, 200))
    for k in range(batches.size):
        measurement, before = standing(k * DT), time.thread_time()
        fresh.step(measurement, (8.0, 0.0, 0.1), k * DT)
        batches.flat[k] = time.thread_time() - before
    assert np.percentile(batches, 99, axis=1).min() <= 1e-3


# --- The watchdog ---------------------------------------------------------------------


def spoil(name, value, now):
    """Return a measurement of a robot that stands, with one number replaced."""
    array = standing(now)._asdict()[name]
    array[1] = value
    return standing(now, **{name: array})


@pytest.mark.parametrize(
    ("measure", "fault"),
    [
        (
            partial(spoil, "joint_position", np.nan),
            "not finite: joint_position; a sensor",
        ),
        (
            partial(spoil, "joint_velocity", np.nan),
            "not finite: joint_velocity; a sensor",
        ),
        (partial(spoil, "up", np.nan), "not finite: up; a sensor"),
        (
            partial(spoil, "angular_velocity", -np.inf),
            "not finite: angular_velocity; a sensor",
        ),
        (lambda now: standing(now, time=np.nan), "not finite: time; a sensor"),
        (
            partial(spoil, "joint_position", 3.0),
            "range: FR_hip is at 3.00 rad, beyond -1.4 to 2.4; is it in degrees",
        ),
        (partial(spoil, "joint_position", 1e308), "range: FR_hip is at 1"),
        (
            partial(spoil, "joint_velocity", 300.0),
            "joint speed: FR_hip has 300 rad/s, more than 100; is it in deg/s",
        ),
        (
            partial(spoil, "angular_velocity", 80.0),
            "turning: angular_velocity has 80 rad/s, more than 50; is it in deg/s",
        ),
        (
            partial(spoil, "up", 1.0),
            "up: its length is 1.41, not 1; is it an acceleration",
        ),
        (partial(spoil, "up", -1e308), "up: its length is "),
        (
            lambda now: standing(now, up=-standing(now).up),
            "tilt: up is (-0.00, -0.00, -1.00), 180 deg off; ",
        ),
        (
            lambda now: standing(now, up=np.array([0.0, 0.94, -0.34])),
            "tilt: up is (0.00, 0.94, -0.34), 110 deg off; ",
        ),
        (
            lambda now: standing(now, time=now + 0.2),
            "clock: a measurement's time is 0.2 s ahead of the controller's; ",
        ),
        (
            lambda now: standing(now, time=1e3 * now),
            "clock: a measurement's time is 500 s ahead of the controller's; ",
        ),
        (
            lambda now: standing(now, time=time.time()),
            "clock: a measurement's time is 1.",
        ),
        (
            lambda now: standing(now, joint_position=STAND[:11]),
            "form: joint_position has the shape (11,), not (12,)",
        ),
        (
            lambda now: standing(now, up=[[0.0, 0.0, 1.0]]),
            "form: up has the shape (1, 3), not (3,)",
        ),
        (
            lambda now: standing(now, up=None),
            "form: up holds object, not 3 real numbers",
        ),
        (
            lambda now: standing(now, up=["0", "0", "1"]),
            "form: up holds <U1, not 3 real numbers",
        ),
        (
            lambda now: standing(now, up=np.array([0j, 0j, 1.0])),
            "form: up holds complex128, not 3 real numbers",
        ),
        (
            lambda now: standing(now, joint_velocity=[[0.0], [0.0, 0.0]]),
            "form: the measurement is no SensorReading",
        ),
        (lambda now: standing(now)[:3], "form: the measurement is no SensorReading"),
        (lambda now: 7, "form: the measurement is no SensorReading"),
        (lambda now: standing(now, time=None), "not finite: time; "),
    ],
    ids=lambda value: value.replace(" ", "_") if isinstance(value, str) else "",
)
def test_one_impossible_measurement_ends_in_a_commanded_stand(fresh, measure, fault):
    ran, now = run(fresh, 0.0, 0.5, standing)
    assert fresh.fault == ""
    assert np.abs(ran[-1].position - STAND).max() > 0.02  # it was on its way
    fresh.step(measure(now), (2.0, 0.0, 0.0), now)
    assert fresh.fault.startswith(fault)
    assert "\n" not in fresh.fault
    # all is well again; that is nothing to rely on
    led, _ = run(fresh, now, 1.5, standing)
    assert fresh.fault.startswith(fault)
    assert np.stack([targets.position for targets in led[-50:]]) == pytest.approx(
        np.tile(STAND, (50, 1)), abs=1e-12
    )
    assert not np.any(led[-1].velocity)
    assert np.isfinite([*led[0].position, *led[0].velocity]).all()


def test_the_way_to_the_stand_is_smooth(fresh):
    ran, now = run(fresh, 0.0, 0.5, standing)
    led, _ = run(fresh, now, 1.2, partial(spoil, "up", np.nan))
    position = np.stack([ran[-1].position, *(targets.position for targets in led)])
    largest = np.abs(ran[-1].position - STAND).max()
    time = fresh.watchdog.limits.stand_time
    # a cubic's greatest slope
    assert np.abs(np.diff(position, axis=0)).max() <= 1.5 * largest * DT / time + 1e-12
    velocity = np.stack([targets.velocity for targets in led])
    moving = slice(1, round(time / DT) - 1)
    slope = np.gradient(position[1:], DT, axis=0)[moving]
    # -2 h^2 of a cubic
    assert velocity[moving] == pytest.approx(
        slope, abs=2.0 * largest * DT**2 / time**3 + 1e-9
    )


def test_silence_of_fifty_milliseconds_ends_in_a_commanded_stand(fresh):
    _, now = run(fresh, 0.0, 0.5, standing)
    last = now - DT
    run(fresh, now, 0.045, lambda _: None)
    assert fresh.fault == ""
    led, _ = run(fresh, last + 0.051, 1.2, lambda _: None)
    assert (
        fresh.fault
        == "silence: no new measurement for 51 ms and 10 calls; is the link up, do its time and `now` go on?"
    )
    assert led[-1].position == pytest.approx(STAND, abs=1e-12)


def moving_to(position=0.0, velocity=0.0):
    """Return the patch of a reference motion whose targets differ from the stand by
    these."""
    pose = SimpleNamespace(
        position=STAND + position, velocity=np.full(12, velocity), torque=np.zeros(12)
    )
    return {"motion": {"return_value": pose}}


@pytest.mark.parametrize(
    ("wild", "fault"),
    [
        (
            moving_to(position=np.nan),
            "targets: FR_abad is told nan of the largest step or speed; is reference.npz",
        ),
        (
            moving_to(velocity=np.inf),
            "targets: FR_abad is told inf of the largest step or speed; is reference.npz",
        ),
        (
            moving_to(velocity=-101.0),
            "targets: FR_abad is told 1.01 of the largest step or speed; ",
        ),
        (
            {"motion": {"side_effect": ZeroDivisionError("float division by zero")}},
            "targets: they cannot be computed (ZeroDivisionError('float division by zero')); is the bundle",
        ),
        *(
            (
                {"_network": {"run.return_value": [np.full((1, 12), answer)]}},
                "network: its answer is not 12 finite numbers; is policy.onnx damaged?",
            )
            for answer in (np.nan, np.inf)
        ),
    ],
    ids=["not_finite", "endless", "fast", "no_number", "nan_network", "inf_network"],
)
def test_no_wild_target_leaves(fresh, monkeypatch, wild, fault):
    """Whatever the reference motion or the network says in mid-run, the joints are led
    to the stand."""
    _, now = run(fresh, 0.0, 0.3, standing)
    [(part, says)] = wild.items()
    sound = getattr(fresh, part)
    monkeypatch.setattr(fresh, part, mock.Mock(wraps=sound, **says))
    led, _ = run(fresh, now, 0.3, standing)
    assert fresh.fault.startswith(fault)
    assert np.isfinite(led).all()
    assert np.abs(np.diff([targets.position for targets in led], axis=0)).max() < 0.2
    assert led[-1].position == pytest.approx(STAND, abs=1e-12)


def test_a_target_that_steps_too_far_does_not_leave(fresh):
    """An action swings by 3 rad at most, and a motion that may be moves half a radian
    in a tick."""
    limit = fresh.watchdog.limits.target_step
    assert limit == pytest.approx(2.0 * 0.5 * 3.0 + 100.0 * DT)
    fresh.watchdog.check_targets(STAND + limit - 1e-9, np.zeros(12), STAND)
    with pytest.raises(
        Exception, match=r"targets: FR_abad is told 1\.\d* of the largest step"
    ):
        fresh.watchdog.check_targets(STAND + 1.01 * limit, np.zeros(12), STAND)


def calls(start, every, count):
    """Return the times of `count` calls of the controller, each with a measurement's
    time stamp."""
    return [(start + every * k, start + every * k) for k in range(count)]


SOUND = calls(0.0, DT, 60)
SILENT = "silence: no new measurement for "
CALLS = {
    "the same again": (
        SOUND + [(0.3 + DT * k, 0.295) for k in range(40)],
        f"{SILENT}5",
    ),
    "an older one": (
        [*SOUND, *((0.3 + DT * k, 0.265) for k in range(40))],
        f"{SILENT}5",
    ),
    "another clock's at first": (
        [(1e9, 100.0)],
        "clock: a new measurement's time is 1e+09 s old; ",
    ),
    **{
        f"{now} as the time": ([*SOUND, (now, 0.3)], "clock: `now` went from 0.295 to ")
        for now in (0.2, np.nan, "noon")
    },
    # Twenty calls without a new measurement: twice as many as 50 ms have at 200 Hz, and
    # as many as they may have.
    "a clock that stands still": (
        SOUND + 21 * [(0.295, 0.295)],
        f"{SILENT}0 ms and 21",
    ),
    "not yet": (SOUND + 20 * [(0.295, 0.295)], ""),
    # At 400 Hz, with measurements that come every 45 ms.
    "twice as often": (
        [(k * DT / 2.0, None if k % 18 else k * DT / 2.0) for k in range(200)],
        "",
    ),
    # A clock that all but stands still: each stamp is new, and the windows of the
    # watchdog would never end.
    "stamps that creep": (SOUND + calls(0.3, 1e-6, 260), "rate: `step` is called "),
    # Before the first measurement the controller may wait for as long as it likes.
    "an hour's wait": ([(0.0, None), *calls(3600.0, DT, 60)], ""),
    "a jump of an hour": (
        [*SOUND, (3600.3, 3600.3)],
        "clock: `now` went from 0.295 to 3600.3 s between two calls; use a clock that",
    ),
    **{
        f"{1.0 / every:.4g} Hz": (
            calls(0.0, every, round(1.5 / every)),
            f"rate: `step` is called {1.0 / every:.4g} times a",
        )
        for every in (0.001, 0.02, 0.06, 0.3)  # from 0.06 s on later than `silence`
    },
    # What is measured after a pause is new, and there are more than half of the calls.
    **{
        f"pauses of {pause} s": (
            [call for n in range(times) for call in calls(n * (pause + 0.3), DT, 60)],
            "",
        )
        for pause, times in ((0.06, 8), (0.2, 6), (0.45, 2))
    },
}


@pytest.mark.parametrize("name", CALLS)
def test_clocks_stamps_and_rates_are_watched(fresh, name):
    told, fault = CALLS[name]
    for k, (now, stamp) in enumerate(told):
        position = STAND + 1e-9 * k
        given = None if stamp is None else standing(stamp, joint_position=position)
        assert np.isfinite(fresh.step(given, None, now)).all()
    assert fresh.fault[: len(fault) or None] == fault


@pytest.mark.parametrize(
    "kind",
    [list, tuple, lambda array: array.astype(np.longdouble).astype(float)],
    ids=["list", "tuple", "array"],
)
def test_lists_and_other_dtypes_are_read_as_arrays(fresh, kind):
    expected, now = run(fresh, 0.0, 0.1, standing)
    fresh.step(standing(now, up=[0, 0, 1]), None, now)  # integers
    assert fresh.fault == ""
    fresh.reset()
    found, _ = run(
        fresh, 0.0, 0.1, lambda now: [*map(kind, standing(now)[:4]), np.float64(now)]
    )
    np.testing.assert_array_equal(found, expected)


def test_a_driver_may_use_its_arrays_again(fresh):
    """A measurement is copied: the next one may come in the same arrays."""
    arrays = standing(0.0)[:4]
    fresh.step(SensorReading(*arrays, time=0.0), None, 0.0)
    arrays[0][:] = np.nan
    assert np.isfinite(fresh.step(None, (1.0, 0.0, 0.0), DT).position).all()
    assert fresh.fault == ""


def test_a_few_lost_measurements_are_bridged(fresh):
    measure = following(fresh)
    run(fresh, 0.0, 3.0, lambda now: (measure(now), None)[round(now / DT) % 8 > 0])
    assert fresh.fault == ""


def test_reset_is_the_way_on(fresh):
    run(fresh, 0.0, 0.1, partial(spoil, "up", np.nan))
    assert fresh.fault
    fresh.reset()
    again, _ = run(fresh, 0.2, 0.5, standing)
    fresh.reset()
    assert fresh.fault == ""
    assert [t.position.tolist() for t in run(fresh, 5.1, 0.5, standing)[0]] == [
        t.position.tolist() for t in again
    ]


@pytest.mark.parametrize(
    "silence",
    [None, (np.nan, 0.0, 0.0), (1.0, 0.0), "full speed", [[1.0], 2.0, 0.0], 3.0],
    ids=["none", "not_finite", "two_numbers", "words", "ragged", "one_number"],
)
def test_a_silent_operator_brakes_the_robot_to_a_stand(fresh, silence):
    measure = following(fresh)
    _, now = run(fresh, 0.0, 0.5, measure, (2.0, 0.1, 0.2))
    _, now = run(fresh, now, 0.5, measure, silence)
    assert fresh.fault == ""
    speed = np.hypot(2.0, 0.1) - fresh.watchdog.limits.braking * 0.5
    assert np.hypot(*fresh.command[:2]) == pytest.approx(speed, abs=1e-4)
    run(fresh, now, 2.0, measure, silence)
    assert fresh.command.tolist() == [0.0, 0.0, 0.0]


def test_a_command_is_kept_within_what_was_trained(fresh, shipped):
    commands = shipped.card.env.commands
    # a launch takes its time
    run(fresh, 0.0, 6.5, following(fresh), (99.0, -99.0, 99.0))
    most = commands.max_forward, -commands.max_lateral, commands.max_yaw_rate
    assert fresh.command == pytest.approx(most)


def test_before_the_first_measurement_it_stands(fresh):
    waited, now = run(fresh, 0.0, 1.0, lambda _: None)
    assert all((targets.position == STAND).all() for targets in waited)
    run(fresh, now, 0.2, standing)
    assert fresh.fault == ""
