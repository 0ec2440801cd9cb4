"""The shape of the house: which part may import which, what the library may not touch, and what is packaged."""

import ast
import graphlib
import itertools
import re
import tomllib
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
SHARED = {
    "errors",
    "constants",
    "provenance",
    "arrays",
    "tempering",
    "figure",
    "rovers",
    "spectra_data",
    "result",
    "minerals",
    "memory",
    "names",
    "units",
    "options",
    "ranges",
    "registry",
    "printable",
    "sun",
    "io",
    "parallel",
    "compiled",
    "heights",
}
ALLOWED = {
    "spectra": {"spectra", *SHARED},
    "images": {"images", *SHARED},
    "regolith": {"regolith", *SHARED},
    "twin": {"twin", "regolith", "images", *SHARED},
    "pages": {"pages", "spectra", "regolith", "twin", *SHARED},
    "guide": {"guide", "pages", "spectra", "regolith", "images", "twin", *SHARED},
    "reproduce": {"reproduce", "pages", "spectra", "regolith", "images", "twin", *SHARED},
    "rovers": {"rovers", "errors", "io", "names", "ranges"},
}
MODULES = [path for folder in ("lunarsci", "cli", "spectra_data") for path in (ROOT / folder).rglob("*.py")]
LIBRARY = [path for path in MODULES if ROOT / "lunarsci" in path.parents]


@cache
def tree_of(path: Path) -> ast.Module:
    """A module as Python reads it; when a test asks for it, as every worker of pytest imports this file."""
    return ast.parse(path.read_text("utf-8"))


def trees() -> Iterator[tuple[Path, ast.Module]]:
    """Every module, and as Python reads it."""
    return ((path, tree_of(path)) for path in MODULES)


