"""What a regression says of one spectrum, and of many."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from lunarsci.arrays import BoolArray, FloatArray
from lunarsci.io.records import coded
from lunarsci.spectra.chemistry.plane import Texts


@dataclass(frozen=True, slots=True, kw_only=True)
class CompositionEstimate:
    """A quantity by one regression.

    Attributes
    ----------
    quantity : `fs`, `wo`, `en`, `fo`, `fa`; `ol_share` and `opx_share` of olivine and pyroxene together.
    unit : `mol %`, or `-` for a share.
    value, sigma : with its standard deviation: error of the band and scatter of the regression. [unit]
    in_range : whether the regression may be used here, as far as the bands can tell.
    reason : why not; empty where it may.
    domain : rocks that the regression was made for, which bands cannot tell: nobody but the user knows.
    caveat : what is not in the error.
    source : entry of `sources.toml`.
    """

    quantity: str
    unit: str
    value: float
    sigma: float
    in_range: bool
    reason: str
    domain: str
    caveat: str
    source: str

    def to_dict(self) -> dict[str, Any]:
        """The attributes by name."""
        return asdict(self)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Estimates:
    """A quantity of m spectra by one regression; as `CompositionEstimate`, with arrays (m,).

    `present` says where its bands are there; elsewhere the others mean nothing.
    """

    quantity: str
    unit: str
    present: BoolArray
    value: FloatArray
    sigma: FloatArray
    reason: Texts
    domain: Texts
    caveat: Texts
    source: Texts

    @property
    def in_range(self) -> BoolArray:
        """Whether the regression may be used."""
        return np.asarray(self.reason == "", bool)

    @property
    def first_usable(self) -> int | None:
        """The first spectrum of which it may be used, None for none."""
        rows = np.flatnonzero(self.present & self.in_range)
        return int(rows[0]) if rows.size else None

    def columns(self) -> dict[str, Any]:
        """The attributes of `CompositionEstimate` by name, as columns of records."""

        texts = {name: coded(getattr(self, name)) for name in ("reason", "domain", "caveat", "source")}
        own = {"quantity": self.quantity, "unit": self.unit, "value": self.value, "sigma": self.sigma}
        return own | {"in_range": self.in_range} | texts

    def of(self, row: int) -> CompositionEstimate:
        """That of one spectrum."""
        return CompositionEstimate(
            quantity=self.quantity,
            unit=self.unit,
            value=float(self.value[row]),
            sigma=float(self.sigma[row]),
            in_range=not self.reason[row],
            reason=self.reason[row],
            domain=self.domain[row],
            caveat=self.caveat[row],
            source=self.source[row],
        )
