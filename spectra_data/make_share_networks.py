"""Make `share_networks.npz`: `python make_share_networks.py FOLDER OUT [FOLD ...]`.

FOLDER holds `reflectance.csv` and `manifest.csv` in `relab`, `minerals` and `meteorites`, spectra of known modes. With
numbers of folds the networks without the suites of fold K are made, as `OUT/fold-K.npz`, which
`make_share_calibration.py` judges; without them those of all spectra, `OUT/share_networks.npz`.

Networks see made-up mixtures: one to four measured powders (their single-scattering albedos, in shares drawn from a
flat law), grains coarser or finer, opaque phases or glass, submicroscopic iron, and what real spectra have beside any
model: level, slope, bend, details, noise. Mixtures of one powder are that powder with all this. `Recipe` has the
numbers of what is drawn, all of them assumed.
"""

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd

from lunarsci.io.inputs import read_input
from lunarsci.minerals import WEIGHED
from lunarsci.spectra.abundance.end_members import embedded_end_members
from lunarsci.spectra.abundance.learned import (
    GRID_NM,
    Background,
    Network,
    features,
    on_grid,
    shared_out,
)
from lunarsci.spectra.abundance.mixing import Albedo, HapkeSurface, iron_absorption
from lunarsci.spectra.readers import read_spectra

COLUMNS = dict(zip(WEIGHED, ("vol_ol", "vol_opx", "vol_cpx", "vol_plg"), strict=True))
PARTS = ("relab", "meteorites", "minerals")
FOLDS, NETWORKS = 8, (True, False, True, False, True)
"""Parts that suites are dealt into; networks, and whether each sees shapes below the hull."""
PURE = 0.95
FACTORS = 24
"""Factors of the law of all spectra."""


@dataclass(frozen=True)
class Recipe:
    """How mixtures are drawn, and how networks learn."""

    count: int = 30_000
    powders: tuple[float, ...] = (0.5, 0.28, 0.13, 0.09)
    any_powder: float = 0.12
    blended: float = 0.4
    common_size: float = 0.6
    own_size: float = 0.35
    dark: float = 0.4
    dark_share: tuple[float, float] = (0.005, 0.6)
    nearly_all_dark: float = 0.08
    dark_albedo: tuple[float, float] = (0.04, 0.4)
    flat: float = 0.4
    glass: float = 0.25
    iron: float = 0.25
    ln_iron: tuple[float, float] = (-2.0, 1.2)
    level: float = 0.1
    slope: float = 0.06
    bend: float = 0.03
    detail: float = 0.012
    edge: float = 0.6
    noise: tuple[float, float] = (0.001, 0.02)
    hidden: tuple[int, ...] = (256, 128)
    epochs: int = 12
    batch: int = 256
    rate: float = 1e-3
    decay: float = 1e-3
    dropped: float = 0.1


@dataclass(frozen=True, eq=False)
class LabSpectra:
    """Measured spectra: ids, ln R (n, 101), shares (n, 4), suites, and what their manifest says."""

    ids: list[str]
    ln_reflectance: np.ndarray
    shares: np.ndarray
    suites: np.ndarray
    manifest: pd.DataFrame

    def where(self, chosen: np.ndarray) -> "LabSpectra":
        """Some of them."""
        rows = np.flatnonzero(chosen)
        ids = [self.ids[k] for k in rows]
        return LabSpectra(
            ids, self.ln_reflectance[rows], self.shares[rows], self.suites[rows], self.manifest.iloc[rows]
        )


def suite_of(id: str) -> str:
    """The letters of an id before its first digit."""
    return re.sub(r"\d.*", "", id)


def measured(folder: Path) -> LabSpectra:
    """Spectra of known modes of all parts."""
    ids, rows, shares, about = [], [], [], []
    for part in PARTS:
        manifest = pd.read_csv(folder / part / "manifest.csv").set_index("id")
        for spectrum in read_spectra(read_input(str(folder / part / "reflectance.csv"))):
            weights, _ = on_grid(spectrum.wavelength_nm)
            modes = manifest.loc[spectrum.id, list(COLUMNS.values())].to_numpy(float)
            ids.append(spectrum.id)
            rows.append(weights @ np.log(np.maximum(spectrum.reflectance, 1e-4)))
            shares.append(modes / modes.sum())
            about.append(manifest.loc[spectrum.id].to_dict() | {"part": part})
    suites = np.array([suite_of(id) for id in ids])
    return LabSpectra(ids, np.array(rows), np.array(shares), suites, pd.DataFrame(about, index=ids))


