"""FITS tables: written by astropy, read back; cut and foreign ones refused."""

import io
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from astropy import units as u
from astropy.io import fits
from astropy.table import Table

from lunarsci.errors import LunarSciWarning
from lunarsci.spectra.spectrum import Spectrum

Read = Callable[..., list[Spectrum]]
Refuse = Callable[..., str]

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


def test_content_decides_whatever_the_name(read: Read) -> None:
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
        ({"wavelength_nm": np.eye(3)[:2], "rock": np.zeros((2, 3))}, "2 rows with wavelengths of their own"),
        ({"dark": np.zeros((2, 3)), "rock": np.zeros((2, 3))}, "2 rows of vector cells without wavelengths"),
        ({"wavelength_nm": np.zeros((1, 3)), "rock": np.zeros((1, 4))}, "differ in shape"),
        ({"wavelength_nm": np.zeros((1, 3, 2)), "rock": np.zeros((1, 3, 2))}, "more dimensions"),
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
