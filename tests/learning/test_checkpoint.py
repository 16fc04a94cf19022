import contextlib
import hashlib
import json
import shutil
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from brax.training.acme import running_statistics
from damage import flipped_bits, strange_json
from flax import struct
from killer import killed_at_every_operation, save_checkpoint

from bp2_rl.learning import checkpoint
from bp2_rl.learning.checkpoint import (
    CheckpointError,
    Saver,
    host_copy,
    latest_step,
    read_metadata,
    restore_checkpoint,
)


class State(struct.PyTreeNode):
    """A small train state with each kind of value that a training state holds."""

    params: dict
    optimizer: Any
    normalizer: Any
    key: jax.Array
    step: jax.Array
    strange: jax.Array  # NaN with a payload, infinities, minus zero, a denormal
    empty: None = None


def make_state(seed: int = 0) -> State:
    params, adam, normalizer = _learned(jax.random.key(seed))
    strange = np.array(
        [0x7FC12345, 0x7F800000, 0xFF800000, 0x80000000, 0x00000001], np.uint32
    ).view(np.float32)
    return State(
        params=params,
        optimizer=adam,
        normalizer=normalizer,
        key=jax.random.PRNGKey(seed),
        step=jnp.int32(12),
        strange=jnp.asarray(strange),
    )


@jax.jit
def _learned(key: jax.Array) -> tuple:
    params = {
        "policy": {"kernel": jax.random.normal(key, (7, 5)), "bias": jnp.zeros(5)},
        "layers": [jnp.ones(2)],
    }
    optimizer = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(1e-3))
    _, adam = optimizer.update(params, optimizer.init(params), params)
    normalizer = running_statistics.init_state(
        {"state": jnp.zeros(4), "privileged_state": jnp.zeros(6)}
    )
    batch = {
        name: jax.random.normal(key, (8, size))
        for name, size in (("state", 4), ("privileged_state", 6))
    }
    return params, adam, running_statistics.update(normalizer, batch)


def as_bits(leaf: Any) -> tuple:
    """Return type, shape and bytes of an array: equal only if nothing at all has
    changed."""
    return leaf.dtype, leaf.shape, np.asarray(leaf).tobytes()


def assert_same(a: Any, b: Any) -> None:
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for (path, left), right in zip(
        jax.tree_util.tree_leaves_with_path(a), jax.tree.leaves(b), strict=True
    ):
        assert as_bits(left) == as_bits(right), jax.tree_util.keystr(path)


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, State]:
    run, state = tmp_path_factory.mktemp("run"), make_state()
    save_checkpoint(run, 100, make_state(1))
    save_checkpoint(run, 200, state, config={"seed": 7}, log={"count": 2})
    return run, state


@pytest.fixture
def run(saved: tuple[Path, State], tmp_path: Path) -> Path:
    """Copy a run with checkpoints 100 and 200 to where it may be broken."""
    return Path(shutil.copytree(saved[0], tmp_path / "run"))


def names(run: Path) -> list[str]:
    return sorted(entry.name for entry in (run / "checkpoints").iterdir())


@pytest.mark.parametrize(("named", "step", "seed"), [(None, 200, 0), (100, 100, 1)])
def test_every_bit_comes_back(
    saved: tuple[Path, State], named: int | None, step: int, seed: int
):
    found, restored = restore_checkpoint(saved[0], make_state(5), named)
    assert found == step
    assert_same(restored, make_state(seed))


def test_a_leaf_is_restored_on_its_templates_sharding_and_without_one_as_numpy(
    tmp_path: Path,
):
    mesh = jax.make_mesh((1,), ("robots",), axis_types=(jax.sharding.AxisType.Auto,))
    spread = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("robots"))
    save_checkpoint(tmp_path, 1, {"x": jnp.arange(8.0)})
    for template in (
        jax.device_put(jnp.zeros(8), spread),
        jax.ShapeDtypeStruct((8,), np.float32, sharding=spread),
    ):
        _, restored = restore_checkpoint(tmp_path, {"x": template})
        assert restored["x"].sharding == spread
        assert_same(restored, {"x": jnp.arange(8.0)})
    for template in (np.zeros(8, np.float32), jax.ShapeDtypeStruct((8,), np.float32)):
        _, restored = restore_checkpoint(tmp_path, {"x": template})
        assert type(restored["x"]) is np.ndarray
        assert_same(restored, {"x": jnp.arange(8.0)})


def test_a_part_can_be_read_by_itself(saved: tuple[Path, State]):
    run, state = saved
    bias = state.params["policy"]["bias"]
    _, part = restore_checkpoint(run, {"params": {"policy": {"bias": bias}}}, part=True)
    assert_same(part, {"params": {"policy": {"bias": bias}}})
    with pytest.raises(
        CheckpointError, match=r"params/critic is absent there and float32\[5\] here"
    ):
        restore_checkpoint(run, {"params": {"critic": bias}}, part=True)