def library_powders() -> LabSpectra:
    """Those of the USGS, from the library of end members; suites by the beginning of the name."""
    own = [item for item in embedded_end_members(GRID_NM) if item.source == "usgs" and item.mineral in WEIGHED]
    shares = np.array([[float(item.mineral == mineral) for mineral in WEIGHED] for item in own])
    suites = np.array(["USGS-" + item.id.split("_")[0] for item in own])
    ids = [item.id for item in own]
    rows = np.log(np.array([item.reflectance for item in own]))
    return LabSpectra(ids, rows, shares, suites, pd.DataFrame(index=ids))


def fold_of(suites: np.ndarray) -> np.ndarray:
    """Which fold each suite is dealt to, as the reference regressions deal them."""
    dealt = np.random.default_rng(0).permutation(sorted(set(suites)))
    return np.array([int(np.flatnonzero(dealt == suite)[0]) % FOLDS for suite in suites])


def _weights(suites: np.ndarray) -> np.ndarray:
    """A suite of m spectra counts as the square root of m."""
    _, place, count = np.unique(suites, return_inverse=True, return_counts=True)
    weight = count[place] ** -0.5
    return np.asarray(weight / weight.sum())


def mixtures(
    powders: LabSpectra, count: int, rng: np.random.Generator, recipe: Recipe
) -> tuple[np.ndarray, np.ndarray]:
    """ln R (count, 101) and shares (count, 4)."""
    mixing = Albedo(HapkeSurface())
    element = mixing.element(np.exp(powders.ln_reflectance))
    kind = np.where(powders.shares.max(axis=1) > PURE, powders.shares.argmax(axis=1), -1)
    pools = [np.flatnonzero(kind == k) for k in range(len(WEIGHED))]
    chances = [_weights(powders.suites[pool]) for pool in pools]
    everyone = _weights(powders.suites)
    number = rng.choice(np.arange(1, len(recipe.powders) + 1), count, p=recipe.powders)
    part = rng.gamma(np.ones((count, len(WEIGHED)))) * (np.arange(len(WEIGHED)) < number[:, None])
    part /= part.sum(axis=1, keepdims=True)
    order = np.argsort(rng.random(part.shape), axis=1)
    common = rng.normal(0.0, recipe.common_size, count)
    mixed, section, shares = np.zeros((count, GRID_NM.size)), np.zeros(count), np.zeros(part.shape)
    for place in range(len(WEIGHED)):
        rows = np.flatnonzero(place < number)
        free = (number[rows] == 1) | (rng.random(rows.size) < recipe.any_powder)
        chosen = rng.choice(len(everyone), rows.size, p=everyone)
        for k, (pool, chance) in enumerate(zip(pools, chances, strict=True)):
            own = ~free & (order[rows, place] == k)
            chosen[own] = rng.choice(pool, own.sum(), p=chance)
        t = element[chosen]
        for k, (pool, chance) in enumerate(zip(pools, chances, strict=True)):
            own = np.flatnonzero((kind[chosen] == k) & (rng.random(rows.size) < recipe.blended))
            between = rng.random(own.size)[:, None]
            t[own] = t[own] * (1 - between) + element[rng.choice(pool, own.size, p=chance)] * between
        size = rng.normal(0.0, recipe.own_size, rows.size) * (number[rows] > 1)
        albedo = mixing.mixing(t + (size + common[rows])[:, None])[0]
        across = part[rows, place] * np.exp(-size)
        mixed[rows] += across[:, None] * albedo
        section[rows] += across
        shares[rows] += part[rows, place][:, None] * powders.shares[chosen]
    darkened = _darkened(mixed / section[:, None], rng, recipe)
    return mixing.ln_reflectance(darkened)[0] + _beside(count, rng, recipe), shares


def _log_uniform(rng: np.random.Generator, ends: tuple[float, float], count: int) -> np.ndarray:
    return np.asarray(np.exp(rng.uniform(*np.log(ends), count)))[:, None]


