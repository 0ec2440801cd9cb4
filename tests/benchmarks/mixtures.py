"""Errors of mineral shares on measured mixtures, for docs/validation/rock.md: `python tests/benchmarks/mixtures.py`.

Needs the reference data, found through LUNARSCI_REFERENCE_DATA. Whatever is of a series is left out of the library.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
from lunarsci.spectra_data.make_abundance_calibration import COLUMNS, MIXTURES, PURE

from lunarsci.inputs import read_input
from lunarsci.spectra.abundance.end_members import FAMILY_OF, embedded_end_members, without_siblings
from lunarsci.spectra.abundance.estimate import estimate_series
from lunarsci.spectra.abundance.kinds import find_kind
from lunarsci.spectra.abundance.nbsr import nbsr_abundance
from lunarsci.spectra.abundance.one_by_one import estimate_each, raw_shares
from lunarsci.spectra.abundance.result import Abundance, MineralFraction
from lunarsci.spectra.library.end_member import EndMember
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.model import mgm_model
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.readers import read_spectra
from lunarsci.spectra.spectrum import Spectrum

__all__ = [
    "MODES",
    "Series",
    "accepted",
    "coverage",
    "laboratory",
    "rmse",
    "rover",
    "shares",
    "strangers",
    "table",
    "weight_errors",
]

MAFIC = tuple(FAMILY_OF)[:3]
CHANNELS = np.arange(450.0, 2451.0, 5.0)
COARSE_UM = 50.0
MODES = {
    "alone": "one spectrum at a time, minerals of the series named",
    "alone, present": "one at a time, minerals of each mixture named",
    "together": "all of a series together, minerals of the series named",
    "together, present": "together, minerals of each mixture named",
    "others known": "together, modes of all others known",
}


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Mixtures of the same powders: modes (s, m), and the library without them."""

    name: str
    minerals: tuple[str, ...]
    spectra: tuple[Spectrum, ...]
    modes: np.ndarray
    library: tuple[EndMember, ...]


@cache
def laboratory(data: Path) -> tuple[Series, ...]:
    """The shared series, grain sizes apart."""
    spectra = {s.id: s for s in read_spectra(read_input(str(data / "spectra/relab/reflectance.csv")))}
    rows = pd.read_csv(data / "spectra/relab/manifest.csv").set_index("id")
    library = embedded_end_members(CHANNELS)
    found = []
    for name, (minerals, kept_out) in MIXTURES.items():
        mixed = rows[rows.index.str.startswith(name) & (rows[list(COLUMNS.values())].max(axis=1) < PURE)]
        for coarse, group in mixed.groupby(mixed["max_um"] > COARSE_UM):
            label = name + (" coarse" if coarse and name == "XP-CMP" else "")
            modes = group[[COLUMNS[mineral] for mineral in minerals]].to_numpy(float)
            kept = without_siblings(library, kept_out)
            found.append(Series(label, minerals, tuple(spectra[id] for id in group.index), modes, kept))
    return tuple(found)


@cache
def rover(data: Path) -> tuple[Spectrum, ...]:
    """Soil and boulders of Chang'E-4."""
    return tuple(read_spectra(read_input(str(data / "spectra/ce4/reflectance_factor.csv"))))


@cache
def shares(series: Series, mode: str) -> tuple[Abundance, ...]:
    """What unmixing finds, in one of `MODES`."""
    modes = series.modes / series.modes.sum(axis=1, keepdims=True)
    truth = [dict(zip(series.minerals, row, strict=True)) for row in modes]
    present: list[list[str] | None] = [None] * len(truth)
    if mode.endswith("present"):
        present = [[mineral for mineral, share in row.items() if share > 0] for row in truth]
    if mode.startswith("together"):
        found = estimate_series(series.spectra, series.minerals, end_members=series.library, present=present)
        return tuple(found)
    if mode == "others known":
        return tuple(_left_out(series, truth, number) for number in range(len(series.spectra)))
    return tuple(
        alone(spectrum, own or series.minerals, series.minerals, series.library)
        for spectrum, own in zip(series.spectra, present, strict=True)
    )


def alone(
    spectrum: Spectrum, named: Sequence[str], minerals: Sequence[str], library: tuple[EndMember, ...]
) -> Abundance:
    """Shares of all minerals, those not named with 0, and a centre also where the spectrum says little."""
    if len(named) == 1:
        found = {named[0]: MineralFraction(named[0], 1.0, 1.0, 1.0, 1.0, 1.0)}
        fractions = tuple(found.get(name, MineralFraction(name, 0.0, 0.0, 0.0, 0.0, 0.0)) for name in minerals)
        return Abundance(spectrum.id, "unmix", fractions, None, True, "", None)
    [one] = estimate_each([spectrum], named, kinds=[find_kind(spectrum, "powder-mixture")], end_members=library)
    _, mean, *_ = raw_shares(spectrum, named, "powder-mixture", library)
    found = {
        item.mineral: replace(item, fraction=float(value)) for item, value in zip(one.fractions, mean, strict=True)
    }
    absent = {name: MineralFraction(name, 0.0, 0.0, 0.0, 0.0, 0.0) for name in minerals}
    return replace(one, fractions=tuple((absent | found)[name] for name in minerals))


def _left_out(series: Series, truth: list[dict[str, float]], number: int) -> Abundance:
    known = [None if index == number else row for index, row in enumerate(truth)]
    return estimate_series(series.spectra, series.minerals, end_members=series.library, known=known)[number]


