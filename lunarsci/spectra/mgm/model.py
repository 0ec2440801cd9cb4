"""A Modified Gaussian Model ready to be fitted: parameters by name, their prior and their bounds.

Constraints as they are written on a command line: NAME=VALUE, NAME=LOW:HIGH, NAME=FACTOR*OTHER+OFFSET, fo=70:5.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import ParameterError
from lunarsci.spectra.mgm import DEFAULT_CONTINUUM, MgmContinuum
from lunarsci.spectra.mgm.assemblages import Assemblage, assemblage

MGM_CONTINUA: tuple[MgmContinuum, ...] = get_args(MgmContinuum)

RANGE_NM = (400.0, 2600.0)
"""The polynomials are written on this interval, mapped to -1 to 1, so that coefficients compare between spectra: see
`FIT_RANGE_NM`."""
_DEGREES = {"quadratic": 2, "cubic": 3, "none": -1}
"""Of the polynomial, by the end of a continuum's name; others are straight lines."""


def is_logarithmic(name: MgmContinuum) -> bool:
    """Whether the polynomial is ln C itself (`log-quadratic`, and `none`, which is ln C = 0) and not C."""
    return name in ("log-quadratic", "none")


def continuum_basis(name: MgmContinuum, wavelength_nm: FloatArray) -> FloatArray:
    """Basis B, shape (n, m), of a continuum C = B c that stands inside ln C, or of ln C = B c (`is_logarithmic`).

    Columns are 1, u (u^2, u^3), with u the wavelength, or the wavenumber, mapped linearly so that 400 and 2600 nm
    become -1 and 1 (or 1 and -1). `none` has no columns. `wavelength_nm` has shape (n,) [nm]. Raises ParameterError
    for an unknown name.
    """
    if name not in MGM_CONTINUA:
        raise ParameterError(f"continuum '{name}' is unknown; choose one of: {', '.join(MGM_CONTINUA)}")
    low, high = RANGE_NM
    values, ends = wavelength_nm, (low, high)
    if name.startswith("wavenumber"):
        values, ends = 1e7 / wavelength_nm, (1e7 / high, 1e7 / low)
    u = 2 * (values - ends[0]) / (ends[1] - ends[0]) - 1
    degree = _DEGREES.get(name.rpartition("-")[2], 1)
    return np.ascontiguousarray(np.vander(u, degree + 1, increasing=True))


BOUND_SIGMAS = 4.0
"""Standard deviations of the priors within which bands are bound: they cut off 6e-5 of a normal law; assumed."""
MIN_FWHM_UM = 0.05
"""No band of a mineral is narrower; assumed."""
KINDS = ("center_nm", "fwhm_nm", "strength")
"""Parameters of a band, in their order: the ends of their names."""
NM_PER_UM = 1e3


