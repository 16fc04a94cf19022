"""Random draws of a robot, against robots that were built with the drawn values, and
against the ranges of training."""

import dataclasses

import numpy as np
import pytest
from runs import no_action, run_one

from bp2_rl.env.randomization import DESIGN_FACTORS
from bp2_rl.robot import bp2
from bp2_rl.robot.hardware import BUILT, IDEAL
from bp2_rl.robot.model import foot_geom_ids
from bp2_rl.robot.named import find_robot
from bp2_rl.settings.env import EnvConfig, RandomizationConfig
from bp2_rl.simulation import simulator
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.simulator import RobotSetup
from bp2_rl.simulation.world import Draw

SCHEDULE = Ramp(1.0, hold=0.2)
RANGES = RandomizationConfig()
VARIED = RandomizationConfig(
    no_load_speed=(0.8, 1.2),
    armature=(0.5, 2.0),
    spring_stiffness=(0.7, 1.3),
    spring_damping=(0.0, 20.0),
)
NOTHING = dict.fromkeys(("friction", "mass", "strength", "gains", "losses"), (1.0, 1.0))


def exactly(**drawn):
    """Return a draw of random robots in which just these values are drawn, with
    certainty."""
    factors = NOTHING | {name: (value, value) for name, value in drawn.items()}
    return Draw(
        RandomizationConfig(
            **{"latency": (0.0, 0.0), **factors}, com_offset=0.0, push_velocity=0.0
        ),
        0,
        0,
    )


def lossier(factor):
    losses = BUILT.losses
    return dataclasses.replace(
        BUILT,
        losses=dataclasses.replace(
            losses,
            latency=0.0,
            drag_area=losses.drag_area * factor,
            gear_efficiency=1.0 - factor * (1.0 - losses.gear_efficiency),
            joint_friction=losses.joint_friction * factor,
            joint_viscosity=losses.joint_viscosity * factor,
            spring_friction=losses.spring_friction * factor,
            current_lag=losses.current_lag * factor,
            bus_power_out=losses.bus_power_out * factor,
            bus_power_in=losses.bus_power_in * factor,
            bus_sag=losses.bus_sag * factor,
        ),
    )


def scaled(hardware, factor, *names):
    return hardware.changed(
        **{name: factor * hardware.parameter(name) for name in names}
    )


@pytest.mark.parametrize(
    ("hardware", "drawn", "built_so", "stiffer"),
    [
        (IDEAL, {"mass": 1.1}, dataclasses.replace(IDEAL, mass_scale=1.1), 1.0),
        (
            IDEAL,
            {"friction": 0.3},
            dataclasses.replace(IDEAL, friction=0.3 * IDEAL.friction),
            1.0,
        ),
        (
            IDEAL,
            {"latency": 0.008},
            dataclasses.replace(
                IDEAL, losses=dataclasses.replace(IDEAL.losses, latency=0.008)
            ),
            1.0,
        ),
        (IDEAL, {"gains": 1.2}, IDEAL, 1.2),
        (BUILT, {"losses": 1.5}, lossier(1.5), 1.0),
        *(
            (IDEAL, {name: factor}, scaled(IDEAL, factor, *built_so), 1.0)
            for name, factor, *built_so in (
                ("no_load_speed", 0.5, "no_load_speed", "corner_speed"),
                ("armature", 3.0, "rotor_inertia"),
                ("spring_stiffness", 0.75, "spring_stiffness"),
                ("spring_damping", 10.0, "spring_damping"),
            )
        ),
    ],
    ids=(
        *("mass", "friction", "latency", "gains", "losses"),
        *("no-load speed", "armature", "spring stiffness", "spring damping"),
    ),
)
def test_a_drawn_robot_runs_as_one_built_so(
    hardware, drawn, built_so, stiffer, monkeypatch
):
    # a drawn robot starts from the stand of that as designed
    monkeypatch.setattr(simulator, "SETTLING_TIME", 0.0)
    config = EnvConfig()
    control = config.control
    other = dataclasses.replace(
        config,
        control=dataclasses.replace(
            control,
            stiffness=stiffer * control.stiffness,
            damping=stiffer * control.damping,
        ),
    )
    as_drawn = run_one(
        no_action, SCHEDULE, config, hardware=hardware, drawn=exactly(**drawn)
    )
    as_built = run_one(no_action, SCHEDULE, other, hardware=built_so)
    designed = run_one(no_action, SCHEDULE, config, hardware=hardware)
    apart = np.max(np.abs(as_drawn.qpos - as_built.qpos))
    assert apart < 1e-6  # factors are drawn in float32
    assert np.max(np.abs(as_drawn.qpos - designed.qpos)) > 0.05
    assert as_drawn.mass == pytest.approx(as_built.mass, rel=1e-6)


def test_each_is_drawn_from_the_ranges_of_training_and_by_itself():
    draws = [Draw(RANGES, 3, number) for number in range(40)]
    drawn = [draw.values(BUILT, 18) for draw in draws]
    for name in ("mass", "strength", "latency", "losses"):
        low, high = getattr(RANGES, name)
        values = np.stack([getattr(one, name) for one in drawn])
        assert np.all((values >= low - 1e-6) & (values <= high + 1e-6)), name
        if high > low:
            assert np.ptp(values) > 0.8 * (high - low), name
            assert len(np.unique(values)) == values.size, name
    assert draws[0].values(BUILT).latency == drawn[0].latency
    assert Draw(RANGES, 4, 0).values(BUILT).friction != drawn[0].friction
    assert len({draw.noise_seed for draw in draws}) == 40


