"""A trained policy as data: two files that anyone can read, and the function that they
describe.

    POLICY/weights.npz   the observation's mean and standard deviation, and each layer's weight and bias
    POLICY/card.json     what the numbers mean: observation layout, action, environment, versions, results

    action = MLP((observation - mean) / std)        deterministic; float32; NumPy or JAX arrays

No pickles: a policy from a stranger is safe to load, and one from another project is
refused by name.
"""

import dataclasses
import functools
import hashlib
import itertools
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from bp2_rl.base import arrays
from bp2_rl.base.assets import asset_path
from bp2_rl.base.errors import UserError, did_you_mean, require_kind
from bp2_rl.base.files import (
    ArraySpec,
    BadFileError,
    read_bytes,
    read_npz,
    require_name,
    write_npz,
)
from bp2_rl.base.folders import find_folder, new_folder
from bp2_rl.base.serialization import load_sealed, save_sealed
from bp2_rl.learning.judged import own_policy, results_of_judge
from bp2_rl.settings.env import EnvConfig
from bp2_rl.settings.ppo import Activation
from bp2_rl.settings.task import Task, TaskSources, read_task
from bp2_rl.settings.training import Stage

FORMAT_VERSION = 1
SHIPPED = ("built", "gentle", "fastest", "ideal", "rough")
"""Names of the shipped policies."""
WEIGHTS = "weights.npz"
CARD = "card.json"
CHECKSUM = "card_sha256"
"""Key in card.json for the checksum of all other entries."""
LARGEST_WEIGHTS = 256 << 20
"""Bytes of the largest weights.npz that is read: a hundred times our own."""
MOST_LAYERS = 100
LARGEST_OBSERVATION = 1e3
"""Largest number in an observation (SI units); up to it no action may overflow."""
# The policy's entry in Brax's observation dictionary.
POLICY_OBSERVATION = "state"


class PolicyError(UserError):
    """Raised for a policy that cannot be loaded or exported."""


@dataclasses.dataclass(frozen=True)
class PolicyCard:
    """The card of a policy: everything that is needed to run the policy and to compare
    it."""

    stage: Stage
    # (name, size) in the order of the observation vector
    observation_layout: tuple[tuple[str, int], ...]
    action_size: int
    activation: Activation
    hidden_layer_sizes: tuple[int, ...]
    # the environment it was trained in, gains and meaning of the action included
    env: EnvConfig
    # the reference motion it was trained on: collocation, kinematic or none
    reference: str
    physics_steps: int  # physics steps of 1 ms, summed over all robots
    seed: int
    versions: dict[str, str]  # of bp2_rl, jax, mujoco and brax
    config_hash: str  # of the whole training config
    results: dict[str, Any]  # measured results, by name
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
    """A deterministic policy, called with observations to get mean actions."""

    card: PolicyCard
    mean: Float[np.ndarray, " observation"]
    std: Float[np.ndarray, " observation"]
    # (weight, bias)
    layers: tuple[tuple[Float[np.ndarray, "_ _"], Float[np.ndarray, " _"]], ...]

    def __repr__(self) -> str:
        """Name the policy's stage, robot, training and seed."""
        card = self.card
        robot = card.env.hardware.anatomy.name
        return f"Policy({card.stage}, {robot}, {card.physics_steps / 1e6:.3g} M physics steps, seed {card.seed})"

    def __call__(
        self, observation: Float[arrays.Array, "*batch observation"]
    ) -> Float[arrays.Array, "*batch action"]:
        """Return the mean actions for observations, as Brax's network does, in the
        array library of `observation`."""
        if observation.shape[-1] != self.card.observation_size:
            layout = self.card.observation_layout
            raise PolicyError(
                f"the observation has {observation.shape[-1]} numbers, but this policy reads "
                f"{self.card.observation_size}: {', '.join(f'{name} {size}' for name, size in layout)}"
            )
        return NETWORKS[self.card.activation](*self.weights, observation)

    @property
    def weights(
        self,
    ) -> tuple[np.ndarray, np.ndarray, tuple[tuple[np.ndarray, np.ndarray], ...]]:
        """All numbers of the network: the observation's mean and standard deviation,
        and the layers."""
        return self.mean, self.std, self.layers


