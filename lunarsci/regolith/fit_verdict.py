"""Whether a soil that was fitted to wheel states may be trusted, and the files that say so."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from lunarsci.errors import DataError, ParameterError
from lunarsci.inputs import InputFile, text

__all__ = ["FitVerdict", "doubt", "read_verdict", "verdict_line", "verdict_of"]

MARK = "# verdict of the fit: "


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


def verdict_line(verdict: FitVerdict) -> str:
    """The first line of a table of soils, a comment to other programs."""
    return MARK + json.dumps(verdict.to_dict(), sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n"


def read_verdict(source: InputFile) -> FitVerdict | None:
    """The verdict that a table of soils or a belief carries, None where it carries none. Raises DataError."""
    content = text(source)
    try:
        if source.name.lower().endswith(".json"):
            document = json.loads(content)
            return verdict_of(document.get("verdict") if isinstance(document, dict) else None)
        first = content.partition("\n")[0].rstrip("\r")
        return verdict_of(json.loads(first.removeprefix(MARK))) if first.startswith(MARK) else None
    except (json.JSONDecodeError, ParameterError) as error:
        raise DataError(f"{source.name}: {error}") from error
