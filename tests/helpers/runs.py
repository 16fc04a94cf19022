"""A single run of the simulator."""

from bp2_rl.simulation.rollout import RunRequest, simulate


def run_one(policy, schedule, config, **request):
    """A trajectory; `request` are fields of `RunRequest`."""
    [run] = simulate(policy, [RunRequest(schedule, **request)], config)
    return run
