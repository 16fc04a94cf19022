"""Hardware and trajectory found together (paper, "Co-optimization of Hardware and Trajectory"), and what it rests on.

The motors stay; gear ratio, leg length and spring stiffness become unknowns of the trajectory's program. A program as
this one has many local optima, so each is sought from several starts, and along a scan from both ends.

    find_designs    the optimum, from every start
    scan_design     the cost over one of the three, the others at BP2's values or free
    vary_settings   the optimum under other settings: which numbers of it are the robot's, which are the settings'

Everything is a chain of problems, each started from the last one's solution. What is solved is kept in a folder under
the hash of its chain, so whatever was interrupted goes on where it stood.
"""

import contextlib
import dataclasses
import functools
import math
from collections.abc import Iterable, Sequence
from concurrent.futures import as_completed
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from bp2_rl.config import config_hash, save_config
from bp2_rl.errors import UserError
from bp2_rl.files import write_text
from bp2_rl.robot import specs
from bp2_rl.robot.specs import HardwareSpec
from bp2_rl.trajopt.problem import Problem, Weights, motor_coordinates
from bp2_rl.trajopt.solution import Solution, load_solution, resample, save_solution
from bp2_rl.workers import spawned

Parameter = Literal["gear_ratio", "leg_length", "spring_stiffness"]
PARAMETERS: tuple[Parameter, ...] = get_args(Parameter)
Others = Literal["BP2", "free"]
UNITS: dict[Parameter, str] = {"gear_ratio": "1", "leg_length": "m", "spring_stiffness": "N/m"}
NUMBERS, TEXT = "codesign.json", "codesign.txt"
PATIENCE = 20.0  # s for each interval, several times what a solution takes; what has none would go on for longer
AT_BOUND = 1e-3  # of a parameter's range: closer than this, the bound made the value
FLAT = 0.02  # a parameter is as good as its optimum where it costs at most this share more


@dataclasses.dataclass(frozen=True)
class Bounds:
    """Least and greatest values of the parameters; the shortest leg holds shank, toe and the spring's travel."""

    gear_ratio: tuple[float, float] = (5.0, 14.0)
    leg_length: tuple[float, float] = (0.29, specs.HIP_FORE_AFT)  # m; see CodesignSettings
    spring_stiffness: tuple[float, float] = (2500.0, 15000.0)  # N/m

    def __post_init__(self) -> None:
        """Refuse bounds between which there is no design, or one that cannot be built."""
        for name in PARAMETERS:
            low, high = getattr(self, name)
            if not (math.isfinite(low) and math.isfinite(high) and 0.0 < low < high):
                raise UserError(f"bounds.{name} must be two numbers with 0 < low < high, got {low:g} and {high:g}")
        try:
            HardwareSpec(leg_length=self.leg_length[0])
        except UserError as error:
            raise UserError(f"bounds.leg_length begins too low: {error}") from error

    def of(self, names: Iterable[str]) -> dict[str, tuple[float, float]]:
        """The bounds of some parameters.

        Raises:
            UserError: a name that is no parameter's.
        """
        return {name: getattr(self, known_parameter(name)) for name in names}

    def touched(self, hardware: HardwareSpec, names: Iterable[str] = PARAMETERS) -> tuple[str, ...]:
        """Which of the parameters the hardware has at a bound."""
        return tuple(
            name
            for name, (low, high) in self.of(names).items()
            if min(getattr(hardware, name) - low, high - getattr(hardware, name)) <= AT_BOUND * (high - low)
        )


def known_parameter(name: str) -> Parameter:
    """`name`, if it is a parameter's.

    Raises:
        UserError: it is not.
    """
    for parameter in PARAMETERS:
        if name == parameter:
            return parameter
    raise UserError(f"{name!r} is no design parameter: choose among {', '.join(PARAMETERS)}")


