"""Reduction of reflectance factors to the standard geometry, and how far the models for it disagree.

Disk functions D: how the radiance factor varies over a sphere at one phase angle, RADF = D(i, e, g) f(g).

RADF = pi I / E0 is cos i times the reflectance factor. A disk function matters only as a ratio between two geometries;
the three here are scaled differently.
"""

from collections.abc import Callable
from math import atan2, cos, pi, pow, radians, sin

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError
from lunarsci.spectra.photometry.phase import STANDARD, Geometry, PhaseFunction, phase_function

LOMMEL_SEELIGER_INCIDENCE_DEG = 65.0
"""Above, Lommel-Seeliger counts as too slow; assumed, within the 57-77 deg at which `lommel_seeliger` says that it
is."""
MCEWEN_PHASE_DEG = 103.9
"""Where the polynomial of `mcewen_weight` goes through zero: McEwen (1996), Lunar Planet. Sci. XXVII, 841. [deg]"""
GRAZING_DEG = 80.0
"""Above, no disk function was compared with measurements; assumed."""


def lommel_seeliger(geometry: Geometry) -> float:
    """Lommel-Seeliger: D = mu0 / (mu0 + mu). [-]

    Light scattered once in a dark, flat, infinitely deep layer. Without shadows of relief it falls too slowly towards
    the terminator: on 23 Chang'E-4 spectra of two patches (lunar day 10, incidence 57-77 deg) it leaves 6-7 % between
    geometries of one patch whatever the phase function is.

    Hapke (2012), Theory of Reflectance and Emittance Spectroscopy, 10.1017/CBO9781139025683.
    """
    return geometry.cos_incidence / (geometry.cos_incidence + geometry.cos_emission)


def akimov(geometry: Geometry) -> float:
    """Akimov's disk function without parameters, of an extremely rough surface. [-]

    D = cos(g/2) cos[pi / (pi - g) (gamma - g/2)] (cos beta)^(g / (pi - g)) / cos gamma, with the photometric longitude
    and latitude from mu = cos beta cos gamma and mu0 = cos beta cos(gamma - g). At g = 0, where gamma is undetermined,
    D = 1. For a surface that is rough at every angle of view: not within some 10 deg of limb or terminator.

    A phase angle outside the triangle of the other two (`Geometry` lets 0.5 deg pass) is moved to its edge.

    Shkuratov et al. (2011), Planet. Space Sci. 59, 1326, 10.1016/j.pss.2011.06.011.
    """
    low, high = geometry.phase_range_deg
    phase = radians(min(max(geometry.phase_deg, low), high))
    longitude = atan2(geometry.cos_incidence - geometry.cos_emission * cos(phase), geometry.cos_emission * sin(phase))
    cos_latitude = min(geometry.cos_emission / cos(longitude), 1.0)
    stretch = pi / (pi - phase)
    rough = pow(cos_latitude, phase / (pi - phase))
    return cos(phase / 2) * cos(stretch * (longitude - phase / 2)) * rough / cos(longitude)


def mcewen(geometry: Geometry) -> float:
    """Lunar-Lambert: D = 2 L mu0 / (mu0 + mu) + (1 - L) mu0 with L from `mcewen_weight`. [-]

    McEwen (1996), A precise lunar photometric function, Lunar Planet. Sci. XXVII, 841.
    """
    weight = mcewen_weight(geometry.phase_deg)
    return 2 * weight * lommel_seeliger(geometry) + (1 - weight) * geometry.cos_incidence


def mcewen_weight(phase_deg: float) -> float:
    """Share of Lommel-Seeliger in `mcewen`: L = 1 - 0.019 g + 2.42e-4 g^2 - 1.46e-6 g^3, not below 0. [-]

    phase_deg : 0 to 180. Above 103.9 deg the polynomial is negative and D could be; as in the reduction of the SELENE
    Spectral Profiler (Kouyama et al. 2016, 10.1016/j.pss.2016.02.003), L is 0 there: Lambert's law.
    """
    return max(1 - 0.019 * phase_deg + 2.42e-4 * phase_deg**2 - 1.46e-6 * phase_deg**3, 0.0)


DISKS: dict[str, Callable[[Geometry], float]] = {
    "lommel-seeliger": lommel_seeliger,
    "akimov": akimov,
    "mcewen": mcewen,
}


def disk_function(name: str) -> Callable[[Geometry], float]:
    """The disk function of that name. Raises ParameterError for an unknown one."""
    if name not in DISKS:
        raise ParameterError(f"disk function '{name}' is unknown; choose one of: {', '.join(DISKS)}")
    return DISKS[name]


def outside(name: str, geometry: Geometry) -> str:
    """What to know when a disk function is used beyond where it is good; '' within."""
    disk_function(name)
    if name == "lommel-seeliger" and geometry.incidence_deg > LOMMEL_SEELIGER_INCIDENCE_DEG:
        return (
            f"incidence {geometry.incidence_deg:.1f} deg: above {LOMMEL_SEELIGER_INCIDENCE_DEG:g} deg Lommel-Seeliger, "
            "which knows no shadows of relief, leaves differences of 6-7 % between geometries; compare with akimov"
        )
    if name == "mcewen" and geometry.phase_deg > MCEWEN_PHASE_DEG:
        return (
            f"phase {geometry.phase_deg:.1f} deg: the weight L of McEwen's polynomial would be negative above "
            f"{MCEWEN_PHASE_DEG:g} deg and is held at 0 (Lambert)"
        )
    if name == "akimov" and max(geometry.incidence_deg, geometry.emission_deg) > GRAZING_DEG:
        return (
            f"incidence {geometry.incidence_deg:.1f} and emission {geometry.emission_deg:.1f} deg: Akimov's function "
            f"is not good above {GRAZING_DEG:g} deg, near terminator and limb"
        )
    return ""


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
