"""Run a policy at 200 Hz on a robot's own computer, with NumPy and onnxruntime alone.

    controller = OnboardController("my_bundle")
    while True:                                            # every 5 ms
        targets = controller.step(measurement, command)    # joint targets for the drives' 1 kHz PD loop

A watchdog looks at everything that comes in (`watchdog`). Where sensors fall silent or
say what cannot be, the joints are led to the standing pose and kept there until
`reset`; where the operator falls silent, the robot slows down to a stand under the
policy.
"""

import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bp2_rl.base.errors import one_line
from bp2_rl.base.files import read_npz
from bp2_rl.robot.observation import OBSERVATION_TERMS, ObservationInputs

from .contents import (
    NETWORK,
    REFERENCE,
    BundleError,
    Convention,
    JointFrame,
    command_law,
    loading,
    read_bundle,
)
from .motion import load_motion, specs_of
from .task import TASK_OBSERVATIONS
from .watchdog import SensorFault, SensorReading, Watchdog

if TYPE_CHECKING:
    import onnxruntime

WARMING = 20  # ticks before the first
PLAYED = 12
"""Number of commands, and of phases, at which the reference motion is tested when it is
loaded."""


class DriveTargets(NamedTuple):
    """The joint angles and speeds that the drives follow until the next tick.

    torque = stiffness (position - q) + damping (velocity - qd).
    """

    position: np.ndarray  # (12) rad
    velocity: np.ndarray  # (12) rad/s


Command = Sequence[float] | np.ndarray | None
"""Velocity command: m/s forward, m/s to the left, rad/s yaw; None if the operator is
silent."""


