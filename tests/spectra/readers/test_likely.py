"""What is told of spectra that are likely not what they should be, and that measured ones are not told of."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.io.inputs import InputFile
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
        (SOUND, 0.0005 * SOUND, ""),
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
    told = [str(item.message) for item in caught if "scatter from channel" not in str(item.message)]
    assert [said in text for text in told] == ([True] if said else [])


@pytest.mark.parametrize(("scatter", "told"), [(0.05, True), (0.25, False)])
def test_a_channel_within_the_noise_is_none_by_itself(scatter: float, told: bool) -> None:
    """It lies 0.53 in ln R off both neighbours: far outside of quiet noise, and within the noise of loud."""
    noise = scatter * np.tile([1.0, -1.0, 0.0, 0.5, -0.5], NM.size // 5)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_batch([table(spiked(1.7) * np.exp(noise * (NM != 600)), 0.01 * SOUND)])
    assert any("single channels" in str(item.message) for item in caught) is told


@pytest.mark.parametrize(("sigma", "told"), [(0.01, False), (0.04, False), (0.07, True), (100.0, True)])
def test_errors_that_channels_cannot_have_each_for_itself_are_said(sigma: float, told: bool) -> None:
    scattered = SOUND * (1 + 0.01 * np.random.default_rng(3).standard_normal(NM.size))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_batch([table(scattered, sigma * SOUND)])
    assert ["into a column NAME_systematic_samples" in str(item.message) for item in caught] == [True] * told


WIDE = np.arange(500.0, 2400.0, 5.0)


@pytest.mark.parametrize(("step", "noise", "told"), [(0.0, 0.002, ""), (0.03, 0.002, "+3."), (-0.05, 0.002, "-")])
def test_a_step_where_detectors_meet_is_told_with_its_place(step: float, noise: float, told: str) -> None:
    """Beside two absorptions, whose sides are steeper than any continuum."""
    rng = np.random.default_rng(4)
    clean = 0.3 * np.exp(-0.5 * ((WIDE - 950) / 80) ** 2) + 0.2 * np.exp(-0.5 * ((WIDE - 1950) / 200) ** 2)
    level = np.exp(-clean) * (0.1 + 5e-5 * WIDE) * (1.0 + noise * rng.standard_normal(WIDE.size))
    stepped = np.where(WIDE > 1000, (1.0 + step) * level, level)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        batch = read_batch([(WIDE, np.vstack([level, stepped]))])
    assert len(batch.spectra) == 2
    texts = [str(item.message) for item in caught]
    assert len(texts) == bool(told)
    for text in texts:
        assert "with a step between two channels" in text and "at 1002 nm" in text and f"by {told}" in text


@pytest.mark.parametrize("missing", [0, 1])
@pytest.mark.parametrize("value", [0.1, 0.3, 0.7])
def test_a_constant_spectrum_is_refused(value: float, missing: int) -> None:
    values = np.full(NM.size, value)
    values[:missing] = np.nan
    with pytest.raises(DataError, match=r"rock\.csv: the same value in all channels"):
        read_batch([table(values, 0.01 * SOUND)])


def test_of_measured_spectra_one_ratio_is_told(reference_data: Path) -> None:
    """A column of a table is scaled to 1 at one wavelength, and no reflectance."""
    count, told = 0, []
    for path in sorted((reference_data / "spectra").rglob("*.csv")):
        if path.stem in ("manifest", "chemistry", "m3_solar_spec"):
            continue
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", LunarSciWarning)
            count += len(list(read_batch(str(path)).spectra))
        told += [str(item.message) for item in caught if "spectra w" in str(item.message)]
    smooth = [text for text in told if "scatter from channel" in text]
    assert [("relab_avg.csv" in text, "sub8.csv" in text) for text in smooth] == [(False, True), (True, False)]
    assert count > 500 and len(told) == 3 and "first 'scaled'" in next(text for text in told if text not in smooth)