@dataclasses.dataclass(frozen=True)
class CodesignSettings:
    """What is optimised, within which bounds, and how hard it is looked for.

    Cost and dynamics alone do not decide the design: a leg weighs nothing more for being longer, long legs move their
    joints slower, and slow joints allow any gear. Unbounded, length and gear run away together, to 0.45 m and 14. What
    holds them here is stated, and ASSUMED:

    - Leg length up to 0.35 m, half the distance between the hips: then a fore and a hind thigh cannot meet. The length
      found is this bound; at BP2's gear legs of 0.37 to 0.42 m are cheaper by 2 %.
    - Joint speeds up to 0.6 of the no-load speed. The same motors run 13.2 m/s, and do so on a battery that may sag to
      0.8 of its voltage: 10 / 13.2 x 0.8 = 0.61. This margin sets the gear, all but in proportion: 7.2 for 0.5, 8.5
      for 0.6, 9.2 for 0.65, 11.2 for 0.8, 13.7 for 1.
    - F bar of three body weights, the largest force of a foot at 10 m/s; so forces, like torques, are shares of their
      greatest. It sets the stiffness: 3.6, 4.7, 6.1 and 6.1 kN/m for 1, 2, 3 and 4 body weights.
    """

    problem: Problem = Problem(
        intervals=8, speed_margin=0.6, weights=Weights(force=round(3.0 * specs.TOTAL_MASS * specs.GRAVITY))
    )
    bounds: Bounds = Bounds()
    # Where scans go; free parameters keep to `bounds`. Behind higher gears the speed margin leaves no gait.
    scanned: Bounds = Bounds(gear_ratio=(5.5, 10.0), leg_length=(0.29, 0.45))
    starts: int = 4  # of the optimum
    starts_elsewhere: int = 1  # of every other setting, besides the optimum itself
    grid: int = 7  # values in a scan
    confirm: tuple[int, ...] = (16, 24, 32, 48)  # intervals on which the optimum is solved again, one after another

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        for name, least in (("starts", 1), ("starts_elsewhere", 0), ("grid", 3)):
            if getattr(self, name) < least:
                raise UserError(f"{name} must be at least {least}, got {getattr(self, name)}")


# --- Chains of problems ---------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Chain:
    """Problems solved one after another, each from the last solution; the first from a cold guess.

    Free parameters are found within `bounds`, starting from the last solution's, or else from the problem's own.
    """

    problems: tuple[Problem, ...]
    free: tuple[Parameter, ...]
    bounds: Bounds
    seed: int = 0  # of the cold guess; 0 is the one that is not varied

    @property
    def before(self) -> "Chain | None":
        """The chain without its last problem."""
        return dataclasses.replace(self, problems=self.problems[:-1]) if len(self.problems) > 1 else None

    def then(self, problem: Problem) -> "Chain":
        """The chain with one more problem."""
        return dataclasses.replace(self, problems=(*self.problems, problem))

    @property
    def parts(self) -> list["Chain"]:
        """The chains that end with the first problem, with the second, and so on."""
        return [dataclasses.replace(self, problems=self.problems[: i + 1]) for i in range(len(self.problems))]


def solve_chain(chain: Chain, folder: Path) -> Solution | None:
    """The solution of a chain's last problem, read from `folder` or solved and kept there; None where IPOPT failed.

    A problem that cannot be solved is passed over: the next one starts from the last solution before it.
    """
    from bp2_rl.trajopt import collocation  # CasADi is optional, and settings are read without it

    if is_solved(chain, folder):
        return read_solution(chain, folder)
    before = chain.before
    while before is not None and (last := solve_chain(before, folder)) is None:
        before = before.before
    problem = chain.problems[-1]
    if before is None:
        guess = collocation.cold_guess(problem, seed=chain.seed or None)
    else:
        problem = problem.on(**{name: getattr(last.problem.hardware, name) for name in chain.free})
        guess = resample(last.problem, last.trajectory, problem)
    path = _path(chain, folder)
    try:
        solution = collocation.solve(
            problem, guess, free=chain.bounds.of(chain.free), time_limit=PATIENCE * problem.intervals
        )
    except collocation.NotSolved as failure:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path.with_suffix(".failed"), f"{failure}\n")
        return None
    save_solution(path, solution)
    return solution


