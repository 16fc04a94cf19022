"""A trained policy as data: two files that anyone can read, and the function that they describe.

    policy/weights.npz   the observation's mean and standard deviation, and each layer's kernel and bias
    policy/card.json     what the numbers mean: observation layout, action, environment, versions, results

    action = MLP((observation - mean) / std)        deterministic; float32; NumPy or JAX arrays

No pickles: a policy from a stranger is safe to load, and one from another project is refused by name.
"""

import dataclasses
import hashlib
import io
import itertools
import json
import os
import shutil
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from bp2_rl.config import ConfigError, from_json, to_json
from bp2_rl.env.config import EnvConfig, upgrade
from bp2_rl.errors import UserError

FORMAT_VERSION = 1
WEIGHTS = "weights.npz"
CARD = "card.json"
# The entry of Brax's observation dictionary that the policy sees.
POLICY_OBSERVATION = "state"

Activation = Literal["swish", "elu", "tanh", "relu"]


class PolicyError(UserError):
    """A policy that cannot be loaded or exported."""


@dataclasses.dataclass(frozen=True)
class PolicyCard:
    """What a reader needs to run a policy and to judge it."""

    stage: str  # "imitation" or "relaxed"
    observation_layout: tuple[tuple[str, int], ...]  # (name, size) in the order of the observation vector
    action_size: int
    activation: Activation
    hidden_layer_sizes: tuple[int, ...]
    env: EnvConfig  # the environment it was trained in, gains and meaning of the action included
    reference: str  # the reference motion it was trained on: collocation, kinematic or none
    physics_steps: int  # 1 ms steps of one robot, all robots together
    seed: int
    versions: dict[str, str]  # of bp2_rl, jax, mujoco and brax
    config_hash: str  # of the whole training config
    results: dict[str, Any]  # what was measured of it, by name
    created: str  # UTC, ISO 8601
    library_sha256: str = ""  # of the motion library it was trained on, if it was
    weights_sha256: str = ""  # of weights.npz; filled in by save_policy
    format_version: int = FORMAT_VERSION

    @property
    def observation_size(self) -> int:
        """Length of the observation vector."""
        return sum(size for _, size in self.observation_layout)


@dataclasses.dataclass(frozen=True, eq=False)
class Policy:
    """A deterministic policy: call it with an observation, or a batch of them, to get the mean action."""

    card: PolicyCard
    mean: Float[np.ndarray, " observation"]
    std: Float[np.ndarray, " observation"]
    layers: tuple[tuple[Float[np.ndarray, "_ _"], Float[np.ndarray, " _"]], ...]  # (kernel, bias)

    def __call__(self, observation: Float[Any, "*batch observation"]) -> Float[Any, "*batch action"]:
        """The action of Brax's network of the same parameters, in the array library of `observation`."""
        if observation.shape[-1] != self.card.observation_size:
            raise PolicyError(
                f"the observation has {observation.shape[-1]} numbers, but this policy reads "
                f"{self.card.observation_size}: {_show_layout(self.card.observation_layout)}"
            )
        xp = observation.__array_namespace__()
        activate = _ACTIVATIONS[self.card.activation]
        hidden = (observation.astype(xp.float32) - self.mean) / self.std
        for kernel, bias in self.layers[:-1]:
            hidden = activate(xp, hidden @ kernel + bias)
        kernel, bias = self.layers[-1]
        return hidden @ kernel + bias


# The sigmoid is written with tanh, which cannot overflow.
_ACTIVATIONS: Mapping[str, Callable[[Any, Any], Any]] = {
    "swish": lambda xp, x: x * (0.5 * (1.0 + xp.tanh(0.5 * x))),
    "elu": lambda xp, x: xp.where(x > 0, x, xp.expm1(xp.minimum(x, 0.0))),
    "tanh": lambda xp, x: xp.tanh(x),
    "relu": lambda xp, x: xp.maximum(x, 0.0),
}


def make_policy(params: Mapping[str, Any], normalizer: Any, card: PolicyCard) -> Policy:
    """The policy of Brax's training parameters.

    Args:
        params: what `brax.training.networks.make_policy_network(..., distribution_type="normal")` trains, without
            its layer norm and mean clipping: `MLP_0/hidden_i` (each one activated) and `Dense_0` (the mean).
            The exploration noise stays behind.
        normalizer: Brax's running statistics, of the observation dictionary or of the policy's part alone.
        card: says how large the network is.

    Raises:
        PolicyError: parameters and card do not describe the same network.
    """
    tree = params["params"]
    layers = [tree["MLP_0"][f"hidden_{i}"] for i in range(len(tree["MLP_0"]))] + [tree["Dense_0"]]
    mean, std = (
        statistic[POLICY_OBSERVATION] if isinstance(statistic, Mapping) else statistic
        for statistic in (normalizer.mean, normalizer.std)
    )
    policy = Policy(
        card=card,
        mean=_float32(mean),
        std=_float32(std),
        layers=tuple((_float32(layer["kernel"]), _float32(layer["bias"])) for layer in layers),
    )
    _check_shapes(policy)
    return policy


