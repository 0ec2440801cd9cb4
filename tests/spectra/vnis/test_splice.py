"""Joining of the detectors, and errors that all channels share."""

import csv
import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lunarsci.errors import DataError
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.bands import measure_bands
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.model import constrained, mgm_model
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.photometry import PhaseFunction, phase_function
from lunarsci.spectra.solar import solar_spectrum
from lunarsci.spectra.spectrum import Spectrum
from lunarsci.spectra.vnis.calibrate import calibrate
from lunarsci.spectra.vnis.calibration import Calibration
from lunarsci.spectra.vnis.channels import SPLICED_NM, fixed_pattern, footprint_mask, random_noise
from lunarsci.spectra.vnis.detector import default_settings
from lunarsci.spectra.vnis.label import read_label
from lunarsci.spectra.vnis.observation import Observation, SwirTable
from lunarsci.spectra.vnis.simulation.instrument import Instrument, simulate
from lunarsci.spectra.vnis.simulation.scene import Material, Scene, SceneComposition, SceneRock
from lunarsci.spectra.vnis.simulation.template import product_files
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


Write = Callable[[Mapping[str, bytes]], Path]
WITHOUT_MODEL = {
    *("calibration_swir", "irradiance_shape", "irradiance_detail", "registration"),
    *("splice_gain", "splice_overlap", "splice_step", "vnir_step_632", "vnir_step_758"),
}
WITH_MODEL = WITHOUT_MODEL | {"photometry_1", "photometry_2", "phase_edge"}
MAFIC = Material(SceneComposition(0.3, 0.35, 0.35, 0.0), albedo=0.1, red_slope=0.4, contrast=1.5)


@functools.cache
def observation(soil: Material | None = None, noise: float = 1.0) -> Observation:
    scene = Scene(rock=SceneRock(), solar="g173") if soil is None else Scene(soil=soil, solar="g173")
    made = simulate(scene, Instrument(noise=noise), seed=7)
    files = product_files(made)
    vd, sd = (
        read_label(next(InputFile(n, c) for n, c in files.items() if f"-{kind}_SCI" in n and n.endswith("L")))
        for kind in ("VD", "SD")
    )
    table = SwirTable(made.swir, np.zeros(300, bool))
    return Observation(vd.name.observation, True, vd, sd, made.vnir, None, table, {})


def found(changes: Mapping[str, Any] | None = None, vnir: float = 1.0, swir: float = 1.0) -> Calibration:
    """The observation, its radiances scaled, under changed settings."""
    source = observation()
    scaled = replace(
        source,
        cube=source.cube * np.float32(vnir),
        table=replace(source.table, radiance=source.table.radiance * swir),
    )
    return calibrate(scaled, replace(default_settings(), **(changes or {})))


@functools.cache
def mafic(noise: float) -> Spectrum:
    """Deep bands, under the photometry and the Sun that the scene obeys."""
    obeyed = replace(
        default_settings(),
        solar=solar_spectrum("g173"),
        other_solar=solar_spectrum("e490"),
        photometry="akimov",
        phase=phase_function("sp-high"),
    )
    return calibrate(observation(MAFIC, noise), obeyed).to_spectrum()


@pytest.fixture(scope="module")
def base() -> Calibration:
    return found()


def test_names_and_shapes(base: Calibration) -> None:
    assert set(base.systematic) == WITH_MODEL
    for mode in base.systematic.values():
        assert mode.shape == (390,)
        assert np.isfinite(mode).all()
    assert base.systematic_total == pytest.approx(np.sqrt(sum(mode**2 for mode in base.systematic.values())))


def test_without_photometry_there_is_no_error_of_its_model() -> None:
    assert set(found({"photometry": "none"}).systematic) == WITHOUT_MODEL


def test_the_calibration_of_swir_is_7_percent_of_everything(base: Calibration) -> None:
    relative = base.systematic["calibration_swir"] / base.reflectance
    assert relative == pytest.approx(np.full(390, relative[0]), rel=1e-9)
    assert relative[0] == pytest.approx(0.07, rel=2e-3)


def test_swir_read_7_percent_higher_is_the_mode(base: Calibration) -> None:
    again = found(swir=math.exp(0.07))
    assert again.reflectance - base.reflectance == pytest.approx(base.systematic["calibration_swir"], rel=0.04)


