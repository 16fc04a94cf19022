"""The data of the player in a report's page: the robot's links, looks and motion.

The motion is given in joint coordinates, from which the page finds the links' poses as
`mj_kinematics` does: with 20 numbers an instant it takes a fifth of what the poses
would.
"""

import base64
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

from bp2_rl.base.plotting import LEG_COLORS, moving_mean
from bp2_rl.robot.conventions import CONTROL_STEP, LEGS
from bp2_rl.robot.ground import over_ground
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.model import (
    SOLE_SITES,
    field_of,
    ground_geoms,
    load_model,
    mesh_of,
    visible_geoms,
)
from bp2_rl.simulation.metrics import RIPPLE
from bp2_rl.simulation.trajectory import Trajectory, best_window
from bp2_rl.simulation.world import World

SHOWN_TIME = 60.0  # s that are shown, around the best second: a page is to stay small
TRACK_COLOR = np.array((0.57, 0.25, 0.2))  # of 1: its colour
MARGIN = 5.0  # m, of ground that is shown around the run
INT16_MAX = 32767  # of a 16-bit number
SHAPES = {
    mujoco.mjtGeom.mjGEOM_SPHERE: "sphere",
    mujoco.mjtGeom.mjGEOM_CAPSULE: "capsule",
    mujoco.mjtGeom.mjGEOM_CYLINDER: "cylinder",
    mujoco.mjtGeom.mjGEOM_BOX: "box",
    mujoco.mjtGeom.mjGEOM_MESH: "mesh",
    mujoco.mjtGeom.mjGEOM_HFIELD: "field",
}


def describe_run(run: Trajectory) -> dict[str, Any]:
    """Return a run's robot and motion for the player, ready for JSON, one sample per
    control step."""
    best = best_window(run, 1.0)
    middle = best.start + 0.5 if best is not None else 0.0
    length = len(run) * run.dt
    if length > SHOWN_TIME:
        start = min(max(middle - SHOWN_TIME / 2, 0.0), length - SHOWN_TIME)
        run = run.between(start, start + SHOWN_TIME)
    step = max(1, round(CONTROL_STEP / run.dt))
    shown = slice(None, None, step)
    speed = moving_mean(run.ground_velocity[:, 0], round(RIPPLE / run.dt))
    turn = run.qpos[shown, 3:7]
    # q and -q are one turn, but not halfway between
    flips = np.cumsum(np.sum(turn[1:] * turn[:-1], axis=1) < 0.0)
    turn = turn * np.where(np.concatenate(([0], flips)) % 2, -1.0, 1.0)[:, None]
    level = run.qpos - over_ground(run.qpos, World(run.terrain).ground)
    return describe_robot(run.hardware, World(run.terrain), run.qpos[:, :2]) | {
        "motion": {
            "rate": 1.0 / (step * run.dt),
            "count": len(turn),
            "start": float(run.time[0]),
            "best": max(middle - float(run.time[0]), 0.0),
            "fell": run.fell_at,
        },
        "channels": {
            "place": _floats(run.qpos[shown, :3]),
            "level": _floats(moving_mean(level[:, 2:3], round(RIPPLE / run.dt))[shown]),
            "turn": _integers(turn),
            "joints": _integers(run.qpos[shown, 7:]),
            "force": _integers(
                moving_mean(run.foot_force, step)[shown].reshape(-1, 12)
            ),
            "speed": _floats(np.stack((speed, run.command[:, 0]), axis=-1)[shown]),
        },
    }


def describe_robot(
    hardware: HardwareSpec, world: World, path: Float[np.ndarray, "K 2"]
) -> dict[str, Any]:
    """Return a robot and uneven ground for the player; lengths in m.

    Parents come before their children; the ground's geoms have the link -1. Of a field
    of heights, only the part near the path is included.
    """
    model = load_model(hardware, scene=world.lay)
    links = []
    meshes = {}
    for body in range(1, model.nbody):
        joint = int(model.body_jntadr[body])
        links.append(
            {
                "name": model.body(body).name,
                "parent": int(model.body_parentid[body]) - 1,
                "position": _rounded(model.body_pos[body]),
                "quaternion": _rounded(model.body_quat[body]),
                "joint": "slide"
                if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
                else "hinge",
                "axis": _rounded(model.jnt_axis[joint]),
            }
        )
    geoms = []
    uneven = [(geom, TRACK_COLOR) for geom in ground_geoms(model)]
    for geom, color in (*visible_geoms(model), *uneven):
        mesh = int(model.geom_dataid[geom])
        shape = SHAPES[mujoco.mjtGeom(int(model.geom_type[geom]))]
        if shape == "mesh":
            meshes.setdefault(mesh, len(meshes))
        geoms.append(
            {
                "link": int(model.geom_bodyid[geom]) - 1,
                "shape": shape,
                "mesh": meshes.get(mesh, -1),
                "size": _rounded(model.geom_size[geom]),
                "position": _rounded(model.geom_pos[geom]),
                "quaternion": _rounded(model.geom_quat[geom]),
                "color": _rounded(color),
                "field": _field(path, model, geom) if shape == "field" else None,
            }
        )
    feet = [
        {
            "link": int(model.site(sole).bodyid[0]) - 1,
            "position": _rounded(model.site(sole).pos),
            "color": [int(LEG_COLORS[leg][i : i + 2], 16) / 255.0 for i in (1, 3, 5)],
        }
        for leg, sole in zip(LEGS, SOLE_SITES, strict=True)
    ]
    return {
        "links": links,
        "geoms": geoms,
        "meshes": [_mesh(model, mesh) for mesh in meshes],
        "feet": feet,
    }


def _field(
    path: Float[np.ndarray, "K 2"], model: mujoco.MjModel, geom: int
) -> dict[str, object]:
    """Return the points of the field of heights that are at most `MARGIN` from the
    path's ranges of x and y."""
    x, y, heights = field_of(model)
    path = (path - model.geom_pos[geom, :2]).T
    columns, rows = (
        np.abs(points - np.clip(points, np.min(at), np.max(at))) <= MARGIN
        for points, at in zip((x, y), path, strict=True)
    )
    near = _integers(heights[np.ix_(rows, columns)].reshape(-1, 1))
    return {"x": _rounded(x[columns]), "y": _rounded(y[rows]), "heights": near}


def _mesh(model: mujoco.MjModel, mesh: int) -> dict[str, object]:
    vertices, faces = mesh_of(model, mesh)
    return {
        "vertices": [_rounded(vertex) for vertex in vertices],
        "faces": faces.tolist(),
    }


def _rounded(values: np.ndarray) -> list[float]:
    return [round(float(value), 6) for value in values]


def _floats(values: Float[np.ndarray, "K n"]) -> dict[str, object]:
    return _channel(values.astype("<f4"), "f4", np.ones(1))


def _integers(values: Float[np.ndarray, "K n"]) -> dict[str, object]:
    """Encode each column as scaled 16-bit integers; values that are not finite become
    0."""
    values = np.nan_to_num(values, posinf=0.0, neginf=0.0)
    scale = np.maximum(np.max(np.abs(values), axis=0), 1e-6) / INT16_MAX
    return _channel(np.rint(values / scale).astype("<i2"), "i2", scale)


def _channel(values: np.ndarray, kind: str, scale: np.ndarray) -> dict[str, object]:
    data = base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()
    return {
        "type": kind,
        "width": values.shape[1],
        "scale": [float(s) for s in scale],
        "data": data,
    }
