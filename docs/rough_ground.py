"""Picture a policy on ground that is not flat: `python docs/rough_ground.py PICTURE.png
[POLICY KIND:SIZE M/S]`."""

import sys
import tempfile
from pathlib import Path

from PIL import Image

import bp2_rl as bp2
from bp2_rl.settings.terrain import Terrain
from bp2_rl.simulation.film import POSTER, Shot, make_video
from bp2_rl.simulation.world import World

COLORS = 256  # of the picture, so that it is small
SHOT = Shot(length=0.1, width=1088, height=496)
VIEW = 200, 60, 936, 460  # pixels of it: left, top, right, bottom


def picture(place: Path, policy: str, ground: str, speed: float) -> None:
    """Run the policy for three seconds at the speed, and picture its best second."""
    world = World(Terrain.of(ground))
    run = bp2.rollout(bp2.load_policy(policy), bp2.Ramp(speed, hold=3.0), world=world)
    with tempfile.TemporaryDirectory() as folder:
        trajectory, film = Path(folder) / "run.npz", Path(folder) / "run.mp4"
        run.save(trajectory)
        make_video(trajectory, film, shot=SHOT)
        with Image.open(film.with_suffix(POSTER)) as poster:
            few = poster.crop(VIEW).quantize(COLORS, kmeans=5, dither=Image.Dither.NONE)
            few.save(place, optimize=True)


if __name__ == "__main__":
    place, *chosen = sys.argv[1:]
    policy, ground, speed = chosen or ("rough", "rough:0.06:0.25", "6")
    picture(Path(place), policy, ground, float(speed))
