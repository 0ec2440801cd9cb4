"""Solar spectra of users: what their files state, leave out, and get wrong."""

import warnings
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad, trapezoid

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.readers.solar_table import read_solar_spectrum
from lunarsci.spectra.solar import SOLAR_SPECTRA, solar_spectrum

PLANCK_NM = np.arange(400.0, 2601.0, 2.0)


def planck(wavelength_nm: np.ndarray) -> np.ndarray:
    """Blackbody of the Sun's radius at 1 AU: a smooth Sun. [W m-2 nm-1]

    Its 5860 K are more than the effective 5772 K: what the Sun lacks below 400 nm it has beyond.
    """
    metres = wavelength_nm * 1e-9
    radiance = 2 * 6.62607015e-34 * 299792458.0**2 / metres**5
    radiance /= np.expm1(6.62607015e-34 * 299792458.0 / (metres * 1.380649e-23 * 5860.0))
    return np.pi * radiance * (6.957e8 / 1.495978707e11) ** 2 * 1e-9


def a_file(content: str, name: str = "sun.csv") -> InputFile:
    return InputFile(name, content.encode())


def table(header: str = "wavelength_nm,irradiance_w_m-2_nm-1", per: float = 1.0, length: float = 1.0) -> str:
    rows = zip(PLANCK_NM * length, planck(PLANCK_NM) * per, strict=True)
    return "\n".join([header, *(f"{w:.6g},{e:.6g}" for w, e in rows)]) + "\n"


@pytest.mark.parametrize(
    ("header", "per", "length"),
    [
        ("wavelength_nm,irradiance_w_m-2_nm-1", 1, 1),
        ("Wavelength (nm),Irradiance (W/m2/nm)", 1, 1),
        ("nm,W/m²/µm", 1000, 1),
        ("wavelength (µm),irradiance (W m-2 µm-1)", 1000, 1e-3),
        ("wavelength [um],irradiance [W m-2 nm-1]", 1, 1e-3),
        ("wavelength_nm,irradiance_mW_m-2_nm-1", 1000, 1),
        ("# wavelength_nm,irradiance_w_m-2_nm-1", 1, 1),
        ("#\n# ASTM\n# wavelength_nm,irradiance_w_m-2_nm-1", 1, 1),
        ("A title,,\nWvlgth nm,Etr W*m-2*nm-1", 1, 1),
    ],
)
def test_stated_units_are_taken_in_silence(header: str, per: float, length: float) -> None:
    found = read_solar_spectrum(a_file(table(header, per, length), "folder/mine.csv"))
    assert (found.name, found.source) == ("mine", "folder/mine.csv")
    assert found.wavelength_nm == pytest.approx(PLANCK_NM)
    assert found.irradiance == pytest.approx(planck(PLANCK_NM), rel=1e-5)


@pytest.mark.parametrize(
    ("header", "per", "length", "assumed"),
    [
        ("# a spectrum", 1, 1, "nm and W m-2 nm-1"),
        ("# a spectrum", 1000, 1, "nm and W m-2 um-1"),
        ("# a spectrum", 1000, 1e-3, "um and W m-2 um-1"),
        ("wavelength,irradiance", 1, 1e-3, "um and W m-2 nm-1"),
        ("wavelength_um,irradiance", 1000, 1e-3, "um and W m-2 um-1"),
        ("wavelength,irradiance (W/m2/nm)", 1, 1, "nm and W m-2 nm-1"),
    ],
)
def test_units_left_out_are_told_by_the_integral(header: str, per: float, length: float, assumed: str) -> None:
    with pytest.warns(LunarSciWarning, match=rf"sun.csv: read as {assumed}, .* 11\d\d W m-2"):
        found = read_solar_spectrum(a_file(table(header, per, length)))
    assert found.wavelength_nm == pytest.approx(PLANCK_NM)
    assert found.irradiance == pytest.approx(planck(PLANCK_NM), rel=1e-5)


def test_the_smooth_sun_of_these_tests_is_as_bright_as_the_standards() -> None:
    for name in SOLAR_SPECTRA:
        spectrum = solar_spectrum(name)
        inside = (spectrum.wavelength_nm >= 430) & (spectrum.wavelength_nm <= 2430)
        standard = trapezoid(spectrum.irradiance[inside], spectrum.wavelength_nm[inside])
        assert quad(lambda x: float(planck(np.array(x))), 430, 2430)[0] == pytest.approx(standard, rel=0.01)


