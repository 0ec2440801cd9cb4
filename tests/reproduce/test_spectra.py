"""The numbers of the rock: minerals and places without spectra, averages with them."""

import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError
from lunarsci.io.inputs import read_input
from lunarsci.reproduce.numbers import Number, published_numbers
from lunarsci.reproduce.spectra import (
    Rocks,
    boulders,
    fit_rocks,
    high_calcium,
    low_calcium,
    olivine_share,
    spectra_numbers,
)
from lunarsci.spectra.readers.dispatch import read_spectra
from lunarsci.spectra.spectrum import Spectrum
from lunarsci.spectra.vnis.simulation.scene import Material, SceneComposition, surface_reflectance

SPECTRA = {"mgm-rms", "opx-share", "olivine-low", "olivine-high"}
WAVELENGTH = np.arange(450.0, 2396.0, 5.0)


def rock(name: str, composition: SceneComposition, seed: int) -> Spectrum:
    """A made-up boulder with noise that the fit has to find its way through."""
    clean = surface_reflectance(WAVELENGTH, Material(composition, albedo=0.15))
    noise = np.random.default_rng(seed).standard_normal(WAVELENGTH.size)
    return Spectrum(name, WAVELENGTH, clean * np.exp(0.005 * noise), uncertainty=0.005 * clean)


@pytest.fixture(scope="module")
def alone() -> dict[str, Number]:
    return {number.id: number for number in spectra_numbers()}


@pytest.fixture(scope="module")
def made_up() -> Rocks:
    return fit_rocks([rock(f"rock-{k}", SceneComposition(0.2, 0.5, 0.3), k) for k in range(3)])


def test_every_number_of_the_table_has_a_verdict_with_evidence(alone: dict[str, Number]) -> None:
    assert list(alone) == [row["id"] for row in published_numbers("spectra")]
    assert all(number.reason for number in alone.values())


def test_without_spectra_what_needs_them_is_open_and_says_so(alone: dict[str, Number]) -> None:
    for name in SPECTRA:
        assert alone[name].ours is None
        assert alone[name].verdict == "not determined by what is published"
        assert "--boulders" in alone[name].reason


def test_zhinyu_lies_where_spherical_trigonometry_has_it(alone: dict[str, Number]) -> None:
    """Law of cosines, and the four-part formula for the direction; radius 1737.4 km."""
    a, b, turn = math.radians(-45.44), math.radians(-45.34), math.radians(176.15 - 177.56)
    cosine = math.sin(a) * math.sin(b) + math.cos(a) * math.cos(b) * math.cos(turn)
    east, north = math.sin(turn), math.cos(a) * math.tan(b) - math.sin(a) * math.cos(turn)
    assert alone["zhinyu-distance"].ours == pytest.approx(1737.4 * math.acos(cosine), rel=1e-6)
    assert alone["zhinyu-azimuth"].ours == pytest.approx(math.degrees(math.atan2(east, north)) % 360, rel=1e-6)
    assert {alone[name].verdict for name in ("zhinyu-distance", "zhinyu-azimuth")} == {"reproduced"}


def test_centres_of_pyroxenes_and_the_one_that_is_not_theirs(alone: dict[str, Number]) -> None:
    """Published as about 900 and 1900 nm, 1100 and 2200 nm; no pyroxene has 1100 nm, and few have as little as 900."""
    verdicts = {name: alone[name].verdict for name in ("lcp-1um", "lcp-2um", "hcp-1um", "hcp-2um")}
    assert verdicts == {
        "lcp-1um": "differs",
        "lcp-2um": "reproduced",
        "hcp-1um": "differs",
        "hcp-2um": "reproduced",
    }
    for number in alone.values():
        if number.verdict.startswith("reproduced") and number.low is not None and number.high is not None:
            assert number.low <= number.published <= number.high
    assert alone["lcp-1um"].low is not None and alone["lcp-1um"].low > 900
    assert alone["hcp-1um"].high is not None
    assert alone["hcp-1um"].high < 1060


def hull_minimum(wavelength: np.ndarray, reflectance: np.ndarray, low: float, high: float) -> float:
    """Deepest point below a straight line between the highest points on either side of a window. [nm]"""
    left = (wavelength > low - 250) & (wavelength < low)
    right = (wavelength > high) & (wavelength < high + 250)
    x = [wavelength[side][np.argmax(reflectance[side])] for side in (left, right)]
    y = [reflectance[side].max() for side in (left, right)]
    inside = (wavelength >= low) & (wavelength <= high)
    ratio = reflectance[inside] / np.interp(wavelength[inside], x, y)
    return float(wavelength[inside][np.argmin(ratio)])