def _darkened(albedo: np.ndarray, rng: np.random.Generator, recipe: Recipe) -> np.ndarray:
    """With opaque phases, or glass, in part of the cross-section, and iron on all grains."""
    count, um = len(albedo), GRID_NM / 1e3
    share = np.where(rng.random((count, 1)) < recipe.dark, _log_uniform(rng, recipe.dark_share, count), 0.0)
    share = np.where(rng.random((count, 1)) < recipe.nearly_all_dark, rng.uniform(0.6, 1.0, (count, 1)), share)
    power = np.where(rng.random((count, 1)) < recipe.flat, 0.0, rng.uniform(0.0, 1.0, (count, 1)))
    depth = np.where(rng.random((count, 1)) < recipe.glass, rng.uniform(0.0, 0.3, (count, 1)), 0.0)
    band = np.exp(-0.5 * ((um - 1.08) / 0.16) ** 2) + 0.6 * np.exp(-0.5 * ((um - 1.9) / 0.3) ** 2)
    dark = np.minimum(_log_uniform(rng, recipe.dark_albedo, count) * um**power * (1 - depth * band), 0.95)
    iron = np.where(rng.random((count, 1)) < recipe.iron, np.exp(rng.normal(*recipe.ln_iron, (count, 1))), 0.0)
    falls = np.where(rng.random((count, 1)) < 0.5, iron_absorption(GRID_NM), 1.0)
    return np.asarray(1.0 / (1.0 / ((1.0 - share) * albedo + share * dark) + iron * falls))


def _beside(count: int, rng: np.random.Generator, recipe: Recipe) -> np.ndarray:
    """What ln R of real spectra has beside the model's, and noise."""
    u = GRID_NM / 1e3 - 1.45
    smooth = (recipe.level * np.ones_like(u), recipe.slope * u, recipe.bend * (u**2 - np.mean(u**2)))
    apart = (GRID_NM[:, None] - GRID_NM) / 120.0
    edge = recipe.edge * np.exp((450.0 - GRID_NM) / 100.0)
    detail = (recipe.detail**2 + edge[:, None] * edge) * np.exp(-0.5 * apart**2) + 1e-9 * np.eye(u.size)
    drawn = rng.standard_normal((count, 3)) @ np.array(smooth)
    drawn += rng.standard_normal((count, u.size)) @ np.linalg.cholesky(detail).T
    return np.asarray(drawn + _log_uniform(rng, recipe.noise, count) * rng.standard_normal((count, u.size)))


