"""The judge beside a training: its results are the benchmarks', and its processes end
with it."""

import dataclasses
import itertools
import multiprocessing
import time
from typing import Any

import jax.numpy as jnp
import pytest

from bp2_rl.base.assets import asset_path
from bp2_rl.env.observations import layout_of
from bp2_rl.evaluation import judge as judging
from bp2_rl.evaluation.benchmarks.options import BenchmarkOptions
from bp2_rl.evaluation.benchmarks.run import ramp_to_topspeed, topspeed
from bp2_rl.evaluation.judge import JUDGED_LAUNCHES, JudgedLaunch, LaunchResult
from bp2_rl.learning.judged import JudgeResult, best_policy
from bp2_rl.learning.policy import NETWORKS, load_policy, save_policy
from bp2_rl.robot.hardware import BUILT
from bp2_rl.settings.env import CommandConfig, EnvConfig
from bp2_rl.simulation import policy_runner
from bp2_rl.simulation.metrics import RunMetrics


@pytest.fixture(scope="module")
def shipped():
    return load_policy(asset_path("policies/ideal"), layout_of=layout_of)


@pytest.fixture(scope="module")
def slower(shipped):
    """Return the shipped policy as if it had been trained up to 6 m/s."""
    env = dataclasses.replace(
        shipped.card.env,
        commands=dataclasses.replace(shipped.card.env.commands, max_forward=6.0),
    )
    return dataclasses.replace(shipped, card=dataclasses.replace(shipped.card, env=env))


def test_the_speed_is_that_of_the_benchmark(slower):
    launches = [
        JudgedLaunch(acceleration=3.0, hold=0.5),
        JudgedLaunch(acceleration=6.0, hold=1.0),
    ]
    launched, _ = judging.measure_launches(slower, slower.card.env, launches)
    setup = BenchmarkOptions(robot="ideal", speed=6.0, acceleration=3.0, hold=0.5)
    result = topspeed(slower, ramp_to_topspeed(slower, setup), setup).metrics
    assert isinstance(result, RunMetrics)
    assert not launched.fell
    assert launched.best_speed > 4.0
    assert launched.best_speed == pytest.approx(result.best_speed, abs=1e-9)


def test_a_robot_that_falls_has_no_speed(slower):
    [launched] = judging.measure_launches(
        lambda observation: 100.0 * jnp.sign(observation[5:17]),
        slower.card.env,
        [JUDGED_LAUNCHES[1]],
    )
    assert launched == LaunchResult(True, 0.0, 6.0, launched.fell_told)
    assert 0.0 < launched.fell_told < 6.0  # it falls while the command rises


def clumsy(policy, limit):
    """Return the policy that runs as `policy` up to a command of `limit`, m/s, and
    throws its legs about beyond."""

    def act(observation):
        wild = 100.0 * jnp.sign(observation[5:17])
        return jnp.where(observation[0] > limit, wild, policy(observation))

    return act


def test_the_judge_finds_the_speed_below_which_a_robot_stays_up(slower):
    """Of 6 m/s times 0.7, 0.7**2 ... the fastest command below 2 m/s is 1.44 m/s."""
    result = judging.judge_policy(clumsy(slower, 2.0), slower.card.env)
    assert (result.speed, result.falls) == (0.0, 3)
    assert 2.0 < result.fell_told < 6.0
    launches = [dataclasses.replace(one, share=0.7**4) for one in JUDGED_LAUNCHES]
    under = judging.combine(judging.measure_launches(slower, slower.card.env, launches))
    # below 2 m/s it is the policy itself, on the same processor in another batch
    assert result.held == pytest.approx(min(under.held, 6.0 * 0.7**4), rel=1e-3)
    # the mean speed under that command counts as one launch of three
    assert result.score == pytest.approx(under.score / 3.0, rel=1e-3)
    assert str(result) == (
        f"holds 1.4 m/s, 3 of 3 launches fell, the first at {result.fell_told:.1f} m/s"
    )


