"""Run a bundle's controller against C MuJoCo as if it were the robot: in real time,
over UDP, on one core.

    python -m onboard.rehearse                     # in the bundle's folder: 20 s at `rehearsal` in deploy.json
    python -m onboard.rehearse --fault nan --fault-at 3

The robot is a process of its own. It sends measurements and the operator's command
every 5 ms and has its drives follow what comes back; datagrams are lost and come late.
This process is the robot's computer: it answers each measurement, and where none comes
it goes on without.
"""

import argparse
import dataclasses
import gc
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from bp2_rl.base.errors import require_one_of

from .contents import describe, read_bundle
from .controller import DriveTargets, OnboardController
from .link import COMMAND, SENSORS, TARGETS, Radio
from .robot import DT
from .watchdog import SensorReading
from .world import FAULTS, TICK, RehearsalPlan, RehearsalWorld

GRACE = 0.001  # s, for which a measurement that is due is waited for
OPERATOR_SILENCE = 0.5  # s, after which the operator counts as silent
PERCENTILES = (50, 99, 100)
LEAST_SHARE, LONGEST_DELAY = 0.95, 50.0
"""Of real time, and ms: a robot that is slower, or was further behind, is led astray by
the machine's delays."""


@dataclasses.dataclass
class Inbox:
    """The newest measurement and command that have been received."""

    measurement: SensorReading | None = None
    command: np.ndarray | None = None
    command_time: float = -np.inf

    def take(self, kind: bytes, values: np.ndarray, time: float) -> None:
        """Store the content of a datagram."""
        if kind == SENSORS:
            self.measurement = SensorReading(
                values[:12], values[12:24], values[24:27], values[27:30], time
            )
        elif kind == COMMAND:
            self.command, self.command_time = values, time

    def tick(self, controller: OnboardController, now: float) -> DriveTargets:
        """Run one tick of the controller with the newest measurement and command."""
        heard = now - self.command_time <= OPERATOR_SILENCE
        return controller.step(self.measurement, self.command if heard else None, now)


def in_real_time(
    folder: Path | str, robot: str, plan: RehearsalPlan, core: int | None
) -> dict[str, Any]:
    """Run the rehearsal over UDP in real time, and return its outcome.

    Args:
        folder: the bundle.
        robot: one of its `robots`.
        plan: what is rehearsed.
        core: on which both processes run; None: wherever the system puts them.
    """
    _pin(core)
    controller, radio = OnboardController(folder), Radio()
    ours, theirs = multiprocessing.get_context("spawn").Pipe()
    process = multiprocessing.get_context("spawn").Process(
        target=_live,
        args=(Path(folder), robot, plan, core, radio.port, theirs),
        daemon=True,
    )
    process.start()
    theirs.close()
    try:
        radio.connect(ours.recv())
        ticks = _drive(controller, radio, ours)
        outcome = ours.recv()
    except EOFError:
        raise RuntimeError("the robot's process ended before the rehearsal") from None
    finally:
        radio.close()
        process.join(5.0)
        process.kill()
    wall, cpu = (
        np.percentile(1e3 * np.array(times), PERCENTILES).tolist()
        for times in zip(*ticks, strict=True)
    )
    return {
        **outcome,
        "ticks": len(ticks),
        "wall_ms": wall,
        "cpu_ms": cpu,
        "fault": controller.fault,
        "too_slow": outcome["real_time"] < LEAST_SHARE
        or outcome["behind_ms"] > LONGEST_DELAY,
        "used": controller.watchdog.used,
    }


def _drive(
    controller: OnboardController, radio: Radio, world: Connection
) -> list[tuple[float, float]]:
    """Tick until the world ends; (wall, processor) seconds from each measurement's
    arrival to the answer's sending."""
    inbox, ticks = Inbox(), []
    gc.collect()
    # a collection would stop a tick; there is little to collect in half a minute
    gc.disable()
    world.send("ready")
    packets = radio.wait(30.0)
    try:
        while True:
            start, used = time.perf_counter(), time.thread_time()
            last = time.monotonic()
            for packet in packets:
                inbox.take(packet.kind, packet.values, packet.time)
            targets = inbox.tick(controller, last)
            radio.send(TARGETS, np.concatenate(targets))
            ticks.append((time.perf_counter() - start, time.thread_time() - used))
            packets = []
            deadline = last + TICK * DT + GRACE
            while (
                not any(packet.kind == SENSORS for packet in packets)
                and time.monotonic() < deadline
            ):
                packets += radio.wait(deadline - time.monotonic())
            if not packets and world.poll():
                return ticks
    finally:
        gc.enable()


