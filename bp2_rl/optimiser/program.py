"""A nonlinear program as it is written down: unknowns, constraints and cost, then solved with IPOPT."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bp2_rl.optimiser.sagittal import ca


class Optimum(NamedTuple):
    """Where IPOPT ended: n unknowns and m constraints, all in the program's own scaled units."""

    point: Float[np.ndarray, " n"]
    on_unknowns: Float[np.ndarray, " n"]  # multipliers of the unknowns' bounds: positive where the upper one holds
    on_constraints: Float[np.ndarray, " m"]  # multipliers of the constraints, with the same signs
    statistics: dict[str, Any]
    violation: float  # largest, of any constraint


class Conditions(NamedTuple):
    """A program's constraints at a point: their values, and the bounds of these and of the unknowns."""

    values: Float[np.ndarray, " m"]
    constraints: tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]
    unknowns: tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]


class LimitRows(NamedTuple):
    """Constraints or unknowns that one limit holds back."""

    limit: str
    places: Int[np.ndarray, " k"]  # among the constraints, or among the unknowns
    share: float  # of an instant that each stands for: a half for those that come in pairs


class Program:
    """A nonlinear program, collected in the order in which it is written down."""

    def __init__(self) -> None:
        self._unknowns: list[ca.MX] = []
        self._guess: list[Float[np.ndarray, " x"]] = []
        self._limits: list[tuple[Float[np.ndarray, " x"], Float[np.ndarray, " x"]]] = []
        self._constraints: list[ca.MX] = []
        self._ranges: list[tuple[Float[np.ndarray, " g"], Float[np.ndarray, " g"]]] = []
        self.cost: ca.MX = ca.MX(0)
        self.limiting: list[LimitRows] = []  # constraints that are limits
        self.limited: list[LimitRows] = []  # unknowns whose bounds are

    def unknown(
        self,
        guess: Float[np.ndarray, "rows columns"],
        scale: float,
        lower: Any = -np.inf,
        upper: Any = np.inf,
        limits: Sequence[str] = (),
    ) -> ca.MX:
        """A matrix like `guess`; inside the program it is divided by `scale`. Its rows' bounds may have names."""
        rows, columns = guess.shape
        first = sum(len(lower) for lower, _ in self._limits)
        for row, limit in enumerate(limits):
            if limit:
                self.limited.append(LimitRows(limit, first + row + rows * np.arange(columns), 1.0))
        symbol = ca.MX.sym("x", *guess.shape)
        low, high = (np.broadcast_to(np.asarray(bound, float), guess.shape) / scale for bound in (lower, upper))
        self._unknowns.append(ca.vec(symbol))
        self._guess.append(np.clip(guess / scale, low, high).ravel(order="F"))
        self._limits.append((low.ravel(order="F"), high.ravel(order="F")))
        return symbol * scale

    def require(
        self,
        expression: ca.MX,
        scale: float,
        lower: float = 0.0,
        upper: float = 0.0,
        limit: str = "",
        share: float = 1.0,
    ) -> None:
        """lower <= expression / scale <= upper: an equation where no bounds are given.

        A `limit` has a name; `share` is as in `LimitRows`.
        """
        column = ca.vec(expression) / scale
        if limit:
            first = sum(len(lower) for lower, _ in self._ranges)
            self.limiting.append(LimitRows(limit, first + np.arange(column.shape[0]), share))
        self._constraints.append(column)
        self._ranges.append((np.full(column.shape[0], lower), np.full(column.shape[0], upper)))

    def at_least_zero(self, expression: ca.MX, scale: float, limit: str = "", share: float = 1.0) -> None:
        """0 <= expression."""
        self.require(expression, scale, 0.0, np.inf, limit, share)

    def within(self, expression: ca.MX, bound: ca.MX, scale: float, limit: str = "") -> None:
        """|expression| <= bound."""
        self.at_least_zero(bound - expression, scale, limit, 0.5)
        self.at_least_zero(bound + expression, scale, limit, 0.5)

    def conditions(self, point: Float[np.ndarray, " n"]) -> Conditions:
        """The constraints and all bounds at a point of the scaled unknowns."""
        values = ca.Function("g", [ca.vertcat(*self._unknowns)], [ca.vertcat(*self._constraints)])(point)
        constraints, unknowns = (_joined(sides) for sides in (self._ranges, self._limits))
        return Conditions(np.array(values).ravel(), constraints, unknowns)

    def values(
        self, groups: list[list[ca.MX]], point: Float[np.ndarray, " n"]
    ) -> list[Float[np.ndarray, "group columns rows"]]:
        """Expressions in the unknowns at a point, each group stacked with its columns first."""
        flat = [value for group in groups for value in group]
        numbers = iter(ca.Function("unknowns", [ca.vertcat(*self._unknowns)], flat)(point) if len(flat) > 1 else ())
        return [np.stack([np.array(next(numbers)).T for _ in group]) for group in groups]

    def solve(self, time_limit: float) -> Optimum:
        """Where IPOPT ends from the guess."""
        x, g = ca.vertcat(*self._unknowns), ca.vertcat(*self._constraints)
        options = {
            # Not expanded: to unroll the points costs more than the faster iterations bring.
            "print_time": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "linear_solver": "mumps",
                "mu_strategy": "adaptive",
                "tol": 1e-7,
                "constr_viol_tol": 1e-9,
                "max_iter": 2000,
                "max_wall_time": time_limit,
            },
        }
        solver = ca.nlpsol("solver", "ipopt", {"x": x, "f": self.cost, "g": g}, options)
        (lbx, ubx), (lbg, ubg) = _joined(self._limits), _joined(self._ranges)
        end = solver(x0=np.concatenate(self._guess), lbx=lbx, ubx=ubx, lbg=lbg, ubg=ubg)
        x_end, g_end, on_x, on_g = (np.array(end[name]).ravel() for name in ("x", "g", "lam_x", "lam_g"))
        over = [lbx - x_end, x_end - ubx, lbg - g_end, g_end - ubg]
        violation = max(float(np.max(excess)) for excess in over)
        return Optimum(x_end, on_x, on_g, solver.stats(), violation)


def _joined(
    sides: Sequence[tuple[Float[np.ndarray, " _"], Float[np.ndarray, " _"]]],
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """All lower bounds in one row, and all upper ones."""
    lower, upper = zip(*sides, strict=True)
    return np.concatenate(lower), np.concatenate(upper)
