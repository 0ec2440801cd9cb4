"""What is believed of a soil: a normal law of its transformed parameters, kept between drives as a file.

Whether a soil that was fitted to wheel states may be trusted, and the files that say so.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.io.documents import json_document
from lunarsci.io.inputs import InputFile, read_json, text
from lunarsci.regolith.physics_discrepancy import FIRST, PhysicsDiscrepancy
from lunarsci.regolith.prior import PARAMETERS, ROLLING, Law, default_prior, rolling_prior, values_of
from lunarsci.regolith.wheel import Wheel

SCHEMA = "lunarsci/soil-belief/1"
ASYMMETRY = 1e-9
FARTHEST_WIDTHS = 6.0
"""Of a mean from its laws; a normal law has 2e-9 of its draws beyond. Assumed. [standard deviations]"""
WIDEST = 5.0
"""Drives narrow a belief and forgetting leads back to its laws, past them by at most (0.25 x 6^2 + 1)^0.5 = 3.2 times;
assumed. [standard deviations of the laws]"""
OPEN = (*PARAMETERS, *ROLLING)
"""Parameters of a belief that holds those of its wheel, too."""
MARK = "# verdict of the fit: "
CLOSED, CONTACT_ANGLES = "closed", "contact angles"
"""In the name of a law: the closed form, and contact angles that are unknown."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FitVerdict:
    """What a fit of a soil says about itself.

    Attributes
    ----------
    trusted : whether a soil of this model explains the states.
    reason : why not, in a sentence that names the columns to look at; empty where it may be trusted.
    model : name of the wheel-soil law.
    model_error : share of the load by which the law misses F_N, F_DP and F_L. [-]
    model_error_from : `residuals` or `given`.
    reduced_chi_square : of the states kept, after that error; None where there are no more forces than parameters. [-]
    assumed : sentences, what the fit had to assume.

    Raises ParameterError for a verdict without its reason.
    """

    trusted: bool
    reason: str
    model: str
    model_error: tuple[float, float, float]
    model_error_from: str
    reduced_chi_square: float | None
    assumed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.trusted == bool(self.reason):
            raise ParameterError("a verdict is trusted, or says why not")
        if len(self.model_error) != 3:
            raise ParameterError("a model error has a share for F_N, F_DP and F_L")

    def to_dict(self) -> dict[str, Any]:
        """As `verdict_of` reads it."""
        return asdict(self)


def verdict_of(document: Any) -> FitVerdict | None:
    """The verdict of a parsed document, None for None. Raises ParameterError for what is none."""
    if document is None:
        return None
    if not isinstance(document, Mapping):
        raise ParameterError("its verdict is no table")
    fields = dict(document)
    try:
        if not isinstance(fields["trusted"], bool):
            raise ParameterError("its verdict is neither true nor false")
        for name, kind in (("model_error", float), ("assumed", str)):
            fields[name] = tuple(kind(value) for value in fields.get(name, ()))
        return FitVerdict(**fields)
    except (KeyError, TypeError, ValueError) as error:
        raise ParameterError(f"its verdict cannot be read: {error}") from error


def doubt(verdict: FitVerdict) -> str:
    """Why soils with this verdict are not to be driven on, for people; empty where they may be."""
    if verdict.trusted:
        return ""
    return f"the soils come from a fit that is not to be trusted: {verdict.reason}"


def other_law(name: str, verdict: FitVerdict | None, rover: str) -> str:
    """What to know where the soils of a file were found by another law than the twin's; empty where they were not."""
    if verdict is None or verdict.model == CLOSED:
        return ""
    lost = ", whose contact angles it does not keep" if CONTACT_ANGLES in verdict.model else ""
    return (
        f"{name} was inferred by the law '{verdict.model}'{lost}; {rover} drives by the closed form with the contact "
        "angles of its file, where these soils may slip otherwise; infer by the law 'given' with this rover's wheel"
    )


