"""Regions of a predicted return: whether they hold the true end, and what past returns teach of them."""

from typing import Any

import numpy as np

from lunarsci.regolith.physics_discrepancy import PhysicsDiscrepancy, across_of

FEWEST_ENDS = 3
"""Of drives that finished, from which on they have a spread."""
REGIONS = {"held": 0.9, "held_50": 0.5}
"""Share of the predicted ends that a region holds."""


def distance_in(cloud: np.ndarray, point: np.ndarray) -> float:
    """Share of the ends of a cloud that are nearer to its mean than a point, in its standard deviations.

    By rank, so that tails count for what they are.
    """
    off = np.vstack([cloud, point]) - np.median(cloud, axis=0)
    squares = np.einsum("ij,ij->i", off @ np.linalg.inv(np.cov(cloud.T)), off)
    return float((squares[:-1] < squares[-1]).mean())


def region(cloud: np.ndarray, end: np.ndarray) -> dict[str, Any]:
    """Where the true end lies in a cloud of predicted ones, and how large its regions are.

    `radius_m` is the root of the trace of the covariance; `radius_90_m` the radius of the circle that has the area of
    the 90 % region.
    """
    within = distance_in(cloud, end)
    off = cloud - np.median(cloud, axis=0)
    covariance = np.cov(cloud.T)
    squares = np.einsum("ij,ij->i", off @ np.linalg.inv(covariance), off)
    size = float(np.linalg.det(covariance) ** 0.25 * np.sqrt(np.quantile(squares, REGIONS["held"])))
    held = {name: within <= share for name, share in REGIONS.items()}
    return {"within": within, "radius_m": float(np.sqrt(np.trace(covariance))), "radius_90_m": size} | held


def moved(cloud: np.ndarray, law: PhysicsDiscrepancy, way_m2: np.ndarray, seed: int) -> np.ndarray:
    """Ends on soils, each with a draw of a discrepancy."""
    random = np.random.default_rng(seed)
    parts = ((law.along, way_m2), (law.across, across_of(way_m2)))
    offsets = [
        one.sizes(len(cloud), random)[:, None]
        * (random.standard_normal(cloud.shape) @ np.linalg.cholesky(matrix + 1e-12 * np.eye(2)).T)
        for one, matrix in parts
    ]
    return np.asarray(cloud + sum(offsets))


def after_past_returns(rows: list[dict[str, Any]], past: int) -> list[dict[str, Any]]:
    """Regions of each return where its discrepancy also learned from so many other returns by the same physics.

    Those are the next ones in the order of the rows, in a circle, each scored by its measured end. Fewer where there
    are not as many.
    """
    found = []
    for k, row in enumerate(rows):
        if not row["model_error"]:
            found.append(row)
            continue
        law = PhysicsDiscrepancy.of(row["discrepancy"])
        for other in (rows[(k + 1 + n) % len(rows)] for n in range(min(past, len(rows) - 1))):
            ends = np.array(other["soil_ends_m"])
            if len(ends) < FEWEST_ENDS:
                continue
            known = np.cov(ends.T) + np.array(other["place_m2"])
            law = law.with_miss(np.array(other["place_m"]) - np.median(ends, axis=0), known, np.array(other["way_m2"]))
        cloud = moved(np.array(row["soil_ends_m"]), law, np.array(row["way_m2"]), 11 + k)
        found.append(region(cloud, np.array(row["end_m"])))
    return found
