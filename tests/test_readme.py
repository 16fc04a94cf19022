"""README's table of results says what the cards say, cell by cell, as the table rounds.

README's commands and Python are run by `.ci/bare`, in README's own environment.
"""

import json
import math
import re
import statistics
from pathlib import Path

import pytest
from scipy import stats

from bp2_rl.robot import bp2

ROOT = Path(__file__).parents[1]
PAPER = ("13.2", "13.2", "10.74", "10.74", "12.2", "12.2", "", "", "", "")
POLICIES = ("built", "gentle", "fastest")


def interval(results, name):
    """Return the cell of a number on plausible robots: median and 90 % interval."""
    low, middle, high = results["posterior"][name]
    return f"{middle:.1f} ({low:.1f} to {high:.1f})"


ROWS = {
    "plausible, treadmill": lambda results: interval(results, "belt"),
    "plausible, outdoors": lambda results: interval(results, "road"),
    "plausible, 100 m": lambda results: interval(results, "time_100m"),
    "treadmill": lambda results: f"{results['losses']['without']['air']:.2f}",
    "outdoors": lambda results: f"{results['topspeed']['best_speed']:.2f}",
    "100 m": lambda results: f"{results['sprint']['time_100m']:.2f}",
    "randomised robots upright": lambda results: f"{results['robustness']['upright']}",
    "randomised robots whose legs touch": lambda results: (
        f"{results['robustness']['legs_touch']}"
    ),
    "manoeuvres passed, of 95": lambda results: f"{results['manoeuvres']['passed']}",
    "[disturbances]": lambda results: f"{results['disturbances']['passed']}",
}
IDEAL = {
    "treadmill": lambda results: f"{results['losses']['ideal']:.2f}",
    "outdoors": lambda results: f"no air: {ROWS['outdoors'](results)}",
    **dict.fromkeys(list(ROWS)[:3], lambda _: ""),
}
"""The ideal robot's own: it runs without air everywhere."""


def table() -> dict[str, list[str]]:
    """Return the cells of README's table of results by the names of its rows."""
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in lines
        if line.startswith("| ")
    ]
    return {row[0]: row[1:] for row in rows if len(row) == 5}


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("start", ROWS)
def test_a_cell_is_what_the_card_says(start, policy):
    (cells,) = (cells for name, cells in table().items() if name.startswith(start))
    results = json.loads(
        (ROOT / f"assets/policies/{policy}/card.json").read_text(encoding="utf-8")
    )["results"]
    row = (IDEAL if policy == "fastest" else {}).get(start, ROWS[start])
    assert cells[1 + POLICIES.index(policy)] == row(results)


def test_the_columns_are_those_policies_and_the_papers_robot():
    head, _, *rows = table().values()
    assert head[0] == "BP2 (paper)"
    assert [
        found[1] for cell in head[1:] if (found := re.search(r"`(\w+)`", cell))
    ] == list(POLICIES)
    assert tuple(cells[0] for cells in rows) == PAPER
    assert (bp2.TREADMILL_TOP_SPEED, bp2.OUTDOOR_TOP_SPEED) == (13.2, 10.74)


def test_the_prediction_intervals_are_those_of_all_trainings():
    """Student's interval for one more draw, by SciPy."""
    text = (ROOT / "docs/notes/training.md").read_text(encoding="utf-8")
    rows = [
        line.strip("|").split("|")
        for line in text.splitlines()
        if line.startswith("| seeds ")
    ]
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    for column, digits, words in (
        (1, 1, "between {} and {} m/s"),
        (2, 2, "100 m in {} to {} s"),
    ):
        values = [
            float(value)
            for row in rows
            for value in row[column].split(",")
            if value.strip()
        ]
        n, spread = len(values), statistics.stdev(values)
        low, high = stats.t(
            n - 1, statistics.mean(values), spread * math.sqrt(1.0 + 1.0 / n)
        ).interval(0.9)
        low, high = (f"{bound:.{digits}f}" for bound in (low, high))
        assert f"**{low} to {high}**" in text
        assert words.format(low, high) in readme
        assert str(n) in readme.split("prediction intervals of [")[1].split("](")[0]