@pytest.mark.reference
def test_centres_are_those_of_the_measured_pyroxenes(reference_data: Path) -> None:
    """RELAB itself, by a straight line and the deepest channel: medians within 20 nm."""
    with (reference_data / "spectra/relab/manifest.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    poor = [row["id"] for row in rows if float(row["vol_opx"]) == 1]
    rich = [row["id"] for row in rows if float(row["vol_cpx"]) == 1 and float(row["cpx_wo"]) >= 0.25]
    spectra = {s.id: s for s in read_spectra(read_input(str(reference_data / "spectra/relab/reflectance.csv")))}
    for names, ours in ((poor, low_calcium()), (rich, high_calcium())):
        own = [(spectra[name].wavelength_nm, spectra[name].reflectance) for name in names if name in spectra]
        assert len(own) >= 10
        found = np.median([hull_minimum(w, r, 800, 1250) for w, r in own])
        assert np.nanmedian(ours[:, 0]) == pytest.approx(found, abs=20)


def test_the_source_is_open_because_an_assumption_turns_it(alone: dict[str, Number]) -> None:
    number = alone["source-crater"]
    assert number.verdict == "not determined by what is published"
    assert (number.low, number.high) == (1.0, number.ours)
    assert number.ours is not None
    assert number.ours > 1


def test_boulders_are_those_named_so_or_all() -> None:
    one, other = (Spectrum(name, WAVELENGTH, np.full(WAVELENGTH.size, 0.1)) for name in ("site-Rock-1", "site-soil"))
    assert boulders([one, other]) == [one]
    assert boulders([other]) == [other]
    with pytest.raises(DataError, match="at least one"):
        boulders([])


def test_made_up_boulders_give_values_with_a_range(made_up: Rocks) -> None:
    numbers = {number.id: number for number in spectra_numbers(made_up)}
    for name in SPECTRA:
        number = numbers[name]
        assert number.ours is not None and number.low is not None and number.high is not None
        assert number.low <= number.ours <= number.high
        assert number.reading
        assert number.verdict == "not determined by what is published"


def test_averages_of_six_are_held_against_those_of_six(made_up: Rocks) -> None:
    six = replace(made_up, fits=2 * made_up.fits, smoothed=2 * made_up.smoothed)
    numbers = {number.id: number for number in spectra_numbers(six)}
    for name in SPECTRA - {"mgm-rms"}:
        assert numbers[name].verdict != "not determined by what is published"
        assert "6 boulders" in numbers[name].reading
    assert numbers["mgm-rms"].verdict == "not determined by what is published"
    one = replace(made_up, fits=made_up.fits[:1], smoothed=made_up.smoothed[:1])
    numbers = {number.id: number for number in spectra_numbers(one)}
    assert (numbers["mgm-rms"].low, numbers["mgm-rms"].high) == (None, None)
    assert "1 boulder that" in numbers["opx-share"].reading


def test_smoothing_is_what_brings_the_fitting_error_down(made_up: Rocks) -> None:
    """41 points of a cubic keep 9/4/41 of the variance of white noise (Savitzky & Golay): 0.5 % turn into 0.12 %."""
    left = 0.5 * math.sqrt(9 / 4 / 41)
    assert np.median([100 * fit.rms_ln for fit in made_up.fits]) == pytest.approx(0.5, rel=0.15)
    smoothed = np.median([100 * fit.rms_ln for fit in made_up.smoothed])
    assert 0.5 * left < smoothed < 2.5 * left


def test_the_share_of_olivine_is_that_of_its_band(made_up: Rocks) -> None:
    fit = made_up.fits[0]
    strength = {band.name: -band.strength for band in fit.bands}
    expected = strength["OL M1-2"] / (strength["OL M1-2"] + strength["OPX 1"] + strength["CPX 1"])
    assert olivine_share(fit) == pytest.approx(expected)


@pytest.mark.reference
@pytest.mark.slow
def test_the_public_boulders(reference_data: Path) -> None:
    """Smoothed, they fit as well as the paper's; its pyroxenes lie within what the choice of the continuum does."""
    spectra = read_spectra(read_input(str(reference_data / "spectra/ce4/reflectance_factor.csv")))
    found = fit_rocks(boulders(spectra))
    numbers = {number.id: number for number in spectra_numbers(found)}
    assert len(found.fits) == 9
    rms, share = numbers["mgm-rms"], numbers["opx-share"]
    assert rms.low is not None and rms.high is not None and share.low is not None and share.high is not None
    assert rms.low < rms.published < rms.high
    assert min(100 * fit.rms_ln for fit in found.fits) > 2 * rms.published
    assert share.verdict == "differs"
    assert share.low < share.published < share.high
    ratios = [fit.nbsr["um2"].opx for fit in found.fits if fit.nbsr["um2"]]
    assert share.ours == pytest.approx(100 * np.mean(ratios))