def test_a_host_copy_outlives_the_donation_of_its_state():
    """On a CPU a NumPy view of a JAX array is its very memory, and the next train step
    writes there."""
    state = {"x": jnp.arange(1000.0), "y": jnp.int32(3)}
    copy = host_copy(state)
    jax.jit(lambda s: jax.tree.map(lambda x: x + 1, s), donate_argnums=0)(state)
    np.testing.assert_array_equal(copy["x"], np.arange(1000.0))
    assert copy["y"] == 3
    assert copy["x"].flags.owndata


def test_metadata_says_what_a_checkpoint_is(saved: tuple[Path, State]):
    metadata = read_metadata(saved[0], 200)
    assert metadata.step == 200
    assert metadata.config == {"seed": 7}
    assert metadata.log == {"count": 2}
    assert metadata.versions["jax"] == jax.__version__
    assert metadata.tree["params/policy/kernel"] == "float32[7,5]"
    on_disk = {path.name for path in (saved[0] / "checkpoints/200").iterdir()}
    assert {*metadata.files, "metadata.json"} == on_disk
    # and any reader of .npz files reads the arrays
    with np.load(saved[0] / "checkpoints/200/state.npz") as arrays:
        np.testing.assert_array_equal(
            arrays["params/policy/kernel"], saved[1].params["policy"]["kernel"]
        )


@pytest.mark.parametrize(
    ("kept", "saves", "left"),
    [
        (2, (1, 2, 10, 20), ["10", "20"]),
        (1, (10, 20, 30, 5), ["30", "5"]),  # none beyond the one that is saved goes
        (2, (3, 3), ["3"]),
    ],
    ids=["the newest", "an older one", "the same again"],
)
def test_a_save_keeps_the_newest_up_to_itself(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    kept: int,
    saves: tuple[int, ...],
    left: list[str],
):
    monkeypatch.setattr(checkpoint, "KEPT", kept)
    for value, step in enumerate(saves):
        save_checkpoint(tmp_path, step, {"x": jnp.float32(value)})
    assert names(tmp_path) == left
    last = restore_checkpoint(tmp_path, {"x": jnp.float32(0)}, saves[-1])
    assert last == (saves[-1], {"x": len(saves) - 1})


@pytest.mark.parametrize("there", [True, False], ids=["a file", "deleted"])
def test_a_runs_folder_is_not_made_anew(tmp_path: Path, there: bool):
    if there:
        (tmp_path / "run").write_text("a file")
    with pytest.raises(
        CheckpointError, match=r"cannot save checkpoint 1 .*there is none yet"
    ):
        save_checkpoint(tmp_path / "run", 1, {"x": jnp.zeros(1)})
    assert (tmp_path / "run").exists() is there


def test_a_save_that_was_killed_is_passed_over_and_swept_away(run: Path):
    folder = run / "checkpoints"
    shutil.copytree(folder / "200", folder / ".300.new")  # killed before the rename
    (folder / "400").mkdir()  # no metadata: never complete
    (folder / "notes.txt").write_text("mine")
    assert latest_step(run) == 200
    assert restore_checkpoint(run, make_state())[0] == 200
    save_checkpoint(run, 300, make_state())
    assert latest_step(run) == 300
    assert not (folder / ".300.new").exists()
    assert (folder / "notes.txt").exists()


@pytest.mark.parametrize("moment", ["write", "rename"])
def test_a_save_that_fails_keeps_the_last_good_one(
    run: Path, monkeypatch: pytest.MonkeyPatch, moment: str
):
    real = checkpoint._write

    def fail(*args: Any) -> None:
        if moment == "write":
            real(*args)
        raise OSError(28, "No space left on device")

    if moment == "write":
        monkeypatch.setattr(checkpoint, "_write", fail)
    else:
        monkeypatch.setattr(Path, "rename", fail)
    with pytest.raises(
        CheckpointError,
        match=r"cannot save checkpoint 300 .*No space left.*the last good one is 200",
    ):
        save_checkpoint(run, 300, make_state())
    assert names(run) == ["100", "200"]
    assert restore_checkpoint(run, make_state())[0] == 200


# --- In the background ----------------------------------------------------------------
def test_the_last_save_is_on_disk_when_a_saver_is_left(tmp_path: Path):
    with Saver(tmp_path, {"seed": 7}) as saver:
        for step in range(4):
            saver.save(step, {"x": jnp.float32(step)}, {"count": step})
    assert restore_checkpoint(tmp_path, {"x": np.float32(0)}) == (3, {"x": 3.0})
    metadata = read_metadata(tmp_path, 3)
    assert (metadata.config, metadata.log) == ({"seed": 7}, {"count": 3})
    assert names(tmp_path) == ["1", "2", "3"]


