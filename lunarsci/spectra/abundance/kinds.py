"""The kind of target: mixed powders, powder of a dark rock, weathered soil, solid rock; or an outlier.

Nine numbers of a spectrum, means over at least 50 nm so that neither resolution nor smoothing changes them: ln R near
750 nm, and ln R elsewhere less that. Each component of a kind is a law of them with the tails of Student's t, whose
mean and covariance stand in `kinds.csv`. A soil under a rover and a rock beside it look alike, and a slab in the
laboratory looks like a coarse powder, so that a solid rock is stated, never found.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal, get_args

import numpy as np

from lunarsci.arrays import SIGNIFICANCE, BoolArray, FloatArray, IntArray
from lunarsci.errors import ParameterError
from lunarsci.io.tables import table_rows
from lunarsci.spectra.noise import scatter_noise_rows
from lunarsci.spectra.spectrum import Spectrum

Kind = Literal["powder-mixture", "dark-rock-powder", "weathered-soil", "solid-rock"]
KINDS: tuple[Kind, ...] = get_args(Kind)
NOT_DETERMINED = "not-determined"
TABLE = "kinds.csv"
WINDOWS_NM = {
    "level": (700.0, 800.0),
    "blue": (450.0, 500.0),
    "visible": (530.0, 600.0),
    "um0_94": (880.0, 1000.0),
    "um1_06": (1000.0, 1120.0),
    "um1_25": (1180.0, 1320.0),
    "um1_52": (1450.0, 1600.0),
    "um1_96": (1850.0, 2060.0),
    "um2_30": (2220.0, 2380.0),
}
"""Where the features are taken that `kinds.csv` has the laws of: the blue and visible slopes, both sides of the 1 um
band, and the 2 um band."""
VISIBLE_BLUE = 0.35
"""`visible`, as `kinds.csv` has its law, is ln R at 565 nm less this share of `blue`, both relative to 750 nm: what the
slope does not explain."""
FREEDOM = 10.0
"""Degrees of freedom of the tails; assumed."""
LEAST_FEATURES = 6
"""Features, of nine, without which no kind is named."""
SURE = {"powder-mixture": 0.9, "dark-rock-powder": 0.8, "weathered-soil": 0.8, "solid-rock": np.inf}
"""Probability from which a kind is named; assumed."""
WEATHERED = 0.5
"""Probability of a surface that space has weathered, soil or rock, from which it counts as one: the more probable."""
SCALED = 1e-6
"""How near 1 a reflectance is that was scaled to it: files write six digits."""
BRIGHTEST = 1.1
"""A reflectance above it is none of a powder: it was scaled; assumed, as when `kinds.csv` was made."""


@dataclass(frozen=True, slots=True)
class KindVerdict:
    """What kind of target a spectrum shows.

    Attributes
    ----------
    kind : one of `KINDS`, or `NOT_DETERMINED`.
    probabilities : by kind, before anything is known of the target, each as likely as the others; they sum to 1. [-]
    weathered : probability of a surface that space has weathered, soil or rock. [-]
    outlier : whether the spectrum is unlike all that is known of its kind, and where that is open, of every kind; or
        far likelier of another kind than stated; or no reflectance, but scaled.
    stated : whether the kind was stated, not found.
    reasons : sentences; empty where there is nothing to say.
    """

    kind: str
    probabilities: Mapping[str, float]
    weathered: float
    outlier: bool
    stated: bool = False
    reasons: tuple[str, ...] = ()

    @property
    def is_weathered(self) -> bool:
        """Whether space has weathered the surface, as far as is known."""
        return self.kind == "weathered-soil" or (not self.stated and self.weathered >= WEATHERED)

    def to_dict(self) -> dict[str, Any]:
        """The key `kind` of `lunarsci spectra unmix --json`."""
        return {
            "name": self.kind,
            "stated": self.stated,
            "stranger": self.outlier,
            "probabilities": dict(self.probabilities),
            "weathered": self.weathered,
            "reasons": list(self.reasons),
        }


@dataclass(frozen=True, slots=True, eq=False)
class KindModel:
    """Normal laws of the features, one for each component of a kind.

    Attributes
    ----------
    components : k names; `kinds` the kind of each.
    mean, covariance : (k, 9) and (k, 9, 9), of the features in the order of `WINDOWS_NM`. [ln R]
    """

    components: tuple[str, ...]
    kinds: tuple[Kind, ...]
    mean: FloatArray
    covariance: FloatArray

    def probabilities(self, features: FloatArray, noise: FloatArray) -> FloatArray:
        """(n, k) of the components; those of one kind share it equally. Features that are NaN are not used."""
        square, ln_volume = self._distances(features, noise)
        used = np.isfinite(features).sum(axis=1)[:, None]
        share = np.array([1.0 / self.kinds.count(kind) for kind in self.kinds])
        ln_density = np.log(share) - 0.5 * ln_volume - 0.5 * (FREEDOM + used) * np.log1p(square / FREEDOM)
        density = np.exp(ln_density - ln_density.max(axis=1, keepdims=True))
        return np.asarray(density / density.sum(axis=1, keepdims=True))

    def likeness(self, features: FloatArray) -> FloatArray:
        """(n, k) share of a component's spectra that lie farther from its mean. Noise does not excuse a spectrum."""
        from scipy.special import chdtrc

        square, _ = self._distances(features, np.zeros_like(features))
        return np.asarray(chdtrc(np.isfinite(features).sum(axis=1)[:, None], square))

    def _distances(self, features: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Squared distance from each component, and the logarithm of the determinant, (n, k) each."""
        there = np.isfinite(features)
        both = there[:, None, :, None] & there[:, None, None, :]
        of_noise = np.where(there, noise**2, 0.0)[:, None, :, None] * np.eye(features.shape[1])
        absent = np.where(there, 0.0, 1.0)[:, None, :, None] * np.eye(features.shape[1])
        covariance = np.where(both, self.covariance[None] + of_noise, 0.0) + absent
        apart = np.where(there, features, 0.0)[:, None, :] - np.where(there[:, None, :], self.mean[None], 0.0)
        solved = np.linalg.solve(covariance, apart[..., None])[..., 0]
        return np.sum(apart * solved, axis=-1), np.linalg.slogdet(covariance)[1]


@cache
def embedded_kinds() -> KindModel:
    """The components of `kinds.csv`."""
    rows: dict[str, list[Mapping[str, str]]] = {}
    for row in table_rows(TABLE):
        rows.setdefault(row["component"], []).append(row)
    names = list(WINDOWS_NM)
    mean = np.array([[float(row["mean"]) for row in part] for part in rows.values()])
    covariance = np.array([[[float(row[name]) for name in names] for row in part] for part in rows.values()])
    kinds: list[Kind] = [next(kind for kind in KINDS if kind == part[0]["kind"]) for part in rows.values()]
    return KindModel(tuple(rows), tuple(kinds), mean, covariance)


def spectral_features(spectrum: Spectrum) -> tuple[FloatArray, FloatArray]:
    """`features_of_rows` of the usable channels of one spectrum, (9,) each."""
    usable, uncertainty = spectrum.usable, spectrum.uncertainty
    errors = None if uncertainty is None else uncertainty[usable][None]
    features, noise = features_of_rows(spectrum.wavelength_nm[usable], spectrum.reflectance[usable][None], errors)
    return features[0], noise[0]


def features_of_rows(
    wavelength_nm: FloatArray, reflectance: FloatArray, uncertainty: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Features (n, 9) and their standard errors by noise [-]: ln R near 750 nm, and ln R in `WINDOWS_NM` less it.

    `visible` is the distance from the line between `blue` and 750 nm. NaN where no channel lies in the window. The
    level of a spectrum that is 1 at a channel, or beyond 1.1, is not used: it was scaled. Of channels (c,) and
    reflectance above 0, (n, c). [nm, -]
    """
    rows, channels = reflectance.shape
    mean, error = (np.full((rows, len(WINDOWS_NM)), np.nan) for _ in range(2))
    if not channels:
        return mean, error
    noise = scatter_noise_rows(reflectance, channels) if uncertainty is None else uncertainty
    for k, (low, high) in enumerate(WINDOWS_NM.values()):
        inside = np.flatnonzero((wavelength_nm >= low) & (wavelength_nm <= high))
        if inside.size:
            part = slice(inside[0], inside[-1] + 1)
            mean[:, k] = reflectance[:, part].mean(axis=1)
            error[:, k] = np.sqrt((noise[:, part] ** 2).mean(axis=1) / inside.size) / mean[:, k]
    features = np.log(mean)
    level = features[:, 0].copy()
    features -= level[:, None]
    features[:, 2] -= VISIBLE_BLUE * features[:, 1]
    features[:, 0] = np.where(_are_scaled(reflectance), np.nan, level)
    error[:, 1:] = np.hypot(error[:, 1:], error[:, :1])
    return features, error


def _are_scaled(reflectance: FloatArray) -> BoolArray:
    return np.asarray((reflectance.max(axis=1) > BRIGHTEST) | np.any(np.abs(reflectance - 1.0) < SCALED, axis=1))


def find_kinds(
    spectra: Sequence[Spectrum], stated: Kind | None = None, model: KindModel | None = None
) -> list[KindVerdict]:
    """The kind of target of each spectrum, or `NOT_DETERMINED` where two kinds are nearly as likely.

    Parameters
    ----------
    spectra : reflectance; features outside of their channels are left out, and with fewer than 6 of 9 the kind is open.
    stated : the kind where it is known; then only `outlier` is judged, by that kind.
    model : instead of the embedded one.

    Raises
    ------
    ParameterError for a kind that is none of `KINDS`.
    """
    if stated is not None and stated not in KINDS:
        raise ParameterError(f"kind '{stated}'; give one of {', '.join(KINDS)}")
    if not spectra:
        return []
    taken = [spectral_features(spectrum) for spectrum in spectra]
    features, noise = (np.array([item[k] for item in taken]) for k in (0, 1))
    law = model or embedded_kinds()
    shares, named, weathered = _named_rows(law, features, law.probabilities(features, noise))
    rows = zip(features, shares, named.tolist(), weathered.tolist(), law.likeness(features), strict=True)
    return [_verdict(law, *row, stated) for row in rows]


def kinds_of_rows(
    wavelength_nm: FloatArray, reflectance: FloatArray, stated: Kind | None = None
) -> tuple[IntArray, FloatArray, BoolArray]:
    """Of spectra (n, c) above 0 on the same channels (c,) what `find_kinds` says, as arrays. [nm, -]

    Returns the place in `KINDS`, -1 where it is open; the probability of no mixture of powders; whether it is taken as
    weathered; (n,) each.
    """
    law, count = embedded_kinds(), len(reflectance)
    features, noise = features_of_rows(wavelength_nm, reflectance)
    shares, named, likely = _named_rows(law, features, law.probabilities(features, noise))
    weathered = (named == KINDS.index("weathered-soil")) | (likely >= WEATHERED)
    if stated is None:
        return named, 1.0 - shares[:, 0], weathered
    given = KINDS.index(stated)
    return np.full(count, given), np.full(count, float(given > 0)), weathered | (stated == "weathered-soil")


def _named_rows(law: KindModel, features: FloatArray, chance: FloatArray) -> tuple[FloatArray, IntArray, FloatArray]:
    """Probabilities of the kinds (n, 4), number of the one that is named or -1, and probability of a weathered surface,
    (n,) each, of probabilities (n, k)."""
    shares = np.column_stack([chance[:, [one == kind for one in law.kinds]].sum(axis=1) for kind in KINDS])
    likely = shares.argmax(axis=1)
    sure = shares.max(axis=1) >= np.array([SURE[kind] for kind in KINDS])[likely]
    sure &= np.isfinite(features).sum(axis=1) >= LEAST_FEATURES
    weathered = chance[:, [name in ("soil", "rover-rock") for name in law.components]].sum(axis=1)
    return shares, np.where(sure, likely, -1), weathered


def _verdict(
    law: KindModel, features: FloatArray, chance: FloatArray, named: int, weathered: float, likeness: FloatArray,
    stated: Kind | None,
) -> KindVerdict:  # fmt: skip
    shares: dict[str, float] = dict(zip(KINDS, chance.tolist(), strict=True))
    kind = stated or (NOT_DETERMINED if named < 0 else KINDS[named])
    reasons = [] if np.isfinite(features[0]) else ["no reflectance: scaled, or its continuum removed"]
    outlier = bool(reasons)
    if np.isfinite(features).sum() < LEAST_FEATURES:
        reasons, outlier = ["too few channels from 450 to 2380 nm to know its kind", *reasons], True
    else:
        judged = [kind == NOT_DETERMINED or one == kind for one in law.kinds]
        if likeness[judged].max() < SIGNIFICANCE:
            reasons.append(f"unlike every {'kind' if kind == NOT_DETERMINED else kind} known")
            outlier = True
        if stated and shares[stated] < SIGNIFICANCE:
            reasons.append(f"looks like {max(shares, key=shares.__getitem__)} rather than {stated}")
            outlier = True
        if kind == NOT_DETERMINED:
            reasons.append(_between(shares, weathered))
    return KindVerdict(kind, shares, weathered, outlier, stated is not None, tuple(reasons))


def _between(shares: Mapping[str, float], weathered: float) -> str:
    pair = ["weathered-soil", "solid-rock"] if weathered >= WEATHERED else list(shares)
    shown = [f"{name} {100 * shares[name]:.0f} %" for name in sorted(pair, key=lambda kind: -shares[kind])[:2]]
    alike = ", which look alike" if weathered >= WEATHERED else ""
    return f"{', '.join(shown)}{alike}: not decided, state the kind"
