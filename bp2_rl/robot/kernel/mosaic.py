"""A function over legs and robots as one GPU kernel, by Mosaic GPU: in JAX's Pallas it
follows Triton.

A block of threads has a warp for each leg and a lane for each robot, so a sum over the
legs is one over four warps. Mosaic GPU broadcasts an array only into a layout that is
named, and it lacks `floor`. So the function is traced first, and its operations are
then issued one by one.
"""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.extend import core

T = TypeVar("T")
Cast = Callable[[Any], Any]
LEGS, LANES = 4, 32
ELEMENTWISE = frozenset(
    """abs add and convert_element_type cos div eq exp ge gt integer_pow le log lt max
    min mul ne neg not or pow rem rsqrt select_n sign sin sqrt square sub tanh""".split()
)
"""Operations of which a result's element depends on the same elements of the inputs."""


def mosaic(function: Callable[..., T], *inputs: Any, block: int = LANES) -> T:
    """Compute function(*inputs) in one Pallas kernel for Mosaic GPU.

    Of all arrays, in and out, the last axis is the robots', or 1; a first one is the
    four legs'. The function may sum over the legs, and call and loop.

    Args:
        function: as `in_one_kernel` takes it.
        inputs: its arguments.
        block: robots in a block of threads, a multiple of 32.

    Raises:
        NotImplementedError: the function does something else with an axis.
    """
    from jax.experimental import pallas
    from jax.experimental.pallas import mosaic_gpu

    leaves, structure = jax.tree.flatten(inputs)
    leaves = [jnp.atleast_1d(leaf) for leaf in leaves]
    robots = max(leaf.shape[-1] for leaf in leaves)
    blocks = -(-robots // block)
    leaves = [_padded(leaf, robots, blocks * block) for leaf in leaves]
    traced, shapes = jax.make_jaxpr(
        lambda *leaves: function(*jax.tree.unflatten(structure, leaves)),
        return_shape=True,
    )(*leaves)
    shapes, results = jax.tree.flatten(shapes)
    written = [
        jax.ShapeDtypeStruct(
            (LEGS, blocks * block) if x.shape == (LEGS, 1) else x.shape or (1,), x.dtype
        )
        for x in shapes
    ]
    layouts, of_legs = _layouts(mosaic_gpu)

    def cast(x: jax.Array) -> jax.Array:
        return mosaic_gpu.layout_cast(x, layouts[x.ndim])

    def part(ref: Any) -> Any:
        """Return a block's part of an array."""
        here = pallas.ds(jax.lax.axis_index("block") * block, block)
        return ref.at[here] if len(ref.shape) == 1 else ref.at[:, here]

    def load(ref: Any) -> Any:
        if ref.shape == (1,):
            return ref[0]
        if ref.shape == (LEGS, 1):
            each = mosaic_gpu.load(ref.at[:, 0], layout=of_legs, optimized=False)
            return cast(jax.lax.broadcast_in_dim(each, (LEGS, block), (0,)))
        layout = layouts[len(ref.shape)]
        return mosaic_gpu.load(part(ref), layout=layout, optimized=False)

    def kernel(*refs: Any) -> None:
        found = evaluate(traced.jaxpr, [load(ref) for ref in refs[: len(leaves)]], cast)
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
            unsafe_no_auto_barriers=True,  # no thread reads what one has written
        ),
    )
    found = [
        x[..., : min(robots, *shape.shape[-1:])]
        for x, shape in zip(run(*leaves), shapes, strict=True)
    ]
    return jax.tree.unflatten(results, found)


def evaluate(
    program: Any, inputs: Sequence[Any], cast: Cast = lambda x: x
) -> list[Any]:
    """Return a traced function's results, of any number of robots.

    Args:
        program: a jaxpr.
        inputs: for each of its inputs (4, robots) or (robots,), or () in place of 1
            or of (1,).
        cast: gives an array that was broadcast its layout.
    """
    robots = next((x.shape[-1] for x in inputs if jnp.shape(x)), 1)
    return _Evaluation(robots, cast).results(program, inputs)