def export_policy(directory: Path, *, params: Mapping[str, Any], normalizer: Any, card: PolicyCard) -> Policy:
    """Save the policy that `make_policy` makes of Brax's parameters; raises what `make_policy` and `save_policy` do."""
    return save_policy(directory, make_policy(params, normalizer, card))


def save_policy(directory: Path, policy: Policy) -> Policy:
    """Write `policy` to `directory`, whole or not at all, and return it with its card as written.

    A policy that is already there is replaced only when the new one is complete on disk.

    Raises:
        PolicyError: weights and card disagree, a weight is not finite, or the place cannot be written.
    """
    _check_shapes(policy)
    arrays = _to_arrays(policy)
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise PolicyError(f"policy not exported to {directory}: {name} is not finite")
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # pyright: ignore[reportArgumentType]
    card = dataclasses.replace(policy.card, weights_sha256=hashlib.sha256(buffer.getvalue()).hexdigest())
    text = json.dumps(to_json(card), indent=2, allow_nan=False) + "\n"
    try:
        _replace_directory(Path(directory), {WEIGHTS: buffer.getvalue(), CARD: text.encode()})
    except OSError as error:
        raise PolicyError(f"cannot write policy {directory}: {error.strerror}") from error
    return dataclasses.replace(policy, card=card)


def load_policy(path: Path | str, *, expected_layout: Sequence[tuple[str, int]] | None = None) -> Policy:
    """Load an exported policy, or a run's.

    Args:
        path: a policy directory (it holds card.json), or a run directory (it holds policy/).
        expected_layout: the observation's (name, size) pairs that the caller will feed; None takes any.

    Raises:
        PolicyError: one line that says what is wrong with the policy and, where we know, how to mend it.
    """
    directory = _find(Path(path))
    card, expected_hash = _read_card(directory)
    if card.library_sha256 and card.library_sha256 != card.env.library.sha256:
        raise PolicyError(
            f"policy {directory} was trained on another motion library: checksum {card.library_sha256[:12]}, that of "
            f"{card.env.library.path or 'the one that ships'} is {card.env.library.sha256[:12]}"
        )
    if expected_layout is not None:
        _check_layout(card, expected_layout, directory)
    arrays = _read_weights(directory / WEIGHTS, expected_hash)
    try:
        count = len(card.hidden_layer_sizes) + 1
        policy = Policy(
            card=card,
            mean=arrays["mean"],
            std=arrays["std"],
            layers=tuple((arrays[f"layer_{i}/kernel"], arrays[f"layer_{i}/bias"]) for i in range(count)),
        )
        _check_shapes(policy)
    except KeyError as error:
        raise PolicyError(
            f"{directory / WEIGHTS} holds no array {error}: not the weights of {CARD} beside it"
        ) from error
    except PolicyError as error:
        raise PolicyError(f"{directory / WEIGHTS}: {error}") from error
    return policy


# --- Reading --------------------------------------------------------------------------------------------------
def _find(path: Path) -> Path:
    for directory in (path, path / "policy"):
        if (directory / CARD).is_file():
            return directory
    if not path.exists():
        raise PolicyError(f"no policy at {path}: there is no such file or folder")
    if path.is_file():
        raise PolicyError(f"{path} is a file; name the policy's folder, which holds {CARD} and {WEIGHTS}")
    if (path / "checkpoints").is_dir():
        raise PolicyError(f"run {path} has exported no policy yet: train it to its first evaluation")
    raise PolicyError(f"no policy in {path}: expected {CARD} and {WEIGHTS} there or in its folder policy")


def _read_card(directory: Path) -> tuple[PolicyCard, str]:
    path = directory / CARD
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise PolicyError(f"cannot read {path}: {error.strerror}") from error
    except ValueError as error:
        raise PolicyError(f"{path} is damaged or not a policy card: {error}") from error
    version = data.get("format_version") if isinstance(data, dict) else None
    if type(version) is not int:
        raise PolicyError(f"{path} is not a BP2 policy card: it has no format_version")
    if version > FORMAT_VERSION:
        raise PolicyError(
            f"{path} has policy format {version}; this bp2_rl reads up to {FORMAT_VERSION}: update bp2_rl"
        )
    try:
        card = from_json(PolicyCard, upgrade(data))
    except ConfigError as error:
        versions = data.get("versions")
        author = versions.get("bp2_rl", "unknown") if isinstance(versions, dict) else "unknown"
        raise PolicyError(f"{path} (exported by bp2_rl {author}): {error}") from error
    return card, card.weights_sha256


