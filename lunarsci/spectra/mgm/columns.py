"""Fits of many spectra as the columns of their JSON and CSV, made from arrays."""

from collections.abc import Mapping, Sequence
from operator import attrgetter
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.io.records import Codes, Column, Listed, Records, Same, Where
from lunarsci.result import flat
from lunarsci.spectra.mgm import TREND_SIGMA
from lunarsci.spectra.mgm.batch import compositions_of
from lunarsci.spectra.mgm.fit import SpectraFits
from lunarsci.spectra.mgm.model import NM_PER_UM
from lunarsci.spectra.mgm.result import ERROR_COVERS

PARTS = ("center", "fwhm", "strength")
"""Parameters of a band, in the order of `MgmModel`."""
ON_BOUND = [[name for k, name in enumerate(PARTS) if code >> k & 1] for code in range(8)]
"""Parameters on a bound by a code whose bits are those of `PARTS`."""
RATIO = ("opx", "cpx", "sigma", "calibration")
"""Keys of a ratio, in the order of the columns of `FitBatch.um1`."""
CSV_RATIO = ("opx", "sigma", "calibration", "continuum", "continuum_low", "continuum_high")
OF_COMPOSITION = ("mean", "sigma", "trend_sigma", "in_range", "domain")
"""Keys of a ratio and of a composition that tables have."""
REGIONS = ("um1", "um2")
COMMON = ("source", "id", "assemblage", "continuum", "converged", "status", "rms_ln", "model_error")
"""Columns of every row of a table, of a fit or of none."""


