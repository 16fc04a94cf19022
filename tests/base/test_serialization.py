import contextlib
import dataclasses
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from damage import strange_json
from hypothesis import given
from hypothesis import strategies as st

from bp2_rl.base.errors import UserError
from bp2_rl.base.serialization import (
    ConfigError,
    claim_folder,
    config_hash,
    from_json,
    load_config,
    load_sealed,
    merge,
    save_config,
    save_sealed,
    to_json,
)
from bp2_rl.optimiser.problem import Problem
from bp2_rl.settings.env import EnvConfig, RewardConfig
from bp2_rl.settings.presets import preset
from bp2_rl.settings.training import TrainConfig


@dataclasses.dataclass(frozen=True)
class Inner:
    rate: float = 3e-4
    sizes: tuple[int, ...] = (512, 256)
    mode: Literal["adaptive", "fixed"] = "fixed"

    def __post_init__(self) -> None:
        if self.rate <= 0:
            raise ValueError("rate must be positive")


@dataclasses.dataclass(frozen=True)
class Outer:
    steps: int
    name: str = "run"
    fast: bool = False
    limit: float = math.inf
    inner: Inner = Inner()
    spare: Inner | None = None
    span: Annotated[tuple[float, float], "for the parser"] = (0.0, 1.0)
    number: Annotated[float, "for the parser"] | None = None
    folder: Path | None = None
    results: dict[str, Any] = dataclasses.field(default_factory=dict)
    layout: tuple[tuple[str, int], ...] = (("up", 3),)
    sizes: tuple[int, ...] | None = None


finite = st.floats(allow_nan=False)
inners = st.builds(
    Inner,
    rate=st.floats(min_value=1e-300, allow_nan=False),
    sizes=st.lists(st.integers()).map(tuple),
    mode=st.sampled_from(["adaptive", "fixed"]),
)
outers = st.builds(
    Outer,
    steps=st.integers(),
    name=st.text(),
    fast=st.booleans(),
    limit=finite,
    inner=inners,
    spare=st.none() | inners,
    span=st.tuples(finite, finite),
    number=st.none() | finite,
    folder=st.none() | st.just(Path("runs/a")),
    results=st.dictionaries(
        st.text(), st.integers() | st.text() | st.lists(st.booleans())
    ),
    layout=st.lists(st.tuples(st.text(), st.integers())).map(tuple),
    sizes=st.none() | st.lists(st.integers()).map(tuple),
)


@given(outers)
def test_a_config_survives_json(config: Outer):
    text = json.dumps(to_json(config), allow_nan=False)
    back = from_json(Outer, json.loads(text))
    assert back == config
    assert type(back.number) is type(config.number)


@pytest.mark.parametrize(
    "config",
    [EnvConfig(reward=RewardConfig(tracking=0.123)), Problem()],
    ids=["environment", "standard problem"],
)
def test_the_configs_of_the_program_survive_json(config: Any):
    text = json.dumps(to_json(config), allow_nan=False)
    assert from_json(type(config), json.loads(text)) == config


def test_nan_survives_as_a_string():
    data = to_json(Outer(steps=1, limit=math.nan))
    assert data["limit"] == "nan"
    assert math.isnan(from_json(Outer, data).limit)


def test_absent_keys_take_their_defaults():
    assert from_json(Outer, {"steps": 5}) == Outer(steps=5)