def _allowed(shares: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Half know which minerals may be there: those that are, and any others."""
    named = (shares > 0.005) | (rng.random(shares.shape) < 0.5) | (rng.random((len(shares), 1)) < 0.5)
    return np.asarray(named, dtype=np.float32)


class Learner:
    """Weights of a network, and what Adam keeps of them (Kingma & Ba 2015, arXiv:1412.6980; decay as in AdamW)."""

    def __init__(self, sizes: tuple[int, ...], rng: np.random.Generator) -> None:
        pairs = list(pairwise(sizes))
        self.weights = [(rng.standard_normal(pair) * np.sqrt(2.0 / pair[0])).astype(np.float32) for pair in pairs]
        self.weights[-1] *= 0.1
        self.biases = [np.zeros(pair[1], np.float32) for pair in pairs]
        self.first, self.second = ([np.zeros_like(p) for p in self.weights + self.biases] for _ in range(2))
        self.steps = 0

    def learn(
        self,
        x: np.ndarray,
        wanted: np.ndarray,
        allowed: np.ndarray,
        rate: float,
        recipe: Recipe,
        rng: np.random.Generator,
    ) -> None:
        """One step towards probabilities (n, 4, 21) of a batch."""
        seen, kept = [x], []
        for k, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = x @ weight + bias
            if k < len(self.weights) - 1:
                kept.append((rng.random(x.shape, dtype=np.float32) > recipe.dropped) / np.float32(1 - recipe.dropped))
                x = np.maximum(x, 0.0) * kept[-1]
                seen.append(x)
        power = x.reshape(wanted.shape)
        found = np.exp(power - power.max(axis=-1, keepdims=True))
        found /= found.sum(axis=-1, keepdims=True)
        slope = ((found - wanted) * allowed[:, :, None] / len(x)).reshape(len(x), -1)
        by_weight, by_bias = [], []
        for k in range(len(self.weights) - 1, -1, -1):
            by_weight.insert(0, seen[k].T @ slope)
            by_bias.insert(0, slope.sum(axis=0))
            if k:
                slope = (slope @ self.weights[k].T) * kept[k - 1] * (seen[k] > 0)
        self.steps += 1
        decays = [recipe.decay] * len(self.weights) + [0.0] * len(self.biases)
        values = self.weights + self.biases
        for value, by, one, two, decay in zip(
            values, by_weight + by_bias, self.first, self.second, decays, strict=True
        ):
            one += 0.1 * (by - one)
            two += 0.001 * (by * by - two)
            step = one / (1 - 0.9**self.steps) / (np.sqrt(two / (1 - 0.999**self.steps)) + 1e-8)
            value -= np.float32(rate) * (step + decay * value)


def trained(powders: LabSpectra, seed: int, shaped: bool, recipe: Recipe) -> tuple[Network, np.ndarray]:
    """A network, and the ln R that it learned from."""
    rng = np.random.default_rng(seed)
    ln_reflectance, shares = mixtures(powders, recipe.count, rng, recipe)
    x = features(ln_reflectance, shaped)
    mean, scale = x.mean(axis=0), x.std(axis=0) + 1e-3
    x, wanted = ((x - mean) / scale).astype(np.float32), shared_out(shares).astype(np.float32)
    learner = Learner((x.shape[1] + len(WEIGHED), *recipe.hidden, wanted[0].size), rng)
    total = recipe.epochs * (recipe.count // recipe.batch)
    for _ in range(recipe.epochs):
        order = rng.permutation(recipe.count)
        for start in range(0, recipe.count - recipe.batch + 1, recipe.batch):
            rows = order[start : start + recipe.batch]
            allowed = _allowed(shares[rows], rng)
            rate = recipe.rate * 0.5 * (1 + np.cos(np.pi * learner.steps / total)) * min(1.0, (learner.steps + 1) / 100)
            learner.learn(np.hstack([x[rows], allowed]), wanted[rows], allowed, rate, recipe, rng)
    layers = tuple(zip(learner.weights, learner.biases, strict=True))
    return Network(layers, mean, scale, shaped), ln_reflectance


def background(ln_reflectance: np.ndarray) -> Background:
    """The normal law of spectra: leading principal components, and what each channel has beside them."""
    mean = ln_reflectance.mean(axis=0)
    sizes, axes = np.linalg.eigh(np.cov(ln_reflectance.T))
    factors = (axes[:, ::-1] * np.sqrt(sizes[::-1])).T[:FACTORS]
    own = np.sqrt(np.maximum(ln_reflectance.var(axis=0) - np.sum(factors**2, axis=0), 1e-8))
    return Background(mean, factors, own)


def packed(networks: list[Network], recipe: Background) -> Iterator[tuple[str, np.ndarray]]:
    """Arrays of the file; weights in half precision."""
    yield "networks", np.array(len(networks))
    for number, network in enumerate(networks):
        yield f"{number}_layers", np.array(len(network.layers))
        yield f"{number}_shaped", np.array(network.shaped)
        yield f"{number}_mean", network.mean.astype(np.float32)
        yield f"{number}_scale", network.scale.astype(np.float32)
        for k, (weight, bias) in enumerate(network.layers):
            yield f"{number}_w{k}", weight.astype(np.float16)
            yield f"{number}_b{k}", bias.astype(np.float16)
    for name, values in (("mean", recipe.mean), ("factors", recipe.factors), ("own", recipe.unique)):
        yield f"background_{name}", values.astype(np.float32)


def made(powders: LabSpectra, seed: int, recipe: Recipe) -> dict[str, np.ndarray]:
    """Networks and background of some powders, as arrays."""
    both = [trained(powders, seed + k, shaped, recipe) for k, shaped in enumerate(NETWORKS)]
    return dict(packed([network for network, _ in both], background(both[0][1])))


def joined(one: LabSpectra, other: LabSpectra) -> LabSpectra:
    """All of both."""
    parts = (
        np.concatenate([getattr(one, name), getattr(other, name)]) for name in ("ln_reflectance", "shares", "suites")
    )
    return LabSpectra(one.ids + other.ids, *parts, pd.concat([one.manifest, other.manifest]))


def main() -> None:
    """Write the networks."""
    folder, out, folds = Path(sys.argv[1]), Path(sys.argv[2]), [int(fold) for fold in sys.argv[3:]]
    out.mkdir(parents=True, exist_ok=True)
    known, library = measured(folder), library_powders()
    for fold in folds:
        rest = known.where(fold_of(known.suites) != fold)
        np.savez_compressed(out / f"fold-{fold}.npz", **made(joined(rest, library), 1000 * (fold + 1), Recipe()))
    if not folds:
        np.savez_compressed(out / "share_networks.npz", **made(joined(known, library), 0, Recipe()))


if __name__ == "__main__":
    main()
