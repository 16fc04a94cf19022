"""The page of `bp2 play` in a browser: the robot in 3D, sliders and buttons. Needs the package viser.

The robot stays where it is on the page and the ground moves under it, so that no camera
need follow it and a hand may turn it about freely. Pages only say what they want: the
robot is touched between two control steps, in `show`.
"""

import html
import logging
import queue
import re
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import viser
from jaxtyping import Float
from matplotlib.colors import to_rgb
from viser._messages import HotkeyKey, RunJavascriptMessage

from bp2_rl.base.errors import UserError
from bp2_rl.base.plotting import LEG_COLORS
from bp2_rl.evaluation.races import TRACK
from bp2_rl.play.gate import OWN_NAMES, guarding
from bp2_rl.play.looks import Looks
from bp2_rl.play.pace import Pace
from bp2_rl.play.session import Session, Wish, readings, wish_limits
from bp2_rl.robot.model import SOLE_SITES, foot_geom_ids

SECTION = 10.0  # m, between the broad lines on the ground
# N/m, of an arrow; N, below which there is none: BP2's
NEWTONS_A_METRE = 1500.0
LEAST_FORCE = 20.0
# m: where the camera is, and what it looks at
WIDE_VIEW = (0.9, -2.4, 0.9), (0.0, 0.0, 0.4)
# on a telephone, whose lower half the panel takes
TALL_VIEW = (1.3, -4.0, 1.2), (0.0, 0.0, -0.4)
GROUND = (150, 72, 56)
LEVELLING = 0.1  # share by which each picture's height nears that of the ground
LINES = {"start": 0.0, "finish": TRACK}  # m
READINGS = 5.0  # a second: how often numbers are renewed
SLOWER = {"real time": 1.0, "1/2": 2.0, "1/5": 5.0, "1/10": 10.0}
PUSHES = {
    "forward": (1.0, 0.0),
    "back": (-1.0, 0.0),
    "left": (0.0, 1.0),
    "right": (0.0, -1.0),
}
KEYS: dict[HotkeyKey, tuple[str, Callable[[Session], None]]] = {
    "W": ("Faster", lambda session: session.step(speed=1)),
    "S": ("Slower", lambda session: session.step(speed=-1)),
    "A": ("Turn left", lambda session: session.step(turn=1)),
    "D": ("Turn right", lambda session: session.step(turn=-1)),
    "Q": ("Sideways to the left", lambda session: session.step(left=1)),
    "E": ("Sideways to the right", lambda session: session.step(left=-1)),
    "F": ("Full speed", lambda session: session.lean("speed", 1.0)),
    "X": ("Stand", Session.stand),
    "R": ("Reset", Session.reset),
}
SLIDERS = {
    "speed": ("Speed, m/s", None),
    "left": ("Sideways, m/s", "To the left"),
    "turn": (
        "Turn, rad/s",
        "To the left. At high speed the command is limited to the turn that friction allows",
    ),
}
STICK = re.compile("(speed|left|turn) (-?[0-9]{1,3})")  # per cent of the limit
POLLING = 0.2  # s, for which `Page.watched` waits for a browser


