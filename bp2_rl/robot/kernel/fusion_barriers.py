"""Where XLA compiles the physics step in parts: fusion barriers between them on CPUs,
one kernel each on GPUs.

XLA fuses operations into one loop where it can, and computes whatever is cheap anew in
each loop that needs it. It does not see how much that is in long chains of products and
sums: on a CPU the step took twice as long as without fusion. A fusion barrier is a
conditional whose condition always holds, which XLA cannot know: it does not fuse what
is inside a conditional with what is outside. On GPUs the step is divided into a few
kernels of Pallas instead, by Mosaic GPU or by Triton.
"""

import importlib
import importlib.util
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from bp2_rl.robot.kernel.mosaic import flat_inputs, mosaic

T = TypeVar("T")
BLOCK, WARPS = 32, 4
"""Robots in a block of Triton's threads on a GPU, and the block's warps: a thread for
each leg."""


class FusionBarriers(NamedTuple):
    """Computes functions behind fusion barriers: XLA does not fuse them with the rest
    of the program."""

    always: Bool[Array, ""] | None  # None: no barriers

    @classmethod
    def of(cls, friction: Any) -> "FusionBarriers":
        """Return barriers for CPUs, with the condition that the floor's friction is not
        negative; no barriers for GPUs."""
        return cls(~(friction[0] < 0.0) if jax.default_backend() == "cpu" else None)

    def __call__(self, function: Callable[..., T], *inputs: Any) -> T:
        """Return function(*inputs), computed behind a fusion barrier."""
        if self.always is None:
            return function(*inputs)
        return jax.lax.cond(self.always, function, _zeros_like(function), *inputs)


def in_one_kernel(function: Callable[..., T], *inputs: Any) -> T:
    """Return function(*inputs), computed on a GPU by one kernel, with intermediate
    values in registers.

    Of all arrays, in and out, the last axis is the robots', or 1; a first one is the
    legs'. Robots may not depend on each other. The function may close over numbers, but
    not over arrays.

    Triton's time grows faster than a kernel: all of the step as one compiles for longer
    than its parts together.
    """
    if jax.default_backend() != "gpu":
        return function(*inputs)
    return (mosaic if _has_mosaic() else _pallas)(function, *inputs)


def find_runtime() -> None:
    """Let programs that were compiled before run: those with kernels of Mosaic GPU call
    its runtime, which JAX finds once the module has been imported."""
    if jax.default_backend() == "gpu" and _has_mosaic():
        importlib.import_module("jax.experimental.pallas.mosaic_gpu")


def _has_mosaic() -> bool:
    """Return whether Mosaic GPU makes the kernels: where it has been tried, by JAX 0.11
    on GPUs of compute capability 9, or where JAX has no Triton."""
    if not importlib.util.find_spec("jax.experimental.pallas.triton"):
        return True
    found = {getattr(gpu, "compute_capability", "") for gpu in jax.devices()}
    return jax.__version_info__[:2] == (0, 11) and found == {"9.0"}


def _pallas(function: Callable[..., T], *inputs: Any, interpret: bool = False) -> T:
    """Compute function(*inputs) in one Pallas kernel for Triton, which JAX 0.11
    deprecates."""
    from jax.experimental import pallas
    from jax.experimental.pallas import triton

    leaves, structure, robots = flat_inputs(inputs)
    inputs = jax.tree.unflatten(structure, leaves)
    shapes, results = jax.tree.flatten(jax.eval_shape(function, *inputs))
    shapes = [
        jax.ShapeDtypeStruct(shape.shape or (1,), shape.dtype) for shape in shapes
    ]
    block = min(BLOCK, robots & -robots)  # the largest power of two that divides them

    def spec(array: Any) -> Any:
        *legs, last = array.shape
        axes = len(legs)
        if last == 1:
            return pallas.BlockSpec(array.shape, lambda i: (0,) * (axes + 1))
        return pallas.BlockSpec((*legs, block), lambda i: (0,) * axes + (i,))

    def kernel(*refs: Any) -> None:
        given, wanted = refs[: len(leaves)], refs[len(leaves) :]
        found = function(*jax.tree.unflatten(structure, [ref[...] for ref in given]))
        for ref, x in zip(wanted, jax.tree.leaves(found), strict=True):
            ref[...] = jnp.broadcast_to(x, ref.shape)

    run = pallas.pallas_call(
        kernel,
        out_shape=shapes,
        grid=(robots // block,),
        in_specs=[spec(leaf) for leaf in leaves],
        out_specs=[spec(shape) for shape in shapes],
        compiler_params=triton.CompilerParams(num_warps=WARPS),
        interpret=interpret,
    )
    return jax.tree.unflatten(results, run(*leaves))


def _zeros_like(function: Callable[..., T]) -> Callable[..., T]:
    def zeros(*inputs: Any) -> Any:
        return jax.tree.map(
            lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(function, *inputs)
        )

    return zeros