class _Evaluation:
    def __init__(self, robots: int, cast: Cast):
        self.robots, self.cast = robots, cast

    def results(self, program: Any, inputs: Sequence[Any]) -> list[Any]:
        """Return the results of a jaxpr, each of its own axes."""
        values = dict(zip(program.invars, inputs, strict=True))

        def read(variable: Any) -> Any:
            literal = isinstance(variable, core.Literal)
            return variable.val if literal else values[variable]

        for equation in program.eqns:
            given = [read(variable) for variable in equation.invars]
            values.update(
                zip(equation.outvars, self.results_of(equation, given), strict=True)
            )
        return [self.like(variable, read(variable)) for variable in program.outvars]

    def results_of(self, equation: Any, given: list[Any]) -> list[Any]:
        """Return the results of one operation of a jaxpr."""
        name, parameters = equation.primitive.name, equation.params
        shape = equation.outvars[0].aval.shape
        if name in ELEMENTWISE:
            axes = max(jnp.ndim(x) for x in given)
            given = [self.spread(x, axes) for x in given]
            return [equation.primitive.bind(*given, **parameters)]
        if name == "floor":
            nearest = jnp.round(given[0])
            return [jax.lax.select(nearest > given[0], nearest - 1.0, nearest)]
        if name == "reduce_sum" and parameters["axes"] == (0,) and len(shape) == 1:
            return [jnp.sum(self.spread(given[0], 2), axis=0)]
        if name == "broadcast_in_dim":
            last = range(len(shape) - len(parameters["broadcast_dimensions"]), len(shape))
            if parameters["broadcast_dimensions"] == tuple(last):
                return given
        if name == "jit":
            return self.results(parameters["jaxpr"].jaxpr, given)
        if name == "scan":
            return self.looped(equation, given)
        raise NotImplementedError(f"{name} to {shape} in a kernel over legs and robots")

    def looped(self, equation: Any, given: list[Any]) -> list[Any]:
        """Return the results of a loop that counts to a number."""
        body, times = equation.params["jaxpr"].jaxpr, equation.params["length"]
        constants = len(given) - len(equation.outvars)
        kept, first = given[:constants], given[constants:]
        start = [
            self.like(*pair) for pair in zip(equation.outvars, first, strict=True)
        ]
        return jax.lax.fori_loop(
            0, times, lambda _, state: self.results(body, [*kept, *state]), start
        )

    def like(self, variable: Any, x: Any) -> Any:
        """Return a number with the axes of a variable of the jaxpr."""
        shape = variable.aval.shape
        if shape in ((), (1,)):
            return x
        return self.spread(x, 2 if len(shape) == 2 and shape[0] == LEGS else 1)

    def spread(self, x: Any, axes: int) -> Any:
        """Return a number with at least so many axes, over robots and over legs."""
        shape = (LEGS, self.robots)[2 - axes :]
        if jnp.ndim(x) == axes:
            return x
        dimensions = range(axes - jnp.ndim(x), axes)
        return self.cast(jax.lax.broadcast_in_dim(x, shape, tuple(dimensions)))


def _layouts(mosaic_gpu: Any) -> tuple[dict[int, Any], Any]:
    """Return the layouts of arrays over robots and over legs and robots, by the number
    of their axes, and that of an array over legs."""
    layout, tiling = mosaic_gpu.Layout.TILED, mosaic_gpu.Tiling
    legs, lanes = mosaic_gpu.Replicated(LEGS), mosaic_gpu.Replicated(LANES)
    layouts = {
        1: layout(tiling(((LANES,), (1,))), (legs,), (-2,), -1),
        2: layout(tiling(((LEGS, LANES), (1,))), (-3,), (-2,), -1),
    }
    return layouts, layout(tiling(((LEGS,), (1,))), (-2,), (lanes,), -1)


def _padded(x: jax.Array, robots: int, whole: int) -> jax.Array:
    """Repeat the last robot up to a whole number of blocks, in what differs between
    robots."""
    if x.shape[-1] != robots:
        return x
    return jnp.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, whole - robots)], mode="edge")
