"""What is believed of a soil: a normal law of its transformed parameters, kept between drives as a file.

What a belief went through: its state after each drive, going back to one, and two beliefs side by side.
"""

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from lunarsci.errors import ParameterError
from lunarsci.inputs import InputFile, read_json
from lunarsci.regolith.fit_verdict import FitVerdict, verdict_of
from lunarsci.regolith.physics_discrepancy import FIRST, PhysicsDiscrepancy
from lunarsci.regolith.prior import PARAMETERS, Law, default_prior, values_of

__all__ = [
    "SCHEMA",
    "BeliefDistance",
    "ParameterDistance",
    "SoilBelief",
    "belief_of",
    "compare_beliefs",
    "first_belief",
    "moved_sd",
    "past_beliefs",
    "read_belief",
    "rolled_back",
    "shared_drives",
    "with_drive",
]

FloatArray = npt.NDArray[np.float64]
SCHEMA = "lunarsci/soil-belief/1"
ASYMMETRY = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class SoilBelief:
    """A normal law of all eight parameters, in the transforms of the laws it began with.

    Attributes
    ----------
    laws : the prior laws, by parameter in the order of `PARAMETERS`; they say what is transformed how, and how wide the
        belief was before any drive.
    mean : of the transforms. (8,)
    covariance : of the transforms. (8, 8)
    history : one entry for each update, oldest first: what it rests on.
    population : transforms drawn from the belief where it is not normal; mean and covariance are theirs. (d, 8)
    verdict : of the fit to wheel states that it comes from, None where it does not.
    discrepancy : what drives are off by beside the soil; that of no drive where a file has none.

    Raises ParameterError for a covariance that is not symmetric and positive definite.
    """

    laws: Mapping[str, Law]
    mean: FloatArray
    covariance: FloatArray
    history: tuple[Mapping[str, Any], ...] = field(default=())
    population: FloatArray | None = field(default=None, repr=False)
    verdict: FitVerdict | None = None
    discrepancy: PhysicsDiscrepancy = FIRST

    def __post_init__(self) -> None:
        size = len(PARAMETERS)
        if tuple(self.laws) != PARAMETERS or self.mean.shape != (size,) or self.covariance.shape != (size, size):
            raise ParameterError(f"a belief needs laws, a mean and a covariance of {', '.join(PARAMETERS)}")
        if not (np.isfinite(self.mean).all() and np.isfinite(self.covariance).all()):
            raise ParameterError("a belief's mean and covariance must be finite")
        if self.population is not None and (
            self.population.ndim != 2 or self.population.shape[1] != size or not np.isfinite(self.population).all()
        ):
            raise ParameterError(f"a belief's population must be finite, {size} numbers for each draw")
        scale = np.sqrt(np.abs(np.diag(self.covariance)))
        if (np.abs(self.covariance - self.covariance.T) > ASYMMETRY * np.outer(scale, scale)).any():
            raise ParameterError("a belief's covariance must be symmetric")
        if not np.linalg.eigvalsh(self.covariance / np.outer(scale, scale))[0] > 0:
            raise ParameterError("a belief's covariance must be positive definite")

    @property
    def ruts(self) -> bool:
        """Whether its values are those with which wheels that follow meet the ruts of others, as in its last drive."""
        return bool(self.history and self.history[-1].get("ruts", False))

    @property
    def left_of_prior(self) -> dict[str, float]:
        """Standard deviation of each parameter's transform as a share of its first law's. [-]"""
        spread = np.sqrt(np.diag(self.covariance))
        return {name: float(sd / self.laws[name].width) for name, sd in zip(PARAMETERS, spread, strict=True)}

    def intervals(self) -> dict[str, tuple[float, float, float]]:
        """Median and 68 % limits of each parameter, in its unit."""
        spread = np.sqrt(np.diag(self.covariance))
        rows = values_of(self.laws, np.stack([self.mean, self.mean - spread, self.mean + spread]))
        return {
            name: (float(m), float(low), float(high)) for name, (m, low, high) in zip(PARAMETERS, rows.T, strict=True)
        }

    def draws(self, count: int, seed: int = 0) -> dict[str, FloatArray]:
        """Soils drawn from the belief, by parameter in its unit: its population, in turn, or a normal law. (count,)"""
        random = np.random.default_rng(seed)
        if self.population is not None:
            points = self.population[np.resize(random.permutation(len(self.population)), count)]
        else:
            noise = random.standard_normal((count, len(PARAMETERS)))
            points = self.mean + noise @ np.linalg.cholesky(self.covariance).T
        values = values_of(self.laws, points)
        return {name: values[:, k] for k, name in enumerate(PARAMETERS)}

    def forgotten(self, share: float) -> "SoilBelief":
        """The belief as ground further on is believed to be: `share` of the way back to the first laws, 0 to 1.

        Mean and covariance are those of the mixture of both; a population is given up. The discrepancy is forgotten
        alike. Raises ParameterError.
        """
        if not 0 <= share <= 1:
            raise ParameterError(f"forgetting is {share}; give 0 (all is kept) to 1 (all is forgotten)")
        first = first_belief(self.laws)
        off = self.mean - first.mean
        covariance = (1 - share) * self.covariance + share * first.covariance + share * (1 - share) * np.outer(off, off)
        discrepancy = self.discrepancy.forgotten(share)
        mean = self.mean - share * off
        return SoilBelief(self.laws, mean, covariance, self.history, verdict=self.verdict, discrepancy=discrepancy)

    def to_json(self) -> str:
        """As `read_belief` reads it."""
        document = {
            "schema": SCHEMA,
            "order": list(PARAMETERS),
            "laws": {name: asdict(law) for name, law in self.laws.items()},
            "mean": self.mean.tolist(),
            "covariance": self.covariance.tolist(),
            "history": [dict(entry) for entry in self.history],
            "population": None if self.population is None else self.population.tolist(),
            "discrepancy": self.discrepancy.to_dict(),
        }
        if self.verdict is not None:
            document["verdict"] = self.verdict.to_dict()
        return json.dumps(document, indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n"


def first_belief(laws: Mapping[str, Law] | None = None) -> SoilBelief:
    """The prior laws, before any drive."""
    laws = default_prior() if laws is None else laws
    widths = np.array([laws[name].width for name in PARAMETERS])
    return SoilBelief(laws, np.array([laws[name].center for name in PARAMETERS]), np.diag(widths**2))


def belief_of(document: Mapping[str, Any]) -> SoilBelief:
    """The belief of a parsed document. Raises ParameterError for what is none."""
    if not isinstance(document, Mapping) or document.get("schema") != SCHEMA:
        raise ParameterError(f"not a soil belief; its schema must be {SCHEMA}")
    try:
        if tuple(document["order"]) != PARAMETERS:
            raise ParameterError(f"its parameters are not {', '.join(PARAMETERS)}")
        laws = {name: Law(**document["laws"][name]) for name in PARAMETERS}
        mean, covariance = (np.array(document[key], dtype=np.float64) for key in ("mean", "covariance"))
        drawn = document.get("population")
        population = None if drawn is None else np.array(drawn, dtype=np.float64)
        verdict, kept = verdict_of(document.get("verdict")), document.get("discrepancy")
        discrepancy = FIRST if kept is None else PhysicsDiscrepancy.of(kept)
        history = tuple(document.get("history", ()))
        return SoilBelief(laws, mean, covariance, history, population, verdict, discrepancy)
    except KeyError as error:
        raise ParameterError(f"no {error} in it") from error
    except (TypeError, ValueError) as error:
        raise ParameterError(str(error)) from error


def read_belief(source: InputFile) -> SoilBelief:
    """Read a belief. Raises DataError for text that is no belief."""
    return read_json(source, "a belief", belief_of)


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
    parent_sha256 : of the file that held the belief before; None where it was the priors.
    forgotten : share of the way back to the priors that was gone before the drive counted, 0 to 1.
    """
    state = {
        "mean": after.mean.tolist(),
        "covariance": after.covariance.tolist(),
        "discrepancy": after.discrepancy.to_dict(),
    }
    entry = {**drive, "parent_sha256": parent_sha256, "forgotten": forgotten, **state}
    return dataclasses.replace(after, history=(*before.history, entry))


def past_beliefs(belief: SoilBelief) -> list[SoilBelief | None]:
    """The belief after 0, 1, ... drives, None where the file did not keep it. (drives + 1)

    The first is the priors, the last the belief itself, with its population; those between are normal laws.
    Raises ParameterError for an entry whose state is no belief.
    """
    past: list[SoilBelief | None] = [first_belief(belief.laws)]
    for number, entry in enumerate(belief.history[:-1], 1):
        past.append(_state(belief, entry, number))
    return [*past, belief] if belief.history else [belief]


def _state(belief: SoilBelief, entry: Mapping[str, Any], number: int) -> SoilBelief | None:
    if any(key not in entry for key in STATE):
        return None
    try:
        mean, covariance = (np.array(entry[key], dtype=np.float64) for key in STATE)
        kept = entry.get("discrepancy")
        discrepancy = FIRST if kept is None else PhysicsDiscrepancy.of(kept)
        return SoilBelief(belief.laws, mean, covariance, belief.history[:number], discrepancy=discrepancy)
    except (KeyError, TypeError, ValueError) as error:
        raise ParameterError(f"history, drive {number}: {error}") from error


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
    past = past_beliefs(belief)
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
    """Hold two beliefs beside each other, as the normal laws of their means and covariances.

    Sources: A. Bhattacharyya (1946), Sankhya 7, 401; S. Kullback & R. A. Leibler (1951), Ann. Math. Stat. 22, 79,
    10.1214/aoms/1177729694. Raises ParameterError for beliefs whose parameters are transformed otherwise.
    """
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
