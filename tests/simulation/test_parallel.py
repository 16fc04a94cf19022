"""Runs are shared out among workers: a robot stays with one worker, and workers are
kept with their compiled code."""

import dataclasses
import os
import signal
from typing import Any

import numpy as np
import pytest
from synthetic import still_policy

from bp2_rl.learning.policy import NETWORKS
from bp2_rl.robot.hardware import BUILT, IDEAL
from bp2_rl.simulation import parallel, policy_runner
from bp2_rl.simulation.parallel import (
    in_parallel,
    keep_workers,
    shares_of,
    simulate_all,
)
from bp2_rl.simulation.rollout import RunRequest, simulate
from bp2_rl.simulation.schedule import Course
from bp2_rl.simulation.simulator import Numerics

LIGHT = dataclasses.replace(BUILT, mass_scale=0.9)


def lasting(seconds, robot=BUILT, **how):
    return RunRequest(Course().hold(seconds), robot, **how)


def test_each_is_dealt_out_once_and_work_is_shared():
    requests = [lasting(seconds) for seconds in (1.0, 2.0, 3.0, 4.0, 6.0, 8.0)]
    shares = shares_of(requests, 2)
    assert sorted(i for share in shares for i in share) == list(range(6))
    assert [sum(requests[i].schedule.duration for i in share) for share in shares] == [
        10.0,
        14.0,
    ]
    assert shares == [[3, 2, 1, 0], [5, 4]]  # the longest first
    assert shares_of(requests[:1], 4) == [[0]]


def test_a_robot_stays_with_one_worker():
    """It is brought to a stand once."""
    robots = BUILT, IDEAL, LIGHT, BUILT, IDEAL, LIGHT, BUILT, IDEAL
    shares = shares_of([lasting(1.0, robot) for robot in robots], 4)
    assert [{robots[i] for i in share} for share in shares] == [
        {BUILT},
        {BUILT, IDEAL},
        {IDEAL},
        {LIGHT},
    ]


def test_finer_physics_is_more_work():
    fine = lasting(1.0, numerics=Numerics(steps=4, motors_each_step=True))
    assert shares_of(
        [lasting(1.0), lasting(1.0), lasting(1.0), lasting(1.0), fine], 2
    ) == [[0, 1, 2, 3], [4]]


def where(policy, task):
    return os.getpid()


def compiled(one, run):
    return os.getpid(), policy_runner._compiled_control_step.cache_info().misses


@pytest.fixture
def zero_policy(make_card):
    return still_policy(make_card())


def test_one_program_serves_all_policies_of_a_network(zero_policy):
    """Another one's weights are arguments of it, and so are the same ones in other
    arrays."""
    (first, (weight, bias)), compiled = (
        zero_policy.layers,
        policy_runner._compiled_control_step,
    )
    compiled.cache_clear()
    others = [
        dataclasses.replace(zero_policy, layers=(first, (weight, bias + shift)))
        for shift in (0.0, 0.1)
    ]
    runs = [
        next(simulate(policy, [lasting(0.05)])) for policy in (zero_policy, *others)
    ]
    control: Any = compiled(
        NETWORKS[zero_policy.card.activation], zero_policy.card.env, None
    )
    assert compiled.cache_info().misses == 1
    assert control._cache_size() == 1
    np.testing.assert_array_equal(runs[0].qpos, runs[1].qpos)
    assert not np.array_equal(runs[0].qpos, runs[2].qpos)


def test_workers_are_kept_with_what_they_have_compiled(zero_policy, monkeypatch):
    monkeypatch.setattr(parallel, "processors", lambda: 1)
    with keep_workers():
        first, then = (
            in_parallel(where, zero_policy, ("one", "two")) for _ in range(2)
        )
        ran = [
            simulate_all(compiled, zero_policy, [lasting(0.01), lasting(0.01)])
            for _ in range(2)
        ]
        os.kill(first[0], signal.SIGINT)  # as Ctrl-C does, to all at once
        assert in_parallel(where, zero_policy, ("three",)) == first[:1]
    assert first == then == 2 * [first[0]]
    assert ran == 2 * [2 * [(first[0], 1)]]
    assert in_parallel(where, zero_policy, ("four",)) != first[:1]


def test_requests_that_take_no_time_are_requests():
    assert shares_of([RunRequest(Course(), BUILT)], 2) == [[0]]
    assert sorted(
        i
        for share in shares_of([lasting(1.0), RunRequest(Course(), IDEAL)], 2)
        for i in share
    ) == [0, 1]
