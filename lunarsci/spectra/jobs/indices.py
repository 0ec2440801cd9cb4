"""`lunarsci.indices`: spectral indices of the Moon, of one spectrum or many."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.constants import SMOOTHING
from lunarsci.errors import DataError, Failure, RequestError
from lunarsci.io.records import Codes, Records
from lunarsci.options import request_of
from lunarsci.result import MadeFrom, Result, job
from lunarsci.spectra.indices import INDICES, NO_CHANNELS, STATUSES, IndexColumn, index_arrays
from lunarsci.spectra.jobs.requests import IndicesRequest
from lunarsci.spectra.readers.batch import SpectraBatch, SpectraSource, read_batch

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredIndices(Result):
    """Indices by name, and the spectra that they are of."""

    batch: SpectraBatch
    columns: Mapping[str, IndexColumn]
    schema = "spectra-indices/1"

    @property
    def made_from(self) -> MadeFrom:
        sources = [INDICES[name].source for name in self.columns]
        return MadeFrom(inputs=self.batch.inputs, tables=self.batch.tables, sources=[*sources, SMOOTHING])

    @property
    def failures(self) -> Sequence[Failure]:
        return self.batch.failures

    def content(self) -> dict[str, Any]:
        about = {name: _about(INDICES[name]) for name in self.columns}
        return {**self.batch.remarks, "indices": about, "spectra": self.records()}

    def records(self) -> Records:
        """Each spectrum with a nested object for each index."""
        result: dict[str, Any] = {
            name: {
                "value": column.value,
                "sigma": column.sigma,
                "interpolation": column.interpolation,
                "calibration": np.where(column.calibration > 0, column.calibration, np.nan),
                "error": np.sqrt(column.sigma**2 + column.interpolation**2 + INDICES[name].miss_sigma ** 2),
                "status": Codes(column.status, STATUSES),
            }
            for name, column in self.columns.items()
        }
        return Records({"source": self.batch.origins, "id": [item.id for item in self.batch.spectra], **result})

    def rows(self) -> Records:
        """One a spectrum: value, noise, whole error and status of each index in columns of their own."""
        cells: dict[str, Any] = {"source": self.batch.origins, "id": [item.id for item in self.batch.spectra]}
        for name, column in self.columns.items():
            cells |= {
                name: column.value,
                f"{name}_sigma": column.sigma,
                f"{name}_error": np.sqrt(column.sigma**2 + column.interpolation**2 + INDICES[name].miss_sigma ** 2),
                f"{name}_status": Codes(column.status, STATUSES),
            }
        return Records(cells)

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.spectra.mgm.figure import index_pages

        return index_pages(self.batch.spectra, self.columns)


def _about(index: Any) -> dict[str, Any]:
    """What an index is, for the JSON."""
    median, largest = index.missed_by or (None, None)
    return {
        "title": index.title,
        "unit": index.unit,
        "source": index.source,
        "wavelengths_nm": list(index.wavelengths_nm),
        "range_low": index.low,
        "range_high": index.high,
        "of_soils": index.of_soils,
        "soils_missed_by_median": median,
        "soils_missed_by_most": largest,
    }


@job
def indices(spectra: "SpectraSource", request: IndicesRequest | None = None, **options: Any) -> MeasuredIndices:
    """Spectral indices of the Moon: integrated band depths, slopes, olivine, spinel, maturity, FeO and TiO2.

    Parameters
    ----------
    spectra : files, patterns, tables, `Spectrum`s or (wavelength_nm (n,), reflectance (n,) or (spectra, n)[, sigma]),
        one or a list; reflectance and its standard deviation sigma are fractions of 1.
    request, options : options as below, and an `IndicesRequest` whose own they replace.

    Raises DataError when no spectrum can be read, or no index reaches any of them; RequestError for an unknown name.

    Examples
    --------
    >>> maturity = lunarsci.indices("lunarsci-demo/rock.ecsv", index=("omat",)).to_table()["omat"]
    """
    asked = request_of(IndicesRequest, request, options)
    names = list(dict.fromkeys(asked.index)) or list(INDICES)
    if unknown := [name for name in names if name not in INDICES]:
        raise RequestError(f"`index` {unknown[0]}: there are {', '.join(INDICES)}")
    batch = read_batch(spectra, asked.wavelength_unit, asked.reflectance_unit, asked.id)
    result = {name: IndexColumn.empty(len(batch.spectra)) for name in names}
    for rows in batch.spectra.alike():
        alike = batch.spectra.taken(rows).arrays()
        shifts = {str(k): alike.shifts[:, k] for k in range(alike.shifts.shape[1])}
        how: dict[str, Any] = {"names": names, "smooth_nm": asked.smooth_nm, "shifts": shifts}
        for name, column in index_arrays(alike.wavelength_nm, alike.reflectance, alike.sigma, **how).items():
            result[name].take(column, rows)
    if all((column.status == NO_CHANNELS).all() for column in result.values()):
        needs = sorted({round(nm) for name in names for nm in INDICES[name].wavelengths_nm})
        raise DataError(
            f"{batch.origins[0]}: no channels where an index needs them; these need reflectances from {needs[0]} to "
            f"{needs[-1]} nm, with channels at most 60 nm apart"
        )
    return MeasuredIndices(batch, result)
