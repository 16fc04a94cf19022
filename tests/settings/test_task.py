"""Tasks: a user's file with reward terms, terminations and observations, read, run and refused."""

import pickle
import random
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import bp2_rl as bp2
from bp2_rl.base.errors import UserError
from bp2_rl.base.serialization import config_hash, from_json, to_json
from bp2_rl.robot.observation import Mirror, ObservationInputs
from bp2_rl.settings.env import EnvConfig
from bp2_rl.settings.task import onboard_source, read_task, run_task

PAGE = Path(__file__).parents[2] / "docs/howto/write_a_reward_term.md"
FILE = PAGE.read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]
ENTRY = 'bp2.ObservationTerm("lean", bp2.Mirror((0,), (-1,)), lean)'
TERM = 'bp2.RewardTerm("level_trunk", level_trunk, imitation=0.1, relaxed=0.05)'


@pytest.fixture
def task(tmp_path):
    (tmp_path / "my_task.py").write_text(FILE)
    return tmp_path / "my_task.py"


def test_a_task_changes_the_settings_and_is_data_in_them(task):
    env = bp2.preset("relaxed", "smoke", task=task).env
    assert env.task.rewards == (("level_trunk", 0.05),)
    assert env.randomization.friction == (0.4, 1.1)
    read = from_json(EnvConfig, to_json(env))
    assert config_hash(read) == config_hash(env)
    with pytest.raises(UserError, match=r"policy sees lean, .* RUN/task/my_task.py:"):
        _ = read.task.task
    assert read.task.with_code(read_task(task)) == env.task
    assert len(pickle.loads(pickle.dumps(env.task)).task.rewards) == 1


def test_the_environment_computes_rewards_terminations_and_observations(task):
    task.write_text(FILE.replace("> 3.0", "> -1.0"))  # each step skids
    env = bp2.make("bp2_kinematic", task=task)
    state = jax.jit(env.reset)(jax.random.PRNGKey(0))
    step = jax.jit(env.step)
    after = step(state, np.zeros(12))
    sizes = {name: len(value) for name, value in state.obs.items()}
    assert sizes == env.observation_size == {"state": 48, "privileged_state": 91}
    assert state.obs["state"][47] == state.obs["state"][30]  # the noisy `up`, too
    np.testing.assert_array_equal(
        state.obs["privileged_state"][-3:], state.pipeline_state.physics.qvel[3:6]
    )
    _, x, y, _ = after.pipeline_state.physics.qpos[3:7]
    assert after.metrics["reward/level_trunk"] == pytest.approx(
        0.1 * np.exp(-20.0 * 2.0 * (x**2 + y**2)), rel=1e-4
    )
    assert (after.done, after.metrics["fall/task/skids"]) == (1.0, 1.0)
    physics = state.pipeline_state.physics
    low = physics.replace(qpos=physics.qpos.at[2].set(0.2))
    episode = state.pipeline_state.replace(physics=low)
    both = step(state.replace(pipeline_state=episode), np.zeros(12)).metrics
    assert (both["fall/too_low"], both["fall/task/skids"]) == (1.0, 0.0)


def test_a_robots_computer_computes_the_observation_of_training(task):
    module, code = {}, read_task(task)
    exec(onboard_source(code, run_task(code)), module)
    [entry] = module["TASK_OBSERVATIONS"]
    now = ObservationInputs(*np.arange(96.0).reshape(8, 12))
    assert (entry.read(now), entry.mirror) == (now.up[1], Mirror((0,), (-1,)))


