"""What was found wrong with telemetry, and what was done about it."""

import warnings
from dataclasses import dataclass, field

from lunarsci.errors import LunarSciWarning

__all__ = ["Finding", "Findings"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One thing that is wrong with telemetry.

    Attributes
    ----------
    kind : a word for it, such as `gap`.
    count : how many rows, positions or wheels it concerns.
    time_s : when it is first seen, None where it has no time. [s]
    what, done : what was found, and what was done about it.
    doubt : whether the result should not be trusted for it.
    """

    kind: str
    count: int
    time_s: float | None
    what: str
    done: str
    doubt: bool = False


@dataclass(slots=True)
class Findings:
    """The findings of one file, each said once as a warning when it is added."""

    file: str
    entries: list[Finding] = field(default_factory=list)

    def add(
        self, kind: str, what: str, done: str, *, count: int = 1, time_s: float | None = None, doubt: bool = False
    ) -> None:
        """Note and say one finding."""
        self.entries.append(Finding(kind=kind, count=count, time_s=time_s, what=what, done=done, doubt=doubt))
        when = "" if time_s is None else f" at time_s {time_s:.6g}"
        warnings.warn(f"{self.file}: {kind}{when}: {what}; {done}", LunarSciWarning, stacklevel=3)

    @property
    def doubt(self) -> str:
        """Why the result should not be trusted, empty if it may be."""
        return "; ".join(f"{entry.kind}: {entry.what}" for entry in self.entries if entry.doubt)
