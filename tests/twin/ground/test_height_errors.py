"""Grounds drawn from elevation models, beside true ones that they were made without."""

import dataclasses
from pathlib import Path

import drawn_terrain
import numpy as np
import pytest

import lunarsci
from lunarsci.errors import DataError, ParameterError
from lunarsci.regolith.soil import read_soil
from lunarsci.twin.ground.height_errors import GRAIN_NODES, likely_ground, relief_of
from lunarsci.twin.ground.terrain import Terrain, build_terrain, height_of, read_terrain_file, terrain_bytes
from lunarsci.twin.jobs.terrain import terrain
from lunarsci.twin.judgement.endpoint import likely_drives, terrain_shares
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import build_rover
from lunarsci.twin.simulation.ensemble import Prediction, predict

SPACING = 0.02


def fractal(hurst: float, at_one_m: float, seed: int, size: int = 512) -> np.ndarray:
    """Ground whose heights a metre apart differ by so much (rms), by Fourier synthesis on a larger torus. [m]"""
    random, whole = np.random.default_rng(seed), 2 * size
    k = np.hypot(np.fft.fftfreq(whole, SPACING)[:, None], np.fft.fftfreq(whole, SPACING))
    k[0, 0] = np.inf
    ground = np.fft.ifft2(k ** (-hurst - 1) * np.fft.fft2(random.standard_normal((whole, whole)))).real
    lag = round(0.5 / SPACING)
    rms = np.sqrt(np.mean((ground[:, lag:] - ground[:, :-lag]) ** 2))
    return np.asarray(ground[:size, :size] * at_one_m * 0.5**hurst / rms)


@pytest.mark.parametrize(("hurst", "at_one_m"), [(0.6, 0.03), (0.8, 0.02), (0.9, 0.05)])
def test_how_rough_the_ground_is_is_found_below_errors_larger_than_its_steps(hurst: float, at_one_m: float) -> None:
    sigma = np.full((512, 512), 0.004)
    found = [
        relief_of(fractal(hurst, at_one_m, seed) + sigma * np.random.default_rng(seed).standard_normal(sigma.shape),
                  SPACING, sigma, np.zeros_like(sigma))
        for seed in range(3)
    ]  # fmt: skip
    assert np.mean([one.hurst for one in found]) == pytest.approx(hurst, abs=0.12)
    assert np.mean([one.at_one_m for one in found]) ** 0.5 == pytest.approx(at_one_m, rel=0.25)


def test_the_true_ground_is_one_of_those_that_are_drawn() -> None:
    """68 and 95 % of its heights lie within what the draws spread, and it is as rough as they are."""
    within, rough = [], []
    for seed in range(4):
        true = fractal(0.7, 0.03, seed, 300)
        sigma = np.broadcast_to(np.geomspace(0.001, 0.012, 300), true.shape)
        noise = np.random.default_rng([seed, 1]).standard_normal(true.shape)
        zeros = np.zeros_like(true)
        mean, errors = likely_ground(true + sigma * noise, SPACING, sigma, zeros, zeros)
        ground = dataclasses.replace(build_terrain("g", 0, 0, SPACING, mean, read_soil("longji")), errors=errors)
        drawn = np.array([ground.drawn_heights(d, slice(0, 300), slice(0, 300)) for d in errors.draws(40, seed)])
        spread = (drawn - mean).std(axis=0)
        within.append([np.mean(np.abs(true - mean) < times * spread) for times in (1.0, 1.96)])
        steps = [np.abs(np.diff(h[..., ::4], axis=-1)).mean() for h in (true, drawn)]
        rough.append(steps[1] / steps[0])
        # Far better than the model itself, whose errors are known not to be ground.
        assert np.std(true - mean) < 0.5 * np.std(sigma * noise)
    assert np.mean(within, axis=0) == pytest.approx([0.68, 0.95], abs=0.06)
    assert np.mean(rough) == pytest.approx(1.0, abs=0.15)


