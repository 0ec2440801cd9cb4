"""Chemistry of pyroxene and olivine from the 1 and 2 um bands, by published regressions."""

from lunarsci.spectra.chemistry.bands import KEYS, chemistry
from lunarsci.spectra.chemistry.estimate import Estimate

__all__ = ["KEYS", "Estimate", "chemistry"]
