"""SYNTHETIC images of spectra, to try maps on: what is in them is known, and none of it was measured from orbit.

Minerals are mixed here by an own short Hapke law (isotropic scattering), not by the library's; spectra of the
laboratory and the rover, where a scene is made of them, are read from the folder of measured data.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.ndimage import gaussian_filter, zoom

from lunarsci.spectra.abundance.end_members import embedded_end_members
from lunarsci.spectra.mgm.forward import model_and_jacobian
from lunarsci.spectra.mgm.model import mgm_model

M3_NM = np.concatenate(
    [np.arange(460.99, 740.0, 39.925), np.arange(750.44, 1555.0, 19.962), np.arange(1578.86, 2450.0, 39.92)]
)
"""Channels as M3 has them in its global mode, those of 450-2450 nm. Green et al. (2011), 10.1029/2011JE003797."""
EIGHTY_FIVE_NM = np.linspace(460.0, 2400.0, 85)
MU0, MU = np.cos(np.radians(30.0)), 1.0


@dataclass(frozen=True)
class Strip:
    """A made-up image: channels (n,) [nm], reflectance (rows, columns, n), its noise of one standard deviation."""

    name: str
    wavelength_nm: np.ndarray
    reflectance: np.ndarray
    sigma: np.ndarray


def mixed(albedo: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Reflectance factor of intimate mixtures, (..., n), from albedos (k, n) and shares (..., k).

    Hapke (1981), 10.1029/JB086iB04p03039, isotropic scattering without opposition effect, i = 30 deg, e = 0.
    """
    w = shares @ albedo
    gamma = np.sqrt(1.0 - w)
    h0, h = ((1 + 2 * mu) / (1 + 2 * mu * gamma) for mu in (MU0, MU))
    return w / (4 * (MU0 + MU)) * h0 * h


def albedo_of(reflectance: np.ndarray) -> np.ndarray:
    """Single-scattering albedo by bisection, the inverse of `mixed`."""
    low, high = np.zeros_like(reflectance), np.ones_like(reflectance)
    one = np.ones((1, 1))
    for _ in range(40):
        middle = (low + high) / 2
        above = mixed(middle.reshape(1, -1), one).reshape(middle.shape) > reflectance
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return (low + high) / 2


def smooth(rng: np.random.Generator, shape: tuple[int, int], length: float) -> np.ndarray:
    """A random field of unit variance that changes over some `length` pixels."""
    step = max(1.0, length / 4)
    small = [int(np.ceil(size / step)) + 8 for size in shape]
    field = zoom(gaussian_filter(rng.normal(size=small), length / step), step, order=1)[: shape[0], : shape[1]]
    return (field - field.mean()) / field.std()


def _end_members(wavelength_nm: np.ndarray, rng: np.random.Generator, count: int) -> np.ndarray:
    library = embedded_end_members(wavelength_nm)
    by_mineral = [
        [item for item in library if item.mineral == mineral]
        for mineral in ("olivine", "orthopyroxene", "clinopyroxene", "plagioclase")
    ]
    chosen = [group[rng.integers(len(group))] for group in by_mineral[:count]]
    return albedo_of(np.array([item.reflectance for item in chosen] + [np.full(wavelength_nm.size, 0.06)]))


def _noisy(
    name: str, wavelength_nm: np.ndarray, clean: np.ndarray, rng: np.random.Generator, share: float, floor: float = 0.0
) -> Strip:
    sigma = np.hypot(share * clean, floor)
    return Strip(name, wavelength_nm, clean + sigma * rng.normal(size=clean.shape), sigma)