def is_solved(chain: Chain, folder: Path) -> bool:
    """Whether it is known already how a chain ends."""
    path = _path(chain, folder)
    return path.with_suffix(".json").exists() or path.with_suffix(".failed").exists()


def read_solution(chain: Chain, folder: Path) -> Solution | None:
    """What `solve_chain` left; None where IPOPT failed."""
    path = _path(chain, folder)
    return None if path.with_suffix(".failed").exists() else load_solution(path)


def _not_solved(message: str) -> Exception:
    """What `collocation` raises."""
    from bp2_rl.trajopt.collocation import NotSolved

    return NotSolved(message)


def _path(chain: Chain, folder: Path) -> Path:
    return folder / "solutions" / config_hash(chain)


def solve_chains(chains: Sequence[Chain], folder: Path, workers: int, title: str, console: Console) -> None:
    """Solve what is not in `folder` yet in `workers` processes, or in this one if it is one."""
    missing = [chain for chain in chains if not all(is_solved(part, folder) for part in chain.parts)]
    if not missing:
        return
    parts = {part for chain in chains for part in chain.parts}
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress, contextlib.ExitStack() as stack:
        task = progress.add_task(title, total=len(parts))

        def show() -> None:
            progress.update(task, completed=sum(is_solved(part, folder) for part in parts))

        show()
        if workers == 1:
            for part in (part for chain in missing for part in chain.parts):
                solve_chain(part, folder)
                show()
            return
        pool = stack.enter_context(spawned(workers))
        for future in as_completed([pool.submit(_solve_parts, chain, folder) for chain in missing]):
            future.result()
            show()


def _solve_parts(chain: Chain, folder: Path) -> None:
    """In a process of its own, every part of a chain."""
    for part in chain.parts:
        solve_chain(part, folder)


# --- The optimum ----------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Row:
    """The cheapest trajectory under one setting."""

    case: str
    gear_ratio: float
    leg_length: float  # m
    spring_stiffness: float  # N/m
    cost: float
    period: float  # s
    duty: float
    peak_torque: float  # Nm, of the joints
    peak_speed: float  # rad/s, likewise
    speed_share: float  # of the no-load speed behind this gear
    at_bounds: tuple[str, ...]  # free parameters that a bound holds
    spread: float  # of the costs from all starts that were solved: dearest over cheapest, less 1
    solved: int  # starts from which there was a trajectory
    starts: int


def find_designs(
    settings: CodesignSettings, folder: Path, workers: int = 1, console: Console | None = None
) -> list[tuple[Chain, Solution]]:
    """The optima from every start, cheapest first, on the mesh of `settings.problem`.

    The first start is BP2 and the cold guess; the others have designs drawn from within the bounds, and varied guesses.

    Raises:
        NotSolved: no start led to a trajectory.
    """
    chains = [_start(settings, seed) for seed in range(settings.starts)]
    solve_chains(chains, folder, workers, "designs", console or Console())
    found = _solved(chains, folder)
    if not found:
        raise _not_solved(f"no design for {settings.problem.speed:g} m/s from {settings.starts} starts")
    return found


def optimise_design(
    settings: CodesignSettings, folder: Path, workers: int = 1, console: Console | None = None
) -> Solution:
    """The cheapest of `find_designs`, solved again on the meshes of `settings.confirm`, the parameters still free.

    Raises:
        NotSolved: no start led to a trajectory, or the finest mesh lost it.
    """
    chain = _refined(settings, find_designs(settings, folder, workers, console)[0][0])
    solve_chains([chain], folder, workers, "finer meshes", console or Console())
    solution = read_solution(chain, folder)
    if solution is None:
        raise _not_solved(f"the design was lost on {chain.problems[-1].intervals} intervals")
    return solution


def _refined(settings: CodesignSettings, chain: Chain) -> Chain:
    """The chain, then its last problem on finer and finer meshes."""
    return functools.reduce(Chain.then, (settings.problem.on_mesh(n) for n in settings.confirm), chain)


