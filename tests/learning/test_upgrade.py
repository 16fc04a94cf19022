"""Cards and runs of before the robot stood once in an `EnvConfig`: `before/` has the shipped card of then, without its
results, and the settings of a smoke training."""

import copy
import json
import re
import shutil
from pathlib import Path

import pytest

from bp2_rl.base.assets import asset_path
from bp2_rl.base.errors import UserError
from bp2_rl.base.serialization import from_json, to_json
from bp2_rl.learning.policy import load_policy
from bp2_rl.learning.run import load_run_config
from bp2_rl.robot.specs import Losses
from bp2_rl.settings.env import EnvConfig, upgrade
from bp2_rl.settings.training import TrainConfig, make_config

BEFORE = Path(__file__).parent / "before"


@pytest.fixture
def old_policy(tmp_path):
    """A folder with the card of then beside the weights that it is of."""
    shutil.copy(asset_path("policies/ideal/weights.npz"), tmp_path)
    shutil.copy(BEFORE / "card.json", tmp_path)
    return tmp_path


def test_the_robot_stands_once():
    assert sum("gear_ratio" in key for key in re.findall(r'"\w+":', json.dumps(to_json(EnvConfig())))) == 1


def test_a_card_of_before_is_the_card_of_the_same_environment(old_policy):
    old, new = load_policy(old_policy).card, load_policy(asset_path("policies/ideal")).card
    assert old.env == new.env
    assert old.weights_sha256 == new.weights_sha256


def test_settings_of_before_are_those_of_today():
    assert load_run_config(BEFORE) == make_config("imitation", "smoke", robot="ideal")


def test_the_speeds_at_which_gaits_begin_to_step_keep_their_values(old_policy):
    card = json.loads((old_policy / "card.json").read_text())
    card["env"]["library"]["start_speed"] = 0.37
    (old_policy / "card.json").write_text(json.dumps(card))
    env = load_policy(old_policy).card.env
    assert (env.library.stepping_speed, env.gait.stepping_speed) == (0.37, 0.2)


def test_the_lag_and_the_stops_of_before_are_those_of_the_hardware(old_policy):
    card = json.loads((old_policy / "card.json").read_text())
    card["env"]["control"]["current_lag"] = 0.004
    for part in (card["env"], card["env"]["gait"], card["env"]["library"]):
        part["hardware"]["spring_stop_stiffness"] = 45e3
    (old_policy / "card.json").write_text(json.dumps(card))
    hardware = load_policy(old_policy).card.env.hardware
    assert hardware.losses == Losses(current_lag=0.004)
    assert (hardware.spring_stop_stiffness, hardware.rebound_stiffness) == (45e3, 45e3)


def test_settings_of_today_stay_as_they_are():
    today = to_json(TrainConfig())
    assert upgrade(copy.deepcopy(today)) == today
    assert from_json(TrainConfig, upgrade(today)) == TrainConfig()


@pytest.mark.parametrize("gait", ["gait", "library"])
def test_a_gait_of_another_robot_is_refused_by_name(old_policy, gait):
    card = json.loads((old_policy / "card.json").read_text())
    card["env"][gait]["hardware"]["leg_length"] = 0.36
    (old_policy / "card.json").write_text(json.dumps(card))
    with pytest.raises(UserError, match=rf"card\.json.*env\.{gait}\.hardware: is another robot") as refusal:
        load_policy(old_policy)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("data", [None, [], {}, {"env": 3}, {"env": {"gait": 3}}])
def test_what_is_no_file_of_ours_is_left_to_the_reader(data):
    assert upgrade(data) == data
