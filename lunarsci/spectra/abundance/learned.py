"""Shares of minerals as small networks foretell them from ln R, learned from laboratory spectra and mixtures of them.

Each network gives, for each mineral, probabilities of the shares 0, 5, ..., 100 %; their mean is taken. Networks that
were told which minerals there are give the others none. `spectra_data/make_share_networks.py` trains them.

Any sampling is brought to channels of 20 nm. Where channels are missing, or a spectrum is noisy, spectra are drawn that
may be behind it, from the normal law of the spectra learned from (a factor analysis), and the networks see each of
them: Rubin (1987), Multiple Imputation for Nonresponse in Surveys, 10.1002/9780470316696. Behind a spectrum that lies
beyond the law they spread by as much more.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.io.tables import SPECTRA_DATA
from lunarsci.minerals import WEIGHED
from lunarsci.spectra.spectrum import NARROW_NM, Spectrum

TABLE = "share_networks.npz"
STEP_NM = 20.0
"""Between channels of the networks."""
GRID_NM = np.arange(450.0, 2451.0, STEP_NM)
"""Channels on which networks see spectra, (101,)."""
SHARES = np.linspace(0.0, 1.0, 21)
"""Shares that the networks have an output for."""
NOISE = 0.02
"""Noise of ln R at 20 nm up to which networks see a spectrum as it is; measured: they were trained with up to that."""
DRAWS = 12
"""Pairs of spectra drawn where some is missing; measured: with 96 mean shares of 60 spectra of RELAB, cut or noisy,
are others by 0.3 % root mean square, 1.6 % at most."""
LEAST_DEPTH = 0.03
"""Depth below the hull, in ln R, from which the shape that networks see is a band's: they were trained with it."""
AT_ONCE = 4096
"""Spectra that go through the networks together."""


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """One network, as `unpacked` takes it from its file: from f features and 4 flags of minerals to 4 x 21 odds.

    Attributes
    ----------
    layers : weights (i, o) and biases (o,) of each, from i numbers to o; all but the last end in max(x, 0).
    mean, scale : (f,) of the features learned from.
    shaped : whether it sees shapes below the hull.
    """

    layers: tuple[tuple[FloatArray, FloatArray], ...]
    mean: FloatArray
    scale: FloatArray
    shaped: bool

    def probabilities(self, features: FloatArray, allowed: FloatArray) -> FloatArray:
        """(n, 4, 21) of what it sees of n spectra (`features`) and of which minerals there may be, (n, 4)."""
        x = np.hstack([(features - self.mean) / self.scale, allowed])
        for number, (weight, bias) in enumerate(self.layers):
            x = x @ weight + bias
            if number < len(self.layers) - 1:
                x = np.maximum(x, 0.0)
        power = x.reshape(-1, len(WEIGHED), SHARES.size)
        odds = np.exp(power - power.max(axis=-1, keepdims=True))
        return only(odds / odds.sum(axis=-1, keepdims=True), allowed)