def _network(
    activate: Callable[[Any, arrays.Array], arrays.Array],
    mean: arrays.Array,
    std: arrays.Array,
    layers: Sequence[tuple[arrays.Array, arrays.Array]],
    observation: Float[arrays.Array, "*batch observation"],
) -> Float[arrays.Array, "*batch action"]:
    xp = observation.__array_namespace__()
    hidden = (observation.astype(xp.float32) - mean) / std
    for weight, bias in layers[:-1]:
        hidden = activate(xp, hidden @ weight + bias)
    weight, bias = layers[-1]
    return hidden @ weight + bias


NETWORKS = {
    name: functools.partial(_network, activate)
    for name, activate in {
        # the sigmoid by tanh, which cannot overflow
        "swish": lambda xp, x: x * (0.5 * (1.0 + xp.tanh(0.5 * x))),
        "elu": lambda xp, x: xp.where(x > 0, x, xp.expm1(xp.minimum(x, 0.0))),
        "tanh": lambda xp, x: xp.tanh(x),
        "relu": lambda xp, x: xp.maximum(x, 0.0),
    }.items()
}
"""Functions (mean, std, layers, observation) -> action, by the hidden layers'
activation."""


def make_policy(
    layers: Sequence[tuple[object, object]], normalizer: Any, card: PolicyCard
) -> Policy:
    """Return the policy of a trained network.

    Args:
        layers: (weight, bias) of each, all but the last activated, as
            `networks.dense_layers` gives them.
        normalizer: Brax's running statistics, of the observation dictionary or of the
            policy's part alone.
        card: says how large the network is.

    Raises:
        PolicyError: layers and card do not describe the same network.
    """
    mean, std = (
        statistic[POLICY_OBSERVATION] if isinstance(statistic, Mapping) else statistic
        for statistic in (normalizer.mean, normalizer.std)
    )
    pairs = tuple((_float32(weight), _float32(bias)) for weight, bias in layers)
    policy = Policy(card, _float32(mean), _float32(std), pairs)
    _check_shapes(policy)
    return policy


def blank_policy(card: PolicyCard) -> Policy:
    """Return a policy of this card all of whose actions are zero."""
    arrays = {
        name: np.zeros(shape, np.float32)
        for name, shape in _expected_shapes(card).items()
    }
    return _from_arrays(card, {**arrays, "std": arrays["std"] + np.float32(1.0)})


def save_policy(directory: Path, policy: Policy) -> Policy:
    """Write `policy` to `directory`, whole or not at all, and return it with its card
    as written.

    A policy that is already there is replaced only when the new one is complete on
    disk.

    Raises:
        PolicyError: weights and card disagree, a weight is not finite, or the place
            cannot be written.
    """
    require_name(directory)
    _check_shapes(policy)
    _check_numbers(policy, f"policy not exported to {directory}")
    try:
        # a link is replaced, and what it leads to left alone
        place = Path(os.path.abspath(directory))
        if place.is_file():
            raise FileExistsError(
                0, "it is a file, not a folder; choose another folder"
            )
        if place.exists() and any(
            entry.name not in (WEIGHTS, CARD) for entry in place.iterdir()
        ):
            raise FileExistsError(
                0, "the folder holds files that are no policy's; choose another"
            )
        with new_folder(place) as fresh:
            write_npz(fresh / WEIGHTS, _to_arrays(policy))
            digest = hashlib.sha256((fresh / WEIGHTS).read_bytes()).hexdigest()
            card = dataclasses.replace(policy.card, weights_sha256=digest)
            save_sealed(fresh / CARD, card, CHECKSUM)
    except OSError as error:
        raise PolicyError(
            f"cannot write policy {directory}: {error.strerror or error}"
        ) from error
    return dataclasses.replace(policy, card=card)


