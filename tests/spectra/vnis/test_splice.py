"""The joining of the detectors: exact on smooth spectra, errors against repeated noise, the step of laboratory ones."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError
from lunarsci.spectra.vnis.channels import fixed_pattern, random_noise
from lunarsci.spectra.vnis.splice import Splice, Step, find_splice

VNIR = 450 + 5.0 * np.arange(100)
SWIR = 900 + 5.0 * np.arange(300)
JOINED = 450 + 5.0 * np.arange(390)
MODEL_ERROR = 0.0021
"""What `step.py` states for spectra that have no step, at 1377.5 nm."""
VNIR_STEPS = {632.5: (0.0015, 0.065), 757.5: (0.0030, 0.050)}
"""The same for the steps of VNIR, and what they are on Chang'E-4 spectra."""


def smooth(wavelength_nm: np.ndarray) -> np.ndarray:
    """ln R is a parabola: red, slightly curved."""
    x = (wavelength_nm - 1400) / 1000
    return np.exp(-2.3 + 0.4 * x - 0.15 * x**2)


def measured(step: float, gain: float) -> tuple[np.ndarray, np.ndarray]:
    """Both detectors' spectra of the smooth surface, where SWIR below 1377.5 nm reads 1/step, and VNIR 1/gain of it."""
    return smooth(VNIR) / gain, smooth(SWIR) / np.where(SWIR < 1377.5, step, 1.0)


def noise_free(step: float, gain: float, relative: float = 0.01) -> Splice:
    vnir, swir = measured(step, gain)
    return find_splice(vnir, swir, relative * vnir, relative * swir)


@pytest.mark.parametrize("step", [0.8, 0.97, 1.0, 1.05, 1.3])
@pytest.mark.parametrize("gain", [0.5, 0.93, 1.0, 1.12, 2.0])
def test_step_and_gain_come_back_exactly(step: float, gain: float) -> None:
    found = noise_free(step, gain)
    assert found.step.factor == pytest.approx(step, rel=1e-12)
    assert found.gain == pytest.approx(gain, rel=1e-12)
    assert found.overlap_rms == pytest.approx(0, abs=1e-12)
    assert found.join(*measured(step, gain)) == pytest.approx(smooth(JOINED), rel=1e-12)


def test_the_level_is_that_of_the_last_sub_band() -> None:
    vnir, swir = measured(1.1, 0.9)
    joined = find_splice(vnir, swir, vnir / 100, swir / 100).join(vnir, swir)
    assert joined.shape == (390,)
    assert np.array_equal(joined[JOINED >= 1380], swir[SWIR >= 1380])
    assert joined[JOINED == 1375][0] == pytest.approx(1.1 * swir[SWIR == 1375][0])
    assert joined[JOINED == 900][0] == pytest.approx(1.1 * swir[0])
    assert joined[JOINED == 895][0] == pytest.approx(0.9 * vnir[VNIR == 895][0])


def test_a_scaled_pair_is_joined_in_the_same_way() -> None:
    vnir, swir = measured(1.04, 0.95)
    found = find_splice(3 * vnir, 3 * swir, 0.03 * vnir, 0.03 * swir)
    one = find_splice(vnir, swir, 0.01 * vnir, 0.01 * swir)
    assert (found.gain, found.gain_sigma) == pytest.approx((one.gain, one.gain_sigma), rel=1e-12)
    assert (found.step.factor, found.step.sigma) == pytest.approx((one.step.factor, one.step.sigma), rel=1e-12)


def test_missing_channels_are_left_out() -> None:
    vnir, swir = measured(1.05, 0.9)
    swir[[2, 3, 90, 94, 97, 99]] = np.nan
    vnir[[5, 95]] = np.nan
    found = find_splice(vnir, swir, vnir / 100, swir / 100)
    assert (found.step.factor, found.gain) == pytest.approx((1.05, 0.9), rel=1e-12)
    joined = found.join(vnir, swir)
    assert np.flatnonzero(np.isnan(joined)).tolist() == [5, 92, 93, 180, 184, 187, 189]


def test_channels_that_are_not_above_0_are_left_out() -> None:
    vnir, swir = measured(1.05, 0.9)
    sigma = swir / 100
    swir[[1, 96]] = -0.01
    vnir[92] = 0.0
    found = find_splice(vnir, swir, np.full(100, 0.001), sigma)
    assert (found.step.factor, found.gain) == pytest.approx((1.05, 0.9), rel=1e-12)


