"""The learner's hyperparameters."""

import dataclasses
import math
from typing import Annotated, Literal

from bp2_rl.base.bounds import Share, Within, check_bounds
from bp2_rl.base.errors import UserError

Activation = Literal["swish", "elu", "tanh", "relu"]
Dtype = Literal["float32", "bfloat16"]
Scale = Annotated[float, Within(0.0, 1e6, open_below=True)]
Decay = Annotated[float, Within(0.0, 1e9, open_below=True, infinite=True)]
Weight = Annotated[float, Within(0.0, 1e6)]
Layers = tuple[Annotated[int, Within(1, 2**16)], ...]
MAX_BLOCKS = 64
"""Most blocks within which robots are shuffled; the number of devices must divide the
number of blocks."""


@dataclasses.dataclass(frozen=True)
class PPOConfig:
    """Hyperparameters of PPO. One train step collects num_envs x unroll_length control
    steps and takes num_epochs x num_minibatches gradient steps on them."""

    num_envs: Annotated[int, Within(1, 2**24)] = 8192
    unroll_length: Annotated[int, Within(1, 2**16)] = 24
    num_minibatches: Annotated[int, Within(1, 2**24)] = 16
    num_epochs: Annotated[int, Within(1, 2**16)] = 4
    episode_length: Annotated[int, Within(1, 2**30)] = 1600  # control steps
    learning_rate: Scale = 3e-4
    # adapts the learning rate to this mean KL divergence; None = fixed
    desired_kl: Scale | None = 0.01
    # train steps after which the desired divergence d has halved: d / (1 + step /
    # kl_decay)
    kl_decay: Decay = float("inf")
    max_learning_rate: Scale = 1e-3
    # number of first train steps in which only the critic learns
    critic_steps: Annotated[int, Within(0, 2**30)] = 0
    averaging: Annotated[float, Within(0.0, 1.0, open_above=True)] = 0.0
    """factor a of the exponential average of the policy's weights, which is exported:
    average = a x average + (1 - a) x weights at each train step"""
    discounting: Share = 0.985
    gae_lambda: Share = 0.95
    clipping: Scale = 0.2
    entropy_cost: Weight = 5e-3
    # train steps after which the entropy cost c has halved: c / (1 + step /
    # entropy_decay)
    entropy_decay: Decay = float("inf")
    value_coefficient: Weight = 1.0
    max_grad_norm: Scale = 1.0
    reward_scaling: Scale = 1.0
    policy_layers: Layers = (512, 256, 128)
    value_layers: Layers = (512, 256, 128)
    activation: Activation = "swish"
    # of the hidden layers in symmetric networks; other networks are Brax's, in float32
    dtype: Dtype = "float32"
    initial_std: Scale = 0.3
    # networks that are left-right symmetric by construction; their layers need even
    # widths
    symmetric: bool = False

    def __post_init__(self) -> None:
        """Raise `UserError` for impossible values, with a line that says how to correct
        them."""
        check_bounds(self, "ppo.")
        for name in ("policy_layers", "value_layers"):
            if not getattr(self, name):
                raise UserError(f"ppo.{name} must name one layer or more")
            if self.symmetric and any(width % 2 for width in getattr(self, name)):
                raise UserError(
                    f"ppo.{name} must be even where ppo.symmetric is on: units come in mirrored pairs"
                )
        if self.desired_kl is not None and self.max_learning_rate < self.learning_rate:
            raise UserError(
                f"ppo.max_learning_rate ({self.max_learning_rate:g}) must be at least ppo.learning_rate "
                f"({self.learning_rate:g})"
            )
        if self.num_envs % self.num_minibatches:
            raise UserError(
                f"ppo.num_envs ({self.num_envs}) must be a multiple of ppo.num_minibatches ({self.num_minibatches})"
            )

    @property
    def steps_per_train_step(self) -> int:
        """Control steps in a train step, summed over all robots."""
        return self.num_envs * self.unroll_length

    @property
    def shuffle_blocks(self) -> int:
        """Number of blocks of robots within which an epoch's robots are shuffled."""
        return math.gcd(self.num_envs // self.num_minibatches, MAX_BLOCKS)
