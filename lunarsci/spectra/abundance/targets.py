"""Kinds of target: what is known of one before its spectrum is seen, and what shares found of it are worth.

Rock types and discrepancies are prior knowledge. `abundance_calibration.csv` has what was measured: how far shares of
spectra of known modes were off, suite by suite, with whatever is of the suite left out of the library. Intervals are
scaled so that they hold those errors (split conformal prediction with suites as the units: Lei et al. 2018,
10.1080/01621459.2017.1307116; Dunn, Wasserman & Ramdas 2023, 10.1080/01621459.2022.2060112): K suites vouch for a level
of K / (K + 1) and none higher.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

from lunarsci.spectra.abundance.posterior import Discrepancy
from lunarsci.spectra.abundance.random_mixtures import RockType
from lunarsci.tables import table_rows

TABLE = "abundance_calibration.csv"
POWDER, DARK, SOLID = "powder-mixture", "dark-rock-powder", "solid-rock"
CHONDRITE = "ordinary-chondrite"
"""Rock type that is named where it is likelier than all others; its class is calibrated by itself."""
MOST_WIDE = 0.12
"""Half of the widest interval of 68 % with which a spectrum is in domain: its worst share is mostly within 0.15."""
POWDER_TYPES = (
    RockType("any", 0.5),
    RockType("led-by-one", 0.5, leading=6.0),
)
ROCK_TYPES = (
    RockType("any", 0.3),
    RockType(
        CHONDRITE,
        0.3,
        {"olivine": 20.0, "orthopyroxene": 11.2, "clinopyroxene": 3.6, "plagioclase": 5.2},
        dark=1.0,
        dark_share=(0.05, 0.7),
        iron=0.5,
        chemistry={"olivine": ("fo", 0.65, 0.88), "orthopyroxene": ("fs", 0.10, 0.35)},
        source="modes of ordinary chondrites: Dunn et al. (2010), Meteorit. Planet. Sci. 45, 123; the rest assumed",
    ),
    RockType("led-by-one", 0.2, leading=6.0),
    RockType(
        "basalt",
        0.2,
        {"olivine": 0.8, "orthopyroxene": 3.0, "clinopyroxene": 2.0, "plagioclase": 4.2},
        source="eucrites and mare basalts hold pyroxene and plagioclase in like parts; numbers assumed",
    ),
)


@dataclass(frozen=True, slots=True)
class Target:
    """A kind of target.

    Attributes
    ----------
    kind : one of `kinds.KINDS` that can be unmixed.
    rock_types : what it may be.
    discrepancy : what real spectra have beside the model's.
    components, foretold : how spectra are compared (`posterior`).

    Detail, level and the way of comparison are those with which errors of suites left out were least, of 1, 2 and 3 %,
    10 and 20 %, and the two ways.
    """

    kind: str
    rock_types: tuple[RockType, ...]
    discrepancy: Discrepancy
    components: int
    foretold: bool


_POWDERS = Discrepancy(level=0.1, slope=0.05, bend=0.03, detail=0.01)
_ROCKS = Discrepancy(level=0.2, slope=0.1, bend=0.05, detail=0.03)
TARGETS = {
    POWDER: Target(POWDER, POWDER_TYPES, _POWDERS, 20, False),
    DARK: Target(DARK, ROCK_TYPES, _ROCKS, 25, True),
    SOLID: Target(SOLID, ROCK_TYPES, _ROCKS, 25, True),
}


@dataclass(frozen=True, slots=True)
class KindCalibration:
    """What suites of known modes say of shares of one class of targets.

    Attributes
    ----------
    name : a kind, or `CHONDRITE`.
    suites, count : ids of the suites and number of spectra; none where nothing of known modes was measured.
    factor68, factor95 : by which standard deviations are multiplied to hold 68 and 95 % of the errors.
    most_unlike : largest distance from random mixtures (`posterior`) that a spectrum of known modes had.
    held68, held95 : share of the errors that intervals hold, each suite judged by the others. [-]
    precision, recall : of the verdict `in_domain` in the same way, where good is the worst mineral within 15 %. [-]
    """

    name: str
    suites: tuple[str, ...]
    count: int
    factor68: float
    factor95: float
    most_unlike: float
    held68: float
    held95: float
    precision: float
    recall: float

    @property
    def certified(self) -> float:
        """Highest level that so many suites can vouch for. [-]"""
        return len(self.suites) / (len(self.suites) + 1)


@cache
def calibrations() -> Mapping[str, KindCalibration]:
    """By name."""
    rows = {row["name"]: row for row in table_rows(TABLE)}
    return {
        name: KindCalibration(
            name,
            tuple(row["suites"].split()),
            int(row["count"]),
            *(
                float(row[key])
                for key in ("factor68", "factor95", "most_unlike", "held68", "held95", "precision", "recall")
            ),
        )
        for name, row in rows.items()
    }
