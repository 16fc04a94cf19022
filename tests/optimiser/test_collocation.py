"""The nonlinear program and how it is solved; test_verify checks that solutions are
true."""

import dataclasses
import importlib
import json
import math
import re
import sys

import casadi
import numpy as np
import pytest
from damage import flipped_bits

from bp2_rl.base.errors import UserError
from bp2_rl.optimiser.collocation import cold_guess, fastest, refine, solve, solve_best
from bp2_rl.optimiser.cycle import whole_cycle
from bp2_rl.optimiser.problem import STRIDES, CostWeights, Problem, motor_coordinates
from bp2_rl.optimiser.program import Program
from bp2_rl.optimiser.solution import (
    Motion,
    NotSolved,
    is_saved,
    load_solution,
    resample,
    sample,
    save_solution,
)
from bp2_rl.optimiser.transcription import SolveOptions
from bp2_rl.robot.hardware import IDEAL, HardwareSpec

TROT, TWO_LEG = STRIDES["trot"], STRIDES["two-leg"]


# --- The sequence of contacts ---------------------------------------------------------
def test_a_trot_is_half_a_cycle_and_its_mirror_image():
    assert TROT.cycles == 0.5
    assert TROT.touchdowns(0) == ("FL", "RR")
    assert TROT.liftoffs(0) == ("FL", "RR")
    assert TROT.touchdowns(1) == TROT.liftoffs(1) == ()
    names = [
        "x",
        "z",
        "pitch",
        *(f"{leg} {part}" for leg in TROT.legs for part in ("hip", "knee", "spring")),
    ]
    follows = dict(zip(names, np.array(names)[TROT.next_coordinates], strict=True))
    assert follows["FR knee"] == "FL knee"
    assert follows["RR spring"] == "RL spring"
    assert follows["pitch"] == "pitch"


def test_the_two_leg_reading_is_a_whole_cycle():
    assert TWO_LEG.cycles == 1.0
    assert [TWO_LEG.touchdowns(i) for i in range(4)] == [("F",), (), ("H",), ()]
    assert np.array_equal(TWO_LEG.next_coordinates, np.arange(TWO_LEG.nq))


def test_feet_that_stay_down_do_not_land_again():
    grounded = dataclasses.replace(
        TWO_LEG, standing=(("F",), ("F", "H"), ("H",), ("F", "H"))
    )
    assert [grounded.touchdowns(i) for i in range(4)] == [(), ("H",), (), ("F",)]
    assert [grounded.liftoffs(i) for i in range(4)] == [(), ("F",), (), ("H",)]


# --- Solutions ------------------------------------------------------------------------
def test_a_cold_start_finds_a_trot(trot):
    assert trot.violation <= 1e-6
    assert trot.problem.speed * trot.period / 2 == pytest.approx(
        trot.motion.q[-1, -1, 0], rel=1e-6
    )
    # Wide: six intervals move the optimum. On 16 it is held to .25-.38 s and .16-.22.
    assert 0.2 < trot.period < 0.5
    assert 0.1 < trot.duty < 0.25


def test_swinging_feet_carry_nothing_and_standing_ones_let_go(trot):
    force = trot.motion.force
    right_fore_and_left_hind = [0, 1, 6, 7]
    assert np.all(force[0][:, right_fore_and_left_hind] == 0.0)
    assert np.all(force[1] == 0.0)
    assert force[0, -1] == pytest.approx(0.0, abs=1e-4)
    assert force[0].max() > 300.0


def test_torques_do_not_jump_between_segments(trot):
    tau = trot.motion.tau
    assert tau[1, 0] == pytest.approx(tau[0, -1], abs=1e-5)
    assert tau[0, 0] == pytest.approx(tau[1, -1][TROT.next_motors], abs=1e-5)


@pytest.mark.parametrize("scheme", ["hermite-simpson", "trapezoid", "paper"])
def test_the_cost_is_the_mean_of_r_as_the_scheme_integrates(scheme):
    """Eq. R without its smoothness, each segment by itself, with the weights that the
    cycle is measured with."""
    problem = Problem(scheme=scheme, intervals=6, weights=CostWeights(smoothness=0.0))
    solution = solve(problem)
    cycle, motors = whole_cycle(solution), motor_coordinates(TROT.legs)
    motion, hardware = cycle.motion, problem.hardware
    load = motion.force / problem.weights.force
    torque = motion.tau / hardware.joint_peak_torque
    power = motion.v[..., motors] / hardware.joint_no_load_speed * torque
    R = sum(np.sum(term**2, axis=-1) for term in (power, torque, load))
    means = np.sum(cycle.weights * R, axis=1) / motion.durations
    assert solution.cost == pytest.approx(np.mean(means), rel=1e-12)


