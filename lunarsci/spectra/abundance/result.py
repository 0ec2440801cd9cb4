"""Mineral modes with intervals: one result type for every method."""

from dataclasses import dataclass
from typing import Any

from lunarsci.spectra.spectrum import FloatArray

__all__ = ["Abundance", "MineralFraction"]


@dataclass(frozen=True, slots=True)
class MineralFraction:
    """Share of one mineral: the mean of its posterior, and the shortest intervals that hold 68 and 95 % of it.

    By volume; of `nbsr` by weight, with the calibrated value and central intervals. [-]
    """

    mineral: str
    fraction: float
    low: float
    high: float
    low95: float
    high95: float


@dataclass(frozen=True, slots=True, eq=False)
class Abundance:
    """Modes of a spectrum.

    Attributes
    ----------
    id, method : of the spectrum, and how it was found.
    fractions : by mineral; they sum to 1 over the minerals that the method can see.
    correlation : (m, m) of the fractions, in their order; None where the method gives none.
    in_domain : whether the spectrum is of the kind for which the method was tested.
    status : a sentence; why not, where it is not.
    rms_ln : misfit of ln R, root mean square, None for a method that fits none. [-]
    """

    id: str
    method: str
    fractions: tuple[MineralFraction, ...]
    correlation: FloatArray | None
    in_domain: bool
    status: str
    rms_ln: float | None

    def to_dict(self) -> dict[str, Any]:
        """The key `abundance` of `lunarsci spectra fit --json`."""
        shares = {
            item.mineral: {name: getattr(item, name) for name in ("fraction", "low", "high", "low95", "high95")}
            for item in self.fractions
        }
        return {
            "method": self.method,
            "in_domain": self.in_domain,
            "status": self.status,
            "rms_ln": self.rms_ln,
            "correlation": None if self.correlation is None else self.correlation.tolist(),
        } | shares
