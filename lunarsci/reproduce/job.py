"""The numbers of Ding et al. (2024) beside what follows from what is published: all, or those of a part."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from matplotlib.figure import Figure

from lunarsci.constants import PAPER
from lunarsci.io.inputs import expand_inputs, read_input
from lunarsci.io.tables import table_hashes
from lunarsci.options import request_of
from lunarsci.provenance import sha256
from lunarsci.regolith.compare import reference_hash, reference_soils, sources_of
from lunarsci.regolith.prior import prior_hash
from lunarsci.regolith.soil import soil_hash
from lunarsci.regolith.wheel import read_wheel
from lunarsci.reproduce.drive import SOIL, Drives, drive_numbers, drive_pages, predicted_drives
from lunarsci.reproduce.numbers import VERDICTS, Number, published_hash
from lunarsci.reproduce.requests import WORK, ReproduceRequest
from lunarsci.reproduce.soil import soil_numbers, soil_pages
from lunarsci.reproduce.spectra import TABLES, Rocks, boulders, fit_rocks, spectra_numbers, spectra_pages
from lunarsci.result import MadeFrom, Progress, Result
from lunarsci.rovers import RoverDescription, read_rover
from lunarsci.spectra.readers.dispatch import read_spectra
from lunarsci.twin.rover import build_rover

ROVER = "yutu2"


@dataclass(frozen=True, slots=True)
class Reproduction(Result):
    """The numbers, and what they and the figures are made from.

    Attributes
    ----------
    description : of the rover.
    parts : that were reproduced: `soil`, `drive`, `spectra`.
    numbers : published ones with what is found for them.
    rocks, drives : what figures of spectra and drives are made from, None where they were not asked for.
    inputs, tables : SHA-256 of files and of tables by name.
    """

    description: RoverDescription
    parts: Sequence[str]
    numbers: list[Number] = field(default_factory=list)
    rocks: Rocks | None = None
    drives: Drives | None = None
    inputs: dict[str, str] = field(default_factory=dict)
    tables: dict[str, str] = field(default_factory=dict)
    schema = "reproduce/1"

    @property
    def made_from(self) -> MadeFrom:
        options = {} if self.parts == ("spectra",) else {"rover": self.description.origin}
        soils = sources_of(reference_soils()) if "soil" in self.parts else []
        return MadeFrom(inputs=self.inputs, tables=self.tables, sources=[PAPER, *soils], options=options)

    @property
    def verdicts(self) -> dict[str, int]:
        """How many numbers have each verdict."""
        counts = Counter(number.verdict for number in self.numbers)
        return {verdict: counts[verdict] for verdict in VERDICTS if counts[verdict]}

    def to_dict(self) -> dict[str, Any]:
        return {"numbers": self.rows(), "verdicts": self.verdicts}

    def rows(self) -> list[dict[str, Any]]:
        """One a number."""
        return [number.to_dict() for number in self.numbers]

    def figures(self) -> Iterator[Figure]:
        pages: dict[str, Callable[[], Any]] = {
            "spectra": lambda: spectra_pages(self.rocks),
            "soil": lambda: soil_pages(read_wheel(self.description)),
            "drive": lambda: drive_pages(self.drives) if self.drives else iter(()),
        }
        for part in self.parts:
            yield from pages[part]()


def reproduce(
    request: ReproduceRequest | None = None, *, progress: Progress | None = None, **options: Any
) -> Reproduction:
    """Compute the numbers of a part, or of all, and judge them by those that are published."""
    asked = request_of(ReproduceRequest, request, options)
    update = progress or (lambda done, total: None)
    description = read_rover(asked.rover or ROVER)
    made = Reproduction(description, asked.parts, tables=published_hash())
    if asked.parts != ("spectra",):
        made.tables[f"{asked.rover or ROVER} (rover)"] = sha256(description.text.encode())
    make: dict[str, Callable[[Reproduction, Progress], Reproduction]] = {
        "spectra": lambda made, update: _with_spectra(made, asked.rocks, update),
        "soil": lambda made, _: _with_soil(made),
        "drive": _with_drive,
    }
    total, before = sum(WORK[name] for name in asked.parts), 0
    for name in asked.parts:
        made = make[name](made, _within(update, before, WORK[name], total))
        before += WORK[name]
        update(100 * before, 100 * total)
    return made


def _within(update: Progress, before: int, share: int, total: int) -> Progress:
    """Progress of one part as progress of all."""
    return lambda done, of: update(round(100 * (before + share * done / max(of, 1))), 100 * total)


def _with_spectra(made: Reproduction, rocks: Sequence[str], update: Progress) -> Reproduction:
    sources = [read_input(path) for path in expand_inputs(rocks)]
    spectra = [spectrum for source in sources for spectrum in read_spectra(source)]
    fitted = fit_rocks(boulders(spectra), update) if sources else None
    return replace(
        made,
        rocks=fitted,
        inputs=made.inputs | {source.name: source.sha256 for source in sources},
        tables=made.tables | table_hashes(*TABLES),
        numbers=made.numbers + spectra_numbers(fitted),
    )


def _with_soil(made: Reproduction) -> Reproduction:
    numbers = made.numbers + soil_numbers(read_wheel(made.description))
    return replace(made, tables=made.tables | reference_hash() | prior_hash(), numbers=numbers)


def _with_drive(made: Reproduction, update: Progress) -> Reproduction:
    drives = predicted_drives(build_rover(made.description), update)
    tables, numbers = made.tables | soil_hash(SOIL)[1], made.numbers + drive_numbers(drives)
    return replace(made, drives=drives, tables=tables, numbers=numbers)
