"""Reduction of reflectance factors to the standard geometry, and how far the models for it disagree."""

import numpy as np

from lunarsci.errors import ParameterError
from lunarsci.spectra.photometry.disk import DISKS, disk_function, outside
from lunarsci.spectra.photometry.geometry import STANDARD, Geometry
from lunarsci.spectra.photometry.phase import PhaseFunction, phase_function
from lunarsci.spectra.spectrum import FloatArray

__all__ = ["correction_factor", "model_spread", "remarks"]

SPREAD_PHASES = ("sp-low", "sp-mid", "sp-high")
_MOST_MODES = 2
_NEGLIGIBLE = 1e-6
_GRAZING = 1e6


def correction_factor(geometry: Geometry, wavelength_nm: FloatArray, disk: str, phase: PhaseFunction) -> FloatArray:
    """Factor from a reflectance factor (REFF) at some geometry to that at 30, 0, 30 deg, shape (n,). [-]

    cos i / cos 30 * D(30, 0, 30) / D(i, e, g) * f(30) / f(g), where RADF = REFF cos i = D f. For Lommel-Seeliger this
    is (cos i + cos e) / (cos 30 + 1) * f(30) / f(g): unlike the form for RADF it has no ratio of cosines of i.

    Parameters
    ----------
    geometry : of the observation.
    wavelength_nm : shape (n,). [nm]
    disk : `lommel-seeliger`, `akimov` or `mcewen`; `remarks` says where each is good.
    phase : the phase function, itself established with one disk function (SELENE: `mcewen`) and used with any.

    Raises
    ------
    ParameterError for an unknown disk function, or where it vanishes (incidence or emission within 0.1 deg of 90).

    Besse et al. (2013), Icarus 222, 229 (Lommel-Seeliger); Yokota et al. (2011), Icarus 215, 639.
    """
    function = disk_function(disk)
    here, standard = function(geometry), function(STANDARD)
    if not here * _GRAZING > geometry.cos_incidence:
        raise ParameterError(
            f"{disk} vanishes at incidence {geometry.incidence_deg:g}, emission {geometry.emission_deg:g}, phase "
            f"{geometry.phase_deg:g} deg; nothing seen so flat can be corrected"
        )
    level = geometry.cos_incidence / STANDARD.cos_incidence * standard / here
    return level * np.exp(-phase.log_ratio(geometry.phase_deg, wavelength_nm))


def remarks(geometry: Geometry, wavelength_nm: FloatArray, disk: str, phase: PhaseFunction) -> list[str]:
    """What a reader of the corrected spectrum should know: use of a model beyond where it is good."""
    found = (outside(disk, geometry), phase.remark(geometry.phase_deg, wavelength_nm))
    return [remark for remark in found if remark]


def model_spread(geometry: Geometry, wavelength_nm: FloatArray, disk: str, phase: PhaseFunction) -> FloatArray:
    """How far nine models of the correction lie from the one used: modes of ln factor, shape (k, n), k <= 2. [-]

    d_m = ln(factor_m / factor) for each of three disk functions with each of three SELENE phase functions, and
    C = mean of d_m d_m^T about the model used, not about their mean. A mode is an eigenvector of C times the root of
    its eigenvalue: one standard deviation that all channels share. The two largest hold more than 99 % of the trace of
    C; the second is kept however small its share, since the first is little but a level and the second is what bends
    bands (0.3-5 % where the level is 1-50 %). None are returned where all models agree (at 30, 0, 30 deg). The channel
    where a mode is largest has the positive sign.

    This is the spread between models in use, a stand-in for the unknown error of any one of them: it is not its
    statistical error, and the nine are no sample of anything. Parameters and errors as for `correction_factor`.
    """
    used = correction_factor(geometry, wavelength_nm, disk, phase)
    phases = [phase_function(name) for name in SPREAD_PHASES]
    models = [correction_factor(geometry, wavelength_nm, name, each) for name in DISKS for each in phases]
    distance = np.log(np.array(models) / used)
    _, size, shape = np.linalg.svd(distance / np.sqrt(len(models)), full_matrices=False)
    modes = (size[:, None] * shape)[:_MOST_MODES]
    modes = modes[np.abs(modes).max(axis=1) > _NEGLIGIBLE]
    largest = np.take_along_axis(modes, np.abs(modes).argmax(axis=1)[:, None], axis=1)
    return np.asarray(modes * np.sign(largest), dtype=np.float64)