def _read_weights(path: Path, expected_hash: str) -> dict[str, np.ndarray]:
    try:
        content = path.read_bytes()
    except FileNotFoundError as error:
        raise PolicyError(f"{path} is missing: the policy was copied without its weights") from error
    except OSError as error:
        raise PolicyError(f"cannot read {path}: {error.strerror}") from error
    if hashlib.sha256(content).hexdigest() != expected_hash:
        raise PolicyError(f"{path} is truncated, damaged or from another policy: its checksum differs from {CARD}'s")
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except (ValueError, OSError, EOFError, zipfile.BadZipFile, AttributeError) as error:
        raise PolicyError(f"{path} is not an .npz archive of plain arrays") from error
    for name, array in arrays.items():
        if array.dtype != np.float32:
            raise PolicyError(f"{path}: {name} is {array.dtype}, expected float32")
    return arrays


def _check_layout(card: PolicyCard, expected: Sequence[tuple[str, int]], directory: Path) -> None:
    theirs, ours = list(card.observation_layout), [(name, size) for name, size in expected]
    if theirs == ours:
        return
    first = next((i for i, pair in enumerate(zip(theirs, ours, strict=False)) if pair[0] != pair[1]), None)
    first = min(len(theirs), len(ours)) if first is None else first
    raise PolicyError(
        f"policy {directory} was trained on other observations: entry {first} is {_show_entry(theirs, first)} "
        f"there and {_show_entry(ours, first)} here; use the bp2_rl that trained it "
        f"({card.versions.get('bp2_rl', 'version unknown')})"
    )


def _check_shapes(policy: Policy) -> None:
    """Raise unless the arrays have the shapes that the card promises."""
    card = policy.card
    sizes = (card.observation_size, *card.hidden_layer_sizes, card.action_size)
    expected = {"mean": sizes[:1], "std": sizes[:1]}
    for i, fans in enumerate(itertools.pairwise(sizes)):
        expected |= {f"layer_{i}/kernel": fans, f"layer_{i}/bias": fans[1:]}
    arrays = _to_arrays(policy)
    if len(policy.layers) != len(sizes) - 1:
        raise PolicyError(f"the network has {len(policy.layers)} layers, its card says {len(sizes) - 1}")
    for name, shape in expected.items():
        if arrays[name].shape != shape:
            raise PolicyError(f"{name} has shape {arrays[name].shape}, its card says {shape}")


# --- Writing --------------------------------------------------------------------------------------------------
def _to_arrays(policy: Policy) -> dict[str, np.ndarray]:
    arrays = {"mean": policy.mean, "std": policy.std}
    for i, (kernel, bias) in enumerate(policy.layers):
        arrays |= {f"layer_{i}/kernel": kernel, f"layer_{i}/bias": bias}
    return arrays


def _replace_directory(directory: Path, files: Mapping[str, bytes]) -> None:
    """Put a folder of `files` where `directory` is, in two renames: a kill leaves the old one, aside at worst."""
    directory = directory.resolve()
    if directory.exists() and any(entry.name not in files for entry in directory.iterdir()):
        raise FileExistsError(0, "the folder holds files that are no policy's; choose another")
    directory.parent.mkdir(parents=True, exist_ok=True)
    fresh, old = (directory.with_name(f".{directory.name}.{suffix}") for suffix in ("new", "old"))
    if old.exists() and not directory.exists():
        old.rename(directory)  # killed between the two renames below
    for leftover in (fresh, old):
        shutil.rmtree(leftover, ignore_errors=True)
    fresh.mkdir()
    for name, content in files.items():
        with (fresh / name).open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
    if directory.exists():
        directory.rename(old)
    fresh.rename(directory)
    shutil.rmtree(old, ignore_errors=True)


def _float32(array: Any) -> np.ndarray:
    return np.array(array, dtype=np.float32)


def _show_layout(layout: Sequence[tuple[str, int]]) -> str:
    return ", ".join(f"{name} {size}" for name, size in layout)


def _show_entry(layout: Sequence[tuple[str, int]], index: int) -> str:
    return f"{layout[index][0]!r} of size {layout[index][1]}" if index < len(layout) else "absent"
