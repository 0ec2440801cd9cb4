"""What a drive teaches: how much narrower its telemetry is expected to make the belief of the soil, and the next drive.

From drives of an ensemble alone. Members are samples of the soil; what telemetry would give of each is compared with
its soil, linearly and with normal laws, so that the expected posterior follows in closed form and needs no update. How
well the next end is then predicted is counted without either (`next_end`).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import ParameterError
from lunarsci.regolith.prior import default_prior
from lunarsci.regolith.states import MeasurementErrors
from lunarsci.twin.choice.next_end import NextEnd, next_end
from lunarsci.twin.plans.path import poses_along
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction

OBSERVED = ("slip_ratio", "side_slip_deg", "sinkage_m")
"""What telemetry gives of a wheel without a measurement of forces."""
PARTS = 2
"""Of a drive for each of which the means over its wheels and samples are observed; assumed. More of them would need
more members: their scatter about what the soil explains is learned from the same drives."""
TRAVEL_SHARE = 0.04 / 3.0
"""Error of the localised end as a share of the way, Ding et al. (2024), 10.1038/s41467-024-46233-8, as in telemetry."""
NOISE_SEED = 31
FEWEST = 2.0
"""So many members are needed for each number that is learned of them; assumed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Teaching:
    """What a drive is expected to teach.

    Attributes
    ----------
    parameters : of the soil, those that differ between members.
    sd_ratio : standard deviation after over before, of each parameter's transform. (parameters,) [-]
    gain_nats : information, half the logarithm of the ratio of the determinants of the covariances. [nat]
    next_end : errors of the predicted end of a next drive; None without one.
    members : drives that it rests on.
    more_than_shortest : whether that end is surely known better than after the shortest of the drives compared.
    """

    parameters: tuple[str, ...]
    sd_ratio: FloatArray = field(repr=False)
    gain_nats: float
    next_end: NextEnd | None
    members: int
    more_than_shortest: bool = False

    @property
    def variance_reduction(self) -> float:
        """Mean over the parameters of 1 - (sd after / sd before)^2. [-]"""
        return float(1.0 - np.mean(self.sd_ratio**2))

    def to_dict(self) -> dict[str, Any]:
        """For a result."""
        return {
            "gain_nats": self.gain_nats,
            "variance_reduction": self.variance_reduction,
            "sd_ratio": dict(zip(self.parameters, map(float, self.sd_ratio), strict=True)),
            "next_end_error_m": None if self.next_end is None else self.next_end.to_dict(),
            "more_than_shortest": self.more_than_shortest,
            "drives": self.members,
        }


def teaching(
    prediction: Prediction, following: Prediction | None = None, errors: MeasurementErrors | None = None
) -> Teaching:
    """What a drive is expected to teach of the soils that it is predicted on.

    Parameters
    ----------
    prediction : drives over samples of the soil, with draws of what the twin's physics is off by.
    following : the next drive, over the same members, with a discrepancy drawn for it anew; its end is what shall be
        known better.
    errors : of slip, side slip and sinkage; those of Ding et al. (2024) where it is None. An error that is a share
        counts as common to all wheels and samples, so that means are no better known than one of them.

    With transforms of the soil t and observations y = a + B t + e, where the covariance R of e holds errors of
    measurement and what of y the soil does not explain (the discrepancy above all), the posterior covariance is
    (S^-1 + B^T R^-1 B)^-1 (Tarantola 2005, Inverse Problem Theory, ch. 3, 10.1137/1.9780898717921): the expected one
    where all is normal and linear. B and R are of a finite ensemble: the inverse of R is taken without its bias
    (Hartlap, Simon & Schneider 2007, A&A 464, 399, 10.1051/0004-6361:20066170), and what errors of B add to the
    information on average is taken off. Members count that finished. Raises ParameterError for too few of them, or
    soils that are all alike.
    """
    done = prediction.finished if following is None else prediction.finished & following.finished
    names, soil = _soils(prediction, done)
    told, sigma = observed(prediction, MeasurementErrors() if errors is None else errors)
    seen, count = told[done], int(done.sum())
    needed = math.ceil(FEWEST * (soil.shape[1] + seen.shape[1] + 1))
    if count < needed:
        raise ParameterError(
            f"{count} drives end, and what they teach needs {needed} of {prediction.members} or more; give more members"
        )
    information = _information(soil, seen, sigma)
    before = np.asarray(np.cov(soil.T), dtype=np.float64).reshape(soil.shape[1], -1)
    after = np.asarray(np.linalg.inv(np.linalg.inv(before) + information), dtype=np.float64)
    return Teaching(
        parameters=names,
        sd_ratio=np.sqrt(np.diag(after) / np.diag(before)),
        gain_nats=0.5 * float(np.linalg.slogdet(before)[1] - np.linalg.slogdet(after)[1]),
        next_end=None if following is None else _next_end(following, told, sigma, done),
        members=count,
    )