def test_errors_that_nodes_share_are_a_height_and_tilts_of_the_stated_size() -> None:
    flat, known = np.zeros((60, 80)), np.full((60, 80), 0.01)
    mean, errors = likely_ground(flat, SPACING, 1e-6 * np.ones_like(flat), np.zeros_like(flat), known)
    ground = dataclasses.replace(build_terrain("g", 0, 0, SPACING, mean, read_soil("longji")), errors=errors)
    drawn = np.array([ground.drawn_heights(d, slice(0, 60), slice(0, 80)) for d in errors.draws(2000, 1)])
    assert drawn.std(axis=0)[np.isfinite(flat)] == pytest.approx(0.01, rel=0.08)
    # Neighbours go together, ends of the map less so.
    assert np.corrcoef(drawn[:, 0, 0], drawn[:, 0, 3])[0, 1] > 0.99
    assert np.corrcoef(drawn[:, 0, 0], drawn[:, 59, 79])[0, 1] < 0.5


def test_gaps_are_filled_as_far_as_the_relief_is_known_with_what_the_ground_about_them_spreads() -> None:
    """True heights in shadow and behind stones lie within the draws; 0.5 m from all heights there is a hole."""
    within = []
    for seed in range(4):
        one = drawn_terrain.case(seed, sun_deg=8.0)
        drawn = one.model.likely(one.model.terrain)
        assert drawn.errors is not None
        gap, truth = np.isnan(one.model.terrain.height_m), one.truth.height_m
        assert gap.any() and (drawn.errors.filled == gap).all() and np.isfinite(drawn.height_m).all()
        rows, columns = (slice(0, n) for n in truth.shape)
        heights = np.array([drawn.drawn_heights(d, rows, columns) for d in drawn.errors.draws(40, seed)])
        sd = np.hypot(heights.std(axis=0), 1e-4)[gap]
        within.append([np.mean(np.abs((truth - drawn.height_m)[gap]) < times * sd) for times in (1.0, 2.0, 4.0)])
    assert 0.65 < np.mean(within, axis=0)[0] < 0.95 < np.mean(within, axis=0)[1]
    assert np.min(within, axis=0)[2] > 0.98
    wide = one.model.terrain.height_m.copy()
    wide[100:180, 100:180] = np.nan
    far = dataclasses.replace(one.model.terrain, height_m=wide)
    filled = one.model.likely(far).height_m
    assert np.isnan(filled[140, 140]) and np.isfinite(filled[140, 120]) and np.isfinite(filled[140, 160])


def test_compiled_heights_are_the_sum_of_mean_modes_and_grain() -> None:
    random = np.random.default_rng(4)
    height = random.normal(size=(40, 50)) * 0.01
    sigma = np.broadcast_to(np.geomspace(1e-3, 1e-2, 50), height.shape)
    mean, errors = likely_ground(height, SPACING, sigma, np.zeros_like(height), 0.003 * np.ones_like(height))
    ground = dataclasses.replace(build_terrain("g", 0, 0, SPACING, mean, read_soil("longji")), errors=errors)
    draws = errors.draws(3, 9)
    grid = ground.grid(draws)
    for lane, i, j in ((0, 0, 0), (1, 39, 49), (2, 17, 23)):
        row, column = (int(draws[lane, -2]) + i) % GRAIN_NODES, (int(draws[lane, -1]) + j) % GRAIN_NODES
        below, share = divmod(float(errors.level[i, j]), 1)
        grain = errors.grain[row, column, int(below) : int(below) + 2]
        expected = mean[i, j] + draws[lane, :-2] @ errors.common[i, j] + (1 - share) * grain[0] + share * grain[1]
        assert height_of(grid, lane, i, j) == pytest.approx(expected, abs=1e-8)
    assert height_of(grid, None, 5, 5) == mean[5, 5]


