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
import select
import subprocess
import sys
import time
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from bp2_rl.base.errors import UserError, one_line, require_one_of

from .binary import BINARY
from .contents import Settings, describe, read_bundle
from .controller import DriveTargets, OnboardController
from .link import COMMAND, SENSORS, TARGETS, Radio
from .robot import DT, FAULTS, TICK, RehearsalPlan, RehearsalWorld
from .watchdog import SensorReading

GRACE = 0.001  # s, for which a measurement that is due is waited for
OPERATOR_SILENCE = 0.5  # s, after which the operator counts as silent
LEAST_SHARE, LONGEST_WAIT = 0.95, 30.0
"""Least real-time factor and share of a second's ticks in time, and longest wait for
targets (ms), of a valid rehearsal: on a busier machine BP2 falls at 10.74 m/s under any
controller."""
PATIENCE = 10.0  # s, within which a program of its own prints its port
SECOND = round(1.0 / (TICK * DT))  # ticks


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
        program: controls the robot in the place of this process, such as the bundle's
            `cpp/main.cpp` compiled.

    Raises:
        UserError: the program does not run.
    """
    _pin(core)
    computer = Computer(folder) if program is None else ProgramProcess(folder, program)
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe()
    process = spawn.Process(
        target=_run_robot,
        args=(Path(folder), robot, plan, core, computer.port, theirs),
        daemon=True,
    )
    process.start()
    theirs.close()
    gc.collect()
    # a collection would stop a tick; there is little to collect in half a minute
    gc.disable()
    try:
        port = ours.recv()
        ours.send("ready")
        told = computer.run(port, ours)
        outcome = {"real_time": ours.recv(), **ours.recv()}
    except EOFError:
        raise RuntimeError("the robot's process ended before the rehearsal") from None
    finally:
        gc.enable()
        computer.close()
        process.join(5.0)
        process.kill()
    busy = (
        min(outcome["real_time"], 1.0 - outcome["most_late"] / SECOND) < LEAST_SHARE
        or outcome["waited_ms"] > LONGEST_WAIT
    )
    return {**outcome, **told, "too_busy": busy}


class Computer:
    """The robot's computer in this process."""

    def __init__(self, folder: Path | str):
        self._controller, self._radio = OnboardController(folder), Radio()
        self.port, self.close = self._radio.port, self._radio.close

    def run(self, port: int, world: Connection) -> Settings:
        """Run the controller until the rehearsal ends; return the number of ticks,
        their (p50, p99, max) from a measurement to its answer, fault and limits
        used."""
        controller, radio = self._controller, self._radio
        radio.connect(port)
        inbox, ticks, packets = Inbox(), [], radio.receive(30.0)
        while packets or not world.poll():
            start, used, now = time.perf_counter(), time.thread_time(), time.monotonic()
            for kind, values in packets:
                inbox.take(kind, values, now)
            targets = inbox.tick(controller, now)
            radio.send(TARGETS, np.concatenate(targets))
            ticks.append((time.perf_counter() - start, time.thread_time() - used))
            # what is there is heard even if this tick took longer than it may
            packets, deadline = radio.receive(), now + TICK * DT + GRACE
            while all(kind != SENSORS for kind, _ in packets) and (
                (left := deadline - time.monotonic()) > 0.0
            ):
                packets += radio.receive(left)
        wall, cpu = np.percentile(1e3 * np.array(ticks), (50, 99, 100), axis=0).T
        return {
            "ticks": len(ticks),
            "wall_ms": wall.tolist(),
            "cpu_ms": cpu.tolist(),
            "fault": controller.fault,
            "used": controller.watchdog.used,
        }


class ProgramProcess:
    """A program of its own that controls the robot, started with the bundle's file for
    C++.

    It prints its port, and when it is ended a line of JSON, as `Computer.run` returns
    it.
    """

    def __init__(self, folder: Path | str, program: Path):
        command = str(program.resolve()), str(Path(folder) / BINARY)
        try:
            self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        except OSError as error:
            raise UserError(f"{program} does not run: {one_line(str(error))}") from None
        assert self._process.stdout is not None
        self._out = self._process.stdout
        heard, _, _ = select.select([self._out], [], [], PATIENCE)
        line = self._out.readline().strip() if heard else ""
        if not line.isdecimal():
            self.close()
            raise UserError(f"{program} printed no port within {PATIENCE:g} s")
        self.port = int(line)

    def run(self, port: int, world: Connection) -> Settings:
        """Let the program run until the rehearsal ends; return what it says of its
        ticks."""
        del port  # it answers whoever speaks first
        world.poll(None)
        self._process.terminate()
        return json.loads(self._out.read())

    def close(self) -> None:
        """End the program."""
        self._process.kill()
        self._process.wait()
        self._out.close()


def _run_robot(
    folder: Path,
    robot: str,
    plan: RehearsalPlan,
    core: int | None,
    port: int,
    computer: Connection,
) -> None:
    """Run the simulated robot in real time, in a process of its own."""
    _pin(core)
    radio, world = Radio(), RehearsalWorld(folder, robot, plan)
    radio.connect(port)
    computer.send(radio.port)
    computer.recv()
    gc.disable()
    answers = np.zeros(-(-world.milliseconds // TICK))  # heard in each tick
    heard = waited = 0  # ms of the robot's time, and ms
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
    # at once, so that the computer does not take the end for silence
    computer.send(world.milliseconds * DT / (time.monotonic() - start))
    # A measurement that comes late, too, is answered beside its tick: the computer,
    # which has gone on without it, answers twice in one.
    late = answers != 1
    computer.send(
        {
            **world.outcome(),
            "due": len(late),
            "late": int(late.sum()),
            "most_late": int(np.convolve(late, np.ones(SECOND)).max()),  # in a second
            "waited_ms": waited,
        }
    )


def _pin(core: int | None) -> None:
    if core is not None:
        os.sched_setaffinity(0, {core})


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
            f"{describe(settings)}, on the {robot} robot for {plan.duration:.1f} s; ground: {settings['ground']}",
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
