"""The observation terms that a task adds: none here, a policy's in its
bundle."""

from bp2_rl.robot.observation import ObservationInputs, ObservationTerm

TASK_OBSERVATIONS: tuple[ObservationTerm[ObservationInputs], ...] = ()
