"""Where every number of the tables comes from, as Markdown, from the tables."""

import ast
import csv
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "spectra_data"
ROVERS = (*sorted((ROOT / "lunarsci/rovers").glob("*.toml")), ROOT / "lunarsci/images/rigs.toml", 
          ROOT / "lunarsci/twin/plans/plan.toml")  # fmt: skip
SOILS = (ROOT / "lunarsci/regolith/soils.toml", ROOT / "lunarsci/regolith/priors.toml")
ROWS = (ROOT / "lunarsci/regolith/reference_soils.csv", ROOT / "lunarsci/regolith/lateral_soils.csv")


STATED = re.compile(r"\b(?:1[89]|20)\d\d\b|10\.\d{4,9}/|assumed|measured|SP-\d+", re.IGNORECASE)
"""A year, a DOI, a report's number, or that it is assumed or was measured."""


class Stated(NamedTuple):
    """A number or a row of numbers: where it stands, what it is, where it comes from, and whether it is a guess."""

    file: str
    name: str
    source: str
    assumed: bool


def of_tables() -> dict[str, dict[str, str]]:
    """The entries of `sources.toml`, each with its table."""
    return tomllib.loads((FOLDER / "sources.toml").read_text("utf-8"))


def _entries(document: dict[str, object], file: str, above: str = "") -> Iterator[Stated]:
    """Numbers of a file whose values are tables with `value` and `source`."""
    for key, entry in document.items():
        if isinstance(entry, dict) and "value" in entry:
            yield Stated(file, above + key, str(entry.get("source", "")), bool(entry.get("assumed")))
        elif isinstance(entry, dict):
            yield from _entries(entry, file, f"{above}{key}.")


def of_rovers() -> Iterator[Stated]:
    """Every number of rovers, wheels, camera rigs and the limits of the embedded plan."""
    for path in ROVERS:
        yield from _entries(tomllib.loads(path.read_text("utf-8")), path.name)


def of_soils() -> Iterator[Stated]:
    """Soils and priors by name, and the rows of soils of the literature."""
    for path in SOILS:
        for name, soil in tomllib.loads(path.read_text("utf-8")).items():
            yield Stated(path.name, name, soil.get("source", ""), False)
    for path in ROWS:
        with path.open(newline="", encoding="utf-8") as file:
            for row in csv.DictReader(file):
                yield Stated(path.name, row["name"], row["source"], False)


def of_published() -> Iterator[Stated]:
    """Published numbers that `lunarsci reproduce` sets beside its own, each with its place in the paper."""
    from lunarsci.constants import PAPER

    path = ROOT / "lunarsci/reproduce/published.csv"
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            yield Stated(path.name, f"{row['id']}: {row['quantity']}", f"{PAPER}: {row['passage']}", False)


CITED = re.compile(
    r"(?:\b[A-Z][\w&.'-]+|et al\.),? \(?(?:1[89]|20)\d\d\b(?! nm)|10\.\d{4,9}/\S|[Aa]ssumed|SP-\d+|by definition"
    r"|[Mm]easured(?! (?:to|mean|error|quantit|state|share|value|spectr))|tests/benchmarks/"
)
"""An author with a year, a DOI, a report's number, or how else the number was found: `STATED`, but for prose."""
REFERS = re.compile(r"(?:[Ss]ee|[Aa]s) `(?:\w+\.)*([A-Z_]\w*)`")
"""Another constant that has the source."""
UNIT = re.compile(r"(.*?\.?)(?: (\[[^\[\]]+\]\.?))?", re.DOTALL)
"""What is said, and the unit behind it."""
UNITS = re.compile(r"_(?:[NUMCK]?M|M2|PX|DEG|RAD|M?S|K?PA|N|W|WH|KG|K|KELVIN|HZ|MA|AU|KG_M3|W_M2|M_S|M_S2)$")
"""Ends of names of whole numbers that have a unit."""


def of_constants(folder: Path = ROOT / "lunarsci") -> Iterator[Stated]:
    """Numbers that modules name in capitals, with what stands below them, beside them, or above their block."""
    for path in sorted(folder.rglob("*.py")):
        text = path.read_text("utf-8")
        lines, body = text.splitlines(), ast.parse(text).body
        for node, below in zip(body, [*body[1:], None], strict=True):
            if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
                continue
            target = ast.unparse(node.targets[0] if isinstance(node, ast.Assign) else node.target).strip("()")
            if not target.lstrip("_").isupper() or not _has_number(node.value, target):
                continue
            said = [entry.value for entry in ast.walk(node.value) if isinstance(entry, ast.Constant)]
            words = (
                [word for word in said if isinstance(word, str) and " " in word[8:]]
                if isinstance(node.value, ast.Call)
                else []
            )
            if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
                words.insert(0, str(below.value.value))
            words += re.findall(r"# (?!fmt|noqa|type)(.*)", "\n".join(lines[node.lineno - 1 : node.end_lineno]))
            above = node.lineno - 1
            while above and re.match(r"[A-Z_]", lines[above - 1]):
                above -= 1
            while above and lines[above - 1].startswith("#"):
                above -= 1
                words.insert(0, lines[above].removeprefix("#"))
            source = " ".join(" ".join(words).split())
            name = f"{target} = {ast.unparse(node.value)}"
            yield Stated(path.relative_to(folder.parent).as_posix(), name, source, "assumed" in source.lower())


