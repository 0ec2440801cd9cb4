"""What a job of lunarsci takes and gives: requests made of options, results that are tables, pictures and JSON.

The functions of `import lunarsci` and the commands of the command line are the same jobs: a frozen request holds every
option with its default, and a `Result` has what `--json`, `--csv` and `--plot` show.
"""

import contextlib
import dataclasses
import functools
import inspect
import re
import sys
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from itertools import islice
from types import FrameType
from typing import TYPE_CHECKING, Any, ClassVar, ParamSpec, TypeAlias, TypeVar, get_args

from lunarsci.errors import Failure, LunarSciWarning, ParameterError, worded
from lunarsci.figure import named_picture, shown, styled
from lunarsci.memory import as_named, is_cube, named_within, path_of, results_on_disk
from lunarsci.minerals import WITH_BANDS
from lunarsci.names import some_of
from lunarsci.options import in_python, options_text, request_of
from lunarsci.provenance import Provenance, document, plain, to_json
from lunarsci.ranges import refuse
from lunarsci.units import unit_of

if TYPE_CHECKING:
    from astropy.table import QTable
    from matplotlib.figure import Figure
    from pandas import DataFrame
    from xarray import Dataset


Given = ParamSpec("Given")
Returned = TypeVar("Returned")
Figures: TypeAlias = "Iterator[Figure]"
"""Pictures of a result, page by page."""
Progress: TypeAlias = Callable[[int, int], None]
"""What a job calls as it goes on: how much is done, and how much there is."""
_MINERAL, _OF = f"({'|'.join(WITH_BANDS)})", "(_(low|high|sigma)(68|95)?)?$"
MEANT = (
    (re.compile(f"^([a-z0-9]+_)?{_MINERAL}{_OF}"), "", "share of the mineral, as a fraction of 1"),
    (re.compile(f"^{_MINERAL}_present$"), "", "probability of more than 5 % of the mineral"),
    (re.compile("^probability_of_"), "", "probability that the fit needs it; whether it is there, `unmix` says"),
    (re.compile(f"^{_MINERAL}_in_(mafic|pyroxene){_OF}"), "", "ratio of minerals, as a fraction of 1"),
    (re.compile("^(fo|fs|wo)_"), "%", "composition of the mineral in mol %"),
)
"""Columns whose names tell no unit: unit and meaning in `to_table`."""
FINE = ("ok", "converged")
NO_VALUE = ("beyond_range", "no_channels", "undefined")
"""What a `status` says of a value that may be used, and of one that may not."""
NOT_TO_BE_TRUSTED = "not to be trusted"
UNMOVED = 0.9
"""Share of a prior's standard deviation above which a value is the prior's; assumed."""
AS_PRIOR = "the prior's: the spectrum says nothing"


def doubt_about(record: Mapping[str, Any]) -> str:
    """Why the values of an object of a result should not be used, where it says so; '' where they may be.

    >>> doubt_about({"mean": 104.8, "in_range": False, "lowest": 0.0, "highest": 100.0})
    'beyond 0-100, where the trend was measured'
    """
    reason = record.get("reason") or record.get("status")
    doubt = reason if isinstance(reason, str) and reason not in FINE else ""
    if not doubt and record.get("in_range") is False and "lowest" in record:
        doubt = f"beyond {record['lowest']:g}-{record['highest']:g}, where the trend was measured"
    outside = any(record.get(flag) is False for flag in ("in_range", "in_domain"))
    if outside or record.get("status") in NO_VALUE:
        return doubt or "out of range"
    return "not determined: most of it is the prior's" if record.get("determined") is False else ""


def from_prior(sigma: float | None, prior_sigma: float) -> bool:
    """Whether a value is the prior's, as its error is hardly less than before the data were seen."""
    return sigma is None or sigma > UNMOVED * prior_sigma