def test_an_integer_is_a_fine_float():
    inner = from_json(Inner, {"rate": 1})
    assert inner.rate == 1.0
    assert type(inner.rate) is float


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({}, "steps: missing"),
        ({"steps": 1, "stepz": 2}, "stepz: unknown key; Outer has steps, name"),
        ({"steps": 1, "inner": {"rat": 2}}, "inner.rat: unknown key"),
        ({"steps": 1.0}, "steps takes a whole number, got 1.0"),
        ({"steps": True}, "steps takes a whole number, got True"),
        ({"steps": 1, "fast": 1}, "fast takes True or False, got 1"),
        ({"steps": 1, "name": None}, "name takes a text, got None"),
        ({"steps": 1, "limit": "1"}, "limit takes a number, got '1'"),
        ({"steps": 1, "limit": True}, "limit takes a number, got True"),
        ({"steps": 1, "inner": 3}, "inner takes an object (Inner), got 3"),
        (
            {"steps": 1, "inner": {"sizes": [1, "a"]}},
            "inner.sizes[1] takes a whole number, got 'a'",
        ),
        (
            {"steps": 1, "inner": {"mode": "wild"}},
            "inner.mode takes 'adaptive' or 'fixed', got 'wild'",
        ),
        ({"steps": 1, "inner": {"rate": -1}}, "inner: rate must be positive"),
        ({"steps": 1, "spare": {"rate": "x"}}, "spare.rate takes a number"),
        ({"steps": 1, "spare": 1}, "spare takes an object (Inner), got 1"),
        ({"steps": 1, "number": "x"}, "number takes a number, got 'x'"),
        ({"steps": 1, "span": [1]}, "span takes 2 entries, got 1"),
        ({"steps": 1, "layout": [["up", "3"]]}, "layout[0][1] takes a whole number"),
        ({"steps": 1, "sizes": [1, None]}, "sizes[1] takes a whole number"),
        ({"steps": 1, "results": [1]}, "results takes an object, got [1]"),
        ({"steps": 1, "limit": 10**400}, "limit takes a number, got a huge integer"),
        ([1], "config takes an object (Outer), got [1]"),
    ],
)
def test_what_does_not_fit_is_refused_by_the_path_of_its_key(data: Any, message: str):
    with pytest.raises(ConfigError) as error:
        from_json(Outer, data)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@dataclasses.dataclass(frozen=True)
class Typed:
    type: str = "a"


@pytest.mark.parametrize(
    ("kind", "value", "complaint"),
    [
        (complex, 1j, "thing: a config cannot hold"),
        (Inner | Typed, Inner(), "cannot hold Typed in a union: its field 'type'"),
        (Inner | Typed, Typed(), "cannot hold Typed in a union: its field 'type'"),
    ],
)
def test_a_field_that_no_config_can_hold_is_the_programs_mistake(
    kind: Any, value: Any, complaint: str
):
    strange = dataclasses.make_dataclass("Strange", [("thing", kind)])
    with pytest.raises(TypeError, match=complaint):
        to_json(strange(value))


def test_a_field_of_the_wrong_type_is_not_written():
    layout: Any = (("up", "fast"),)
    with pytest.raises(
        ConfigError, match=r"layout\[0\]\[1\] takes a whole number, got 'fast'"
    ):
        to_json(Outer(steps=1, layout=layout))


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (None, r"config\.json cannot be read: No such file"),
        ('{"steps": 1', r"config\.json is damaged or not JSON"),
        ('{"steps": "x"}', r"config\.json: steps takes a whole number"),
    ],
)
def test_a_file_that_is_not_ours_is_refused_by_its_name(
    tmp_path: Path, content: str | None, complaint: str
):
    path = tmp_path / "config.json"
    if content is not None:
        path.write_text(content)
    with pytest.raises(ConfigError, match=complaint):
        load_config(Outer, path)


def test_one_of_several_dataclasses_is_read_back_by_its_name():
    @dataclasses.dataclass(frozen=True)
    class Walk:
        speed: float = 1.0

    @dataclasses.dataclass(frozen=True)
    class Run:
        speed: float = 9.0

    @dataclasses.dataclass(frozen=True)
    class Motion:
        gait: Walk | Run = Walk()

    assert to_json(Motion(Run(8.0))) == {"gait": {"type": "Run", "speed": 8.0}}
    assert from_json(Motion, {"gait": {"type": "Run", "speed": 8.0}}) == Motion(
        Run(8.0)
    )
    with pytest.raises(ConfigError, match=r"gait.type takes Walk or Run, got 'Fly'"):
        from_json(Motion, {"gait": {"type": "Fly"}})


