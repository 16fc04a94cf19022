"""The session in a browser: the robot in three dimensions, sliders and buttons, a chart. Needs the package viser.

The robot stays where it is on the page and the ground moves under it, so that no camera need follow it and a hand may
turn it about freely. Pages only say what they want: the robot is touched between two control steps, in `show`.
"""

import logging
import queue
from collections.abc import Callable
from typing import Any

import numpy as np
import viser
from jaxtyping import Float

from bp2_rl.base.errors import UserError
from bp2_rl.env.controller import motors_of
from bp2_rl.play.chart import TorqueSpeed
from bp2_rl.play.looks import Looks
from bp2_rl.play.pace import Pace
from bp2_rl.play.session import Session, Wish
from bp2_rl.robot.model import SOLE_SITES
from bp2_rl.robot.specs import LEGS

CELL, SECTION = 1.0, 10.0  # m, of the lines on the ground
NEWTONS_A_METRE, LEAST_FORCE = 1500.0, 20.0  # N/m, of an arrow; N, below which there is none
LEG_COLORS = (0, 114, 178), (230, 159, 0), (0, 158, 115), (204, 121, 167)  # as `plotting.LEG_COLORS`
GHOST_COLOR, GHOST_OPACITY = (80, 150, 255), 0.3
SEEN = 1e-4  # m, and of a quaternion: what moves by less stays where it is
READINGS = 5.0  # a second: how often numbers and chart are renewed
SLOWER = {"real time": 1.0, "1/2": 2.0, "1/5": 5.0, "1/10": 10.0}
PUSHES = {"forward": (1.0, 0.0), "back": (-1.0, 0.0), "left": (0.0, 1.0), "right": (0.0, -1.0)}
FASTER, TIGHTER = 0.5, 0.1  # m/s and rad/s that a key adds


class Page:
    """The page of a session; `close` ends its server.

    Args:
        session: to be shown.
        host: the address to listen at.
        port: the port to listen at; the next free one if another program uses it.

    Raises:
        UserError: there is no such place to listen at.
    """

    def __init__(self, session: Session, *, host: str, port: int):
        # Browsers open connections ahead that they then never use: not worth a traceback.
        logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
        try:
            self.server = viser.ViserServer(host=host, port=port, label="BP2", verbose=False)
        except (OSError, RuntimeError, OverflowError) as error:
            raise UserError(f"cannot listen at {host}:{port}: {error}; choose another --host or --port") from error
        self.url = f"http://{'localhost' if host in ('127.0.0.1', '0.0.0.0') else host}:{self.server.get_port()}"
        self._wishes: queue.SimpleQueue[Callable[[Session], None]] = queue.SimpleQueue()
        self._next_readings = 0.0
        self._scene = _Scene(self.server, session)
        self._panel(session)
        self._keys(session)

    def close(self) -> None:
        """End the server."""
        self.server.stop()

    def show(self, session: Session, pace: Pace) -> bool:
        """Do what the page asked for since the last time, and renew what it shows."""
        while not self._wishes.empty():
            self._wishes.get()(session)
        session.wish = Wish(self._speed.value, self._turn.value)
        if session.friction != self._friction.value:
            session.friction = self._friction.value
        pace.slow = SLOWER[self._slower.value]
        with self.server.atomic():
            self._scene.show(session, ghost=self._ghost.value, forces=self._forces.value)
            if pace.elapsed >= self._next_readings:
                self._next_readings = pace.elapsed + 1.0 / READINGS
                self._readings.content = _readings(session, pace)
                self._chart_place.content = self._drawn(session)
        return True

    def _panel(self, session: Session) -> None:
        gui, limits = self.server.gui, session.config.commands
        gui.configure_theme(
            control_layout="collapsible", control_width="medium", show_logo=False, show_share_button=False
        )
        self._readings = gui.add_html(_readings(session, None))
        self._speed = gui.add_slider(
            "Speed, m/s", min=0.0 - limits.max_backward, max=limits.max_forward, step=0.1,
            initial_value=session.wish.speed,
        )  # fmt: skip
        self._turn = gui.add_slider(
            "Turn, rad/s", min=-limits.max_yaw_rate, max=limits.max_yaw_rate, step=0.05, initial_value=0.0,
            hint="To the left. The faster the robot, the less of it is commanded: what friction holds",
        )  # fmt: skip
        stand, reset = gui.add_button("Stand"), gui.add_button("Reset", color="gray")
        stand.on_click(lambda _: self._stand())
        reset.on_click(lambda _: self._wishes.put(Session.reset))
        strength = gui.add_slider("Push, m/s", min=0.1, max=3.0, step=0.1, initial_value=0.8)
        push = gui.add_button_group("Push it", tuple(PUSHES))

        @push.on_click
        def _(event: Any) -> None:
            forward, left = (strength.value * part for part in PUSHES[event.target.value])
            self._wishes.put(lambda session: session.push(forward, left))

        self._friction = gui.add_slider("Friction", min=0.1, max=1.5, step=0.05, initial_value=session.friction)
        self._slower = gui.add_dropdown("Time", tuple(SLOWER), initial_value="real time")
        self._ghost = gui.add_checkbox("Reference motion", initial_value=True)
        self._forces = gui.add_checkbox("Foot forces", initial_value=True)
        self._chart = TorqueSpeed(motors_of(session.config))
        self._chart_place = gui.add_html(self._drawn(session))

    def _drawn(self, session: Session) -> str:
        return f'<div style="padding:.4em .9em">{self._chart.svg(session.worked)}</div>'

    def _stand(self) -> None:
        self._speed.value = self._turn.value = 0.0

    def _keys(self, session: Session) -> None:
        """Keys do the same; arrow keys move the slider that was touched last."""
        limits = session.config.commands

        def add(slider: Any, much: float, least: float, most: float) -> Callable[[Any], None]:
            def change(_: Any) -> None:
                slider.value = float(np.clip(round(slider.value + much, 6), least, most))

            return change

        speeds = -limits.max_backward, limits.max_forward
        turns = -limits.max_yaw_rate, limits.max_yaw_rate
        commands: tuple[tuple[str, Any, Callable[[Any], None]], ...] = (
            ("Faster", "W", add(self._speed, FASTER, *speeds)),
            ("Slower", "S", add(self._speed, -FASTER, *speeds)),
            ("Turn left", "A", add(self._turn, TIGHTER, *turns)),
            ("Turn right", "D", add(self._turn, -TIGHTER, *turns)),
            ("Stand", "X", lambda _: self._stand()),
            ("Reset", "R", lambda _: self._wishes.put(Session.reset)),
        )
        for label, key, change in commands:
            self.server.gui.add_command(label, hotkey=key).on_trigger(change)