def load_policy(
    path: Path | str,
    *,
    layout_of: Callable[[EnvConfig], Sequence[tuple[str, int]]] | None = None,
    task: Path | str | TaskSources | Task | None = None,
) -> Policy:
    """Load an exported policy, or a run's.

    Args:
        path: a policy directory (it holds card.json), a run directory (`own_policy`
            says which of its policies is meant), or the name of a shipped policy, such
            as `built`.
        layout_of: the observation's (name, size) pairs that the caller will feed in an
            environment; None takes any.
        task: the task that the policy was trained with, as `preset` takes it, whose
            code computes terms of the observation. Without it no code of a policy's
            task is run.

    Raises:
        PolicyError: one line that says what is wrong with the policy and, where we
            know, how to correct it.
    """
    directory = find_policy(path)
    card = _read_card(directory)
    results = card.results | results_of_judge(directory)
    card = dataclasses.replace(card, results=results)
    if card.library_sha256 and card.library_sha256 != card.env.library.sha256:
        raise PolicyError(
            f"policy {directory} was trained on another motion library: checksum {card.library_sha256[:12]}, that of "
            f"{card.env.library.path or 'the one that ships'} is {card.env.library.sha256[:12]}"
        )
    if layout_of is not None:
        _check_layout(card, layout_of(card.env), directory)
    if task is not None:
        card = dataclasses.replace(card, env=_with_code(card.env, task))
    arrays = _read_weights(directory / WEIGHTS, card)
    policy = _from_arrays(card, arrays)
    _check_numbers(policy, f"{directory / WEIGHTS}")
    return policy


# --- Reading --------------------------------------------------------------------------
def find_policy(path: Path | str) -> Path:
    """Return the directory of a policy, which `path` names as for `load_policy`.

    Raises:
        PolicyError: there is none.
    """
    require_kind(
        "load_policy",
        path,
        (str, Path),
        f"a folder or a policy's name ({', '.join(SHIPPED)})",
    )
    path = (
        asset_path(f"policies/{path}")
        if str(path) in SHIPPED and not Path(path).exists()
        else Path(path)
    )
    require_name(path)
    directory: Path | None = find_folder(path)
    if not (directory / CARD).is_file():
        directory = own_policy(path)
    if directory is not None and (directory / CARD).is_file():
        return directory
    if not path.exists():
        near = did_you_mean(str(path), SHIPPED)
        raise PolicyError(
            f"no policy at {path}: there is no such file or folder; {', '.join(SHIPPED)} ship{near}"
        )
    if path.is_file():
        raise PolicyError(
            f"{path} is a file; name the policy's folder, which holds {CARD} and {WEIGHTS}"
        )
    if (path / "checkpoints").is_dir():
        raise PolicyError(
            f"run {path} has exported no policy yet: train it to its first save"
        )
    raise PolicyError(
        f"no policy in {path}: expected {CARD} and {WEIGHTS} there, or a run's policies"
    )


def _with_code(env: EnvConfig, task: Path | str | TaskSources | Task) -> EnvConfig:
    """Return a policy's environment with the code of its task."""
    code = read_task(task) if isinstance(task, str | Path) else task
    return dataclasses.replace(env, task=env.task.with_code(code))


def _read_card(directory: Path) -> PolicyCard:
    try:
        card = load_sealed(PolicyCard, directory / CARD, CHECKSUM, FORMAT_VERSION)
    except UserError as error:
        raise PolicyError(str(error)) from error
    if len(card.hidden_layer_sizes) > MOST_LAYERS:
        raise PolicyError(
            f"{directory / CARD} has over {MOST_LAYERS} layers, more than any policy of bp2_rl"
        )
    return card


def _read_weights(path: Path, card: PolicyCard) -> dict[str, np.ndarray]:
    """Read only the arrays that a policy's card describes."""
    if not path.exists():
        raise PolicyError(
            f"{path} is missing: the policy was copied without its weights"
        )
    try:
        content = read_bytes(path, LARGEST_WEIGHTS)
        if hashlib.sha256(content).hexdigest() != card.weights_sha256:
            raise PolicyError(
                f"{path} is truncated, damaged or from another policy: its checksum differs from {CARD}'s"
            )
        specs = {
            name: ArraySpec(np.dtype(np.float32), shape)
            for name, shape in _expected_shapes(card).items()
        }
        return read_npz(path, specs, content=content, largest=LARGEST_WEIGHTS)
    except BadFileError as error:
        raise PolicyError(f"{error}: not the weights of {CARD} beside it") from error