@dataclass(frozen=True, slots=True, eq=False)
class MgmModel:
    """Parameters of a fit, in the kernel's units: wavelengths in micrometres.

    Attributes
    ----------
    assemblage, continuum : bands and the polynomial under them.
    names : p names: `c0`, `c1`, ... of the continuum, then `opx_1_center_nm`, `opx_1_fwhm_nm`, `opx_1_strength`, ...
    prior : (p,) mean. [-, um, um, -]
    precision : (p, p) inverse covariance of the prior; 0 where it is flat (continuum). Centres that follow the same
        composition are correlated.
    lower, upper : (p,) bounds; equal where a parameter is fixed.
    planes : rows (p,) and targets of ties, row @ parameters = target, which `prior` and `precision` also hold.
    whole : whether all channels of a spectrum are fitted, and not those of 400-2600 nm.
    """

    assemblage: Assemblage
    continuum: MgmContinuum
    names: tuple[str, ...]
    prior: FloatArray
    precision: FloatArray
    lower: FloatArray
    upper: FloatArray
    planes: tuple[tuple[FloatArray, float], ...] = ()
    whole: bool = False

    @property
    def degrees(self) -> int:
        """Number m of continuum coefficients."""
        return self.prior.size - 3 * len(self.assemblage.bands)

    @property
    def logarithmic(self) -> bool:
        """Whether the polynomial is ln C."""
        return is_logarithmic(self.continuum)

    @property
    def sigma(self) -> FloatArray:
        """(p,) standard deviation of the prior; infinite where it is flat, 0 for fixed ones. [as `prior`]"""
        sigma = np.full(self.prior.size, np.inf)
        sigma[self.degrees :] = np.sqrt(np.diag(np.linalg.inv(self.precision[self.degrees :, self.degrees :])))
        sigma[self.fixed] = 0.0
        return sigma

    @property
    def fixed(self) -> BoolArray:
        """(p,) True for parameters that may not move."""
        return np.asarray(self.lower == self.upper)

    @property
    def scale_free(self) -> bool:
        """Whether a constant factor of the reflectance changes nothing but the continuum coefficients."""
        m = self.degrees
        unbounded = np.isinf(self.lower[:m]).all() and np.isinf(self.upper[:m]).all()
        return m > 0 and bool(unbounded and not self.precision[:m].any())

    def basis(self, wavelength_nm: FloatArray) -> FloatArray:
        """Continuum basis, (n, m), on wavelengths in nm."""
        return continuum_basis(self.continuum, wavelength_nm)

    def index(self, name: str) -> int:
        """Position of a parameter. Raises ParameterError when there is none of that name."""
        if name not in self.names:
            raise ParameterError(f"there is no parameter '{name}'; {self.assemblage.name} has: {', '.join(self.names)}")
        return self.names.index(name)

    def bounded(self, name: str, lower: float, upper: float) -> "MgmModel":
        """With a parameter kept between two values in the unit of its name; equal values fix it.

        Raises ParameterError for an unknown name, bounds that are the wrong way round, widths not above 0, and
        strengths above 0 unless the model has them (`model_of` a `.fit` file).
        """
        k, unit = self.index(name), unit_of(name)
        faults = {
            "bounds must rise": not lower <= upper,
            "a width must stay above 0 nm": name.endswith("fwhm_nm") and not lower > 0,
            "bands absorb, strengths are 0 or below": name.endswith("strength") and upper > 0 >= self.upper[k],
        }
        if wrong := [fault for fault, there in faults.items() if there]:
            raise ParameterError(f"{name} from {lower:g} to {upper:g}: {wrong[0]}")
        low, high = self.lower.copy(), self.upper.copy()
        low[k], high[k] = lower / unit, upper / unit
        return replace(self, lower=low, upper=high)

    def tied(self, name: str, factor: float, other: str, offset: float) -> "MgmModel":
        """With name = factor * other + offset, in the units of the names, exact to a thousandth of a nanometre.

        Made by a prior that leaves no room beside that line; the bounds of both remain. Raises ParameterError for an
        unknown name, one tied to itself, or a continuum coefficient tied to a band.
        """
        a, b = self.index(name), self.index(other)
        if a == b or min(a, b) < self.degrees <= max(a, b):
            raise ParameterError(
                f"{name} cannot be tied to {other}: none to itself, no continuum coefficient to a band"
            )
        row = np.zeros(self.prior.size)
        row[a], row[b] = 1.0, -factor * unit_of(other) / unit_of(name)
        return self.on_plane(row, offset / unit_of(name))

    def on_plane(self, row: FloatArray, target: float) -> "MgmModel":
        """With a prior that leaves no room beside row @ parameters = target, (p,), in the kernel's units.

        Its mean moves along the covariance C to the plane, m + C r (t - r'm) / (r'C r + s^2), as a normal law does that
        is told r'x = t with an error of s. For continuum coefficients, which have no prior, it is the nearest point.
        """
        precision, m = self.precision + np.outer(row, row) / TIE_SIGMA**2, self.degrees
        prior, part = self.prior.copy(), slice(None, m) if row[:m].any() else slice(m, None)
        if part.stop is None:
            toward = np.linalg.solve(self.precision[part, part], row[part])
            prior[part] += toward * (target - row @ prior) / (row[part] @ toward + TIE_SIGMA**2)
        else:
            pull = self.precision @ prior + row * target / TIE_SIGMA**2
            prior[part] = np.linalg.lstsq(precision[part, part], pull[part], rcond=None)[0]
        return replace(self, prior=prior, precision=precision, planes=(*self.planes, (row, target)))


TIE_SIGMA = 1e-6
"""Of a tie, in the kernel's units: a thousandth of a nanometre, a millionth of ln R."""


def unit_of(name: str) -> float:
    """Units of a parameter's name per unit of the kernel: 1000 for nanometres, else 1."""
    return NM_PER_UM if name.endswith("_nm") else 1.0


