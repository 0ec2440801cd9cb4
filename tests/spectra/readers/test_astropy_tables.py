"""ECSV and FITS tables."""

import io
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from astropy import units as u
from astropy.io import fits
from astropy.table import MaskedColumn, Table

from lunarsci.errors import LunarSciWarning
from lunarsci.spectra.readers import astropy_tables
from lunarsci.spectra.spectrum import Spectrum

Read = Callable[..., list[Spectrum]]
Refuse = Callable[..., str]
BY_HAND = """# %ECSV 1.0
# ---
# datatype:
# - {name: wavelength, unit: um, datatype: float64}
# - {name: basalt, unit: '%', datatype: float64}
# - {name: basalt_sigma, unit: '%', datatype: float64}
# meta: {instrument: VNIS, drive: 12}
wavelength basalt basalt_sigma
0.4 10.0 1.0
0.5 "" 2.0
0.6 30.0 3.0
"""


def ecsv(columns: dict[str, Any], **meta: Any) -> bytes:
    stream = io.StringIO()
    Table(columns, meta=meta).write(stream, format="ascii.ecsv")
    return stream.getvalue().encode()


def test_units_metadata_and_masked_values(read: Read) -> None:
    (spectrum,) = read(BY_HAND, "rock.ecsv")
    np.testing.assert_allclose(spectrum.wavelength_nm, [400, 500, 600], rtol=1e-12)
    np.testing.assert_allclose(spectrum.reflectance, [0.1, np.nan, 0.3], rtol=1e-12)
    np.testing.assert_allclose(spectrum.uncertainty, [0.01, 0.02, 0.03], rtol=1e-12)
    assert spectrum.id == "basalt"
    assert spectrum.metadata["header"] == {"instrument": "VNIS", "drive": 12}
    assert spectrum.metadata["channels_missing"] == 1


@pytest.mark.parametrize("delimiter", [" ", ","])
@pytest.mark.parametrize(("unit", "share"), [("", 1.0), ("%", 100.0), (None, 1.0)])
def test_a_plain_table_is_read_as_astropy_reads_it(
    read: Read, monkeypatch: pytest.MonkeyPatch, delimiter: str, unit: str | None, share: float
) -> None:
    """Numbers of any digits, whole ones, widths, and a header whose values lists and mappings hold."""
    rng, wavelength = np.random.default_rng(4), np.linspace(450.0, 2400.0, 40)
    rock = share * rng.uniform(0.1, 0.4, 40)
    columns: dict[str, Any] = {"wavelength": wavelength * u.nm, "rock": rock, "rock_sigma": rock * 1e-7}
    columns |= {"width": np.full(40, 5.0) * u.nm, "whole": np.full(40, float(round(share)))}
    table = Table(columns, meta={"title": "µ", "notes": ["a", {"b": 1.5}], "none": None, "synthetic": True})
    for name in ("rock", "rock_sigma", "whole"):
        table[name].unit = unit
    stream = io.StringIO()
    table.write(stream, format="ascii.ecsv", delimiter=delimiter)
    assert astropy_tables._usual_columns(stream.getvalue()) is not None
    with pytest.warns(LunarSciWarning, match="left out 'width'"):
        plain = read(stream.getvalue(), "rock.ecsv")
        monkeypatch.setattr(astropy_tables, "_usual_columns", lambda text: None)
        slow = read(stream.getvalue(), "rock.ecsv")
    assert [one.id for one in plain] == ["rock", "whole"]
    for one, other in zip(plain, slow, strict=True):
        assert (one.id, one.metadata) == (other.id, other.metadata)
        np.testing.assert_array_equal(one.wavelength_nm, other.wavelength_nm)
        np.testing.assert_array_equal(one.reflectance, other.reflectance)
        np.testing.assert_array_equal(one.uncertainty, other.uncertainty)


def test_a_plain_table_needs_no_astropy() -> None:
    lines = [line for line in BY_HAND.splitlines() if '""' not in line]
    columns, names, units, meta = astropy_tables._usual_columns("\n".join(lines)) or pytest.fail("astropy is needed")
    assert (names, units) == (["wavelength", "basalt", "basalt_sigma"], ["um", "percent", "percent"])
    assert columns.tolist() == [[0.4, 0.6], [10.0, 30.0], [1.0, 3.0]]
    assert meta == {"instrument": "VNIS", "drive": 12}
    assert astropy_tables._usual_columns(BY_HAND) is None


