"""Constraints as they are written on a command line: NAME=VALUE, NAME=LOW:HIGH, NAME=FACTOR*OTHER+OFFSET, fo=70:5."""

import re
from collections.abc import Sequence

from lunarsci.errors import ParameterError
from lunarsci.spectra.mgm.model import MgmModel, unit_of

__all__ = ["constrained", "parse_compositions"]

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_TIE = re.compile(rf"(?:({_NUMBER})\*)?([a-z]\w*)([-+](?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)?")


def constrained(
    model: MgmModel, *, fixed: Sequence[str] = (), bounds: Sequence[str] = (), ties: Sequence[str] = ()
) -> MgmModel:
    """The model with parameters fixed, bounded or tied, in the units of their names.

    `fixed` holds `NAME` (at the prior's mean) or `NAME=VALUE`, `bounds` `NAME=LOW:HIGH`, `ties` `NAME=OTHER`,
    `NAME=FACTOR*OTHER` or either with `+OFFSET`. Raises ParameterError for anything else and for unknown names.
    """
    for text in fixed:
        name, _, value = (part.strip() for part in text.partition("="))
        at = _number(value, text) if value else float(model.prior[model.index(name)]) * unit_of(name)
        model = model.bounded(name, at, at)
    for text in bounds:
        name, _, span = (part.strip() for part in text.partition("="))
        low, colon, high = span.partition(":")
        if not colon:
            raise ParameterError(f"bound '{text}': write NAME=LOW:HIGH, such as opx_1_center_nm=900:940")
        model = model.bounded(name, _number(low, text), _number(high, text))
    for text in ties:
        name, _, rule = text.replace(" ", "").partition("=")
        found = _TIE.fullmatch(rule)
        if not found:
            raise ParameterError(
                f"tie '{text}': write NAME=FACTOR*OTHER+OFFSET, such as cpx_1_fwhm_nm=opx_1_fwhm_nm+20"
            )
        model = model.tied(name, float(found[1] or 1), found[2], float(found[3] or 0))
    return model


def parse_compositions(text: str) -> dict[str, tuple[float, float]]:
    """`fo=70:5,fs=30:10` as {"fo": (70, 5), "fs": (30, 10)}: mean and standard deviation. [mol %]

    Raises ParameterError for anything else.
    """
    found = {}
    for part in text.split(","):
        key, _, values = part.strip().partition("=")
        mean, colon, sigma = values.partition(":")
        if not colon:
            raise ParameterError(f"composition '{part}': write KEY=MEAN:ERROR in mol %, such as fo=70:5")
        found[key.strip().lower()] = (_number(mean, part), _number(sigma, part))
    return found


def _number(text: str, whole: str) -> float:
    if not re.fullmatch(_NUMBER, text.strip()):
        raise ParameterError(f"'{whole}': '{text.strip()}' is no number")
    return float(text)
