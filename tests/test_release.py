"""Version, licence and pinned requirements agree wherever a release states them."""

import re
import tomllib
from pathlib import Path

from packaging.requirements import Requirement

import bp2_rl

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def test_the_citation_is_of_this_version_and_licence():
    citation = (ROOT / "CITATION.cff").read_text()
    assert re.findall(r"^version: (.+)$", citation, re.M) == [bp2_rl.__version__]
    assert re.findall(r"^license: (.+)$", citation, re.M) == [PROJECT["license"]]
    holder = re.findall(
        r"^Copyright \(c\) \d+ (.+)$", (ROOT / "LICENSE").read_text(), re.M
    )
    assert re.findall(r"^authors:\n  - name: (.+)$", citation, re.M) == holder


def test_the_package_says_that_it_is_typed():
    assert (Path(bp2_rl.__file__).parent / "py.typed").is_file()
    assert "Typing :: Typed" in PROJECT["classifiers"]


def test_what_the_documentation_is_built_with_is_pinned():
    pinned = {
        line.split("==")[0]
        for line in (ROOT / "constraints.txt").read_text().splitlines()
        if "==" in line
    }
    extras = PROJECT["optional-dependencies"]
    assert {
        re.split(r"[>=<\[]", need)[0] for need in extras["docs"] + extras["release"]
    } <= pinned


def test_no_pin_holds_on_a_python_that_is_too_old():
    """There pip of Python 3.10 would tell of a conflict of packages, and of Python
    nothing."""
    pins = [
        Requirement(line)
        for line in (ROOT / "constraints.txt").read_text().splitlines()
        if "==" in line
    ]
    assert len(pins) > 50
    old = [
        pin.name
        for pin in pins
        if pin.marker is None or pin.marker.evaluate({"python_version": "3.10"})
    ]
    assert old == []