@pytest.mark.parametrize(
    "change",
    [
        ("0.5 20.0 2.0", "0.5  2.0"),
        ("# %ECSV 1.0", "# %ECSV"),
        ("rock, datatype: float64", "rock, datatype: int64"),
        ("# datatype:", "# delimiter: ';'\n# datatype:"),
        ("# schema", "# meta: {a: !!omap [b: 1]}\n# schema"),
    ],
)
def test_what_is_no_plain_table_is_left_to_astropy(change: tuple[str, str]) -> None:
    made = ecsv({"wavelength": [0.4, 0.5] * u.um, "rock": [10.0, 20.0], "rock_sigma": [1.0, 2.0]}).decode()
    assert astropy_tables._usual_columns(made) is not None and change[0] in made
    assert astropy_tables._usual_columns(made.replace(*change, 1)) is None


@pytest.mark.parametrize("unit", ["micron", "1000 pm"])
def test_nm_and_um_by_other_names_are_read(read: Read, unit: str) -> None:
    values = [0.4, 0.5] if unit == "micron" else [400.0, 500.0]
    (spectrum,) = read(ecsv({"wavelength": values * u.Unit(unit), "rock": [0.1, 0.2]}), "rock.ecsv")
    assert spectrum.wavelength_nm.tolist() == pytest.approx([400, 500])


def test_content_decides_whatever_the_name(read: Read) -> None:
    assert read(BY_HAND, "rock.csv")[0].metadata["format"] == "ecsv"


@pytest.mark.parametrize("unit", ["nm", "um", "Angstrom", "m", "cm-1", "eV", "THz"])
@pytest.mark.parametrize("name", ["wavelength", "x"])
def test_every_spectral_unit_gives_the_same_wavelengths(read: Read, unit: str, name: str) -> None:
    truth = np.array([400.0, 1000.0, 2500.0])
    # c = 299792458 m/s and hc = 1239.841984 eV nm (CODATA 2018)
    written = {
        "nm": truth,
        "um": truth / 1e3,
        "Angstrom": truth * 10,
        "m": truth / 1e9,
        "cm-1": 1e7 / truth,
        "eV": 1239.841984332 / truth,
        "THz": 299792.458 / truth,
    }[unit]
    data = ecsv({name: written * u.Unit(unit), "rock": [0.1, 0.2, 0.3]})
    (spectrum,) = read(data, "rock.ecsv")
    np.testing.assert_allclose(spectrum.wavelength_nm, truth, rtol=1e-9)
    np.testing.assert_array_equal(spectrum.reflectance, [0.1, 0.2, 0.3])
    assert spectrum.metadata["wavelength_unit_from"] == "file"


def test_round_trip_of_many_columns(read: Read) -> None:
    rng = np.random.default_rng(5)
    wavelength = np.linspace(450, 2400, 391)
    values = rng.uniform(0.01, 0.9, (4, 391)) * [[1], [0.001], [1], [0.001]]
    names = ["a", "a_err", "b", "b_uncertainty"]
    data = ecsv({"wavelength_nm": wavelength, **dict(zip(names, values, strict=True))})
    a, b = read(data, "rock.ecsv")
    for spectrum, k in ((a, 0), (b, 2)):
        np.testing.assert_array_equal(spectrum.wavelength_nm, wavelength)
        np.testing.assert_array_equal(spectrum.reflectance, values[k])
        np.testing.assert_array_equal(spectrum.uncertainty, values[k + 1])
    assert (a.id, b.id) == ("a", "b")


def test_masked_integers_are_missing(read: Read) -> None:
    column = MaskedColumn([10, 20, 30], mask=[False, True, False], unit=u.percent)
    (spectrum,) = read(ecsv({"wavelength": [400, 500, 600] * u.nm, "rock": column}), "rock.ecsv")
    np.testing.assert_allclose(spectrum.reflectance, [0.1, np.nan, 0.3])


def test_fwhm_text_and_physical_units_are_left_out_and_said(read: Read) -> None:
    columns = {
        "wavelength": [400.0, 500.0] * u.nm,
        "fwhm": [8.0, 8.0] * u.nm,
        "note": ["good", "bad"],
        "signal": [1.0, 2.0] * u.W,
        "rock": [0.1, 0.2],
    }
    with pytest.warns(LunarSciWarning, match="left out 'fwhm', 'note', 'signal'"):
        (spectrum,) = read(ecsv(columns), "rock.ecsv")
    assert spectrum.id == "rock"


