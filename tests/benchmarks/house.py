"""Sizes of the house: `python tests/benchmarks/house.py [FOLDER]`, of this checkout or another one.

Lines of code are those that are neither blank nor docstrings; strings below a constant count as docstrings. `assumed`
counts texts of constants that say so; `refusals` are `raise` statements and calls of functions that do nothing else
than raise.
"""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]


def modules(folder: Path, *parts: str) -> Iterator[tuple[str, ast.Module]]:
    """Text and tree of each module."""
    for part in parts:
        for path in sorted((folder / part).rglob("*.py")):
            text = path.read_text("utf-8")
            yield text, ast.parse(text)


def texts(tree: ast.Module) -> list[ast.Expr]:
    """Docstrings, and strings below constants."""
    return [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
    ]


def code_lines(text: str, tree: ast.Module) -> int:
    """Lines that are neither blank nor within `texts`."""
    inside = {line for node in texts(tree) for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)}
    return sum(bool(line.strip()) and number not in inside for number, line in enumerate(text.split("\n"), start=1))


def assumed(tree: ast.Module) -> int:
    """Strings below constants that call these assumed."""
    return sum(
        isinstance(after, ast.Expr)
        and isinstance(getattr(after.value, "value", None), str)
        and "assumed" in str(getattr(after.value, "value", "")).lower()
        for before, after in zip(tree.body, tree.body[1:], strict=False)
        if isinstance(before, ast.Assign | ast.AnnAssign)
    )


def inner_imports(tree: ast.Module) -> int:
    """Import statements in functions."""
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    return len({
        (node.lineno, node.col_offset)
        for function in functions
        for node in ast.walk(function)
        if isinstance(node, ast.Import | ast.ImportFrom)
    })  # fmt: skip


def refusals(trees: list[ast.Module]) -> int:
    """Raise statements, and calls of functions whose body only raises."""
    functions = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    bodies = {node.name: [part for part in node.body if not isinstance(part, ast.Expr)] for node in functions}
    raisers = {name for name, body in bodies.items() if len(body) == 1 and isinstance(body[0], ast.Raise)}
    nodes = [node for tree in trees for node in ast.walk(tree)]
    calls = sum(isinstance(node, ast.Call) and getattr(node.func, "id", "") in raisers for node in nodes)
    return calls + sum(isinstance(node, ast.Raise) for node in nodes)


def main() -> None:
    """Print the sizes."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT
    found = list(modules(folder, "lunarsci", "cli"))
    trees = [tree for _, tree in found]
    sizes = {
        "lines of lunarsci and cli": sum(text.count("\n") for text, _ in found),
        "of these code": sum(code_lines(text, tree) for text, tree in found),
        "modules": len(found),
        "constants called assumed": sum(map(assumed, trees)),
        "refusals": refusals(trees),
        "imports in functions": sum(map(inner_imports, trees)),
        "lines of tests": sum(text.count("\n") for text, _ in modules(folder, "tests")),
    }
    for name, size in sizes.items():
        print(f"{name:<28} {size:>7,}")


if __name__ == "__main__":
    main()
