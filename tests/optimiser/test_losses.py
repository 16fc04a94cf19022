"""Losses of a built robot: the laws of the model and of its verifier against closed
forms, and trots with losses."""

import dataclasses
import json

import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.optimiser import sagittal, verifier_laws
from bp2_rl.optimiser.collocation import STANDARD, cold_guess, solve
from bp2_rl.optimiser.planar import PlanarModel
from bp2_rl.optimiser.problem import Problem, motor_coordinates
from bp2_rl.optimiser.sagittal import ca
from bp2_rl.optimiser.solution import Solution, load_solution, save_solution
from bp2_rl.optimiser.transcription import transcribe
from bp2_rl.optimiser.verify import LIMITS, _over_stride, failures, verify
from bp2_rl.paper.trajectories.variants import loss_variants
from bp2_rl.robot import bp2
from bp2_rl.robot.conventions import LEGS
from bp2_rl.robot.hardware import BUILT, IDEAL, PARTS, HardwareSpec, Losses

MOTORS = motor_coordinates(LEGS)
STALL = 120.0 / (1.0 - 14.7 / 21.4)  # Nm, where Table S1's falling line begins


def robot(**losses: float) -> HardwareSpec:
    return HardwareSpec(losses=Losses(**losses))


PAYING = {
    "drag": robot(drag_area=0.4, headwind=3.0),
    "gear": robot(gear_efficiency=0.85),
    "joint friction": robot(joint_friction=3.0, joint_viscosity=0.1),
    "slide friction": robot(spring_friction=40.0),
    "bus power": robot(bus_power_out=2.5e3, bus_power_in=0.5e3),
    "bus sag": robot(bus_sag=0.1),
    "rebound stop": HardwareSpec(rebound_stiffness=80e3, rebound_damping=100.0),
    "braking limit": HardwareSpec(braking_speed=bp2.NO_LOAD_SPEED),
}


# --- The laws -------------------------------------------------------------------------
@pytest.mark.parametrize(("legs", "share"), [(LEGS, 1.0), (("F", "H"), 0.5)])
@pytest.mark.parametrize(("speed", "force"), [(10.0, -20.28), (-3.0, 0.0), (-8.0, 3.0)])
def test_air_presses_on_the_trunk_with_the_square_of_its_speed(
    legs, share, speed, force
):
    """1/2 x 1.2 x 0.2 x 13^2 = 20.28 N with 3 m/s of headwind; slower than a tailwind
    the trunk is pushed."""
    hardware = robot(drag_area=0.2, headwind=3.0)
    model, n = sagittal.build_model(legs, hardware), 3 + 3 * len(legs)
    v = np.eye(n)[0] * speed
    passive = np.array(
        model.passive(np.zeros(n), v, sagittal.design_vector(hardware))
    ).ravel()
    assert passive[0] == pytest.approx(share * force, rel=1e-12)
    assert verifier_laws.drag(hardware, share, v[:1])[0] == pytest.approx(
        share * force, rel=1e-12
    )


@pytest.mark.parametrize("qd", [5.0, -5.0])
@pytest.mark.parametrize("tau", [100.0, -100.0])
def test_gear_and_joint_take_their_part_against_the_motion_driving_and_braking(qd, tau):
    """2 Nm dry, .05 x 5 viscous, 8 % of 100 Nm: ten roundings from zero speed and more,
    so to 1e-6."""
    hardware = robot(gear_efficiency=0.92, joint_friction=2.0, joint_viscosity=0.05)
    left = tau - np.sign(qd) * (2.0 + 0.25 + 8.0)
    model, v = sagittal.build_model(LEGS, hardware), np.zeros(15)
    v[MOTORS] = qd
    motors = np.full(8, tau)
    resistance = np.array(
        model.resistance(v, motors, sagittal.design_vector(hardware))
    ).ravel()
    np.testing.assert_allclose(motors - resistance, left, rtol=1e-6)
    np.testing.assert_allclose(
        verifier_laws.joint_torque(hardware, v[MOTORS], motors), left, rtol=1e-6
    )


def test_hip_and_knee_are_each_slowed_by_their_own_friction():
    """2 Nm + .1 x 5 at a hip and 3 Nm + .4 x 5 at a knee; ten roundings from zero
    speed, so to 1e-6."""
    hardware = HardwareSpec(
        losses=Losses(joint_friction=(9.0, 2.0, 3.0), joint_viscosity=(9.0, 0.1, 0.4))
    )
    model, v, motors = (
        sagittal.build_model(LEGS, hardware),
        np.zeros(15),
        np.full(8, 50.0),
    )
    v[MOTORS] = 5.0
    resistance = np.array(
        model.resistance(v, motors, sagittal.design_vector(hardware))
    ).ravel()
    np.testing.assert_allclose(resistance, [2.5, 5.0] * 4, rtol=1e-6)
    np.testing.assert_allclose(
        verifier_laws.joint_torque(hardware, v[MOTORS], motors),
        [47.5, 45.0] * 4,
        rtol=1e-6,
    )