def flat(record: Mapping[str, Any]) -> dict[str, Any]:
    """Nested values under joined names; tuples and lists as text.

    >>> flat({"name": "OPX 1", "shrinkage": {"center": 0.5}, "notes": ["a", "b"]})
    {'name': 'OPX 1', 'shrinkage_center': 0.5, 'notes': 'a b'}
    """
    row: dict[str, Any] = {}
    for key, value in record.items():
        if isinstance(value, Mapping):
            row |= {f"{key}_{inner}": item for inner, item in value.items()}
        else:
            row[key] = " ".join(map(str, value)) if isinstance(value, list | tuple) else value
    return row


@dataclass(frozen=True, slots=True, kw_only=True)
class MadeFrom:
    """What a result was made from, for its provenance.

    Attributes
    ----------
    inputs, tables : name to SHA-256, of what the user gave and of what came with lunarsci.
    sources : what to cite.
    seed : of the random numbers, None where none are drawn.
    options : what was taken for options that were left out.
    """

    inputs: Mapping[str, str] = field(default_factory=dict)
    tables: Mapping[str, str] = field(default_factory=dict)
    sources: Sequence[str] = ()
    seed: int | None = None
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Asked:
    """Which function was called, as its users know it, every option, resolved, and what it warned of."""

    command: str
    options: Mapping[str, Any]
    warnings: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class Doubt:
    """Why a result should not be trusted or acted on; false where it may be, as text one sentence.

    Attributes
    ----------
    reasons : the most important first.
    verdict : what they mean, such as `not to be trusted`; the sentence begins with it.
    """

    reasons: tuple[str, ...] = ()
    verdict: str = ""

    @classmethod
    def of(cls, *reasons: object, verdict: str = "") -> "Doubt":
        """Of reasons as text, empty ones left out; another doubt is one reason."""
        return cls(tuple(filter(None, map(str, reasons))), verdict)

    def __bool__(self) -> bool:
        return bool(self.reasons)

    def __str__(self) -> str:
        return ": ".join(filter(None, (self.verdict, "; ".join(self.reasons)))) if self else ""