def test_a_finer_mesh_hardly_changes_the_cost(trot):
    finer = refine(trot, 9)
    assert finer.problem.intervals == 9
    # Forces are quadratures of six and nine intervals; the mesh's share of the cost is
    # within some per cent.
    assert finer.cost == pytest.approx(trot.cost, rel=0.05)


def test_the_two_leg_reading_pitches_more(trot):
    two_leg = solve(Problem(gait="two-leg", intervals=5))
    assert two_leg.motion.q.shape == (4, 11, 9)
    assert np.ptp(two_leg.motion.q[..., 2]) > np.ptp(trot.motion.q[..., 2])


def test_less_torque_is_less_speed(trot):
    weaker = dataclasses.replace(
        trot, problem=trot.problem.on(peak_torque=60.0, corner_speed=0.0)
    )
    strong, weak = fastest(trot), fastest(weaker)
    assert 13.2 < strong.problem.speed < 25.0
    assert weak.problem.speed < strong.problem.speed - 0.5


def test_the_best_of_several_starts_is_none_the_worse(trot):
    best = solve_best(trot.problem, starts=1, near=[trot])
    assert best.cost <= trot.cost + 1e-6


def test_staying_near_the_start_is_worth_something(trot):
    slower = trot.problem.at(9.5)
    near, free = (
        solve(slower, trot.motion, SolveOptions(proximity=proximity))
        for proximity in (1e3, 0.0)
    )

    def distance(solution):
        return np.mean((solution.motion.q - trot.motion.q)[..., 1:] ** 2)

    assert distance(near) < 0.5 * distance(free)
    assert near.cost >= free.cost - 1e-6  # without the term


@pytest.mark.parametrize("seed", [None, 1, 2])
@pytest.mark.parametrize("gait", ["trot", "two-leg"])
def test_guesses_are_runs_at_the_speed_asked_for(gait, seed):
    problem = Problem(speed=7.0, gait=gait, intervals=4)
    guess = cold_guess(problem, seed)
    assert guess.q[-1, -1, 0] == pytest.approx(7.0 * guess.durations.sum())
    again = guess.q[-1, -1][problem.stride.next_coordinates]
    assert again[1:] == pytest.approx(guess.q[0, 0, 1:], abs=1e-6)
    assert guess.force[..., 1::2].max() > 0.0


# --- No solution ----------------------------------------------------------------------
def test_an_impossible_speed_is_said_so():
    with pytest.raises(
        NotSolved,
        match=r"no trajectory at 40 m/s: IPOPT ended with .*; lower the speed",
    ):
        solve(Problem(speed=40.0, intervals=2))


def test_an_interruption_is_none_of_the_ways_to_fail(monkeypatch):
    # As CasADi reports Ctrl-C within IPOPT: it must not be kept as a problem without a
    # solution.
    found = Program.solve

    def interrupted(self, time_limit, perhaps_infeasible):
        end = found(self, 0.01, perhaps_infeasible)
        how = {"success": False, "return_status": "NonIpopt_Exception_Thrown"}
        return end._replace(statistics=end.statistics | how)

    monkeypatch.setattr(Program, "solve", interrupted)
    with pytest.raises(KeyboardInterrupt):
        solve(Problem(intervals=2))


@pytest.mark.parametrize(
    ("kind", "change", "message"),
    [
        (Problem, {"speed": 0.0}, "speed must be from 0.01 to 100, got 0"),
        (Problem, {"speed": -3.0}, "speed must be from 0.01 to 100, got -3"),
        (Problem, {"speed": 1e308}, "speed must be from 0.01 to 100, got 1e+308"),
        (Problem, {"speed": math.nan}, "speed must be from 0.01 to 100, got nan"),
        (Problem, {"intervals": 1}, "intervals must be from 2 to 500, got 1"),
        (Problem, {"intervals": 10**400}, "from 2 to 500, got a huge integer"),
        (Problem, {"clearance": -0.01}, "clearance must be from 0 to 0.5, got -0.01"),
        (Problem, {"pitch_limit": 0.0}, "pitch_limit must be from 0.001 to 1.5, got 0"),
        (CostWeights, {"force": 0.0}, "weights.force must be from 1 to 1e+06, got 0"),
        (CostWeights, {"power": -1.0}, "weights.power must be from 0 to 1e+06, got -1"),
    ],
)
def test_impossible_problems_are_refused(kind, change, message):
    with pytest.raises(UserError, match=re.escape(message)):
        kind(**change)