class FitColumns:
    """Columns of fits of n spectra to one model, in the order of the spectra; `origins` are their inputs."""

    def __init__(self, fits: SpectraFits, origins: Sequence[str]) -> None:
        self.fits, self.model, self.size, self.there = fits, fits.model, len(fits), fits.there
        self.plain: dict[str, Column] = {
            "source": list(origins),
            "id": list(fits.names),
            "assemblage": Same(self.model.assemblage.name),
            "continuum": Same(self.model.continuum),
            "converged": fits.gathered(lambda batch: batch.converged) > 0,
            "status": fits.statuses,
            "rms_ln": fits.gathered(lambda batch: batch.rms_ln),
            "model_error": fits.gathered(lambda batch: batch.model_error),
        }
        self.ratios = {region: fits.gathered(attrgetter(region)) for region in REGIONS}

    def records(self, more: Mapping[str, Column]) -> Records:
        """The objects of `--json`, with further keys."""
        fits, determined = self.fits, {region: np.isfinite(numbers[:, 0]) for region, numbers in self.ratios.items()}
        ratios = {region: Where(determined[region], _ratio(numbers)) for region, numbers in self.ratios.items()}
        coefficients = fits.gathered(lambda batch: batch.values[:, : batch.model.degrees])
        bands = self._bands()
        columns: dict[str, Column] = {
            "prior": Where(self.there, Same("map")),
            "reduced_chi2": fits.gathered(lambda batch: batch.reduced_chi2),
            "bic": fits.gathered(lambda batch: batch.bic),
            "iterations": None,
            "error_covers": Where(self.there, Same(list(ERROR_COVERS))),
            "continuum_coefficients": Where(self.there, coefficients),
            "bands": Listed([_slot(bands, k) for k in range(self._count)], self._count * self.there),
            "nbsr": Where(self.there, ratios),
            "compositions": Where(self.there, self._compositions(), {}),
            "choice": None,
            "intervals": None,
        }
        return Records(self.plain | columns | dict(more), self.size)

    def rows(self, more: Mapping[str, Column], *, bands: bool = True) -> Records:
        """The rows of `--csv`, one a band, with further columns; a spectrum without a fit has one with its status.

        Without `bands` there is one a spectrum, without the columns of bands.
        """
        columns = dict(self.plain)
        for region, numbers in self.ratios.items():
            columns |= {f"nbsr_{region}_{key}": _ratio(numbers)[key] for key in CSV_RATIO}
        for key, item in self._compositions().items():
            columns |= {f"{key}_{name}": Where(self.there, item[name]) for name in OF_COMPOSITION}
        if not bands:
            return Records(columns | dict(more), self.size)
        count = rows_of(self.fits)
        row = np.repeat(np.arange(self.size), count)
        place = np.arange(row.size) - np.repeat(np.cumsum(count) - count, count)
        spectra = Records(columns | dict(more), self.size).taken(row)
        shown = self.there[row] & (self._count > 0)
        band_columns = {key: Where(shown, _stacked(column, row, place)) for key, column in self._bands().items()}
        return Records({**spectra.columns, **band_columns}, row.size)

    @property
    def _count(self) -> int:
        return len(self.model.assemblage.bands)

    def _bands(self) -> dict[str, list[str] | FloatArray | IntArray | dict[str, FloatArray] | None]:
        """By key: a text of each band, numbers (n, bands), or numbers by the kind of parameter."""
        m, bands = self.model.degrees, self.model.assemblage.bands
        names = ("values", "sigma", "calibration")
        value, sigma, shared = (self.fits.gathered(attrgetter(name))[:, m:] for name in names)
        shrinkage = self.fits.gathered(lambda batch: batch.shrinkage[:, m:])
        held = np.nan_to_num(self.fits.gathered(lambda batch: batch.at_bound[:, m:])).astype(int)
        unit = {"center": NM_PER_UM, "fwhm": NM_PER_UM, "strength": 1.0}
        keys = {"center": "center_nm", "fwhm": "fwhm_nm", "strength": "strength"}
        result: dict[str, Any] = {key: [getattr(band, key) for band in bands] for key in ("name", "mineral", "region")}
        for k, part in enumerate(PARTS):
            result[keys[part]] = value[:, k::3] * unit[part]
            result[_between(keys[part], "sigma")] = sigma[:, k::3] * unit[part]
        for k, part in enumerate(PARTS):
            result[_between(keys[part], "calibration")] = shared[:, k::3] * unit[part]
        result["shrinkage"] = {part: shrinkage[:, k::3] for k, part in enumerate(PARTS)}
        result["at_bound"] = held[:, ::3] + 2 * held[:, 1::3] + 4 * held[:, 2::3]
        return result | dict.fromkeys(_between(keys[part], "continuum") for part in PARTS)

    def _compositions(self) -> dict[str, dict[str, Column]]:
        """By key of the composition, the columns of a `MineralComposition`."""
        result: dict[str, dict[str, Column]] = {}
        numbers = self.fits.gathered(compositions_of)
        for k, item in enumerate(self.model.assemblage.compositions):
            mean, sigma = numbers[:, k].T
            result[item.key] = {
                "key": item.key,
                "mineral": item.mineral,
                "mean": mean,
                "sigma": sigma,
                "trend_sigma": Same(TREND_SIGMA[item.key]),
                "prior_sigma": Same(item.sigma),
                "lowest": Same(item.lowest),
                "highest": Same(item.highest),
                "in_range": (item.lowest <= mean) & (mean <= item.highest),
                "domain": Same(self.model.assemblage.domain(item.mineral)),
            }
        return result


def rows_of(fits: SpectraFits) -> IntArray:
    """(n,) rows of `--csv` that each spectrum has."""
    return np.where(fits.there, max(1, len(fits.model.assemblage.bands)), 1)


def _ratio(numbers: FloatArray) -> dict[str, Column]:
    return {**dict(zip(RATIO, numbers.T, strict=True)), **dict.fromkeys(CSV_RATIO[3:])}


def _between(name: str, part: str) -> str:
    """`center_sigma_nm` of `center_nm`."""
    return f"{name[:-3]}_{part}_nm" if name.endswith("_nm") else f"{name}_{part}"