class Page:
    """The web page of a session and its server.

    A page for this machine alone answers only to this machine's own names, so that no
    other site's page can steer it. What a browser sends but for moves of the page's
    widgets, keys, a gamepad and its own camera is passed over.

    Args:
        session: to be shown.
        host: the address to listen at.
        port: the port to listen at; the next free one if another program uses it.

    Raises:
        UserError: there is no such place to listen at.
    """

    def __init__(self, session: Session, *, host: str, port: int):
        # Browsers open connections ahead that they then never use: not worth a
        # traceback.
        logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
        self._widgets: dict[str, viser.GuiInputHandle[Any]] = {}  # by viser's name
        try:
            family, *_, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[
                0
            ]
            # at no such address viser waits for ever
            socket.create_server(address[:2], family=family).close()
            with guarding(self._widgets, self._hear, own_names=host in OWN_NAMES):
                self.server = viser.ViserServer(
                    host=host,
                    port=port,
                    label=session.hardware.anatomy.name,
                    verbose=False,
                )
        except (OSError, RuntimeError, OverflowError) as error:
            raise UserError(
                f"cannot listen at {host}:{port}: {error}; choose another --host or --port"
            ) from error
        self.url = f"http://{'localhost' if host in ('127.0.0.1', '0.0.0.0') else host}:{self.server.get_port()}"
        self._session = session
        self._wanted: queue.SimpleQueue[Callable[[Session], None]] = queue.SimpleQueue()
        """Actions on the session that the page asked for, run before the next
        picture."""
        self._next_readings = 0.0
        self._scene = _Scene(self.server, session)
        self._panel()
        for key, (label, action) in KEYS.items():
            command = self.server.gui.add_command(label, hotkey=key)
            command.on_trigger(lambda _, action=action: self._wanted.put(action))
        script = RunJavascriptMessage((Path(__file__).parent / "pad.js").read_text())
        # viser has no public way to run one
        vars(self.server.gui)["_websock_interface"].queue_message(script)
        self.server.on_client_connect(_step_back)

    def close(self) -> None:
        """Stop the server."""
        self.server.stop()

    def watched(self) -> bool:
        """Return whether a browser shows the page; if none does, wait `POLLING` seconds
        first."""
        is_watched = bool(self.server.get_clients())
        if not is_watched:
            time.sleep(POLLING)
        return is_watched

    def show(self, pace: Pace) -> None:
        """Apply the page's requests to the session, and update the page."""
        session = self._session
        # not what comes meanwhile, or a flood would never let the robot run
        for _ in range(self._wanted.qsize()):
            self._wanted.get()(session)
        self._synchronise_wish()
        session.friction = self._friction.value
        pace.slow = SLOWER[self._slower.value]
        with self.server.atomic():
            self._scene.show(
                session, ghost=self._ghost.value, forces=self._forces.value
            )
            if pace.elapsed >= self._next_readings:
                self._next_readings = pace.elapsed + 1.0 / READINGS
                self._readings.content = _table(readings(session, pace))

    def _hear(self, message: bytes | str) -> None:
        """Take what `pad.js` says: a key, or a part of the wish with its share."""
        if message in KEYS:
            self._wanted.put(KEYS[message][1])
        elif isinstance(message, str) and (lean := STICK.fullmatch(message)):
            part, percent = lean.groups()
            self._wanted.put(lambda session: session.lean(part, int(percent) / 100))

    def _synchronise_wish(self) -> None:
        """Set the wish from the sliders or, if the wish changed otherwise, the sliders
        from the wish."""
        session = self._session
        if session.wish != self._wish:
            for name, slider in self._sliders.items():
                slider.value = getattr(session.wish, name)
        else:
            session.wish = Wish(
                **{name: slider.value for name, slider in self._sliders.items()}
            )
        self._wish = session.wish

    def _panel(self) -> None:
        gui = self.server.gui
        session = self._session
        gui.configure_theme(
            control_width="medium", show_logo=False, show_share_button=False
        )
        gui.main_panel.dock_right()
        self._readings = gui.add_html("")
        least, most = wish_limits(session.config.commands)
        self._sliders = {}
        self._wish = session.wish
        for name, (label, hint) in SLIDERS.items():
            low, high = getattr(least, name), getattr(most, name)
            if low < high:
                self._sliders[name] = gui.add_slider(
                    label,
                    min=low,
                    max=high,
                    step=0.05,
                    initial_value=getattr(session.wish, name),
                    hint=hint,
                )
        gui.add_button_group("Robot", ("stand", "reset")).on_click(
            lambda event: self._wanted.put(getattr(Session, event.target.value))
        )
        strength = gui.add_slider(
            "Push, m/s", min=0.1, max=3.0, step=0.1, initial_value=0.8
        )

        @gui.add_button_group("Push it", tuple(PUSHES)).on_click
        def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            forward, left = (
                strength.value * part for part in PUSHES[event.target.value]
            )
            self._wanted.put(lambda session: session.push(forward, left))

        friction = round(session.friction, 2)
        self._friction = gui.add_slider(
            "Friction",
            min=min(0.1, friction),
            max=max(1.5, friction),
            step=0.05,
            initial_value=friction,
        )
        self._slower = gui.add_dropdown(
            "Time", tuple(SLOWER), initial_value="real time"
        )
        self._ghost = gui.add_checkbox("Reference motion", initial_value=True)
        self._forces = gui.add_checkbox("Foot forces", initial_value=True)
        self._widgets |= vars(gui)["_gui_input_handle_from_uuid"]


