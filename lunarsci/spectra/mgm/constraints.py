"""Constraints as they are written on a command line: NAME=VALUE, NAME=LOW:HIGH, NAME=FACTOR*OTHER+OFFSET, fo=70:5."""

import re
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from lunarsci.errors import ParameterError
from lunarsci.spectra.mgm.model import MgmModel, unit_of

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
LARGEST = 1e6
SLACK = 1e-6
"""By which the sides of a tie may miss each other, in the units of names: rounding."""
_TIE = re.compile(rf"(?:({_NUMBER})\*)?([a-z]\w*)([-+](?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)?")


def constrained(
    model: MgmModel, *, fixed: Sequence[str] = (), bounds: Sequence[str] = (), ties: Sequence[str] = ()
) -> MgmModel:
    """The model with parameters fixed, bounded or tied, in the units of their names.

    `fixed` holds `NAME` (at the prior's mean) or `NAME=VALUE`, `bounds` `NAME=LOW:HIGH`, `ties` `NAME=OTHER`,
    `NAME=FACTOR*OTHER` or either with `+OFFSET`. Raises ParameterError for anything else, for unknown names, for a
    parameter that is constrained twice, and for ties in a circle or that no values within the bounds obey.
    """
    _refuse_twice([text.partition("=")[0].strip() for text in (*fixed, *bounds, *ties)])
    for text in fixed:
        name, equals, value = (part.strip() for part in text.partition("="))
        at = _number(value, text) if equals else _prior_mean(model, name)
        model = model.bounded(name, at, at)
    for text in bounds:
        name, _, span = (part.strip() for part in text.partition("="))
        low, colon, high = span.partition(":")
        if not colon:
            raise ParameterError(f"bound '{text}': write NAME=LOW:HIGH, such as opx_1_center_nm=900:940")
        model = model.bounded(name, _number(low, text), _number(high, text))
    others: dict[str, str] = {}
    for text in ties:
        name, factor, other, offset = _tie(text)
        if name != other and name in _followed(other, others):
            raise ParameterError(f"tie '{text}' closes a circle: {other} follows {name} already")
        others[name] = other
        _refuse_empty(model, text, name, factor, other, offset)
        model = model.tied(name, factor, other, offset)
    return model


def _refuse_twice(names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ParameterError(f"{name} is constrained {names.count(name)} times; leave one of `fix`, `bound`, `tie`")


def _prior_mean(model: MgmModel, name: str) -> float:
    if model.index(name) < model.degrees:
        raise ParameterError(f"`fix` {name}: a continuum coefficient has no usual value; write {name}=VALUE")
    return float(model.prior[model.index(name)]) * unit_of(name)


def _tie(text: str) -> tuple[str, float, str, float]:
    """Name, factor, other name and offset."""
    name, _, rule = text.replace(" ", "").partition("=")
    found = _TIE.fullmatch(rule)
    if not found:
        raise ParameterError(f"tie '{text}': write NAME=FACTOR*OTHER+OFFSET, such as cpx_1_fwhm_nm=opx_1_fwhm_nm+20")
    factor, offset = float(found[1] or 1), float(found[3] or 0)
    if max(abs(factor), abs(offset)) > LARGEST:
        raise ParameterError(f"tie '{text}': factor and offset beyond {LARGEST:g} describe no bands")
    return name, factor, found[2], offset


def _followed(name: str, others: Mapping[str, str]) -> Iterator[str]:
    """The parameter and all that it follows."""
    yield name
    while name in others:
        name = others[name]
        yield name


def _refuse_empty(model: MgmModel, text: str, name: str, factor: float, other: str, offset: float) -> None:
    """Refuse a tie whose two sides have no value in common within the bounds."""
    ends = np.array([[model.lower[k], model.upper[k]] for k in (model.index(name), model.index(other))])
    own, source = ends[0] * unit_of(name), ends[1] * unit_of(other)
    with np.errstate(invalid="ignore"):
        there = np.sort(np.nan_to_num(factor * source, nan=0.0) + offset)
    if max(own[0], there[0]) > min(own[1], there[1]) + SLACK:
        raise ParameterError(
            f"tie '{text}' cannot hold: {name} stays within {own[0]:g} to {own[1]:g}, its other side within "
            f"{there[0]:g} to {there[1]:g}"
        )


def parse_compositions(text: str) -> dict[str, tuple[float, float]]:
    """`fo=70:5,fs=30:10` as {"fo": (70, 5), "fs": (30, 10)}: mean and standard deviation. [mol %]

    Raises ParameterError for anything else.
    """
    found = {}
    for part in text.split(","):
        key, _, values = part.strip().partition("=")
        if key.strip().lower() in found:
            raise ParameterError(f"composition '{text}' gives {key.strip()} twice")
        mean, colon, sigma = values.partition(":")
        if not colon:
            raise ParameterError(f"composition '{part}': write KEY=MEAN:ERROR in mol %, such as fo=70:5")
        found[key.strip().lower()] = (_number(mean, part), _number(sigma, part))
    return found


def _number(text: str, whole: str) -> float:
    if not re.fullmatch(_NUMBER, text.strip()):
        raise ParameterError(f"'{whole}': '{text.strip()}' is no number")
    return float(text)