def _slot(bands: Mapping[str, Any], k: int) -> dict[str, Column]:
    """What a list of objects holds at its place k."""
    result: dict[str, Column] = {}
    for key, column in bands.items():
        if isinstance(column, dict):
            result[key] = {name: numbers[:, k] for name, numbers in column.items()}
        elif key == "at_bound":
            result[key] = Codes(column[:, k], ON_BOUND)
        else:
            result[key] = column[:, k] if isinstance(column, np.ndarray) else column[k] if column else None
    return result


def _stacked(column: Any, row: IntArray, place: IntArray) -> Column:
    """What the rows of a table hold, each of a band of a spectrum."""
    if isinstance(column, dict):
        return {name: numbers[row, place] for name, numbers in column.items()}
    if isinstance(column, np.ndarray):
        return Codes(column[row, place], ON_BOUND) if column.dtype.kind == "i" else column[row, place]
    return Codes(place, column) if column else None


def rows_one_by_one(
    records: Sequence[Mapping[str, Any]], shares: Mapping[int, Sequence[Any]], *, bands: bool = True
) -> list[dict[str, Any]]:
    """The rows of `--csv` of records that were made one by one, and the shares of some by position.

    One a band; a spectrum without a fit, and each without `bands`, has one.
    """
    rows: list[dict[str, Any]] = []
    for index, record in enumerate(records):
        ends = {item["name"]: item for item in record["intervals"]["intervals"]} if record["intervals"] else {}
        common = _spectrum_row(record, _share_columns(shares.get(index, ())))
        common |= _interval_columns({name: name for name in ("nbsr_um1_opx", "nbsr_um2_opx")}, ends)
        for band in record["bands"] if bands else ():
            key = band["name"].lower().replace(" ", "_").replace("-", "_")
            columns = {f"{key}_{kind}": kind for kind in ("center_nm", "fwhm_nm", "strength")}
            rows.append(common | flat(band) | _interval_columns(columns, ends))
        if not (bands and record["bands"]):
            rows.append(common)
    return rows


def _spectrum_row(record: Mapping[str, Any], shares: Mapping[str, Any]) -> dict[str, Any]:
    """The columns of a spectrum, which are the same in the rows of all its bands."""
    common = {key: record[key] for key in COMMON}
    for region in REGIONS:
        ratio = (record["nbsr"] or {}).get(region) or {}
        common |= {f"nbsr_{region}_{key}": ratio.get(key) for key in CSV_RATIO}
    for key, item in record["compositions"].items():
        common |= {f"{key}_{name}": item[name] for name in OF_COMPOSITION}
    common |= shares
    if choice := record["choice"]:
        common |= {f"choice_{key}": choice[key] for key in ("margin", "strong")}
        common |= {key: "+".join(choice[key]) for key in ("sure", "open", "not_needed")}
        chances = choice["mineral_probability"] | choice["group_probability"]
        common |= {f"probability_of_{name}": chance for name, chance in chances.items()}
    return common


def _share_columns(result: Sequence[Any]) -> dict[str, Any]:
    """`nbsr_in_domain`, `nbsr_orthopyroxene`, `nbsr_orthopyroxene_low` and the like."""
    columns: dict[str, Any] = {}
    for modes in result:
        columns[f"{modes.method}_in_domain"] = modes.in_domain
        for share in modes.fractions:
            name = f"{modes.method}_{share.mineral}"
            columns |= {name: share.fraction}
            columns |= {f"{name}_{end}": getattr(share, end) for end in ("low", "high", "low95", "high95")}
    return columns


def _interval_columns(columns: Mapping[str, str], ends: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """`center_low68_nm` and the like."""
    result: dict[str, Any] = {}
    for name, column in columns.items():
        stem, unit = (column[:-3], "_nm") if column.endswith("_nm") else (column, "")
        if name in ends:
            result |= {f"{stem}_{end}{unit}": ends[name][end] for end in ("low68", "high68", "low95", "high95")}
    return result
