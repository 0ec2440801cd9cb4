"""What errors of the terrain make of drives: some of them again, on ground as it is likely to be."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray, IntArray
from lunarsci.twin.judgement.keeping import extremes
from lunarsci.twin.simulation.ensemble import LONGEST_SAMPLE_M, LONGEST_STEP_S, Prediction, predict

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


def likely_drives(prediction: Prediction) -> Prediction | None:
    """Some of the drives again, at most 64, on ground as it is likely to be; None where heights are exact."""
    return None if prediction.draws is None else _again(prediction, _chosen(prediction))


def _chosen(prediction: Prediction) -> IntArray:
    count = prediction.members if prediction.grounds is not None else min(MOST_PAIRS, prediction.members)
    return np.unique(np.linspace(0, prediction.members - 1, count).astype(int))


def terrain_shares(prediction: Prediction, plain: Prediction | None) -> TerrainShares | None:
    """By pairs with `likely_drives`; None without them, or where fewer than two pairs finished."""
    if plain is None:
        return None
    chosen = _chosen(prediction)
    if plain.members == 1:
        plain = _alike(plain, len(chosen))
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


def _alike(plain: Prediction, count: int) -> Prediction:
    """One drive, as many times as there are grounds on which its soil was driven."""
    return dataclasses.replace(
        plain,
        paths=np.repeat(plain.paths, count, axis=0),
        states=np.repeat(plain.states, count, axis=0),
        recorded=np.repeat(plain.recorded, count),
        outcome=np.repeat(plain.outcome, count),
        finer=None,
    )


def _again(prediction: Prediction, chosen: IntArray) -> Prediction:
    """Some members on the likely ground."""
    samples = {name: values[chosen] for name, values in prediction.parameters.items()}
    known: dict[str, Any] = {"samples": samples} if samples else {"sweep": ()}
    sample_m = float(prediction.time_s[1]) * prediction.plan.speed_m_s
    return predict(
        prediction.rover,
        dataclasses.replace(prediction.terrain, errors=None),
        prediction.plan,
        time_step_s=min(prediction.time_step_s * (1 + 1e-9), LONGEST_STEP_S),
        sample_m=min(sample_m * (1 + 1e-9), LONGEST_SAMPLE_M),
        seed=prediction.seed,
        ruts=prediction.ruts,
        before=prediction.before,
        **(known if prediction.grounds is None else {"grounds": prediction.grounds}),
    )


def _share(drawn: FloatArray, likely: FloatArray) -> float | None:
    """Of the variance of values (n, k) that their ground makes."""
    of_ground, of_soil = (float(part.var(axis=0).sum()) for part in (drawn - likely, likely))
    return of_ground / (of_ground + of_soil) if of_ground + of_soil > 0 else None