@cache
def imports(tree: ast.AST) -> frozenset[str]:
    """Modules that a module imports, at its head or inside of functions."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found |= {node.module} if node.module != "lunarsci" else {f"lunarsci.{alias.name}" for alias in node.names}
    return frozenset(found)


def part_of(path: Path) -> str:
    return path.relative_to(ROOT / "lunarsci").parts[0].removesuffix(".py")


def test_arrows_point_one_way() -> None:
    for path in LIBRARY:
        used = {name.split(".")[1] for name in imports(tree_of(path)) if name.startswith("lunarsci.")}
        part = part_of(path)
        assert "cli" not in used, f"{path}: the library does not know the command line"
        forbidden = used - ALLOWED.get(part, SHARED)
        assert not forbidden, f"{path}: {part} may not import {forbidden}"


def test_nobody_imports_click() -> None:
    """Newer typer has none; that the library has no command line and does not print are rules of ruff."""
    assert not any(name.split(".")[0] == "click" for _, tree in trees() for name in imports(tree))


def test_cli_reaches_its_siblings_relatively() -> None:
    for path, tree in trees():
        if ROOT / "cli" in path.parents:
            assert not any(name.startswith(("cli", "lunarsci.cli")) for name in imports(tree)), path


def test_every_package_on_disk_is_listed() -> None:
    listed = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    on_disk = {"lunarsci.cli", "lunarsci.spectra_data"}
    on_disk |= {f"lunarsci.cli.{path.parent.name}" for path in (ROOT / "cli").glob("*/__init__.py")}
    for path in (ROOT / "lunarsci").rglob("__init__.py"):
        on_disk.add(".".join(path.parent.relative_to(ROOT).parts))
    assert listed == on_disk


def entries(node: ast.AST, section: str) -> list[str]:
    """Names that a section of a docstring describes: `a, b : ...` are two."""
    lines = (ast.get_docstring(node) or "").splitlines()
    names: list[str] = []
    for first in (k + 2 for k, line in enumerate(lines[:-1]) if line == section and set(lines[k + 1]) == {"-"}):
        for line in itertools.takewhile(bool, lines[first:]):
            if not line.startswith(" "):
                names += line.partition(" : ")[0].split(", ")
    return names


def members(node: ast.ClassDef, classes: dict[str, ast.ClassDef]) -> set[str]:
    """Fields, properties and methods of a class, what it assigns to itself, and those of its bases."""
    names = {entry.target.id for entry in node.body if isinstance(entry, ast.AnnAssign)}
    for part in ast.walk(node):
        if isinstance(part, ast.FunctionDef):
            names.add(part.name)
        elif isinstance(part, ast.Attribute) and isinstance(part.ctx, ast.Store):
            names.add(part.attr)
    bases = [classes[base.id] for base in node.bases if isinstance(base, ast.Name) and base.id in classes]
    return names.union(*(members(base, classes) for base in bases))


def arguments(node: ast.FunctionDef) -> set[str]:
    taken = node.args
    given = [*taken.posonlyargs, *taken.args, *taken.kwonlyargs, taken.vararg, taken.kwarg]
    return {one.arg for one in given if one is not None}


def test_docstrings_describe_what_there_is() -> None:
    """An entry under `Attributes` is a member of its class, one under `Parameters` a parameter."""
    nodes = [(path, node) for path, tree in trees() for node in ast.walk(tree)]
    classes = {node.name: node for _, node in nodes if isinstance(node, ast.ClassDef)}
    described, stale = 0, []
    for path, node in nodes:
        if isinstance(node, ast.FunctionDef):
            named, there = entries(node, "Parameters"), arguments(node)
        elif isinstance(node, ast.ClassDef):
            begin = [part for part in node.body if isinstance(part, ast.FunctionDef) and part.name == "__init__"]
            named = [*entries(node, "Attributes"), *entries(node, "Parameters")]
            there = members(node, classes).union(*map(arguments, begin))
        else:
            continue
        described += len(named)
        stale += [f"{path.relative_to(ROOT)}:{node.name}: {name}" for name in named if name not in there]
    assert described > 2500, "or nothing was looked at"
    assert stale == []


def lengths() -> list[tuple[str, int]]:
    found = []
    for path, tree in trees():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                doc = ast.get_docstring(node, clean=False)
                body = node.end_lineno - node.lineno + 1 - (doc.count("\n") + 1 if doc else 0)
                found.append((f"{path.relative_to(ROOT)}:{node.name}", body))
    return found


OTHER_WORDS = {
    "told": "reported, stated, notify",
    "said": "note, stated",
    "found": "result, detected, or what it is",
    "known": "given, stated, prior",
    "own": "subset, per_…",
    "kept": "inliers, retained, saved",
    "stranger": "outlier",
}
"""Words that say little of what a name stands for, and some of the field's instead."""
KEYS_AND_OPTIONS = {"known", "kept", "kept_share"}
"""Names of options and keys of JSON, which stay for users."""


def test_names_are_words_of_the_field() -> None:
    odd = []
    for path in (path for path in MODULES if ROOT / "spectra_data" not in path.parents):
        for node in ast.walk(tree_of(path)):
            name = getattr(node, "name", None) or getattr(node, "arg", None)
            if isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
                name = node.id if isinstance(node, ast.Name) else node.attr
            if not isinstance(name, str) or isinstance(node, ast.keyword | ast.alias) or name in KEYS_AND_OPTIONS:
                continue
            parts = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower().split("_")
            odd += [f"{path.name}: {name}; rather {OTHER_WORDS[word]}" for word in OTHER_WORDS if word in parts]
    assert odd == []


def test_functions_and_modules_stay_small() -> None:
    assert [row for row in lengths() if row[1] > 60] == []
    assert [p.name for p in MODULES if p.read_text("utf-8").count("\n") > 800] == []


def commands() -> list[tuple[str, int]]:
    """Name and lines of the body of every function that answers a command."""
    found = []
    for path, tree in trees():
        for node in tree.body if ROOT / "cli" in path.parents else ():
            if isinstance(node, ast.FunctionDef) and node.returns and ast.unparse(node.returns) == "Report":
                body = node.body[1:] if ast.get_docstring(node) else node.body
                found.append((node.name, body[-1].end_lineno - body[0].lineno + 1))
    return found