def mgm_model(
    name: str = "OL-OPX-CPX",
    continuum: MgmContinuum = DEFAULT_CONTINUUM,
    compositions: Mapping[str, tuple[float, float]] | None = None,
) -> MgmModel:
    """The model of an assemblage: priors from its tables, bounds four prior standard deviations wide, strengths <= 0.

    The bands of one mineral come together: their strengths are correlated a priori.

    Parameters
    ----------
    name : see `assemblage`.
    continuum : one of `MGM_CONTINUA`.
    compositions : `fo`, `fs`, `wo` to mean and standard deviation, instead of the table's. [mol %]

    Raises
    ------
    ParameterError for unknown names, and compositions outside 0-100 or that the assemblage does not have.
    """
    chosen = assemblage(name)
    degrees = continuum_basis(continuum, np.array([1000.0])).shape[1]
    beliefs = {item.key: (item.mean, item.sigma) for item in chosen.compositions}
    shifts = _checked(beliefs, dict(compositions or {}), chosen.name)
    chosen = _believing(chosen, shifts)
    bands = chosen.bands
    prior = np.array([[band.center_nm / NM_PER_UM, band.fwhm_nm / NM_PER_UM, 0.0] for band in bands])
    covariance = prior_covariance(chosen)
    reach = BOUND_SIGMAS * np.sqrt(np.diag(covariance)).reshape(-1, 3)
    lower, upper = prior - reach, prior + reach
    lower[:, 1] = np.maximum(lower[:, 1], MIN_FWHM_UM)
    lower[:, 2], upper[:, 2] = -np.inf, 0.0
    precision = np.zeros((degrees + prior.size, degrees + prior.size))
    precision[degrees:, degrees:] = np.linalg.inv(covariance)
    flat = np.full(degrees, np.inf)
    return MgmModel(
        chosen,
        continuum,
        tuple(f"c{k}" for k in range(degrees)) + tuple(f"{band.key}_{kind}" for band in bands for kind in KINDS),
        np.concatenate([np.zeros(degrees), prior.ravel()]),
        precision,
        np.concatenate([-flat, lower.ravel()]),
        np.concatenate([flat, upper.ravel()]),
    )


def stated_for(name: str, compositions: Mapping[str, tuple[float, float]] | None) -> dict[str, tuple[float, float]]:
    """Those of the compositions that an assemblage has."""
    keys = {item.key for item in assemblage(name).compositions}
    return {key: value for key, value in (compositions or {}).items() if key in keys}


def _checked(
    beliefs: Mapping[str, tuple[float, float]], wanted: Mapping[str, tuple[float, float]], name: str
) -> dict[str, tuple[float, float]]:
    """By composition: how far its mean is from the table's, and its standard deviation. [mol %]"""
    for key, (mean, sigma) in wanted.items():
        if key not in beliefs or not (0 <= mean <= 100 and 0 < sigma <= 100):
            names = ", ".join(beliefs) or "none"
            raise ParameterError(
                f"composition {key} = {mean:g} +- {sigma:g}: {name} has {names}; give 0-100 mol %, an error above 0"
            )
    return {
        key: (wanted[key][0] - mean, wanted[key][1]) if key in wanted else (0.0, sigma)
        for key, (mean, sigma) in beliefs.items()
    }


def _believing(chosen: Assemblage, shifts: Mapping[str, tuple[float, float]]) -> Assemblage:
    """The assemblage with the compositions that are believed, and its centres there."""
    compositions = tuple(
        replace(item, mean=item.mean + shifts[item.key][0], sigma=shifts[item.key][1]) for item in chosen.compositions
    )
    bands = tuple(
        replace(
            band,
            center_nm=band.center_nm + sum(slope * shifts[key][0] for key, slope in band.slopes_nm.items()),
        )
        for band in chosen.bands
    )
    return replace(chosen, bands=bands, compositions=compositions)


def center_slopes(assemblage: Assemblage) -> FloatArray:
    """Change of (centre, FWHM, strength) of all bands per mol % of each composition, shape (k, c). [um, um, -]"""
    slopes = np.zeros((3 * len(assemblage.bands), len(assemblage.compositions)))
    for column, composition in enumerate(assemblage.compositions):
        slopes[::3, column] = [band.slopes_nm.get(composition.key, 0.0) / NM_PER_UM for band in assemblage.bands]
    return slopes


def prior_covariance(assemblage: Assemblage) -> FloatArray:
    """Prior covariance of (centre, FWHM, strength) of all bands, shape (k, k). [um, um, -]

    Centres that follow the same composition vary together, and so do the strengths of one mineral's bands.
    """
    bands = assemblage.bands
    sigma = [(band.center_sigma_nm / NM_PER_UM, band.fwhm_sigma_nm / NM_PER_UM, band.strength_sigma) for band in bands]
    covariance = np.diag(np.ravel(sigma) ** 2)
    spread = center_slopes(assemblage) * [composition.sigma for composition in assemblage.compositions]
    covariance += spread @ spread.T
    for mineral in {band.mineral for band in bands}:
        shared = np.zeros(3 * len(bands))
        shared[2::3] = [band.strength_sigma * band.strength_loading * (band.mineral == mineral) for band in bands]
        together = np.outer(shared, shared)
        covariance += together - np.diag(np.diag(together))
    return covariance