def verdict_line(verdict: FitVerdict) -> str:
    """The first line of a table of soils, a comment to other programs."""
    return MARK + json.dumps(verdict.to_dict(), sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n"


def read_verdict(source: InputFile) -> FitVerdict | None:
    """The verdict that a table of soils or a belief carries, None where it carries none. Raises DataError."""
    content = text(source)
    try:
        if source.name.lower().endswith(".json"):
            document = json_document(content)
            return verdict_of(document.get("verdict") if isinstance(document, dict) else None)
        first = content.partition("\n")[0].rstrip("\r")
        return verdict_of(json_document(first.removeprefix(MARK))) if first.startswith(MARK) else None
    except (json.JSONDecodeError, ParameterError) as error:
        raise DataError(f"{source.name}: {error}") from error


@dataclass(frozen=True, slots=True, eq=False)
class SoilBelief:
    """A normal law of all eight parameters, in the transforms of the laws it began with; or with its wheel's, twelve.

    Attributes
    ----------
    laws : the prior laws, by parameter in the order of `PARAMETERS`, or with those of `ROLLING` after them; they say
        what is transformed how, and how wide the belief was before any drive.
    mean : of the transforms. (p,)
    covariance : of the transforms. (p, p)
    history : one entry for each update, oldest first: what it rests on.
    population : transforms drawn from the belief where it is not normal; mean and covariance are theirs. (d, p)
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
        size = len(self.names)
        if self.names not in (PARAMETERS, OPEN) or self.mean.shape != (size,) or self.covariance.shape != (size, size):
            told = f"{', '.join(PARAMETERS)}, and of none or all of {', '.join(ROLLING)}"
            raise ParameterError(f"a belief needs laws, a mean and a covariance of {told}")
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
    def names(self) -> tuple[str, ...]:
        """Of its parameters: those of a soil, or with them those of `ROLLING`."""
        return tuple(self.laws)

    @property
    def soil(self) -> "SoilBelief":
        """What it says of the soil alone, whatever the wheel that taught it may be."""
        size = len(PARAMETERS)
        drawn = None if self.population is None else self.population[:, :size]
        laws = {name: self.laws[name] for name in PARAMETERS}
        return replace(
            self, laws=laws, mean=self.mean[:size], covariance=self.covariance[:size, :size], population=drawn
        )

    def opened(self, wheel: Wheel) -> "SoilBelief":
        """The same with contact angles and effective radius of a wheel unknown, too, as wide as their priors.

        Of a belief that holds them it is this one. Its soil was learned with the angles of the wheel's file, so these
        are the middle of what is believed of them; a population is given up.
        """
        if self.names == OPEN:
            return self
        laws = rolling_prior(wheel)
        centers, widths = (np.array([getattr(law, what) for law in laws.values()]) for what in ("center", "width"))
        size = len(self.mean)
        covariance = np.diag(np.concatenate([np.zeros(size), widths**2]))
        covariance[:size, :size] = self.covariance
        mean = np.concatenate([self.mean, centers])
        return replace(self, laws={**self.laws, **laws}, mean=mean, covariance=covariance, population=None)

    def samples(self, transforms: FloatArray) -> dict[str, FloatArray]:
        """Parameters in their units, each (n,), from transforms (n, p)."""
        values = values_of(self.laws, transforms, self.names)
        return {name: values[:, k] for k, name in enumerate(self.names)}

    @property
    def ruts(self) -> bool:
        """Whether its values are those with which wheels that follow meet the ruts of others, as in its last drive."""
        return bool(self.history and self.history[-1].get("ruts", False))

    @property
    def doubt(self) -> str:
        """Why predictions from it are doubtful, as was said of its drives; empty where they are not.

        The doubt of a drive stays until all was forgotten before a later one.
        """
        return self._told("doubt")

    @property
    def caution(self) -> str:
        """What was warned of when it learned and is no doubt; empty where nothing was. It stays as doubt does."""
        return self._told("caution")

    def _told(self, key: str) -> str:
        """The last text of the drives since all was forgotten, and how many more there are."""
        told: list[str] = []
        for entry in self.history:
            told = [] if entry.get("forgotten") == 1.0 else told
            if entry.get(key):
                told.append(f"{entry.get('states', 'a drive')}: {entry[key]}")
        more = f" (and {len(told) - 1} of its other drives)" if len(told) > 1 else ""
        return f"{told[-1]}{more}" if told else ""

    @property
    def sd_ratio(self) -> dict[str, float]:
        """Standard deviation of each parameter's transform as a share of its prior's. [-]"""
        spread = np.sqrt(np.diag(self.covariance))
        return {name: float(sd / self.laws[name].width) for name, sd in zip(self.names, spread, strict=True)}

    def intervals(self) -> dict[str, tuple[float, float, float]]:
        """Median and 68 % limits of each parameter, in its unit."""
        spread = np.sqrt(np.diag(self.covariance))
        rows = self.samples(np.stack([self.mean, self.mean - spread, self.mean + spread]))
        return {name: (float(m), float(low), float(high)) for name, (m, low, high) in rows.items()}

    def draws(self, count: int, seed: int = 0) -> dict[str, FloatArray]:
        """Soils drawn from the belief, by parameter in its unit: its population, in turn, or a normal law. (count,)"""
        random = np.random.default_rng(seed)
        if self.population is not None:
            points = self.population[np.resize(random.permutation(len(self.population)), count)]
        else:
            noise = random.standard_normal((count, len(self.names)))
            points = self.mean + noise @ np.linalg.cholesky(self.covariance).T
        return self.samples(points)

    def inflated(self, share: float) -> "SoilBelief":
        """Prior inflation for ground further on: the belief gone `share` of the way back to the prior, 0 to 1.

        Mean and covariance are those of the mixture of both; a population is given up. The discrepancy is forgotten
        alike. Raises ParameterError.
        """
        if not 0 <= share <= 1:
            raise ParameterError(f"forgetting is {share}; give 0 (all is kept) to 1 (all is forgotten)")
        first = first_belief(self.laws)
        off = self.mean - first.mean
        covariance = (1 - share) * self.covariance + share * first.covariance + share * (1 - share) * np.outer(off, off)
        discrepancy = self.discrepancy.inflated(share)
        mean = self.mean - share * off
        return SoilBelief(self.laws, mean, covariance, self.history, verdict=self.verdict, discrepancy=discrepancy)

    def to_json(self) -> str:
        """As `read_belief` reads it."""
        document = {
            "schema": SCHEMA,
            "order": list(self.names),
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
    widths = np.array([law.width for law in laws.values()])
    return SoilBelief(laws, np.array([law.center for law in laws.values()]), np.diag(widths**2))


def belief_of(document: Mapping[str, Any]) -> SoilBelief:
    """The belief of a parsed document. Raises ParameterError for what is none."""
    if not isinstance(document, Mapping) or document.get("schema") != SCHEMA:
        raise ParameterError(f"not a soil belief; its schema must be {SCHEMA}")
    try:
        if tuple(document["order"]) not in (PARAMETERS, OPEN):
            raise ParameterError(f"its parameters are not {', '.join(PARAMETERS)}")
        laws = {name: Law(**document["laws"][name]) for name in document["order"]}
        mean, covariance = (np.array(document[key], dtype=np.float64) for key in ("mean", "covariance"))
        drawn = document.get("population")
        population = None if drawn is None else np.array(drawn, dtype=np.float64)
        verdict, kept = verdict_of(document.get("verdict")), document.get("discrepancy")
        discrepancy = FIRST if kept is None else PhysicsDiscrepancy.of(kept)
        history = tuple(document.get("history", ()))
        belief = SoilBelief(laws, mean, covariance, history, population, verdict, discrepancy)
        _check_likely(belief)
        return belief
    except KeyError as error:
        raise ParameterError(f"no {error} in it") from error
    except (TypeError, ValueError) as error:
        raise ParameterError(str(error)) from error


def _check_likely(belief: SoilBelief) -> None:
    """Raises ParameterError for a belief far from both its own laws and those of `priors.toml`, or much wider."""
    for k, (name, own) in enumerate(belief.laws.items()):
        usual = default_prior().get(name, own)
        median, sd = float(own.back(belief.mean[k])), float(belief.covariance[k, k]) ** 0.5
        width = max(own.width, usual.width)
        with np.errstate(all="ignore"):
            off = min(abs(belief.mean[k] - own.center) / own.width, abs(usual.widths_off(median)))
        if not off <= FARTHEST_WIDTHS:
            raise ParameterError(
                f"its mean of {name} is {belief.mean[k]:g}, which stands for {median:.3g}, {off:.0f} standard "
                f"deviations from its law; means are of '{own.of}', check that this one is"
            )
        if sd > WIDEST * width:
            raise ParameterError(
                f"its {name} is {sd / width:.3g} times as wide as its law; a covariance holds variances of '{own.of}'"
            )


def read_belief(source: InputFile) -> SoilBelief:
    """Read a belief. Raises DataError for text that is no belief."""
    return read_json(source, "a belief", belief_of)