def test_without_ipopt_there_is_a_line_that_says_so(monkeypatch):
    monkeypatch.setattr(casadi, "has_nlpsol", lambda name: False)
    with pytest.raises(UserError, match="no IPOPT: pip install"):
        solve(Problem(intervals=2))


def test_without_casadi_there_is_a_line_that_says_so(monkeypatch):
    monkeypatch.setitem(sys.modules, "casadi", None)
    monkeypatch.delitem(sys.modules, "bp2_rl.optimiser.sagittal")
    with pytest.raises(
        UserError,
        match=r'needs the package casadi: pip install -c constraints.txt -e "\.\[trajopt\]"',
    ):
        importlib.import_module("bp2_rl.optimiser.sagittal")


# --- Between the points, and on disk --------------------------------------------------
def test_samples_at_the_points_are_the_points(trot):
    for segment in range(2):
        moment = sample(trot.problem, trot.motion, segment, trot.problem.points)
        for name in ("tau", "force", "a"):
            assert getattr(moment, name) == pytest.approx(
                getattr(trot.motion, name)[segment]
            )
        # The middle of an interval is on the cubic of its ends as exactly as the
        # defects are zero.
        assert moment.q == pytest.approx(trot.motion.q[segment], abs=1e-7)
        assert moment.v == pytest.approx(trot.motion.v[segment], abs=1e-5)


@pytest.mark.parametrize("scheme", ["hermite-simpson", "trapezoid", "paper"])
def test_samples_are_exact_for_what_the_scheme_integrates_exactly(scheme):
    # Constant acceleration: exact for the first two schemes, and for the third in
    # velocity and at the points.
    problem = Problem(scheme=scheme, intervals=3)
    rate = np.full((2, 1, 15), -9.81)

    def fallen(shares):
        """q and v at these shares of 0.2 s."""
        t = 0.2 * shares[:, None]
        return 3.0 * t + 0.5 * rate * t**2, 3.0 + rate * t

    q, v = fallen(problem.points)
    motors = np.ones((*q.shape[:2], 8))
    a = np.broadcast_to(rate, q.shape)
    motion = Motion(np.array([0.2, 0.2]), q, v, a, motors, motors, np.zeros((2, 8)))
    shares = np.linspace(0.0, 1.0, 23)
    moment = sample(problem, motion, 1, shares)
    for found, exact in zip((moment.q, moment.v), fallen(shares), strict=True):
        assert found == pytest.approx(exact[1])
    assert moment.tau == pytest.approx(1.0)


def test_resampling_onto_the_same_mesh_changes_nothing(trot):
    again = resample(trot.problem, trot.motion, trot.problem)
    assert again.q == pytest.approx(trot.motion.q, abs=1e-7)
    assert again.tau == pytest.approx(trot.motion.tau)


def test_a_solution_survives_the_disk(trot, tmp_path):
    checked = dataclasses.replace(trot, checks={"energy_residual": 1e-4})
    save_solution(tmp_path / "deep" / "speed-10.00", checked)
    again = load_solution(tmp_path / "deep" / "speed-10.00")
    assert again.problem == trot.problem
    assert again.statistics == checked.statistics
    for name, array in trot.motion.arrays.items():
        assert np.array_equal(again.motion.arrays[name], array)


def moved(solution, **arrays):
    """Return a solution with other arrays of its motion."""
    motion = dataclasses.replace(solution.motion, **arrays)
    return dataclasses.replace(solution, motion=motion)