def test_a_command_calls_a_job_and_no_more() -> None:
    assert len(commands()) > 20
    assert [row for row in commands() if row[1] > 15] == []


def test_no_fragment_has_a_single_user() -> None:
    """Commands, which their group names, and jobs, which notebooks name, are what people use."""
    users: Counter[str] = Counter()
    for path, tree in trees():
        users.update(name for name in imports(tree) if name != ".".join(path.relative_to(ROOT).with_suffix("").parts))
    fragments = []
    for path in MODULES:
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        inner = (
            ROOT / "lunarsci" in path.parents
            and path.stem not in ("__init__", "__main__")
            and path.parent.name != "jobs"
        )
        if inner and path.read_text("utf-8").count("\n") < 60 and users[name] < 2:
            fragments.append(name)
    assert fragments == [], "fewer than 60 lines and one user: move them into that user, or into a neighbour"


def test_every_table_row_names_a_known_source() -> None:
    import csv

    folder = ROOT / "spectra_data"
    sources = tomllib.loads((folder / "sources.toml").read_text("utf-8"))
    with (folder / "mgm_bands.csv").open() as file:
        assert {row["source"] for row in csv.DictReader(file)} <= sources.keys()
    assert {entry["table"] for entry in sources.values()} == {
        path.name for suffix in ("csv", "npz") for path in folder.glob(f"*.{suffix}")
    }
    for entry in sources.values():
        assert entry["what"]
        assert entry["citation"]


def test_every_number_of_a_rover_file_has_a_source() -> None:
    for path in (ROOT / "lunarsci/rovers").glob("*.toml"):
        for table in tomllib.loads(path.read_text("utf-8")).values():
            for key, entry in table.items() if isinstance(table, dict) else []:
                assert entry["source"], f"{path.name}: {key}"


def circle_in(arrows: dict[str, set[str]]) -> list[str]:
    try:
        list(graphlib.TopologicalSorter(arrows).static_order())
    except graphlib.CycleError as found:
        return list(found.args[1])
    return []


def test_no_folder_of_the_library_imports_in_a_circle() -> None:
    """At every level, imports inside of functions counted."""
    files = {".".join(path.relative_to(ROOT).with_suffix("").parts): path for path in MODULES}
    folders = {name.removesuffix(".__init__") for name, path in files.items() if path.name == "__init__.py"}
    arrows: dict[str, set[str]] = {}
    for name, path in files.items():
        if ROOT / "lunarsci" in path.parents:
            own = name.rpartition(".")[0]
            used = {part if part in folders else part.rpartition(".")[0] for part in imports(tree_of(path))}
            arrows.setdefault(own, set()).update(used & folders - {own})
    assert sum(map(len, arrows.values())) > 30, "or nothing was looked at"
    assert circle_in(arrows) == []


def modules_named(path: Path, names: dict[str, Path]) -> set[str]:
    """Modules of the project that a file imports, at its head, in functions, for types, or by a string."""
    package = [*path.relative_to(ROOT).with_suffix("").parts][:-1]
    found: set[str] = set()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else []
            base = ".".join([*above, *(node.module.split(".") if node.module else [])])
            inner = {f"{base}.{alias.name}" for alias in node.names}
            found |= inner & names.keys() or {base}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and "." in node.value:
            found |= {node.value.replace("lunarsci.cli", "cli")}
    return found & names.keys()


def test_no_files_import_each_other_in_a_circle() -> None:
    names = {".".join(p.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): p for p in MODULES}
    arrows = {name: modules_named(path, names) - {name} for name, path in names.items()}
    assert sum(map(len, arrows.values())) > 2000, "or nothing was looked at"
    assert circle_in(arrows) == []


def test_no_class_name_is_used_twice() -> None:
    classes = [node.name for _, tree in trees() for node in tree.body if isinstance(node, ast.ClassDef)]
    assert [name for name, count in Counter(classes).items() if count > 1] == []
