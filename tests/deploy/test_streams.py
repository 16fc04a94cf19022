"""Hundreds of streams of wrong sensors: no crash, no target outside a joint's range, a
fault within its time.

Three runs are recorded in simulation, with lost measurements and the noise of training,
and a robot that hangs and is swung by hand. A stream is what the controller was given
in one of these, made wrong from a random tick on; the whole controller of the bundle
runs, its network as well. Faults and their times are read from the table of
docs/deploy.md.
"""

import os
import re
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from bp2_rl.robot.bp2 import ABAD_RANGE, HIP_RANGE, KNEE_RANGE

DT = 0.005
TICKS = 420
STAND = np.array([0.0, 0.62, -1.24] * 4)
RANGE = np.array((ABAD_RANGE, HIP_RANGE, KNEE_RANGE) * 4)
Q, QD, UP, GYRO = slice(0, 12), slice(12, 24), slice(24, 27), slice(27, 30)
NOISE = np.repeat((0.01, 0.3, 0.01, 0.1), (12, 12, 3, 3))  # of training
PAGE = Path(__file__).parents[2] / "docs" / "deploy.md"
ROW = re.compile(r"^\| `([a-z ]+)` \|.*\| (at once|[\d.]+ s) \|$", re.MULTILINE)
TIMES = {
    name: 0.0 if text == "at once" else float(text.removesuffix(" s"))
    for name, text in ROW.findall(PAGE.read_text())
}


# --- What goes wrong: (random, values, stamp, time since it began, values when it began


def times(place, factor, rng, values, stamp, since, then):
    values[place] *= factor
    return values, stamp


def joint_times(joints, factor, both, rng, values, stamp, since, then):
    joint = rng.choice(joints)
    values[[joint, 12 + joint] if both else 12 + joint] *= factor
    return values, stamp


def stamped(make, rng, values, stamp, since, then):
    return values, make(rng, stamp, round(since, 6))


def repeated(place, rng, values, stamp, since, then):
    values[place] = then[place]
    return values, stamp


def impossible(value, rng, values, stamp, since, then):
    values[rng.integers(30)] = value
    return values, stamp


def exchanged(rng, values, stamp, since, then):
    values[:24] = values[:24].reshape(2, 4, 3)[:, [1, 0, 2, 3]].ravel()
    return values, stamp


def turned_axes(rng, values, stamp, since, then):
    values[GYRO] = values[[28, 27, 29]]
    return values, stamp


def noise_at(since):
    """Return normal numbers that are the same in every stream at a time."""
    return np.random.default_rng(round(1e6 * since)).normal(size=30)


def noisy_up(rng, values, stamp, since, then):
    """Freeze the up vector but for an IMU's noise."""
    values[UP] = (then + NOISE * noise_at(since))[UP]
    return values, stamp


def noise_for_gyro(rng, values, stamp, since, then):
    values[GYRO] = 0.1 * noise_at(since)[:3]
    return values, stamp


def one_encoder(size, rng, values, stamp, since, then):
    """Freeze one joint's encoder but for `size` times an encoder's noise."""
    joint, noise = rng.choice(SWINGING), size * noise_at(since)
    values[[joint, 12 + joint]] = then[joint] + 0.01 * noise[0], 0.3 * noise[1]
    return values, stamp


def formless(rng, values, stamp, since, then):
    parts = [values[Q], values[QD], values[UP], values[GYRO], stamp]
    which = int(rng.integers(4))
    wrongs = (
        None,
        [],
        3.0,
        "up",
        parts[which][:-1],
        [*parts[which], 0.0],
        parts[which][None],
        parts[which].astype(str),
        parts[which].astype(complex),
        [[1.0], [2.0, 3.0]],
        [None] * len(parts[which]),
        {"value": 1},
        object(),
    )
    choice = int(rng.integers(len(wrongs) + 3))
    if choice >= len(wrongs):
        return ("a string", {"time": stamp}, parts[:3])[choice - len(wrongs)], None
    parts[which] = wrongs[choice]
    return tuple(parts), None


def noise_of_any_size(rng, values, stamp, since, then):
    return values + 10.0 ** rng.uniform(2.5, 300.0) * rng.normal(size=30), stamp


def silent(rng, values, stamp, since, then):
    return None, None