def test_a_save_that_is_killed_between_its_files_is_no_save(
    trot, tmp_path, monkeypatch
):
    path = tmp_path / "speed"
    save_solution(path, trot)
    monkeypatch.setattr(
        "bp2_rl.base.serialization.save_config",
        lambda *_: (_ for _ in ()).throw(KeyboardInterrupt),
    )
    with pytest.raises(KeyboardInterrupt):
        save_solution(path, moved(trot, q=trot.motion.q + 0.1))
    assert not is_saved(path)


def test_arrays_under_another_solutions_card_are_refused(trot, tmp_path):
    path, other = tmp_path / "speed", tmp_path / "other"
    save_solution(path, trot)
    save_solution(other, moved(trot, q=trot.motion.q + 0.1))
    other.with_suffix(".npz").rename(path.with_suffix(".npz"))
    foreign = "its arrays are not those that its card was written for"
    with pytest.raises(UserError, match=foreign):
        load_solution(path)
    card = json.loads(path.with_suffix(".json").read_text())
    del card["arrays_sha256"]  # as earlier versions wrote it
    path.with_suffix(".json").write_text(json.dumps(card))
    assert np.array_equal(load_solution(path).motion.q, trot.motion.q + 0.1)


UNREADABLE = r"solution .*speed cannot be read .*: solve it again"


@pytest.mark.attack
@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ('"format": 1', '"format": 99', "has format 99, this version reads 1"),
        ('"speed": 10.0', '"speed": -10.0', "speed must be from"),
        ("(?s).*", "[" * 100_000, UNREADABLE),
        ("(?s).*", "[]", UNREADABLE),
        ("(?s).*", "null", UNREADABLE),
        ('"iterations": ', f'"iterations": 1{"0" * 5000}', UNREADABLE),
    ],
    ids=["format", "speed", "nested", "list", "null", "huge"],
)
def test_broken_cards_are_refused(before, after, message, trot, tmp_path):
    path = tmp_path / "speed"
    save_solution(path, trot)
    card = path.with_suffix(".json")
    card.write_text(re.sub(before, after, card.read_text(), count=1))
    with pytest.raises(UserError, match=message):
        load_solution(path)


@pytest.mark.attack
def test_broken_arrays_are_refused(trot, tmp_path):
    path = tmp_path / "speed"
    with pytest.raises(UserError, match=UNREADABLE):
        load_solution(path)
    save_solution(path, trot)
    arrays = path.with_suffix(".npz")
    arrays.write_bytes(arrays.read_bytes()[: arrays.stat().st_size // 2])
    with pytest.raises(UserError, match=UNREADABLE):
        load_solution(path)
    coarse = resample(trot.problem, trot.motion, trot.problem.on_mesh(3))
    shapes = r"holds q as float64\[2, 7, 15\], expected floating\[2, 13, 15\]"
    holes = np.full_like(trot.motion.v, np.nan)
    for other, message in (
        (moved(trot, **coarse.arrays), shapes),
        (moved(trot, v=holes), "numbers in v that are not finite"),
    ):
        save_solution(path, other)
        with pytest.raises(UserError, match=message):
            load_solution(path)


def test_every_bit_flipped_in_a_solution_is_one_line(trot, tmp_path):
    path = tmp_path / "speed"
    save_solution(path, trot)
    lines = []
    for suffix, times in ((".npz", 150), (".json", 50)):
        file = path.with_name(path.name + suffix)
        content = file.read_bytes()
        for flipped in flipped_bits(content, times):
            file.write_bytes(flipped)
            try:
                load_solution(path)
            except UserError as error:
                lines.append(str(error))
        file.write_bytes(content)
    assert len(lines) > 120
    assert not any("\n" in line for line in lines)


def test_the_model_of_other_hardware_is_another_model():
    # Cached by hardware: a stale entry would be a silent error.
    from bp2_rl.optimiser import sagittal

    q, v = np.full(15, 0.1), np.zeros(15)
    stiff, soft = (
        np.array(
            sagittal.build_model(hardware=IDEAL).passive(
                q, v, sagittal.design_vector(hardware)
            )
        ).ravel()
        for hardware in (IDEAL, HardwareSpec(spring_stiffness=3000.0))
    )
    assert stiff[5] - soft[5] == pytest.approx(-300.0)
    damped = sagittal.build_model(hardware=HardwareSpec(spring_damping=0.0))
    assert damped.passive(q, v + 1.0, sagittal.design_vector(IDEAL))[5] - stiff[
        5
    ] == pytest.approx(0.0, abs=1e-9)