class _Scene:
    """The 3D scene of the page: robot, ghost of the reference motion, force arrows and
    ground."""

    def __init__(self, server: viser.ViserServer, session: Session):
        scene = server.scene
        self._looks = Looks(session.hardware, session.world)
        server.initial_camera.position, server.initial_camera.look_at = WIDE_VIEW
        server.initial_camera.fov = np.deg2rad(45.0)
        scene.configure_environment_map("park", environment_intensity=0.6)
        self._ground = scene.add_grid(
            "/ground",
            visible=self._looks.has_floor,
            infinite_grid=True,
            cell_size=1.0,
            section_size=SECTION,
            cell_color=(225, 205, 198),
            section_color=(255, 255, 255),
            section_thickness=3.0,
            plane_color=GROUND,
            plane_opacity=1.0,
            fade_distance=60.0,
            shadow_opacity=0.4,
        )
        self._track = scene.add_frame("/track", show_axes=False)
        for i, mesh in enumerate(self._looks.ground()):
            scene.add_mesh_simple(
                f"/track/ground/{i}",
                mesh.vertices,
                mesh.faces,
                color=GROUND,
                flat_shading=True,
            )
        for name, x in LINES.items():
            scene.add_box(
                f"/track/{name}",
                (255, 200, 40),
                (0.25, 12.0, 0.04),
                position=(x, 0.0, 0.02),
                cast_shadow=False,
            )
            scene.add_label(f"/track/{name}/label", name, position=(0.0, 2.0, 0.6))
        self._robot = _Figure(scene, "/robot", self._looks)
        self._ghost = _Figure(scene, "/ghost", self._looks)
        for i, ((body, color), mesh) in enumerate(self._looks.parts().items()):
            name = self._looks.bodies[body - 1]
            shape = (mesh.vertices, mesh.faces)
            scene.add_mesh_simple(
                f"/robot/{name}/{i}", *shape, color=color, side="double"
            )
            scene.add_mesh_simple(
                f"/ghost/{name}/{i}",
                *shape,
                color=(80, 150, 255),
                opacity=0.3,
                cast_shadow=False,
            )
        self._level = 0.0  # m, of the ground below the trunk, without its steps
        size = session.hardware.size
        self._least_force = size.mass * LEAST_FORCE
        self._stiffness = size.mass / size.length * NEWTONS_A_METRE
        self._toes = self._looks.model.geom_bodyid[foot_geom_ids(self._looks.model)]
        self._sole = self._looks.model.site(SOLE_SITES[0]).pos.copy()
        # On the toes, so that they stay on the feet whatever a browser draws first.
        self._arrows = [
            scene.add_arrows(
                f"/robot/{self._looks.bodies[toe - 1]}/force",
                np.zeros((1, 2, 3)),
                to_rgb(color),
                shaft_radius=0.012,
                head_radius=0.03,
                head_length=0.06,
                visible=False,
            )
            for toe, color in zip(self._toes.tolist(), LEG_COLORS.values(), strict=True)
        ]

    def show(self, session: Session, *, ghost: bool, forces: bool) -> None:
        """Update the scene to the session's current state."""
        qpos = session.qpos
        self._level += LEVELLING * (session.ground - self._level)
        self._ground.position = (*(-(qpos[:2] % SECTION)), -self._level)
        self._track.position = (-qpos[0], -qpos[1], -self._level)
        self._robot.place(*self._looks.place(qpos, self._level))
        self._show_forces(session.foot_forces() if forces else np.zeros((4, 3)))
        self._ghost.root.visible = ghost
        if ghost:
            self._ghost.place(*self._looks.place(session.reference(), self._level))

    def _show_forces(self, forces: Float[np.ndarray, "4 3"]) -> None:
        """Draw the foot forces as arrows from the soles, for the robot's current
        pose."""
        turns = self._looks.data.xmat[self._toes].reshape(-1, 3, 3)
        for arrow, turn, force in zip(self._arrows, turns, forces, strict=True):
            arrow.visible = bool(np.linalg.norm(force) > self._least_force)
            if arrow.visible:
                arrow.points = np.array(
                    [[self._sole, self._sole + turn.T @ force / self._stiffness]],
                    np.float32,
                )


class _Figure:
    """A robot in the 3D scene, with one frame for each body."""

    def __init__(self, scene: viser.SceneApi, root: str, looks: Looks):
        self.root = scene.add_frame(root, show_axes=False)
        self._frames = [
            scene.add_frame(f"{root}/{name}", show_axes=False) for name in looks.bodies
        ]

    def place(
        self, position: Float[np.ndarray, "B 3"], quaternion: Float[np.ndarray, "B 4"]
    ) -> None:
        """Set the poses of the bodies; viser sends those that changed."""
        for frame, at, turn in zip(self._frames, position, quaternion, strict=True):
            frame.position, frame.wxyz = at, turn


async def _step_back(client: viser.ClientHandle) -> None:
    """Let the whole robot be seen on a browser that is higher than wide."""
    if client.camera.image_width < client.camera.image_height:
        client.camera.position, client.camera.look_at = TALL_VIEW


def _table(texts: dict[str, str]) -> str:
    """Return readings as HTML."""
    rows = (
        f'<tr><td style="padding-right:.8em;opacity:.6">{html.escape(name)}</td>'
        f'<td data-reading="{html.escape(name)}">{html.escape(value)}</td></tr>'
        for name, value in texts.items()
    )
    return f'<table style="margin:.2em .8em;font-size:.85em;line-height:1.4">{"".join(rows)}</table>'
