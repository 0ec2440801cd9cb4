"""Spectra as the Modified Gaussian Model sees them: ln R on their usable channels, with weights."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray, IndexArray
from lunarsci.errors import DataError
from lunarsci.spectra.collection import SpectrumCollection
from lunarsci.spectra.noise import deepest_below_hull, scatter_noise_rows
from lunarsci.spectra.spectrum import Spectrum, reaches_over, wide_gap

FIT_RANGE_NM = (400.0, 2600.0)
"""What is fitted of a spectrum: the silicates' electronic bands; assumed."""
REQUIRED_NM = (800.0, 1300.0)
"""Without the 1 um region there is nothing that tells the three minerals apart; assumed."""
MIN_CHANNELS = 40
"""Usable channels that a fit needs."""


@dataclass(frozen=True, slots=True, eq=False)
class MgmData:
    """One spectrum in ln R with its weights.

    Attributes
    ----------
    wavelength_nm, reflectance : (n,), ascending, all usable. [nm, -]
    weight : (n,) 1 / variance of ln R, of noise and model error together. [-]
    shifts : (k, n) changes of ln R by one standard deviation of errors that all channels share. [-]
    model_error : standard deviation of ln R that stands for what the model cannot explain; part of `weight`. [-]
    """

    id: str
    wavelength_nm: FloatArray
    reflectance: FloatArray
    weight: FloatArray
    shifts: FloatArray
    model_error: float


@dataclass(frozen=True, slots=True, eq=False)
class MgmRows:
    """Spectra on the same channels, row by row as in `MgmData`.

    Attributes
    ----------
    wavelength_nm : (c,), ascending, usable in all n of them. [nm]
    reflectance, weight : (n, c) of the reflectance factor, and 1 / variance of ln R. [-]
    shifts : (n, k, c) changes of ln R by one standard deviation of k errors that all channels share. [-]
    model_error : (n,), part of `weight`. [-]
    """

    wavelength_nm: FloatArray
    reflectance: FloatArray
    weight: FloatArray
    shifts: FloatArray
    model_error: FloatArray

    def __len__(self) -> int:
        return len(self.reflectance)

    @classmethod
    def together(cls, spectra: Sequence[MgmData]) -> "MgmRows":
        """Of spectra that share their channels."""
        columns = ("reflectance", "weight", "shifts", "model_error")
        arrays = (np.array([getattr(data, name) for data in spectra], dtype=np.float64) for name in columns)
        return cls(spectra[0].wavelength_nm, *arrays)

    def part(self, rows: slice) -> "MgmRows":
        """Some of them."""
        return MgmRows(
            self.wavelength_nm, self.reflectance[rows], self.weight[rows], self.shifts[rows], self.model_error[rows]
        )

    def seen(self, rows: IndexArray) -> tuple[FloatArray, FloatArray]:
        """Channels and reflectances of some of them. [nm, -]"""
        return self.wavelength_nm, self.reflectance[rows]

    def at(self, row: int, name: str) -> MgmData:
        """One of them."""
        return MgmData(
            name, self.wavelength_nm, self.reflectance[row], self.weight[row], self.shifts[row],
            float(self.model_error[row]),
        )  # fmt: skip


MISFIT_FLOOR, MISFIT_SHARE = 0.003, 0.04
"""Error of ln R at channels of 5 nm where none is stated: a floor, assumed, and a share of the deepest absorption.

Fits leave 0.4-0.8 % of the depth in laboratory powders (16-84 % of 172), 0.4-1.1 % in meteorites (83), over 10-18
channels, which weighs like an independent error several times larger. With this share the 68 % intervals of band
centres hold 82-98 % of the differences between grain sizes of one mineral (PE-CMP-034, -040, -041, PP-CMP-027,
PO-CMP-032), those of NBSR 36-71 % of 14 mixtures about their line, which both fall with a smaller share."""
MISFIT_SPACING_NM = 5.0
"""Spacing of the channels that `MISFIT_FLOOR` and `MISFIT_SHARE` were measured on. [nm]"""
DEPTH_RANGE_NM = (600.0, 2500.0)
"""Where the deepest absorption is looked for, off the edges of the range; assumed."""


def deepest_absorption(wavelength_nm: FloatArray, reflectance: FloatArray) -> FloatArray:
    """Deepest absorption below the upper hull of ln R, (n,), 600-2500 nm, of channels (c,) and (n, c) [nm, -]. [-]"""
    inside = (wavelength_nm >= DEPTH_RANGE_NM[0]) & (wavelength_nm <= DEPTH_RANGE_NM[1])
    return deepest_below_hull(wavelength_nm[inside], np.log(np.ascontiguousarray(reflectance[:, inside])))


def expected_misfit(wavelength_nm: FloatArray, reflectance: FloatArray) -> FloatArray:
    """Error of ln R that stands for what Gaussians on a smooth continuum cannot explain of channels (n, c), (n,). [-]

    Wider channels hold as much of it in fewer numbers: it falls with the root of the spacing.
    """
    depth = deepest_absorption(wavelength_nm, reflectance)
    spacing = float(np.median(np.diff(wavelength_nm)))
    return np.asarray(np.hypot(MISFIT_FLOOR, MISFIT_SHARE * depth) * np.sqrt(MISFIT_SPACING_NM / spacing))