WRONG = {
    "raise RuntimeError('no')": ("", r"my_task.py, line 1 of my_task.py: Runtime"),
    "def": ("", r"my_task.py: SyntaxError"),
    "import sys; sys.exit()": ("", r"my_task.py, line 1 of my_task.py: SystemExit"),
    "TASK = 3": (None, r"has no TASK: let it say TASK = Task"),
    f"rewards=[{TERM}, {TERM}]": (
        f"rewards=[{TERM}]",
        r"rewards has level_trunk twice",
    ),
    'bp2.RewardTerm("level-trunk",': (
        'bp2.RewardTerm("level_trunk",',
        r"'level-trunk' is no name",
    ),
    ENTRY.replace("lean", "up", 1): (ENTRY, r"the policy sees up already"),
    # of the tests alone: types are checked at run time
    'bp2.ObservationTerm("lean", None, lean)': (
        ENTRY,
        r"lean has no mirror|lean\', \'mirror\': None",
    ),
    'bp2.ObservationTerm("lean", bp2.Mirror((1, 0), (1, -1)), lean)': (
        ENTRY,
        r"lean, taken twice",
    ),
    'bp2.ObservationTerm("lean", bp2.Mirror((0,), (1,)), lean)': (
        ENTRY,
        r"of a mirrored robot is",
    ),
    'bp2.ObservationTerm("lean", bp2.Mirror((0, 1), (1, 1)), lean)': (
        ENTRY,
        r"lean .*cannot reshape",
    ),
    'bp2.ObservationTerm("lean", bp2.Mirror((0,), (-1,)), lambda now: now.up[1])': (
        ENTRY,
        r"as a def",
    ),
    "return jnp.sin(now.up[1:2])": ("return now.up[1:2]", r"lean .*name 'jnp'"),
    "return now.episode.q[2:3]": ("return now.up[1:2]", r"lean .* critic's \(privi"),
    "settings=lambda config: 3": ("settings=on_ice", r"settings takes the TrainConfig"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_mistake_in_a_task_is_told_by_name(task, wrong):
    right, told = WRONG[wrong]
    whole = {"": f"{wrong}\n{FILE}", None: wrong}
    task.write_text(whole.get(right, FILE.replace(str(right), wrong)))
    with pytest.raises(UserError, match=told):
        bp2.preset("imitation", "smoke", task=task)


@pytest.mark.parametrize(
    ("right", "wrong", "told"),
    [
        ("x.e_z[2]", "x.e_z", r"reward term level_trunk .one number.: "),
        (
            "x.e_z[2]",
            "x.tilt",
            r"reward term level_trunk.* line 9 of my_task.py: Attribute",
        ),
        ("now.velocity[1]", "now.velocity", r"termination skids .one number.: "),
        ("qvel[3:6]", "qvel", r"observation spin .3 numbers by its mirror image"),
        (
            'bp2.RewardTerm("level_trunk"',
            'bp2.RewardTerm("tracking"',
            r"a reward term tracking already",
        ),
    ],
)
def test_a_mistake_that_only_training_meets_is_told_by_name(task, right, wrong, told):
    task.write_text(FILE.replace(right, wrong))

    def step(key):
        env = bp2.make("bp2_kinematic", task=task)
        return env.step(env.reset(key), jnp.zeros(12))

    with pytest.raises(UserError, match=told):
        jax.eval_shape(step, jax.random.PRNGKey(0))


def test_two_tasks_with_modules_of_one_name_stay_apart(tmp_path):
    found = []
    for folder in ("0.25", "0.5"):
        file = tmp_path / folder / "my-task.py"
        file.parent.mkdir()
        (tmp_path / folder / "random.py").write_text(f"HOW = {folder}\n")
        text = FILE.replace("=0.1", "=HOW").replace("TASK", "OTHER")
        file.write_text(f"from random import HOW\n{text}")
        found += bp2.preset("imitation", "smoke", task=f"{file}:OTHER").env.task.rewards
    assert found == [("level_trunk", 0.25), ("level_trunk", 0.5)]
    assert sys.modules["random"] is random


def test_a_policy_without_a_task_of_its_own_takes_none(task):
    with pytest.raises(UserError, match=r"not that of any task"):
        bp2.load_policy("built", task=task)
    with pytest.raises(
        UserError, match=r"no task nowhere: name FILE.py, FILE.py:NAME or"
    ):
        bp2.load_policy("built", task="nowhere")
