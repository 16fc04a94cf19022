"""A function over legs and robots as one GPU kernel by Mosaic GPU, which follows Triton
in JAX's Pallas.

A block of threads has a warp for each leg and a lane for each robot: a sum over the
legs is a sum over four warps. Mosaic GPU broadcasts an array only into a layout that is
named, and does not know `floor`. So JAX traces the function, and its operations are
issued one by one.
"""

import importlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
from jax.extend import core
from jax.typing import ArrayLike
from jaxtyping import Array

T = TypeVar("T")
Ref: TypeAlias = (
    Any  # an array in the GPU's memory, for which Pallas has no public type
)
LEGS, LANES = 4, 32
ELEMENTWISE = frozenset(
    {
        "abs",
        "add",
        "and",
        "convert_element_type",
        "cos",
        "div",
        "eq",
        "ge",
        "gt",
        "integer_pow",
        "le",
        "lt",
        "max",
        "min",
        "mul",
        "ne",
        "neg",
        "or",
        "rsqrt",
        "select_n",
        "sin",
        "sqrt",
        "square",
        "sub",
    }
)
"""Operations on arrays of one shape, element by element."""


def mosaic(function: Callable[..., T], *inputs: Any) -> T:
    """Compute function(*inputs) in one Pallas kernel for Mosaic GPU, from JAX 0.11 on.

    Args:
        function: as `fusion_barriers.in_one_kernel` takes it. It may sum over the four
            legs, compute element by element, call and loop.
        inputs: its arguments.

    Raises:
        NotImplementedError: the function has another operation.
    """
    from jax.experimental import pallas

    mosaic_gpu: Any = importlib.import_module("jax.experimental.pallas.mosaic_gpu")
    leaves, structure, robots = flat_inputs(inputs)
    blocks = -(-robots // LANES)
    whole = blocks * LANES
    leaves = [_padded(leaf, robots, whole) for leaf in leaves]
    traced, shapes = traced_flat(function, structure, leaves)
    shapes, results = jax.tree.flatten(shapes)
    written = [
        jax.ShapeDtypeStruct(
            (LEGS, whole) if x.shape == (LEGS, 1) else x.shape or (1,), x.dtype
        )
        for x in shapes
    ]
    layouts, of_legs = _layouts(mosaic_gpu)

    def cast(x: Array) -> Array:
        return mosaic_gpu.layout_cast(x, layouts[x.ndim])

    def part(ref: Ref) -> Ref:
        """Return a block's part of an array."""
        here = pallas.ds(jax.lax.axis_index("block") * LANES, LANES)
        return ref.at[here] if len(ref.shape) == 1 else ref.at[:, here]

    def load(ref: Ref) -> Array:
        if ref.shape == (1,):
            return ref[0]
        if ref.shape == (LEGS, 1):
            each = mosaic_gpu.load(ref.at[:, 0], layout=of_legs, optimized=False)
            return cast(jax.lax.broadcast_in_dim(each, (LEGS, LANES), (0,)))
        layout = layouts[len(ref.shape)]
        return mosaic_gpu.load(part(ref), layout=layout, optimized=False)

    def kernel(*refs: Ref) -> None:
        given = [load(ref) for ref in refs[: len(leaves)]]
        found = BlockEvaluation(LANES, cast).results(traced, given)
        for ref, x in zip(refs[len(leaves) :], found, strict=True):
            if ref.shape == (1,):
                ref[0] = x
            else:
                part(ref)[...] = x

    run = mosaic_gpu.kernel(
        kernel,
        out_type=written,
        grid=(blocks,),
        grid_names=("block",),
        compiler_params=mosaic_gpu.CompilerParams(
            lowering_semantics=mosaic_gpu.LoweringSemantics.Lane,
            unsafe_no_auto_barriers=True,  # no memory is both read and written
        ),
    )
    found = [
        x[..., : min(robots, *shape.shape[-1:])]
        for x, shape in zip(run(*leaves), shapes, strict=True)
    ]
    return jax.tree.unflatten(results, found)


def flat_inputs(inputs: tuple[object, ...]) -> tuple[list[Array], Any, int]:
    """Return the inputs' leaves, each with an axis, their tree's structure, and the
    number of robots."""
    leaves, structure = jax.tree.flatten(jax.tree.map(jnp.atleast_1d, inputs))
    return leaves, structure, max(leaf.shape[-1] for leaf in leaves)


def traced_flat(
    function: Callable[..., T], structure: Any, leaves: list[Array]
) -> tuple[core.Jaxpr, Any]:
    """Return the jaxpr of a function of the leaves of its arguments, and the shapes of
    its results."""
    closed, shapes = jax.make_jaxpr(
        lambda *leaves: function(*jax.tree.unflatten(structure, leaves)),
        return_shape=True,
    )(*leaves)
    return closed.jaxpr, shapes


class BlockEvaluation:
    """Evaluates jaxprs for a number of robots, which they need not be traced for.

    A value is an array (4, robots) or (robots,). It is () where the jaxpr has 1, or
    may be so where all elements are equal.

    Args:
        robots: their number.
        cast: gives an array that was broadcast its layout.
    """

    def __init__(self, robots: int, cast: Callable[[Array], Array] = lambda x: x):
        self.robots, self.cast = robots, cast

    def results(
        self, program: core.Jaxpr, inputs: Sequence[ArrayLike]
    ) -> list[ArrayLike]:
        """Return a jaxpr's results, in the shapes that it gives them but for (4, 1),
        which is (4, robots)."""
        values = dict(zip(program.invars, inputs, strict=True))

        def read(variable: core.Var | core.Literal) -> ArrayLike:
            literal = isinstance(variable, core.Literal)
            return variable.val if literal else values[variable]

        for equation in program.eqns:
            found = self._computed(equation, [read(x) for x in equation.invars])
            values.update(zip(equation.outvars, found, strict=True))
        return [self._like(variable, read(variable)) for variable in program.outvars]

    def _computed(
        self, equation: core.JaxprEqn, given: list[ArrayLike]
    ) -> list[ArrayLike]:
        name, parameters = equation.primitive.name, equation.params
        if name in ELEMENTWISE:
            axes = max(jnp.ndim(x) for x in given)
            given = [self._spread(x, axes) for x in given]
            return [equation.primitive.bind(*given, **parameters)]
        if name == "floor":
            nearest = jnp.round(given[0])
            return [jax.lax.select(nearest > given[0], nearest - 1.0, nearest)]
        if name == "reduce_sum" and parameters["axes"] == (0,):
            return [jnp.sum(self._spread(given[0], 2), axis=0)]
        if name == "broadcast_in_dim" and _adds_first_axes(parameters):
            return given
        if name == "jit":
            return self.results(parameters["jaxpr"].jaxpr, given)
        if name == "scan" and _only_carries(equation):
            return self._looped(equation, given)
        raise NotImplementedError(f"{name} in a kernel over legs and robots")

    def _looped(
        self, equation: core.JaxprEqn, given: list[ArrayLike]
    ) -> list[ArrayLike]:
        body, times = equation.params["jaxpr"].jaxpr, equation.params["length"]
        constants = len(given) - len(equation.outvars)
        kept, first = given[:constants], given[constants:]
        start = [
            self._like(*pair) for pair in zip(equation.outvars, first, strict=True)
        ]
        return jax.lax.fori_loop(
            0, times, lambda _, state: self.results(body, [*kept, *state]), start
        )

    def _like(self, variable: Any, x: ArrayLike) -> ArrayLike:
        shape = variable.aval.shape
        if shape in ((), (1,)):
            return x
        return self._spread(x, 2 if len(shape) == 2 and shape[0] == LEGS else 1)

    def _spread(self, x: ArrayLike, axes: int) -> ArrayLike:
        """Return a value as an array with these axes: the robots' or, of two, the legs'
        too."""
        has = jnp.ndim(x)
        if has == axes:
            return x
        shape = (LEGS, self.robots)[2 - axes :]
        last = tuple(range(axes - has, axes))
        return self.cast(jax.lax.broadcast_in_dim(x, shape, last))


def _only_carries(scan: core.JaxprEqn) -> bool:
    """Return whether a loop takes nothing from arrays step by step, and stacks nothing:
    inside it, then, everything has the shape that it has outside."""
    body = scan.params["jaxpr"]
    outside = [variable.aval for variable in (*scan.invars, *scan.outvars)]
    return outside == [*body.in_avals, *body.out_avals]


def _adds_first_axes(parameters: Mapping[str, Any]) -> bool:
    axes, given = len(parameters["shape"]), parameters["broadcast_dimensions"]
    return given == tuple(range(axes - len(given), axes))


def _layouts(mosaic_gpu: Any) -> tuple[dict[int, Any], Any]:
    """Return the layouts of arrays over robots and over legs and robots, by the number
    of their axes, and the layout of an array over legs."""
    layout, tiling = mosaic_gpu.Layout.TILED, mosaic_gpu.Tiling
    legs, lanes = mosaic_gpu.Replicated(LEGS), mosaic_gpu.Replicated(LANES)
    layouts = {
        1: layout(tiling(((LANES,), (1,))), (legs,), (-2,), -1),
        2: layout(tiling(((LEGS, LANES), (1,))), (-3,), (-2,), -1),
    }
    return layouts, layout(tiling(((LEGS,), (1,))), (-2,), (lanes,), -1)


def _padded(x: Array, robots: int, whole: int) -> Array:
    """Repeat the last robot up to a whole number of blocks, in what differs between
    robots."""
    if x.shape[-1] != robots:
        return x
    return jnp.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, whole - robots)], mode="edge")
