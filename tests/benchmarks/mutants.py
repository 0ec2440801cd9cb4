"""Which faults of one line the tests do not see: `make mutants`, or `python tests/benchmarks/mutants.py [--seed 3]`.

A fault is a formula with another sign, factor, unit, power, axis, function, comparison or constant, planted at random
into a copy of the checkout. Tests run until one fails: first those that mirror the module by name or import it, then
the others, by the number of imports that lie between. A test that fails without the fault, too, has not seen it. What
no test sees survives, and is printed. Tests whose truth is what the program itself printed before do not count.

Every place has the same chance but for those in `SELDOM`: modules that read, write, check and draw. Sentences, errors,
annotations, docstrings and functions that give pictures get no fault. mutmut 3.8 leaves decorated functions alone,
which all compiled ones are, and cosmic-ray 8.7 runs one command for every fault; so this is a script.
"""

import argparse
import ast
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from queue import Queue
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
SCIENCE = ("spectra", "regolith", "images", "twin")
SELDOM = re.compile(
    r"/(jobs|readers|library)/|figure|chart|film|animation|_files?\.py|checks|options|/rows|telemetry/read"
)
SELDOM_SHARE = 0.1
OWN_OUTPUT = ("test_former_rocks", "test_former_drives", "test_pictures", "test_readme", "test_help", "test_wheel")
"""Tests that compare with the program's own output, or say nothing of numbers and take long."""
FUNCTIONS = {
    **{"sin": "cos", "cos": "sin", "min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum"},
    **{"deg2rad": "rad2deg", "rad2deg": "deg2rad", "radians": "degrees", "degrees": "radians", "argmin": "argmax"},
    **{"argmax": "argmin", "mean": "median", "median": "mean", "floor": "ceil", "ceil": "floor", "sqrt": "", "abs": ""},
}
UNITS = ("deg2rad", "rad2deg", "radians", "degrees")
OPERATORS: dict[type, tuple[str, str, str]] = {
    ast.Add: ("+", "-", "sign"), ast.Sub: ("-", "+", "sign"),
    ast.Mult: ("*", "/", "factor"), ast.Div: ("/", "*", "factor"),
}  # fmt: skip
COMPARISONS: dict[type, tuple[str, str]] = {ast.Lt: ("<", ">"), ast.Gt: (">", "<"), ast.LtE: ("<=", ">"),
                                            ast.GtE: (">=", "<")}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Fault:
    """What stands in a file from one place to another, and what would be wrong there."""

    path: str
    line: int
    start: int
    end: int
    before: str
    after: str
    kind: str

    def planted(self, text: str) -> str:
        """The file with the fault; places are bytes within the line."""
        lines = text.splitlines(keepends=True)
        line = lines[self.line - 1].encode()
        lines[self.line - 1] = (line[: self.start] + self.after.encode() + line[self.end :]).decode()
        return "".join(lines)

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.before!r} -> {self.after!r} ({self.kind})"


def faults_of(path: str, text: str) -> list[Fault]:
    """Every fault that one file can get."""
    lines = [line.encode() for line in text.splitlines()]
    found = []
    for node, parent in formulas(ast.parse(text)):
        for start, end, after, kind in changes(node, parent, lines):
            before = lines[node.lineno - 1][start:end].decode()
            found.append(Fault(path, node.lineno, start, end, before, after, kind))
    return found


