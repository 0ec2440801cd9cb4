"""What drives a belief of the soil rests on, how each moved it, and the way back."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from lunarsci.errors import within_file
from lunarsci.figure import file_label
from lunarsci.io.inputs import InputFile, Source, read_input
from lunarsci.options import request_of
from lunarsci.regolith.belief import (
    BeliefDistance,
    SoilBelief,
    compare_beliefs,
    moved_sd,
    parameter_rows,
    past_beliefs,
    read_belief,
    rolled_back,
)
from lunarsci.regolith.prior import PARAMETERS
from lunarsci.result import Doubt, MadeFrom, Result
from lunarsci.twin.ground.driven_soil import doubt_of
from lunarsci.twin.jobs.requests import HistoryRequest

if TYPE_CHECKING:
    from matplotlib.figure import Figure


SOURCES = [
    "Bhattacharyya (1946), Sankhya 7, 401",
    "Kullback & Leibler (1951), Ann. Math. Stat. 22, 79, 10.1214/aoms/1177729694",
]
COPIED = (
    "states",
    "sha256",
    "parent_sha256",
    "forgotten",
    "plan",
    "rover",
    "ground",
    "gravity_m_s2",
    "values",
    "outliers",
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BeliefHistory(Result):
    """The drives of a belief.

    Attributes
    ----------
    source, belief : the file, and what it holds.
    drives : by drive, what it was and what was believed after it.
    other_source, other, distance : the belief beside it; None where none was given.
    rollback, rolled_back : the number of drives, and what was believed after them.
    """

    schema = "twin-history/1"
    source: InputFile
    belief: SoilBelief
    drives: list[dict[str, Any]]
    other_source: InputFile | None
    other: SoilBelief | None
    distance: BeliefDistance | None
    rollback: int | None
    rolled_back: SoilBelief | None

    @property
    def made_from(self) -> MadeFrom:
        files = (self.source, self.other_source)
        return MadeFrom(inputs={file.name: file.sha256 for file in files if file}, sources=SOURCES)

    @property
    def synthetic(self) -> bool:
        """Whether a drive of it was on ground that is made up."""
        return any(bool(entry.get("synthetic")) for entry in self.belief.history)

    @property
    def doubt(self) -> Doubt:
        both = ((self.source, self.belief), (self.other_source, self.other))
        return Doubt.of(*(doubt_of(file.name, belief) for file, belief in both if file))

    def to_dict(self) -> dict[str, Any]:
        back = self.rolled_back
        return {
            "drives": self.drives,
            "doubt": self.belief.doubt or None,
            "caution": self.belief.caution or None,
            "synthetic": self.synthetic,
            "parameters": parameter_rows(self.belief),
            "discrepancy": self.belief.discrepancy.to_dict(),
            "against": None if self.distance is None else asdict(self.distance),
            "rolled_back": None if back is None else {"drives": self.rollback, "parameters": parameter_rows(back)},
        }

    def rows(self) -> list[dict[str, Any]]:
        """One for each number of drives and parameter, from the priors on."""
        first: dict[str, Any] = dict.fromkeys(("states", "plan", "refused", "moved_sd"))
        first |= {"drive": 0, "parameters": parameter_rows(rolled_back(self.belief, 0))}
        rows = []
        for drive in (first, *self.drives):
            for name in PARAMETERS:
                values = (drive["parameters"] or {}).get(name, {})
                head = {key: drive[key] for key in ("drive", "states", "plan")}
                numbers = {key: values.get(key) for key in ("median", "low", "high", "left_of_prior")}
                rows.append(head | {"parameter": name, **numbers, "moved_sd": (drive["moved_sd"] or {}).get(name)})
        return rows

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.regolith.figure import belief_figure, belief_history_figure

        names = (file_label(self.source.name), file_label(self.other_source.name) if self.other_source else "")
        title = f"{names[0]}: belief of the soil by drive"
        yield belief_figure(self.belief, f"{names[0]}: what is believed of the soil", synthetic=self.synthetic)
        yield belief_history_figure(self.belief, title, self.other, names, synthetic=self.synthetic)


def history(belief: Source, request: HistoryRequest | None = None, **options: Any) -> BeliefHistory:
    """What drives a belief rests on, how each moved it, and where it differs from another.

    Raises DataError for files that hold no belief, and for more drives than it rests on.
    """
    asked = request_of(HistoryRequest, request, options)
    source = read_input(belief)
    other = None if asked.against is None else read_input(asked.against)
    one, two = read_belief(source), None if other is None else read_belief(other)
    with within_file(source.name):
        return BeliefHistory(
            source=source,
            belief=one,
            drives=_drives(one),
            other_source=other,
            other=two,
            distance=None if two is None else compare_beliefs(one, two),
            rollback=asked.rollback,
            rolled_back=None if asked.rollback is None else rolled_back(one, asked.rollback),
        )


def _drives(belief: SoilBelief) -> list[dict[str, Any]]:
    steps = zip(belief.history, moved_sd(belief), past_beliefs(belief)[1:], strict=True)
    return [
        {"drive": number}
        | {key: entry.get(key) for key in COPIED}
        | {
            "reduced_chi_square": _reduced(entry),
            "surprise": entry.get("surprise"),
            "refused": entry.get("refused") or None,
            "doubt": entry.get("doubt") or None,
            "caution": entry.get("caution") or None,
            "moved_sd": moved,
            "parameters": None if state is None else parameter_rows(state),
        }
        for number, (entry, moved, state) in enumerate(steps, 1)
    ]


def _reduced(entry: Mapping[str, Any]) -> float | None:
    chi_square, values = entry.get("chi_square"), entry.get("values")
    if isinstance(chi_square, int | float) and isinstance(values, int) and values > 0:
        return float(chi_square) / values
    return None