def test_errors_are_those_of_repeated_noise() -> None:
    """8000 draws of the instrument's noise; a standard deviation over as many is known to 0.8 %.

    The error of the gain is enlarged where the detectors differ by more than their noise, by the root of chi2 / 9 where
    this is above 1. That happens by chance too, and makes the error 8 % larger in the mean.
    """
    from scipy.stats import chi2

    rng = np.random.default_rng(11)
    vnir, swir = measured(1.03, 0.95)
    of_vnir = np.hypot(random_noise(VNIR, "vnir"), fixed_pattern(VNIR, "vnir"))
    of_swir = np.hypot(random_noise(SWIR, "swir"), fixed_pattern(SWIR, "swir"))
    found = []
    for _ in range(8000):
        v = vnir * (1 + of_vnir * rng.standard_normal(100))
        s = swir * (1 + of_swir * rng.standard_normal(300))
        found.append(find_splice(v, s, v * of_vnir, s * of_swir))
    step, gain = np.array([item.step.factor for item in found]), np.array([item.gain for item in found])
    stated_step = np.sqrt(np.mean([item.step.sigma**2 for item in found]) - MODEL_ERROR**2)
    stated_gain = np.sqrt(np.mean([item.gain_sigma**2 for item in found]))
    by_chance = math.sqrt(chi2(9).expect(lambda value: max(1.0, value / 9)))
    assert np.std(np.log(step)) == pytest.approx(stated_step, rel=0.03)
    assert np.std(np.log(gain / step)) == pytest.approx(stated_gain / by_chance, rel=0.03)
    assert np.mean(step) == pytest.approx(1.03, abs=5 * stated_step / math.sqrt(8000))
    assert np.mean(gain) == pytest.approx(0.95, abs=5 * math.hypot(stated_gain, stated_step) / math.sqrt(8000))
    for k, (at_nm, (model, _)) in enumerate(VNIR_STEPS.items()):
        steps = [item.vnir_steps[k] for item in found]
        assert {one.at_nm for one in steps} == {at_nm}
        stated = np.sqrt(np.mean([one.sigma**2 for one in steps]) - model**2)
        assert np.std(np.log([one.factor for one in steps])) == pytest.approx(stated, rel=0.03)


def test_the_error_of_the_gain_is_that_of_a_weighted_mean() -> None:
    """Ten channels, 3 % in VNIR and 4 % in SWIR: hypot(3, 4) / sqrt(10) %, whatever the spectrum."""
    vnir, swir = measured(1.0, 1.0)
    found = find_splice(vnir, swir, 0.03 * vnir, 0.04 * swir)
    assert found.gain_sigma == pytest.approx(0.05 / math.sqrt(10), rel=1e-9)


def test_noisy_channels_have_little_weight() -> None:
    """One channel of the overlap is off by 50 %; stated so, it does not move the gain."""
    vnir, swir = measured(1.0, 1.0)
    off = swir.copy()
    off[3] *= 1.5
    sigma = 0.01 * swir
    moved = find_splice(vnir, off, 0.001 * vnir, sigma).gain
    sigma[3] = 50 * swir[3]
    assert moved > 1.04
    assert find_splice(vnir, off, 0.001 * vnir, sigma).gain == pytest.approx(1, abs=1e-4)


def test_what_remains_in_the_overlap_is_stated() -> None:
    """Errors of +2 and -2 % in turn leave 2 % rms beside a gain of 1."""
    vnir, swir = measured(1.0, 1.0)
    swir[:10] *= np.where(np.arange(10) % 2, 1.02, 0.98)
    found = find_splice(vnir, swir, 0.02 * smooth(VNIR), 0.02 * smooth(SWIR))
    assert found.overlap_rms == pytest.approx(0.02, rel=0.02)
    assert found.gain == pytest.approx(1, abs=5e-3)


def disturbed(first: float, second: float) -> tuple[np.ndarray, np.ndarray]:
    """Both detectors' spectra where VNIR reads 1/first of it below 632.5 nm, and 1/second below 757.5 nm."""
    vnir, swir = measured(1.02, 0.95)
    return vnir / np.where(VNIR < 632.5, first, 1) / np.where(VNIR < 757.5, second, 1), swir


@pytest.mark.parametrize(("first", "second"), [(1.06, 0.97), (0.95, 1.04), (1.0, 1.0)])
def test_steps_of_vnir_are_found_and_removed_where_it_is_wanted(first: float, second: float) -> None:
    vnir, swir = disturbed(first, second)
    for remove in (False, True):
        found = find_splice(vnir, swir, vnir / 100, swir / 100, remove_vnir_steps=remove)
        assert [(step.at_nm, step.factor) for step in found.vnir_steps] == [
            (632.5, pytest.approx(first, rel=1e-12)),
            (757.5, pytest.approx(second, rel=1e-12)),
        ]
        left = np.where(JOINED < 632.5, first, 1) * np.where(JOINED < 757.5, second, 1)
        wanted = smooth(JOINED) if remove else smooth(JOINED) / left
        assert found.join(vnir, swir) == pytest.approx(wanted, rel=1e-12)