def formulas(node: ast.AST) -> Iterator[tuple[ast.expr, ast.AST]]:
    """Expressions of one line and what they stand in, but for texts, errors, annotations and what leads to an error."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST) or isinstance(child, (ast.Raise, ast.Assert, ast.JoinedStr, ast.Import)):
                continue
            if isinstance(child, ast.If) and any(isinstance(one, ast.Raise) for one in child.body):
                continue
            if isinstance(child, ast.FunctionDef) and (child.name == "__post_init__" or draws(child)):
                continue
            if isinstance(child, ast.expr) and child.lineno == child.end_lineno:
                yield child, node
            yield from formulas(child)


def draws(function: ast.FunctionDef) -> bool:
    """Whether it gives pictures: where things stand on these is looked at, not calculated."""
    return function.returns is not None and "Figure" in ast.unparse(function.returns)


Change = tuple[int, int, str, str]


def changes(node: ast.expr, parent: ast.AST, lines: list[bytes]) -> Iterator[Change]:
    """What may be wrong at one expression: start and end in its line, what would stand there, and the kind."""
    line = lines[node.lineno - 1]
    match node:
        case ast.BinOp(left=left, op=op, right=right) if type(op) in OPERATORS and not has_text(node):
            sign, other, kind = OPERATORS[type(op)]
            if (place := line.find(sign.encode(), left.end_col_offset, right.col_offset)) >= 0:
                yield place, place + 1, other, "degrees of freedom" if is_one(right) and kind == "sign" else kind
        case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in COMPARISONS:
            sign, other = COMPARISONS[type(op)]
            if (place := line.find(sign.encode(), left.end_col_offset, right.col_offset)) >= 0:
                yield place, place + len(sign), other, "comparison"
        case ast.UnaryOp(op=ast.USub()):
            yield node.col_offset, node.col_offset + 1, "", "sign"
        case ast.Call(func=ast.Attribute() | ast.Name()) if (name := name_of(node.func)) in FUNCTIONS:
            kind = "unit" if name in UNITS else "power" if name == "sqrt" else "function"
            place = node.func.end_col_offset or 0
            start = place - len(name) if FUNCTIONS[name] else node.func.col_offset
            yield start, place, FUNCTIONS[name], kind
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            end = node.end_col_offset or 0
            if (wrong := constant_gone_wrong(value, parent, node)) is not None:
                yield node.col_offset, end, wrong[0], wrong[1]


def constant_gone_wrong(value: float, parent: ast.AST, node: ast.expr) -> tuple[str, str] | None:
    """Another number in its place, and the kind of fault."""
    match parent:
        case ast.keyword(arg="axis") if value in (0, 1, -1):
            return str(1 - abs(int(value))), "axis"
        case ast.keyword(arg="ddof"):
            return str(1 - int(value)), "degrees of freedom"
        case ast.Subscript() | ast.Tuple() if type(value) is int and value in (0, 1):
            return (str(1 - value), "axis") if isinstance(parent, ast.Subscript) else None
        case ast.BinOp(op=ast.Pow(), right=right) if right is node:
            return str(value + 1), "power"
        case ast.BinOp() if value in (1e3, 1e6, 1e9, 1e-3, 1e-6, 1e-9):
            return repr(1.0 / value), "unit"
        case ast.BinOp() if not has_text(parent):
            return (str(value + 1) if type(value) is int else repr(1.1 * value or 1.0)), "factor"
        case ast.Call(func=function) if re.search("quantile|percentile|ppf|interval", name_of(function)):
            return repr(0.9 * value), "quantile"
    return None


def is_one(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value == 1


def name_of(function: ast.expr) -> str:
    return function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")


def has_text(node: ast.AST) -> bool:
    """Whether something is joined or repeated that is no number: texts, lists, tuples, types."""
    kinds = (ast.JoinedStr, ast.List, ast.Tuple, ast.Starred, ast.ListComp, ast.Dict, ast.Set)
    return any(isinstance(one, kinds) or isinstance(getattr(one, "value", None), str) for one in ast.walk(node))


def drawn(root: Path, count: int, seed: int, only: str = "") -> list[Fault]:
    """Faults at random places of the science; modules in `SELDOM` have a tenth of the chance."""
    draw, weighted = random.Random(seed), []
    for package in SCIENCE:
        for path in sorted((root / "lunarsci" / package).rglob("*.py")):
            name = path.relative_to(root).as_posix()
            if re.search(only, name):
                weight = SELDOM_SHARE if SELDOM.search(name) else 1.0
                weighted += [(weight, fault) for fault in faults_of(name, path.read_text("utf-8"))]
    order = sorted(weighted, key=lambda pair: draw.random() ** (1 / pair[0]), reverse=True)
    return [fault for _, fault in order[:count]]


# --- tests by how near they are ---


def imported(text: str) -> set[str]:
    """Modules that a file imports, at its head or in a function, as paths without suffix."""
    found = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found


@cache
def arrows(root: Path) -> dict[str, set[str]]:
    """What each module of the library, and each file of tests by its path, imports."""
    files = {".".join(path.relative_to(root).with_suffix("").parts): path for path in (root / "lunarsci").rglob("*.py")}
    files |= {path.stem: path for path in (root / "tests/benchmarks").glob("*.py")}
    tests = {path.relative_to(root).as_posix(): path for path in (root / "tests").rglob("test_*.py")}
    return {name: imported(path.read_text("utf-8")) for name, path in (files | tests).items()}


def tests_for(root: Path, path: str) -> list[tuple[int, str]]:
    """Files of tests by their distance from a module: 0 for its own, 1 where it is imported, and so on.

    Those of its part come first, as they compile the least.
    """
    module, known = path.removesuffix(".py").replace("/", "."), arrows(root)
    distance, front = {module: 0}, {module}
    while front:
        step = {name for name, used in known.items() if used & front and name not in distance}
        distance |= dict.fromkeys(step, 1 + max(distance.values()))
        front = step
    stem, part = module.rpartition(".")[2], f"tests/{path.split('/')[1]}/"
    ranked = []
    for name in (name for name in known if name.endswith(".py") and Path(name).stem not in OWN_OUTPUT):
        own = 0 if Path(name).stem == f"test_{stem}" else 1 if stem in Path(name).stem else 99
        ranked.append((min(own, distance.get(name, 99)), not name.startswith(part), name))
    return [(far, name) for far, _, name in sorted(ranked)]


# --- a copy, faults in it, and what the tests say ---

NO_TEST = ("", "time")
"""In the place of the test that sees a fault, where there is none."""


def copied(place: Path) -> Path:
    """The checkout, with what is new and without what git ignores; compiled code of unchanged files is found again."""
    listed = ["git", "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    for name in subprocess.run(listed, capture_output=True, text=True, check=True).stdout.split("\0"):
        if name and (ROOT / name).is_file():
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, place / name)
    return place


def fails(copy: Path, files: list[str], limit_s: float, without: list[str]) -> str:
    """The test that fails first, or "time" where they do not end; "" if all pass. Some are left out."""
    line = [sys.executable, "-m", "pytest", "-x", "-q", "--numprocesses=0", "-p", "no:cacheprovider", "--tb=no", *files]
    line += [f"--deselect={name}" for name in without]
    environment = os.environ | {"NUMBA_CACHE_DIR": f"{copy}-numba", "PYTHONPATH": str(copy / "tests/checkout")}
    quiet: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True}
    with subprocess.Popen(line, cwd=copy, env=environment, start_new_session=True, **quiet) as process:
        try:
            told, _ = process.communicate(timeout=limit_s)
        except BaseException as ended:  # Ctrl-C too: what the tests started ends with them
            os.killpg(process.pid, signal.SIGKILL)
            if isinstance(ended, subprocess.TimeoutExpired):
                return "time"
            raise
    named = re.findall(r"^(?:FAILED|ERROR) (\S+)", told, re.M)
    return "" if process.returncode in (0, 5) else (named or ["the process ended"])[0]


def killer(copy: Path, fault: Fault, options: argparse.Namespace) -> str:
    """The test that sees the fault, and passes without it; "" if none does, "time" if tests do not end in time."""
    broken: list[str] = []
    while (seen := first_failure(copy, fault, options, broken)).startswith("tests/"):
        if not fails(copy, [seen], options.timeout, []):
            break
        broken.append(seen)
    return seen


def first_failure(copy: Path, fault: Fault, options: argparse.Namespace, broken: list[str]) -> str:
    """The test that fails first while the fault lies in the copy; "" if all pass, "time" if they do not end in time.

    Those that are broken without it are left out.
    """
    target, began = copy / fault.path, time.monotonic()
    sound = target.read_text("utf-8")
    ranked = tests_for(ROOT, fault.path)
    files = [name for distance, name in ranked if distance < 99]
    near, rest = files[: options.near], files[options.near :]
    try:
        target.write_text(fault.planted(sound), "utf-8")
        for some in (near, [] if options.nearest_only else rest):
            left = options.timeout - (time.monotonic() - began)
            if some and (seen := fails(copy, some, left, broken) if left > 0 else "time"):
                return seen
        return ""
    finally:
        target.write_text(sound, "utf-8")


def report(results: list[tuple[Fault, str]]) -> str:
    """Kills by kind and by package, and what survived."""
    lines = []
    for title, key in (("kind", lambda f: f.kind), ("package", lambda f: f.path.split("/")[1])):
        all_, dead = Counter(key(f) for f, _ in results), Counter(key(f) for f, by in results if by not in NO_TEST)
        lines += [f"{title:20s} killed"] + [f"{name:20s} {dead[name]} of {all_[name]}" for name in sorted(all_)]
    lines += [f"{'out of time' if by else 'survived'}: {fault}" for fault, by in results if by in NO_TEST]
    killed = sum(by not in NO_TEST for _, by in results)
    return "\n".join([*lines, f"{killed} of {len(results)} killed ({100 * killed / max(1, len(results)):.0f} %)"])


def main() -> None:
    """Plant, try and report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=150)
    parser.add_argument("--seed", type=int, default=random.randrange(10**6))
    parser.add_argument("--only", default="", help="pattern of paths")
    parser.add_argument("--near", type=int, default=8, help="files of tests that run first")
    parser.add_argument("--nearest-only", action="store_true")
    parser.add_argument("--timeout", type=float, default=900.0, help="seconds for one fault")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    print(f"seed {options.seed}", flush=True)
    faults, places = drawn(ROOT, options.count, options.seed, options.only), Queue[Path]()
    for number in range(options.jobs):
        place = Path(tempfile.gettempdir()) / f"lunarsci-mutants-{number}"
        shutil.rmtree(place, ignore_errors=True)
        places.put(copied(place))

    def tried(fault: Fault) -> tuple[Fault, str]:
        place = places.get()
        try:
            by = killer(place, fault, options)
        finally:
            places.put(place)
        print(f"{fault}: {by or 'survived'}", flush=True)
        return fault, by

    with ThreadPoolExecutor(options.jobs) as pool:
        results = list(pool.map(tried, faults))
    print(report(results))
    if options.json:
        rows = [asdict(fault) | {"killed_by": by} for fault, by in results]
        options.json.write_text(json.dumps({"seed": options.seed, "faults": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