def _start(settings: CodesignSettings, seed: int) -> Chain:
    """The free problem by itself, from a start of its own for each seed."""
    problem = settings.problem
    if seed > 0:
        draw = np.random.default_rng(seed).uniform
        problem = problem.on(**{name: float(draw(*bounds)) for name, bounds in settings.bounds.of(PARAMETERS).items()})
    return Chain((problem,), PARAMETERS, settings.bounds, seed)


def _solved(chains: Iterable[Chain], folder: Path) -> list[tuple[Chain, Solution]]:
    """The chains that ended in a solution, cheapest first."""
    ends = [(chain, read_solution(chain, folder)) for chain in chains]
    return sorted(((chain, end) for chain, end in ends if end is not None), key=lambda pair: pair[1].cost)


def _row(case: str, chains: Sequence[Chain], folder: Path) -> Row | None:
    """The cheapest of several ways to the same problem; None where none led there."""
    found = _solved(chains, folder)
    if not found:
        return None
    chain, best = found[0]
    hardware, motors = best.problem.hardware, motor_coordinates(best.problem.stride.legs)
    speed = float(np.max(np.abs(best.trajectory.v[..., motors])))
    return Row(
        case=case,
        **{name: float(getattr(hardware, name)) for name in PARAMETERS},
        cost=best.cost,
        period=best.period,
        duty=best.duty,
        peak_torque=float(np.max(np.abs(best.trajectory.tau))),
        peak_speed=speed,
        speed_share=speed / hardware.joint_no_load_speed,
        at_bounds=chain.bounds.touched(hardware, chain.free),
        spread=found[-1][1].cost / best.cost - 1.0,
        solved=len(found),
        starts=len(chains),
    )


# --- Scans ----------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Scan:
    """The cheapest trajectory for every value of one parameter that could be solved, in order of the value."""

    parameter: Parameter
    others: Others
    rows: tuple[Row, ...]

    @property
    def values(self) -> tuple[float, ...]:
        """The parameter's values."""
        return tuple(getattr(row, self.parameter) for row in self.rows)

    @property
    def best(self) -> Row:
        """The cheapest row."""
        return min(self.rows, key=lambda row: row.cost)

    @property
    def interior(self) -> bool:
        """Whether the minimum is one: neither end of the scan is the cheapest."""
        return self.best not in (self.rows[0], self.rows[-1])

    @property
    def flat(self) -> tuple[float, float]:
        """Least and greatest value that cost at most a share `FLAT` more than the cheapest."""
        good = [v for v, row in zip(self.values, self.rows, strict=True) if row.cost <= (1.0 + FLAT) * self.best.cost]
        return min(good), max(good)


def scan_chains(settings: CodesignSettings, parameter: str, others: Others) -> tuple[Chain, Chain]:
    """One parameter over a grid, upwards and downwards, the others at the problem's values or free.

    Raises:
        UserError: a name that is no parameter's.
    """
    name = known_parameter(parameter)
    free: tuple[Parameter, ...] = tuple(p for p in PARAMETERS if p != name and others == "free")
    grid = np.linspace(*settings.scanned.of((name,))[name], settings.grid)
    problems = tuple(settings.problem.on(**{name: float(value)}) for value in grid)
    return Chain(problems, free, settings.bounds), Chain(problems[::-1], free, settings.bounds)


def scan_design(
    settings: CodesignSettings,
    parameter: str,
    others: Others,
    folder: Path,
    workers: int = 1,
    console: Console | None = None,
) -> Scan:
    """The cost over one parameter: by continuation from both ends of the grid, the cheaper kept at each value.

    Raises:
        UserError: a name that is no parameter's.
        NotSolved: there was a trajectory for no value.
    """
    up, down = scan_chains(settings, parameter, others)
    solve_chains((up, down), folder, workers, f"{parameter}, others {others}", console or Console())
    pairs = zip(up.parts, reversed(down.parts), strict=True)
    rows = [_row(f"{getattr(pair[0].problems[-1].hardware, parameter):g}", pair, folder) for pair in pairs]
    kept = tuple(row for row in rows if row is not None)
    if not kept:
        raise _not_solved(f"no trajectory for any {parameter} of the scan")
    return Scan(known_parameter(parameter), others, kept)