def test_the_model_has_what_was_drawn_and_its_legs_keep_their_friction():
    draw = Draw(RANGES, 0, 0)
    before = RobotSetup(EnvConfig(hardware=BUILT)).model()
    after = RobotSetup(EnvConfig(hardware=BUILT), drawn=draw).model()
    drawn = draw.values(BUILT, after.nbody)
    np.testing.assert_allclose(after.body_mass, before.body_mass * drawn.mass)
    feet = [after.geom("floor").id, *foot_geom_ids(after)]
    np.testing.assert_allclose(after.geom_friction[feet, 0], drawn.friction)
    others = np.setdiff1d(np.arange(after.ngeom), feet)
    np.testing.assert_array_equal(
        after.geom_friction[others], before.geom_friction[others]
    )
    assert bp2.LEG_FRICTION in after.geom_friction[others, 0]
    np.testing.assert_allclose(after.body_subtreemass[0], np.sum(after.body_mass))


def test_the_model_and_the_motors_have_the_numbers_of_the_design_that_were_drawn():
    config = EnvConfig(hardware=dataclasses.replace(BUILT, braking_speed=60.0))
    before, seen = RobotSetup(config), []
    designed = before.model()
    for number in range(20):
        draw = Draw(VARIED, 3, number)
        robot = dataclasses.replace(before, drawn=draw)
        model, drawn = robot.model(), draw.values(config.hardware)
        for field, factor in (
            ("jnt_stiffness", drawn.spring_stiffness),
            ("dof_damping", drawn.spring_damping),
            ("dof_armature", drawn.armature),
        ):
            np.testing.assert_allclose(
                getattr(model, field), factor * getattr(designed, field)
            )
        motors = robot.motors()
        for name in ("corner_speed", "no_load_speed", "braking_speed"):
            np.testing.assert_allclose(
                getattr(motors, name),
                drawn.no_load_speed * getattr(before.motors(), name),
            )
        assert motors.peak_torque == before.motors().peak_torque
        seen.append([float(getattr(drawn, name)) for name in DESIGN_FACTORS])
        plain = Draw(RANGES, 3, number).values(config.hardware)
        assert [getattr(plain, name) for name in DESIGN_FACTORS] == [None] * 4
        assert plain.friction == drawn.friction  # no other draw has changed
        np.testing.assert_array_equal(plain.losses, drawn.losses)
    low, high = np.transpose([getattr(VARIED, name) for name in DESIGN_FACTORS])
    assert np.all((np.array(seen) >= low - 1e-6) & (np.array(seen) <= high + 1e-6))
    assert np.all(np.ptp(seen, axis=0) > 0.7 * (high - low))
    # each by itself
    assert np.max(np.abs(np.corrcoef(seen, rowvar=False) - np.eye(4))) < 0.7


def test_friction_does_not_throw_a_light_rotor_back():
    for factor, held in ((0.5, 0.5), (1.0, 1.0), (2.0, 1.0)):
        setup = RobotSetup(EnvConfig(hardware=BUILT))
        drawn = dataclasses.replace(setup, drawn=exactly(armature=factor)).resistance()
        designed = setup.resistance()
        assert drawn is not None
        assert designed is not None
        assert drawn.joint_hold == pytest.approx(held * designed.joint_hold)
        assert drawn.joint_friction == pytest.approx(designed.joint_friction)


@pytest.mark.parametrize("ranges", [RANGES, VARIED], ids=["designed", "varied"])
@pytest.mark.parametrize("name", ["go1", "spot"])
def test_another_robot_is_drawn_too(name, ranges):
    setup = RobotSetup(EnvConfig(hardware=find_robot(name)), drawn=Draw(ranges, 0, 0))
    designed = dataclasses.replace(setup, drawn=None).model()
    masses = setup.model().body_mass[1:] / designed.body_mass[1:]
    assert len(np.unique(masses)) == designed.nbody - 1
    assert np.all((masses >= RANGES.mass[0]) & (masses <= RANGES.mass[1]))


def test_a_weak_robot_has_weak_motors():
    setup = RobotSetup(EnvConfig(hardware=BUILT), drawn=exactly(strength=0.7))
    np.testing.assert_allclose(np.asarray(setup.motors().strength), 0.7, rtol=1e-6)


def test_pushes_come_as_often_and_as_hard_as_in_training():
    pushes = [
        push for number in range(100) for push in Draw(RANGES, 0, number).pushes(20.0)
    ]
    # three deviations
    assert len(pushes) == pytest.approx(100 * 20.0 / RANGES.push_interval, rel=0.15)
    kicks = np.array([(push.forward, push.left) for push in pushes])
    assert np.max(np.abs(kicks)) <= RANGES.push_velocity
    np.testing.assert_allclose(
        np.std(kicks, axis=0), RANGES.push_velocity / np.sqrt(3.0), rtol=0.1
    )
    assert Draw(dataclasses.replace(RANGES, push_velocity=0.0), 0, 0).pushes(20.0) == ()


def test_where_nothing_is_drawn_there_is_no_noise_and_no_push():
    draw = Draw(dataclasses.replace(RANGES, enabled=False), 0, 0)
    assert draw.pushes(20.0) == ()
    assert draw.noise_seed is None
    assert float(draw.values(BUILT).friction) == pytest.approx(BUILT.friction)