def test_without_units_the_rules_of_text_hold(read: Read) -> None:
    with pytest.warns(LunarSciWarning, match="read as µm"):
        (spectrum,) = read(ecsv({"wavelength": [0.4, 2.5], "rock": [0.1, 0.2]}), "rock.ecsv")
    np.testing.assert_allclose(spectrum.wavelength_nm, [400, 2500])


@pytest.mark.parametrize("word", ["microns", "micrometers"])
def test_plain_words_for_units_are_known(read: Read, word: str) -> None:
    (spectrum,) = read(BY_HAND.replace("unit: um", f"unit: {word}"), "rock.ecsv")
    np.testing.assert_allclose(spectrum.wavelength_nm, [400, 500, 600])


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (("unit: um", "unit: nm"), "cannot be nm as the file says"),
        (("unit: um", "unit: furlong"), "unit 'furlong', which is no wavelength"),
        (("unit: um", "unit: kg"), "no wavelength"),
        (("basalt_sigma", "basalt"), "two columns are named 'basalt'"),
        (("0.6 30.0 3.0\n", "0.6 30"), "broken ECSV"),
        (("datatype: float64}", "datatype: float64"), "broken ECSV"),
        (("30.0", "30.o"), "broken ECSV"),
        (('0.4 10.0 1.0\n0.5 "" 2.0\n0.6 30.0 3.0\n', ""), "0 rows"),
    ],
)
def test_broken_tables_are_refused_in_one_line(refuse: Refuse, change: tuple[str, str], reason: str) -> None:
    assert change[0] in BY_HAND
    assert reason in refuse(BY_HAND.replace(*change), "rock.ecsv")


def cut_shows(length: int) -> bool:
    """Between two rows, and within the last number of one, no reader can tell a cut."""
    last = BY_HAND[:length].rpartition("\n")[2]
    return last.startswith("#") or 0 < len(last.split()) < 3


@pytest.mark.parametrize("length", list(filter(cut_shows, range(20, len(BY_HAND), 7))))
def test_a_cut_that_shows_is_refused(refuse: Refuse, length: int) -> None:
    assert refuse(BY_HAND[:length], "rock.ecsv").startswith("rock.ecsv: ")


def test_two_spectral_columns_without_a_name_are_refused(refuse: Refuse) -> None:
    data = ecsv({"x": [400, 500] * u.nm, "y": [400, 500] * u.nm, "rock": [0.1, 0.2]})
    assert "both have a spectral unit" in refuse(data, "rock.ecsv")


def test_an_ecsv_name_without_its_mark_is_text(read: Read) -> None:
    (spectrum,) = read("wavelength_nm,R\n400,.1\n500,.2\n", "rock.ecsv")
    assert spectrum.metadata["format"] == "text"
    np.testing.assert_array_equal(spectrum.reflectance, [0.1, 0.2])


WAVELENGTH = np.linspace(450, 2400, 391)
REFLECTANCE = np.random.default_rng(8).uniform(0.01, 0.9, 391)


def as_fits(columns: dict[str, Any], **meta: Any) -> bytes:
    stream = io.BytesIO()
    Table(columns, meta=meta).write(stream, format="fits")
    return stream.getvalue()


def test_round_trip_of_scalar_rows(read: Read) -> None:
    columns = {"wavelength": WAVELENGTH * u.nm, "rock": REFLECTANCE, "rock_err": REFLECTANCE / 100}
    (spectrum,) = read(as_fits(columns, TARGET="LE03"), "rock.fits")
    np.testing.assert_array_equal(spectrum.wavelength_nm, WAVELENGTH)
    np.testing.assert_array_equal(spectrum.reflectance, REFLECTANCE)
    np.testing.assert_array_equal(spectrum.uncertainty, REFLECTANCE / 100)
    assert spectrum.id == "rock"
    assert spectrum.metadata["header"] == {"TARGET": "LE03"}


def test_round_trip_of_one_row_of_vectors(read: Read) -> None:
    columns = {"wavelength": [WAVELENGTH / 1e3] * u.um, "R": [REFLECTANCE * 100] * u.percent, "site": ["LE03"]}
    (spectrum,) = read(as_fits(columns), "rock.fits")
    np.testing.assert_allclose(spectrum.wavelength_nm, WAVELENGTH, rtol=1e-12)
    np.testing.assert_allclose(spectrum.reflectance, REFLECTANCE, rtol=1e-12)
    assert (spectrum.id, spectrum.metadata["header"]) == ("rock", {"site": "LE03"})


