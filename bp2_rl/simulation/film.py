"""Render a film of a run and its poster image, on machines with a GL library.

MuJoCo binds its GL library when it is first imported and a wrong choice can end the
process, so the film is made by a process of its own: `make_video` starts it once for
each library, this module run as a script is that process.
"""

import contextlib
import dataclasses
import importlib.util
import io
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from bp2_rl.base.errors import one_line
from bp2_rl.base.files import write_bytes
from bp2_rl.robot.camera import Camera
from bp2_rl.robot.model import ground_geoms, load_model
from bp2_rl.simulation.metrics import RIPPLE
from bp2_rl.simulation.trajectory import Trajectory, best_window
from bp2_rl.simulation.world import World

GL_LIBRARIES = ("egl", "osmesa")
POSTER = ".jpg"  # beside the film, under its name
# s: if a frame takes longer, the CPU draws it, and the film is simplified
SLOW_FRAME = 0.1
TIME_LIMIT = 300.0  # s, for one library
# m: where the film is made, in the midst of the scene's lane lines and metre marks
SCENE = 90.0


@dataclasses.dataclass(frozen=True)
class Shot:
    """The part of a run that is filmed, and the size of the film."""

    length: float = 4.0  # s
    frame_rate: int = 30  # frames/s
    width: int = 960  # pixels; both multiples of 16, as the codec wants
    height: int = 544


class NoVideo(Exception):
    """Raised if no film can be made on this machine; the message gives the reason and a
    remedy, in one line."""


def make_video(
    trajectory: Path, output: Path, gl_library: str | None = None, shot: Shot = Shot()
) -> None:
    """Film the trajectory saved at `trajectory` with the given GL library, or the first
    that works.

    Beside the film, under its name, lies its poster, a JPEG.

    Raises:
        NoVideo: no GL library works here.
    """
    if importlib.util.find_spec("imageio_ffmpeg") is None:
        raise NoVideo(
            "no video: the package imageio-ffmpeg is missing; pip install imageio-ffmpeg"
        )
    reasons = []
    for library in (gl_library,) if gl_library else GL_LIBRARIES:
        error = _film_with(library, trajectory, output, shot)
        if error is None:
            return
        reasons.append(f"{library}: {error}")
    remedy = (
        "unset MUJOCO_GL"
        if gl_library
        else "apt-get install libegl1 libgl1-mesa-dri libosmesa6 (Debian, Ubuntu)"
    )
    raise NoVideo(
        f"no video: no GL library works here ({'; '.join(reasons)}); {remedy}"
    )


def _film_with(library: str, trajectory: Path, output: Path, shot: Shot) -> str | None:
    """Film in a process with one GL library; return None on success, else the last line
    of its error."""
    environment = os.environ | {
        "MUJOCO_GL": library,
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
    }
    if library == "egl":
        environment.setdefault("PYOPENGL_PLATFORM", "egl")
    command = [sys.executable, "-m", __name__, str(trajectory), str(output)]
    command.append(json.dumps(dataclasses.asdict(shot)))
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=TIME_LIMIT
        )
    except subprocess.TimeoutExpired:
        return f"not done after {TIME_LIMIT:.0f} s"
    if done.returncode == 0:
        return None
    lines = done.stderr.strip().splitlines() or [f"ended with status {done.returncode}"]
    return lines[-1].strip()


def film(run: Trajectory, output: Path, shot: Shot = Shot()) -> None:
    """Render some seconds of a run from the tracking camera, in real time, and a
    poster.

    A flat scene repeats itself every metre, so the robot is moved by whole metres
    towards the scene's middle.
    """
    model = load_model(run.hardware, scene=World(run.terrain).lay)
    if uneven := ground_geoms(model):  # which would half cover the lanes' lines
        model.geom_matid[uneven] = model.mat("metres").id
        model.mat_rgba[model.mat("line").id, 3] = 0.0
    if _seconds_a_frame(model, run, shot) > SLOW_FRAME:
        model.vis.quality.offsamples = 0
        model.vis.quality.shadowsize = 1024
        model.mat_reflectance[:] = 0.0
    with tempfile.TemporaryDirectory(prefix="bp2-film-") as folder:
        temporary = Path(folder) / output.name
        poster = _draw(run, model, temporary, shot)
        write_bytes(output, temporary.read_bytes())
    write_bytes(output.with_suffix(POSTER), poster)


