"""The numbers of a result, each with its error, the parts of it, and why it should not be used, if so."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from lunarsci.pages.words import measured, number, unit, words
from lunarsci.result import PRIORS_OWN, doubt_about, from_prior
from lunarsci.spectra.jobs.bands import METHODS, SHORT, regression
from lunarsci.spectra.mgm import PERCENT_OF, with_trend

PARTS = {
    "sigma": "standard error",
    "trend_sigma": "of the trend",
    "random": "random part",
    "systematic": "systematic part",
    "calibration": "calibration, shared",
    "method": "choice of method",
    "gaussian": "minimum or Gaussian",
    "continuum": "choice of continuum",
    "common_sigma": "common to all",
    "model": "of the model",
    "systematic_sigma": "systematic part",
    "low": "from",
    "high": "to",
}
"""Ends of keys that are a part of an error, and what each is."""
OF_CONTINUUM = re.compile(r"b[acd](1000|2000)(_nm)?")
"""Bands, whose systematic part is the spread over continua alone."""
VALUES = ("value", "mean", "fraction", "median")
"""Keys of a number that its object is named for."""
SAID = (
    *("notes", "remarks", "reasons", "reason", "doubt", "caution", "caveat", "status", "why_none", "refused"),
    *("must_mend", "not_compared"),
)
"""Keys whose text says what an answer does not know."""
GROUPS = ("chemistry", "compositions", "spectra", "rocks", "parameters", "joint", "abundances", "end_members", "maps")
"""Keys that add nothing to a name."""
WITHIN = {
    "opx": (0.0, 1.0),
    "cpx": (0.0, 1.0),
    "fraction": (0.0, 1.0),
    "center_nm": (0.0, 3000.0),
    "fwhm_nm": (0.0, 3000.0),
    "strength": (-5.0, 5.0),
}
"""Lowest and highest value that can be; an error as wide says that nothing is known. Assumed."""
MANY = ("spectra", "rocks", "observations", "track", "stations", "designs", "drives", "soils", "numbers", "layers")
"""Lists that may be long; of others all are taken, up to `LONGEST`."""
LONGEST = 40
REFUSED = "not to be used"


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number or a short text of a result.

    Attributes
    ----------
    of : what it is of, in words.
    name : what it is, in words, with its unit.
    text : the value with its error; `not to be used` where the command shows none.
    parts : of the error, by what each is.
    remark : why it should not be used, or read with care.
    """

    of: str
    name: str
    text: str
    parts: Mapping[str, str] = field(default_factory=dict)
    remark: str = ""

    @property
    def refused(self) -> bool:
        return self.text == REFUSED


def quantities(record: Mapping[str, Any], of: tuple[str, ...] = (), most: int | None = None) -> Iterator[Quantity]:
    """All of them, in their order; of lists of objects those of one, or the first `most`."""
    spent = _keys_of_parts(record)
    kept = next((key for key in VALUES if _is_number(record.get(key))), "")
    shared = doubt_about(record) if "in_domain" in record else ""
    alone = (bool(kept) or "prior_sigma" in record) and any(key in record for key in ("in_range", "reason", "low"))
    for key, item in record.items():
        if key in spent or key in SAID or item is None or key.endswith("_note") or (alone and key != kept):
            continue
        if isinstance(item, Mapping):
            told = {"doubt": shared} if shared and _is_number(item.get("fraction")) else {}
            yield from quantities({**item, **told}, of if key in GROUPS else (*of, key), most)
        elif isinstance(item, list):
            yield from _of_list(key, item, of, most)
        elif _is_number(item):
            yield _quantity(record, key, of)
        elif key not in ("id", "key", "quantity", "unit", "in_range", "in_domain"):
            yield Quantity(_path(of), words(key), number(item))


def _of_list(key: str, items: list[Any], of: tuple[str, ...], most: int | None) -> Iterator[Quantity]:
    plain = not any(isinstance(one, dict | list) for one in items)
    if plain and 0 < len(items) <= 4 and most is None:
        yield Quantity(_path(of), words(key), ", ".join(number(one) for one in items))
    elif all(isinstance(one, Mapping) for one in items) and (len(items) == 1 or most is not None):
        for place, one in enumerate(items[: most if key in MANY else LONGEST]):
            named = next((str(one[name]) for name in ("id", "name", "quantity", "wheel") if one.get(name)), "")
            own = named or (key if len(items) == 1 else f"{words(key)} {place + 1}")
            yield from quantities(one, (*of, own), most)


def _quantity(record: Mapping[str, Any], key: str, of: tuple[str, ...]) -> Quantity:
    named = PARTS | ({"systematic": PARTS["continuum"]} if OF_CONTINUUM.fullmatch(key) else {})
    parts = {named[part]: record[name] for part, name in _parts_of(record, key).items()}
    name, symbol, above = _named(record, key, of)
    doubt = str(record.get("doubt") or ("" if "in_domain" in record else doubt_about(record)))
    if not doubt and _is_number(record.get("prior_sigma")) and from_prior(record.get("sigma"), record["prior_sigma"]):
        doubt = PRIORS_OWN
    refused = bool(doubt)
    if not refused and record.get("domain") and isinstance(record["domain"], str):
        doubt = f"only if {record['domain']}"
    sigma = parts.get("standard error")
    if record.get("in_range") is False:
        return Quantity(_path(above), name, REFUSED, {}, doubt)
    within = WITHIN.get(key, (0.0, 100.0) if symbol == "mol %" else (-math.inf, math.inf))
    value = record[key]
    shown = measured(value, sigma, "", within) if sigma else number(value)
    if sigma and not refused and "trend_sigma" in record:
        shown = with_trend(shown, record["trend_sigma"])
    return Quantity(_path(above), name, shown, {part: number(float(own), 2) for part, own in parts.items()}, doubt)


def _named(record: Mapping[str, Any], key: str, of: tuple[str, ...]) -> tuple[str, str, tuple[str, ...]]:
    """Name with unit, the unit, and what it is of."""
    symbol = str(record.get("unit") or unit(key))
    if key not in VALUES or not of:
        return words(key), symbol, of
    last, above = of[-1], of[:-1]
    if record.get("quantity") in SHORT and any(part in last for part in METHODS):
        name = f"{SHORT[record['quantity']]} by {regression(last)}"
    elif last in PERCENT_OF:
        name, symbol = f"{PERCENT_OF[last]}, from band centres", "mol %"
    else:
        name, symbol = words(last), symbol if symbol != "-" and "[" not in words(last) else ""
    if key == "fraction":
        name = f"share of {name}"
    shown = name if not symbol or symbol == "-" else f"{name} [{symbol}]"
    return shown, symbol, above


def _path(of: Sequence[str]) -> str:
    return ", ".join(words(one).partition(" [")[0] for one in of)


def _is_number(item: Any) -> bool:
    return isinstance(item, int | float) and not isinstance(item, bool)


def _parts_of(record: Mapping[str, Any], key: str) -> dict[str, str]:
    """Keys of the parts of an error: `center_sigma_nm` and `center_nm_sigma` of `center_nm`, `sigma` of `value`."""
    stem, _, end = key.rpartition("_")
    found = {}
    for part in PARTS:
        tries = [f"{key}_{part}", *([f"{stem}_{part}_{end}"] if stem else [])]
        tries += [part] if key in (*VALUES, "opx") else []
        name = next((one for one in tries if one != key and _is_number(record.get(one))), None)
        if name is not None:
            found[part] = name
    return found


def _keys_of_parts(record: Mapping[str, Any]) -> set[str]:
    return {name for key, item in record.items() if _is_number(item) for name in _parts_of(record, key).values()}
