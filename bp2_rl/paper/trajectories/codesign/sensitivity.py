"""The optimum under other settings: which of its numbers are the robot's, and which are
the settings'."""

import dataclasses
from pathlib import Path
from typing import Any

from bp2_rl.paper.trajectories.codesign.chain import solve_chains
from bp2_rl.paper.trajectories.codesign.search import (
    DesignRow,
    cheapest,
    find_designs,
    start_chain,
)
from bp2_rl.paper.trajectories.codesign.settings import CodesignSettings
from bp2_rl.robot import bp2, conventions


def vary_settings(
    settings: CodesignSettings, folder: Path, workers: int = 1
) -> tuple[DesignRow, ...]:
    """The optimum under the settings and under each of `variations`; from cold starts
    and from the settings' optimum.

    Raises:
        NotSolved: no start led to a trajectory even under the settings themselves.
    """
    base, _ = find_designs(settings, folder, workers)[0]
    ways = {
        "as stated": [start_chain(settings, seed) for seed in range(settings.starts)]
    }
    for case, changed in variations(settings).items():
        ways[case] = [
            dataclasses.replace(base, bounds=changed.bounds).then(changed.problem)
        ]
        ways[case] += [
            start_chain(changed, seed) for seed in range(settings.starts_elsewhere)
        ]
    solve_chains(
        [chain for chains in ways.values() for chain in chains],
        folder,
        workers,
        "sensitivity",
    )
    return cheapest(ways.items(), folder)


def variations(settings: CodesignSettings) -> dict[str, CodesignSettings]:
    """One setting after another changed to another value that could be defended as
    well; names say value and unit."""
    problem, weights, hardware = (
        settings.problem,
        settings.problem.weights,
        settings.problem.hardware,
    )
    body_weight, inertia = (
        bp2.TOTAL_MASS * conventions.GRAVITY,
        hardware.parameter("rotor_inertia"),
    )

    def pose(**changes: Any) -> CodesignSettings:
        return dataclasses.replace(
            settings, problem=dataclasses.replace(problem, **changes)
        )

    def weigh(**changes: float) -> CodesignSettings:
        return pose(weights=dataclasses.replace(weights, **changes))

    def build(**changes: float) -> CodesignSettings:
        return pose(hardware=dataclasses.replace(hardware, **changes))

    def limit(longest: float) -> CodesignSettings:
        leg_length = (settings.bounds.leg_length[0], longest)
        return dataclasses.replace(
            settings, bounds=dataclasses.replace(settings.bounds, leg_length=leg_length)
        )

    cases = {
        f"F bar {share:g} body weights": weigh(force=round(share * body_weight))
        for share in (1, 2, 3, 4)
    }
    for name in ("power", "load", "smoothness"):
        scaled = [factor * getattr(weights, name) for factor in (0.25, 4.0)]
        cases |= {
            f"{name} weight {value:g}": weigh(**{name: value}) for value in scaled
        }
    cases |= {
        f"rotor {x * inertia * 1e4:g}e-4 kg m2": build(rotor_inertia=x * inertia)
        for x in (0.5, 2.0, 4.0)
    }
    cases |= {
        f"speed margin {margin:g}": pose(speed_margin=margin)
        for margin in (0.5, 0.65, 0.8, 1.0)
    }
    cases |= {
        f"corner speed {speed:g} rad/s": build(corner_speed=speed)
        for speed in (0.0, bp2.CORNER_SPEED)
    }
    cases |= {
        f"peak torque {torque:g} Nm": build(peak_torque=torque)
        for torque in (100.0, bp2.PEAK_TORQUE)
    }
    cases |= {
        f"foot radius {radius:g} m": pose(foot_radius=radius)
        for radius in (0.0, bp2.FOOT_RADIUS)
    }
    cases |= {f"leg up to {longest:g} m": limit(longest) for longest in (0.36, 0.45)}
    return {case: changed for case, changed in cases.items() if changed != settings}
