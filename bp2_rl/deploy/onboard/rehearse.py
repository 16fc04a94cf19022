"""Run a bundle's controller against C MuJoCo as if it were the robot: in real time,
over UDP, on one core.

    python -m onboard.rehearse                     # in the bundle's folder: 20 s at `rehearsal` in deploy.json
    python -m onboard.rehearse --fault nan --fault-at 3

This process is the robot. It sends measurements and the operator's command every 5 ms
and has its drives follow what comes back; datagrams are lost and come late. The robot's
computer is a process of its own, `computer` or a program: it answers each measurement,
and where none comes it goes on without.
"""

import argparse
import contextlib
import dataclasses
import gc
import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Generator, Sequence
from pathlib import Path

import numpy as np

from bp2_rl.base.errors import UserError, require_one_of

from .binary import BINARY
from .contents import Settings, describe_bundle, read_bundle
from .controller import DriveTargets
from .link import TARGETS, Radio
from .robot import DT, FAULTS, TICK, RehearsalPlan, RehearsalWorld

LEAST_SHARE, LONGEST_WAIT = 0.95, 30.0
"""Least real-time factor and share of a second's ticks in time, and longest wait for
targets (ms), of a valid rehearsal: on a busier machine BP2 falls at 10.74 m/s under any
controller."""
PATIENCE = 30.0  # s, within which the robot's computer prints its port
SECOND = round(1.0 / (TICK * DT))  # ticks


def in_real_time(
    folder: Path | str,
    robot: str,
    plan: RehearsalPlan,
    core: int | None,
    program: Path | None = None,
) -> Settings:
    """Rehearse a bundle in real time over UDP; return the outcome as numbers by name.

    Args:
        folder: the bundle.
        robot: one of its `robots`.
        plan: what is rehearsed.
        core: on which both processes run; None: wherever the system puts them.
        program: controls the robot in the place of `computer`, such as the bundle's
            `cpp/main.cpp` compiled.

    Raises:
        UserError: the bundle or the program does not run.
        OSError: there is no such program.
    """
    if core is not None:
        os.sched_setaffinity(0, {core})
    world, place = RehearsalWorld(folder, robot, plan), Path(folder).resolve()
    with (
        _computer(place, program) as (computer, port),
        contextlib.closing(Radio()) as radio,
    ):
        radio.connect(port)
        outcome = _run_robot(world, radio)
        ended = computer.poll()
        # at once, so that the computer does not take the end for silence
        computer.terminate()
        told = computer.communicate()[0]
        if ended is not None:
            raise UserError(
                f"{program or 'computer'} ended during the rehearsal, with exit status {ended}"
            )
    busy = (
        min(outcome["real_time"], 1.0 - outcome["most_late"] / SECOND) < LEAST_SHARE
        or outcome["waited_ms"] > LONGEST_WAIT
    )
    return {**outcome, **world.outcome(), **json.loads(told), "too_busy": busy}


@contextlib.contextmanager
def _computer(
    folder: Path, program: Path | None
) -> "Generator[tuple[subprocess.Popen[str], int]]":
    """Context manager that runs the robot's computer; yields its process and its
    port."""
    ours = [sys.executable, "-m", f"{__package__}.computer", str(folder)]
    command = [str(program.resolve()), str(folder / BINARY)] if program else ours
    root = Path(__file__).parents[1]  # of the package
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, cwd=root
    ) as process:
        assert process.stdout is not None
        try:
            heard, _, _ = select.select([process.stdout], [], [], PATIENCE)
            line = process.stdout.readline().strip() if heard else ""
            if line.startswith("error: "):
                raise UserError(line.removeprefix("error: "))
            if not line.isdecimal():
                silent = "no port, and ended" if heard else "no port in time"
                answer = f"{line!r} instead of its port" if line else silent
                raise UserError(f"{program or 'computer'} printed {answer}")
            yield process, int(line)
        finally:
            process.kill()


