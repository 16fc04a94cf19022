"""Print how fast policies run on robots that BP2 may as well be: `python
docs/plausible_robots.py built gentle`."""

import sys

import bp2_rl as bp2
from bp2_rl.robot.bp2 import OUTDOOR_TOP_SPEED
from bp2_rl.robot.hardware import BUILT, times

PAPERS_PACE = OUTDOOR_TOP_SPEED
HIND = slice(6, 12)  # motors of the hind legs


def robots() -> dict[str, bp2.HardwareSpec]:
    """Return the built robot, and others that differ from it in one property."""

    changed = BUILT.changed
    named = {"as assumed": BUILT, "no air, as on a treadmill": changed(drag_area=0.0)}
    named |= {
        f"spring damping {d} N s/m": changed(spring_damping=float(d))
        for d in (20, 50, 100, 150)
    }
    slower = {p: times(1.0 - p / 100, BUILT.no_load_speed) for p in (10, 20)}
    named |= {
        f"no-load speed -{p} %": changed(no_load_speed=speed)
        for p, speed in slower.items()
    }
    named |= {
        f"peak torque {nm} Nm": changed(peak_torque=float(nm))
        for nm in (110, 100, 90, 80)
    }
    named |= {f"bus sag {sag} % a kW": changed(bus_sag=sag / 100) for sag in (2.5, 5.0)}
    named |= {
        f"bus {out:g} kW out, {back:g} in": changed(
            bus_power_out=1e3 * out, bus_power_in=1e3 * back
        )
        for out, back in ((6, 3), (5, 2), (4, 1.5), (8, 1), (8, 0.5))
    }
    return named


def result(run: bp2.Trajectory) -> str:
    """Return the best second of a run, or when the robot fell."""
    return (
        f"falls after {run.fell_at:.1f} s"
        if run.fell_at
        else f"{run.metrics.best_speed:.2f}"
    )


def hind_power(run: bp2.Trajectory) -> str:
    """Return the peak powers of a hind hip and of a hind knee at the held speed."""
    held = run.time >= run.steady_from + 1.0  # s, in which the robot settles
    power = (run.torque * run.joint_velocity)[held, HIND]
    _, hip, knee = power.max(axis=0).reshape(2, 3).max(axis=0)
    return f"hip {hip:.0f} W, knee {knee:.0f} W"


def main(names: list[str]) -> None:
    """Print a row for each robot: the best second of each policy at its fastest command
    and at the paper's pace."""
    columns: list[list[str]] = []
    for name in names:
        policy = bp2.load_policy(name)
        for speed in (policy.card.env.commands.max_forward, PAPERS_PACE):
            ramp = bp2.Ramp(speed, hold=5.0).under(policy.card.env.control)
            runs = list(
                bp2.simulate(
                    policy, [bp2.RunRequest(ramp, robot) for robot in robots().values()]
                )
            )
            columns.append([result(run) for run in runs])
        print(
            f"{name}, as assumed, told {PAPERS_PACE} m/s: peaks of the hind motors are {hind_power(runs[0])}"
        )
    for robot, *cells in zip(robots(), *columns, strict=True):
        print("|", " | ".join([robot, *cells]), "|")


if __name__ == "__main__":
    main(sys.argv[1:])
