import contextlib
import dataclasses
import hashlib
import io
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.training import networks
from brax.training.acme import running_statistics
from damage import flipped_bits, strange_json
from flax import linen
from killer import killed_at_every_operation

from bp2_rl.base.errors import UserError
from bp2_rl.base.serialization import to_json
from bp2_rl.learning.networks import dense_layers
from bp2_rl.learning.policy import (
    PolicyCard,
    PolicyError,
    find_policy,
    load_policy,
    make_policy,
    save_policy,
)
from bp2_rl.robot.named import find_robot
from bp2_rl.settings.env import EnvConfig

LAYOUT = (("command", 3), ("joint_position", 12), ("up", 3))
SIZE = sum(size for _, size in LAYOUT)
HIDDEN = (32, 16)
ACTIVATIONS: dict[str, Callable] = {
    "swish": linen.swish,
    "elu": linen.elu,
    "tanh": linen.tanh,
    "relu": linen.relu,
}


def export_policy(directory, *, params, normalizer, card):
    return save_policy(
        directory, make_policy(dense_layers(params, {}), normalizer, card)
    )


def make_card(**changes: Any) -> PolicyCard:
    card = PolicyCard(
        stage="imitation",
        observation_layout=LAYOUT,
        action_size=12,
        activation="swish",
        hidden_layer_sizes=HIDDEN,
        env=EnvConfig(),
        reference="kinematic",
        physics_steps=1_000_000,
        seed=7,
        versions={"bp2_rl": "0.1.0", "jax": "0.10.2"},
        config_hash="0123456789ab",
        results={"top_speed": 8.3, "falls": 0, "command": "python eval.py"},
        created="2026-11-20T12:00:00+00:00",
    )
    return dataclasses.replace(card, **changes)


def brax_network(activation: str = "swish") -> networks.FeedForwardNetwork:
    return networks.make_policy_network(
        12,
        {"state": (SIZE,), "privileged_state": (40,)},
        preprocess_observations_fn=running_statistics.normalize,  # pyright: ignore[reportArgumentType]
        hidden_layer_sizes=HIDDEN,
        activation=ACTIVATIONS[activation],
        distribution_type="normal",
        noise_std_type="log",
    )


def brax_normalizer() -> running_statistics.RunningStatisticsState:
    """Return running statistics that have seen data far from zero mean and unit
    deviation."""
    state = running_statistics.init_state(
        {"state": jnp.zeros(SIZE), "privileged_state": jnp.zeros(40)}
    )
    key = jax.random.key(1)
    batch = {
        "state": 3 + 5 * jax.random.normal(key, (64, SIZE)),
        "privileged_state": jax.random.normal(key, (64, 40)),
    }
    return jax.jit(running_statistics.update)(state, batch)


@pytest.fixture(scope="module")
def brax_params() -> Any:
    params = jax.jit(brax_network().init)(jax.random.key(0))
    # Brax starts biases at zero: let them count
    return jax.tree.map(lambda x: x + 0.1, params)


@pytest.fixture(scope="module")
def normalizer() -> Any:
    return brax_normalizer()