@pytest.mark.parametrize(
    ("separator", "header"),
    [
        ("\t", "wavelength_nm\tirradiance_w_m-2_nm-1"),
        (" ", "wavelength_nm irradiance_w_m-2_nm-1"),
        ("   ", "nm   W/m2/nm"),
    ],
)
def test_other_separators(separator: str, header: str) -> None:
    content = "\n".join([header, *(line.replace(",", separator) for line in table().splitlines()[1:])])
    assert read_solar_spectrum(a_file(content)).irradiance == pytest.approx(planck(PLANCK_NM), rel=1e-5)


def test_decimal_commas() -> None:
    content = table().replace(",", ";").replace(".", ",")
    assert read_solar_spectrum(a_file(content)).irradiance == pytest.approx(planck(PLANCK_NM), rel=1e-5)


def test_the_irradiance_is_picked_out_of_more_columns() -> None:
    head, *body = table().splitlines()
    wide = "\n".join(
        [f",fwhm_nm,{head},irradiance_sigma,global", *(f"{k},1,{row},0.1,5" for k, row in enumerate(body))]
    )
    assert read_solar_spectrum(a_file(wide)).irradiance == pytest.approx(planck(PLANCK_NM), rel=1e-5)


@pytest.mark.parametrize("header", ["nm,a,b,c", "nm,irradiance,extraterrestrial,x", "# none"])
def test_too_many_columns_to_choose_from(header: str) -> None:
    body = [f"{row},1,1" for row in table().splitlines()[1:]]
    with pytest.raises(DataError, match="columns may be the irradiance; keep two columns"):
        read_solar_spectrum(a_file("\n".join([header, *body])))


def ecsv(length: str, per: str) -> str:
    from astropy import units as u

    wavelength = (PLANCK_NM * u.nm).to_value(length)
    irradiance = (planck(PLANCK_NM) * u.Unit("W m-2 nm-1")).to_value(per)
    head = [
        "# %ECSV 1.0",
        "# ---",
        "# datatype:",
        f"# - {{name: lam, unit: {length}, datatype: float64}}",
        f"# - {{name: sun, unit: {per}, datatype: float64}}",
        "# schema: astropy-2.0",
        "lam sun",
    ]
    return "\n".join([*head, *(f"{w} {e}" for w, e in zip(wavelength, irradiance, strict=True))]) + "\n"


@pytest.mark.parametrize(
    ("length", "per"), [("nm", "W / (m2 nm)"), ("um", "W / (m2 um)"), ("Angstrom", "erg / (s cm2 Angstrom)")]
)
def test_ecsv_is_converted_by_its_units(length: str, per: str) -> None:
    found = read_solar_spectrum(a_file(ecsv(length, per), "sun.ecsv"))
    assert found.wavelength_nm == pytest.approx(PLANCK_NM)
    assert found.irradiance == pytest.approx(planck(PLANCK_NM))


def test_ecsv_without_units_is_told_by_the_integral() -> None:
    bare = ecsv("nm", "W / (m2 nm)").replace("unit: nm, ", "").replace("unit: W / (m2 nm), ", "")
    with pytest.warns(LunarSciWarning, match="read as nm and W m-2 nm-1"):
        assert read_solar_spectrum(a_file(bare)).irradiance == pytest.approx(planck(PLANCK_NM))


@pytest.mark.parametrize(
    ("old", "new"),
    [("unit: W / (m2 nm)", "unit: m"), ("unit: nm", "unit: K"), ("# datatype:", "# datatype: ]["), ("400.0 ", "x ")],
)
def test_broken_ecsv_is_refused(old: str, new: str) -> None:
    content = ecsv("nm", "W / (m2 nm)")
    assert old in content
    with pytest.raises(DataError, match=r"^sun.csv: unusable ECSV table"):
        read_solar_spectrum(a_file(content.replace(old, new, 1)))


def test_missing_value_in_ecsv_names_its_row() -> None:
    lines = ecsv("nm", "W / (m2 nm)").splitlines()
    lines[9] = lines[9].split()[0] + ' ""'
    with pytest.raises(DataError, match="row 3: irradiance is nan"):
        read_solar_spectrum(a_file("\n".join(lines)))