# --- Sensitivity ----------------------------------------------------------------------------------------------


def vary_settings(
    settings: CodesignSettings, folder: Path, workers: int = 1, console: Console | None = None
) -> list[Row]:
    """The optimum under the settings and under each of `variations`; from cold starts and from the settings' optimum.

    Raises:
        NotSolved: no start led to a trajectory even under the settings themselves.
    """
    found = find_designs(settings, folder, workers, console)
    base = found[0][0]
    ways = {
        case: [
            dataclasses.replace(base, bounds=changed.bounds).then(changed.problem),
            *(_start(changed, seed) for seed in range(settings.starts_elsewhere)),
        ]
        for case, changed in variations(settings).items()
    }
    every = [chain for chains in ways.values() for chain in chains]
    solve_chains(every, folder, workers, "sensitivity", console or Console())
    ways = {"as stated": [_start(settings, seed) for seed in range(settings.starts)]} | ways
    rows = [_row(case, chains, folder) for case, chains in ways.items()]
    return [row for row in rows if row is not None]


def variations(settings: CodesignSettings) -> dict[str, CodesignSettings]:
    """One setting after another changed to another value that could be defended as well; names say value and unit."""
    problem, weights, hardware = settings.problem, settings.problem.weights, settings.problem.hardware
    body_weight, inertia = specs.TOTAL_MASS * specs.GRAVITY, hardware.rotor_inertia

    def pose(**changes: Any) -> CodesignSettings:
        return dataclasses.replace(settings, problem=dataclasses.replace(problem, **changes))

    def weigh(**changes: float) -> CodesignSettings:
        return pose(weights=dataclasses.replace(weights, **changes))

    def build(**changes: float) -> CodesignSettings:
        return pose(hardware=dataclasses.replace(hardware, **changes))

    def limit(longest: float) -> CodesignSettings:
        leg_length = (settings.bounds.leg_length[0], longest)
        return dataclasses.replace(settings, bounds=dataclasses.replace(settings.bounds, leg_length=leg_length))

    cases = {f"F bar {share:g} body weights": weigh(force=round(share * body_weight)) for share in (1, 2, 3, 4)}
    for name in ("power", "load", "smoothness"):
        scaled = [factor * getattr(weights, name) for factor in (0.25, 4.0)]
        cases |= {f"{name} weight {value:g}": weigh(**{name: value}) for value in scaled}
    cases |= {f"rotor {x * inertia * 1e4:g}e-4 kg m2": build(rotor_inertia=x * inertia) for x in (0.5, 2.0, 4.0)}
    cases |= {f"speed margin {margin:g}": pose(speed_margin=margin) for margin in (0.5, 0.65, 0.8, 1.0)}
    cases |= {f"corner speed {speed:g} rad/s": build(corner_speed=speed) for speed in (0.0, specs.CORNER_SPEED)}
    cases |= {f"peak torque {torque:g} Nm": build(peak_torque=torque) for torque in (100.0, specs.PEAK_TORQUE)}
    cases |= {f"foot radius {radius:g} m": pose(foot_radius=radius) for radius in (0.0, specs.FOOT_RADIUS)}
    cases |= {f"leg up to {longest:g} m": limit(longest) for longest in (0.36, 0.45)}
    return {case: changed for case, changed in cases.items() if changed != settings}


# --- Everything together --------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Codesign:
    """What a whole study found."""

    settings: CodesignSettings
    meshes: tuple[Row, ...]  # the optimum on finer and finer meshes
    sensitivity: tuple[Row, ...]
    scans: tuple[Scan, ...]