def _live(
    folder: Path,
    robot: str,
    plan: RehearsalPlan,
    core: int | None,
    port: int,
    computer: Connection,
) -> None:
    """Run the simulated robot in a process of its own."""
    _pin(core)
    radio, world = Radio(), RehearsalWorld(folder, robot, plan)
    radio.connect(port)
    computer.send(radio.port)
    computer.recv()
    gc.disable()
    behind, start = 0.0, time.monotonic()
    for k in range(world.milliseconds):
        due = start + k * DT
        behind = max(behind, time.monotonic() - due)
        while (left := due - time.monotonic()) > 0.0:
            time.sleep(left)
        now = time.monotonic()
        for kind, values in world.says(k, now):
            radio.send(kind, values)
        for packet in radio.receive():
            if packet.kind == TARGETS:
                world.hears(
                    DriveTargets(packet.values[:12], packet.values[12:]), packet.time
                )
        world.millisecond(k, now)
    took = time.monotonic() - start
    computer.send(
        {
            **world.outcome(),
            "real_time": world.milliseconds * DT / took,
            "behind_ms": 1e3 * behind,
        }
    )


def _pin(core: int | None) -> None:
    if core is not None:
        os.sched_setaffinity(0, {core})


def show(result: dict[str, Any], plan: RehearsalPlan) -> str:
    """Describe the outcome, one line for each subject."""

    def row(times: Sequence[float]) -> str:
        return " / ".join(f"{ms:.3f}" for ms in times)

    fell = (
        "did not fall"
        if result["fell_at"] is None
        else f"fell after {result['fell_at']:.2f} s"
    )
    lines = [
        f"real time   {result['real_time']:.3f} of it; the robot was {result['behind_ms']:.1f} ms behind at most",
        f"datagrams   {result['lost']:.0f} of {result['sent']:.0f} lost, targets {1e3 * plan.late:g} ms late",
        f"ticks       {result['ticks']}; p50 / p99 / max {row(result['wall_ms'])} ms ({row(result['cpu_ms'])} ms of "
        "processor)",
        f"robot       {fell}, {result['distance']:.1f} m run, {result['beside_line']:.2f} m beside the line at most",
    ]
    if result["mean_speed"] is not None:
        slowest = (
            ""
            if result["least_second"] is None
            else f", slowest second {result['least_second']:.2f} m/s"
        )
        lines.append(
            f"speed       {result['mean_speed']:.2f} m/s over {plan.hold:g} s{slowest}"
        )
    fault = result["fault"] or "silent"
    if result["too_slow"]:
        lines.insert(
            0,
            "TOO SLOW    is this machine: nothing below is the robot's fault; try --core -1 on idle cores",
        )
        fault = fault.partition(":")[0]  # whose line would blame the sensors
    lines.append(
        f"watchdog    {fault}; speed at the end {result['final_speed']:.2f} m/s"
    )
    lines.append(
        "limits used "
        + ", ".join(
            f"{name} {100 * used:.0f} %" for name, used in result["used"].items()
        )
    )
    return "\n".join(lines)


def parse(argv: Sequence[str] | None = None) -> argparse.Namespace:
    """The command line."""
    here = Path(__file__).resolve().parent.parent
    parser = argparse.ArgumentParser(
        prog="python -m onboard.rehearse", description=(__doc__ or "").split("\n\n")[0]
    )
    parser.add_argument(
        "folder",
        nargs="?",
        type=Path,
        default=here,
        help="the bundle (default: that of this code)",
    )
    parser.add_argument(
        "--robot", help="one of deploy.json's robots (default: the first)"
    )
    for field in dataclasses.fields(RehearsalPlan):
        flag = f"--{field.name.replace('_', '-')}"
        # deploy.json has the robot's
        default = None if field.name == "speed" else field.default
        choices = FAULTS[1:] if field.name == "fault" else None
        parser.add_argument(
            flag,
            type=float if default is None else type(default),
            default=default,
            choices=choices,
        )
    parser.add_argument(
        "--core",
        type=int,
        help="the core for both processes (default: the last; -1: any)",
    )
    parser.add_argument("--json", action="store_true", help="print the outcome as JSON")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return 1 if the robot fell or the watchdog stopped it
    unexpectedly, 2 if the input is wrong."""
    args = parse(argv)
    plan = {
        field.name: getattr(args, field.name)
        for field in dataclasses.fields(RehearsalPlan)
    }
    core = args.core
    if core is None and hasattr(os, "sched_getaffinity"):
        core = max(os.sched_getaffinity(0))
    try:
        settings, _ = read_bundle(args.folder)
        robot = args.robot or next(iter(settings["robots"]), "")
        require_one_of("robot", robot, settings["robots"])
        plan = RehearsalPlan(
            **plan
            | (
                {}
                if args.speed is not None
                else {"speed": settings["rehearsal"]["speed"]}
            )
        )
        print(
            f"{describe(settings)}, on the {robot} robot for {plan.duration:.1f} s",
            file=sys.stderr,
        )
        result = in_real_time(args.folder, robot, plan, None if core == -1 else core)
    except (OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(json.dumps(result) if args.json else show(result, plan))
    return int(
        result["fell_at"] is not None
        or bool(result["fault"]) != (plan.fault in ("nan", "silence"))
    )


if __name__ == "__main__":
    sys.exit(main())