def test_vnir_read_5_percent_higher_changes_nothing(base: Calibration) -> None:
    """It is scaled to SWIR: its calibration is no error of the result, and is not listed."""
    assert found(vnir=math.exp(0.05)).reflectance == pytest.approx(base.reflectance, rel=1e-6)
    assert "calibration_vnir" not in base.systematic


def test_a_pixel_of_registration_scales_everything(base: Calibration) -> None:
    """What the field of view sees, moved by a pixel in four directions; the table's level goes with it."""
    lines, samples = np.nonzero(footprint_mask())
    brightness = observation().cube[90:].mean(axis=0, dtype=float)
    here, *moved = (
        brightness[lines + down, samples + right].mean() for down, right in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))
    )
    wanted = np.sqrt(np.mean([(there / here - 1) ** 2 for there in moved]))
    relative = base.systematic["registration"] / base.reflectance
    assert relative == pytest.approx(np.full(390, wanted), rel=1e-3)


def test_the_detail_of_the_irradiance_is_the_difference_of_two_calibrations(base: Calibration) -> None:
    other = found({"solar": solar_spectrum("g173"), "other_solar": solar_spectrum("e490")})
    mode = base.systematic["irradiance_detail"]
    assert other.reflectance - base.reflectance == pytest.approx(mode, abs=0.03 * np.abs(mode).max())
    assert 0.002 < np.std(mode / base.reflectance) < 0.02


