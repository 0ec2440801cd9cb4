"""What is told of spectra that are likely not what they should be, and that measured ones are not told of."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.inputs import InputFile
from lunarsci.spectra.readers.batch import read_batch

NM = np.arange(500, 700, 5)
SOUND = 0.1 + 1e-4 * (NM - 500)


def table(reflectance: np.ndarray, sigma: np.ndarray) -> InputFile:
    rows = "\n".join(f"{w},{r:.6g},{s:.6g}" for w, r, s in zip(NM, reflectance, sigma, strict=True))
    return InputFile("rock.csv", f"wavelength_nm,rock,rock_sigma\n{rows}\n".encode())


def spiked(factor: float) -> np.ndarray:
    return np.where(NM == 600, factor, 1.0) * SOUND


@pytest.mark.parametrize(
    ("reflectance", "sigma", "said"),
    [
        (SOUND, 0.25 * SOUND, ""),
        (SOUND, 0.35 * SOUND, "errors above 30%"),
        (SOUND / SOUND.max(), 0.01 * SOUND, ""),
        (1.01 * SOUND / SOUND.min(), 0.01 * SOUND, "reflectance above 1"),
        (spiked(1.6), 0.01 * SOUND, ""),
        (spiked(1.7), 0.01 * SOUND, "single channels"),
        (spiked(0.5), 0.01 * SOUND, "single channels"),
    ],
)
def test_each_kind_is_told_beyond_its_limit(reflectance: np.ndarray, sigma: np.ndarray, said: str) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert len(list(read_batch([table(reflectance, sigma)]).spectra)) == 1
    assert [said in str(item.message) for item in caught] == ([True] if said else [])


def test_a_constant_spectrum_is_refused() -> None:
    with pytest.raises(DataError, match=r"rock\.csv: the same value in all channels"):
        read_batch([table(np.full(NM.size, 0.1), 0.01 * SOUND)])


def test_of_measured_spectra_one_ratio_is_told(reference_data: Path) -> None:
    """A column of a table is scaled to 1 at one wavelength, and no reflectance."""
    count, told = 0, []
    for path in sorted((reference_data / "spectra").rglob("*.csv")):
        if path.stem in ("manifest", "chemistry", "m3_solar_spec"):
            continue
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", LunarSciWarning)
            count += len(list(read_batch(str(path)).spectra))
        told += [str(item.message) for item in caught if "spectra with" in str(item.message)]
    assert count > 500 and len(told) == 1 and "first 'scaled'" in told[0]
