"""Made-up ground: rocks against the integral of their distribution, slopes, and heights that stay as they were."""

import hashlib
import math

import numpy as np
import pytest
from scipy.integrate import quad

from lunarsci.errors import ParameterError
from lunarsci.twin.ground.hazards import ground_maps
from lunarsci.twin.ground.synthetic import (
    LARGEST_M,
    SCALE_M,
    rocks_per_m2,
    scatter_rocks,
    synthetic_longji,
    synthetic_terrain,
)


@pytest.mark.parametrize("smallest", [0.1, 0.3, 1.0])
def test_the_number_of_rocks_is_the_integral_of_the_area_over_the_area_of_one(smallest: float) -> None:
    share = 0.0021
    number, _ = quad(
        lambda d: share / SCALE_M * math.exp(-d / SCALE_M) / (math.pi * d**2 / 4.0), smallest, LARGEST_M, epsabs=1e-14
    )
    assert rocks_per_m2(share, smallest) == pytest.approx(number, rel=1e-8)


def test_rocks_cover_their_share_of_the_ground_and_spare_the_start() -> None:
    """Rocks of at least 0.1 m cover share exp(-0.1 / 0.2), up to those beyond 2 m; some overlap."""
    axis = 0.05 * np.arange(-600, 601)
    flat = np.zeros((axis.size, axis.size))
    share = 0.02
    cover = np.mean([(scatter_rocks(axis, axis, flat, share, seed) > 0).mean() for seed in range(4)])
    assert cover == pytest.approx(share * math.exp(-0.1 / SCALE_M), rel=0.1)
    rocks = scatter_rocks(axis, axis, flat, share, 0)
    assert rocks[np.hypot(axis[None, :], axis[:, None]) < 1.5].max() == 0.0
    assert 0.2 < rocks.max() <= 0.5 * 2.0 * LARGEST_M


def test_the_same_rocks_lie_on_a_finer_grid() -> None:
    coarse, fine = (
        synthetic_terrain(seed=3, spacing_m=spacing, rock_share=0.01, rms_m=0.0, craters=0, extent_m=8.0)
        for spacing in (0.1, 0.05)
    )
    assert fine.height_m[::2, ::2] == pytest.approx(coarse.height_m, abs=1e-9)


def test_the_stand_in_without_rocks_is_what_it_was() -> None:
    """Heights of some nodes, from the version that knew no rocks."""
    before = {(0, 0): 0.3011231615699306, (140, 60): 0.22187306693064196, (320, 340): -0.6881664798997277}
    bare, rocky = synthetic_longji(), synthetic_longji(rock_share=0.0021)
    assert [bare.height_m[node] for node in before] == pytest.approx(list(before.values()), rel=1e-13)
    assert np.array_equal(synthetic_longji(rock_share=0.0).height_m, bare.height_m)
    changed = bare.height_m != rocky.height_m
    assert 0.0002 < changed.mean() < 0.004 and (rocky.height_m >= bare.height_m).all()
    assert rocky.synthetic


def test_a_synthetic_plain_has_the_slope_asked_for() -> None:
    terrain = synthetic_terrain(slope_deg=12.0, craters=0, rms_m=0.0, extent_m=6.0, spacing_m=0.1)
    assert terrain.synthetic and "synthetic" in terrain.name
    assert (terrain.x_m[0], terrain.y_m[-1]) == pytest.approx((-3.0, 3.0))
    slope = ground_maps(terrain, 1.0, 0.3).slope_deg[10:-10, 10:-10]
    assert slope == pytest.approx(12.0, abs=1e-4)


def test_a_seed_makes_the_ground() -> None:
    options = {"extent_m": 6.0, "spacing_m": 0.1, "rock_share": 0.02}
    one, same, other = (
        hashlib.sha256(synthetic_terrain(seed=seed, **options).height_m.tobytes()).hexdigest() for seed in (1, 1, 2)
    )
    assert one == same != other


@pytest.mark.parametrize(
    "bad",
    [
        {"spacing_m": 0.0},
        {"spacing_m": math.nan},
        {"extent_m": 3.0},
        {"extent_m": 1000.0, "spacing_m": 0.05},
        {"slope_deg": 60.0},
        {"craters": -1},
        {"rock_share": 0.5},
        {"rock_share": math.nan},
        {"rms_m": 1.0},
        {"seed": -1},
    ],
)
def test_ground_that_cannot_be_is_refused(bad: dict[str, float]) -> None:
    with pytest.raises(ParameterError):
        synthetic_terrain(**bad)
