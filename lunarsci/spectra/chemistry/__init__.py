"""Chemistry of pyroxene and olivine from the 1 and 2 um bands, by published regressions."""

from lunarsci.spectra.chemistry.bands import KEYS, CompositionEstimate, chemistry

__all__ = ["KEYS", "CompositionEstimate", "chemistry"]