@dataclass(frozen=True, slots=True, eq=False)
class Background:
    """Normal law of ln R of spectra learned from, on `GRID_NM`.

    Attributes
    ----------
    mean, unique : (101,) mean, and standard deviation of each channel alone. [ln R]
    factors : (k, 101); the covariance is factors' factors + unique^2 on the diagonal.
    """

    mean: FloatArray
    factors: FloatArray
    unique: FloatArray

    def behind(self, seen: FloatArray, there: BoolArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean (n, 101) and root of the covariance (101, 101) of what spectra seen (n, t) may be; noise (t,)."""
        whole = self.factors.T @ self.factors + np.diag(self.unique**2)
        among = whole[np.ix_(there, there)] + np.diag(noise**2)
        gain = np.linalg.solve(among, whole[there]).T
        left = whole - gain @ whole[there]
        sizes, axes = np.linalg.eigh((left + left.T) / 2)
        return self.mean + (seen - self.mean[there]) @ gain.T, axes * np.sqrt(np.maximum(sizes, 0.0))

    def ln_distance(self, seen: FloatArray, there: BoolArray, noise: FloatArray) -> FloatArray:
        """Logarithm of the squared distance of spectra seen (n, t) from the mean, by the law, over t; (n,)."""
        among = self.factors.T[there] @ self.factors[:, there] + np.diag(self.unique[there] ** 2 + noise**2)
        apart = seen - self.mean[there]
        square = np.sum(apart * np.linalg.solve(among, apart.T).T, axis=1) / there.sum()
        return np.asarray(np.log(square))


@dataclass(frozen=True, slots=True, eq=False)
class Foretold:
    """What networks say of n spectra.

    Attributes
    ----------
    probabilities : (n, 4, 21) of `SHARES` of each mineral of `WEIGHED`.
    ln_distance : (n,) from the spectra learned from (`Background.ln_distance`).
    missing : (n,) part of `GRID_NM` without a channel, 0 to 1.
    shallow : (n,) ln of `LEAST_DEPTH` over the depth of the deepest band, 0 if that is deeper, at most ln 3.
    """

    probabilities: FloatArray
    ln_distance: FloatArray
    missing: FloatArray
    shallow: FloatArray

    @classmethod
    def of_nothing(cls, count: int) -> "Foretold":
        """Of spectra that have no channel here: any share is as likely."""
        even = np.full((count, len(WEIGHED), SHARES.size), 1.0 / SHARES.size)
        return cls(even, np.zeros(count), np.ones(count), np.full(count, np.log(3.0)))

    def put(self, rows: Sequence[int], other: "Foretold") -> None:
        """Take over what was found of some."""
        for name in ("probabilities", "ln_distance", "missing", "shallow"):
            getattr(self, name)[rows] = getattr(other, name)


def only(probabilities: FloatArray, allowed: FloatArray) -> FloatArray:
    """With a share of 0 of the minerals that may not be there."""
    allowed_only = probabilities * allowed[:, :, None]
    allowed_only[:, :, 0] += 1.0 - allowed
    return np.asarray(allowed_only)


def below_hull(ln_reflectance: FloatArray) -> FloatArray:
    """ln R below the upper convex hull of R, (n, c); the hull is wound from node to node in all spectra at once."""
    reflectance = np.exp(ln_reflectance)
    rows, last = np.arange(len(reflectance)), reflectance.shape[1] - 1
    hull, at = np.empty_like(reflectance), np.zeros(len(reflectance), dtype=int)
    places = np.arange(last + 1)
    while rows.size:
        heights, start = reflectance[rows], reflectance[rows, at[rows]]
        ahead = places[None] - at[rows][:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = np.where(ahead > 0, (heights - start[:, None]) / ahead, -np.inf)
        node = last - np.argmax(slope[:, ::-1], axis=1)
        best = slope[np.arange(rows.size), node]
        within = (ahead >= 0) & (places[None] <= node[:, None])
        line = start[:, None] + best[:, None] * ahead
        hull[rows] = np.where(within, line, hull[rows])
        at[rows] = node
        rows = rows[node < last]
    return np.asarray(ln_reflectance - np.log(hull))


def features(ln_reflectance: FloatArray, shaped: bool) -> FloatArray:
    """What a network sees of ln R (n, 101): without its level, the level; if `shaped`, slopes and the hull's shape."""
    level = ln_reflectance.mean(axis=1, keepdims=True)
    parts = [ln_reflectance - level, 0.5 * level]
    if shaped:
        shape = below_hull(ln_reflectance)
        depth = np.abs(shape).max(axis=1, keepdims=True)
        slope = 30.0 * np.gradient(ln_reflectance, axis=1)
        parts += [slope, shape / np.maximum(depth, LEAST_DEPTH), np.log(np.maximum(depth, LEAST_DEPTH / 3))]
    return np.hstack(parts)


@cache
def embedded_networks() -> tuple[tuple[Network, ...], Background]:
    """Those of `share_networks.npz`."""
    with (files(SPECTRA_DATA) / TABLE).open("rb") as file, np.load(file) as arrays:
        return unpacked(arrays)


def shared_out(shares: FloatArray) -> FloatArray:
    """Weights (…, 21) of `SHARES` of shares (…): of the two nearest, so that their mean is the share."""
    return np.asarray(np.maximum(1.0 - np.abs(shares[..., None] - SHARES) * (SHARES.size - 1), 0.0))


def unpacked(arrays: Mapping[str, FloatArray]) -> tuple[tuple[Network, ...], Background]:
    """Networks and background of the arrays of a file."""
    networks = []
    for number in range(int(arrays["networks"])):
        count = int(arrays[f"{number}_layers"])
        layers = tuple(
            (arrays[f"{number}_w{k}"].astype(np.float64), arrays[f"{number}_b{k}"].astype(np.float64))
            for k in range(count)
        )
        mean, scale = (arrays[f"{number}_{name}"].astype(np.float64) for name in ("mean", "scale"))
        networks.append(Network(layers, mean, scale, bool(arrays[f"{number}_shaped"])))
    law = (arrays[f"background_{name}"].astype(np.float64) for name in ("mean", "factors", "own"))
    return tuple(networks), Background(*law)


def on_grid(wavelength_nm: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Weights (101, c) that make channels of `GRID_NM` of ascending channels (c,), and which of them are there (101,).

    Means of channels within 10 nm where they are denser than that, else straight between neighbours up to `NARROW_NM`
    apart.
    """
    weights = (np.abs(GRID_NM[:, None] - wavelength_nm) <= STEP_NM / 2).astype(np.float64)
    there = np.asarray(weights.any(axis=1))
    weights[there] /= weights[there].sum(axis=1, keepdims=True)
    after = np.searchsorted(wavelength_nm, GRID_NM)
    inside = np.flatnonzero((after > 0) & (after < wavelength_nm.size))
    low, high = wavelength_nm[after[inside] - 1], wavelength_nm[after[inside]]
    sparse = (high - low > STEP_NM / 2) & (high - low <= NARROW_NM)
    rows, part = inside[sparse], ((GRID_NM[inside] - low) / (high - low))[sparse]
    weights[rows] = 0.0
    weights[rows, after[rows] - 1], weights[rows, after[rows]] = 1.0 - part, part
    there[rows] = True
    return weights, there


def foretell(
    wavelength_nm: FloatArray,
    reflectance: FloatArray,
    allowed: FloatArray,
    noise: FloatArray | None = None,
    learned: tuple[Sequence[Network], Background] | None = None,
) -> Foretold:
    """Shares of spectra on the same channels.

    Parameters
    ----------
    wavelength_nm : (c,) ascending. [nm]
    reflectance : (n, c) above 0. [-]
    allowed : (n, 4) 1 for minerals that there may be, else 0.
    noise : (n, c) standard deviation of ln R; up to `NOISE` at 20 nm it is not looked at. [-]

    Where no channel lies from 450 to 2450 nm any share is as likely.
    """
    weights, there = on_grid(wavelength_nm) if wavelength_nm.size else (np.empty((0, 0)), np.zeros(GRID_NM.size, bool))
    if not there.any():
        return Foretold.of_nothing(len(reflectance))
    networks, background = learned or embedded_networks()
    seen = np.log(reflectance) @ weights[there].T
    error = np.zeros_like(seen) if noise is None else np.sqrt(noise**2 @ (weights[there] ** 2).T)
    quiet = error.max(axis=1) <= NOISE
    probabilities, distance, shallow = np.zeros((len(seen), len(WEIGHED), SHARES.size)), *np.zeros((2, len(seen)))
    for rows in (np.flatnonzero(quiet), *np.flatnonzero(~quiet)[:, None]):
        noise_here = np.zeros(seen.shape[1]) if rows.size == 0 or quiet[rows[0]] else error[rows[0]]
        distance[rows] = background.ln_distance(seen[rows], there, noise_here)
        drawn = seen[rows][:, None]
        if not there.all() or noise_here.any():
            mean, root = background.behind(seen[rows], there, noise_here)
            normal = np.random.default_rng(0).standard_normal((DRAWS, GRID_NM.size))
            wider = np.exp(np.maximum(distance[rows], 0.0) / 2)[:, None, None]
            drawn = mean[:, None] + wider * (np.concatenate([normal, -normal]) @ root.T)
        count = max(1, AT_ONCE // drawn.shape[1])
        for start in range(0, rows.size, count):
            part = slice(start, start + count)
            probabilities[rows[part]], shallow[rows[part]] = _mean_of(networks, drawn[part], allowed[rows[part]])
    return Foretold(probabilities, distance, np.full(len(seen), 1.0 - there.mean()), shallow)


def _mean_of(networks: Sequence[Network], drawn: FloatArray, allowed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Over networks and draws (n, d, 101) of each spectrum probabilities, (n, 4, 21), and how shallow it is, (n,)."""
    flat, count = drawn.reshape(-1, drawn.shape[-1]), drawn.shape[1]
    seen = {shaped: features(flat, shaped) for shaped in (False, True)}
    may = np.repeat(allowed, count, axis=0)
    means = np.mean([network.probabilities(seen[network.shaped], may) for network in networks], axis=0)
    shallow = np.maximum(np.log(LEAST_DEPTH) - seen[True][:, -1], 0.0).reshape(len(drawn), count).mean(axis=1)
    return np.asarray(means.reshape(len(drawn), count, *means.shape[1:]).mean(axis=1)), shallow


def foretell_each(
    spectra: Sequence[Spectrum], allowed: FloatArray, learned: tuple[Sequence[Network], Background] | None = None
) -> Foretold:
    """`foretell` of the usable channels of each spectrum, those of the same channels together."""
    groups: dict[bytes, list[int]] = {}
    for index, spectrum in enumerate(spectra):
        groups.setdefault(spectrum.wavelength_nm[spectrum.usable].tobytes(), []).append(index)
    result = Foretold.of_nothing(len(spectra))
    for channels, indices in groups.items():
        some = [spectra[k] for k in indices]
        rows = np.array([one.reflectance[one.usable] for one in some])
        errors = [np.zeros(rows.shape[1]) if one.uncertainty is None else one.uncertainty[one.usable] for one in some]
        result.put(indices, foretell(np.frombuffer(channels), rows, allowed[indices], np.array(errors) / rows, learned))
    return result