def test_content_decides_whatever_the_name_fits(read: Read) -> None:
    data = as_fits({"wavelength_nm": WAVELENGTH, "rock": REFLECTANCE})
    assert read(data, "rock.dat")[0].metadata["format"] == "fits"


def test_nan_is_missing(read: Read) -> None:
    (spectrum,) = read(as_fits({"wavelength_nm": [400.0, 500.0], "rock": [0.1, np.nan]}), "rock.fits")
    np.testing.assert_array_equal(spectrum.reflectance, [0.1, np.nan])


def test_the_first_table_with_two_columns_is_read(read: Read) -> None:
    small = fits.table_to_hdu(Table({"time": [1.0]}))
    right = fits.table_to_hdu(Table({"wavelength_nm": [400.0, 500.0], "rock": [0.1, 0.2]}))
    stream = io.BytesIO()
    fits.HDUList([fits.PrimaryHDU(np.zeros((3, 3))), small, right]).writeto(stream)
    assert read(stream.getvalue(), "rock.fits")[0].id == "rock"


def test_duplicates_are_named_by_row(refuse: Refuse) -> None:
    data = as_fits({"wavelength_nm": [400.0, 500.0, 400.0], "rock": [0.1, 0.2, 0.3]})
    assert "row 1 and row 3 have the same wavelength, 400 nm" in refuse(data, "rock.fits")


@pytest.mark.parametrize("length", [30, 100, 2880, 4000, 5760, 5765, 8000, 14399])
def test_truncated_files_are_refused_in_one_line(refuse: Refuse, length: int) -> None:
    data = as_fits({"wavelength_nm": WAVELENGTH, "rock": REFLECTANCE})
    assert len(data) == 5 * 2880
    message = refuse(data[:length], "rock.fits")
    assert "truncated" in message or "no FITS table" in message


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
def test_a_header_of_noise_is_refused(refuse: Refuse) -> None:
    data = bytearray(as_fits({"wavelength_nm": WAVELENGTH, "rock": REFLECTANCE}))
    data[2880:5760] = b"x" * 2880
    assert refuse(bytes(data), "rock.fits").startswith("rock.fits: ")


def test_an_image_is_refused(refuse: Refuse) -> None:
    stream = io.BytesIO()
    fits.PrimaryHDU(np.zeros(100)).writeto(stream)
    assert "no FITS table with two columns" in refuse(stream.getvalue(), "rock.fits")


@pytest.mark.parametrize(
    ("columns", "reason"),
    [
        ({"wavelength_nm": np.eye(3)[:2], "rock": np.zeros((2, 3))}, "2 rows of vectors without common wavelengths"),
        ({"dark": np.zeros((2, 3)), "rock": np.zeros((2, 3))}, "2 rows of vectors without common wavelengths"),
        ({"wavelength_nm": np.zeros((1, 3)), "rock": np.zeros((1, 4))}, "differ in shape"),
        ({"wavelength_nm": np.zeros((1, 3, 2)), "rock": np.zeros((1, 3, 2))}, "does not hold one number a row"),
        ({"note": ["a", "b"], "other": ["c", "d"]}, "no reflectance column"),
    ],
)
def test_tables_of_another_shape_are_refused(refuse: Refuse, columns: dict[str, Any], reason: str) -> None:
    assert reason in refuse(as_fits(columns), "rock.fits")


def test_remarks_of_astropy_are_passed_on_with_the_files_name(read: Read) -> None:
    hdu = fits.table_to_hdu(Table({"wavelength_nm": [400.0, 500.0], "rock": [0.1, 0.2]}))
    hdu.header["TUNIT2"] = "albedoes"
    stream = io.BytesIO()
    hdu.writeto(stream)
    with (
        pytest.warns(LunarSciWarning, match=r"^rock\.fits: ") as said,
        pytest.raises(ValueError, match="no reflectance"),
    ):
        read(stream.getvalue(), "rock.fits")
    assert all(str(w.message).startswith("rock.fits: ") for w in said if w.category is LunarSciWarning)


def test_a_fits_name_on_another_content_is_refused(refuse: Refuse) -> None:
    assert "SIMPLE" in refuse("wavelength_nm,R\n400,.1\n", "rock.fits")
