"""Sets of reward coefficients, each with a column for the imitation stage and one for
the relaxed stage."""

from bp2_rl.settings.env import RewardConfig, TrackingShape
from bp2_rl.settings.training import Stage

PAPER: dict[Stage, RewardConfig] = {
    "imitation": RewardConfig(),
    "relaxed": RewardConfig(
        height=0.0,
        attitude=0.0,
        imitation=0.1,
        tracking=0.4,
        torque=0.2,
        power=0.1,
        smoothness=0.2,
        symmetry=0.1,
    ),
}
"""The paper's reward coefficients: the two columns of Table S4."""

SHAPE = TrackingShape(
    floor=0.1, width=9.0, tail=0.5, yaw_width=0.1, yaw_reach=0.3, memory=0.2
)
"""A tracking reward with a slope at every error: narrow at low speed, wide at high
speed, with a linear tail, of errors averaged over the trunk's sway within a stride."""

OURS: dict[Stage, RewardConfig] = {
    "imitation": RewardConfig(tracking=2.0, tracking_shape=SHAPE),
    "relaxed": RewardConfig(
        height=0.0,
        attitude=0.0,
        imitation=0.1,
        tracking=2.0,
        torque=0.1,
        power=0.1,
        smoothness=0.2,
        symmetry=0.1,
        tracking_shape=SHAPE,
    ),
}
"""Table S4's coefficients with more weight on tracking, in another shape: with the
paper's shape a robot that is 2 m/s too slow gains no reward by running faster.
docs/notes/training.md has the ablation."""

SMALL_SHAPE = TrackingShape(width=9.0, tail=0.3, yaw_width=0.4)
OURS_SMALL: dict[Stage, RewardConfig] = {
    "imitation": RewardConfig(tracking=1.25, tracking_shape=SMALL_SHAPE),
    "relaxed": RewardConfig(
        height=0.0,
        attitude=0.0,
        imitation=0.1,
        tracking=1.25,
        torque=0.1,
        power=0.1,
        smoothness=0.2,
        symmetry=0.1,
        tracking_shape=SMALL_SHAPE,
    ),
}
"""`OURS` for a small fleet, with less weight on tracking, in a wider shape: closer
tracking is learned more slowly."""