def changed(line: int, row: str) -> str:
    lines = table().splitlines()
    lines[line - 1] = row
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (changed(3, "402,"), "line 3: irradiance is nan"),
        (changed(3, "402,nan"), "line 3: irradiance is nan"),
        (changed(3, ",1.7"), "line 3: wavelength is nan"),
        (changed(3, "402,-1.7"), r"line 3: irradiance is -1.7, it must be a number above 0"),
        (changed(3, "402,0"), "line 3: irradiance is 0"),
        (changed(3, "402,inf"), "line 3: irradiance is inf"),
        (changed(3, "-402,1.7"), "line 3: wavelength is -402"),
        (changed(3, "400,1.7"), "line 3: a second 400; keep one row"),
        (changed(3, "402,dark"), "line 3, column 'irradiance_w_m-2_nm-1': 'dark' is not a number"),
        (changed(3, "402,1.7,3"), "line 3 has 3 fields, the others 2"),
        (changed(2, "oops,1.7"), "line 2, column 'wavelength_nm': 'oops' is not a number"),
        ("the quick brown fox\njumps over\n", "no line begins with a number"),
        ("# nothing\n", "no line begins with a number"),
        ("wavelength_nm,irradiance\n", "no line begins with a number"),
        ("400\n500\n600\n", "no columns may be the irradiance"),
        (" , \n,\n", "no columns may be the irradiance"),
        ("\n".join(table().splitlines()[:900]), r"wavelengths 400-2196 nm do not cover 430-2430 nm"),
        ("\n".join(table().splitlines()[20:]), r"wavelengths 438-2600 do not cover 430-2430 nm"),
        (table("wavelength_um,irradiance"), "wavelengths 400-2600 um do not cover"),
        (table("wavelength_cm,irradiance"), "has the unit 'cm'"),
        (table("wavelength_nm,irradiance_w_m-2_um-1"), r"integrates to 1.1\d W m-2 .* if in W m-2 um-1"),
        (table("wavelength_nm,irradiance_w_m-2_nm-1", 1000), r"integrates to 1.1\de\+06 W m-2 .* if in W m-2 nm-1"),
        (table("wavelength_nm,irradiance", 100), "integrates to"),
        (table("wavelength_nm,irradiance_w_m-2_nm-1", 0.75), "above the atmosphere"),
        (table("wavelength_nm,irradiance_w_m-2_nm-1", 1 / np.pi), "above the atmosphere"),
    ],
)
def test_unusable_files_say_what_and_where(content: str, what: str) -> None:
    with pytest.raises(DataError, match=what) as caught:
        read_solar_spectrum(a_file(content))
    assert str(caught.value).startswith("sun.csv: ")
    assert "\n" not in str(caught.value)


def test_names_that_are_too_few_say_nothing() -> None:
    with pytest.warns(LunarSciWarning, match="read as nm and W m-2 nm-1"):
        found = read_solar_spectrum(a_file(table("a spectrum of the Sun")))
    assert found.irradiance == pytest.approx(planck(PLANCK_NM), rel=1e-5)


def test_binary_content_is_refused() -> None:
    with pytest.raises(DataError, match="binary"):
        read_solar_spectrum(InputFile("sun.nc", b"CDF\x01\x00\x00\x00" * 50))


def test_rows_in_another_order_are_sorted_with_a_warning() -> None:
    head, *body = table().splitlines()
    with pytest.warns(LunarSciWarning, match="sorted by wavelength"):
        found = read_solar_spectrum(a_file("\n".join([head, *reversed(body)])))
    assert np.array_equal(found.wavelength_nm, PLANCK_NM)
    assert found.irradiance == pytest.approx(planck(PLANCK_NM), rel=1e-5)


@pytest.mark.parametrize(("factor", "off"), [(1.07, r"\+[67]\.\d%"), (0.9, r"-(9|10)\.\d%")])
def test_an_integral_some_per_cent_off_is_said(factor: float, off: str) -> None:
    with pytest.warns(LunarSciWarning, match=rf"is {off} off that of ASTM G173"):
        read_solar_spectrum(a_file(table(per=factor)))


@pytest.mark.parametrize("name", SOLAR_SPECTRA)
def test_the_own_tables_can_be_read_as_a_users(name: str) -> None:
    data = (files("lunarsci.spectra_data") / f"solar_{name}.csv").read_bytes()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = read_solar_spectrum(InputFile("again.csv", data))
    assert np.array_equal(found.wavelength_nm, solar_spectrum(name).wavelength_nm)
    assert np.array_equal(found.irradiance, solar_spectrum(name).irradiance)


@pytest.mark.reference
def test_a_table_of_one_detector_does_not_cover_the_channels(reference_data: Path) -> None:
    path = reference_data / "vnis/vnis_cmos_wl_fwhm_solar.csv"
    with pytest.raises(DataError, match="wavelengths 450-945 nm do not cover"):
        read_solar_spectrum(InputFile(str(path), path.read_bytes()))
