"""Jobs of spectra from Python: one result feeds the next, in memory, and is what the command line shows."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from astropy import units
from lunarsci.cli import main

from lunarsci.errors import DataError, LunarSciError, LunarSciWarning, ParameterError, RequestError
from lunarsci.spectra.jobs.bands import MeasuredBands, bands
from lunarsci.spectra.jobs.calibrate import Calibrations, calibrate, check_fits, settings_of
from lunarsci.spectra.jobs.fit import fit
from lunarsci.spectra.jobs.library import check_library, import_library, open_library
from lunarsci.spectra.jobs.match import match
from lunarsci.spectra.jobs.requests import CalibrateRequest, MatchRequest
from lunarsci.spectra.jobs.simulate import simulate

ROCK = "ol=0.1,opx=0.5,cpx=0.1,plg=0.3"


@pytest.fixture(scope="module")
def products(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("products")
    for name, content in simulate(rock=ROCK, seed=3).files.items():
        (folder / name).write_bytes(content)
    return folder


@pytest.fixture(scope="module")
def calibrated(products: Path) -> Calibrations:
    return calibrate(products, photometry="akimov")


@pytest.fixture(scope="module")
def measured(calibrated: Calibrations) -> MeasuredBands:
    return bands(calibrated.spectra)


def test_what_is_calibrated_is_what_the_command_says(
    calibrated: Calibrations, products: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["spectra", "calibrate", str(products), "--photometry", "akimov", "--json", "--no-time", "-q"]
    assert main(arguments) == 0
    said = json.loads(capsys.readouterr().out)
    ours = json.loads(calibrated.to_json(time=False))
    assert ours["result"] == said["result"]
    assert ours["provenance"]["sources"] == said["provenance"]["sources"]
    assert ours["result"]["spectra"][0]["photometry"]["disk"] == "akimov"
    assert len(calibrated.to_table()) == 390
    assert calibrated.to_table()["wavelength_nm"].unit == units.nm


def test_one_result_feeds_the_next(calibrated: Calibrations, measured: MeasuredBands) -> None:
    [record] = measured.to_dict()["spectra"]
    assert record["id"] == calibrated.observations[0].id
    assert record["bc1000_nm"] == pytest.approx(925, abs=40)
    found = match(measured)
    assert found.to_dict()["rocks"][0]["bands"]["bc1000_nm"]["center_nm"] == record["bc1000_nm"]
    assert sum(row["posterior"] for row in found.rows()) == pytest.approx(1)


def test_arrays_and_files_are_measured_alike(measured: MeasuredBands, calibrated: Calibrations, tmp_path: Path) -> None:
    file = tmp_path / "rock.ecsv"
    file.write_bytes(calibrated.to_ecsv({}))
    wavelength, reflectance = calibrated.spectra[0].wavelength_nm, calibrated.spectra[0].reflectance
    centres = [bands(given).good[0].bands["2000"].center_nm for given in (file, (wavelength, reflectance))]
    assert centres[0] == pytest.approx(measured.good[0].bands["2000"].center_nm, abs=1e-6)
    assert centres[1] == pytest.approx(centres[0], abs=5)  # noise is estimated where none is given


def test_a_library_is_made_written_and_opened(calibrated: Calibrations, tmp_path: Path) -> None:
    file, library_file = tmp_path / "rock.ecsv", tmp_path / "library.ecsv"
    file.write_bytes(calibrated.to_ecsv({}))
    library = import_library([str(file)], mineral="other", source="made up")
    library_file.write_bytes(library.to_ecsv())
    opened = open_library([str(library_file)])
    assert [member.source for member in opened.members] == ["made up"]
    assert np.allclose(opened.members[0].reflectance, library.members[0].reflectance)
    assert check_library([str(library_file)]).untrusted == ""


@pytest.mark.parametrize(
    ("ask", "error", "message"),
    [
        (lambda: match(site="here", modes="ol=0.5:0.1,opx=0.5:0.1"), RequestError, "`site` here: give LAT,LON"),
        (lambda: match(), RequestError, "`modes` or `bands` of one rock"),
        (lambda: match(modes="ol=0.5"), RequestError, "`modes` 0.5: give ol=VALUE:ERROR"),
        (lambda: match(request=MatchRequest(rock_life="80:40", modes="ol=1:0")), RequestError, "`rock_life` 80:40"),
        (lambda: simulate(soil="ol=1.5"), ParameterError, "ol|olivine"),
        (lambda: simulate(time="noon"), ParameterError, "'noon' is no time"),
        (lambda: calibrate("-"), DataError, "a product is several files"),
        (lambda: settings_of(CalibrateRequest(shadow=2.0)), ParameterError, "the shadow limit is 2"),
    ],
)
def test_what_there_cannot_be_is_refused(ask: Callable[[], Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        ask()


def test_a_fits_table_has_no_room_for_many() -> None:
    names = [f"CE4_GRAS_VNIS-SD_SCI_N_20200716031001_20200716100000_{n:04d}_B.2BL" for n in range(1, 60)]
    check_fits(Path("a.fits"), names[:55])
    check_fits(Path("a.ecsv"), names)
    with pytest.raises(ParameterError, match=r"a.fits: a FITS table holds 55 observations, here are 59; use .ecsv"):
        check_fits(Path("a.fits"), names)


WAVELENGTH_NM = np.arange(500.0, 2400.0, 5.0)
REFLECTANCE = 0.2 * np.exp(-0.3 * np.exp(-0.5 * ((WAVELENGTH_NM - 930) / 60) ** 2))
"""MADE UP: one band at 930 nm."""
INDEXED = pd.DataFrame({"a": REFLECTANCE}, index=pd.Index(WAVELENGTH_NM, name="wavelength_nm"))


@pytest.mark.parametrize(
    ("given", "options", "count"),
    [
        ((WAVELENGTH_NM, REFLECTANCE), {}, 1),
        ((WAVELENGTH_NM, REFLECTANCE, np.full(WAVELENGTH_NM.size, 5e-4)), {}, 1),
        ((WAVELENGTH_NM / 1e3, REFLECTANCE), {"wavelength_unit": "um"}, 1),
        ((WAVELENGTH_NM * units.nm, 100 * REFLECTANCE), {"reflectance_unit": "percent"}, 1),
        ((WAVELENGTH_NM, np.array([REFLECTANCE] * 3)), {}, 3),
        ((WAVELENGTH_NM, np.array([REFLECTANCE] * 2).T, np.full(WAVELENGTH_NM.size, 5e-4)), {}, 2),
        (INDEXED, {}, 1),
        (INDEXED["a"], {}, 1),
    ],
)
def test_arrays_are_taken_as_they_come(given: Any, options: dict[str, Any], count: int) -> None:
    found = bands(given, **options).to_table()["bc1000_nm"]
    assert len(found) == count and np.allclose(found.value, 930, atol=0.5)


def test_micrometres_are_told_by_their_values_and_said() -> None:
    with pytest.warns(LunarSciWarning, match="0.5-2.395 read as µm; give nm, or wavelength_unit='um'"):
        found = bands((WAVELENGTH_NM / 1e3, REFLECTANCE))
    assert found.to_table()["bc1000_nm"][0].value == pytest.approx(930, abs=0.5)
    with pytest.warns(LunarSciWarning, match="read as µm"):
        bands(pd.DataFrame({"a": REFLECTANCE}, index=WAVELENGTH_NM / 1e3))


@pytest.mark.parametrize("at_nm", [930, 1500])
@pytest.mark.parametrize("factor", [0.5, 2.0, 5.0])
def test_a_single_channel_far_off_moves_no_answer(factor: float, at_nm: float) -> None:
    """It is left out, which is said: what is found is what is found without that channel."""
    place = int(np.argmin(np.abs(WAVELENGTH_NM - at_nm)))
    spiked, sigma = REFLECTANCE.copy(), np.full(WAVELENGTH_NM.size, 5e-4)
    spiked[place] *= factor
    without = [np.delete(one, place) for one in (WAVELENGTH_NM, REFLECTANCE, sigma)]
    with pytest.warns(LunarSciWarning, match="both neighbours, which are left out: 1, first 'spectrum 1'"):
        found = bands((WAVELENGTH_NM, spiked, sigma)).to_table()
    assert found["bc1000_nm"][0].value == pytest.approx(930, abs=0.5)
    expected = bands(tuple(without)).to_table()
    assert found["bc1000_nm"][0] == expected["bc1000_nm"][0]
    assert found["bc1000_sigma_nm"][0] == expected["bc1000_sigma_nm"][0]
    with pytest.warns(LunarSciWarning, match="left out"):
        fitted = fit((WAVELENGTH_NM, spiked, sigma), assemblage="opx").to_dict()["spectra"][0]["bands"]
    truth = fit(tuple(without), assemblage="opx").to_dict()["spectra"][0]["bands"]
    assert [one["center_nm"] for one in fitted] == pytest.approx([one["center_nm"] for one in truth], rel=1e-9)


def test_arrays_in_percent_are_read_so() -> None:
    with pytest.warns(LunarSciWarning, match="read as percent"):
        found = bands((WAVELENGTH_NM, 100 * REFLECTANCE)).to_table()
    expected = bands((WAVELENGTH_NM, REFLECTANCE)).to_table()
    assert found["bc1000_nm"][0].value == pytest.approx(expected["bc1000_nm"][0].value)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (
            (WAVELENGTH_NM, REFLECTANCE[1:]),
            r"shape \(379,\) beside 380 wavelengths; give \(wavelength_nm, reflectance\)",
        ),
        (np.array([WAVELENGTH_NM, REFLECTANCE]), "or a third array of standard deviations"),
        ((WAVELENGTH_NM[:9], np.full((9, 9), 0.2)), r"shape \(9, 9\) beside 9 wavelengths; give \(wavelength_nm"),
        ((WAVELENGTH_NM, np.array([REFLECTANCE] * 3), np.ones((2, 380))), "3 spectra and 2 rows of errors"),
    ],
)
def test_arrays_that_are_no_spectrum_say_what_to_give(given: Any, said: str) -> None:
    with pytest.raises(DataError, match=said):
        bands(given)


def test_some_spectra_of_a_file_are_taken_by_their_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "many.csv"
    INDEXED.assign(**{f"rock-{k}": REFLECTANCE * (1 + 0.1 * k) for k in range(8)}).to_csv(file)
    found = bands(str(file), id=("rock-5", "rock-2"))
    assert list(found.to_table()["id"]) == ["rock-5", "rock-2"] and len(found.batch.origins) == 2
    assert list(bands(str(file), id=("rock-7", "rock-[12]")).to_table()["id"]) == ["rock-7", "rock-1", "rock-2"]
    assert found.asked is not None and found.asked.options["id"] == ["rock-5", "rock-2"]
    assert main(["spectra", "bands", str(file), "--id", "rock-2", "--json", "-q"]) == 0
    assert [one["id"] for one in json.loads(capsys.readouterr().out)["result"]["spectra"]] == ["rock-2"]
    with pytest.raises(DataError, match=r"no spectrum is called 'rok-2'; did you mean 'rock-2'\? there are 9: a,"):
        bands(str(file), id="rok-2")


def test_a_table_of_names_is_told_from_a_misspelt_number(tmp_path: Path) -> None:
    file = tmp_path / "manifest.csv"
    for first, said in (("PE-CMP-030", True), ("5OO", False)):
        file.write_text(f"id,mineral\n{first},0.2\n510,0.3\n520,0.4\n")
        with pytest.raises(DataError) as caught:
            bands(str(file))
        assert ("is the file no table of spectra?" in str(caught.value)) is said


def test_masks_of_arrays_are_kept() -> None:
    """Hot channels in the band, masked in any of the usual ways, are as if they were not there."""
    from astropy import units as u
    from astropy.utils.masked import Masked

    hot = np.abs(WAVELENGTH_NM - 940) < 12
    spoilt, sigma = np.where(hot, 1.3 * REFLECTANCE, REFLECTANCE), np.full(WAVELENGTH_NM.size, 5e-4)
    gone = [np.delete(one, np.flatnonzero(hot)) for one in (WAVELENGTH_NM, REFLECTANCE, sigma)]
    wanted = bands(tuple(gone)).to_table()["bc1000_nm"][0]
    masked = np.ma.array(spoilt, mask=hot)
    for given in (
        (WAVELENGTH_NM, masked, sigma),
        [(WAVELENGTH_NM, masked, sigma)],
        (WAVELENGTH_NM, np.ma.array([spoilt, spoilt], mask=[hot, hot]), sigma),
        (WAVELENGTH_NM * u.nm, Masked(spoilt * u.one, mask=hot), sigma * u.one),
    ):
        assert bands(given).to_table()["bc1000_nm"][0].value == pytest.approx(wanted.value, abs=0.05)
    with pytest.raises(LunarSciError, match="some wavelengths are masked"):
        bands((np.ma.array(WAVELENGTH_NM, mask=hot), spoilt, sigma))
    table = pd.DataFrame({"a": REFLECTANCE})
    assert bands((pd.Series(WAVELENGTH_NM), table["a"], sigma)).to_table()["bc1000_nm"][0].value


def test_units_of_reflectances_and_errors_are_kept() -> None:
    from astropy import units as u

    sigma = np.full(WAVELENGTH_NM.size, 5e-4)
    plain = bands((WAVELENGTH_NM, REFLECTANCE, sigma)).to_table()
    for reflectance, error, unit in (
        (100 * REFLECTANCE * u.percent, sigma * u.one, None),
        (100 * REFLECTANCE * u.percent, 100 * sigma * u.percent, "percent"),
        (REFLECTANCE, 100 * sigma * u.percent, None),
        (100 * REFLECTANCE, sigma * u.one, "percent"),
    ):
        found = bands((WAVELENGTH_NM * u.nm, reflectance, error), reflectance_unit=unit).to_table()
        for name in ("bc1000_nm", "bc1000_sigma_nm"):
            assert found[name][0].value == pytest.approx(plain[name][0].value, rel=1e-6)
    with pytest.raises(LunarSciError, match="reflectances are fractions or percent"):
        bands((WAVELENGTH_NM, REFLECTANCE * u.W / u.m**2))


@pytest.mark.parametrize("stated", [False, True], ids=["no units", "units"])
def test_columns_of_astropy_are_arrays_with_their_masks_and_units(stated: bool) -> None:
    from astropy.table import Column, MaskedColumn

    hot = np.abs(WAVELENGTH_NM - 940) < 12
    gone = [np.delete(one, np.flatnonzero(hot)) for one in (WAVELENGTH_NM, REFLECTANCE)]
    wanted = bands(tuple(gone)).to_table()["bc1000_nm"][0].value
    scale = 100.0 if stated else 1.0
    reflectance = MaskedColumn(scale * np.where(hot, 0.9, REFLECTANCE), mask=hot, unit="percent" if stated else None)
    wavelength = Column(WAVELENGTH_NM / 1e3, unit="um") if stated else Column(WAVELENGTH_NM)
    assert bands((wavelength, reflectance)).to_table()["bc1000_nm"][0].value == pytest.approx(wanted, abs=0.05)