def way_back(plan: Plan) -> Plan:
    """The same arcs backwards, from the end of a plan, no wheel slipping on purpose."""
    legs = tuple(map(_backwards, reversed(plan.legs)))
    x, y, heading = poses_along(plan, 1.0)[-1]
    return replace(plan, name=f"way back: {plan.name}", legs=legs, x_m=float(x), y_m=float(y),
                   heading_deg=math.degrees(heading), fixes=None, target_m=None)  # fmt: skip


def _backwards(leg: Leg) -> Leg:
    if not leg.length_m:
        return replace(leg, turn_deg=-leg.turn_deg)
    return replace(leg, curvature_per_m=-leg.curvature_per_m, crab_deg=_about(leg.crab_deg), wheel_test=None)


def _about(crab_deg: float) -> float:
    return crab_deg + 180.0 if crab_deg <= 0 else crab_deg - 180.0


def observed(prediction: Prediction, errors: MeasurementErrors) -> tuple[FloatArray, FloatArray]:
    """What telemetry gives of each member, and its standard errors. (members, k), (k,)

    Means of `OBSERVED` over wheels and samples of each part of the drive, and its end in x and y.
    """
    moving = np.flatnonzero(~prediction.halted)
    columns: list[FloatArray] = []
    sigmas: list[float] = []
    for part in np.array_split(moving, PARTS):
        if not part.size:
            continue
        for name in OBSERVED:
            values = prediction.states[..., STATE_COLUMNS.index(name)][:, part]
            columns.append(values.mean(axis=(1, 2)))
            sigmas.append(float(np.median(errors.of(name, values))))
    place = TRAVEL_SHARE * prediction.plan.length_m
    return np.column_stack([*columns, prediction.endpoints_m]), np.array([*sigmas, place, place])


def _soils(prediction: Prediction, done: Any) -> tuple[tuple[str, ...], FloatArray]:
    """Names and transforms of the parameters that differ, by their standard deviations. (members, p)"""
    laws = default_prior()
    soils: Mapping[str, FloatArray] = prediction.parameters
    varied = {name: laws[name].transformed(values[done]) if name in laws else values[done]
              for name, values in soils.items() if done.any() and np.ptp(values[done]) > 0}  # fmt: skip
    if not varied:
        raise ParameterError("all drives have one soil, so that none teaches anything of it; give a belief")
    columns = np.column_stack(list(varied.values()))
    return tuple(varied), (columns - columns.mean(axis=0)) / columns.std(axis=0, ddof=1)


def _information(soil: FloatArray, seen: FloatArray, sigma: FloatArray) -> FloatArray:
    """B^T R^-1 B of the members, without the bias of their number. (p, p)"""
    count, size = soil.shape
    slopes, left = _explained(soil, seen)
    free = count - 1 - size
    unexplained = left.T @ left / free + np.diag(sigma**2)
    inverse = np.linalg.inv(unexplained) * max(free - seen.shape[1] - 1, 1) / free
    # Slopes of a finite ensemble scatter with R about the true ones: on average that adds k (T^T T)^-1.
    share = float(np.trace(inverse @ (left.T @ left / free)))
    found = slopes @ inverse @ slopes.T - share * np.linalg.inv(soil.T @ soil)
    values, vectors = np.linalg.eigh(0.5 * (found + found.T))
    return np.asarray(vectors @ np.diag(np.maximum(values, 0.0)) @ vectors.T)


def _explained(soil: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Slopes of values on the soil (p, k), and what is left of these (members, k)."""
    off = values - values.mean(axis=0)
    slopes, *_ = np.linalg.lstsq(soil, off, rcond=None)
    return np.asarray(slopes), off - soil @ slopes


def _next_end(following: Prediction, told: FloatArray, sigma: FloatArray, done: BoolArray) -> NextEnd:
    """From telemetry with errors drawn; the same ones for every drive, so that drives are compared by themselves."""
    noise = np.random.default_rng(NOISE_SEED).standard_normal(told.shape)
    return next_end(told + sigma * noise, following.endpoints_m, following.paths[:, -1, :2], done)