def test_a_model_without_errors_is_refused_and_a_wrong_layer_named(tmp_path: Path) -> None:
    zeros = np.zeros((9, 9))
    with pytest.raises(ParameterError, match="no random error"):
        likely_ground(zeros, SPACING, zeros, zeros, zeros)
    ground, path = build_terrain("g", 0, 0, SPACING, zeros, read_soil("longji")), tmp_path / "g.npz"
    for layer, says in ((np.ones((2, 2)), "shape"), (-np.ones((9, 9)), "negative")):
        path.write_bytes(terrain_bytes(ground, errors={"height_m_sigma": layer}))
        with pytest.raises(DataError, match=says):
            read_terrain_file(path, read_soil("longji"))


PLAN = Plan(name="ahead", legs=(Leg(1.5, 0.1),), speed_m_s=0.05)


@pytest.fixture(scope="module")
def uncertain() -> Terrain:
    model = drawn_terrain.case(3).model
    return model.likely(model.terrain, 0.15)


def drives(terrain: Terrain, members: int, **options: object) -> Prediction:
    samples = {"friction_angle_deg": np.linspace(33.0, 40.0, members)}
    return predict(build_rover("yutu2"), terrain, PLAN, samples=samples, **options)  # type: ignore[arg-type]


def test_drives_on_drawn_grounds_are_the_same_whoever_drives_them(uncertain: Terrain) -> None:
    from lunarsci.parallel.blocks import computing

    found = drives(uncertain, 20, seed=5)
    assert found.finished.all() and found.draws is not None and len(found.draws) == 20
    with computing(workers=1):
        assert (drives(uncertain, 20, seed=5).paths == found.paths).all()
    alone = predict(
        found.rover, uncertain, PLAN, samples={"friction_angle_deg": found.parameters["friction_angle_deg"][17:18]},
        draws=found.draws[17:18], seed=5,
    )  # fmt: skip
    # In another lane, so to rounding.
    assert alone.paths[0] == pytest.approx(found.paths[17], abs=1e-8)
    other = drives(uncertain, 20, seed=6)
    assert np.abs(other.paths - found.paths).max() > 1e-3


def test_what_the_terrain_makes_of_the_spread_is_said(uncertain: Terrain) -> None:
    """All of it where the soil is one; none where heights are exact."""
    one = predict(build_rover("yutu2"), uncertain, PLAN, samples={"friction_angle_deg": np.full(12, 37.0)})
    shares = terrain_shares(one, likely_drives(one))
    assert shares is not None and shares.pairs == 12 and shares.end_m > 0.001
    exact = dataclasses.replace(uncertain, errors=None)
    likely = predict(build_rover("yutu2"), exact, PLAN, samples={"friction_angle_deg": np.array([37.0])})
    away = one.paths[:, -1, :2] - likely.paths[0, -1, :2]
    assert shares.end_m == pytest.approx(np.sqrt((away**2).sum(axis=1).mean()), rel=1e-6)
    assert shares.end == pytest.approx(1.0) and shares.tilt_deg == pytest.approx(1.0)
    assert likely_drives(drives(dataclasses.replace(uncertain, errors=None), 4)) is None


def test_the_command_draws_unless_told_not_to(tmp_path: Path) -> None:
    model = drawn_terrain.case(3).model
    path = tmp_path / "dem.npz"
    path.write_bytes(terrain_bytes(model.terrain, errors=model.errors))
    asked = {"terrain": str(path), "sweep": ("friction_angle_deg=33:40:4",)}
    drawn, likely = (lunarsci.predict(PLAN, **asked, exact_terrain=exact) for exact in (False, True))
    assert drawn.to_dict()["terrain_errors"]["pairs"] == 4 and likely.to_dict()["terrain_errors"] is None
    assert drawn.made_from.seed == 0 and likely.made_from.seed is None
    # What `twin terrain` writes keeps the heights and errors of the file.
    kept = tmp_path / "terrain.npz"
    kept.write_bytes(terrain(str(path)).files()["terrain.npz"]())
    again = read_terrain_file(kept, read_soil("longji"))
    assert (again.terrain.height_m == model.terrain.height_m).all() and set(again.errors) == set(model.errors)