SWINGING = [1, 2, 4, 5, 7, 8, 10, 11]  # hips and knees
HIPS, KNEES = [1, 4, 7, 10], [2, 5, 8, 11]
CLOCK, FORM, FINITE, GAIT = (
    {"clock"},
    {"form"},
    {"not finite"},
    {"joint velocity", "joint speed"},
)
STOOD_STILL = partial(stamped, lambda rng, stamp, since: round(stamp - since, 6))
WRONGS = {
    "angles in degrees": (partial(times, Q, 57.3), {"range"}),
    "joint speeds in deg/s": (partial(times, QD, 57.3), GAIT),
    "joint speeds in rpm": (partial(times, QD, 9.55), GAIT),
    "joint speeds before the gear": (partial(times, QD, 6.0), GAIT),
    "joint speeds a tenth": (partial(times, QD, 0.1), GAIT),
    "joint speeds of zero": (partial(times, QD, 0.0), GAIT),
    "gyro in deg/s": (partial(times, GYRO, 57.3), {"gyro", "turning"}),
    "gyro of zero": (partial(times, GYRO, 0.0), {"frozen", "gyro"}),
    "acceleration": (partial(times, UP, 9.81), {"up"}),
    "gravity": (partial(times, UP, -1.0), {"tilt"}),
    "speed's sign": (partial(joint_times, SWINGING, -1.0, False), GAIT),
    "speeds' signs": (partial(times, QD, -1.0), GAIT),
    "a hip's sign": (
        partial(joint_times, HIPS, -1.0, True),
        {"off target", "opposed", "range", "joint velocity"},
    ),
    "a knee's sign": (partial(joint_times, KNEES, -1.0, True), {"range"}),
    "gyro's sign": (partial(times, GYRO, -1.0), {"gyro"}),
    "gyro's axes": (turned_axes, {"gyro"}),
    "up's sign": (partial(times, slice(24, 26), -1.0), {"gyro"}),
    "legs exchanged": (exchanged, {"opposed", "off target", *GAIT}),
    "stamps ahead": (
        partial(
            stamped, lambda rng, stamp, since: stamp + rng.choice((0.02, 0.2, 5.0))
        ),
        CLOCK,
    ),
    "stamps behind": (
        partial(
            stamped, lambda rng, stamp, since: stamp - rng.choice((0.06, 1.0, 1e6))
        ),
        {"silence"},
    ),
    "stamps of milliseconds": (
        partial(stamped, lambda rng, stamp, since: 1e3 * stamp),
        CLOCK,
    ),
    "stamps since the epoch": (
        partial(stamped, lambda rng, stamp, since: time.time()),
        CLOCK,
    ),
    "stamps that stand still": (STOOD_STILL, {"silence"}),
    "stamps that go back": (
        partial(stamped, lambda rng, stamp, since: stamp - 2.0 * since),
        {"silence"},
    ),
    "no stamps": (
        partial(
            stamped,
            lambda rng, stamp, since: ("now", np.nan, np.inf, [], {})[rng.integers(5)],
        ),
        FINITE,
    ),
    "forms": (formless, FORM),
    "all frozen": (partial(repeated, slice(0, 30)), {"frozen", "gyro", *GAIT}),
    "up frozen": (partial(repeated, UP), {"frozen"}),
    "gyro frozen": (partial(repeated, GYRO), {"frozen", "gyro"}),
    "encoders frozen": (partial(repeated, slice(0, 24)), {"frozen", *GAIT}),
    "an encoder frozen": (partial(one_encoder, 0.0), {"frozen", *GAIT}),
    "an encoder's noise": (partial(one_encoder, 1.0), {"still", "off target", *GAIT}),
    "gyro's noise": (noise_for_gyro, {"gyro"}),
    "gyro halved": (partial(times, GYRO, 0.5), {"gyro"}),
    "gyro doubled": (partial(times, GYRO, 2.0), {"gyro"}),
    "up's noise": (noisy_up, {"gyro"}),
    "silence": (silent, {"silence"}),
    "NaN": (partial(impossible, np.nan), FINITE),
    "infinity": (partial(impossible, -np.inf), FINITE),
    "huge": (partial(impossible, 1e300), {"range", "joint speed", "turning", "up"}),
    "noise": (noise_of_any_size, {"range", "joint speed", "turning", "up"}),
}
SEEN_IN_A_SWING = {
    "gyro's axes",
    "up's sign",
    "gyro halved",
    "gyro doubled",
    "gyro's noise",
    "up's noise",
}
"""The wrongs that need more of a swing of the trunk than a run on flat ground has."""
SWUNG = 3  # the recorded stream of it
MIXED = 3
"""Streams with two wrongs at once, for each of the wrongs."""
SEEDS = int(os.environ.get("BP2_STREAMS", "8"))
"""Streams of each wrong: with BP2_STREAMS=25 more than a thousand in all."""


# --- The streams ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def runs(onboard, bundle, controller, rehearse):
    """Record three runs; return the controller's inputs, (measurement, command) of each
    tick."""
    recorded = []
    for seed, (robot, speed, sideways, turn) in enumerate(
        (
            ("built", 8.0, 0.0, 0.0),
            ("built", 2.0, 0.2, 0.3),
            ("ideal", 12.0, 0.0, 0.1),
            ("built", 0.0, 0.0, 0.0),
        )
    ):
        plan = onboard.robot.RehearsalPlan(
            speed + 1e-6,
            acceleration=100.0,
            hold=TICKS * DT - (speed + 1e-6) / 100.0,
            seed=seed,
        )
        world = onboard.robot.RehearsalWorld(bundle, robot, plan)
        noisily = partial(
            hear, np.random.default_rng(seed), np.array([0.0, sideways, turn])
        )
        swinging = partial(swing, world.robot) if seed == SWUNG else None
        ticks = rehearse(world, controller, noisily, swinging)
        assert controller.fault == ""
        recorded.append([tick[:2] for tick in ticks])
    return recorded


