"""A nonlinear program as it is written down: unknowns, constraints and cost, then
solved with IPOPT."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from bp2_rl.optimiser.sagittal import ca


class Optimum(NamedTuple):
    """Result of IPOPT for n unknowns and m constraints, all in the program's own scaled
    units."""

    point: Float[np.ndarray, " n"]
    # of the unknowns' bounds: positive where the upper one holds
    unknown_multipliers: Float[np.ndarray, " n"]
    constraint_multipliers: Float[np.ndarray, " m"]  # with the same signs
    statistics: dict[str, Any]
    violation: float  # largest, of any constraint


class Bounds(NamedTuple):
    """Lower and upper bounds of k constraints or unknowns."""

    lower: Float[np.ndarray, " k"]
    upper: Float[np.ndarray, " k"]


class Conditions(NamedTuple):
    """A program's constraints at a point: their values, and the bounds of these and of
    the unknowns."""

    values: Float[np.ndarray, " m"]
    constraint_bounds: Bounds
    unknown_bounds: Bounds


class Program:
    """A nonlinear program, collected in the order in which it is written down."""

    def __init__(self) -> None:
        self._unknowns: list[ca.MX] = []
        self._guess: list[Float[np.ndarray, " x"]] = []
        self._unknown_bounds: list[Bounds] = []
        self._constraints: list[ca.MX] = []
        self._constraint_bounds: list[Bounds] = []
        self.objective: ca.MX = ca.MX(0)

    def unknown(
        self,
        guess: Float[np.ndarray, "rows columns"],
        scale: float,
        lower: float | np.ndarray = -np.inf,
        upper: float | np.ndarray = np.inf,
    ) -> ca.MX:
        """Add a matrix of unknowns, which start at `guess` and are divided by `scale`
        inside the program."""
        symbol = ca.MX.sym("x", *guess.shape)
        low, high = (
            np.broadcast_to(np.asarray(bound, float), guess.shape) / scale
            for bound in (lower, upper)
        )
        self._unknowns.append(ca.vec(symbol))
        self._guess.append(np.clip(guess / scale, low, high).ravel(order="F"))
        self._unknown_bounds.append(Bounds(low.ravel(order="F"), high.ravel(order="F")))
        return symbol * scale

    def require(
        self,
        expression: ca.MX,
        scale: float,
        lower: float = 0.0,
        upper: float = 0.0,
    ) -> None:
        """Add the constraint lower <= expression / scale <= upper: an equation where no
        bounds are given."""
        column = ca.vec(expression) / scale
        size = column.shape[0]
        self._constraints.append(column)
        self._constraint_bounds.append(
            Bounds(np.full(size, lower), np.full(size, upper))
        )

    def at_least_zero(self, expression: ca.MX, scale: float) -> None:
        """Add the constraint 0 <= expression."""
        self.require(expression, scale, 0.0, np.inf)

    def within(self, expression: ca.MX, bound: ca.MX | float, scale: float) -> None:
        """Add the constraint |expression| <= bound."""
        self.at_least_zero(bound - expression, scale)
        self.at_least_zero(bound + expression, scale)

    def conditions(self, point: Float[np.ndarray, " n"]) -> Conditions:
        """Return the constraints' values and all bounds at a point of the scaled
        unknowns."""
        [values] = self.values([ca.vertcat(*self._constraints)], point)
        return Conditions(
            values.ravel(),
            _joined(self._constraint_bounds),
            _joined(self._unknown_bounds),
        )

    def values(
        self, expressions: Sequence[ca.MX], point: Float[np.ndarray, " n"]
    ) -> list[Float[np.ndarray, "columns rows"]]:
        """Return the values of expressions at a point of the scaled unknowns, each with
        its columns first."""
        function = ca.Function(
            "values", [ca.vertcat(*self._unknowns)], list(expressions)
        )
        return [np.array(value).T for value in function.call([point])]

    def solve(self, time_limit: float, perhaps_infeasible: bool) -> Optimum:
        """Solve the program with IPOPT from the guess, and return where it ends."""
        x, g = ca.vertcat(*self._unknowns), ca.vertcat(*self._constraints)
        options = {
            # Not expanded: to unroll the points costs more than the faster iterations
            # bring.
            "print_time": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "linear_solver": "mumps",
                "mu_strategy": "adaptive",
                "tol": 1e-7,
                "constr_viol_tol": 1e-9,
                "max_iter": 2000,
                "max_cpu_time": time_limit,
                "expect_infeasible_problem": "yes" if perhaps_infeasible else "no",
            },
        }
        solver = ca.nlpsol(
            "solver", "ipopt", {"x": x, "f": self.objective, "g": g}, options
        )
        lbx, ubx = _joined(self._unknown_bounds)
        lbg, ubg = _joined(self._constraint_bounds)
        end = solver(x0=np.concatenate(self._guess), lbx=lbx, ubx=ubx, lbg=lbg, ubg=ubg)
        x_end, g_end, on_x, on_g = (
            np.array(end[name]).ravel() for name in ("x", "g", "lam_x", "lam_g")
        )
        over = [lbx - x_end, x_end - ubx, lbg - g_end, g_end - ubg]
        violation = max(float(np.max(excess)) for excess in over)
        return Optimum(x_end, on_x, on_g, solver.stats(), violation)


def _joined(parts: Sequence[Bounds]) -> Bounds:
    """Return several bounds joined into one."""
    lower, upper = zip(*parts, strict=True)
    return Bounds(np.concatenate(lower), np.concatenate(upper))