def test_nothing_resists_a_joint_at_rest():
    model, p = sagittal.build_model(LEGS, BUILT), sagittal.design_vector(BUILT)
    assert np.all(np.array(model.resistance(np.zeros(15), np.full(8, 50.0), p)) == 0.0)


@pytest.mark.parametrize("rate", [2.0, -2.0])
def test_a_spring_that_tops_out_meets_slide_and_stop(rate):
    """3 cm beyond its rest length: the spring's 6 kN/m and the stop's 150, 10 + 100 N
    s/m, and 20 N of the slide.

    The stop is rounded over 5 mm: at six times that its depth is 0.7 % more, its
    damping's share 0.7 % less.
    """
    q, v = np.zeros(15), np.zeros(15)
    q[5], v[5] = -0.03, rate
    expected = 156e3 * 0.03 - 110.0 * rate - np.sign(rate) * 20.0
    passive = sagittal.build_model(LEGS, BUILT).passive(
        q, v, sagittal.design_vector(BUILT)
    )
    assert float(passive[5]) == pytest.approx(expected, rel=0.01)


def test_the_bus_gives_what_motors_deliver_and_their_heat():
    """At standstill with peak torque: (120 / 383.3)^2 of 383.3 Nm x 21.4 rad/s; turning
    at 10 rad/s 1200 W more."""
    qd, tau = np.zeros((2, 8)), np.zeros((2, 8))
    tau[:, 0], qd[1, 0] = 120.0, 10.0
    heat = 120.0**2 * 21.4 / STALL
    np.testing.assert_allclose(
        verifier_laws.bus_power(IDEAL, qd, tau), [heat, heat + 1200.0], rtol=1e-12
    )
    limited = robot(bus_power_out=1500.0, bus_power_in=200.0)
    assert verifier_laws.bus_excess(
        limited, 1.0, np.array([1600.0, 0.0])
    ) == pytest.approx(100.0)
    assert verifier_laws.bus_excess(
        limited, 0.5, np.array([-150.0, 0.0])
    ) == pytest.approx(50.0)
    assert verifier_laws.bus_excess(IDEAL, 1.0, np.array([1e6, -1e6])) == 0.0


def test_the_judge_s_envelope_sags_and_ends_braking():
    """A motor at 20 rad/s has 25 Nm to drive with; each kW drawn, at 5 % a kW, takes 5
    % of the stall torque off."""
    qd, tau = np.full((1, 8), 20.0), np.zeros((1, 8))
    tau[0, 0] = STALL * (1.0 - 20.0 / 21.4) + 3.0
    assert verifier_laws.torque_excess(IDEAL, 1.0, qd, tau) == pytest.approx(3.0)
    drawn = verifier_laws.bus_power(IDEAL, qd, tau)[0] / 1e3
    assert verifier_laws.torque_excess(
        robot(bus_sag=0.05), 1.0, qd, tau
    ) == pytest.approx(3.0 + 0.05 * drawn * STALL)
    tau[0, 0] = -100.0
    assert verifier_laws.torque_excess(IDEAL, 1.0, qd, tau) == 0.0
    mirrored = HardwareSpec(braking_speed=21.4)
    assert verifier_laws.torque_excess(mirrored, 1.0, qd, tau) == pytest.approx(
        100.0 - STALL * (1.0 - 20.0 / 21.4)
    )
    assert verifier_laws.torque_excess(
        HardwareSpec(braking_speed=18.0), 1.0, qd, tau
    ) == pytest.approx(100.0)


# --- The program ----------------------------------------------------------------------
def size(hardware: HardwareSpec) -> tuple[int, int]:
    """Return the numbers of unknowns and constraints of a trot's program."""
    problem = Problem(intervals=4, hardware=hardware)
    program = transcribe(problem, cold_guess(problem), STANDARD).program
    end = program.conditions(np.concatenate(program._guess))
    return len(end.unknown_bounds.lower), len(end.values)


def test_what_a_robot_does_not_lose_is_not_in_its_program():
    model, p = sagittal.build_model(LEGS, IDEAL), ca.SX.sym("p", 3)
    q, v, tau = ca.SX.sym("q", 15), ca.SX.sym("v", 15), ca.SX.sym("tau", 8)
    assert model.resistance(v, tau, p).is_zero()
    assert model.passive(q, v, p)[0].is_zero()
    ideal = size(IDEAL)
    # of both segments: the points, and twice between two of them
    states = 2 * (9 + 2 * 4)
    rows = dict.fromkeys(PAYING, 0) | {
        "bus power": states,
        "bus sag": 16 * states,
        "braking limit": 16 * states,
    }
    for name, hardware in PAYING.items():
        assert size(hardware) == (ideal[0], ideal[1] + rows[name]), name


@pytest.fixture(scope="module")
def free() -> Solution:
    """Return a trot of a robot without losses."""
    return solve(Problem(speed=10.0, intervals=4))