def test_a_save_leaves_the_caller_free_and_two_never_overlap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    release, writing = threading.Semaphore(0), []
    real = checkpoint._write

    def slow(directory: Path, *args: Any) -> None:
        writing.append(directory.name)
        assert release.acquire(timeout=10)
        real(directory, *args)

    monkeypatch.setattr(checkpoint, "_write", slow)
    with Saver(tmp_path, {}) as saver:
        saver.save(1, {"x": jnp.float32(1)})
        assert latest_step(tmp_path) is None  # back before it is written
        threading.Timer(0.1, release.release).start()
        saver.save(2, {"x": jnp.float32(2)})  # waits for the first
        assert latest_step(tmp_path) == 1
        release.release()
    assert latest_step(tmp_path) == 2
    assert writing == [".1.new", ".2.new"]


@pytest.mark.parametrize(
    ("then", "error"),
    [
        (lambda saver: saver.save(2, {"x": jnp.zeros(1)}), CheckpointError),
        (lambda saver: saver.wait(), CheckpointError),
        (lambda saver: None, CheckpointError),
        (lambda saver: 1 / 0, ZeroDivisionError),  # an error of the training is it
    ],
    ids=["save", "wait", "leave", "fail"],
)
def test_what_went_wrong_in_the_background_is_raised_by_the_next_call(
    tmp_path: Path, then: Callable[[Saver], object], error: type[Exception]
):
    (tmp_path / "checkpoints").write_text("in the way")

    def run() -> None:
        with Saver(tmp_path, {}) as saver:
            saver.save(1, {"x": jnp.zeros(1)})
            then(saver)

    with pytest.raises(error, match=r"cannot save checkpoint 1 |division by zero"):
        run()


# --- Readers and kills ----------------------------------------------------------------
@pytest.mark.attack
def test_readers_only_ever_see_whole_checkpoints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """A reader that polls during many saves restores a state that one save wrote, never
    a mixture."""
    monkeypatch.setattr(checkpoint, "KEPT", 10)
    state = {"x": jnp.zeros(1000), "y": jnp.zeros(1000)}
    save_checkpoint(tmp_path, 0, state)
    done = threading.Event()

    def save() -> None:
        for step in range(1, 6):
            save_checkpoint(
                tmp_path, step, jax.tree.map(lambda x, n=step: x + n, state)
            )
        done.set()

    writer = threading.Thread(target=save)
    writer.start()
    seen = set()
    while not done.is_set():
        step, restored = restore_checkpoint(tmp_path, state)
        assert np.all(np.asarray(restored["x"]) == step)
        assert np.all(np.asarray(restored["y"]) == step)
        seen.add(step)
    writer.join()
    assert latest_step(tmp_path) == 5
    assert seen


@pytest.mark.parametrize("step", [2, 3], ids=["the same step again", "another step"])
def test_a_save_killed_at_any_operation_leaves_the_one_before_or_the_new_one(
    tmp_path: Path, step: int
):
    template = {"x": np.zeros(1000)}
    (tmp_path / "run").mkdir()
    for before in (1, 2):
        save_checkpoint(tmp_path / "run", before, {"x": np.full(1000, float(before))})
    found = []
    for run in killed_at_every_operation(tmp_path, "save_step", step):
        newest, state = restore_checkpoint(run, template)
        assert (newest, state["x"][0]) in {(2, 2.0), (step, 7.0)}
        assert np.all(state["x"] == state["x"][0])
        found.append(state["x"][0])
        save_checkpoint(run, 4, {"x": np.full(1000, 4.0)})  # and saves go on
        assert restore_checkpoint(run, template)[0] == 4
        assert all(name.isdecimal() for name in names(run))
    assert found == sorted(found)
    assert {*found} == {2.0, 7.0}


# --- What is refused, and in which words ----------------------------------------------
def refusal(run: Path, template: Any = None, step: int | None = None) -> str:
    before = sorted(str(path) for path in run.rglob("*"))
    with pytest.raises(CheckpointError) as error:
        restore_checkpoint(run, make_state() if template is None else template, step)
    assert "\n" not in str(error.value)
    assert sorted(str(path) for path in run.rglob("*")) == before, (
        "a refusal destroys nothing"
    )
    return str(error.value)


def flip_a_bit(content: bytes) -> bytes:
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


@pytest.mark.parametrize(
    ("name", "damage", "words"),
    [
        ("state.npz", lambda content: content[:-7], "its checksum differs"),
        ("state.npz", flip_a_bit, "its checksum differs"),
        ("state.npz", None, "cannot be read: No such file"),
        ("metadata.json", lambda content: content[:500], "is damaged or not JSON"),
    ],
)
def test_a_damaged_file_is_named_with_the_step_to_go_on_from(run, name, damage, words):
    path = run / "checkpoints/200" / name
    content = path.read_bytes()
    path.unlink()
    if damage is not None:
        path.write_bytes(damage(content))
    message = refusal(run)
    assert f"200/{name} {words}" in message or f"{name} is damaged: {words}" in message
    assert message.endswith("remove that folder to go on from step 100")
    shutil.rmtree(run / "checkpoints/100")
    assert refusal(run).endswith("there is no other to go on from")