_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
LARGEST = 1e6
"""Factors and offsets beyond describe no bands."""
SLACK = 1e-6
"""By which the sides of a tie may miss each other, in the units of names: rounding."""
_FORMS = {
    "fix": (rf"(\w+)(?:=({_NUMBER}))?", "NAME or NAME=VALUE, such as opx_1_center_nm=920"),
    "bound": (rf"(\w+)=({_NUMBER}):({_NUMBER})", "NAME=LOW:HIGH, such as opx_1_center_nm=900:940"),
    "tie": (
        rf"(\w+)=(?:({_NUMBER})\*)?([a-z]\w*)([-+](?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)?",
        "NAME=FACTOR*OTHER+OFFSET, such as cpx_1_fwhm_nm=opx_1_fwhm_nm+20",
    ),
    "composition": (rf"(\w+)=({_NUMBER}):({_NUMBER})", "KEY=MEAN:ERROR in mol %, such as fo=70:5"),
}


def constrained(
    model: MgmModel, *, fixed: Sequence[str] = (), bounds: Sequence[str] = (), ties: Sequence[str] = ()
) -> MgmModel:
    """The model with parameters fixed, bounded or tied, in the units of their names.

    `fixed` holds `NAME` (at the prior's mean) or `NAME=VALUE`, `bounds` `NAME=LOW:HIGH`, `ties` `NAME=OTHER`,
    `NAME=FACTOR*OTHER` or either with `+OFFSET`. Raises ParameterError for anything else, for unknown names, for a
    parameter that is constrained twice, and for ties in a circle or that no values within the bounds obey.
    """
    taken: set[str] = set()
    for text in fixed:
        name, value = _parsed("fix", text, taken)
        at = float(value) if value else _prior_mean(model, name)
        model = model.bounded(name, at, at)
    for text in bounds:
        name, low, high = _parsed("bound", text, taken)
        model = model.bounded(name, float(low), float(high))
    others: dict[str, str] = {}
    for text in ties:
        name, factor, other, offset = _parsed("tie", text, taken)
        if name != other and name in _followed(other, others):
            raise ParameterError(f"tie '{text}' closes a circle: {other} follows {name} already")
        others[name] = other
        _refuse_empty(model, text, name, float(factor or 1), other, float(offset or 0))
        model = model.tied(name, float(factor or 1), other, float(offset or 0))
    return model


def _parsed(form: str, text: str, taken: set[str]) -> tuple[str, ...]:
    """The parts of a constraint, of a name that is not `taken` yet."""
    pattern, usage = _FORMS[form]
    match = re.fullmatch(pattern, "".join(text.split()))
    if not match or match[1] in taken:
        raise ParameterError(f"{form} '{text}': write {usage}; each name once")
    taken.add(match[1])
    return match.groups()


def _prior_mean(model: MgmModel, name: str) -> float:
    if model.index(name) < model.degrees:
        raise ParameterError(f"`fix` {name}: a continuum coefficient has no usual value; write {name}=VALUE")
    return float(model.prior[model.index(name)]) * unit_of(name)


def _followed(name: str, others: Mapping[str, str]) -> Iterator[str]:
    """The parameter and all that it follows."""
    yield name
    while name in others:
        name = others[name]
        yield name


def _refuse_empty(model: MgmModel, text: str, name: str, factor: float, other: str, offset: float) -> None:
    """Refuse a tie whose two sides have no value in common within the bounds."""
    ends = np.array([[model.lower[k], model.upper[k]] for k in (model.index(name), model.index(other))])
    left, right = ends[0] * unit_of(name), ends[1] * unit_of(other)
    with np.errstate(invalid="ignore", over="ignore"):
        right = np.sort(np.nan_to_num(factor * right, nan=0.0) + offset)
    large = max(abs(factor), abs(offset)) > LARGEST
    if large or max(left[0], right[0]) > min(left[1], right[1]) + SLACK:
        raise ParameterError(
            f"tie '{text}' cannot hold: {name} stays within {left[0]:g} to {left[1]:g}, its other side within "
            f"{right[0]:g} to {right[1]:g}"
        )


def parse_compositions(text: str) -> dict[str, tuple[float, float]]:
    """`fo=70:5,fs=30:10` as {"fo": (70, 5), "fs": (30, 10)}: mean and standard deviation. [mol %]

    Raises ParameterError for anything else.
    """
    taken: set[str] = set()
    parsed = [_parsed("composition", part.lower(), taken) for part in text.split(",")]
    return {key: (float(mean), float(sigma)) for key, mean, sigma in parsed}
