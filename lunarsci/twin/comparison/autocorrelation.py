"""How many independent values there are in a series whose neighbours are alike."""

import numpy as np
import numpy.typing as npt

__all__ = ["correlation_length"]

FloatArray = npt.NDArray[np.float64]
WINDOW = 5.0
"""The sum over lags ends where it is this many correlation lengths long (Sokal 1997)."""


def correlation_length(series: FloatArray, taken: int = 0) -> float:
    """Number of neighbouring values that count as one: 1 + 2 (sum of the autocorrelation), 1 to n. [-]

    The sum ends where the lag passes five times what was summed so far: A. Sokal (1997), Monte Carlo methods in
    statistical mechanics, 10.1007/978-1-4899-0319-8_6. The series is (n,), evenly sampled, about zero: its mean is not
    taken off, so that a constant counts as one value. Where a fit of `taken` numbers was taken off, it took about
    taken/n from the autocorrelation at each lag, as the mean alone takes 1/n (M. Kendall (1954), Biometrika 41, 403,
    10.1093/biomet/41.3-4.403); this is given back, up to the lag whose correlation is within chance, 1/sqrt(n).
    """
    count = len(series)
    power = float(series @ series)
    if count < 2 or power == 0:
        return 1.0
    length = 1.0
    for lag in range(1, count):
        correlation = float(series[lag:] @ series[:-lag]) / power + taken / count
        if taken and correlation < count**-0.5:
            break
        length += 2.0 * correlation
        if lag >= WINDOW * length:
            break
    return float(np.clip(length, 1.0, count))
