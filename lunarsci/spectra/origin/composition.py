"""What a rock or a crater's ejecta are made of: shares of minerals, band centres, and their errors.

Rocks from the JSON results of `lunarsci spectra fit` and `lunarsci spectra bands`.
"""

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, TypeVar

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError, RequestError
from lunarsci.io import inputs
from lunarsci.io.documents import json_document
from lunarsci.io.inputs import InputFile
from lunarsci.io.tables import table_rows
from lunarsci.minerals import WEIGHED, WITH_BANDS, WORDS
from lunarsci.ranges import NOT_NEGATIVE, POSITIVE, SHARE, check_range
from lunarsci.spectra.rows import number

BANDS = {"bc1000_nm": "[700, 1300]", "bc2000_nm": "[1500, 2600]"}
"""Band centres, and the range outside which a value is no such centre; assumed. [nm]"""
LARGEST_SUM = 1.1
"""Modes that add up to more are in the wrong unit or wrong: published ones of 102 % exist. Assumed."""
SMALLEST_SIGMA = 1e-4
"""Standard deviation of a mode is taken as at least this, that a covariance can be inverted."""

Value = tuple[float, float]
"""A value and its standard deviation."""


@dataclass(frozen=True, slots=True)
class Composition:
    """Modes and band centres, each as (value, standard deviation).

    Attributes
    ----------
    modes : fraction of some of `WITH_BANDS`, 0 to 1; by volume or weight, only their shares count.
    bands : some of `bc1000_nm` and `bc2000_nm`. [nm]
    correlation : of the modes in their order, (n, n); independent where None.

    Raises ParameterError for unknown names, values or errors out of range, modes whose sum is above 1.1 or 0.
    """

    modes: Mapping[str, Value] = field(default_factory=dict)
    bands: Mapping[str, Value] = field(default_factory=dict)
    correlation: FloatArray | None = None

    def __post_init__(self) -> None:
        for given, ranges in ((self.modes, dict.fromkeys(WITH_BANDS, SHARE)), (self.bands, BANDS)):
            for name, (value, sigma) in given.items():
                if name not in ranges:
                    raise ParameterError(f"'{name}' is no mineral or band here; there are {', '.join(ranges)}")
                check_range(name, value, ranges[name])
                check_range(f"error of {name}", sigma, POSITIVE if ranges is BANDS else SHARE)
        if self.modes:
            check_range("sum of the modes", sum(value for value, _ in self.modes.values()), f"(0, {LARGEST_SUM}]")
        if len(self.modes) == 1:
            raise ParameterError(f"{next(iter(self.modes))} alone has no share; give two minerals or none")

    @property
    def comparable(self) -> bool:
        """Whether there is anything to compare."""
        return bool(self.modes or self.bands)

    def shares(self, minerals: Sequence[str]) -> tuple[FloatArray, FloatArray]:
        """Mean (n,) and covariance (n, n) of the shares of these minerals, which add up to 1."""
        values = np.array([self.modes[name][0] for name in minerals])
        sigmas = np.array([max(self.modes[name][1], SMALLEST_SIGMA) for name in minerals])
        order = [list(self.modes).index(name) for name in minerals]
        correlation = np.eye(len(order)) if self.correlation is None else self.correlation[np.ix_(order, order)]
        return closed(values, correlation * np.outer(sigmas, sigmas))