def test_a_step_of_vnir_that_cannot_be_measured_stays() -> None:
    """Channels 37 to 41, 635 to 655 nm, leave three of eight above 632.5 nm."""
    vnir, swir = disturbed(1.06, 0.97)
    vnir[37:42] = np.nan
    found = find_splice(vnir, swir, vnir / 100, swir / 100, remove_vnir_steps=True)
    assert [step.at_nm for step in found.vnir_steps] == [757.5]
    joined = found.join(vnir, swir)
    assert joined[JOINED > 670] == pytest.approx(smooth(JOINED)[JOINED > 670], rel=1e-12)
    assert joined[JOINED < 632.5] == pytest.approx((smooth(JOINED) / 1.06)[JOINED < 632.5], rel=1e-12)
    assert found.modes(joined)["vnir_step_632"][:30] == pytest.approx(0.065 * joined[:30])


@pytest.mark.parametrize("removed", [False, True])
def test_modes_are_shifts_of_what_each_factor_scales(removed: bool) -> None:
    """A step of VNIR that is kept is an error of its usual size, one that is removed of its standard error."""
    splice = Splice(
        step=Step(1377.5, 1.02, 0.004),
        vnir_steps=(Step(632.5, 1.05, 0.011), Step(757.5, 0.98, 0.012)),
        vnir_steps_removed=removed,
        gain=0.95,
        gain_sigma=0.003,
        overlap_rms=0.01,
    )
    spliced = smooth(JOINED)
    wanted = {
        "splice_gain": (900, 0.003),
        "splice_overlap": (900, 0.01),
        "splice_step": (1377.5, 0.004),
        "vnir_step_632": (632.5, 0.011 if removed else 0.065),
        "vnir_step_758": (757.5, 0.012 if removed else 0.050),
    }
    modes = splice.modes(spliced)
    assert modes.keys() == wanted.keys()
    for name, (end, size) in wanted.items():
        assert modes[name] == pytest.approx(np.where(end > JOINED, size * spliced, 0)), name


def test_the_error_of_the_gain_grows_where_the_detectors_disagree() -> None:
    """Errors of +3 and -3 % in turn where 1 % is stated: chi2 = 10 * 3^2 over 9 degrees of freedom, its root 3.2."""
    vnir, swir = measured(1.0, 1.0)
    swir[:10] *= np.where(np.arange(10) % 2, 1.03, 0.97)
    sigma = 0.01 / math.sqrt(2)
    found = find_splice(vnir, swir, sigma * smooth(VNIR), sigma * smooth(SWIR))
    chi2 = 10 * 0.03**2 / 0.01**2 / 9
    assert found.gain_sigma == pytest.approx(0.01 / math.sqrt(10) * math.sqrt(chi2), rel=0.03)


@pytest.mark.reference
def test_the_step_of_laboratory_spectra_that_have_none(reference_data: Path) -> None:
    with (reference_data / "spectra/relab/reflectance.csv").open() as file:
        header, *rows = csv.reader(file)
    table = np.array([[float(cell) if cell else np.nan for cell in row] for row in rows])
    steps = []
    for column in table[:, 1:].T:
        known = np.isfinite(column)
        vnir, swir = (np.interp(grid, table[known, 0], column[known]) for grid in (VNIR, SWIR))
        found = find_splice(vnir, swir, 0.01 * vnir, 0.01 * swir)
        steps.append([found.step.factor, *(step.factor for step in found.vnir_steps)])
        assert found.gain == pytest.approx(found.step.factor, abs=1e-12)
    assert len(steps) == len(header) - 1 == 172
    stated = np.array([MODEL_ERROR, *(error for error, _ in VNIR_STEPS.values())])
    apart = np.array(steps) - 1
    assert (np.sqrt(np.mean(apart**2, axis=0)) <= 1.1 * stated).all()
    assert (np.std(apart, axis=0) <= 1.1 * stated).all()


def test_the_stated_error_is_never_below_that_of_the_model() -> None:
    assert noise_free(1.0, 1.0, relative=1e-6).step.sigma == pytest.approx(MODEL_ERROR, rel=1e-3)


@pytest.mark.parametrize("missing", ["vnir", "swir"])
def test_an_overlap_without_channels_is_refused(missing: str) -> None:
    vnir, swir = measured(1.0, 1.0)
    (vnir[90:96] if missing == "vnir" else swir[:6]).fill(np.nan)
    with pytest.raises(DataError, match="only 4 of 10 channels from 900 to 945 nm are valid in both detectors"):
        find_splice(vnir, swir, vnir / 100, swir / 100)


@pytest.mark.parametrize("channels", [slice(84, 92), slice(96, 104), slice(0, 300)])
def test_a_step_without_channels_beside_it_is_refused(channels: slice) -> None:
    """Channels 84-95 are those from 1320 to 1375 nm, 96-107 those from 1380 to 1435 nm."""
    vnir, swir = measured(1.0, 1.0)
    swir[channels] = np.nan
    with pytest.raises(
        DataError, match=r"too few valid channels from 1317\.5 to 1437\.5 nm to find the step at 1377\.5 nm"
    ):
        find_splice(vnir, swir, vnir / 100, swir / 100)
