"""The smallest training there is: tests that train it share its compiled programs."""

import dataclasses

from bp2_rl.settings.training import Stage, TrainConfig, make_config


def tiny(stage: Stage = "imitation", **run) -> TrainConfig:
    """The smoke preset with 16 robots and networks of one layer, four train steps long unless `run` says otherwise."""
    config = make_config(stage, "smoke")
    ppo = dataclasses.replace(
        config.ppo, num_envs=16, unroll_length=4, num_minibatches=2, policy_layers=(16,), value_layers=(16,)
    )
    settings = {"steps": 4 * ppo.steps_per_train_step, "checkpoints": 2, "logs": 4} | run
    return dataclasses.replace(config, ppo=ppo, run=dataclasses.replace(config.run, **settings))