def edit_metadata(run: Path, **changes: Any) -> None:
    path = run / "checkpoints/200/metadata.json"
    metadata = json.loads(path.read_text())
    metadata.pop("metadata_sha256", None)
    path.write_text(json.dumps(metadata | changes))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "half-written, or not a checkpoint of bp2_rl"),
        ("[]", "is not of bp2_rl"),
        ("{}", "is not of bp2_rl"),
        ('{"format_version": "one"}', "is not of bp2_rl"),
        ('{"format_version": true}', "is not of bp2_rl"),
    ],
)
def test_metadata_of_another_program_are_refused(
    run: Path, content: str | None, words: str
):
    path = run / "checkpoints/200/metadata.json"
    path.unlink()
    if content is not None:
        path.write_text(content)
    assert words in refusal(run, step=200)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"format_version": 99}, "this one reads format 3: update bp2_rl"),
        ({"format_version": 2}, "format 3: use the bp2_rl that wrote it"),
        *(
            ({name: None}, f"{name} takes an object, got None")
            for name in ("config", "log", "tree", "files")
        ),
        ({"files": {}}, "is damaged"),
        ({"step": 201}, "does not describe the checkpoint of step 200"),
    ],
)
def test_metadata_that_do_not_fit_are_refused(run: Path, changes: dict, words: str):
    edit_metadata(run, versions={"bp2_rl": "9.9"}, **changes)
    assert words in refusal(run)


def test_a_step_that_is_not_there_is_refused(run: Path, tmp_path: Path):
    assert "no complete checkpoint in" in refusal(tmp_path / "none")
    assert refusal(run, step=150).endswith("it has: 100, 200")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"step": jnp.zeros(2, jnp.int32)}, "step is int32[] there and int32[2] here"),
        ({"step": jnp.float32(0)}, "step is int32[] there and float32[] here"),
        ({"params": {}}, "params/layers/0 is float32[2] there and absent here"),
        ({"empty": jnp.zeros(1)}, "empty is absent there and float32[1] here"),
    ],
)
def test_another_trainings_checkpoint_names_the_first_leaf_that_differs(
    run: Path, change: dict, words: str
):
    message = refusal(run, make_state().replace(**change))
    assert words in message
    assert "is of another training" in message


def forge_state(run: Path, **arrays: Any) -> None:
    """Replace step 200's arrays by others, with metadata that vouch for them."""
    np.savez(run / "checkpoints/200/state.npz", **arrays)
    content = (run / "checkpoints/200/state.npz").read_bytes()
    edit_metadata(run, files={"state.npz": hashlib.sha256(content).hexdigest()})


@pytest.mark.parametrize(
    ("bias", "words"),
    [
        (np.zeros((5, 2), np.float32), "holds {} as float32[5, 2], expected float32"),
        (np.zeros(5), "holds {} as float64[5], expected float32[5]"),
        (None, "lacks the array {}"),
    ],
    ids=["shape", "type", "missing"],
)
def test_arrays_that_are_not_as_the_metadata_say_are_refused_by_name(
    run: Path, bias: np.ndarray | None, words: str
):
    with np.load(run / "checkpoints/200/state.npz") as file:
        arrays = dict(file)
    forge_state(run, **arrays)
    restore_checkpoint(run, make_state())
    del arrays["params/policy/bias"]
    if bias is not None:
        arrays["params/policy/bias"] = bias
    forge_state(run, **arrays)
    assert words.format("params/policy/bias") in refusal(run)


@pytest.mark.attack
def test_whatever_the_metadata_hold_the_checkpoint_is_restored_or_refused(run: Path):
    edit_metadata(run)
    path, template = run / "checkpoints/200/metadata.json", make_state()
    for text in strange_json(json.loads(path.read_text()), 500):
        path.write_text(text)
        with contextlib.suppress(CheckpointError):  # anything else fails the test
            restore_checkpoint(run, template, 200)


@pytest.mark.parametrize("name", ["metadata.json", "state.npz"])
def test_a_flipped_bit_of_either_file_changes_nothing_or_is_refused(
    run: Path, name: str
):
    path, state = run / "checkpoints/200" / name, make_state()
    loaded = 0
    for content in flipped_bits(path.read_bytes(), 200):
        path.write_bytes(content)
        with contextlib.suppress(CheckpointError):
            assert_same(restore_checkpoint(run, state, 200)[1], state)
            loaded += 1
    assert loaded < 50