@pytest.mark.parametrize("name", PAYING)
def test_a_trot_that_pays_is_sound_at_its_points_and_costs_more(name, free):
    """By the judge's own laws; between the points of so coarse a mesh no trot is."""
    solution = solve(
        dataclasses.replace(free.problem, hardware=PAYING[name]), free.motion
    )
    figures = verify(solution)
    failing = {line.split()[0] for line in failures(figures)}
    assert not failing & {
        "dynamics_residual",
        "impact_residual",
        "position_jump",
        "velocity_jump",
    }
    qd, tau = solution.motion.v[..., MOTORS], solution.motion.tau
    power = verifier_laws.bus_power(PAYING[name], qd, tau)
    # IPOPT's tolerance is 1e-9 of 100 Nm and of 1 kW; a bound may be relaxed by 1e-8 of
    # itself.
    assert verifier_laws.bus_excess(PAYING[name], 1.0, power) < 1e-3
    assert verifier_laws.torque_excess(PAYING[name], 1.0, qd, tau) < 1e-3
    if name != "rebound stop":  # as good as a softer one
        assert solution.cost > free.cost
    if name == "bus power":
        assert (
            np.max(
                verifier_laws.bus_power(
                    IDEAL, free.motion.v[..., MOTORS], free.motion.tau
                )
            )
            > 2.5e3
        )
        assert np.max(power) == pytest.approx(2.5e3, rel=1e-4)


def test_half_a_robot_lets_the_bus_sag_by_the_whole_robots_power():
    hardware = PAYING["bus sag"]
    problem = Problem(gait="two-leg", speed=10.0, intervals=4, hardware=hardware)
    motion = solve(problem).motion
    qd, tau = motion.v[..., problem.stride.motors], motion.tau
    assert verifier_laws.torque_excess(hardware, 0.5, qd, tau) < 1e-3
    # the sag is what limits: were it twice as much, motors would be beyond it
    assert verifier_laws.torque_excess(hardware, 0.25, qd, tau) > 1.0


def test_energy_closes_with_every_loss():
    """A smooth trot, as `test_verify`'s, of a robot that loses on every way; without
    one of them it does not close."""
    losses = Losses(0.2, 1.0, 0.92, 2.0, 0.05, 20.0)
    hardware = HardwareSpec(
        spring_stop_stiffness=0.0,
        rebound_stiffness=0.0,
        spring_stiffness=4e3,
        spring_damping=50.0,
        losses=losses,
    )
    solution = solve(Problem(speed=10.0, intervals=8, clearance=0.0, hardware=hardware))
    figures = verify(solution)
    # of a mesh of 8 intervals
    between_the_points = {"foot_speed", "foot_drift", "friction_use", "torque_excess"}
    simulated_again = {"position_error", "velocity_error", "energy_error"}
    assert {
        line.split()[0] for line in failures(figures)
    } <= between_the_points | simulated_again
    nothing = {
        "drag_area": 0.0,
        "gear_efficiency": 1.0,
        "joint_friction": 0.0,
        "spring_friction": 0.0,
    }
    for name, value in nothing.items():
        without = dataclasses.replace(
            hardware, losses=dataclasses.replace(losses, **{name: value})
        )
        forgetful = dataclasses.replace(
            solution, problem=dataclasses.replace(solution.problem, hardware=without)
        )
        missing = _over_stride(PlanarModel.of(forgetful.problem), forgetful)[
            "energy_residual"
        ]
        assert missing > 5.0 * LIMITS["energy_residual"], name


def test_a_solution_from_before_losses_is_read_as_one_without(trot, tmp_path):
    save_solution(tmp_path / "old", trot)
    card = json.loads((tmp_path / "old.json").read_text())
    hardware = card["problem"]["hardware"]
    for name in (
        "losses",
        "rebound_stiffness",
        "rebound_damping",
        "braking_speed",
        "envelope",
        "solid_legs",
    ):
        del hardware[name]
    (tmp_path / "old.json").write_text(json.dumps(card))
    assert load_solution(tmp_path / "old", trot.problem).problem.hardware == IDEAL


# --- One at a time --------------------------------------------------------------------
def test_each_loss_is_added_alone_and_taken_away_alone():
    built = Problem(hardware=BUILT)
    variants = {
        name: variant.problem.hardware for name, variant in loss_variants(built).items()
    }
    ideal = variants["ideal"]
    assert ideal.losses == Losses(
        current_lag=BUILT.losses.current_lag, latency=BUILT.losses.latency
    )
    assert (ideal.friction, ideal.rebound_stiffness) == (
        IDEAL.friction,
        IDEAL.rebound_stiffness,
    )
    assert variants["built"] == BUILT
    assert variants["ideal + gears"].losses == dataclasses.replace(
        ideal.losses, gear_efficiency=0.92
    )
    assert variants["built - ground friction"] == dataclasses.replace(
        BUILT, friction=IDEAL.friction
    )
    parts = [name for name in PARTS if f"ideal + {name}" in variants]
    assert [*variants] == [
        "ideal",
        *(f"ideal + {p}" for p in parts),
        "built",
        *(f"built - {p}" for p in parts),
    ]
    with pytest.raises(UserError, match="choose --robot built"):
        loss_variants(Problem())
