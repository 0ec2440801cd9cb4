"""Write a report: pictures and files first, so that nothing is printed when one of them cannot be written."""

import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lunarsci.atomic import write_files
from lunarsci.errors import OutputError, ParameterError
from lunarsci.printable import printable
from lunarsci.provenance import Provenance, document, json_chunks, plain

from .options import Output
from .report import Report
from .table import render, to_csv
from .talk import say

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def emit(report: Report, output: Output, provenance: Provenance) -> None:
    """Write the pictures and the result, then say what was written and what to know about it."""
    contents: dict[Path, bytes | Iterable[bytes]] = {}
    if output.plot:
        contents[output.plot] = _picture(report.figures, output.plot)
    contents |= {target: _picture(draw, target) for target, draw in report.pictures.items()}
    contents |= {target: make() for target, make in report.extras.items()}
    record = provenance.to_dict(time=not output.no_time)
    made = _as_file(report, output, record)
    text: Iterable[bytes] = () if made else _as_text(report, output, record)
    if output.path and output.folder:
        contents.update({output.path / name: make() for name, make in report.files.items()})
        contents[output.path / "result.json"] = json_chunks(document(report.schema, report.result, record))
    elif output.path and not report.written:
        contents[output.path] = made or text
    write_files(contents, force=output.force, folder=output.path if output.folder else None)
    for path in (*report.written, *contents):
        say(f"written: {path}", quiet=output.quiet)
    if output.folder or not output.path or report.written:
        _print(text)
    for failure in report.failures:
        say(f"error: {failure}")
    if report.untrusted:
        say(report.untrusted)


def _print(text: Iterable[bytes]) -> None:
    if sys.stdout is None:
        raise OutputError("stdout is closed; use -o FILE")
    terminal = sys.stdout.isatty()
    try:
        for piece in text:
            sys.stdout.write("\n".join(map(printable, piece.decode().split("\n"))) if terminal else piece.decode())
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        raise OutputError(f"stdout: {error.strerror}; the result was not printed") from error


def _as_file(report: Report, output: Output, record: Mapping[str, Any]) -> bytes | None:
    """The content of a file in one of the report's own formats; None where the result is wanted as text."""
    asked = output.as_json or output.as_csv or output.field_path is not None
    if asked or output.folder or not output.path:
        return None
    make = report.formats.get(output.path.suffix.lower())
    return make(record) if make else None


def _as_text(report: Report, output: Output, record: Mapping[str, Any]) -> Iterable[bytes]:
    """The result as it is wanted, in pieces."""
    suffix = output.path.suffix.lower() if output.path and not output.folder else ""
    if output.field_path is not None:
        return [f"{_field(report.result, output.field_path)}\n".encode()]
    if output.as_json or (suffix == ".json" and not output.as_csv):
        return json_chunks(document(report.schema, report.result, record))
    if output.as_csv or suffix == ".csv":
        if report.rows is None:
            raise ParameterError("this result is no table; use --json")
        return to_csv(report.rows)
    return [render(report.tables() if callable(report.tables) else report.tables).encode()]


def _field(result: Any, path: str) -> str:
    value = _opened(result)
    steps = path.split(".")
    for depth, step in enumerate(steps[1:] if steps[0] == "result" else steps):
        if value is None and depth:
            return "null"
        try:
            value = _opened(value[int(step)] if _is_list(value) else value[step])
        except (KeyError, IndexError, ValueError, TypeError):
            known = _known(value)
            raise typer.BadParameter(f"--field {path}: no '{step}' at level {depth + 1}; there is: {known}") from None
    found = plain(value)
    return found if isinstance(found, str) else json.dumps(found, sort_keys=True, ensure_ascii=False)


def _opened(value: Any) -> Any:
    """A value that a step can lead into; what lies deeper is left as it is."""
    if isinstance(value, Mapping):
        return {str(key): item for key, item in value.items()}
    return value if _is_list(value) else plain(value)


def _is_list(value: Any) -> bool:
    """Whether a step into it is a number: a list, or records of many things alike."""
    return isinstance(value, Sequence) and not isinstance(value, str | tuple)


def _known(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(sorted(value))
    return f"0 to {len(value) - 1}" if _is_list(value) and value else "nothing below it"


def _picture(draw: "Callable[[], Iterable[Figure]] | None", target: Path) -> bytes:
    if draw is None:
        raise ParameterError("there is nothing to draw; leave --plot out")
    from lunarsci.figure import picture_bytes

    return picture_bytes(draw(), target)
