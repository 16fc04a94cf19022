"""A preset on another robot: BP2's settings stay, another robot's follow its size."""

import dataclasses

import pytest
from odd_robots import plain

from bp2_rl.base.errors import UserError
from bp2_rl.base.serialization import from_json, to_json
from bp2_rl.robot.hardware import BUILT
from bp2_rl.robot.kinematics import reach
from bp2_rl.robot.named import find_robot, shipped_files
from bp2_rl.robot.reading import read_mjcf
from bp2_rl.robot.robot_file import robot_text
from bp2_rl.settings import presets
from bp2_rl.settings.presets.robots import sized, speed_factor
from bp2_rl.settings.training import TrainConfig

SHIPPED = list(shipped_files())


def test_bp2_has_the_settings_that_were_written_for_it_however_it_is_changed():
    env = presets.preset("relaxed", "gpu").env
    assert sized(env) is env
    longer = BUILT.changed(leg_length=0.4)
    assert sized(dataclasses.replace(env, hardware=longer)).control == env.control


@pytest.mark.parametrize("name", SHIPPED)
def test_another_robots_settings_are_those_of_its_size(name):
    robot, bp2 = find_robot(name), presets.preset("relaxed", "cpu").env
    env, size = presets.preset("relaxed", "cpu", robot=name).env, robot.size
    weight_times_length = (
        robot.mass * robot.anatomy.leg_length / (BUILT.mass * BUILT.anatomy.leg_length)
    )
    assert size.torque == pytest.approx(weight_times_length)
    assert env.control.stiffness == pytest.approx(
        weight_times_length * bp2.control.stiffness
    )
    assert env.termination.min_height / robot.anatomy.leg_length == pytest.approx(
        bp2.termination.min_height / BUILT.anatomy.leg_length
    )
    froude = [
        config.commands.slow**2 / one.anatomy.leg_length
        for config, one in ((env, robot), (bp2, BUILT))
    ]
    assert froude[0] == pytest.approx(froude[1])
    assert env.commands.max_forward == pytest.approx(
        speed_factor(robot) * bp2.commands.max_forward
    )
    assert env.reference == "kinematic"
    # nobody knows how fast it is
    assert env.curriculum.start_speed == pytest.approx(env.commands.max_forward / 4.0)
    # The legs can stretch as far as the gait sweeps.
    stretched = size.length * (env.gait.height**2 + (env.gait.sweep / 2.0) ** 2) ** 0.5
    assert stretched <= reach(hardware=robot)[1]


@pytest.mark.parametrize(
    "knee_range",
    ["-2.6 -0.3", "-2.6 1.9", "-1.9 2.6", "-3.1416 3.1416", "0 2.6", "-9 9"],
)
def test_a_knee_that_passes_through_straight_has_the_gait_of_one_that_stops_there(
    knee_range, tmp_path
):
    """0.55 m of BP2's, which a straight leg reaches whatever else its knee can do."""
    env = presets.preset(
        "imitation", "cpu", robot=str(robot_of(tmp_path, plain(knee_range=knee_range)))
    ).env
    assert env.gait.height == presets.preset("imitation", "cpu").env.gait.height == 0.55


def test_knees_that_cannot_stretch_for_the_gait_are_refused_by_name(tmp_path):
    file = robot_of(tmp_path, plain(knee_range="-2.6 -2.5"))
    with pytest.raises(
        UserError,
        match=r"the knees of plain let its legs reach 0.*correct the knees' range",
    ):
        presets.preset("imitation", "cpu", robot=str(file))


def robot_of(folder, model):
    """Write a model and the robot file that is filled in from it; return the file's
    path."""
    (folder / "model.xml").write_text(model)
    file = folder / "robot.toml"
    file.write_text(robot_text(read_mjcf(folder / "model.xml"), "model.xml"))
    return file


def test_another_robot_keeps_to_slow_commands_and_learns_with_less_and_less_noise():
    ours, of_bp2 = (
        presets.preset("relaxed", "cpu", robot=name) for name in ("go1", "built")
    )
    assert ours.env.reward.tracking_shape.floor < of_bp2.env.reward.tracking_shape.floor
    assert (ours.env.reward.schedule, of_bp2.env.reward.schedule) == ("off", "text")
    assert ours.env.commands.slow_fraction > of_bp2.env.commands.slow_fraction
    train_steps = ours.run.steps / ours.ppo.steps_per_train_step
    assert ours.ppo.entropy_decay == pytest.approx(0.02 * train_steps)
    # Neither the paper's rewards nor a first stage are touched.
    assert (
        presets.preset("relaxed", "cpu", "paper", "go1").env.reward
        == presets.preset("relaxed", "cpu", "paper").env.reward
    )
    assert (
        presets.preset("imitation", "cpu", robot="go1").ppo
        == presets.preset("imitation", "cpu").ppo
    )


@pytest.mark.parametrize("name", SHIPPED)
def test_a_run_holds_its_robot_whole(name):
    config = presets.preset("imitation", "cpu", robot=name)
    assert from_json(TrainConfig, to_json(config)) == config