@pytest.mark.slow
def test_true_drives_lie_within_the_predicted_ones() -> None:
    """Eight of those of `tests/benchmarks/drawn_terrain.py`."""
    found = [drawn_terrain.ranks(seed, 24) for seed in range(100, 108)]
    assert all(one["finished"] == 1.0 for one in found)
    for name in ("end_x_m", "end_y_m", "largest tilt_deg", "median tilt_deg", "median slip_ratio"):
        assert drawn_terrain.share_within(found, name, 0.95) >= 0.74, name


def test_a_gap_in_rough_ground_on_a_slope_is_on_that_slope_and_no_rougher_than_the_ground() -> None:
    """Ground of a low exponent on a slope of 14 degrees, with gaps between rows of stones: gaps lie on the slope, and
    steps of 8 cm drawn in them are less than twice those of the true ground, though heights about gaps spread more."""
    size, wide = 300, 24
    true = fractal(0.4, 0.02, 3, size) + 0.25 * SPACING * np.arange(size)
    height, gap = true.copy(), np.zeros(true.shape, dtype=bool)
    for row in range(0, size - wide, 2 * wide):
        for column in range(0, size - wide, 2 * wide):
            gap[row : row + wide, column : column + wide] = True
            height[row : row + wide, column + wide : column + 2 * wide : 4] += 0.1
    sigma, zeros = np.full(true.shape, 0.002), np.zeros(true.shape)
    mean, errors = likely_ground(np.where(gap, np.nan, height), SPACING, sigma, zeros, zeros)
    plain = build_terrain("g", 0, 0, SPACING, mean, read_soil("longji"))
    ground, whole = dataclasses.replace(plain, errors=errors), slice(0, size)
    drawn = np.array([ground.drawn_heights(d, whole, whole) for d in errors.draws(10, 1)]) - mean
    inside = gap[:, 4:] & gap[:, :-4]
    steps = [np.sqrt(np.mean((h[..., 4:] - h[..., :-4])[..., inside] ** 2)) for h in (drawn, true - mean)]
    assert steps[0] < 2.0 * steps[1] and drawn[:, gap].std() > 0.03
    slope = np.polyfit(SPACING * np.arange(wide), mean[:wide, :wide].mean(axis=0), 1)[0]
    assert slope == pytest.approx(0.25, abs=0.1)


@pytest.mark.slow
def test_drives_over_gaps_of_the_model_go_where_the_true_one_goes() -> None:
    """Six with stones and shadows, on each of which the model as it was read has a hole in the way."""
    found = [drawn_terrain.ranks(seed, 24, sun_deg=15.0) for seed in range(100, 106)]
    assert all(one["finished"] == 1.0 and one["read"] != "finished" for one in found)
    for name in ("end_x_m", "end_y_m", "largest tilt_deg", "median tilt_deg"):
        assert drawn_terrain.share_within(found, name, 0.95) >= 0.66, name


def test_filled_gaps_are_marked_on_the_map_of_a_drive() -> None:
    """As many nodes are tinted as were filled; a model without gaps has no such entry in the legend."""
    from matplotlib.figure import Figure

    from lunarsci.twin.figures.panels import draw_ground

    for sun_deg in (8.0, None):
        model, axes = drawn_terrain.case(0, sun_deg).model, Figure().subplots()
        ground = model.likely(model.terrain)
        assert ground.errors is not None
        draw_ground(axes, ground, (slice(None), slice(None)), 0.1)
        tinted = [np.ma.count(image.get_array()) for image in axes.images[1:]]
        assert tinted == [ground.errors.filled.sum()] * (sun_deg is not None)
        assert axes.get_legend_handles_labels()[1] == ["not seen, filled"] * (sun_deg is not None)
