"""Whether a spectrum absorbs enough near 1 um to tell minerals."""

from itertools import product

import numpy as np

from lunarsci.spectra.abundance.kinds import WINDOWS_NM, spectral_features
from lunarsci.spectra.spectrum import Spectrum

LEAST_DEPTH = 0.07
"""Below it shares and ratios are not told; measured: of 156 spectra of known modes (`share_errors.csv`) three have
0.052 or less, whose worst shares are off by 28 to 42 %, two of them in domain by all else. The next have 0.087 to
0.092; ordinary chondrites in domain have 0.133 at least and are right within 12 %. Norite 78235 has 0.046. [ln R]"""
SEEN_SIGMAS = 3.0
"""Standard errors of noise that an absorption must have; assumed."""
PLACES = ("level", "um0_94", "um1_06", "um1_25", "um1_52", "um1_96", "um2_30")
"""Windows of `WINDOWS_NM` between which lines are laid; the second to fourth are where minerals with iron absorb."""
ABSORBING = (1, 2, 3)


def depth_at_1um(spectrum: Spectrum) -> tuple[float, float]:
    """Deepest absorption of ln R near 1 um below a line between two windows, and its standard error by noise. [-]

    Means over windows of 100 nm and more, so that single channels and noise make no absorption; 0 where none is below.
    """
    features, noise = spectral_features(spectrum)
    chosen = [list(WINDOWS_NM).index(name) for name in PLACES]
    x = np.array([np.mean(WINDOWS_NM[name]) for name in PLACES])
    ln_r, error = features[chosen], noise[chosen]
    ln_r[0] = 0.0
    error[0] = 0.0
    found = [(0.0, 0.0)]
    for k in ABSORBING:
        for i, j in product(range(k), range(k + 1, x.size)):
            share = (x[k] - x[i]) / (x[j] - x[i])
            depth = float((1 - share) * ln_r[i] + share * ln_r[j] - ln_r[k])
            sigma = float(np.sqrt(error[k] ** 2 + ((1 - share) * error[i]) ** 2 + (share * error[j]) ** 2))
            if np.isfinite(depth):
                found.append((depth, sigma))
    return max(found)


def too_shallow(spectrum: Spectrum) -> str:
    """Why a spectrum's absorption tells no minerals; empty where it may."""
    depth, sigma = depth_at_1um(spectrum)
    if depth >= max(LEAST_DEPTH, SEEN_SIGMAS * sigma):
        return ""
    limit = f"{SEEN_SIGMAS:g} standard errors are {100 * SEEN_SIGMAS * sigma:.0f} %"
    if depth < LEAST_DEPTH:
        limit = f"measured shares were wrong below {100 * LEAST_DEPTH:.0f} %"
    return f"no absorption near 1 um deep enough to tell minerals ({100 * depth:.1f} %; {limit})"
