"""Random noise of a spectrum, from the file or from the scatter between neighbouring channels."""

import numpy as np

from lunarsci.spectra.spectrum import FloatArray, Spectrum

__all__ = ["channel_noise", "scatter_noise"]

_NORMAL_MAD = 1.4826  # standard deviation of a normal law over its median absolute deviation
_SECOND_DIFFERENCE = np.sqrt(6.0)  # standard deviation of x[i-1] - 2 x[i] + x[i+1] over that of x


def channel_noise(spectrum: Spectrum) -> FloatArray:
    """One standard deviation of the reflectance per channel, shape (n,). [-]

    The spectrum's own uncertainty where it has one, else `scatter_noise`. Masked channels are NaN.
    """
    if spectrum.uncertainty is not None:
        return np.where(spectrum.usable, spectrum.uncertainty, np.nan)
    noise = np.full(spectrum.wavelength_nm.shape, np.nan)
    noise[spectrum.usable] = scatter_noise(spectrum.reflectance[spectrum.usable])
    return noise


def scatter_noise(values: FloatArray, window: int = 61) -> FloatArray:
    """Noise from second differences, robustly (median absolute deviation), in a running window of channels.

    Sees only what changes from channel to channel: smoothed data come out too quiet, and structure as narrow as two
    channels counts as noise. Shape (n,), above 0 unless the data are exactly straight. [unit of `values`]

    von Neumann, Kent, Bellinson & Hart (1941), Ann. Math. Stat. 12, 153, 10.1214/aoms/1177731746, in robust form.
    """
    if values.size < 5:
        return np.full(values.shape, np.std(values))
    second = np.abs(np.diff(values, 2))
    half = (min(window, second.size) - 1) // 2
    centres = np.clip(np.arange(values.size) - 1, half, second.size - 1 - half)
    windows = np.lib.stride_tricks.sliding_window_view(second, 2 * half + 1)
    running: FloatArray = np.median(windows, axis=1)[centres - half] * _NORMAL_MAD / _SECOND_DIFFERENCE
    floor = float(np.finfo(float).eps * np.abs(values).max())
    return np.maximum(running, floor)