def closed(values: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Values (..., n) divided by their sum, and covariance to first order: J C J', J = (1 - p 1') / sum. (..., n, n)

    Raises ParameterError where a sum is 0.
    """
    total = values.sum(axis=-1)
    if (total <= 0).any():
        raise ParameterError("the minerals to be compared are all absent; there is nothing to compare")
    share = values / total[..., None]
    jacobian = (np.eye(values.shape[-1]) - share[..., :, None]) / total[..., None, None]
    return share, jacobian @ covariance @ np.swapaxes(jacobian, -1, -2)


@dataclass(frozen=True, slots=True)
class Rock:
    """A rock: its name, what is known of its composition, and remarks on how that was read.

    `tables` are those of the package that its errors come from; `untested` is whether shares of its kind were tested on
    no rocks of known modes.
    """

    id: str
    composition: Composition
    remarks: tuple[str, ...] = ()
    tables: tuple[str, ...] = ()
    untested: bool = False


FITS = ("lunarsci/spectra-fit/", "lunarsci/spectra-unmix/")
BANDS_SCHEMA = "lunarsci/spectra-bands/"


def read_rocks(source: InputFile) -> list[Rock]:
    """The rocks of a result: modes from its `abundance`, else pyroxenes from NBSR at 2 um; band centres with errors.

    Errors from the data, the calibration that channels share and the choice of the continuum are added in squares.
    Of a spectrum that has none of them nothing is known, and a remark says why. Raises DataError for another kind of
    file, or one without a spectrum.
    """
    schema, records = _records(source)
    read = _from_fit if schema.startswith(FITS) else _from_bands
    rocks = []
    for index, record in enumerate(records):
        try:
            rocks.append(read(record, str(record.get("id") or f"{source.stem}-{index}")))
        except (ParameterError, TypeError, ValueError, KeyError, AttributeError) as error:
            raise DataError(f"{source.name}: spectrum {index}: {error}; was the file edited?") from error
    if not rocks:
        raise DataError(f"{source.name}: has no spectrum; {MAKE_SHARES}")
    return rocks


MAKE_SHARES = "make shares by `lunarsci spectra unmix FILE -o shares.json`"


def _unknown(name: str, why: str) -> Rock:
    return Rock(name, Composition(), (why,))


def _records(source: InputFile) -> tuple[str, Sequence[Mapping[str, Any]]]:
    """Schema and spectra of a result."""
    try:
        document = json_document(inputs.text(source))
    except json.JSONDecodeError as error:
        raise DataError(f"{source.name}: is no JSON ({error}); give what `spectra fit --json` wrote") from error
    result = document if isinstance(document, dict) else {}
    schema, content = str(result.get("schema", "")), result.get("result")
    records = content.get("spectra") if isinstance(content, dict) else None
    if not schema.startswith((*FITS, BANDS_SCHEMA)) or not isinstance(records, list):
        raise DataError(
            f"{source.name}: schema is '{schema}', or it has no result.spectra; give what `spectra unmix`, `fit` or "
            "`bands` wrote with --json, whole"
        )
    return schema, records


def _from_fit(record: Mapping[str, Any], name: str) -> Rock:
    abundance = record.get("abundance")
    if abundance:
        return _from_shares(abundance, str((record.get("kind") or {}).get("name")), name)
    ratio = (record.get("nbsr") or {}).get("um2")
    if not ratio or ratio.get("opx") is None:
        return _unknown(name, f"{_without_ratio(record)}; {MAKE_SHARES}")
    opx = float(ratio["opx"])
    sigma = _combined(ratio, ("sigma", "calibration", "continuum"), "NBSR")
    sigma = min(sigma, 1.0)  # the most that a fraction may have
    modes = {"orthopyroxene": (opx, sigma), "clinopyroxene": (1 - opx, sigma)}
    opposite = np.array([[1.0, -1.0], [-1.0, 1.0]])
    return Rock(name, Composition(modes, {}, opposite), ("OPX : CPX is NBSR at 2 µm as it stands, uncalibrated",))


def _without_ratio(record: Mapping[str, Any]) -> str:
    """Why a fit has no ratio of pyroxenes at 2 um."""
    if not (bands := record.get("bands")):
        return f"there is no fit of it: {record.get('status') or 'no reason given'}"
    fitted = {band.get("mineral") for band in bands if band.get("region") == "um2"}
    if {"orthopyroxene", "clinopyroxene"} <= fitted:
        return "its bands leave the ratio of pyroxenes at 2 µm (NBSR) open"
    return f"it was fitted without bands of both pyroxenes at 2 µm ({record.get('assemblage')})"


def _from_shares(abundance: Mapping[str, Any], kind: str, name: str) -> Rock:
    """Shares and their standard deviations, by the intervals that `spectra unmix` calibrates.

    One that is not determined counts with the middle and half the width of its interval; where none is, nothing is
    known. Out of the domain errors are at least those that were measured of the kind.
    """
    if (prior := abundance.get("prior")) == "lunar-rocks":
        text = (
            f"its shares hold the prior {prior}, which is no evidence of a crater, and do not count; unmix without it"
        )
        return _unknown(name, text)
    given = {mineral: abundance.get(mineral) or {} for mineral in WITH_BANDS}
    modes = {mineral: _interval(item) for mineral, item in given.items() if item.get("low") is not None}
    determined = [mineral for mineral in modes if given[mineral].get("fraction") is not None]
    remarks: list[str] = ["its shares are those of `abundance` in the JSON of `spectra unmix` or `spectra fit`"]
    tables: tuple[str, ...] = ()
    if modes and not determined:
        return _unknown(name, f"its shares decide nothing: {abundance.get('status', 'not determined')}")
    if len(modes) < 2:
        return _unknown(name, "it has shares of fewer than two minerals")
    if wide := [mineral for mineral in modes if mineral not in determined]:
        remarks.append(f"not determined, known by their intervals alone: {', '.join(wide)}")
    untested = abundance.get("in_domain") is False
    if untested:
        remarks.append("its shares are out of domain")
        if measured_errors(kind):
            modes, text = widened(modes, kind)
            remarks, tables = [*remarks, text], (ERRORS,)
    return Rock(name, Composition(_scaled(modes)), tuple(remarks), tables, untested)


def _interval(item: Mapping[str, Any]) -> Value:
    """Fraction, or the middle of its 68 % interval; half of that, or of the way to the farther end of the 95 % one."""
    low, high = float(item["low"]), float(item["high"])
    value = (low + high) / 2 if item.get("fraction") is None else float(item["fraction"])
    far = max(float(item.get("high95", high)) - value, value - float(item.get("low95", low)))
    return value, max((high - low) / 2, far / 2)


def _scaled(modes: Mapping[str, Value]) -> dict[str, Value]:
    """Divided by their sum where that is more than modes may have, as middles of wide intervals are."""
    total = sum(value for value, _ in modes.values())
    return {m: (v / total, s) for m, (v, s) in modes.items()} if total > LARGEST_SUM else dict(modes)


ERRORS = "share_errors.csv"


@cache
def measured_errors(kind: str) -> Mapping[str, float]:
    """Root mean square errors of `spectra unmix` by mineral, of a kind of target or class of rocks; empty without any.

    Each sample series counts the same, and was left out of what judged it. [-]
    """
    squares: dict[str, dict[str, list[float]]] = {}
    for row in table_rows(ERRORS):
        for mineral in WEIGHED:
            if row["class"] == kind and row[f"error_{mineral}"]:
                of_suite = squares.setdefault(mineral, {}).setdefault(row["suite"], [])
                of_suite.append(float(row[f"error_{mineral}"]) ** 2)
    return {
        mineral: math.sqrt(np.mean([np.mean(values) for values in suites.values()]))
        for mineral, suites in squares.items()
    }


def widened(modes: Mapping[str, Value], kind: str) -> tuple[dict[str, Value], str]:
    """Modes with errors no smaller than those measured of a kind, and a remark that says so."""
    errors = measured_errors(kind)
    wide = {mineral: (value, max(sigma, errors.get(mineral, 0.0))) for mineral, (value, sigma) in modes.items()}
    least = ", ".join(f"{mineral} {errors[mineral]:.2f}" for mineral in modes if mineral in errors)
    return wide, f"errors at least those measured of unmixed spectra of {kind}: {least}"


def _from_bands(record: Mapping[str, Any], name: str) -> Rock:
    bands = {}
    for key in BANDS:
        stem = key.removesuffix("_nm")
        if record.get(key) is not None and record.get(f"{stem}_sigma_nm") is not None:
            parts = (f"{stem}_sigma_nm", f"{stem}_systematic_nm", f"{stem}_calibration_nm")
            bands[key] = (float(record[key]), _combined(record, parts, key))
    return Rock(name, Composition({}, bands)) if bands else _unknown(name, "it has no band centre with an error")


def _combined(record: Mapping[str, Any], keys: Iterable[str], what: str) -> float:
    parts = [float(record[key]) for key in keys if record.get(key) is not None]
    for part in parts:
        check_range(f"error of {what}", part, NOT_NEGATIVE)
    check_range(f"error of {what}", sigma := math.hypot(*parts), POSITIVE)
    return sigma


def joined(rocks: Iterable[Rock]) -> list[Rock]:
    """Rocks of the same id as one: modes of one result, band centres of the other.

    Raises DataError where two results give modes, or two give the same band centre, for one id.
    """
    by_id: dict[str, Rock] = {}
    for rock in rocks:
        before = by_id.get(rock.id)
        by_id[rock.id] = _merged(before, rock) if before else rock
    return list(by_id.values())


def _merged(one: Rock, other: Rock) -> Rock:
    a, b = one.composition, other.composition
    if (a.modes and b.modes) or set(a.bands) & set(b.bands):
        names = "give each rock once, or let ids differ; in Python a Series or a column names its spectrum"
        raise DataError(f"{one.id}: is in the inputs twice; {names}")
    modes = a if a.modes else b
    both = Composition(modes.modes, {**a.bands, **b.bands}, modes.correlation)
    return Rock(one.id, both, (*one.remarks, *other.remarks), (*one.tables, *other.tables))


BAND_NAMES = {"bc1000": "bc1000_nm", "bc2000": "bc2000_nm", "bc1000_nm": "bc1000_nm", "bc2000_nm": "bc2000_nm"}


def stated_composition(
    modes: str | None, bands: str | None, kind: str | None = None
) -> tuple[Composition, tuple[str, ...]]:
    """A composition from texts, `ol=0.2:0.05,opx=0.5:0.1` and `bc1000=930:5`: values and errors by name, and remarks.

    Errors of modes are as quoted, with a kind at least those measured of it.

    Raises RequestError for another text, ParameterError as `Composition` does.
    """
    shares = _pairs(modes, "modes", {word: name for word, name in WORDS.items() if name in WITH_BANDS})
    shares, remark = widened(shares, kind) if kind else (shares, "")
    return Composition(shares, _pairs(bands, "bands", BAND_NAMES)), (remark,) if remark else ()


Stated = TypeVar("Stated")


def stated_numbers(
    option: str, text: str, form: str, make: Callable[..., Stated], counts: tuple[int, ...] = (2,)
) -> Stated:
    """What is made of the numbers of an option, which commas or colons part, as `form` has it.

    Raises RequestError for another text, and where `make` raises ParameterError.
    """
    values = [number(part.strip()) for part in text.split("," if "," in form else ":")]
    finite = [value for value in values if value is not None and math.isfinite(value)]
    try:
        if len(finite) == len(values) and len(values) in counts:
            return make(*finite)
        why = f"give {form} in numbers"
    except ParameterError as error:
        why = str(error)
    raise RequestError(f"`{option}` {text}: {why}")


def _pairs(text: str | None, option: str, names: dict[str, str]) -> dict[str, Value]:
    """`NAME=VALUE:ERROR,…` by full name."""
    pairs: dict[str, Value] = {}
    for part in text.split(",") if text else []:
        key, equals, numbers = part.partition("=")
        name = names.get(key.strip().lower())
        if not (equals and name) or name in pairs:
            listed = ", ".join(dict.fromkeys(names.values()))
            raise RequestError(f"`{option}` '{part}': give NAME=VALUE:ERROR, each once, with a NAME of {listed}")
        pairs[name] = stated_numbers(option, numbers, f"{key}=VALUE:ERROR", lambda value, sigma: (value, sigma))
    return pairs