def study_codesign(
    settings: CodesignSettings, folder: Path, workers: int = 1, console: Console | None = None
) -> Codesign:
    """Optimum, sensitivity and scans; solutions, `codesign.json` and `codesign.txt` are left in `folder`.

    Interrupted, it goes on from what is in the folder.

    Raises:
        NotSolved: no start led to a trajectory.
    """
    folder.mkdir(parents=True, exist_ok=True)
    console = console or Console()
    optimise_design(settings, folder, workers, console)
    best = _refined(settings, find_designs(settings, folder, workers, console)[0][0])
    meshes = [_row(f"on {part.problems[-1].intervals} intervals", [part], folder) for part in best.parts[1:]]
    sensitivity = vary_settings(settings, folder, workers, console)
    wanted: list[tuple[Parameter, Others]] = [(name, others) for others in get_args(Others) for name in PARAMETERS]
    ways = [chain for name, others in wanted for chain in scan_chains(settings, name, others)]
    solve_chains(ways, folder, workers, "scans", console)
    scans = [scan_design(settings, name, others, folder, workers, console) for name, others in wanted]
    study = Codesign(settings, tuple(row for row in meshes if row), tuple(sensitivity), tuple(scans))
    save_config(folder / NUMBERS, study)
    with (folder / TEXT).open("w", encoding="utf-8") as file:
        print_study(study, Console(file=file, width=120))
    print_study(study, console)
    return study


def print_study(study: Codesign, console: Console) -> None:
    """The optimum beside BP2, the optimum under other settings, and what the scans say of each parameter."""
    console.print(_table("Optimum", (*study.meshes, *study.sensitivity)))
    console.print(_scan_table(study.scans))
    for line in remarks(study):
        console.print(line, soft_wrap=True, highlight=False, markup=False)


def remarks(study: Codesign) -> list[str]:
    """Between which values each parameter's optimum lies under all settings, and how often a bound made it."""
    lines = []
    for name in PARAMETERS:
        held = [row for row in study.sensitivity if name in row.at_bounds]
        inside = [getattr(row, name) for row in study.sensitivity if name not in row.at_bounds]
        where = f"{min(inside):.4g} to {max(inside):.4g} {UNITS[name]}" if inside else "nowhere"
        lines.append(
            f"{name}: inside its bounds at {where} in {len(inside)} of {len(study.sensitivity)} settings, "
            f"at a bound in {len(held)}"
        )
    return lines


def _table(title: str, rows: Iterable[Row]) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold", box=None, padding=(0, 1, 0, 0))
    table.add_column("setting", no_wrap=True)
    for heading in (
        "gear",
        "length",
        "stiffness",
        "cost",
        "period",
        "duty",
        "torque",
        "speed",
        "of top",
        "spread",
        "solved",
    ):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(row.case, *_cells(row))
    return table


def _cells(row: Row) -> Iterable[str]:
    """Figures of a row; a star marks what a bound holds."""
    star = {name: "*" if name in row.at_bounds else "" for name in PARAMETERS}
    return (
        f"{row.gear_ratio:.2f}{star['gear_ratio']}",
        f"{row.leg_length:.3f}{star['leg_length']}",
        f"{row.spring_stiffness:.0f}{star['spring_stiffness']}",
        f"{row.cost:.4f}",
        f"{row.period:.3f}",
        f"{row.duty:.3f}",
        f"{row.peak_torque:.1f}",
        f"{row.peak_speed:.1f}",
        f"{row.speed_share:.0%}",
        f"{row.spread:.1%}",
        f"{row.solved}/{row.starts}",
    )


def _scan_table(scans: Iterable[Scan]) -> Table:
    table = Table(title="Scans", title_justify="left", title_style="bold", box=None, padding=(0, 1, 0, 0))
    for heading in ("parameter", "others", "cheapest at", "", f"within {FLAT:.0%}", "solved from"):
        table.add_column(heading, no_wrap=True)
    for scan in scans:
        table.add_row(
            f"{scan.parameter} [{UNITS[scan.parameter]}]".replace("[", r"\["),
            scan.others,
            f"{getattr(scan.best, scan.parameter):.5g}",
            "inside" if scan.interior else "at an end",
            "{:.5g} to {:.5g}".format(*scan.flat),
            f"{scan.values[0]:.5g} to {scan.values[-1]:.5g}",
        )
    return table