def mixtures(
    wavelength_nm: np.ndarray, shape: tuple[int, int], seed: int, noise: float = 0.004, length: float = 12.0
) -> Strip:
    """Shares of minerals that change smoothly, rays and craters with sharp borders, shading by slopes."""
    rng = np.random.default_rng(seed)
    albedo = _end_members(wavelength_nm, rng, 4)
    level = np.stack(
        [1.2 * smooth(rng, shape, length) for _ in range(4)] + [1.0 + 0.7 * smooth(rng, shape, length)], axis=-1
    )
    y, x = np.indices(shape)
    for _ in range(max(3, shape[0] * shape[1] // 2000)):
        inside = (y - rng.uniform(0, shape[0])) ** 2 + (x - rng.uniform(0, shape[1])) ** 2 < rng.uniform(2, 12) ** 2
        level[inside] += rng.normal(scale=1.5, size=5)
    shares = np.exp(level)
    clean = mixed(albedo, shares / shares.sum(axis=-1, keepdims=True))
    shade = np.clip(1.0 + 0.2 * smooth(rng, shape, 4.0), 0.4, None)
    return _noisy("mixtures", wavelength_nm, clean * shade[..., None], rng, noise)


def shadows(wavelength_nm: np.ndarray, shape: tuple[int, int], seed: int) -> Strip:
    """The same under a low Sun: shadows with 2 % of the light, and noise that does not fall with it."""
    rng = np.random.default_rng(seed + 1)
    sunny = mixtures(wavelength_nm, shape, seed, noise=0.0)
    light = np.where(smooth(rng, shape, 8.0) < -0.7, 0.02, np.clip(0.6 + 0.4 * smooth(rng, shape, 5.0), 0.05, None))
    return _noisy("shadows", wavelength_nm, sunny.reflectance * light[..., None], rng, 0.003, 2e-4)


def gradient(wavelength_nm: np.ndarray, shape: tuple[int, int], seed: int) -> Strip:
    """Bands of the model itself, whose parameters go from one draw of the prior to another across the image."""
    rng = np.random.default_rng(seed)
    model = mgm_model("OL-OPX-CPX")
    m = model.degrees
    root = np.linalg.cholesky(np.linalg.inv(model.precision[m:, m:]))
    ends = model.prior + np.pad(rng.normal(size=(4, root.shape[0])) @ root.T, ((0, 0), (m, 0)))
    ends[:, m + 2 :: 3] = -0.12 * 1.8 ** rng.normal(size=ends[:, m + 2 :: 3].shape)
    ends[:, :3] = np.column_stack([rng.uniform(0.1, 0.2, 4), rng.uniform(0, 0.05, 4), rng.uniform(-0.01, 0.01, 4)])
    a, b = (v[..., None] for v in np.meshgrid(np.linspace(0, 1, shape[1]), np.linspace(0, 1, shape[0])))
    points = (1 - b) * ((1 - a) * ends[0] + a * ends[1]) + b * ((1 - a) * ends[2] + a * ends[3])
    points = np.clip(points, model.lower, model.upper).reshape(-1, model.prior.size)
    basis = model.basis(wavelength_nm)
    clean = np.exp([model_and_jacobian(p, wavelength_nm / 1e3, basis, model.logarithmic)[0] for p in points])
    return _noisy("gradient", wavelength_nm, clean.reshape(*shape, -1), rng, 0.005)


def checkerboard(wavelength_nm: np.ndarray, shape: tuple[int, int], seed: int) -> Strip:
    """No pixel is like those beside it: two grounds by turns, each its own mixture of each place."""
    first, second = (mixtures(wavelength_nm, shape, seed + k, noise=0.0).reflectance for k in (100, 200))
    odd = np.indices(shape).sum(axis=0) % 2 == 1
    return _noisy(
        "checkerboard", wavelength_nm, np.where(odd[..., None], first, second), np.random.default_rng(seed), 0.005
    )


def _measured(folder: Path, file: str, wavelength_nm: np.ndarray) -> np.ndarray:
    """Spectra of a table, (k, n), those that have values on all channels."""
    table = pd.read_csv(folder / "spectra" / file)
    grid, values = table.iloc[:, 0].to_numpy(), table.iloc[:, 1:].to_numpy(dtype=float).T
    found = np.array([np.interp(wavelength_nm, grid, row) for row in values])
    return found[np.isfinite(found).all(axis=1) & (found > 0.005).all(axis=1)]


def patchwork(
    wavelength_nm: np.ndarray, shape: tuple[int, int], seed: int, folder: Path, file: str, cells: float = 30.0
) -> Strip:
    """Measured spectra, each in a cell of some `cells` pixels with straight borders, with shading and noise."""
    rng = np.random.default_rng(seed)
    spectra = _measured(folder, file, wavelength_nm)
    count = max(2, int(shape[0] * shape[1] / cells))
    seeds = np.column_stack([rng.uniform(0, size, count) for size in shape])
    pixels = np.indices(shape).reshape(2, -1).T
    nearest = np.concatenate(
        [((part[:, None] - seeds) ** 2).sum(axis=2).argmin(axis=1) for part in np.array_split(pixels, 32)]
    )
    clean = spectra[rng.integers(len(spectra), size=count)[nearest]].reshape(*shape, -1)
    shade = np.clip(1.0 + 0.15 * smooth(rng, shape, 4.0), 0.4, None)
    return _noisy(Path(file).parent.name, wavelength_nm, clean * shade[..., None], rng, 0.003)


MADE_UP: dict[str, Callable[[np.ndarray, tuple[int, int], int], Strip]] = {
    "mixtures": mixtures,
    "shadows": shadows,
    "gradient": gradient,
    "checkerboard": checkerboard,
}
MEASURED = (
    "relab/reflectance.csv",
    "ce4/reflectance_factor.csv",
    "meteorites/reflectance.csv",
    "lunar_soils/reflectance.csv",
    "minerals/reflectance.csv",
)
