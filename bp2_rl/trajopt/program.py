"""A nonlinear program as it is written down: unknowns, constraints and cost, then solved with IPOPT."""

from typing import Any

import numpy as np
from jaxtyping import Float

from bp2_rl.trajopt.sagittal import ca


class Program:
    """A nonlinear program, collected in the order in which it is written down."""

    def __init__(self) -> None:
        self._unknowns: list[ca.MX] = []
        self._guess: list[Float[np.ndarray, " x"]] = []
        self._limits: list[tuple[Float[np.ndarray, " x"], Float[np.ndarray, " x"]]] = []
        self._constraints: list[ca.MX] = []
        self._ranges: list[tuple[Float[np.ndarray, " g"], Float[np.ndarray, " g"]]] = []
        self.cost: ca.MX = ca.MX(0)

    def unknown(
        self, guess: Float[np.ndarray, "rows columns"], scale: float, lower: Any = -np.inf, upper: Any = np.inf
    ) -> ca.MX:
        """A matrix like `guess`; inside the program it is divided by `scale`."""
        symbol = ca.MX.sym("x", *guess.shape)
        low, high = (np.broadcast_to(np.asarray(bound, float), guess.shape) / scale for bound in (lower, upper))
        self._unknowns.append(ca.vec(symbol))
        self._guess.append(np.clip(guess / scale, low, high).ravel(order="F"))
        self._limits.append((low.ravel(order="F"), high.ravel(order="F")))
        return symbol * scale

    def require(self, expression: ca.MX, scale: float, lower: float = 0.0, upper: float = 0.0) -> None:
        """lower <= expression / scale <= upper: an equation where no bounds are given."""
        column = ca.vec(expression) / scale
        self._constraints.append(column)
        self._ranges.append((np.full(column.shape[0], lower), np.full(column.shape[0], upper)))

    def at_least_zero(self, expression: ca.MX, scale: float) -> None:
        """0 <= expression."""
        self.require(expression, scale, 0.0, np.inf)

    def within(self, expression: ca.MX, bound: ca.MX, scale: float) -> None:
        """|expression| <= bound."""
        self.at_least_zero(bound - expression, scale)
        self.at_least_zero(bound + expression, scale)

    def solve(
        self, unknowns: list[list[ca.MX]], time_limit: float
    ) -> tuple[list[Float[np.ndarray, "group columns rows"]], dict[str, Any], float]:
        """The unknowns at the optimum, each group stacked with its columns first; statistics; largest violation."""
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
        lbx, ubx = (np.concatenate(side) for side in zip(*self._limits, strict=True))
        lbg, ubg = (np.concatenate(side) for side in zip(*self._ranges, strict=True))
        end = solver(x0=np.concatenate(self._guess), lbx=lbx, ubx=ubx, lbg=lbg, ubg=ubg)
        x_end, g_end = (np.array(end[name]).ravel() for name in ("x", "g"))
        over = [lbx - x_end, x_end - ubx, lbg - g_end, g_end - ubg]
        violation = max(float(np.max(excess)) for excess in over)
        flat = [value for group in unknowns for value in group]
        numbers = iter(ca.Function("unknowns", [x], flat)(end["x"]) if len(flat) > 1 else ())
        return [np.stack([np.array(next(numbers)).T for _ in group]) for group in unknowns], solver.stats(), violation
