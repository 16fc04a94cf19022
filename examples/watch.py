"""Run a policy in C MuJoCo, print its speed, and save pictures, and a film if there is
a GL library.

python examples/watch.py                     # the policy that ships
python examples/watch.py runs/slow_trot      # yours
"""

import sys
from pathlib import Path

import bp2_rl as bp2
from bp2_rl.base.plotting import save_figure
from bp2_rl.simulation.figures import gait_figure
from bp2_rl.simulation.film import NoVideo, make_video

OUT = Path("reports/watch")


def watch(
    policy_or_run: Path | str, speed: float, hold: float, out: Path
) -> bp2.RunMetrics:
    """Run a policy from a stand to `speed` (m/s), held for `hold` seconds; save
    trajectory and picture in `out`."""
    policy = bp2.load_policy(policy_or_run)
    # A schedule gives the command over time; the policy's card names the robot of its
    # training.
    run = bp2.rollout(policy, bp2.Ramp((speed, 0.0, 0.0), acceleration=2.4, hold=hold))
    out.mkdir(parents=True, exist_ok=True)
    # every millisecond: states, torques, targets, forces of the ground
    run.save(out / "trajectory.npz")
    save_figure(gait_figure(run), out / "gait.png")
    return run.metrics


def main() -> None:
    """Watch the policy that the argument names, or the shipped policy `built`."""
    metrics = watch(
        sys.argv[1] if len(sys.argv) > 1 else "built", speed=2.0, hold=5.0, out=OUT
    )
    fell = (
        "did not fall"
        if metrics.fell_at is None
        else f"fell after {metrics.fell_at:.2f} s"
    )
    print(
        f"{metrics.mean_speed:.2f} m/s where {metrics.commanded_speed:g} m/s were commanded; {fell}"
    )
    print(
        f"hardest foot {metrics.peak_foot_force:.0f} N, springs up to {1000 * metrics.peak_spring_travel:.0f} mm"
    )
    try:
        make_video(OUT / "trajectory.npz", OUT / "film.mp4")
    except NoVideo as why:
        print(why)
    print(f"pictures: {OUT}")


if __name__ == "__main__":
    main()
