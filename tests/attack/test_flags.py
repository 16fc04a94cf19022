"""Every flag of every command with impossible values: the command accepts the value, or
refuses with status 2 in one line or in tyro's words.

Nothing is computed: the work that a command would begin is cut off where it begins.
"""

import contextlib
import importlib
import math
import re
import time
from pathlib import Path

import pytest
from refusals import begin, is_told

pytestmark = pytest.mark.attack

LONGEST = 20.0  # s, for an answer
NUMBERS = ("nan", "inf", "-inf", "1e308", "-1e308", "9" * 400, "fast")
WORDS = ("x" * 5000, "[/foo]bar", "\udcff", "")
REFUSED = ("nan", "-inf", "1e308", "-1e308", "9" * 400, "fast")
"""Numbers that make no setting: whatever the flag, they are refused."""
ENDLESS = (
    "--env.control.torque-rate",
    "--env.reward.tracking-shape.width",
    "--ppo.entropy-decay",
    "--ppo.kl-decay",
    "hardware.braking-speed",
    "losses.bus-power-out",
    "losses.bus-power-in",
    "longest-period",
    "highest-step",
    "hardest-landing",
)
"""How flags end of what may be infinite: then there is no limit, no widening, no
decay."""


COMMANDS = {
    "train": ("bp2_rl.cli.train", ["--preset", "smoke"]),
    "eval": ("bp2_rl.cli.eval", []),
    "study": ("bp2_rl.cli.study", []),
    "bench": ("bp2_rl.cli.bench", ["--preset", "smoke"]),
    "export": ("bp2_rl.cli.export", []),
    "trajopt solve": ("bp2_rl.cli.trajopt", ["solve"]),  # `trajopt verify` has no flags
    **{
        f"trajectories {what}": ("bp2_rl.paper.cli.trajectories", [what])
        for what in (
            "limits",
            "schemes",
            "codesign",
            "objective",
            "figures",
        )
    },
    **{
        f"figures {figure}": ("bp2_rl.paper.cli.figures", [figure])
        for figure in (
            *("scaling", "race", "robot", "rewards"),
            *("exchange", "sections", "torque", "map", "trapping", "gaits"),
        )
    },
    "scaling": ("bp2_rl.paper.cli.scaling", []),
    "figures --all": ("bp2_rl.paper.cli.figures", ["--all"]),
    "trajopt library": ("bp2_rl.cli.trajopt", ["library", "build"]),
}
"""Module of each command, and the words that come before its flags."""


@pytest.fixture(autouse=True)
def nothing_is_computed(monkeypatch, tmp_path):
    for place in WORK:
        monkeypatch.setattr(place, begin)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")  # for tyro's help: a flag a line


WORK = (
    "bp2_rl.learning.run.start",
    "bp2_rl.learning.run.resume",
    "bp2_rl.learning.run.replay",
    "bp2_rl.evaluation.report.folder.open_folder",
    "bp2_rl.tools.study.running.run_study",
    "bp2_rl.tools.bench.run_bench",
    "bp2_rl.cli.trajopt.spinner",
    "bp2_rl.cli.trajopt.progress_bar",
    "bp2_rl.paper.trajectories.codesign.optimise_design",
    "bp2_rl.paper.trajectories.objective.compare_objectives",
    "bp2_rl.paper.trajectories.decomposition.decompose",
    "bp2_rl.paper.pendulum.exchange.study_exchange",
    "bp2_rl.paper.pendulum.sections.cut_sections",
    "bp2_rl.paper.pendulum.torque.compare_torques",
    "bp2_rl.paper.pendulum.reduction.map_reduction",
    "bp2_rl.paper.pendulum.trapping.find_trapping",
    "bp2_rl.paper.pendulum.gaits.gain_by_gait",
    "bp2_rl.paper.cli.figures.open_figure_folder",
    "bp2_rl.paper.figures.scaling.scaling_figure",
    "bp2_rl.paper.figures.race.race_figure",
    "bp2_rl.paper.figures.robot.measure_robot",
    "bp2_rl.paper.figures.rewards.rewards_figure",
    "bp2_rl.paper.cli.index._make",
)
"""Functions with which commands begin to work, after all flags were checked."""


def flags(text: str) -> dict[str, str]:
    """Return the flags in tyro's help of a command, each with its metavar."""
    found = {}
    for line in text.splitlines():
        if match := re.match(
            r"[│ ] (--[\w.-]+)(?:, --[\w.-]+)?(?: (.*?))?(?:  .*)?$", line
        ):
            found[match[1]] = (match[2] or "").replace("{None}|", "").rstrip(" │")
    return found


def attacks(metavar: str) -> tuple[str, ...]:
    return NUMBERS if re.search("FLOAT|INT|M/S|RAD|HZ|T0|[MSN]$", metavar) else WORDS


def fewer(flag: str, metavar: str, command: str) -> tuple[str, ...]:
    """Return the attacks on a flag whose kind was attacked before: those that its own
    bounds must stop."""
    if command != "train" and "hardware." in flag:  # the same settings, attacked there
        return ("nan",)
    if "INT" in metavar:
        return ("nan", "9" * 400)
    return tuple(
        value
        for value in attacks(metavar)
        if value in ("nan", "inf", "1e308", "-1e308", "[/foo]bar", "")
    )


def run(capsys, module: str, words: list[str]) -> tuple[int, str, float]:
    """Run a command; return exit status, standard error and duration, s."""
    began = time.monotonic()
    try:
        status = importlib.import_module(module).main(words)
    except SystemExit as end:
        status = int(end.code or 0)
    return status, capsys.readouterr().err, time.monotonic() - began


def shown(case: list[str]) -> str:
    return ascii(
        " ".join(
            word if len(word) < 40 else f"{word[:10]}...({len(word)})" for word in case
        )
    )


@pytest.mark.parametrize("command", COMMANDS)
def test_no_value_of_any_flag_ends_in_a_traceback(command, capsys):
    module, words = COMMANDS[command]
    with contextlib.suppress(SystemExit):
        importlib.import_module(module).main([*words, "--help-all"])
    known = flags(capsys.readouterr().out)
    assert known
    if command == "bench":  # has train's settings, which are attacked there
        known = {
            flag: takes
            for flag, takes in known.items()
            if not flag.startswith(("--env.", "--ppo."))
        }
    wrong = []
    kinds: set[str] = set()
    for flag, metavar in known.items():
        values = fewer(flag, metavar, command) if metavar in kinds else attacks(metavar)
        kinds.add(metavar)
        for value in values:
            before = set(Path.cwd().iterdir())
            case = [
                *words,
                flag,
                *[value] * max(1, len(metavar.split()) if "[" not in metavar else 1),
            ]
            status, error, seconds = run(capsys, module, case)
            accepted = "AcceptedError" in error or status == 0
            number = value in REFUSED and attacks(metavar) is NUMBERS
            mistakes = {
                f"{seconds:.0f} s": seconds > LONGEST,
                "accepted": accepted
                and number
                and not (flag.endswith(ENDLESS) and float(value) == math.inf),
                "leaves something behind": not accepted
                and set(Path.cwd().iterdir()) != before,
                f"status {status}, {error[:300]!a}": not accepted
                and (status != 2 or not is_told(error)),
            }
            wrong += [f"{shown(case)}: {what}" for what, so in mistakes.items() if so]
    assert not wrong, "\n".join(wrong)