class OnboardController:
    """A single robot's controller: from measurements and commands to joint targets. Not
    thread-safe.

    Args:
        folder: a bundle that `bp2 export --format onnx` wrote.
        clock: seconds; used if `step` gets no time.
        convention: whose signs and zeros the joint angles have that `step` takes and
            returns: the bundle's, or those of the robot's own model, which
            `model_joints` in `deploy.json` has.

    Raises:
        BundleError: the folder is no bundle of this format, is damaged, or its parts do
            not fit together.
    """

    def __init__(
        self,
        folder: Path | str,
        clock: Callable[[], float] = time.monotonic,
        convention: Convention = "bundle",
    ):
        self.settings, files = read_bundle(folder)
        self._clock, self._dt = clock, 1.0 / self.settings["rates"]["policy"]
        self._frame = JointFrame.of(self.settings, convention)
        with loading(folder):
            self.watchdog = Watchdog(self.settings, self._frame)
            control, command = self.settings["control"], self.settings["command"]
            self._stand = np.array(control["stand"], float)
            self._range = np.array(self.settings["joint_range"], float).T
            self._least, self._most = map(np.array, (command["least"], command["most"]))
            self._residual = control["mode"] == "residual"
            self._clock_at_rest = control["clock_at_rest"]
            self._scale, self._limit = control["action_scale"], control["action_limit"]
            stiffness = self.settings["gains"]["stiffness"]
            self._feedforward = control["feedforward"] / stiffness
            self._law = command_law(self.settings)
            arrays = read_npz(
                Path(folder) / REFERENCE,
                specs_of(self.settings["reference"]),
                content=files[REFERENCE],
            )
            self.motion = load_motion(self.settings["reference"], arrays)
            self._network = _load_network(files[NETWORK])
            self._load_observation()
            self.reset()
            self._try_motion()
            still = SensorReading(
                self._stand, np.zeros(12), np.array([0.0, 0.0, 1.0]), np.zeros(3), 0.0
            )
            for _ in range(WARMING):  # else the first ticks are the slowest
                self._act(still)
        self.reset()

    def _load_observation(self) -> None:
        """Find how each observation term is computed; `NAME@K` is a term's change over
        K ticks."""
        known = {term.name: term for term in (*OBSERVATION_TERMS, *TASK_OBSERVATIONS)}
        places, end = {}, 0
        names = [name.partition("@") for name, _ in self.settings["observation"]]
        for name, _, _ in names:
            if name not in known:
                raise BundleError(
                    f"the policy sees {name}, which the bundle's own code computes: run it in the bundle's folder"
                )
        self._terms = [known[name] for name, at, _ in names if not at]
        for term in self._terms:
            places[term.name] = slice(end, end := end + term.size)
        self._changes = [(int(ticks), places[name]) for name, at, ticks in names if at]
        longest = max((ticks for ticks, _ in self._changes), default=0)
        self._past: deque[np.ndarray] = deque(maxlen=longest)

    def _try_motion(self) -> None:
        """Compute the reference motion at many commands and phases; raise `SensorFault`
        for impossible targets."""
        for command in np.linspace(self._least, self._most, PLAYED).tolist():
            for phase in np.arange(PLAYED) / PLAYED:
                pose = self.motion(command, phase)
                self.watchdog.check_targets(pose.position, pose.velocity, pose.position)

    def reset(self, phase: float = 0.0) -> None:
        """Restart the controller at a gait phase (cycles), the only way to go on after
        a stop by the watchdog."""
        self.fault = ""
        """Reason for which the watchdog stopped the policy; empty while it runs."""
        self._phase = phase
        self._last_action = np.zeros(12, np.float32)
        self._past.clear()
        self.command = np.zeros(3, np.float32)
        self._targets = DriveTargets(self._stand.copy(), np.zeros(12))
        self._stopped_at, self._ticks_stopped = self._targets.position, 0
        self.watchdog.reset()

    def step(
        self,
        measurement: SensorReading | None,
        command: Command,
        now: float | None = None,
    ) -> DriveTargets:
        """Return the joint targets for the next tick of 5 ms from the newest
        measurement and command.

        `step` never raises for what a sensor, a clock or a link may bring, and no
        target is outside a joint's range.

        Args:
            measurement: the newest there is. One counts as new if its time is later
                than that of all before; an older one, the same again, or None say
                nothing new.
            command: kept within what the policy was trained for.
            now: s, by the clock that measurements are stamped with on arrival; by
                default the clock's time.
        """
        if not self.fault:
            try:
                now = self._clock() if now is None else now
                newest = self.watchdog.look(measurement, now, self._targets.position)
                self._obey(command)
                if newest is not None:  # else the first is still on its way
                    self._targets = self._act(newest)
            except Exception as error:  # a fault, or whatever a bundle's numbers lead to: the loop goes on
                wild = f"targets: they cannot be computed ({one_line(repr(error))[:100]}); is the bundle damaged?"
                self.fault = str(error) if isinstance(error, SensorFault) else wild
                self._stopped_at = self._targets.position
        if self.fault:
            self._targets = self._to_stand()
        return DriveTargets(*self._frame.outward(np.stack(self._targets)))

    def _to_stand(self) -> DriveTargets:
        """Return the next joint targets on a cubic path to the standing pose, which
        starts and ends at rest.

        Ticks are counted, because a clock may be what is at fault.
        """
        limits = self.watchdog.limits
        time, fastest = limits.stand_time, limits.joint_speed
        s = min(self._ticks_stopped * self._dt / time, 1.0)
        self._ticks_stopped += 1
        way = self._stand - self._stopped_at
        return self._within_range(
            self._stopped_at + way * s * s * (3.0 - 2.0 * s),
            np.clip(way * (6.0 * s * (1.0 - s) / time), -fastest, fastest),
        )

    # --- The policy -------------------------------------------------------------------

    def _obey(self, command: Command) -> None:
        """Set the command within the training's limits; slow down if it is not three
        finite numbers."""
        try:
            asked = np.asarray(command, float)
        except Exception:  # whatever the link to the operator brings
            asked = np.zeros(0)
        if asked.shape == (3,) and np.isfinite(asked).all():
            asked = np.clip(asked, self._least, self._most).astype(np.float32)
        else:
            speed = float(np.linalg.norm(self.command[:2]))
            slower = max(speed - self.watchdog.limits.braking * self._dt, 0.0)
            asked = self.command * np.float32(slower / speed if speed > 0.0 else 0.0)
        self.command = self._law.tell(self.command, asked)

    def _act(self, measurement: SensorReading) -> DriveTargets:
        """Compute a tick's joint targets by the network and the reference motion.

        Raises:
            SensorFault: the network's answer, or a target, cannot be.
        """
        command = self.command.astype(float).tolist()
        hand = 1.0 if self._clock_at_rest else self.motion.stepping(command)
        angle = 2.0 * math.pi * self._phase
        now = ObservationInputs(
            self.command,
            np.array((hand * math.sin(angle), hand * math.cos(angle))),
            *measurement[:4],
            self._last_action,
            self._stand,
        )
        read = [np.reshape(term.read(now), -1) for term in self._terms]
        frame: np.ndarray = np.concatenate(read, dtype=np.float32)
        changes = [
            frame[place] - self._past[-ticks][place]
            if ticks <= len(self._past)
            else 0.0 * frame[place]
            for ticks, place in self._changes
        ]
        self._past.append(frame)
        seen = np.concatenate([frame, *changes])[None]
        answer = np.asarray(self._network.run(None, {"obs": seen})[0])
        if answer.shape != (1, 12) or not np.isfinite(answer).all():
            raise SensorFault(
                "network: its answer is not 12 finite numbers; is policy.onnx damaged?"
            )
        action = np.minimum(np.maximum(answer[0], -self._limit), self._limit)
        self._phase = (self._phase + self._dt * self.motion.phase_rate(command)) % 1.0
        self._last_action = action
        offset = self._scale * action.astype(float)
        position, velocity = self._stand + offset, np.zeros(12)
        if self._residual:
            pose = self.motion(command, self._phase)
            position = pose.position + self._feedforward * pose.torque + offset
            velocity = pose.velocity
        targets = self._within_range(position, velocity)
        self.watchdog.check_targets(*targets, self._targets.position)
        return targets

    def _within_range(self, position: np.ndarray, velocity: np.ndarray) -> DriveTargets:
        lowest, highest = self._range
        return DriveTargets(np.minimum(np.maximum(position, lowest), highest), velocity)


def _load_network(content: bytes) -> "onnxruntime.InferenceSession":
    """Load the network to run on one core; it is too small for threads."""
    import onnxruntime  # here, so that `bp2 export` can say how to install it

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    return onnxruntime.InferenceSession(
        content, options, providers=["CPUExecutionProvider"]
    )