def _has_number(node: ast.expr, name: str) -> bool:
    """Whether it is a number of the world, or several, and not a place in a row or a text."""
    if isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Call) and ast.unparse(node.func) == "range"):
        return False
    numbers = [type(entry.value) for entry in ast.walk(node) if isinstance(entry, ast.Constant)]
    return float in numbers or (int in numbers and any(UNITS.search(one) for one in name.split(", ")))


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "/").replace("<", "&lt;")


PART = r"(?:\([^\s()]*\)|[^\s,;()])"
"""A letter of a DOI, or several in brackets."""


def linked(text: str) -> str:
    """The same with DOIs as links."""
    return re.sub(rf"(?<![/\w.])(10\.\d{{4,9}}/{PART}*(?<![.:]))", r"[\1](https://doi.org/\1)", text)


def _table(rows: Iterator[Stated]) -> str:
    lines = ["| what | source |", "| --- | --- |"]
    for row in rows:
        said = linked(_cell(row.source))
        guess = row.assumed and not row.source.lower().startswith("assumed")
        lines.append(f"| `{row.file}` {_cell(row.name)} | {'**assumed**: ' if guess else ''}{said} |")
    return "\n".join(lines)


def sources_text() -> str:
    """All sources: of the tables, of rovers and cameras, of soils, of the numbers of the paper."""
    lines = ["| what | source |", "| --- | --- |"]
    for entry in of_tables().values():
        where = entry.get("doi") or entry.get("url", "")
        link = f" [{where}]({'https://doi.org/' if 'doi' in entry else ''}{where})" if where else ""
        lines.append(f"| `{entry['table']}` {_cell(entry['what'])} | {linked(_cell(entry['citation']))}{link} |")
    parts = {
        "Tables of spectra": "\n".join(lines),
        "Works that `lunarsci cite` names": works_text(),
        "Rovers, wheels, cameras and limits": _table(of_rovers()),
        "Soils and priors": _table(of_soils()),
        "Numbers of Ding et al. (2024)": _table(of_published()),
    }
    return "\n\n".join(f"## {name}\n\n{text}" for name, text in parts.items())


def works_text() -> str:
    """The works of `references.toml`, with what of them was recalled and the tables that rest on them."""
    lines = [
        "Authors, titles and places are as an index record, a reference list or a public bibliography has them, which "
        "does not say that the work itself was read. What was written down from memory is called recalled; no DOI is. "
        "Of six works no title was found, one here and five that the soils below cite by author, year and place.",
        "",
        "| key | work | tables |",
        "| --- | --- | --- |",
    ]
    for name, work in tomllib.loads((FOLDER / "references.toml").read_text("utf-8")).items():
        who = work.get("author", work.get("editor", "")).strip("{}").split(" and ")
        names = " and ".join(who) if len(who) < 4 else f"{who[0]} and others"
        place = " ".join(work[one] for one in ("journal", "booktitle", "institution", "publisher") if one in work)
        parts = [
            work.get("title", "title not found"),
            f"{place} {work.get('volume', work.get('number', ''))}".strip(),
            work.get("pages"),
        ]
        said = ", ".join(
            str(part).replace("--", "-") for part in [*parts, work.get("doi"), work.get("howpublished")] if part
        )
        tables = ", ".join(f"`{one}`" for one in work.get("tables", ()))
        year = f" ({work['year']})" if "year" in work else ""
        recalled = f" (recalled: {work['recalled']})" if "recalled" in work else ""
        lines.append(f"| `{name}` | {linked(_cell(f'{names}{year}, {said}'))}{recalled} | {tables} |")
    return "\n".join(lines)


def constants_text() -> str:
    """Constants of the code that cite a source, were measured, or are assumed; a table for each of its packages."""
    parts: dict[str, list[str]] = {}
    for row in of_constants():
        if CITED.search(row.source) or REFERS.search(row.source):
            said, unit = UNIT.fullmatch(row.source).groups()  # type: ignore[union-attr]
            name = row.name if len(row.name) < 80 else f"{row.name[:70]} …"
            _, package, *rest = row.file.split("/")
            what = f"`{'/'.join(rest) or package}` `{_cell(name)}` {unit or ''}"
            part = f"lunarsci/{package}" if rest else "lunarsci"
            parts.setdefault(part, ["| what | source |", "| --- | --- |"]).append(f"| {what} | {linked(_cell(said))} |")
    return "\n\n".join("\n".join((f"### `{part}`\n", *rows)) for part, rows in sorted(parts.items()))
