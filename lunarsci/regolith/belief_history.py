"""What a belief of a soil went through: its state after each drive, going back to one, and two beliefs side by side.

From the effective values that a belief holds to the ground's own: a belief of drives holds the values that the twin's
law needs to move as the rover did, good for predictions with this law. Stress integrals, ruts, or a soil that changes
move the rover alike with other values, and so the ground's own, which another instrument would measure, are known less
well.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError
from lunarsci.regolith.belief import SoilBelief, first_belief
from lunarsci.regolith.physics_discrepancy import FIRST, PhysicsDiscrepancy
from lunarsci.regolith.prior import NINETY_FIVE, PARAMETERS, values_of

OTHER_PHYSICS: Mapping[str, float] = MappingProxyType(
    {
        "stiffness_kpa_m_n": 0.7,
        "sinkage_exponent": 0.4,
        "sinkage_exponent_slip": 1.9,
        "cohesion_pa": 0.7,
        "friction_angle_deg": 1.0,
        "shear_modulus_mm": 0.4,
        "external_friction_angle_deg": 0.6,
        "lateral_modulus_mm": 0.5,
    }
)
"""Standard deviation between effective and own values, in widths of the prior: the most probable of 19 updates by
stress integrals, ruts and changing soils, drawn towards their common 0.8, on the grounds and soils that
`tests/benchmarks/loop.py --training --seed 1701` drives on, which no reported number is of. [-]"""
STATE = ("mean", "covariance")
"""Keys of an entry that hold the belief after its drive; entries of older files have none."""


def with_drive(
    after: SoilBelief,
    before: SoilBelief,
    drive: Mapping[str, Any],
    *,
    parent_sha256: str | None = None,
    forgotten: float = 0.0,
) -> SoilBelief:
    """The belief after a drive, with the drive and its own state at the end of its history.

    Parameters
    ----------
    after, before : the belief after the drive, and that before it, which holds the history so far.
    drive : what the drive was and how it was explained, as plain values; kept as it is.
        Of what the discrepancy rests on it keeps the number alone, as the belief itself holds the lines: a history
        that repeated them would grow as the square of its drives.
    parent_sha256 : of the file that held the belief before; None where it was the priors.
    forgotten : share of the way back to the priors that was gone before the drive counted, 0 to 1.
    """
    state = {
        "mean": after.mean.tolist(),
        "covariance": after.covariance.tolist(),
        "discrepancy": after.discrepancy.to_dict() | {"scored": len(after.discrepancy.scored)},
    }
    entry = {**drive, "parent_sha256": parent_sha256, "forgotten": forgotten, **state}
    return dataclasses.replace(after, history=(*_with_own_lines(before, after), entry))


def _with_own_lines(before: SoilBelief, after: SoilBelief) -> tuple[Mapping[str, Any], ...]:
    """The history before a drive; its entries have lines of their own where the belief after it has others."""
    lines = before.discrepancy.scored
    if after.discrepancy.scored[: len(lines)] == lines:
        return before.history
    return tuple(
        {**entry, "discrepancy": _with_lines(entry["discrepancy"], before)} if entry.get("discrepancy") else entry
        for entry in before.history
    )


def past_beliefs(belief: SoilBelief) -> list[SoilBelief | None]:
    """The belief after 0, 1, ... drives, None where the file did not keep it. (drives + 1)

    The first is the priors, the last the belief itself, with its population; those between are normal laws.
    Raises ParameterError for an entry whose state is no belief.
    """
    past: list[SoilBelief | None] = [first_belief(belief.soil.laws)]
    for number, entry in enumerate(belief.history[:-1], 1):
        past.append(_state(belief, entry, number))
    return [*past, belief] if belief.history else [belief]


def _state(belief: SoilBelief, entry: Mapping[str, Any], number: int) -> SoilBelief | None:
    if any(key not in entry for key in STATE):
        return None
    try:
        mean, covariance = (np.array(entry[key], dtype=np.float64) for key in STATE)
        kept = entry.get("discrepancy")
        discrepancy = FIRST if kept is None else PhysicsDiscrepancy.of(_with_lines(kept, belief))
        laws = belief.laws if len(mean) == len(belief.laws) else belief.soil.laws
        return SoilBelief(laws, mean, covariance, belief.history[:number], discrepancy=discrepancy)
    except (KeyError, TypeError, ValueError) as error:
        raise ParameterError(f"history, drive {number}: {error}") from error


def _with_lines(kept: Mapping[str, Any], belief: SoilBelief) -> Mapping[str, Any]:
    """A discrepancy of an entry with what it rested on by then: the first of the belief's lines; older files have them.

    Raises ValueError for more of them than there are.
    """
    count, lines = kept.get("scored", ()), belief.discrepancy.scored
    if not isinstance(count, int):
        return kept
    if not 0 <= count <= len(lines):
        raise ValueError(f"its discrepancy rests on {count} drives, that of the belief on {len(lines)}")
    return {**kept, "scored": lines[:count]}


def rolled_back(belief: SoilBelief, drives: int) -> SoilBelief:
    """The belief as it was after so many of its drives; 0 gives the priors.

    Mean and covariance come back to the digit. The population of an earlier moment is not kept in a file: what comes
    back is a normal law, but for the belief as it is. Raises ParameterError for a number out of range, and for a state
    that the file does not hold.
    """
    if not 0 <= drives <= len(belief.history):
        raise ParameterError(f"cannot go back to {drives} drives; the belief rests on {len(belief.history)}")
    found = past_beliefs(belief)[drives]
    if found is None:
        raise ParameterError(f"the state after drive {drives} was not kept; its update came from an older version")
    return found


def moved_sd(belief: SoilBelief) -> list[dict[str, float] | None]:
    """How far each drive moved each parameter's transform, in standard deviations of the state before. [-]

    None for a drive before or after which the state was not kept. What was forgotten before the drive counts as moved.
    """
    past = [state and state.soil for state in past_beliefs(belief)]
    return [
        None if one is None or two is None else _named((two.mean - one.mean) / np.sqrt(np.diag(one.covariance)))
        for one, two in pairwise(past)
    ]


def _named(values: FloatArray) -> dict[str, float]:
    return dict(zip(PARAMETERS, map(float, values), strict=True))


def shared_drives(one: SoilBelief, other: SoilBelief) -> int:
    """Number of drives, from the first on, that two beliefs have in common: same states file, same values, same state.

    Both rest on them, so that they are no independent witnesses of the soil.
    """
    count = 0
    for mine, theirs in zip(one.history, other.history, strict=False):
        if dict(mine) != dict(theirs):
            break
        count += 1
    return count


@dataclass(frozen=True, slots=True)
class ParameterDistance:
    """One parameter in two beliefs.

    Attributes
    ----------
    one, other : median and 68 % limits, in the parameter's unit.
    difference_sd : other less one, of the transforms, in units of the root of the summed variances. [-]
    bhattacharyya : distance of the two normal laws of the transform, 0 where they are equal. [-]
    """

    one: tuple[float, float, float]
    other: tuple[float, float, float]
    difference_sd: float
    bhattacharyya: float


@dataclass(frozen=True, slots=True)
class BeliefDistance:
    """Two beliefs side by side.

    Attributes
    ----------
    parameters : by name.
    difference_sd : of the whole, root of the mean square of the difference in units of the summed covariances: about 1
        where two independent beliefs of one soil differ as they should. [-]
    bhattacharyya : distance of the normal laws of all transforms, 0 where they are equal. [-]
    kullback_leibler : information that is lost where the first stands for the other, and the reverse. [nat]
    shared_drives : that both rest on.
    """

    parameters: dict[str, ParameterDistance]
    difference_sd: float
    bhattacharyya: float
    kullback_leibler: tuple[float, float]
    shared_drives: int


def compare_beliefs(one: SoilBelief, other: SoilBelief) -> BeliefDistance:
    """Hold what two beliefs say of the soil beside each other, as the normal laws of their means and covariances.

    Sources: A. Bhattacharyya (1946), Sankhya 7, 401; S. Kullback & R. A. Leibler (1951), Ann. Math. Stat. 22, 79,
    10.1214/aoms/1177729694. Raises ParameterError for beliefs whose parameters are transformed otherwise.
    """
    one, other = one.soil, other.soil
    strange = [name for name in PARAMETERS if one.laws[name].of != other.laws[name].of]
    if strange:
        raise ParameterError(f"the beliefs do not compare: {strange[0]} is transformed otherwise in the two")
    mine, theirs = one.intervals(), other.intervals()
    off, total = other.mean - one.mean, one.covariance + other.covariance
    rows = {}
    for k, name in enumerate(PARAMETERS):
        pair = [(law.mean[k : k + 1], law.covariance[k : k + 1, k : k + 1]) for law in (one, other)]
        apart = float(off[k] / np.sqrt(total[k, k]))
        rows[name] = ParameterDistance(mine[name], theirs[name], apart, _bhattacharyya(*pair[0], *pair[1]))
    return BeliefDistance(
        rows,
        float(np.sqrt(off @ np.linalg.solve(total, off) / len(PARAMETERS))),
        _bhattacharyya(one.mean, one.covariance, other.mean, other.covariance),
        (_kullback_leibler(other, one), _kullback_leibler(one, other)),
        shared_drives(one, other),
    )


def _bhattacharyya(mean: FloatArray, covariance: FloatArray, other: FloatArray, others: FloatArray) -> float:
    """(1/8) d' S^-1 d + (1/2) ln(det S / sqrt(det A det B)), S = (A + B)/2, d the difference of the means."""
    middle, off = 0.5 * (covariance + others), other - mean
    ln_det = [float(np.linalg.slogdet(matrix)[1]) for matrix in (middle, covariance, others)]
    return float(off @ np.linalg.solve(middle, off)) / 8.0 + 0.5 * (ln_det[0] - 0.5 * (ln_det[1] + ln_det[2]))


