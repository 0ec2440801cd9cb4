"""Ground between the nodes of a coarse map, and verdicts that hang on it."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from lunarsci.regolith.soil import Soil, read_soil
from lunarsci.regolith.wheel import read_wheel
from lunarsci.twin.ground.finer_ground import (
    lunar_relief,
    relief_of_kind,
    roughness_of_map,
    unresolved_grain,
    with_unresolved,
)
from lunarsci.twin.ground.height_errors import fractal_power
from lunarsci.twin.ground.terrain import Terrain, build_terrain, write_terrain
from lunarsci.twin.jobs.predict import predict
from lunarsci.twin.plans.plan import Leg, Limit, Plan

WHEEL = read_wheel("yutu2")
PLACES = np.array([[0.0, 0.0], [6.0, 0.0]])


def coarse(spacing_m: float, slope_deg: float, soil: Soil | None = None) -> Terrain:
    """A plane that rises along y, 80 m x 80 m."""
    axis = np.arange(-40.0, 40.0 + 1e-9, spacing_m)
    height = math.tan(math.radians(slope_deg)) * axis[:, None] + 0.0 * axis[None, :]
    return build_terrain("coarse", -40.0, -40.0, spacing_m, height, soil or read_soil("longji"))


def test_slopes_over_17_m_have_the_published_median() -> None:
    """Slopes along x and y are normal: the median slope of 200,000 grounds is what was put in."""
    random = np.random.default_rng(4)
    for slope, hurst in ((2.0, 0.76), (7.5, 0.95)):
        relief = relief_of_kind(slope, hurst)
        rms = math.sqrt(relief.at_one_m * 17.0 ** (2.0 * hurst))
        steep = np.hypot(*random.normal(scale=rms / 17.0, size=(2, 200_000)))
        assert math.degrees(math.atan(np.median(steep))) == pytest.approx(slope, rel=0.01)
    middle, apart = lunar_relief()
    assert middle.hurst == pytest.approx(0.855)
    for sign, kind in ((-1, (2.0, 0.76)), (1, (7.5, 0.95))):
        assert math.sqrt(middle.at_one_m) * math.exp(sign * apart) == pytest.approx(
            math.sqrt(relief_of_kind(*kind).at_one_m)
        )


def spline_weights(place: tuple[float, float]) -> np.ndarray:
    """Weights of 16 x 16 nodes in a cubic spline at a place in the middle of them, by splines of unit vectors."""
    along, across = (CubicSpline(np.arange(16.0), np.eye(16), bc_type="not-a-knot")(7.0 + part) for part in place)
    return np.outer(along, across)


def squared_difference(factor: int, lag: int, place: tuple[int, int]) -> float:
    """Mean square of the difference of what nodes do not show at two places, for differences c l^(2 H) of the ground.

    Of weights w that sum to zero the variance is minus half the sum of w_i w_j c |x_i - x_j|^(2 H) (Matheron 1973).
    """
    relief, _ = lunar_relief()
    ends = np.array([place, (place[0] + lag, place[1])]) / factor
    nodes = np.argwhere(np.ones((16, 16))) - 7.0
    shown = spline_weights(tuple(ends[1])) - spline_weights(tuple(ends[0]))
    places = np.concatenate([ends, nodes])
    weights = np.concatenate([[-1.0, 1.0], -shown.ravel()])
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1) * factor
    return float(-0.5 * weights @ (relief.at_one_m * apart ** (2.0 * relief.hurst)) @ weights)


def test_what_nodes_show_is_left_out_and_the_rest_is_as_rough_as_the_law_says() -> None:
    """Nodes 16 m apart, in steps of 1 m: differences over 4 and 8 m, and nothing at the nodes.

    Roughness that changes from place to place by a normal logarithm of spread s has a mean square of exp(2 s^2).
    """
    apart = 0.4
    found = np.zeros((2, 16, 16))
    for seed in range(24):
        grain = unresolved_grain(16, 1.0, seed, (0.0, apart)).astype(float)
        assert np.abs(grain[::16, ::16]).max() < 1e-5
        for number, lag in enumerate((4, 8)):
            squares = (np.roll(grain, -lag, 0) - grain) ** 2
            found[number] += squares.reshape(32, 16, 32, 16).mean(axis=(0, 2)) / 24
    for number, lag in enumerate((4, 8)):
        for place in ((2, 8), (6, 0), (8, 8)):
            law = squared_difference(16, lag, place) * math.exp(2.0 * apart**2)
            assert found[number][place] == pytest.approx(law, rel=0.12), (lag, place)


def test_nodes_are_as_close_as_a_wheel_is_large_and_the_map_stays_as_it_is() -> None:
    soft, hard = read_soil("longji"), dataclasses.replace(read_soil("longji"), cohesion_pa=3000.0)
    rough = coarse(5.0, 4.0)
    laid = np.broadcast_to(soft.vector(), (*rough.height_m.shape, 8)).copy()
    laid[:, 9:] = hard.vector()
    rough = dataclasses.replace(rough, soil=laid)
    rough.height_m[0, 0] = np.nan
    finer, told = with_unresolved(rough, PLACES, WHEEL, 0.2)
    assert told is not None and told.spacing_m == 5.0 and finer.spacing_m == 5.0 / 64 and finer.errors is not None
    x, y = np.array([-1.3, 0.0, 4.7, 7.2]), np.array([0.4, -2.0, 3.3, 0.0])
    assert finer.height_at(x, y) == pytest.approx(math.tan(math.radians(4.0)) * y, abs=1e-9)
    row = finer.soil[finer.height_m.shape[0] // 2]
    at = np.searchsorted(finer.x_m, 2.5)
    assert row[np.searchsorted(finer.x_m, -1.0), 3] == soft.cohesion_pa
    assert row[np.searchsorted(finer.x_m, 6.0), 3] == pytest.approx(3000.0)
    assert row[at, 3] == pytest.approx(0.5 * (soft.cohesion_pa + 3000.0), rel=0.02)
    near = coarse(0.9, 4.0)
    as_it_is, nothing = with_unresolved(near, PLACES, dataclasses.replace(WHEEL, radius_m=0.9), 0.2)
    assert as_it_is is near and nothing is None
    # Three sigma of what lies between nodes are then a step that a wheel climbs.
    relief, _ = lunar_relief()
    rougher = math.exp(roughness_of_map(rough)[0])
    assert 3.0 * rougher * math.sqrt(relief.at_one_m * told.deciding_m ** (2.0 * relief.hurst)) == pytest.approx(0.2)


def test_a_map_tells_how_rough_its_ground_is() -> None:
    """Fractal ground by the law, and twice or a third of it: the mean of the logarithm moves half-way and more there.

    A normal prior of variance p and one reading of variance r meet at p / (p + r) of the way; the Student law that
    stands for the reading pulls less, the farther it is off. A level map tells nothing.
    """
    relief, apart = lunar_relief()
    prior = apart**2 + 0.45**2
    random, shape = np.random.default_rng(6), (256, 256)
    waves = np.fft.fft2(random.standard_normal(shape)) * np.sqrt(fractal_power(shape, 2.0, relief))
    ground = np.fft.ifft2(waves).real
    means = []
    for factor in (1.0 / 3.0, 1.0, 2.0):
        laid = build_terrain("law", 0.0, 0.0, 2.0, factor * ground, read_soil("longji"))
        mean, sd = roughness_of_map(laid)
        means.append(mean)
        assert 0.25 < sd < math.sqrt(prior)
        assert mean == pytest.approx(prior / (prior + 0.25) * math.log(factor), abs=0.25)
    assert means[0] < means[1] < means[2]
    assert roughness_of_map(coarse(5.0, 4.0))[0] == pytest.approx(0.0, abs=1e-9)
    assert roughness_of_map(coarse(5.0, 4.0))[1] == pytest.approx(math.sqrt(prior), rel=0.01)


def verdict_on(tmp_path: Path, slope_deg: float, tilt_deg: float):  # type: ignore[no-untyped-def]
    """5 m along a slope on nodes 5 m apart, where only the tilt can stand in the way."""
    write_terrain(coarse(5.0, slope_deg), tmp_path / "coarse.npz")
    given = {"slip_ratio": 1.0, "side_slip_deg": 90.0, "sinkage_m": 0.15, "clearance_m": 0.001, "tilt_deg": tilt_deg}
    limits = tuple(Limit(name, "", value, "test", False) for name, value in given.items())
    plan = Plan(name="along", legs=(Leg(5.0),), speed_m_s=0.05, limits=limits)
    return predict(plan, terrain=str(tmp_path / "coarse.npz"), rover="yutu2", time_step=0.2)


def test_a_verdict_that_hangs_on_ground_nobody_saw_is_not_determined(tmp_path: Path) -> None:
    """Over 1 m the ground between the nodes has slopes of 3.4 deg rms; tilts of a drive reach two or three of these."""
    gentle = verdict_on(tmp_path, 0.0, 25.0)
    assert gentle.verdict.verdict == "go" and gentle.prediction.members == 64 and not gentle.untrusted
    steep = verdict_on(tmp_path, 12.0, 10.0)
    assert steep.verdict.verdict == "no-go"
    close = verdict_on(tmp_path, 4.0, 10.0)
    assert close.verdict.verdict == "not-determined" and close.untrusted.startswith("not-determined: it hangs on")
    why = close.verdict.reasons[0]
    assert "nodes 5 m apart" in why and f"every {close.unresolved.deciding_m:.2g} m" in why
    assert 0.05 < close.verdict.failed / 64 < 0.75