def test_equal_configs_have_equal_hashes_and_others_do_not():
    assert config_hash(Inner(rate=1)) == config_hash(Inner(rate=1.0))
    assert config_hash(Inner(rate=1.0)) != config_hash(Inner(rate=1.0 + 1e-15))


def test_the_hash_is_the_same_in_another_process():
    program = (
        "from bp2_rl.base.serialization import config_hash as h; "
        "from bp2_rl.settings.env import EnvConfig; print(h(EnvConfig()))"
    )
    other = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert other.stdout.split()[-1] == config_hash(EnvConfig())


def test_a_merge_keeps_what_was_changed_and_takes_the_rest():
    before, after = (
        Outer(1, inner=Inner(rate=1.0)),
        Outer(2, fast=True, inner=Inner(rate=2.0, mode="adaptive")),
    )
    changed = Outer(1, name="mine", inner=Inner(rate=1.0, sizes=(8,)))
    assert merge(before, changed, after) == Outer(
        2, "mine", True, inner=Inner(2.0, (8,), "adaptive")
    )
    assert merge(before, dataclasses.replace(before, steps=3), after).steps == 3
    assert merge(before, before, after) == after


def test_a_file_round_trips_and_leaves_nothing_else_behind(tmp_path: Path):
    path = tmp_path / "config.json"
    save_config(path, Outer(steps=1))
    save_config(path, Outer(steps=2))
    assert load_config(Outer, path) == Outer(steps=2)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.attack
def test_whatever_a_config_file_holds_it_is_read_or_refused(tmp_path: Path):
    path = tmp_path / "config.json"
    for text in strange_json(to_json(preset("imitation", "smoke")), 1000):
        path.write_text(text)
        with contextlib.suppress(UserError):  # anything else fails the test
            load_config(TrainConfig, path)


@dataclasses.dataclass(frozen=True)
class Card:
    versions: dict[str, str]
    a: float = 1.5
    b: tuple[int, ...] = ()
    format_version: int = 3


def test_what_was_sealed_comes_back_and_nothing_else_does(tmp_path: Path):
    path, card = tmp_path / "card.json", Card({"bp2_rl": "0.1"}, b=(1, 2))
    save_sealed(path, card, "sum")
    sealed = json.loads(path.read_text())
    plain = {key: value for key, value in sealed.items() if key != "sum"}
    for same in (sealed, dict(reversed(sealed.items())), plain):
        path.write_text(json.dumps(same, indent=3))
        assert load_sealed(Card, path, "sum", 3) == card
    for changed in ({**sealed, "a": 1.25}, {**sealed, "d": 0}, {**sealed, "sum": None}):
        path.write_text(json.dumps(changed))
        with pytest.raises(
            ConfigError,
            match=r"card\.json \(written by bp2_rl 0\.1\): damaged or edited",
        ):
            load_sealed(Card, path, "sum", 3)
    path.write_text(json.dumps(plain | {"a": "x"}))
    with pytest.raises(ConfigError, match="a takes a number, got 'x'"):
        load_sealed(Card, path, "sum", 3)
    path.write_text(json.dumps(plain))
    with pytest.raises(
        ConfigError,
        match=r"has format 3, of bp2_rl 0\.1; this one reads format 2: update bp2_rl",
    ):
        load_sealed(Card, path, "sum", 2)


def test_a_folder_is_claimed_once_and_says_what_is_another(tmp_path):
    folder = tmp_path / "deep" / "folder"
    claim_folder(folder, "card.json", Inner(), "a walk")
    written = (folder / "card.json").stat().st_mtime_ns
    claim_folder(folder, "card.json", Inner(), "a walk")
    assert (folder / "card.json").stat().st_mtime_ns == written
    with pytest.raises(
        UserError,
        match=r"holds a walk with another sizes \(see .*card.json\): choose another folder",
    ):
        claim_folder(folder, "card.json", Inner(sizes=(1,)), "a walk")


def test_a_folder_that_cannot_be_is_not_claimed():
    with pytest.raises(UserError, match="cannot write to /dev/null/here"):
        claim_folder(Path("/dev/null/here"), "card.json", Inner(), "a walk")