def test_a_robot_that_always_falls_holds_no_speed(slower):
    result = judging.judge_policy(clumsy(slower, 0.0), slower.card.env)
    assert (result.held, result.score, result.falls) == (0.0, 0.0, 3)
    assert str(result).startswith("3 of 3 launches fell")


def test_no_slower_command_is_tried_where_the_first_launch_stays_up(
    slower, monkeypatch
):
    launches = judging.measure_launches(slower, slower.card.env, JUDGED_LAUNCHES)
    monkeypatch.setattr(judging, "SLOWER_LAUNCHES", None)
    result = judging.judge_policy(slower, slower.card.env)
    assert result == judging.combine(launches)
    assert result.held == pytest.approx(6.0, rel=0.1)


def test_in_a_training_that_ends_at_a_speed_robots_are_told_little_more(slower):
    nimble = judging.judge_policy(slower, slower.card.env, until=3.0)
    assert nimble.held == pytest.approx(3.3, rel=0.05)
    wild = clumsy(slower, 2.0)
    fell = judging.judge_policy(wild, slower.card.env, until=3.0, slower=False)
    assert (fell.falls, fell.score, fell.held) == (3, 0.0, 0.0)
    assert 2.0 < fell.fell_told < 3.3


def fell(told=0.0):
    return LaunchResult(True, 0.0, fell_told=told)


@pytest.mark.parametrize(
    ("launches", "result"),
    [
        # of several falls that at the least command is told
        (
            [LaunchResult(False, 9.0, held=8.8), fell(5.0), fell(3.9)],
            JudgeResult(9.0, 2, 3, 3.0, 3.9, 8.8),
        ),
        # the first launch gives the speed, all of them falls and mean
        (
            [LaunchResult(False, 9.0), fell(), LaunchResult(False, 12.0)],
            JudgeResult(9.0, 1, 3, 7.0),
        ),
        # the first launch is the longest: no short one makes up for a fall in it
        (
            [fell(), LaunchResult(False, 12.0), LaunchResult(False, 12.0)],
            JudgeResult(0.0, 1, 3, 0.0),
        ),
        # faster than told is as bad as slower
        ([LaunchResult(False, 2.5, command=3.0)], JudgeResult(2.5, 0, 1, 2.5)),
        ([LaunchResult(False, 3.5, command=3.0)], JudgeResult(3.5, 0, 1, 2.5)),
        ([LaunchResult(False, 3.0, command=3.0)], JudgeResult(3.0, 0, 1, 3.0)),
    ],
)
def test_launches_are_combined(launches, result):
    told = launches[0].command
    assert judging.combine(launches) == dataclasses.replace(result, told=told)


def test_who_follows_the_fastest_command_comes_before_who_holds_a_slower_one():
    told = 10.0
    barely = [LaunchResult(False, 0.7 * told, told), fell(9.0), fell(9.0)]
    slower = [LaunchResult(False, 0.7 * told, 0.7 * told, held=0.7 * told)] * 3
    results = {1: judging.combine([fell(8.0)] * 3, slower), 2: judging.combine(barely)}
    assert results[1].held == pytest.approx(7.0)
    assert best_policy(results, None) == 2
    # by the speed that they hold, where all fall
    halves = [LaunchResult(False, 5.0, 5.0, held=5.2)] * 3
    results = {
        2: judging.combine([fell(8.0)] * 3, slower),
        3: judging.combine([fell(9.9)] * 3, halves),
        4: judging.combine([fell(9.9)] * 3),
    }
    assert results[3].held == 5.0  # no more than the command
    assert best_policy(results, None) == 2


@pytest.mark.parametrize(
    ("steepest", "asked"), [(2.0, [2.0, 2.0, 2.0]), (8.0, [3.0, 6.0, 3.0])]
)
def test_no_launch_is_steeper_than_those_of_the_training(steepest, asked):
    env = EnvConfig(commands=CommandConfig(acceleration=(1.0, steepest)))
    assert [one.ramp(env).acceleration for one in JUDGED_LAUNCHES] == asked