def _draw(run: Trajectory, model: mujoco.MjModel, output: Path, shot: Shot) -> bytes:
    """Render the frames into a film at `output`; return the middle frame as a JPEG."""
    import imageio_ffmpeg  # an evaluation goes without a film where it is missing

    samples = frame_samples(run, shot)
    poster = io.BytesIO()
    forward = run.ground_velocity[:, 0]
    ripple = round(RIPPLE / run.dt)
    # The index in front lets a browser begin before it has the whole file.
    writer = imageio_ffmpeg.write_frames(
        str(output),
        (shot.width, shot.height),
        fps=shot.frame_rate,
        quality=7,
        output_params=["-movflags", "+faststart"],
    )
    writer.send(None)
    try:
        with contextlib.closing(Camera(model, shot.height, shot.width)) as camera:
            # the endless floor is laid out around the camera's last place
            camera.picture(_moved_to_middle(run, samples[0]))
            for i, k in enumerate(samples):
                recent = forward[max(0, k - ripple) : k + 1]
                text = f"{np.mean(recent):.1f} m/s    {run.time[k]:.2f} s"
                picture = camera.picture(_moved_to_middle(run, k))
                image = _captioned(picture, text)
                writer.send(image.tobytes())
                if i == len(samples) // 2:
                    image.save(poster, "JPEG", quality=80)
    finally:
        writer.close()
    return poster.getvalue()


def _moved_to_middle(run: Trajectory, sample: int) -> np.ndarray:
    """Return the robot's positions, on a flat floor moved by whole metres to the midst of
    the scene."""
    moved = run.qpos[sample].copy()
    if not run.terrain.size:
        moved[0] += SCENE - np.floor(moved[0])
    return moved


def _seconds_a_frame(model: mujoco.MjModel, run: Trajectory, shot: Shot) -> float:
    with contextlib.closing(Camera(model, shot.height, shot.width)) as camera:
        camera.picture(run.qpos[0])  # the first one sets up the scene
        start = time.perf_counter()
        camera.picture(run.qpos[0])
        return time.perf_counter() - start


def frame_samples(run: Trajectory, shot: Shot = Shot()) -> np.ndarray:
    """Return the samples to show as frames: the shot's part of the run, or all of a
    shorter run."""
    end = len(run) * run.dt
    best = best_window(run, 1.0)
    middle = 0.0 if best is None else best.start + 0.5
    start = min(max(middle - shot.length / 2, 0.0), max(end - shot.length, 0.0))
    times = np.arange(start, min(start + shot.length, end), 1.0 / shot.frame_rate)
    return np.minimum(np.round(times / run.dt).astype(int), len(run) - 1)


def _captioned(frame: np.ndarray, text: str) -> Image.Image:
    image = Image.fromarray(frame)
    size = max(image.height / 22.0, 12.0)
    ImageDraw.Draw(image).text(
        (1.2 * size, image.height - 2.0 * size),
        text,
        font=ImageFont.load_default(size),
        fill="white",
        stroke_width=round(size / 12),
        stroke_fill="#1F2328",
    )
    return image


def _main() -> int:
    trajectory, output = map(Path, sys.argv[1:3])
    shot = Shot(**json.loads(sys.argv[3]))
    try:
        film(Trajectory.load(trajectory), output, shot)
    except Exception as error:
        # What a missing or broken GL library raises depends on the library: the parent
        # only wants to read why.
        print(one_line(f"{type(error).__name__}: {error}"), file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(_main())