OF_RESULTS = {"rocks", "results", "request", "progress"}
"""Parameters of jobs that take results themselves, not the files of them, or no input."""
OF_PATHS = {"cube", "predicted", "stations", "terrain", "terrains", "trials"}
"""Parameters of jobs whose readers take paths alone."""
NAMES = ("id", "rock", "name", "parameter", "quantity", "layer")
"""Columns of which the first that is there names a row."""
FIRST = 4
"""Values of the first row that a result shows of itself."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Result(ABC):
    """What a job found; a job's own result says `to_dict`, `rows`, `figures`, `made_from` and `doubt`.

    `print` shows the first screen of its command, a notebook answer, table and picture; `len` and an index, or a name,
    give its rows, one of each thing. Two are equal where `to_json(time=False)` is.

    Of many things alike it has `content` instead of `to_dict`, and gives their `Records` there and as `rows`.

    Attributes
    ----------
    schema : name and version of its JSON, such as `spectra-fit/1`.
    page_title : what it is called on a page of `lunarsci report`, such as `Minerals`.
    sources : what to cite for all results of the class.
    made_from : what it was made from: `sources`, and its attributes `inputs`, `tables` and `seed` if it has them.
    doubt : why it should not be trusted or acted on, reason by reason.
    untrusted : the same as one sentence; '' if it may be.
    failures : inputs that gave no result, one sentence each.
    asked : what it was asked with, where a function of lunarsci made it.
    """

    schema: ClassVar[str] = ""
    page_title: ClassVar[str] = ""
    sources: ClassVar[Sequence[str]] = ()
    asked: Asked | None = field(default=None, compare=False)

    def __init_subclass__(cls, **more: Any) -> None:
        # A dataclass leaves a method that is there alone; one made of all fields would fill pages.
        cls.__repr__ = Result.__repr__  # type: ignore[method-assign]
        cls.__eq__, cls.__hash__ = Result.__eq__, Result.__hash__  # type: ignore[method-assign]
        for name in {"to_dict", "made_from"} & vars(cls).keys():
            setattr(cls, name, _with_names(vars(cls)[name]))

    def __repr__(self) -> str:
        made_by = f" of {self.asked.command}" if self.asked else ""
        first = plain(self[0]).items() if len(self) else ()
        words = [f"{key} {value}" for key, value in first if isinstance(value, str) and key != "source"][:1]
        numbers = [
            f"{key} {value}" if isinstance(value, bool) else f"{key} {value:.5g}"
            for key, value in first
            if isinstance(value, int | float)
        ]
        shown = [*words, *numbers][:FIRST]
        rows = f"{len(self)} row{'s' if len(self) != 1 else ''}{', the first: ' if shown else ''}{', '.join(shown)}"
        doubt = "; .untrusted says why not to trust it" if self.untrusted else ""
        return (
            f"<{type(self).__name__}{made_by}, {rows}; .to_table(), .plot(), .to_dict() and .to_json() have all{doubt}>"
        )

    def __len__(self) -> int:
        return len(self.rows_each())

    def __getitem__(self, index: Any) -> Any:
        """Rows as of `rows_each`, one or some by their numbers, or one by its name.

        Raises KeyError for a name that no row has, IndexError for a number beyond them.
        """
        rows = self.rows_each()
        if isinstance(index, str):
            key = next((name for name in NAMES if len(rows) and name in rows[0]), "")
            named = {str(row[key]): row for row in rows} if key else {}
            if index not in named:
                raise KeyError(f"no row is called '{index}'; there are {some_of(list(named), FIRST) or 'no names'}")
            return named[index]
        if isinstance(index, int) and not -len(rows) <= index < len(rows):
            raise IndexError(f"row {index}: there are {len(rows)}, the first is 0")
        return rows[index]

    def __bool__(self) -> bool:
        return True

    def __eq__(self, other: object) -> bool:
        """Whether another result of the kind says the same of the same, whenever it was made."""
        if not isinstance(other, Result) or type(self) is not type(other):
            return False
        return self is other or self.to_json(time=False) == other.to_json(time=False)

    def __hash__(self) -> int:
        return hash(self.schema)

    def __str__(self) -> str:
        return str(_renderer().as_text(self))

    def to_text(self) -> str:
        """All that its command prints with `--verbose`; `print` shows the first screen of it."""
        return str(_renderer().as_whole_text(self))

    @property
    def made_from(self) -> MadeFrom:
        given = {name: getattr(self, name) for name in ("inputs", "tables", "seed") if hasattr(self, name)}
        return MadeFrom(sources=self.sources, **given)

    @property
    def doubt(self) -> Doubt:
        return Doubt()

    @property
    def untrusted(self) -> str:
        return in_python(str(self.doubt))

    @property
    def failures(self) -> Sequence[Failure]:
        return ()

    def to_dict(self) -> dict[str, Any]:
        """The `result` of `--json`, in plain Python, keys with their units."""
        made: dict[str, Any] = plain(self.content())
        return made

    def content(self) -> Mapping[str, Any]:
        """The same, where lists of many records may be `Records`."""
        return self.to_dict()

    @abstractmethod
    def rows(self) -> Sequence[Mapping[str, Any]]:
        """The rows of `--csv`."""

    def may_have(self, key: str) -> Collection[str]:
        """Names that stand below a key of `to_dict` where there is something to say of them, and else do not."""
        return ()

    @staticmethod
    def page_answer(result: Mapping[str, Any]) -> str:
        """The answer of a page in a sentence or two, of what `to_dict` gave."""
        return "Its numbers are below."

    def rows_each(self) -> Sequence[Mapping[str, Any]]:
        """The same where none of the columns wanted is of a part, as a band of a spectrum is: one of each thing."""
        return self.rows()

    def figures(self) -> Figures:
        """The pages of `--plot`."""
        return iter(())

    def answers(self) -> Sequence[Mapping[str, Any]]:
        """The rows of `to_table`: those of `--csv`, but where these are the steps to an answer."""
        return self.rows()

    def as_input(self, role: str) -> Mapping[str, Callable[[], bytes]]:
        """The file that an input of that name is read from where it is this result, or the files of a folder."""
        return {}

    def to_table(self, *, parts: bool = True) -> "QTable":
        """The answer as a table; a column with a unit in its name is a quantity, missing numbers are NaN.

        Without `parts` there is one row of each thing, as of a spectrum, and not one of each of its bands.
        """
        from astropy.table import QTable
        from astropy.units import Unit

        rows = [plain(row) for row in (self.answers() if parts else self.rows_each())]
        names = list(dict.fromkeys(name for row in rows for name in row))
        table = QTable({name: _column(name, [row.get(name) for row in rows]) for name in names})
        for name in names:
            if (meant := next((one for one in MEANT if one[0].search(name)), None)) and table[name].dtype.kind == "f":
                table[name] = table[name] << Unit(meant[1])
                table[name].info.description = meant[2]
        return table

    def to_pandas(self, *, parts: bool = True) -> "DataFrame":
        """The same table as a DataFrame, units in the names of its columns; lists of a cell are text."""
        from pandas import DataFrame

        return DataFrame([flat(plain(row)) for row in (self.answers() if parts else self.rows_each())])

    def layers(self) -> Mapping[str, tuple[tuple[str, ...], Any]]:
        """Of a grid its axes, which are named as themselves, and what lies on them: names of axes, and values."""
        return {}

    def to_xarray(self) -> "Dataset":
        """A grid as a Dataset: heights, maps of ground, designs, drives by time. ParameterError where there is none."""
        layers = self.layers()
        refuse({f"a {type(self).__name__} is no grid; to_pandas() has its table": not layers})
        try:
            from xarray import Dataset
        except ImportError as error:
            raise ParameterError("grids need xarray; pip install 'lunarsci[cubes]'") from error
        made = {name: (axes, values, {"units": unit_of(name)}) for name, (axes, values) in layers.items()}
        return Dataset(made, attrs={"schema": f"lunarsci/{self.schema}"}).set_coords(
            [name for name, (axes, _) in layers.items() if axes == (name,)]
        )

    def provenance(self) -> Provenance:
        """What it was made from, with what, and what is in doubt."""
        made = self.made_from
        return Provenance(
            command=self.asked.command if self.asked else f"lunarsci.{type(self).__name__}",
            options=(dict(self.asked.options) if self.asked else {}) | dict(made.options),
            inputs=made.inputs,
            tables=made.tables,
            sources=made.sources,
            seed=made.seed,
            warnings=self.asked.warnings if self.asked else (),
            untrusted=self.untrusted,
            failures=self.failures,
        )

    def to_json(self, *, time: bool = True) -> str:
        """The document of `--json`; without `time` two equal results give equal text."""
        return as_named(to_json(document(self.schema, self.content(), self.provenance().to_dict(time=time))))

    def plot(self, page: int | str = 0) -> "Figure":
        """A page of `--plot`, from 0, or the first that names something, such as a spectrum; a notebook shows it.

        Raises ParameterError where there is no such page.
        """
        with styled():
            if isinstance(page, str):
                figure = named_picture(self.figures(), page)
            else:
                figure = next(islice(self.figures(), page, None), None)
        if figure is None:
            raise ParameterError(f"page {page!r} is none of this result's, {sum(1 for _ in self.figures())} in all")
        return shown(figure)

    def _repr_html_(self) -> str:
        return str(_renderer().as_html(self))


def _renderer() -> Any:
    """What makes the text and the HTML of a result: it stands above the library, whose package names it."""
    return import_module("lunarsci")._renderer()


def _with_names(member: Any) -> Any:
    """A method or property of a result, in what it gives the names of inputs in memory, not the paths they lie at."""
    if isinstance(member, property):
        return property(_with_names(member.fget))
    if hasattr(member, "__wrapped__"):  # a dataclass with slots is made twice
        return member
    return functools.wraps(member)(lambda self: named_within(member(self)))


def job(function: Callable[Given, Returned]) -> Callable[Given, Returned]:
    """A function of `import lunarsci`: its result knows what it was asked with, and its help names every option.

    Its parameter `request` is a dataclass or None, `options` by name replace fields of it.
    """
    kind: Any = next(filter(dataclasses.is_dataclass, get_args(function.__annotations__["request"])))
    signature = inspect.signature(function)

    @functools.wraps(function)
    def run(*args: Given.args, **options: Given.kwargs) -> Returned:
        caller = sys._getframe(1)
        with worded(str if _is_inside(caller) else in_python), _heard(caller) as heard:
            bound = signature.bind(*_together(args, kind, signature), **options)
            arguments, replaced = bound.arguments, bound.arguments.pop("options", {})
            for name in {*arguments} - OF_RESULTS:
                read = path_of if name in OF_PATHS else results_on_disk
                arguments[name] = read(name, arguments[name])
            request = arguments["request"] = request_of(kind, arguments.get("request"), replaced)
            result = function(*bound.args, **bound.kwargs)
        fields = {item.name: named_within(plain(getattr(request, item.name))) for item in dataclasses.fields(request)}
        object.__setattr__(result, "asked", Asked(f"lunarsci.{function.__name__}", fields, heard))
        return result

    text, heading, examples = (inspect.getdoc(function) or "").partition("\n\nExamples\n")
    run.__doc__ = f"{text}\n\n{options_text(kind)}{heading}{examples}"
    return run


def _together(args: tuple[Any, ...], kind: type, signature: inspect.Signature) -> tuple[Any, ...]:
    """What a function was called with; arrays of a spectrum or cube one after the other are one input."""
    first = next(iter(signature.parameters))
    if first == "cube" and is_cube(args[:2]):
        return args[:2], *args[2:]
    arrays = first == "spectra" and len(args) in (2, 3)
    return (args,) if arrays and not isinstance(args[1], kind | None) else args


def _is_inside(caller: FrameType) -> bool:
    """Whether a caller is inside lunarsci, such as the command line, which words for itself what its users read."""
    return str(caller.f_globals.get("__name__")).startswith("lunarsci.")


@contextlib.contextmanager
def _heard(caller: FrameType) -> Iterator[list[str]]:
    """Lunarsci's warnings, each once; in the end they are passed on as of the user's line.

    A caller inside lunarsci, such as the command line, hears them by itself.
    """
    heard: list[str] = []
    if _is_inside(caller):
        yield heard
        return
    show = warnings.showwarning

    def hear(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if not issubclass(category, LunarSciWarning):
            show(message, category, *where, **more)
        elif (text := in_python(str(message))) not in heard:
            heard.append(text)

    as_errors = next((how[0] for how in warnings.filters if issubclass(LunarSciWarning, how[2])), "") == "error"
    try:
        with warnings.catch_warnings():
            if not as_errors:
                warnings.simplefilter("always", LunarSciWarning)
            warnings.showwarning = hear
            yield heard
    finally:
        seen = caller.f_globals.setdefault("__warningregistry__", {})
        for text in heard:
            warnings.warn_explicit(text, LunarSciWarning, caller.f_code.co_filename, caller.f_lineno, registry=seen)


def _column(name: str, cells: list[Any]) -> Any:
    import numpy as np
    from astropy import units

    present = [cell for cell in cells if cell is not None]
    if present and all(isinstance(cell, int | float) and not isinstance(cell, bool) for cell in present):
        whole = len(present) == len(cells) and all(isinstance(cell, int) for cell in cells)
        values = np.array([np.nan if cell is None else cell for cell in cells], int if whole else float)
        return values * units.Unit(unit) if (unit := unit_of(name)) else values
    if present and all(isinstance(cell, bool) for cell in cells):
        return np.array(cells, bool)
    if not present:
        missing = np.full(len(cells), np.nan)
        return missing * units.Unit(unit) if (unit := unit_of(name)) else missing
    return np.array(["" if cell is None else str(cell) for cell in cells])
