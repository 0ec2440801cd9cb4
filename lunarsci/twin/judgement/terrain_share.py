"""What errors of the terrain make of drives: some of them again, on ground as it is likely to be."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.twin.judgement.keeping import extremes
from lunarsci.twin.simulation.ensemble import Prediction, predict

MOST_PAIRS = 64
"""Drives that are driven again, evenly from all; of so many pairs a share is known within a fifth of itself."""


@dataclass(frozen=True, slots=True)
class TerrainShares:
    """How much of the variance over the drives is of the terrain, by pairs of drives on the same soil.

    One drive of a pair is on a drawn ground, the other on the likely one; with D their difference and S the second,
    the share is var D / (var D + var S).

    Attributes
    ----------
    pairs : how many.
    end_m : root mean square distance of the ends of a pair. [m]
    end, slip_ratio, tilt_deg, sinkage_m : shares, of the end and of the worst value of each drive; None where nothing
        varies. [-]
    """

    pairs: int
    end_m: float
    end: float | None
    slip_ratio: float | None
    tilt_deg: float | None
    sinkage_m: float | None


def terrain_shares(prediction: Prediction) -> TerrainShares | None:
    """By at most 64 pairs; None where heights are exact, or fewer than two pairs finished."""
    if prediction.draws is None:
        return None
    every = prediction.grounds is not None
    count = prediction.members if every else min(MOST_PAIRS, prediction.members)
    chosen = np.unique(np.linspace(0, prediction.members - 1, count).astype(int))
    plain = _again(prediction, chosen)
    done = plain.finished & prediction.finished[chosen]
    if done.sum() < 2:
        return None
    ends = prediction.paths[chosen][done, -1, :2], plain.paths[done, -1, :2]
    worst = {
        name: _share(extremes(prediction, name)[chosen][done, None], extremes(plain, name)[done, None])
        for name in ("slip_ratio", "tilt_deg", "sinkage_m")
    }
    off = float(np.sqrt(((ends[0] - ends[1]) ** 2).sum(axis=1).mean()))
    return TerrainShares(pairs=int(done.sum()), end_m=off, end=_share(*ends), **worst)


def _again(prediction: Prediction, chosen: IntArray) -> Prediction:
    """Some members on the likely ground."""
    samples = {name: values[chosen] for name, values in prediction.parameters.items()}
    known: dict[str, Any] = {"samples": samples} if samples else {"sweep": ()}
    return predict(
        prediction.rover,
        dataclasses.replace(prediction.terrain, errors=None),
        prediction.plan,
        time_step_s=prediction.time_step_s * (1 + 1e-9),
        sample_m=float(prediction.time_s[1]) * prediction.plan.speed_m_s * (1 + 1e-9),
        seed=prediction.seed,
        ruts=prediction.ruts,
        before=prediction.before,
        **(known if prediction.grounds is None else {"grounds": prediction.grounds}),
    )


def _share(drawn: FloatArray, likely: FloatArray) -> float | None:
    """Of the variance of values (n, k) that their ground makes."""
    of_ground, of_soil = (float(part.var(axis=0).sum()) for part in (drawn - likely, likely))
    return of_ground / (of_ground + of_soil) if of_ground + of_soil > 0 else None