def _check_layout(
    card: PolicyCard, expected: Sequence[tuple[str, int]], directory: Path
) -> None:
    pairs = itertools.zip_longest(card.observation_layout, expected)
    for i, (theirs, ours) in enumerate(pairs):
        if theirs != ours:
            raise PolicyError(
                f"policy {directory} was trained on other observations: term {i} is {_show_term(theirs)} there and "
                f"{_show_term(ours)} here; use the bp2_rl that trained it "
                f"({card.versions.get('bp2_rl', 'version unknown')})"
            )


def _expected_shapes(card: PolicyCard) -> dict[str, tuple[int, ...]]:
    """Return the shape of every array of a policy with this card."""
    sizes = (card.observation_size, *card.hidden_layer_sizes, card.action_size)
    shapes: dict[str, tuple[int, ...]] = {"mean": sizes[:1], "std": sizes[:1]}
    for i, fans in enumerate(itertools.pairwise(sizes)):
        shapes |= {f"layer_{i}/weight": fans, f"layer_{i}/bias": fans[1:]}
    return shapes


def _check_shapes(policy: Policy) -> None:
    """Raise `PolicyError` unless the arrays have the shapes that the card promises."""
    count = len(policy.card.hidden_layer_sizes) + 1
    if len(policy.layers) != count:
        raise PolicyError(
            f"the network has {len(policy.layers)} layers, its card says {count}"
        )
    arrays = _to_arrays(policy)
    for name, shape in _expected_shapes(policy.card).items():
        if arrays[name].shape != shape:
            raise PolicyError(
                f"{name} has shape {arrays[name].shape}, its card says {shape}"
            )


def _check_numbers(policy: Policy, where: str) -> None:
    """Raise `PolicyError` if the weights are such that an action may not be finite;
    `where` begins the message."""
    for name, array in _to_arrays(policy).items():
        if not np.isfinite(array).all():
            raise PolicyError(f"{where}: {name} is not finite")
    if not (policy.std > 0.0).all():
        raise PolicyError(f"{where}: std is not positive")
    # No sum of products can be larger than that of the absolute values; no activation
    # adds to |x| beyond 1.
    largest = float(np.finfo(np.float32).max)
    bound = (LARGEST_OBSERVATION + np.abs(policy.mean.astype(float))) / policy.std
    if not (bound < largest).all():
        raise PolicyError(f"{where}: std is so small that an observation may overflow")
    for i, (weight, bias) in enumerate(policy.layers):
        bound = np.maximum(bound, 1.0) @ np.abs(weight.astype(float)) + np.abs(bias)
        if not (bound < largest).all():
            raise PolicyError(
                f"{where}: layer_{i}/weight is so large that an action may overflow"
            )


def _from_arrays(card: PolicyCard, arrays: Mapping[str, np.ndarray]) -> Policy:
    count = len(card.hidden_layer_sizes) + 1
    layers = tuple(
        (arrays[f"layer_{i}/weight"], arrays[f"layer_{i}/bias"]) for i in range(count)
    )
    return Policy(card, arrays["mean"], arrays["std"], layers)


# --- Writing --------------------------------------------------------------------------
def _to_arrays(policy: Policy) -> dict[str, np.ndarray]:
    arrays = {"mean": policy.mean, "std": policy.std}
    for i, (weight, bias) in enumerate(policy.layers):
        arrays |= {f"layer_{i}/weight": weight, f"layer_{i}/bias": bias}
    return arrays


def _float32(array: object) -> np.ndarray:
    return np.array(array, dtype=np.float32)


def _show_term(term: tuple[str, int] | None) -> str:
    return "absent" if term is None else f"{term[0]!r} of size {term[1]}"
