"""What is believed of a soil: a normal law of its transformed parameters, kept between drives as a file.

Whether a soil that was fitted to wheel states may be trusted, and the files that say so. The belief after each drive,
going back to one, and two beliefs side by side.

From the effective values that a belief holds to the ground's own: a belief of drives holds the values that the twin's
law needs to move as the rover did, good for predictions with this law. Stress integrals, ruts, or a soil that changes
move the rover alike with other values, and so the ground's own, which another instrument would measure, are known less
well.
"""

import dataclasses
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.errors import ParameterError, named
from lunarsci.io.documents import json_document
from lunarsci.io.inputs import InputFile, read_json, text
from lunarsci.ranges import SHARE, check_each, refuse
from lunarsci.regolith.physics_discrepancy import FIRST, PhysicsDiscrepancy
from lunarsci.regolith.prior import NINETY_FIVE, PARAMETERS, ROLLING, Law, default_prior, rolling_prior, values_of
from lunarsci.regolith.wheel import Wheel

FORM = "soil-belief/1"
SCHEMA = f"lunarsci/{FORM}"
"""Of the file of a belief; other versions are refused."""
OF_STATES = "lunarsci/regolith-identify/"
"""How the schema of results of wheel states begins."""
OF_DRIVE = "lunarsci/twin-update/"
"""How that of results of a drive begins, which hold the belief after it."""
ASYMMETRY = 1e-9
"""By which correlations may differ from those across the diagonal: rounding. [-]"""
FARTHEST_WIDTHS = 6.0
"""Of a mean from its laws, of which a normal law has 2e-9 of its draws beyond, and of what it leaves open: forgetting
leads back to the laws, past them by at most (0.25 x 6^2 + 1)^0.5 = 3.2 times. Assumed. [standard deviations]"""
OPEN = (*PARAMETERS, *ROLLING)
"""Parameters of a belief that holds those of its wheel, too."""
MARK = "# verdict of the fit: "
"""How the line of a table of soils that has the verdict begins."""
LISTS: dict[str, type] = {"model_error": float, "assumed": str, "loads_n": float}
"""Keys of a verdict with lists, and what their entries are."""
CLOSED, CONTACT_ANGLES = "closed", "contact angles"
"""In the name of a law: the closed form, and contact angles that are unknown."""


