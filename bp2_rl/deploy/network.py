"""Convert a policy's network to ONNX, checked in onnxruntime, and to records for C++."""

from typing import TYPE_CHECKING

import numpy as np

from bp2_rl.base.errors import not_installed
from bp2_rl.deploy.onboard.binary import record
from bp2_rl.learning.policy import Policy

if TYPE_CHECKING:
    from onnx import NodeProto, ValueInfoProto

INPUT, OUTPUT = "obs", "actions"
OPSET, IR_VERSION = 17, 8
"""Versions of ONNX's operators and file format, which onnxruntime 1.12 and later
read."""
ACTIVATIONS = {"elu": "Elu", "tanh": "Tanh", "relu": "Relu"}
SAMPLES, CLOSE = 256, 1e-5
"""Number of random observations to compare on, and the largest relative error that
float32 rounding may cause."""


def to_onnx(policy: Policy) -> bytes:
    """Return a policy's network as an ONNX model: `obs` (batch, n) -> `actions` (batch,
    12).

    Numbers are float32, and actions are not clipped.

    Raises:
        UserError: the package onnx or onnxruntime is missing.
    """
    try:
        import onnxruntime  # noqa: F401
        from onnx import TensorProto, checker, helper, numpy_helper
    except ModuleNotFoundError as error:
        raise not_installed("--format onnx", str(error.name), "deploy") from error

    def values(name: str, size: int) -> "ValueInfoProto":
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", size])

    card = policy.card
    nodes = [
        helper.make_node("Sub", [INPUT, "mean"], ["centred"]),
        helper.make_node("Div", ["centred", "std"], ["hidden_0"]),
    ]
    for i in range(len(policy.layers)):
        if i > 0:
            nodes += _activate(card.activation, f"sum_{i - 1}", f"hidden_{i}")
        read = [f"hidden_{i}", f"weight_{i}", f"bias_{i}"]
        nodes.append(helper.make_node("Gemm", read, [f"sum_{i}"]))
    nodes[-1].output[0] = OUTPUT
    graph = helper.make_graph(
        nodes,
        "bp2_policy",
        [values(INPUT, card.observation_size)],
        [values(OUTPUT, card.action_size)],
        [
            numpy_helper.from_array(array, name)
            for name, array in _arrays(policy).items()
        ],
    )
    model = helper.make_model(
        graph,
        producer_name="bp2_rl",
        ir_version=IR_VERSION,
        opset_imports=[helper.make_opsetid("", OPSET)],
    )
    checker.check_model(model, full_check=True)
    content = model.SerializeToString()
    _compare(policy, content)
    return content


def to_records(policy: Policy) -> bytes:
    """Return a policy's network as records of the controller's file for C++."""
    values = {"activation": policy.card.activation, **_arrays(policy)}
    most = float(np.finfo(np.float32).max)
    return b"".join(
        record(f"network.{name}", value, (-most, most))
        for name, value in values.items()
    )


def _arrays(policy: Policy) -> dict[str, np.ndarray]:
    """Return the arrays of a policy's network by name, float32."""
    arrays = {"mean": policy.mean, "std": policy.std}
    for i, (weight, bias) in enumerate(policy.layers):
        arrays |= {f"weight_{i}": weight, f"bias_{i}": bias}
    return {name: np.asarray(array, np.float32) for name, array in arrays.items()}


def _activate(name: str, before: str, after: str) -> "list[NodeProto]":
    """Return the ONNX nodes of an activation function from value `before` to value
    `after`."""
    from onnx import helper

    if name == "swish":
        gate = f"{before}_gate"
        return [
            helper.make_node("Sigmoid", [before], [gate]),
            helper.make_node("Mul", [before, gate], [after]),
        ]
    return [helper.make_node(ACTIVATIONS[name], [before], [after])]


def _compare(policy: Policy, content: bytes) -> None:
    """Raise RuntimeError unless onnxruntime and the policy agree, up to rounding, on
    random observations."""
    import onnxruntime

    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    drawn = np.random.default_rng(0).normal(
        size=(SAMPLES, policy.card.observation_size)
    )
    observation = (policy.mean + 2.0 * policy.std * drawn).astype(np.float32)
    (found,) = session.run([OUTPUT], {INPUT: observation})
    expected = policy(observation)
    error = float(
        np.max(np.abs(np.asarray(found) - expected) / (1.0 + np.abs(expected)))
    )
    if not error <= CLOSE:
        raise RuntimeError(
            f"onnxruntime {onnxruntime.__version__} is off by {error:.1e} from the policy"
        )
