"""Count the statements that a newcomer reads to understand one training, its judge and
one evaluation of the top speed.

Run in the repository's root: `python tests/helpers/closure.py [--list]`.
"""

import ast
import sys
from pathlib import Path

ROOTS = (
    "bp2_rl.learning.run",
    "bp2_rl.evaluation.judge",
    "bp2_rl.evaluation.benchmarks.run",
)


def modules(package: Path) -> dict[str, Path]:
    """Return every module of a package by its dotted name."""
    found = {}
    for path in package.rglob("*.py"):
        parts = path.relative_to(package.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(path: Path, known: dict[str, Path]) -> set[str]:
    """Return the modules of the same package that a file imports, anywhere in it, but
    for type checkers alone."""
    names = set()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    untaken = {
        node
        for block in ast.walk(tree)
        if isinstance(block, ast.If) and ast.unparse(block.test) == "TYPE_CHECKING"
        for statement in block.body
        for node in ast.walk(statement)
    }
    for node in ast.walk(tree):
        if node in untaken:
            continue
        if isinstance(node, ast.ImportFrom) and node.module:
            names |= {
                node.module,
                *(f"{node.module}.{alias.name}" for alias in node.names),
            }
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return names & known.keys()


def closure(known: dict[str, Path], roots: tuple[str, ...] = ROOTS) -> set[str]:
    """Return the given modules and all modules that they import, directly or not."""
    seen, waiting = set(), list(roots)
    while waiting:
        name = waiting.pop()
        if name not in seen:
            seen.add(name)
            waiting += imports(known[name], known)
    return seen


def is_code(node: ast.AST) -> bool:
    """Return whether a node is a statement, and neither an import nor a docstring."""
    if (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    ):
        return False
    return isinstance(node, ast.stmt) and not isinstance(
        node, ast.Import | ast.ImportFrom
    )


def count(paths: list[Path]) -> int:
    """Return the number of statements in these files together, which long or joined
    lines do not change."""
    return sum(
        is_code(node)
        for path in paths
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    )


if __name__ == "__main__":
    known = modules(Path(__file__).parents[2] / "bp2_rl")
    found = sorted(closure(known))
    if "--list" in sys.argv:
        print(*found, sep="\n")
    print(
        f"{count([known[name] for name in found]):,} statements in {len(found)} modules"
    )
