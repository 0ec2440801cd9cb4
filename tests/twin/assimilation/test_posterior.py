"""Coordinates, mode, population and widened errors, against laws that are known."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

from lunarsci.errors import ParameterError
from lunarsci.regolith.belief import first_belief
from lunarsci.twin.assimilation.posterior import (
    PosteriorMode,
    SoilCoordinates,
    draw_particles,
    find_mode,
    fit_emulator,
    inflation_of,
    wheel_errors,
)
from lunarsci.twin.assimilation.residuals import OBSERVED, DriveBias
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, predict

WHEELS = ("FL", "FR", "ML", "MR", "RL", "RR")


def soils(count: int, seed: int = 3) -> np.ndarray:
    first = first_belief()
    noise = np.random.default_rng(seed).standard_normal((count, 8))
    return first.mean + noise @ np.linalg.cholesky(first.covariance).T


def test_coordinates_lead_back_to_the_soil() -> None:
    coordinates, points = SoilCoordinates(0.012), soils(200)
    assert np.allclose(coordinates.transforms(coordinates.from_transforms(points)), points, atol=1e-9)
    nothing = coordinates.from_transforms(points[0])
    nothing[4] = nothing[3] - 1.0
    assert np.isnan(coordinates.transforms(nothing)).all()


def test_volume_is_that_of_the_jacobian_by_differences() -> None:
    coordinates, step = SoilCoordinates(0.012), 1e-6
    for point in soils(5):
        rows = [(coordinates.from_transforms(point + e) - coordinates.from_transforms(point - e)) / (2 * step)
                for e in np.eye(8) * step]  # fmt: skip
        assert coordinates.ln_volume(point) == pytest.approx(-np.log(abs(np.linalg.det(np.array(rows)))), abs=1e-6)


def bent(points: np.ndarray) -> np.ndarray:
    """Residual rows: x normal, y about x^2/2, z about x^3/10 (which no quadratic follows), the others normal."""
    rows = points.copy()
    rows[:, 1] = (points[:, 1] - 0.5 * points[:, 0] ** 2) / 0.5
    rows[:, 2] = points[:, 2] - 0.1 * points[:, 0] ** 3
    return rows


def test_population_of_a_bent_law_has_its_moments() -> None:
    """With x normal: E y = 1/2, var y = 1/2 + 1/4, var z = 1 + 15/100."""

    def with_density(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rows = bent(points)
        return rows, -0.5 * (rows**2).sum(axis=1)

    posterior: Any = SimpleNamespace(
        with_density=with_density,
        residuals=lambda points: (bent(points), points),
        ln_prior=lambda points: np.zeros(len(points)),
    )
    mode = PosteriorMode(np.zeros(8), 0.0, np.diag([1.0, 0.5**2, *np.ones(6)]))
    moments = []
    for seed in range(4):
        drawn, left = draw_particles(posterior, mode, 512, np.random.default_rng(seed))
        assert left < 0.15
        moments.append([*drawn.mean(axis=0)[:2], *drawn.var(axis=0)])
    mean, scatter = np.mean(moments, axis=0), 1.0 / np.sqrt(4 * 512)
    assert mean[0] == pytest.approx(0.0, abs=4 * scatter)
    assert mean[1] == pytest.approx(0.5, abs=4 * scatter)
    assert mean[2:] == pytest.approx([1.0, 0.75, 1.15, *np.ones(5)], rel=0.15)


def test_emulator_follows_quadratic_residuals_exactly() -> None:
    random = np.random.default_rng(1)
    root, linear_part, bend = 0.3 * np.eye(8), random.normal(size=(8, 20)), random.normal(size=(8, 20))

    def rows(points: np.ndarray) -> np.ndarray:
        return points @ linear_part + points**2 @ bend - 1.0

    trained, new = (0.3 * random.normal(size=(count, 8)) for count in (200, 50))
    emulator = fit_emulator(trained, rows(trained), (rows(trained) ** 2).sum(axis=1), np.zeros(8), root)
    assert emulator.cost(new) == pytest.approx((rows(new) ** 2).sum(axis=1), rel=1e-5)


def linear(matrix: np.ndarray, measured: np.ndarray, cliff: float = np.inf) -> Any:
    """A posterior whose residuals are linear; no soil where the first coordinate is above the cliff."""

    def residuals(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rows = points @ matrix.T - measured
        rows[points[:, 0] > cliff] = np.inf
        return rows, np.where(np.isfinite(rows[:, :1]), points, np.inf)

    def cost(points: np.ndarray) -> np.ndarray:
        return sum((part**2).sum(axis=1) for part in residuals(points))

    def draw(count: int, random: np.random.Generator) -> np.ndarray:
        return random.standard_normal((count, 8))

    same = SimpleNamespace(transforms=lambda p: p, from_transforms=lambda p: p)
    belief = SimpleNamespace(covariance=np.eye(8))
    return SimpleNamespace(
        residuals=residuals, cost=cost, draw_prior=draw, coordinates=same, drive=SimpleNamespace(belief=belief)
    )


def test_mode_of_a_linear_problem_is_that_of_least_squares() -> None:
    random = np.random.default_rng(5)
    matrix, truth = 0.3 * random.normal(size=(40, 8)), 0.5 * random.normal(size=8)
    measured = matrix @ truth
    found = find_mode(linear(matrix, measured), np.random.default_rng(0))
    assert found is not None
    inverse = np.linalg.inv(matrix.T @ matrix + np.eye(8))
    assert found.point == pytest.approx(inverse @ matrix.T @ measured, abs=5e-3)
    assert found.covariance == pytest.approx(inverse, abs=1e-6)
    nothing = find_mode(linear(matrix, measured, cliff=-1e9), np.random.default_rng(0))
    assert nothing is None


def test_mode_follows_wild_values_by_their_sign_alone_and_the_prior_whole() -> None:
    """Beyond 4 errors a value pulls by 4 whatever its size and curves nothing; a prior that is 6 off stays a square."""
    random = np.random.default_rng(5)
    matrix, truth = random.normal(size=(40, 8)), np.array([7.0, *np.zeros(7)])
    measured = matrix @ truth
    wild = np.zeros(40, dtype=bool)
    wild[[2, 20, 33]] = True
    measured[wild] += np.array([4e3, 5e3, -6e3])

    def half_cost(point: np.ndarray) -> float:
        off = np.abs(matrix @ point - measured)
        return float(np.where(off < 4.0, 0.5 * off**2, 4.0 * off - 8.0).sum() + 0.5 * (point**2).sum())

    found = find_mode(linear(matrix, measured), np.random.default_rng(0))
    assert found is not None and found.point[0] > 6.0
    assert found.point == pytest.approx(minimize(half_cost, truth, tol=1e-8).x, abs=0.02)
    calm = matrix[~wild]
    assert found.covariance == pytest.approx(np.linalg.inv(calm.T @ calm + np.eye(8)), abs=2e-4)


def test_errors_are_widened_by_what_is_alike_and_not_by_noise() -> None:
    random = np.random.default_rng(2)
    wheels = WHEELS * 32
    drive: Any = SimpleNamespace(counted=np.ones((len(wheels), 6), dtype=bool), record=SimpleNamespace(wheel=wheels))
    # By chance alone 1 in 100 quantities is widened: 2.4 of 240 are expected, 8 or more happen once in 300 times.
    nowhere = np.zeros(0)
    for alarm in (lambda *given: inflation_of(*given, nowhere), wheel_errors):
        assert sum(len(alarm(drive, random.normal(size=(len(wheels), 6)))) for _ in range(40)) < 8
    noise = random.normal(size=(len(wheels), 6))
    alike = noise.copy()
    alike[:, 0] += np.where(np.array(wheels) == "RL", 2.0, 0.0)
    alike[:, 1] *= 2.0
    alike[:, 2] += 3.0 * np.sign(np.sin(np.arange(len(wheels)) / 30.0))
    found = inflation_of(drive, alike, nowhere)
    assert {OBSERVED[1], OBSERVED[2]} <= set(found) <= {*OBSERVED[1:]}
    assert found[OBSERVED[1]] == pytest.approx(2.0, rel=0.25)
    assert found[OBSERVED[2]] > 4.0
    own = wheel_errors(drive, alike)
    # One wheel of six is off by 2: about their mean the six scatter with a variance of 4 (1/6) (5/6) 6/5.
    assert set(own) >= {OBSERVED[0]}
    assert own[OBSERVED[0]] == pytest.approx(np.sqrt(4.0 / 6.0), rel=0.3)
    wild = noise.copy()
    wild[::40, 2] = 300.0
    assert inflation_of(drive, wild, nowhere).get(OBSERVED[2], 1.0) < 2.0


def test_errors_that_stay_are_removed_as_their_covariance_says() -> None:
    """Whitening of I + B B^T against the dense inverse root; and back."""
    random = np.random.default_rng(4)
    values, sigma = 1.0 + random.random((24, 6)), 0.1 + random.random((24, 6))
    wheel, way = np.arange(24) % 6, np.array([[3.0, 1.0]])
    whitening = np.linalg.inv(np.linalg.cholesky(np.array([[[0.04, 0.01], [0.01, 0.02]]])))
    marginalised = DriveBias(wheels={"sinkage_m": 2.0}).marginalised(values, sigma, wheel, way, whitening, values)
    basis = marginalised.vectors * marginalised.sizes
    size, vectors = np.linalg.eigh(np.eye(24 * 6 + 2) + basis @ basis.T)
    rows = random.normal(size=(3, 24 * 6 + 2))
    assert marginalised.applied(rows) == pytest.approx(rows @ (vectors / np.sqrt(size)) @ vectors.T)
    assert marginalised.undone(marginalised.applied(rows)) == pytest.approx(rows)
    # A drive 25 % of whose slip is wrong, and which went that much too far, is explained to a large part.
    wrong = np.zeros((24, 6))
    wrong[:, 1] = 0.25 * values[:, 1].mean() / sigma[:, 1]
    row = np.append(wrong, (whitening @ (-0.25 * values[:, 1].mean() * way[0])[None, :, None])[0])
    assert np.linalg.norm(row) > 5.0 and np.linalg.norm(marginalised.applied(row)) < np.sqrt(2.0)
    with pytest.raises(ParameterError, match="model error of 'nothing'"):
        DriveBias({"nothing": 1.0})


@pytest.mark.parametrize(
    ("quantity", "softer"), [("side_slip_deg", "lateral_modulus_mm"), ("slip_ratio", "shear_modulus_mm")]
)
def test_a_slip_that_is_off_puts_the_rover_where_a_drive_with_more_slip_ends(
    yutu2: Rover, slope: Any, quantity: str, softer: str
) -> None:
    """Up and across a slope on two soils, of which one lets the wheels slip more: what states and places differ by lies
    along the error that all wheels share. With a lever of the wrong sign none of it would, of twice the size a third
    would not, as states and places are made to weigh alike."""
    plan = Plan(name="oblique", legs=(Leg(3.0),), speed_m_s=0.05, heading_deg=30.0)
    modulus = {"lateral_modulus_mm": 20.0, "shear_modulus_mm": 18.0}
    soils = {name: [value, value * (1.2 if name == softer else 1.0)] for name, value in modulus.items()}
    drives = predict(yutu2, slope(0.06, 0.02), plan, samples=soils)
    slips = drives.states[:, 2:, :, STATE_COLUMNS.index(quantity)].reshape(2, -1)
    places = drives.paths[:, 2:, :2]
    apart, moved = float(np.diff(slips.mean(axis=1))[0]), (places[1] - places[0]).ravel()
    k, shape = OBSERVED.index(quantity), (slips.shape[1], 6)
    values = np.zeros(shape)
    values[:, k] = slips[0].mean()
    off = np.zeros(shape)
    off[:, k] = apart
    weight = np.sqrt(len(off)) * abs(apart) / np.linalg.norm(moved)
    bias = DriveBias(common={quantity: 100.0}).marginalised(
        values,
        np.ones(shape),
        np.arange(len(off)) % 6,
        places[0] - drives.paths[0, 0, :2],
        weight * np.eye(moved.size),
        values,
    )
    row = np.append(off, weight * moved)
    assert np.linalg.norm(bias.applied(row)) < 0.1 * np.linalg.norm(row)