@pytest.fixture(scope="module")
def exported(
    brax_params: Any, normalizer: Any, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    directory = tmp_path_factory.mktemp("run") / "policy"
    export_policy(
        directory, params=brax_params, normalizer=normalizer, card=make_card()
    )
    return directory


@pytest.fixture
def policy_dir(exported: Path, tmp_path: Path) -> Path:
    """Copy an exported policy to where it may be broken."""
    return Path(shutil.copytree(exported, tmp_path / "policy"))


# --- The function ---------------------------------------------------------------------
@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize(
    ("deviations", "tolerance"),
    [
        (1.0, 1e-6),  # float32's rounding of sums of order one
        # of sums of some hundreds, which may nearly cancel; a careless sigmoid would
        # overflow here
        (100.0, 1e-4),
    ],
)
def test_the_action_is_that_of_braxs_network(
    activation: str,
    deviations: float,
    tolerance: float,
    brax_params: Any,
    normalizer: Any,
):
    policy = make_policy(
        dense_layers(brax_params, {}), normalizer, make_card(activation=activation)
    )
    noise = deviations * jax.random.normal(jax.random.key(2), (100, SIZE))
    observation = normalizer.mean["state"] + noise * normalizer.std["state"]
    expected, _ = brax_network(activation).apply(
        normalizer,
        brax_params,
        {"state": observation, "privileged_state": jnp.zeros((100, 40))},
    )
    scale = np.maximum(1, np.abs(expected).max(axis=-1, keepdims=True))
    for action in (
        policy(np.asarray(observation)),
        policy(observation),
        jax.jit(policy)(observation),
    ):
        assert action.dtype == np.float32
        np.testing.assert_allclose(
            action / scale, expected / scale, rtol=0, atol=tolerance
        )


def test_the_action_keeps_the_observations_library_and_batch_shape(exported: Path):
    policy = load_policy(exported)
    # float64, as C MuJoCo gives it
    observation = np.random.default_rng(0).normal(size=(4, 5, SIZE))
    action = policy(observation)
    assert isinstance(action, np.ndarray)
    assert action.shape == (4, 5, 12)
    with pytest.raises(
        PolicyError,
        match="has 17 numbers, but this policy reads 18: command 3, joint_position 12, up 3",
    ):
        policy(np.zeros(17))
    np.testing.assert_allclose(
        policy(observation[2, 3]), action[2, 3], rtol=0, atol=1e-6
    )
    assert isinstance(policy(jnp.asarray(observation)), jax.Array)
    np.testing.assert_allclose(
        jax.vmap(jax.vmap(policy))(jnp.asarray(observation)), action, rtol=0, atol=1e-6
    )


# --- The files ------------------------------------------------------------------------
def test_what_is_loaded_is_what_was_exported(
    brax_params: Any, normalizer: Any, tmp_path: Path
):
    card = make_card(
        env=dataclasses.replace(
            EnvConfig(),
            control=dataclasses.replace(EnvConfig().control, stiffness=99.0),
        )
    )
    made = export_policy(
        tmp_path / "p", params=brax_params, normalizer=normalizer, card=card
    )
    loaded = load_policy(tmp_path / "p")
    assert loaded.card == made.card
    assert dataclasses.replace(loaded.card, weights_sha256="") == card
    assert loaded.card.env.control.stiffness == 99.0
    np.testing.assert_array_equal(loaded.mean, normalizer.mean["state"])
    np.testing.assert_array_equal(
        loaded.layers[0][0], brax_params["params"]["MLP_0"]["hidden_0"]["kernel"]
    )
    np.testing.assert_array_equal(
        loaded.layers[-1][1], brax_params["params"]["Dense_0"]["bias"]
    )
    assert sorted(path.name for path in (tmp_path / "p").iterdir()) == [
        "card.json",
        "weights.npz",
    ]


def test_statistics_of_the_policys_part_alone_will_do(
    brax_params: Any, normalizer: Any, exported: Path, tmp_path: Path
):
    export_policy(
        tmp_path / "p",
        params=brax_params,
        normalizer=running_statistics.NestedMeanStd(
            mean=normalizer.mean["state"], std=normalizer.std["state"]
        ),
        card=make_card(),
    )
    assert (tmp_path / "p/weights.npz").read_bytes() == (
        exported / "weights.npz"
    ).read_bytes()


def test_a_runs_policy_is_found_by_the_runs_folder(exported: Path, tmp_path: Path):
    for steps in ("64", "128"):
        shutil.copytree(exported, tmp_path / "policies" / steps)
    assert find_policy(tmp_path) == tmp_path / "policies" / "128"
    assert load_policy(tmp_path).card == load_policy(str(exported)).card


def test_saving_a_loaded_policy_changes_its_card_and_not_its_weights(
    exported: Path, tmp_path: Path
):
    policy = load_policy(exported)
    measured = dataclasses.replace(
        policy, card=dataclasses.replace(policy.card, results={"top_speed": 9.0})
    )
    saved = save_policy(tmp_path / "p", measured)
    assert load_policy(tmp_path / "p").card == saved.card == measured.card
    assert (tmp_path / "p/weights.npz").read_bytes() == (
        exported / "weights.npz"
    ).read_bytes()


def test_a_policy_may_be_saved_where_it_lies(
    policy_dir: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(policy_dir)
    saved = save_policy(
        Path(), dataclasses.replace(load_policy("."), card=make_card(seed=8))
    )
    assert load_policy(policy_dir).card == saved.card
    assert saved.card.seed == 8
    assert [path.name for path in policy_dir.parent.iterdir()] == ["policy"]


@pytest.mark.parametrize(
    ("hidden", "words"),
    [
        ((32, 20), r"layer_1/weight has shape \(32, 16\), its card says \(32, 20\)"),
        ((32,), "the network has 3 layers, its card says 2"),
    ],
)
def test_a_network_that_is_not_the_cards_is_not_saved(
    brax_params: Any, normalizer: Any, policy_dir: Path, hidden: tuple, words: str
):
    before, card = (
        (policy_dir / "card.json").read_bytes(),
        make_card(hidden_layer_sizes=hidden),
    )
    with pytest.raises(PolicyError, match=words):
        make_policy(dense_layers(brax_params, {}), normalizer, card)
    with pytest.raises(PolicyError, match=words):
        save_policy(policy_dir, dataclasses.replace(load_policy(policy_dir), card=card))
    assert (policy_dir / "card.json").read_bytes() == before


@pytest.mark.parametrize("there", [True, False])
def test_a_policy_is_not_saved_through_a_link(
    exported: Path, tmp_path: Path, there: bool
):
    elsewhere, link = tmp_path / "elsewhere", tmp_path / "policies" / "1024"
    link.parent.mkdir()
    if there:
        elsewhere.mkdir()
    link.symlink_to(elsewhere)
    save_policy(link, load_policy(exported))
    assert load_policy(link).card.seed == 7
    assert elsewhere.exists() is there
    assert not there or list(elsewhere.iterdir()) == []


def test_a_policy_set_aside_by_a_killed_export_comes_back(
    brax_params: Any, normalizer: Any, policy_dir: Path, monkeypatch: pytest.MonkeyPatch
):
    # killed between the two renames
    policy_dir.rename(policy_dir.with_name(".policy.old"))
    # and the next export fails before it could write
    monkeypatch.setattr(Path, "mkdir", _no_space)
    with pytest.raises(PolicyError, match="No space left"):
        export_policy(
            policy_dir, params=brax_params, normalizer=normalizer, card=make_card()
        )
    monkeypatch.undo()
    assert load_policy(policy_dir).card.seed == 7


@pytest.mark.attack
def test_an_export_killed_at_any_operation_leaves_the_policy_before_or_the_new_one(
    policy_dir: Path, tmp_path: Path
):
    shutil.copytree(policy_dir, tmp_path / "run" / "policies" / "64")
    seeds = []
    for run in killed_at_every_operation(tmp_path, "save_card"):
        policy = load_policy(run)
        seeds.append(policy.card.seed)
        save_policy(run / "policies" / "64", policy)  # and exports go on
        assert [path.name for path in (run / "policies").iterdir()] == ["64"]
    assert seeds == sorted(seeds)
    assert {*seeds} == {7, 8}


def _no_space(self: Path, *args: Any, **kwargs: Any) -> None:
    if self.name.startswith("."):
        raise OSError(28, "No space left on device")


def test_an_export_never_replaces_a_folder_that_is_no_policy(
    brax_params: Any, normalizer: Any, tmp_path: Path
):
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis/chapter1.tex").write_text("mine")
    with pytest.raises(PolicyError, match="holds files that are no policy's"):
        export_policy(
            tmp_path / "thesis",
            params=brax_params,
            normalizer=normalizer,
            card=make_card(),
        )
    assert (tmp_path / "thesis/chapter1.tex").read_text() == "mine"
    assert [path.name for path in tmp_path.rglob("*")] == ["thesis", "chapter1.tex"]


# --- What is refused, and in which words ----------------------------------------------
def refusal(path: Path, **options: Any) -> str:
    with pytest.raises(UserError) as error:
        load_policy(path, **options)
    assert "\n" not in str(error.value)
    return str(error.value)


def edit_card(directory: Path, **changes: Any) -> None:
    """Edit a policy's card as a stranger would, with no checksum to give the edit
    away."""
    path = directory / "card.json"
    card = json.loads(path.read_text())
    card.pop("card_sha256", None)
    path.write_text(json.dumps(card | changes))


def forge(directory: Path, content: bytes) -> None:
    """Replace a policy's weights by others, with a card that vouches for them."""
    (directory / "weights.npz").write_bytes(content)
    edit_card(directory, weights_sha256=hashlib.sha256(content).hexdigest())


def archive(**arrays: object) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)  # pyright: ignore[reportArgumentType]
    return file.getvalue()


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("nowhere", "there is no such file or folder"),
        ("", "expected card.json and weights.npz there, or a run's policies"),
        ("file", "is a file; name the policy's folder"),
        ("run", "has exported no policy yet: train it to its first save"),
        ("x" * 5000, "no file or folder can be called"),
        ("a\0b", "no file or folder can be called"),
        ("a\udcff", "no file or folder can be called"),
    ],
    ids=["none", "empty", "file", "new run", "long", "NUL", "no UTF-8"],
)
def test_a_place_without_a_policy_is_refused(tmp_path: Path, place: str, words: str):
    (tmp_path / "file").touch()
    (tmp_path / "run/checkpoints").mkdir(parents=True)
    assert words in refusal(tmp_path / place)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("weights.npz", None, "weights.npz is missing"),
        ("weights.npz", b"", "truncated, damaged or from another policy"),
        ("card.json", b'{"format_version": 1', "card.json is damaged or not JSON"),
        ("card.json", b"[1, 2]", "is not of bp2_rl: it has no format_version"),
        ("card.json", b'{"model": "gpt"}', "it has no format_version"),
        ("card.json", b'{"format_version": "1"}', "it has no format_version"),
    ],
)
def test_a_file_that_is_not_the_policys_is_refused(
    policy_dir: Path, name: str, content: bytes | None, words: str
):
    (policy_dir / name).unlink()
    if content is not None:
        (policy_dir / name).write_bytes(content)
    assert words in refusal(policy_dir)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "weights.npz is damaged or no .npz file"),
        (b"PK\x03\x04 not really", "weights.npz is damaged or no .npz file"),
        (
            archive(mean=np.array([{"a": 1}], object)),
            "holds mean as object[1], expected float32[18]",
        ),
        (
            archive(mean=np.zeros(SIZE)),
            "holds mean as float64[18], expected float32[18]",
        ),
        (
            archive(w=np.zeros(3, np.float32)),
            "lacks the array mean: not the weights of card.json beside it",
        ),
    ],
    ids=["nothing", "no archive", "pickle", "another precision", "foreign"],
)
def test_weights_that_no_export_wrote_are_refused(
    policy_dir: Path, content: bytes, words: str
):
    forge(policy_dir, content)
    assert words in refusal(policy_dir)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"format_version": 2},
            "card.json has format 2, of bp2_rl 0.1.0; this one reads format 1: update bp2_rl",
        ),
        ({"action_size": 13}, "holds layer_2/weight as float32[16, 12], expected"),
        (
            {"env": {"gravity": 1.62}},
            "card.json (written by bp2_rl 0.1.0): env.gravity: unknown key",
        ),
        ({"versions": None}, "versions takes an object, got None"),
        (
            {"activation": "gelu"},
            "activation takes 'swish' or 'elu' or 'tanh' or 'relu', got 'gelu'",
        ),
        # a network of 200,000 layers is read in no time, and would never be compiled
        ({"hidden_layer_sizes": [1] * 101}, "has over 100 layers"),
        ({"stage": "$\\frac{$"}, "stage takes 'imitation' or 'relaxed', got '$"),
        ({"created": "\x1b[31m"}, "a text holds the control character '\\x1b'"),
        ({"results": {"\u202e": 1}}, "a text holds the control character '\\u202e'"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_a_card_of_another_program_is_refused(
    policy_dir: Path, changes: dict, words: str
):
    edit_card(policy_dir, **changes)
    assert words in refusal(policy_dir)


@pytest.mark.attack
def test_a_card_made_before_there_were_checksums_is_loaded(policy_dir: Path):
    edit_card(policy_dir)
    assert load_policy(policy_dir).card.seed == 7


def test_a_flipped_bit_of_the_card_is_seen(policy_dir: Path):
    """None changes what is loaded; nearly all are refused in one line, the others are
    of no account."""
    path, card = policy_dir / "card.json", load_policy(policy_dir).card
    loaded = 0
    for content in flipped_bits(path.read_bytes(), 200):
        path.write_bytes(content)
        with contextlib.suppress(UserError):
            assert load_policy(policy_dir).card == card
            loaded += 1
    assert loaded < 50


@pytest.mark.attack
def test_whatever_a_card_holds_it_is_loaded_or_refused(policy_dir: Path):
    edit_card(policy_dir, env=to_json(EnvConfig(reference="kinematic")))
    path = policy_dir / "card.json"
    for text in strange_json(json.loads(path.read_text()), 300):
        path.write_text(text)
        with contextlib.suppress(UserError):  # anything else fails the test
            load_policy(policy_dir)


def test_a_robots_name_is_one_that_titles_and_terminals_can_show(policy_dir: Path):
    env = to_json(EnvConfig(hardware=find_robot("go1"), reference="kinematic"))
    edit_card(policy_dir, env=env)
    assert load_policy(policy_dir).card.env.hardware.anatomy.name == "Unitree Go1"
    for name in ("$\\frac{$", "x" * 100_000, "", "a\nb"):
        env["hardware"]["body"]["name"] = name
        edit_card(policy_dir, env=env)
        assert (
            "a robot's name takes 1 to 80 printable letters and no $, got "
            in refusal(policy_dir)
        )


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("std", 0.0, "std is not positive"),
        ("std", -1.0, "std is not positive"),
        ("std", 1e-38, "std is so small that an observation may overflow"),
        ("mean", np.nan, "mean is not finite"),
        ("layer_1/weight", np.inf, "layer_1/weight is not finite"),
        (
            "layer_0/weight",
            3e38,
            "layer_0/weight is so large that an action may overflow",
        ),
        (
            "layer_2/weight",
            1e36,
            "layer_2/weight is so large that an action may overflow",
        ),
    ],
)
def test_numbers_that_no_action_can_come_of_are_refused_by_name(
    exported: Path,
    policy_dir: Path,
    tmp_path: Path,
    name: str,
    value: float,
    words: str,
):
    with np.load(exported / "weights.npz") as file:
        arrays = dict(file)
    arrays[name] = np.full_like(arrays[name], value)
    forge(policy_dir, archive(**arrays))
    assert words in refusal(policy_dir)
    layers = tuple(
        (arrays[f"layer_{i}/weight"], arrays[f"layer_{i}/bias"]) for i in range(3)
    )
    broken = dataclasses.replace(
        load_policy(exported), mean=arrays["mean"], std=arrays["std"], layers=layers
    )
    with pytest.raises(PolicyError, match=f"not exported to .*: {words}"):
        save_policy(tmp_path / "p", broken)
    assert not (tmp_path / "p").exists()


@pytest.mark.parametrize(
    ("expected", "words"),
    [
        (
            [("command", 3), ("joint_position", 12), ("up", 2)],
            "term 2 is 'up' of size 3 there and 'up' of size 2 here",
        ),
        (
            [("command", 3), ("phase", 2)],
            "term 1 is 'joint_position' of size 12 there and 'phase' of size 2 here",
        ),
        (
            [("command", 3), ("joint_position", 12)],
            "term 2 is 'up' of size 3 there and absent here",
        ),
        (
            [*LAYOUT, ("last_action", 12)],
            "term 3 is absent there and 'last_action' of size 12 here",
        ),
    ],
)
def test_another_observation_layout_names_the_first_difference(
    policy_dir: Path, expected: list, words: str
):
    message = refusal(policy_dir, layout_of=lambda _: expected)
    assert words in message
    assert "use the bp2_rl that trained it (0.1.0)" in message
