"""What a command hands over to be shown."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lunarsci.errors import Failure

from .printing import names_of
from .table import TextTable
from .talk import FAILED, UNTRUSTED

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from lunarsci.result import Result


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """What a command found, before it is known how it will be shown.

    Attributes
    ----------
    schema : name and version of the JSON result, such as `spectra-fit/1`.
    result : the result, keys with their units; in plain Python, but that long lists may be `Records`.
    tables : the same for people, or what makes it, where that takes time that a file need not wait for.
    rows : the same as one table for `--csv`; None where the result is no table.
    may_have : names that may stand below a key of the result, or be lacking; as of `Result`.
    rows_each : makes the rows where no column wanted is of a part, as a band of a spectrum is; None for `rows`.
    figures : draws the pictures of `--plot`, one per page; None where there is nothing to draw.
    pictures : further pictures that were asked for, by the file that takes them.
    extras : further files that were asked for, such as films, by name.
    inputs, data_tables, sources, seed : for the provenance.
    formats : file suffixes of `--output` beyond .json and .csv, with what makes such a file from the provenance.
    files : for commands that fill a folder: file name to what makes its content.
    written : files that the job wrote itself, since they may not fit into memory; the result then goes to stdout.
    untrusted : one sentence, why the result is printed but should not be trusted or acted on; empty if it may be.
    failures : inputs that gave no result, one sentence each.
    options : what was taken for options that were left out, for the provenance.
    raw : makes a text that is the result itself, such as a file to begin with, and is shown as it is.
    stored : document of a result that is there, which paths of `--field` lead into that begin with `result`.
    """

    schema: str
    result: Mapping[str, Any]
    tables: Sequence[TextTable] | Callable[[], Sequence[TextTable]]
    rows: Sequence[Mapping[str, Any]] | None = None
    may_have: Callable[[str], Collection[str]] = lambda key: ()
    rows_each: Callable[[], Sequence[Mapping[str, Any]]] | None = None
    figures: Callable[[], "Iterable[Figure]"] | None = None
    pictures: Mapping[Path, Callable[[], "Iterable[Figure]"]] = field(default_factory=dict)
    extras: Mapping[Path, Callable[[], bytes]] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict)
    data_tables: Mapping[str, str] = field(default_factory=dict)
    sources: Sequence[str] = ()
    seed: int | None = None
    formats: Mapping[str, Callable[[Mapping[str, Any]], bytes]] = field(default_factory=dict)
    files: Mapping[str, Callable[[], bytes]] = field(default_factory=dict)
    written: Sequence[Path] = ()
    untrusted: str = ""
    failures: Sequence[Failure] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    raw: Callable[[], str] | None = None
    stored: Mapping[str, Any] | None = None

    def with_reasons(self, worded: Callable[[str], str]) -> "Report":
        """With the reasons of its failures, why it is not to be trusted, and how it was read, as `worded` has them."""
        lines = self.result.get("read_as")
        result = {**self.result, "read_as": [*map(worded, lines)]} if isinstance(lines, list | tuple) else self.result
        failures = [one.worded(worded) for one in self.failures]
        return replace(self, untrusted=worded(self.untrusted), failures=failures, result=result)

    @classmethod
    def of(
        cls, result: "Result", tables: Sequence[TextTable] | Callable[[], Sequence[TextTable]], **more: Any
    ) -> "Report":
        """The report of a job's result; `more` are other attributes."""
        made = result.made_from
        parts: dict[str, Any] = {
            "rows": result.rows(),
            "may_have": result.may_have,
            "rows_each": result.rows_each,
            "figures": result.figures,
            "inputs": made.inputs,
            "data_tables": made.tables,
            "sources": made.sources,
            "seed": made.seed,
            "options": made.options,
            "untrusted": result.untrusted,
            "failures": result.failures,
        }
        return cls(schema=result.schema, result=result.content(), tables=tables, **(parts | more))

    def rows_with(self, columns: Sequence[str]) -> Sequence[Mapping[str, Any]] | None:
        """The rows for some columns of `--csv`: one of each thing, unless one of them is a column of its parts."""
        each = self.rows_each() if self.rows_each and columns else None
        names = {name.casefold() for name in names_of(each)} if each is not None else set()
        return each if names.issuperset(name.casefold() for name in columns) and columns else self.rows

    @property
    def exit_code(self) -> int:
        """0 done, 1 some input failed, 3 finished but not to be trusted or not safe."""
        if self.failures:
            return FAILED
        return UNTRUSTED if self.untrusted else 0