def _run_robot(world: RehearsalWorld, radio: Radio) -> dict[str, float]:
    """Run the simulated robot in real time; return the real-time factor, and how many
    ticks had no answer in time."""
    answers = np.zeros(-(-world.milliseconds // TICK))  # heard in each tick
    heard = waited = 0  # ms of the robot's time, and ms
    gc.freeze()  # later collections skip all objects that exist now
    start = time.monotonic()
    for k in range(world.milliseconds):
        due = start + k * DT
        while (left := due - time.monotonic()) > 0.0:
            time.sleep(left)
        now = time.monotonic()
        for kind, values in world.says(k, now):
            radio.send(kind, values)
        for kind, values in radio.receive():
            if kind == TARGETS:
                world.hears(DriveTargets(*np.split(values, 2)), now)
                answers[k // TICK] += 1
                heard = k
        waited = max(waited, k - heard)
        world.millisecond(k, now)
    took = time.monotonic() - start
    # A measurement that comes late, too, is answered beside its tick: the computer,
    # which has gone on without it, answers twice in one.
    late = answers != 1
    return {
        "real_time": world.milliseconds * DT / took,
        "due": len(late),
        "late": int(late.sum()),
        "most_late": int(np.convolve(late, np.ones(SECOND)).max()),  # in a second
        "waited_ms": waited,
    }


def show(result: Settings, plan: RehearsalPlan) -> str:
    """Describe the outcome of a rehearsal, one line for each subject."""
    fault, fell_at = result["fault"] or "silent", result["fell_at"]
    fell = "did not fall" if fell_at is None else f"fell after {fell_at:.2f} s"
    wall, cpu = (
        " / ".join(f"{ms:.3f}" for ms in result[name]) for name in ("wall_ms", "cpu_ms")
    )
    used = (f"{name} {100 * share:.0f} %" for name, share in result["used"].items())
    late = f"{result['late']} of {result['due']} ticks late, {result['most_late']} of them in a second"
    rows = {
        "real time": f"{result['real_time']:.3f} of it; {late}; the longest wait for targets {result['waited_ms']} ms",
        "datagrams": f"{result['lost']:.0f} of {result['sent']:.0f} lost, targets {1e3 * plan.late:g} ms late",
        "ticks": f"{result['ticks']}; p50 / p99 / max {wall} ms ({cpu} ms of processor)",
        "robot": f"{fell}, {result['distance']:.1f} m run, {result['beside_line']:.2f} m beside the line at most",
    }
    if result["mean_speed"] is not None:
        rows["speed"] = f"{result['mean_speed']:.2f} m/s over {plan.hold:g} s"
    if result["least_second"] is not None:
        rows["speed"] += f", slowest second {result['least_second']:.2f} m/s"
    if result["too_busy"]:
        busy = f"is this machine, {late}: a fall tells nothing of the controller; try --core -1 on idle cores"
        rows = {"TOO BUSY": busy} | rows
        fault = fault.partition(":")[0]  # whose line would blame the sensors
    rows["watchdog"] = f"{fault}; speed at the end {result['final_speed']:.2f} m/s"
    rows["limits used"] = ", ".join(used)
    return "\n".join(f"{name:11} {said}" for name, said in rows.items())


def parse(argv: Sequence[str] | None = None) -> argparse.Namespace:
    """Parse the command line of a rehearsal; flags that are not given are None."""
    parser = argparse.ArgumentParser(
        prog="python -m onboard.rehearse", description=(__doc__ or "").split("\n\n")[0]
    )
    add, here = parser.add_argument, Path(__file__).resolve().parent.parent
    bundle = "the bundle (default: that of this code)"
    add("folder", nargs="?", type=Path, default=here, help=bundle)
    add("--robot", help="one of deploy.json's robots (default: the first)")
    for field in dataclasses.fields(RehearsalPlan):
        kind = float if field.name == "speed" else type(field.default)
        choices = FAULTS[1:] if field.name == "fault" else None
        add(f"--{field.name.replace('_', '-')}", type=kind, choices=choices)
    last = max(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else -1
    cores = "the core for both processes (default: the last; -1: any)"
    add("--core", type=int, default=last, help=cores)
    add("--program", type=Path, help="a program that controls, such as cpp/main.cpp's")
    add("--json", action="store_true", help="print the outcome as JSON")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the rehearsal; return 1 if the robot fell or the watchdog stopped it
    unexpectedly, 2 for wrong input."""
    args = parse(argv)
    try:
        settings, _ = read_bundle(args.folder)
        robot = args.robot or next(iter(settings["robots"]), "")
        require_one_of("robot", robot, settings["robots"])
        names = [field.name for field in dataclasses.fields(RehearsalPlan)]
        given = {name: x for name in names if (x := getattr(args, name)) is not None}
        plan = RehearsalPlan(**{**settings["rehearsal"], **given})
        print(
            f"{describe_bundle(settings)}, on the {robot} robot for {plan.duration:.1f} s; ground: {settings['ground']}",
            file=sys.stderr,
        )
        result = in_real_time(
            args.folder,
            robot,
            plan,
            None if args.core == -1 else args.core,
            args.program,
        )
    except (OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(json.dumps(result) if args.json else show(result, plan))
    expected = plan.fault in ("nan", "silence")
    return int(result["fell_at"] is not None or bool(result["fault"]) != expected)


if __name__ == "__main__":
    sys.exit(main())