def _kullback_leibler(true: SoilBelief, model: SoilBelief) -> float:
    """(1/2) (tr(M^-1 T) + d' M^-1 d - n + ln det M - ln det T)."""
    off = model.mean - true.mean
    spread = float(np.trace(np.linalg.solve(model.covariance, true.covariance)))
    shift = float(off @ np.linalg.solve(model.covariance, off))
    ln_det = float(np.linalg.slogdet(model.covariance)[1] - np.linalg.slogdet(true.covariance)[1])
    return 0.5 * (spread + shift - len(PARAMETERS) + ln_det)


@dataclass(frozen=True, slots=True)
class GroundInterval:
    """One parameter of the ground itself, in its unit: median, and limits at 68 and 95 %."""

    median: float
    low_68: float
    high_68: float
    low_95: float
    high_95: float


def ground_moments(belief: SoilBelief) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation of the transforms of the ground's own values, each by itself. (8,), (8,)

    What the drives say, which is the belief without its prior, is widened by what other physics would change, and
    joined with the prior again; so no interval is wider than before any drive.
    """
    belief = belief.soil
    center = np.array([belief.laws[name].center for name in PARAMETERS])
    width = np.array([belief.laws[name].width for name in PARAMETERS])
    off, variance = (belief.mean - center) / width, np.diag(belief.covariance) / width**2
    told = np.maximum(1.0 / variance - 1.0, 1e-9)
    said = off / variance / told
    other = np.array([OTHER_PHYSICS[name] for name in PARAMETERS])
    weight = 1.0 / (1.0 / told + other**2)
    own = 1.0 / (1.0 + weight)
    return center + width * own * weight * said, width * np.sqrt(own)


def ground_intervals(belief: SoilBelief) -> dict[str, GroundInterval]:
    """Median and limits of each parameter of the ground itself, in its unit."""
    mean, spread = ground_moments(belief)
    points = np.stack([mean + k * spread for k in (0.0, -1.0, 1.0, -NINETY_FIVE, NINETY_FIVE)])
    rows = values_of(belief.laws, points)
    return {name: GroundInterval(*map(float, column)) for name, column in zip(PARAMETERS, rows.T, strict=True)}


def parameter_rows(belief: SoilBelief) -> dict[str, dict[str, float]]:
    """By parameter: effective median and 68 % interval, posterior over prior standard deviation, and the ground's own.

    Keys `median`, `low`, `high`, `left_of_prior`, and `ground_` with those of `GroundInterval`.
    """
    ground = ground_intervals(belief)
    return {
        name: row | {f"ground_{key}": value for key, value in asdict(ground[name]).items()}
        for name, row in effective_rows(belief.soil).items()
    }


def contact_rows(belief: SoilBelief) -> dict[str, dict[str, float]]:
    """Effective rows of the wheels' parameters, those of `ROLLING`; none where the belief holds them for known."""
    return {name: row for name, row in effective_rows(belief).items() if name not in PARAMETERS}


def effective_rows(belief: SoilBelief) -> dict[str, dict[str, float]]:
    """By parameter: effective median and 68 % interval, and posterior over prior standard deviation."""
    left = belief.sd_ratio
    return {
        name: {"median": median, "low": low, "high": high, "left_of_prior": left[name]}
        for name, (median, low, high) in belief.intervals().items()
    }
