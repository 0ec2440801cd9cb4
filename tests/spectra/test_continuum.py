"""Continua against numpy's polynomial and scipy's convex hull."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from lunarsci.errors import DataError, ParameterError
from lunarsci.spectra.continuum import CONIC_TIES_NM, SHOULDERS_NM, ContinuumName, continuum, upper_hull

GRID = np.arange(450.0, 2396.0, 5.0)


def spectrum() -> np.ndarray:
    band = 1 - 0.3 * np.exp(-0.5 * ((GRID - 950) / 90) ** 2) - 0.2 * np.exp(-0.5 * ((GRID - 2000) / 200) ** 2)
    return (0.05 + 5e-5 * GRID) * band


def of_one(name: ContinuumName, values: np.ndarray) -> np.ndarray:
    return np.asarray(continuum(name, GRID, values[None])[0])


def test_conic_is_the_parabola_through_its_three_points() -> None:
    values = spectrum()
    found = of_one("conic", values)
    at = [int(np.argmin(abs(GRID - tie))) for tie in CONIC_TIES_NM]
    assert np.allclose(found, np.polyval(np.polyfit(GRID[at], values[at], 2), GRID), atol=1e-9)


def test_hull_has_the_vertices_of_scipys_convex_hull() -> None:
    rng = np.random.default_rng(0)
    y = np.cumsum(rng.normal(size=GRID.size)) / 50 - (GRID / 2000 - 0.7) ** 2
    hull = ConvexHull(np.column_stack([GRID, y]))
    chord = y[0] + (y[-1] - y[0]) * (GRID - GRID[0]) / (GRID[-1] - GRID[0])
    upper = sorted(i for i in hull.vertices if y[i] >= chord[i] - 1e-12)
    assert upper_hull(GRID, y) == upper


def test_hull_lies_on_or_above_the_spectrum() -> None:
    values = spectrum()
    assert np.all(of_one("hull", values) >= values - 1e-12)


def test_linear_meets_the_spectrum_at_its_ties() -> None:
    values = spectrum()
    level = of_one("linear", values)
    for low, high in SHOULDERS_NM:
        inside = np.flatnonzero((low <= GRID) & (high >= GRID))
        at = inside[np.argmax(values[inside])]
        assert level[at] == pytest.approx(values[at], rel=1e-12)


@pytest.mark.parametrize("tie", [end for shoulder in SHOULDERS_NM[:2] for end in shoulder])
def test_a_shoulder_holds_the_channels_at_its_ends(tie: float) -> None:
    """A peak at the very channel at which a shoulder begins or ends is its tie; one channel farther out is not."""
    for at, inside in ((tie, True), (tie + (5.0 if tie in (850.0, 1650.0) else -5.0), False)):
        values = spectrum() + np.where(at == GRID, 0.2, 0.0)
        assert (of_one("linear", values)[at == GRID] == pytest.approx(values[at == GRID], rel=1e-12)) == inside


def test_a_spectrum_that_ends_before_the_ties_says_what_to_use() -> None:
    short = GRID < 1200
    with pytest.raises(DataError, match="`continuum` hull"):
        continuum("conic", GRID[short], spectrum()[None, short])


def test_unknown_continuum_lists_the_known_ones() -> None:
    with pytest.raises(ParameterError, match="conic, hull, linear"):
        continuum("spline", GRID, spectrum()[None])  # type: ignore[arg-type]