def test_a_launch_may_have_noisy_sensors(shipped):
    env = dataclasses.replace(shipped.card.env, commands=CommandConfig(max_forward=1.0))
    launches = [
        JudgedLaunch(acceleration=3.0, hold=1.5, noise_seed=seed)
        for seed in (None, 1, 2, 1)
    ]
    clean, one, other, again = (
        judging.measure_launches(shipped, env, [launch])[0].best_speed
        for launch in launches
    )
    assert one == again
    assert len({clean, one, other}) == 3
    assert {launch.noise_seed for launch in JUDGED_LAUNCHES} == {1, 2, 3}


def test_a_launch_may_be_of_a_worse_robot():
    robot = JudgedLaunch(3.0, 1.0, friction=0.75, mass=1.05, latency=0.005).robot(BUILT)
    assert robot.friction == pytest.approx(0.6)
    assert robot.mass_scale == pytest.approx(1.05)
    assert robot.losses.latency == pytest.approx(0.01)
    assert JudgedLaunch(3.0, 1.0).robot(BUILT) == BUILT


@pytest.fixture(scope="module")
def slow_policy(shipped, tmp_path_factory):
    """Save a policy whose command is 1 m/s at most, so that the judge's result takes a
    moment."""
    env = shipped.card.env
    env = dataclasses.replace(
        env, commands=dataclasses.replace(env.commands, max_forward=1.0)
    )
    folder = tmp_path_factory.mktemp("slow") / "64"
    save_policy(
        folder,
        dataclasses.replace(shipped, card=dataclasses.replace(shipped.card, env=env)),
    )
    return folder


def test_a_result_comes_from_another_process_which_ends_with_the_judge(slow_policy):
    """Launches side by side end as those one by one."""
    policy, before = load_policy(slow_policy), multiprocessing.active_children()
    with judging.open_judge(policy.card, None) as judge:
        pending = judge.submit(slow_policy)
        assert not pending.done()
        workers = [
            worker
            for worker in multiprocessing.active_children()
            if worker not in before
        ]
        result = pending.result(timeout=120)
        # The same programs on the same processor.
        assert result == judging.combine(
            [
                *itertools.chain(
                    *(
                        judging.measure_launches(policy, policy.card.env, [one])
                        for one in JUDGED_LAUNCHES
                    )
                )
            ]
        )
        assert result.speed > 0.0
        judge.submit(slow_policy)  # nobody waits for this one
        began = time.monotonic()
    assert time.monotonic() - began < 2.0
    assert workers
    assert not any(worker.is_alive() for worker in workers)


def test_a_judge_compiles_before_the_first_policy(slow_policy):
    """Tracing and compiling a network's control step takes longer than most
    launches."""
    policy = load_policy(slow_policy)
    compiled = policy_runner._compiled_control_step
    compiled.cache_clear()
    judging._warm_up(policy.card, slower=True)
    control: Any = compiled(
        NETWORKS[policy.card.activation], policy.card.env, policy.card.env.randomization
    )
    assert control._cache_size() == 2  # a batch, and that of slower launches
    judging._judge(slow_policy, policy.card.env.task, None, True)
    judging.measure_launches(policy, policy.card.env, judging.SLOWER_LAUNCHES)
    assert compiled.cache_info().misses == 1
    assert control._cache_size() == 2


def test_a_judge_whose_process_is_killed_says_so(slow_policy):
    before = multiprocessing.active_children()
    with judging.open_judge(load_policy(slow_policy).card, None) as judge:
        pending = judge.submit(slow_policy)
        for worker in multiprocessing.active_children():
            if worker not in before:
                worker.kill()
        with pytest.raises(RuntimeError, match="terminated abruptly"):
            pending.result(timeout=120)
        with pytest.raises(RuntimeError):
            judge.submit(slow_policy)