@pytest.mark.reference
@pytest.mark.parametrize(("solar", "tolerance"), [("e490", 0.008), ("g173", 0.015)])
def test_the_shape_of_the_irradiance_is_that_to_the_sun_of_m3(
    reference_data: Path, solar: str, tolerance: float
) -> None:
    """Channel by channel of M3, 40 nm wide, and averaged over 120 nm; where the splice changes nothing.

    G173 departs from E490 by up to 4 % around 1815 nm, which other averages see differently.
    """
    with (reference_data / "spectra/lunar/m3_solar_spec.csv").open() as file:
        m3 = np.array([[float(cell) for cell in row] for row in list(csv.reader(file))[1:]])
    used = solar_spectrum(solar)
    result = found({"solar": used, "other_solar": solar_spectrum("g173" if solar == "e490" else "e490")})
    shape = result.systematic["irradiance_shape"] / result.reflectance
    for center in range(1500, 2301, 100):
        wanted = [
            math.log(used.irradiance[np.abs(used.wavelength_nm - w) <= 20].mean() / (e / 1000))
            for w, e in m3
            if abs(w - center) <= 60
        ]
        assert shape[(center - 450) // 5] == pytest.approx(np.mean(wanted), abs=tolerance), center
    assert np.std(shape) > 0.005


class GoingOn:
    """A SELENE phase function whose parabola is not held at its ends: through three values of it within."""

    name, source = "going on", "a test"

    def __init__(self, held: PhaseFunction) -> None:
        self.held = held

    def log_ratio(self, phase_deg: float, wavelength_nm: np.ndarray) -> np.ndarray:
        at = np.array([600.0, 1200.0, 1900.0])
        return np.polyval(np.polyfit(at, self.held.log_ratio(phase_deg, at), 2), wavelength_nm)

    def edge_shift(self, phase_deg: float, wavelength_nm: np.ndarray) -> np.ndarray:
        return np.zeros(wavelength_nm.shape)

    def remark(self, phase_deg: float, wavelength_nm: np.ndarray) -> str:
        return ""


def test_the_edge_of_the_phase_function_is_that_of_letting_it_go_on(base: Calibration) -> None:
    other = found({"phase": GoingOn(phase_function("sp-mid"))})
    mode = base.systematic["phase_edge"]
    assert other.reflectance - base.reflectance == pytest.approx(mode, abs=0.02 * np.abs(mode).max())
    within = (SPLICED_NM > 515) & (SPLICED_NM < 2050)
    assert np.abs(mode[within]).max() < 0.02 * np.abs(mode).max()


def test_the_limit_of_shadows_is_half_the_difference_of_two_limits() -> None:
    """Twilight: light falls to nothing over the right half of the field of view."""
    source = observation()
    light = np.ones(256, dtype=np.float32)
    light[100:] = np.maximum(0.003, np.linspace(1.0, -2.0, 156))
    of_all = light[np.nonzero(footprint_mask())[1]].mean()
    table = replace(source.table, radiance=source.table.radiance * of_all)
    dusk = replace(source, cube=source.cube * light, table=table)
    low, middle, high = (
        calibrate(dusk, replace(default_settings(), shadow_limit=limit)) for limit in (0.01, 0.02, 0.03)
    )
    assert low.footprint.lit.sum() > middle.footprint.lit.sum() > high.footprint.lit.sum()
    mode = middle.systematic["shadow_limit"]
    assert mode == pytest.approx((high.reflectance - low.reflectance) / 2, abs=0.02 * np.abs(mode).max())
    assert np.abs(mode / middle.reflectance).max() > 1e-3


@pytest.mark.parametrize(
    ("disk", "phase"), [("lommel-seeliger", "sp-mid"), ("akimov", "sp-high"), ("mcewen", "sp-low")]
)
def test_the_modes_of_photometry_are_the_spread_of_nine_calibrations(disk: str, phase: str) -> None:
    used = found({"photometry": disk, "phase": phase_function(phase)})
    models = [
        found({"photometry": other, "phase": phase_function(name)})
        for other in ("lommel-seeliger", "akimov", "mcewen")
        for name in ("sp-low", "sp-mid", "sp-high")
    ]
    apart = np.log([model.reflectance / used.reflectance for model in models])
    modes = [used.systematic[f"photometry_{k}"] for k in (1, 2)]
    shifts = np.arcsinh([mode / used.reflectance for mode in modes])  # half of e^x - e^-x each
    assert np.sqrt((shifts**2).sum(axis=0)) == pytest.approx(np.sqrt((apart**2).mean(axis=0)), rel=0.05)
    # And between channels: how 700, 1000 and 1500 nm move together.
    at = [50, 110, 210]
    assert shifts.T[at] @ shifts[:, at] == pytest.approx(apart.T[at] @ apart[:, at] / 9, rel=0.1)


def test_no_mode_where_a_channel_is_not_used() -> None:
    source = observation()
    radiance = source.table.radiance.copy()
    radiance[150] = np.nan
    made = calibrate(replace(source, table=replace(source.table, radiance=radiance)))
    assert np.isnan(made.reflectance[240])
    assert all(mode[240] == 0 for mode in made.systematic.values())
    assert made.to_spectrum().mask.sum() == 1  # type: ignore[union-attr]


def spectrum(**changes: Any) -> Spectrum:
    given = {"wavelength_nm": np.array([500.0, 600.0, 700.0]), "reflectance": np.array([0.1, np.nan, 0.2])}
    return Spectrum("x", **(given | changes))


def test_a_spectrum_keeps_shifts_and_clears_unusable_channels() -> None:
    made = spectrum(systematic={"level": np.array([0.01, np.nan, 0.02])})
    assert made.systematic["level"].tolist() == [0.01, 0.0, 0.02]
    with pytest.raises(ValueError, match="read-only"):
        made.systematic["level"][0] = 1
    assert spectrum().systematic == {}


@pytest.mark.parametrize(
    ("shift", "message"),
    [
        ([0.01, 0.0], r"systematic 'level' is not known in every usable channel \(2 values for 3 channels\)"),
        ([np.nan, 0.0, 0.0], "systematic 'level' is not known in every usable channel"),
        ([np.inf, 0.0, 0.0], "systematic 'level' is not known in every usable channel"),
    ],
)
def test_shifts_that_do_not_fit_are_refused(shift: list[float], message: str) -> None:
    with pytest.raises(DataError, match=f"^x: {message}"):
        spectrum(systematic={"level": np.array(shift)})


BANDS = {"center_nm": "center_calibration_nm", "depth": "depth_calibration", "area_nm": "area_calibration_nm"}


def shifted(source: Spectrum, name: str, share: float) -> Spectrum:
    """The spectrum with a share of one standard deviation of an error."""
    return replace(source, id=f"{name} {share:+g}", reflectance=source.reflectance + share * source.systematic[name])


@pytest.mark.parametrize("continuum", ["conic", "hull", "linear"])
def test_errors_of_bands_are_those_of_measuring_shifted_spectra(continuum: str) -> None:
    """The share is small, so that the continuum keeps its tie points."""
    share = 1e-4
    source = mafic(0.1)

    def measured(of: Spectrum) -> Any:
        return measure_bands(of, continuum_name=continuum).bands  # type: ignore[arg-type]

    base = measured(source)
    pairs = [[measured(shifted(source, name, sign * share)) for sign in (1, -1)] for name in source.systematic]
    for key, band in base.items():
        assert band.center_nm is not None
        for quantity, stated in BANDS.items():
            slopes = [(getattr(up[key], quantity) - getattr(down[key], quantity)) / (2 * share) for up, down in pairs]
            assert getattr(band, stated) == pytest.approx(float(np.linalg.norm(slopes)), rel=0.05)
            assert getattr(band, stated) > 0


def test_bands_of_a_spectrum_without_shared_errors_say_nothing_about_them() -> None:
    source = replace(mafic(0.1), systematic={})
    for band in measure_bands(source).bands.values():
        assert band.center_nm is not None
        assert [getattr(band, stated) for stated in BANDS.values()] == [None] * 3


def test_a_level_moves_no_band() -> None:
    """A grey error is divided out by the continuum: centre, depth and area of a ratio stay."""
    source = mafic(0.1)
    grey = replace(source, systematic={"level": 0.07 * source.reflectance})
    for band in measure_bands(grey).bands.values():
        assert [getattr(band, stated) for stated in BANDS.values()] == pytest.approx([0, 0, 0], abs=1e-8)


def fitted(spectra: list[Spectrum]) -> list[MgmFit]:
    """Without the pyroxenes' weak bands at 1.2 um, which the simulated surfaces do not have."""
    model = constrained(mgm_model("OL-OPX-CPX"), fixed=["opx_m1_strength=0", "cpx_m1_strength=0"])
    fits = fit_spectra(spectra, model)
    assert all(isinstance(fit, MgmFit) for fit in fits)
    return fits  # type: ignore[return-value]


@pytest.mark.slow
def test_errors_of_fits_are_those_of_fitting_shifted_spectra() -> None:
    """All bands are deep, so that none ends on a bound. Centres and widths move by little, and not quite linearly.

    A band far from all channels moves by less than the rounding of what it absorbs there.
    """
    share = 0.1
    source = mafic(0.0)
    names = list(source.systematic)
    base, *moved = fitted([source, *(shifted(source, name, f * share) for name in names for f in (1, -1))])
    assert not any(band.at_bound for band in base.bands)
    pairs = list(zip(moved[::2], moved[1::2], strict=True))

    def response(value: Callable[[MgmFit], float]) -> float:
        return float(np.linalg.norm([(value(up) - value(down)) / (2 * share) for up, down in pairs]))

    for k, band in enumerate(base.bands):
        assert band.strength_calibration == pytest.approx(response(lambda f, k=k: f.bands[k].strength), rel=0.1)
        assert band.center_calibration_nm == pytest.approx(
            response(lambda f, k=k: f.bands[k].center_nm), rel=0.3, abs=1e-9
        )
        assert band.fwhm_calibration_nm == pytest.approx(response(lambda f, k=k: f.bands[k].fwhm_nm), rel=0.3, abs=1e-9)
    ratio = base.nbsr["um2"]
    assert ratio is not None
    assert ratio.calibration == pytest.approx(response(lambda f: f.nbsr["um2"].opx), rel=0.1)  # type: ignore[union-attr]


def test_fits_of_a_spectrum_without_shared_errors_say_nothing_about_them() -> None:
    source = replace(mafic(0.0), systematic={})
    [fit] = fitted([source])
    assert all(band.strength_calibration is None for band in fit.bands)
    assert all(ratio is None or ratio.calibration is None for ratio in fit.nbsr.values())


def test_a_level_changes_no_mineral() -> None:
    """ln R moves by a constant, which the continuum takes up, as nearly as the fit stands at its minimum."""
    source = mafic(0.0)
    [fit] = fitted([replace(source, systematic={"level": 0.07 * source.reflectance})])
    assert [band.strength_calibration for band in fit.bands] == pytest.approx([0] * len(fit.bands), abs=1e-4)
    ratio = fit.nbsr["um2"]
    assert ratio is not None
    assert ratio.calibration == pytest.approx(0, abs=1e-4)