def hear(rng, aside, kind, values):
    """Add noise to sensor values, and an offset to operator values."""
    return values + (NOISE * rng.normal(size=30) if kind == b"S" else aside)


def swing(robot, now):
    """Hold the trunk in the air and roll and pitch it by some 20 deg."""
    robot.model.opt.gravity[:] = 0.0
    turn, rate = 0.5 * np.sin(4.0 * now), 2.0 * np.cos(4.0 * now)
    axis = np.array([0.96, 0.28, 0.0])
    robot.data.qpos[:7] = (
        0.0,
        0.0,
        2.0,
        np.cos(turn / 2.0),
        *(np.sin(turn / 2.0) * axis),
    )
    robot.data.qvel[:6] = 0.0, 0.0, 0.0, *(rate * axis)


def play(controller, ticks, wrongs, begins, rng):
    """Play a run with wrong sensors; return the targets of all ticks, the controller's
    fault, and the time from the wrong's beginning to the fault."""
    controller.reset()
    targets, found, then = [], np.inf, None
    seeds = rng.integers(2**32, size=len(wrongs))
    for k, (measurement, command) in enumerate(ticks):
        given, now = measurement, DT * k
        if k >= begins and measurement is not None:
            values, stamp = np.concatenate(measurement[:4]), measurement.time
            then = values if then is None else then
            # which joint is wrong stays
            for wrong, seed in zip(wrongs, seeds, strict=True):
                if stamp is not None:
                    since = DT * (k - begins)
                    values, stamp = wrong(
                        np.random.default_rng(seed), values.copy(), stamp, since, then
                    )
            given = (
                values
                if stamp is None
                else (values[Q], values[QD], values[UP], values[GYRO], stamp)
            )
        targets.append(controller.step(given, command, now))
        if controller.fault and found == np.inf:
            found = now - DT * begins
        if now - DT * begins > found + 0.11:
            break
    return np.array(targets), controller.fault, found


def check_targets(controller, targets):
    position, velocity = targets[:, 0], targets[:, 1]
    assert np.isfinite(targets).all()
    assert (position >= RANGE[:, 0]).all()
    assert (position <= RANGE[:, 1]).all()
    # rad/s, what a gait or the way to a stand asks for
    assert np.abs(velocity).max() <= 40.0
    if controller.fault:
        assert position[-1] == pytest.approx(STAND, abs=1e-12)
        assert not velocity[-1].any()


@pytest.mark.parametrize("name", WRONGS)
def test_a_wrong_stream_ends_in_its_fault_in_time(controller, runs, name):
    wrong, faults = WRONGS[name]
    runs = runs[SWUNG:] if name in SEEN_IN_A_SWING else runs[:SWUNG]
    longest = max(TIMES[fault] for fault in faults)
    for seed in range(SEEDS):
        rng = np.random.default_rng([seed, *name.encode()])
        begins = int(rng.integers(40, 90))
        targets, fault, after = play(
            controller, runs[seed % len(runs)], [wrong], begins, rng
        )
        found = fault.partition(":")[0]
        assert found in faults, (seed, fault)
        # a tick; and two measurements may be lost
        assert after <= longest + 3 * DT, (seed, fault)
        check_targets(controller, targets)


@pytest.mark.parametrize("name", WRONGS)
def test_two_wrongs_end_in_a_fault_in_time(controller, runs, name):
    for seed in range(MIXED):
        rng = np.random.default_rng([seed, *name.encode(), 2])
        other = rng.choice([other for other in WRONGS if other != name])
        wrongs, faults = zip(WRONGS[name], WRONGS[other], strict=True)
        begins = int(rng.integers(40, 90))
        targets, fault, after = play(controller, runs[SWUNG], wrongs, begins, rng)
        longest = max(
            TIMES[fault] for fault in set.union(*faults) | {fault.partition(":")[0]}
        )
        assert after <= longest + 3 * DT, (seed, other, fault)
        check_targets(controller, targets)


@pytest.mark.parametrize("run", range(4))
def test_a_sound_stream_is_no_fault(controller, runs, run):
    """With further measurements lost, and with times that jitter, come late or are a
    little ahead."""
    rng = np.random.default_rng(run)
    drop = lambda rng, values, stamp, since, then: (None, None)  # noqa: E731
    for kind in range(4):
        late = partial(
            stamped,
            lambda _, stamp, since, kind=kind: (
                stamp + (0.0, -0.02, 0.004, rng.uniform(-0.004, 0.004))[kind]
            ),
        )
        targets, fault, _ = play(controller, runs[run], [late], 100, rng)
        assert fault == ""
        check_targets(controller, targets)
    thinned = [
        (None if rng.random() < 0.2 else measurement, command)
        for measurement, command in runs[run]
    ]
    assert play(controller, thinned, [drop], TICKS, rng)[1] == ""
