"""Rocks from the JSON results of `lunarsci spectra fit` and `lunarsci spectra bands`."""

import json
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from lunarsci import inputs
from lunarsci.errors import DataError, ParameterError
from lunarsci.inputs import InputFile
from lunarsci.spectra.origin.composition import BANDS, MINERALS, Composition, Value
from lunarsci.spectra.origin.match import Rock

__all__ = ["joined", "read_rocks"]

FIT, BANDS_SCHEMA = "lunarsci/spectra-fit/", "lunarsci/spectra-bands/"
LARGEST_RATIO_SIGMA = 1.0


def read_rocks(source: InputFile) -> list[Rock]:
    """The rocks of a result: modes from its `abundance`, else pyroxenes from NBSR at 2 um; band centres with errors.

    Errors from the data, the calibration that channels share and the choice of the continuum are added in squares.
    Spectra without a result are left out. Raises DataError for another kind of file, or one without a usable rock.
    """
    document = _document(source)
    schema = str(document.get("schema", ""))
    if not schema.startswith((FIT, BANDS_SCHEMA)):
        raise DataError(
            f"{source.name}: schema is '{schema}'; give what `lunarsci spectra fit --json` or `bands --json` wrote"
        )
    records = _records(document, source.name)
    read = _from_fit if schema.startswith(FIT) else _from_bands
    rocks = []
    for number, record in enumerate(records):
        try:
            rock = read(record, str(record.get("id") or f"{source.stem}-{number}"))
        except (ParameterError, TypeError, ValueError, KeyError, AttributeError) as error:
            raise DataError(f"{source.name}: spectrum {number}: {error}; was the file edited?") from error
        rocks += [rock] if rock else []
    if not rocks:
        raise DataError(f"{source.name}: no spectrum has modes, an NBSR or band centres; look at their `status`")
    return rocks


def _document(source: InputFile) -> Mapping[str, Any]:
    try:
        document = json.loads(inputs.text(source))
    except (json.JSONDecodeError, RecursionError) as error:
        raise DataError(
            f"{source.name}: is no JSON ({error}); give the output of `lunarsci spectra fit --json`"
        ) from error
    if not isinstance(document, dict):
        raise DataError(f"{source.name}: is no result of lunarsci; give the output of `lunarsci spectra fit --json`")
    return document


def _records(document: Mapping[str, Any], file: str) -> list[Mapping[str, Any]]:
    result = document.get("result")
    records = result.get("spectra") if isinstance(result, dict) else None
    if not isinstance(records, list) or not all(isinstance(record, dict) for record in records):
        raise DataError(f"{file}: has no result.spectra; was the file cut or edited?")
    return records


def _from_fit(record: Mapping[str, Any], name: str) -> Rock | None:
    abundance = record.get("abundance")
    if abundance:
        given = {mineral: abundance.get(mineral) or {} for mineral in MINERALS}
        modes = {mineral: _interval(item) for mineral, item in given.items() if item.get("fraction") is not None}
        doubt = ["its abundances are outside the domain of their method"] if abundance.get("in_domain") is False else []
        return Rock(name, Composition(modes), ("modes are those of `abundance`", *doubt)) if len(modes) > 1 else None
    ratio = (record.get("nbsr") or {}).get("um2")
    if not ratio or ratio.get("opx") is None:
        return None
    opx = float(ratio["opx"])
    sigma = _combined(ratio, ("sigma", "calibration", "continuum"), "NBSR")
    sigma = min(sigma, LARGEST_RATIO_SIGMA)
    modes = {"orthopyroxene": (opx, sigma), "clinopyroxene": (1 - opx, sigma)}
    opposite = np.array([[1.0, -1.0], [-1.0, 1.0]])
    return Rock(name, Composition(modes, {}, opposite), ("OPX : CPX is NBSR at 2 µm as it stands, uncalibrated",))


def _interval(item: Mapping[str, Any]) -> Value:
    """Fraction and half its 68 % interval."""
    sigma = (float(item["high"]) - float(item["low"])) / 2
    return float(item["fraction"]), sigma


def _from_bands(record: Mapping[str, Any], name: str) -> Rock | None:
    bands = {}
    for key in BANDS:
        stem = key.removesuffix("_nm")
        if record.get(key) is not None and record.get(f"{stem}_sigma_nm") is not None:
            parts = (f"{stem}_sigma_nm", f"{stem}_systematic_nm", f"{stem}_calibration_nm")
            bands[key] = (float(record[key]), _combined(record, parts, key))
    return Rock(name, Composition({}, bands)) if bands else None


def _combined(record: Mapping[str, Any], keys: Iterable[str], what: str) -> float:
    sigma = math.sqrt(sum(float(record[key]) ** 2 for key in keys if record.get(key) is not None))
    if not (math.isfinite(sigma) and sigma > 0):
        raise ParameterError(f"{what} has no error above 0")
    return sigma


def joined(rocks: Iterable[Rock]) -> list[Rock]:
    """Rocks of the same id as one: modes of one result, band centres of the other.

    Raises DataError where two results give modes, or two give the same band centre, for one id.
    """
    found: dict[str, Rock] = {}
    for rock in rocks:
        before = found.get(rock.id)
        found[rock.id] = _merged(before, rock) if before else rock
    return list(found.values())


def _merged(one: Rock, other: Rock) -> Rock:
    a, b = one.composition, other.composition
    if (a.modes and b.modes) or set(a.bands) & set(b.bands):
        raise DataError(f"{one.id}: is in the inputs twice; give each rock once, or let ids differ")
    modes = a if a.modes else b
    both = Composition(modes.modes, {**a.bands, **b.bands}, modes.correlation)
    return Rock(one.id, both, (*one.remarks, *other.remarks))