def errors(series: Series, mode: str) -> np.ndarray:
    """Found less true, (s, m). [vol %]"""
    found = np.array([[item.fraction for item in one.fractions] for one in shares(series, mode)])
    return 100 * (found - series.modes)


def rmse(all_series: Sequence[Series], mode: str, mineral: str) -> float:
    """Root mean square over all mixtures of series that hold the mineral. [vol %]"""
    parts = [errors(s, mode)[:, s.minerals.index(mineral)] for s in all_series if mineral in s.minerals]
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) if parts else float("nan")


def coverage(all_series: Sequence[Series], mode: str) -> tuple[float, float]:
    """Share of the truths within 68 and 95 % intervals, minerals that could be found; of a spectrum that no mixture is
    like any share is possible, which does not count."""
    inside: list[tuple[bool, bool]] = []
    for series in all_series:
        for row, one in zip(series.modes, shares(series, mode), strict=True):
            for truth, item in zip(row, one.fractions, strict=True):
                anything = (item.low, item.high) == (0.0, 1.0)
                if not anything and (truth > 0 or not mode.endswith("present")):
                    inside.append((item.low <= truth <= item.high, item.low95 <= truth <= item.high95))
    one, two = np.mean(inside, axis=0)
    return float(one), float(two)


@cache
def weight_errors(series: Series) -> tuple[tuple[float, bool], ...]:
    """Orthopyroxene in all pyroxene by `nbsr` where determined, found less true [%, densities taken as equal]."""
    model = mgm_model("OL-OPX-CPX-PLG" if "plagioclase" in series.minerals else _family(series.minerals))
    found = []
    for spectrum, row in zip(series.spectra, series.modes, strict=True):
        opx, cpx = (row[series.minerals.index(name)] for name in ("orthopyroxene", "clinopyroxene"))
        [fit] = fit_spectra([spectrum], model)
        one = nbsr_abundance(fit) if isinstance(fit, MgmFit) else None
        if one is not None and one.determined and opx + cpx > 0:
            found.append((100 * (one.fractions[0].fraction - opx / (opx + cpx)), one.in_domain))
    return tuple(found)


def strangers(data: Path) -> dict[str, list[tuple[Spectrum, tuple[str, ...]]]]:
    """Spectra that are no mixtures of the minerals named, by kind."""
    every = tuple(FAMILY_OF)
    spectra = {s.id: s for s in read_spectra(read_input(str(data / "spectra/relab/reflectance.csv")))}
    rows = pd.read_csv(data / "spectra/relab/manifest.csv").set_index("id")
    pure = [
        (spectra[id], tuple(name for name in every if name != mineral))
        for mineral, column in COLUMNS.items()
        for id in rows.index[rows[column] >= PURE]
    ]
    of_m3, apollo16 = "lunar/m3_aristarchus_sample.csv", "lunar/apollo16_62231_relab_avg.csv"
    moon = [*read_spectra(read_input(str(data / "spectra" / of_m3)))]
    moon += [*read_spectra(read_input(str(data / "spectra" / apollo16)))][:1]
    return {
        "soil and boulders, Chang'E-4": [(spectrum, every) for spectrum in rover(data)],
        "soil, M3 and Apollo 16": [(spectrum, every) for spectrum in moon],
        "one mineral, the three others named": pure,
    }


def accepted(pairs: Sequence[tuple[Spectrum, tuple[str, ...]]]) -> int:
    """How many of them come out as in domain."""
    return sum(estimate_each([spectrum], minerals)[0].in_domain for spectrum, minerals in pairs)


def _family(minerals: Sequence[str]) -> str:
    return "-".join(FAMILY_OF[mineral] for mineral in minerals)


def table(data: Path) -> list[str]:
    """Rows of the page: per series and mode, the error of each mafic mineral."""
    lines = []
    every = laboratory(data)
    for group in [*((one,) for one in every), every]:
        name = group[0].name if len(group) == 1 else "all"
        count = sum(len(one.spectra) for one in group)
        cells = []
        for mode in MODES:
            values = [rmse(group, mode, mineral) for mineral in MAFIC]
            cells.append(" / ".join("-" if np.isnan(value) else f"{value:.0f}" for value in values))
        with_both = [one for one in group if {"orthopyroxene", "clinopyroxene"} <= set(one.minerals)]
        both = [error for one in with_both for error, _ in weight_errors(one)]
        cells.append(f"{np.sqrt(np.mean(np.square(both))):.0f}" if both else "-")
        lines.append(f"| {name} | {count} | " + " | ".join(cells) + " |")
    return lines


def main() -> None:
    """Print the tables."""
    data = Path(os.environ["LUNARSCI_REFERENCE_DATA"])
    every = laboratory(data)
    print("\n".join(table(data)))
    for mode in MODES:
        one, two = coverage(every, mode)
        print(f"{mode}: plagioclase {rmse(every, mode, 'plagioclase'):.1f} vol %; 68 % intervals hold {one:.2f}, "
              f"95 % ones {two:.2f}")  # fmt: skip
    right = [one.in_domain for series in every for one in shares(series, "alone")]
    wrong = {kind: (accepted(pairs), len(pairs)) for kind, pairs in strangers(data).items()}
    taken = sum(right) + sum(count for count, _ in wrong.values())
    print(f"in domain: {sum(right)} of {len(right)} mixtures (recall {np.mean(right):.2f}); "
          f"precision {sum(right) / taken:.2f}")  # fmt: skip
    for kind, (count, total) in wrong.items():
        print(f"{kind}: {count} of {total} taken as in domain")


if __name__ == "__main__":
    main()