def prepare_rows(
    wavelength_nm: FloatArray,
    reflectance: FloatArray,
    *,
    sigma: FloatArray | None = None,
    shifts: FloatArray | None = None,
    model_error: float | FloatArray | None = None,
    whole: bool = False,
) -> MgmRows:
    """The channels within 400-2600 nm, their noise and `model_error` (of ln R) added in quadrature.

    Parameters
    ----------
    wavelength_nm, reflectance : (c,) ascending and (n, c), above 0, usable in all rows. [nm, -]
    sigma : (n, c) standard deviation of the reflectance, above 0; without it, `scatter_noise_rows`. [-]
    shifts : (n, k, c) of the reflectance by one standard deviation of errors that all channels share. [-]
    model_error : one for all or one a row; without it, `expected_misfit`. [-]
    whole : whether all channels count, for bands that may lie anywhere.

    Raises
    ------
    DataError with fewer than 40 channels, or, without `whole`, where they do not reach over 800-1300 nm, or leave more
    than 100 nm out there.
    """
    keep = fitted_channels(wavelength_nm, whole=whole)
    nm = wavelength_nm[keep]
    noise = scatter_noise_rows(reflectance) if sigma is None else sigma
    fitted = np.ascontiguousarray(reflectance[:, keep])
    error = (
        expected_misfit(nm, fitted) if model_error is None else np.broadcast_to(np.float64(model_error), len(fitted))
    )
    weight = 1 / ((noise[:, keep] / fitted) ** 2 + error[:, None] ** 2)
    shared = np.empty((len(fitted), 0, nm.size)) if shifts is None else shifts[:, :, keep] / fitted[:, None]
    return MgmRows(nm, fitted, weight, shared, error)


def fitted_channels(wavelength_nm: FloatArray, *, whole: bool = False) -> BoolArray:
    """Which usable channels (c,) [nm] are fitted: those within 400-2600 nm, or all of the `whole`. (c,)

    Raises DataError as `prepare_rows`.
    """
    keep = _inside(wavelength_nm, whole)
    nm = wavelength_nm[keep]
    if nm.size < MIN_CHANNELS:
        between = "" if whole else " between {:g} and {:g} nm".format(*FIT_RANGE_NM)
        raise DataError(f"{nm.size} usable channels{between}; {MIN_CHANNELS} are needed")
    if not whole:
        _check_reach(nm)
    return keep


def _check_reach(wavelength_nm: FloatArray) -> None:
    if not reaches_over(wavelength_nm, *REQUIRED_NM):
        gap = wide_gap(wavelength_nm, *REQUIRED_NM)
        text = ": no usable channel from {:g} to {:g} nm".format(*gap) if gap else ""
        raise DataError("the channels do not reach over {:g}-{:g} nm".format(*REQUIRED_NM) + text)


def _inside(wavelength_nm: FloatArray, whole: bool) -> BoolArray:
    """Channels that are fitted."""
    low, high = (0.0, np.inf) if whole else FIT_RANGE_NM
    return np.asarray((wavelength_nm >= low) & (wavelength_nm <= high))


@dataclass(frozen=True, slots=True)
class SpectraRows:
    """Spectra on the same usable channels, with errors of the same kinds, which are prepared when they are asked for.

    `model_error` and `whole` as `prepare_rows` takes them.
    """

    spectra: SpectrumCollection
    model_error: float | None
    whole: bool

    def part(self, rows: slice) -> "SpectraRows":
        """Some of them."""
        return SpectraRows(self.spectra[rows], self.model_error, self.whole)

    def arguments(self) -> dict[str, Any]:
        """Their arrays, as `prepare_rows` takes them."""
        return self.spectra.arrays()._asdict() | {"model_error": self.model_error, "whole": self.whole}

    def prepared(self) -> MgmRows:
        """As `prepare_rows` makes them, whose errors are raised."""
        return prepare_rows(**self.arguments())

    def seen(self, rows: IndexArray) -> tuple[FloatArray, FloatArray]:
        """Channels and reflectances of some of them, as `prepared` has them, without the rest. [nm, -]"""
        arrays = self.spectra.taken(rows).arrays()
        inside = _inside(arrays.wavelength_nm, self.whole)
        return arrays.wavelength_nm[inside], arrays.reflectance[:, inside]

    def at(self, row: int, name: str) -> MgmData:
        """One of them, prepared."""
        return self.part(slice(row, row + 1)).prepared().at(0, name)


def prepare(spectrum: Spectrum, model_error: float | None = None, *, whole: bool = False) -> MgmData:
    """One spectrum, as `prepare_rows` makes it, whose errors are raised."""
    return SpectraRows(SpectrumCollection.of([spectrum]), model_error, whole).at(0, spectrum.id)
