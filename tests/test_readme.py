"""README's table of results says what the cards say, cell by cell, as the table rounds; README's Python runs."""

import json
import re
import statistics
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROWS = {
    "top speed": lambda results: f"{results['topspeed']['best_speed']:.2f} m/s",
    "100 m": lambda results: f"{results['sprint']['time_100m']:.2f} s",
    "200 randomised robots": lambda results: "{upright} upright, legs touch in {legs_touch}".format(
        **results["robustness"]
    ),
    "manoeuvres passed, of 95": lambda results: f"{results['manoeuvres']['passed']}",
    "[disturbances]": lambda results: f"{results['disturbances']['passed']}",
}


def table() -> dict[str, list[str]]:
    """Return the cells of README's table of results by the names of its rows."""
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("| ")]
    return {row[0]: row[1:] for row in rows if len(row) == 5}


@pytest.mark.parametrize(("column", "policy"), [(1, "built"), (2, "fastest")])
@pytest.mark.parametrize("start", ROWS)
def test_a_cell_is_what_the_card_says(start, column, policy):
    (cells,) = (cells for name, cells in table().items() if name.startswith(start))
    results = json.loads((ROOT / f"assets/policies/{policy}/card.json").read_text(encoding="utf-8"))["results"]
    assert cells[column] == ROWS[start](results)


def test_the_columns_are_those_policies():
    (head,) = (cells for name, cells in table().items() if name.startswith("from a stand"))
    assert head[0] == "BP2 (paper)"
    assert [found[1] for cell in head[1:3] if (found := re.search(r"`(\w+)`", cell))] == ["built", "fastest"]


def test_the_ranges_are_those_of_the_five_trainings():
    text = (ROOT / "docs/notes/training.md").read_text(encoding="utf-8")
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if re.match(r"\| \d \| 1", line)]
    assert [row[0] for row in rows] == list("01234")

    for row in rows:
        row.append(f"{int(row[8]) + int(row[9])}")  # pushes and rough grounds

    def span(column):
        return sorted((row[column].split()[0] for row in rows), key=float)[:: len(rows) - 1]

    def mean_and_span(column, digits, unit):
        mean = statistics.mean(float(row[column].split()[0]) for row in rows)
        return "{:.{}f}{} ({} to {})".format(mean, digits, unit, *span(column))

    cells = [table()[name][3] for name in table() if not name.startswith(("from", "---"))]
    assert cells[0] == mean_and_span(1, 2, " m/s")
    assert cells[1] == mean_and_span(2, 2, " s")
    assert {f"each {row[7]} upright" for row in rows} == {cells[2]}
    assert cells[3] == mean_and_span(5, 0, "")
    assert cells[4] == mean_and_span(10, 0, "")
    prose = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "100 m in {} to {} s".format(*span(3)) in prose.replace("\n", " ")
    assert "in {} to {} s. `built` is".format(*span(4)) in prose.replace("\n", " ")


def test_the_lines_of_python_run(tmp_path):
    """Each block as a script of its own, but for the preset: `smoke` takes a minute less."""
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    assert ['"cpu"' in block for block in blocks] == [False, True]
    said = []
    for block in blocks:
        (tmp_path / "script.py").write_text(block.replace('"cpu"', '"smoke"'), encoding="utf-8")
        done = subprocess.run([sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        said += done.stdout.split()
    assert 9.5 < float(said[0]) < 11.0
    card = json.loads((tmp_path / "runs/first/policy/card.json").read_text(encoding="utf-8"))
    assert card["env"]["hardware"]["body"]["name"] == "Unitree Go1"  # the robot of the second block
