"""The player as a part of a page: its elements, its content and its script, all inside."""

import functools
import json
from importlib import resources

from bp2_rl.evaluation.report.player.content import describe
from bp2_rl.simulation.trajectory import Trajectory

SCRIPTS = "linear.js", "shapes.js", "motion.js", "scene.js", "controls.js"


@functools.cache
def style() -> str:
    """The player's style sheet."""
    return _read("player.css")


def player(run: Trajectory) -> str:
    """The run in HTML with its own script, to stand in a page once."""
    content = json.dumps(describe(run), separators=(",", ":"), allow_nan=False).replace("</", "<\\/")
    script = "\n".join(map(_read, SCRIPTS))
    return (
        f'{_read("player.html")}<script type="application/json" id="run-content">{content}</script>'
        f'<script>"use strict";\n(() => {{\n{script}}})();</script>'
    )


def _read(name: str) -> str:
    return resources.files("bp2_rl.evaluation.report.player").joinpath(name).read_text(encoding="utf-8")