WHOSE = ("wheel", "gravity_m_s2", "loads_n")
"""What a verdict says of whose states were fitted, where that is known."""


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
    wheel : whose states they were, as `written_for` names it; '' where nothing says so.
    gravity_m_s2 : of these states; None where nothing says so.
    loads_n : least and largest load of these states; () where nothing says so. [N]

    Raises ParameterError for a verdict without its reason.
    """

    trusted: bool
    reason: str
    model: str
    model_error: tuple[float, float, float]
    model_error_from: str
    reduced_chi_square: float | None
    assumed: tuple[str, ...] = ()
    wheel: str = ""
    gravity_m_s2: float | None = None
    loads_n: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        faults = {
            "a verdict is trusted, or says why not": self.trusted is not (not self.reason),
            "a model error has a share for F_N, F_DP and F_L": len(self.model_error) != 3,
        }
        refuse(faults)

    def to_dict(self) -> dict[str, Any]:
        """As `verdict_of` reads it."""
        return {key: value for key, value in asdict(self).items() if key not in WHOSE or value}


def verdict_of(document: Any) -> FitVerdict | None:
    """The verdict of a parsed document, None for None. Raises ParameterError for what is none."""
    if document is None:
        return None
    with named("its verdict cannot be read", ParameterError):
        lists = {name: tuple(map(kind, document.get(name, ()))) for name, kind in LISTS.items()}
        return FitVerdict(**{**document, **lists})


def doubt(verdict: FitVerdict) -> str:
    """Why soils with this verdict are not to be driven on, for people; empty where they may be."""
    if verdict.trusted:
        return ""
    return f"the soils come from a fit that is not to be trusted: {verdict.reason}"


def other_law(name: str, verdict: FitVerdict | None, rover: str) -> str:
    """What to know where the soils of a file were inferred by another law than the twin's; empty where they were not.

    `name` is the file, `verdict` that of its fit, `rover` the rover that drives on the soils.
    """
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
    with named(source.name):
        if source.name.lower().endswith(".json"):
            document = json_document(content)
            return verdict_of(document.get("verdict") if isinstance(document, dict) else None)
        first = content.partition("\n")[0].rstrip("\r")
        return verdict_of(json_document(first.removeprefix(MARK))) if first.startswith(MARK) else None


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
    meets_ruts : of each draw of the population, whether it is of the case that wheels meet the ruts of others; None
        where that is not kept. (d,)

    Raises ParameterError for a covariance that is not symmetric and positive definite.
    """

    schema: ClassVar[str] = FORM
    laws: Mapping[str, Law]
    mean: FloatArray
    covariance: FloatArray
    history: tuple[Mapping[str, Any], ...] = field(default=())
    population: FloatArray | None = field(default=None, repr=False)
    verdict: FitVerdict | None = None
    discrepancy: PhysicsDiscrepancy = FIRST
    meets_ruts: BoolArray | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        size, draws = len(self.names), np.zeros((0, len(self.names))) if self.population is None else self.population
        shapes = self.mean.shape == (size,) and self.covariance.shape == (size, size)
        needed = f"{', '.join(PARAMETERS)}, and of none or all of {', '.join(ROLLING)}"
        refuse({f"a belief needs laws, a mean and a covariance of {needed}":
                self.names not in (PARAMETERS, OPEN) or not shapes})  # fmt: skip
        finite = all(np.isfinite(numbers).all() for numbers in (self.mean, self.covariance, draws))
        refuse({f"a belief needs finite numbers, and {size} for each draw of its population":
                draws.ndim != 2 or draws.shape[1] != size or not finite})  # fmt: skip
        refuse({"a belief keeps of each draw of its population whether it meets ruts, or of none":
                self.meets_ruts is not None and self.meets_ruts.shape != draws.shape[:1]})  # fmt: skip
        scale = np.sqrt(np.abs(np.diag(self.covariance)))
        scaled = self.covariance / np.outer(scale, scale)
        definite = (np.abs(scaled - scaled.T) <= ASYMMETRY).all() and np.linalg.eigvalsh(scaled)[0] > 0
        refuse({"a belief's covariance must be symmetric and positive definite": not definite})

    @property
    def names(self) -> tuple[str, ...]:
        """Of its parameters, in order: `PARAMETERS`, or with them `ROLLING`; p is 8 or 12."""
        return tuple(self.laws)

    @property
    def soil(self) -> "SoilBelief":
        """The belief of the eight parameters of the soil alone, without those of the wheel that taught it."""
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
        return replace(
            self, laws={**self.laws, **laws}, mean=mean, covariance=covariance, population=None, meets_ruts=None
        )

    def samples(self, transforms: FloatArray) -> dict[str, FloatArray]:
        """Parameters in their units, each (n,), from transforms (n, p)."""
        values = values_of(self.laws, transforms, self.names)
        return {name: values[:, k] for k, name in enumerate(self.names)}

    @property
    def ruts(self) -> float:
        """Probability that wheels that follow meet the ruts of others, by its last drive. [-]"""
        last = self.history[-1] if self.history else {}
        return float(last.get("ruts_probability", last.get("ruts", False)))

    @property
    def doubt(self) -> str:
        """Why predictions from it are doubtful, as was said of its drives; empty where they are not.

        The doubt of a drive stays until all was forgotten before a later one.
        """
        return self._last("doubt")

    @property
    def caution(self) -> str:
        """What was warned of when it learned and is no doubt; empty where nothing was. It stays as doubt does."""
        return self._last("caution")

    def _last(self, key: str) -> str:
        """The last text of the drives since all was forgotten, and how many more there are."""
        texts: list[str] = []
        for entry in self.history:
            texts = [] if entry.get("forgotten") == 1.0 else texts
            if entry.get(key):
                texts.append(f"{entry.get('states', 'a drive')}: {entry[key]}")
        more = f" (and {len(texts) - 1} of its other drives)" if len(texts) > 1 else ""
        return f"{texts[-1]}{more}" if texts else ""

    @property
    def sd(self) -> FloatArray:
        """Standard deviation of each parameter's transform. (p,)"""
        return np.sqrt(np.diag(self.covariance))

    @property
    def sd_ratio(self) -> dict[str, float]:
        """Standard deviation of each parameter's transform, as a share of the prior's. [-]"""
        return {name: float(sd / self.laws[name].width) for name, sd in zip(self.names, self.sd, strict=True)}

    def intervals(self) -> dict[str, tuple[float, float, float]]:
        """Median and 68 % limits of each parameter, in its unit."""
        rows = self.samples(np.stack([self.mean, self.mean - self.sd, self.mean + self.sd]))
        return {name: (float(m), float(low), float(high)) for name, (m, low, high) in rows.items()}

    @property
    def loads_n(self) -> tuple[float, ...]:
        """Least and largest load of a wheel that it was learned under, since all was forgotten; () if unknown. [N]"""
        loads = [] if self.verdict is None else [*self.verdict.loads_n]
        for entry in self.history:
            loads = [] if entry.get("forgotten") == 1.0 else loads
            loads += [] if entry.get("refused") else entry.get("loads_n", [])
        return (min(loads), max(loads)) if loads else ()

    def beyond_loads(self, load_n: float) -> float:
        """How far a load of a wheel is from those that it was learned under: 0 within, 1/2 at half or twice. [-]"""
        low, high = self.loads_n or (load_n, load_n)
        return 1.0 - min(load_n / low, high / load_n, 1.0)

    def under(self, load_n: float, seed: int = 0) -> "SoilBelief":
        """For wheels that carry a load: beyond those of its drives effective values go over to the ground's own.

        Effective values are those with which the twin's law moves as a rover did under its loads. Under others what the
        law misses is another, as for another law or instrument: `ground_moments` says what is known then.
        """
        share, size = self.beyond_loads(load_n), len(PARAMETERS)
        if share == 0.0:
            return self
        mean, sd = ground_moments(self)
        shift, extra = np.zeros((2, len(self.mean)))
        shift[:size] = share * (mean - self.mean[:size])
        extra[:size] = share * np.maximum(sd**2 - self.sd[:size] ** 2, 0.0)
        drawn = self.population
        if drawn is not None:
            noise = np.random.default_rng(seed).standard_normal(drawn.shape)
            drawn = drawn + shift + np.sqrt(extra) * noise
        return replace(self, mean=self.mean + shift, covariance=self.covariance + np.diag(extra), population=drawn)

    def draws_with_ruts(self, count: int, seed: int = 0) -> BoolArray:
        """Whether wheels meet ruts with each of `draws`: as in its population, or as probably. (count,)"""
        if self.population is not None and self.meets_ruts is not None:
            return self.meets_ruts[np.resize(np.random.default_rng(seed).permutation(len(self.population)), count)]
        order = np.random.default_rng([seed, 31]).permutation(count)
        return np.asarray(order < round(self.ruts * count))

    def draws(self, count: int, seed: int = 0) -> dict[str, FloatArray]:
        """Soils drawn from the belief, by parameter in its unit: its population, in turn, or a normal law. (count,)"""
        random = np.random.default_rng(seed)
        if self.population is not None:
            points = self.population[np.resize(random.permutation(len(self.population)), count)]
        else:
            noise = random.standard_normal((count, len(self.names)))
            points = self.mean + noise @ np.linalg.cholesky(self.covariance).T
        return self.samples(points)

    def forgotten(self, share: float) -> "SoilBelief":
        """For ground further on: the mixture of posterior and prior in which the prior has the weight `share`, 0 to 1.

        Mean and covariance are the mixture's; a population is given up. The discrepancy is forgotten
        alike. Raises ParameterError.
        """
        check_each("the share", {"forgotten": share}, {"forgotten": SHARE})
        first = first_belief(self.laws)
        off = self.mean - first.mean
        covariance = (1 - share) * self.covariance + share * first.covariance + share * (1 - share) * np.outer(off, off)
        discrepancy = self.discrepancy.forgotten(share)
        mean = self.mean - share * off
        return SoilBelief(self.laws, mean, covariance, self.history, verdict=self.verdict, discrepancy=discrepancy)

    def as_input(self, role: str) -> dict[str, Callable[[], bytes]]:
        """The file of an input of that name, as a result has it."""
        return {"belief.json": lambda: self.to_json().encode()}

    def to_dict(self) -> dict[str, Any]:
        """As `belief_of` reads it."""
        verdict = {} if self.verdict is None else {"verdict": self.verdict.to_dict()}
        return verdict | {
            "schema": SCHEMA,
            "order": list(self.names),
            "laws": {name: asdict(law) for name, law in self.laws.items()},
            "mean": self.mean.tolist(),
            "covariance": self.covariance.tolist(),
            "history": [dict(entry) for entry in self.history],
            "population": None if self.population is None else self.population.tolist(),
            "meets_ruts": None if self.meets_ruts is None else self.meets_ruts.tolist(),
            "discrepancy": self.discrepancy.to_dict(),
        }

    def to_json(self) -> str:
        """As `read_belief` reads it."""
        return json.dumps(self.to_dict(), indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n"


def first_belief(laws: Mapping[str, Law] | None = None) -> SoilBelief:
    """The prior laws, before any drive."""
    laws = default_prior() if laws is None else laws
    widths = np.array([law.width for law in laws.values()])
    return SoilBelief(laws, np.array([law.center for law in laws.values()]), np.diag(widths**2))


def belief_of_posterior(joint: Mapping[str, Any]) -> SoilBelief:
    """The normal law about the medians of what `regolith infer` calls `joint`, with its verdict.

    Raises KeyError, TypeError or ParameterError for what is no such posterior.
    """
    records, size = joint["parameters"], len(PARAMETERS)
    laws = {name: Law(**records[name]["prior"]) for name in PARAMETERS}
    sd = np.array([(1 - float(records[name]["shrinkage"])) * law.width for name, law in laws.items()])
    mean = np.array([float(law.transformed(np.array(records[name]["median"]))) for name, law in laws.items()])
    correlation = np.array(joint["correlation"])[:size, :size]
    return SoilBelief(laws, mean, correlation * np.outer(sd, sd), verdict=verdict_of(joint.get("verdict")))


def _belief_of_result(document: Mapping[str, Any]) -> SoilBelief:
    """Of the JSON of `regolith infer`, whose doubt goes with it. Raises ParameterError for that of `identify`."""
    result = document["result"]
    single = "a result of `regolith identify`, which solves single states and leaves the other parameters open"
    refuse({f"{single}; give what `lunarsci regolith infer STATES.csv -o soil.json` writes": "joint" not in result})
    belief, untrusted = belief_of_posterior(result["joint"]), document.get("provenance", {}).get("untrusted", "")
    if not untrusted or belief.verdict is None or not belief.verdict.trusted:
        return belief
    return replace(belief, verdict=replace(belief.verdict, trusted=False, reason=untrusted))


def belief_of(document: Mapping[str, Any]) -> SoilBelief:
    """The belief of a parsed document, also of a result of `regolith infer` or `twin update`.

    Raises ParameterError for what is none.
    """
    schema = str(document.get("schema", "")) if isinstance(document, Mapping) else ""
    if schema.startswith(OF_STATES):
        with named("", ParameterError):
            return _belief_of_result(document)
    if schema.startswith(OF_DRIVE):
        result = document.get("result")
        return belief_of(result.get("belief", {}) if isinstance(result, Mapping) else {})
    refuse({f"not a soil belief; its schema must be {SCHEMA}, as --save of `twin update` writes it": schema != SCHEMA})
    with named("", ParameterError):
        laws = {name: Law(**document["laws"][name]) for name in document["order"]}
        mean, covariance = (np.array(document[key], dtype=np.float64) for key in ("mean", "covariance"))
        drawn, history = document.get("population"), tuple(document.get("history", ()))
        population = None if drawn is None else np.array(drawn, dtype=np.float64)
        verdict, discrepancy = verdict_of(document.get("verdict")), PhysicsDiscrepancy.of(document.get("discrepancy"))
        met = document.get("meets_ruts")
        ruts = None if met is None or population is None else np.array(met, dtype=np.bool_)
        belief = SoilBelief(laws, mean, covariance, history, population, verdict, discrepancy, ruts)
        refuse(_unlikely(belief))
        return belief


def _unlikely(belief: SoilBelief) -> Iterator[str]:
    """Parameters that are far from both the belief's own laws and those of `priors.toml`, or much wider."""
    for k, (name, law) in enumerate(belief.laws.items()):
        usual = default_prior().get(name, law)
        median, sd = float(law.back(belief.mean[k])), float(belief.covariance[k, k]) ** 0.5
        with np.errstate(all="ignore"):
            off = min(abs(belief.mean[k] - law.center) / law.width, abs(usual.widths_off(median)))
        wide = sd / max(law.width, usual.width)
        if not (off <= FARTHEST_WIDTHS and wide <= FARTHEST_WIDTHS):
            yield (
                f"its mean of {name} is {belief.mean[k]:g}, which stands for {median:.3g}, {off:.0f} standard "
                f"deviations from its law, and {wide:.3g} times as wide as that; means and variances are of '{law.of}'"
            )


def read_belief(source: InputFile) -> SoilBelief:
    """Read a belief. Raises DataError for text that is no belief."""
    return read_json(source, "a belief", belief_of)


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
    return dataclasses.replace(after, history=(*_with_separate_lines(before, after), entry))


def _with_separate_lines(before: SoilBelief, after: SoilBelief) -> tuple[Mapping[str, Any], ...]:
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
    """The belief after the drive of an entry of its history, the `number`-th from 1; None where it was not saved."""
    if any(key not in entry for key in STATE):
        return None
    with named(f"history, drive {number}", ParameterError):
        mean, covariance = (np.array(entry[key], dtype=np.float64) for key in STATE)
        saved = entry.get("discrepancy")
        discrepancy = PhysicsDiscrepancy.of(saved and _with_lines(saved, belief))
        laws = belief.laws if len(mean) == len(belief.laws) else belief.soil.laws
        return SoilBelief(laws, mean, covariance, belief.history[:number], discrepancy=discrepancy)


def _with_lines(saved: Mapping[str, Any], belief: SoilBelief) -> Mapping[str, Any]:
    """A discrepancy of an entry with what it rested on by then: the first of the belief's lines; older files have them.

    Raises ParameterError for more of them than there are.
    """
    count, lines = saved.get("scored", ()), belief.discrepancy.scored
    if not isinstance(count, int):
        return saved
    more = f"its discrepancy rests on {count} drives, that of the belief on {len(lines)}"
    refuse({more: not 0 <= count <= len(lines)})
    return {**saved, "scored": lines[:count]}


def rolled_back(belief: SoilBelief, drives: int) -> SoilBelief:
    """The belief as it was after so many of its drives; 0 gives the priors.

    Mean and covariance come back to the digit. The population of an earlier moment is not kept in a file: what comes
    back is a normal law, but for the belief as it is. Raises ParameterError for a number out of range, and for a state
    that the file does not hold.
    """
    past = past_beliefs(belief)
    if not (0 <= drives < len(past) and (state := past[drives])):
        raise ParameterError(
            f"cannot go back to {drives} drives; the belief rests on {len(past) - 1}, and older versions kept no states"
        )
    return state


def moved_sd(belief: SoilBelief) -> list[dict[str, float] | None]:
    """How far each drive moved each parameter's transform, in standard deviations of the state before. [-]

    None for a drive before or after which the state was not kept. What was forgotten before the drive counts as moved.
    """
    past = [state and state.soil for state in past_beliefs(belief)]
    return [
        None
        if one is None or two is None
        else dict(zip(PARAMETERS, map(float, (two.mean - one.mean) / one.sd), strict=True))
        for one, two in pairwise(past)
    ]


def shared_drives(one: SoilBelief, other: SoilBelief) -> int:
    """Number of drives, from the first on, that two beliefs have in common: same states file, same values, same state.

    Both rest on them, so that they are no independent witnesses of the soil.
    """
    same = [dict(mine) == dict(theirs) for mine, theirs in zip(one.history, other.history, strict=False)]
    return [*same, False].index(False)


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
    refuse(
        f"the beliefs do not compare: {name} is transformed otherwise in the two"
        for name in PARAMETERS
        if one.laws[name].of != other.laws[name].of
    )
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
    """(1/8) d' S^-1 d + (1/2) ln(det S / sqrt(det A det B)), S = (A + B)/2, d the difference of the means. [-]

    Arguments are mean (k,) and covariance A (k, k) of one normal law, then mean and covariance B of the other.
    """
    middle, off = 0.5 * (covariance + others), other - mean
    ln_det = [float(np.linalg.slogdet(matrix)[1]) for matrix in (middle, covariance, others)]
    return float(off @ np.linalg.solve(middle, off)) / 8.0 + 0.5 * (ln_det[0] - 0.5 * (ln_det[1] + ln_det[2]))


def _kullback_leibler(true: SoilBelief, model: SoilBelief) -> float:
    """(1/2) (tr(M^-1 T) + d' M^-1 d - n + ln det M - ln det T), T and M the covariances of both. [nat]"""
    off = model.mean - true.mean
    spread = float(np.trace(np.linalg.solve(model.covariance, true.covariance)))
    shift = float(off @ np.linalg.solve(model.covariance, off))
    ln_det = float(np.linalg.slogdet(model.covariance)[1] - np.linalg.slogdet(true.covariance)[1])
    return 0.5 * (spread + shift - len(PARAMETERS) + ln_det)


def ground_moments(belief: SoilBelief) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation of the transforms of the ground's own values, each by itself. (8,), (8,)

    What the drives say, which is the belief without its prior, is widened by what other physics would change, and
    joined with the prior again; so no interval is wider than before any drive.
    """
    belief = belief.soil
    center, width = (np.array([getattr(belief.laws[name], of) for name in PARAMETERS]) for of in ("center", "width"))
    off, variance = (belief.mean - center) / width, (belief.sd / width) ** 2
    precision = np.maximum(1.0 / variance - 1.0, 1e-9)
    observed = off / variance / precision
    weight = 1.0 / (1.0 / precision + np.array([OTHER_PHYSICS[name] for name in PARAMETERS]) ** 2)
    left = 1.0 / (1.0 + weight)
    return center + width * left * weight * observed, width * np.sqrt(left)


def parameter_rows(belief: SoilBelief) -> dict[str, dict[str, float]]:
    """By parameter: effective median and 68 % interval, posterior over prior standard deviation, and the ground's own.

    Keys `median`, `low`, `high`, `left_of_prior`, and `ground_median` with limits `ground_low_68` and so on.
    """
    mean, sd = ground_moments(belief)
    widths = {"median": 0.0, "low_68": -1.0, "high_68": 1.0, "low_95": -NINETY_FIVE, "high_95": NINETY_FIVE}
    ends = values_of(belief.laws, np.stack([mean + width * sd for width in widths.values()])).T
    return {
        name: row | {f"ground_{key}": float(value) for key, value in zip(widths, column, strict=True)}
        for (name, row), column in zip(effective_rows(belief.soil).items(), ends, strict=True)
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
