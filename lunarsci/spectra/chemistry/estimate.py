"""One quantity that a band speaks for."""

from dataclasses import asdict, dataclass
from typing import Any

__all__ = ["Estimate"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
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