class _Scene:
    """Robot, ghost, arrows and ground."""

    def __init__(self, server: Any, session: Session):
        scene, self._looks = server.scene, Looks(session.hardware)
        server.initial_camera.position, server.initial_camera.look_at = (0.9, -2.4, 0.9), (0.0, 0.0, 0.4)
        server.initial_camera.fov = np.deg2rad(45.0)
        scene.configure_environment_map("park", environment_intensity=0.6)
        self._ground = scene.add_grid(
            "/ground", infinite_grid=True, cell_size=CELL, section_size=SECTION, cell_color=(225, 205, 198),
            section_color=(255, 255, 255), section_thickness=3.0, plane_color=(150, 72, 56), plane_opacity=1.0,
            fade_distance=60.0, shadow_opacity=0.4,
        )  # fmt: skip
        self._robot, self._ghost = _Figure(scene, "/robot", self._looks), _Figure(scene, "/ghost", self._looks)
        for i, part in enumerate(self._looks.parts()):
            name, shape = self._looks.bodies[part.body - 1], (part.vertices, part.faces)
            scene.add_mesh_simple(f"/robot/{name}/{i}", *shape, color=part.color, side="double")
            scene.add_mesh_simple(
                f"/ghost/{name}/{i}", *shape, color=GHOST_COLOR, opacity=GHOST_OPACITY, cast_shadow=False
            )
        self._toes = [self._looks.model.body(f"{leg}_toe").id for leg in LEGS]
        self._sole = self._looks.model.site(SOLE_SITES[0]).pos.copy()
        # On the toes, so that they stay on the feet whatever a browser draws first.
        self._arrows = [
            scene.add_arrows(
                f"/robot/{self._looks.bodies[toe - 1]}/force", np.zeros((1, 2, 3)), tuple(color),
                shaft_radius=0.012, head_radius=0.03, head_length=0.06, visible=False,
            )
            for toe, color in zip(self._toes, LEG_COLORS, strict=True)
        ]  # fmt: skip

    def show(self, session: Session, *, ghost: bool, forces: bool) -> None:
        """Everything as it is now."""
        qpos = session.qpos
        self._ground.position = (-(qpos[0] % SECTION), -(qpos[1] % SECTION), 0.0)
        self._robot.place(*self._looks.place(qpos))
        self._show_forces(session.foot_forces() if forces else np.zeros((4, 3)))
        self._ghost.root.visible = ghost
        if ghost:
            self._ghost.place(*self._looks.place(session.reference()))

    def _show_forces(self, forces: Float[np.ndarray, "4 3"]) -> None:
        """Arrows from the soles; to be called with the robot in its place."""
        turns = self._looks.data.xmat[self._toes].reshape(-1, 3, 3)
        for arrow, turn, force in zip(self._arrows, turns, forces, strict=True):
            arrow.visible = bool(np.linalg.norm(force) > LEAST_FORCE)
            if arrow.visible:
                arrow.points = np.array([[self._sole, self._sole + turn.T @ force / NEWTONS_A_METRE]])


class _Figure:
    """A robot on the page: frames that hang on each other as its bodies do."""

    def __init__(self, scene: Any, root: str, looks: Looks):
        self.root = scene.add_frame(root, show_axes=False)
        self._frames = [scene.add_frame(f"{root}/{name}", show_axes=False) for name in looks.bodies]
        self._at = [np.full((len(looks.bodies), size), np.inf) for size in (3, 4)]

    def place(self, position: Float[np.ndarray, "B 3"], quaternion: Float[np.ndarray, "B 4"]) -> None:
        """Move what has moved: a frame that is told where it is costs more than all of a body's kinematics."""
        for attribute, now, last in zip(("position", "wxyz"), (position, quaternion), self._at, strict=True):
            for i in np.flatnonzero(np.any(np.abs(now - last) > SEEN, axis=1)):
                setattr(self._frames[i], attribute, now[i])
                last[i] = now[i]


def _readings(session: Session, pace: Pace | None) -> str:
    """What the robot does and is told, as HTML."""
    x, y, _ = session.qpos[:3]
    told, state = session.command, "" if session.down_since is None else '<b style="color:#D55E00">fell</b>, '
    lines = (
        f'<b style="font-size:1.6em" data-reading="speed">{session.speed:.2f}</b> m/s, told {told[0]:.2f}',
        f"turns {session.turn:.2f} rad/s, told {told[2]:.2f}",
        f"{state}{session.time:.1f} s, {session.distance:.0f} m run; at {x:.1f}, {y:.1f} m; {session.falls} falls",
        f"{pace or '&nbsp;'}",
    )
    return f'<div style="padding:.2em .8em;font-size:.85em;line-height:1.5">{"<br>".join(lines)}</div>'
