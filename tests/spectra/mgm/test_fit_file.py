"""`.fit` files: an example of the literature read field by field, round trips, refusals, and models made from them."""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.io.inputs import InputFile, read_input
from lunarsci.minerals import MINERALS
from lunarsci.spectra.mgm.damping import fit_damping
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.fit_file import (
    FitBand,
    FitFile,
    fit_file_of,
    fit_file_text,
    model_of,
    parse_minerals,
    read_fit_file,
    read_start,
)
from lunarsci.spectra.mgm.model import mgm_model
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.readers.dispatch import read_spectra
from lunarsci.spectra.spectrum import Spectrum

EXAMPLE = """C:\\data\\
sample.asc
-100,25,10
450,2400,1
2E-03,1E-06
Q
0.85 -1e-6 0 0
10 1e-4 1e-7 1e-7
3
333 400 -20
1e4 1e4 100
1000 250 -1
200 400 10
2000 300 -1
300 400 10
"""
ROWS = EXAMPLE.splitlines()
GRID = np.arange(450.0, 2396.0, 5.0)


def read(content: str | bytes) -> FitFile:
    return read_fit_file(InputFile("start.fit", content.encode() if isinstance(content, str) else content))


def with_row(number: int, row: str) -> str:
    return "\n".join([*ROWS[: number - 1], row, *ROWS[number:]])


FILE = read(EXAMPLE)


def test_every_field_is_where_the_layout_has_it() -> None:
    expected = FitFile(
        folder="C:\\data\\",
        spectrum="sample.asc",
        plot_axis=(-100.0, 25.0, 10.0),
        wavelength_axis=(450.0, 2400.0, 1.0),
        rms_limit=0.002,
        improvement_limit=1e-6,
        continuum="Q",
        coefficients=(0.85, -1e-6, 0.0, 0.0),
        coefficients_95=(10.0, 1e-4, 1e-7, 1e-7),
        bands=(
            FitBand(333.0, 400.0, -20.0, 1e4, 1e4, 100.0),
            FitBand(1000.0, 250.0, -1.0, 200.0, 400.0, 10.0),
            FitBand(2000.0, 300.0, -1.0, 300.0, 400.0, 10.0),
        ),
    )
    assert expected == FILE


@pytest.mark.parametrize(
    "content",
    [
        EXAMPLE.replace("\n", "\r\n"),
        EXAMPLE.replace("\n", "\r"),
        EXAMPLE.rstrip("\n"),
        EXAMPLE + "\n \n",
        EXAMPLE.replace(" ", "\t"),
        EXAMPLE.replace(" ", ", "),
        EXAMPLE.replace("\n", "  \n "),
        EXAMPLE.replace("1e4", "1.0D+04").replace("e-", "E-"),
        with_row(6, "q  polynomial in wavenumber"),
        with_row(6, "Q: cubic"),
        with_row(9, "3 bands of 3 values"),
        with_row(10, "333 400 -20 ! ultraviolet"),
        EXAMPLE + "remarks below the bands\n",
        b"\xef\xbb\xbf" + EXAMPLE.encode(),
        EXAMPLE.encode("utf-16"),
    ],
)
def test_spellings_of_the_same_file(content: str | bytes) -> None:
    assert read(content) == FILE


def test_folder_may_be_empty() -> None:
    assert read(with_row(1, "")) == replace(FILE, folder="")


def test_a_folder_that_is_not_utf8_is_read_and_remarked_on() -> None:
    with pytest.warns(LunarSciWarning, match=r"start\.fit: is not valid UTF-8"):
        assert read(with_row(1, "Donn\xe9es\\").encode("latin-1")).folder == "Donn\xe9es\\"


@pytest.mark.parametrize("kept", range(1, len(ROWS)))
def test_a_file_cut_off_at_any_line_is_refused(kept: int) -> None:
    with pytest.raises(DataError, match=r"^start\.fit: line \d+: .*cut off") as caught:
        read("\n".join(ROWS[:kept]))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("missing", range(1, len(ROWS) + 1))
def test_a_file_without_one_of_its_lines_is_refused(missing: int) -> None:
    with pytest.raises(DataError, match=r"^start\.fit: line \d+: "):
        read("\n".join(ROWS[: missing - 1] + ROWS[missing:]))


@pytest.mark.parametrize("empty", range(2, len(ROWS)))
def test_an_empty_line_is_refused_by_its_number(empty: int) -> None:
    with pytest.raises(DataError, match=rf"^start\.fit: line {empty}: is empty"):
        read(with_row(empty, "  "))


@pytest.mark.parametrize(
    ("number", "row", "fault"),
    [
        (3, "-100,25", "not 3 numbers"),
        (3, "-100,25,many", "not 3 numbers"),
        (4, "450,inf,1", "not 3 numbers"),
        (4, "450,1e999,1", "finite"),
        (10, "0.333 0.4 -20", "is this um"),
        (4, "450,2400,1,7", "not 3 numbers"),
        (5, "-2e-3,1e-6", "0 or above"),
        (5, "nan,1e-6", "not 2 numbers"),
        (6, "X", "unknown; give one letter of Q, T, P, S, N"),
        (6, "Quadratic", "letter"),
        (6, "2", "letter"),
        (7, "0.85 -1e-6 0", "not 4 numbers"),
        (7, "0.85 inf 0 0", "not 4 numbers"),
        (7, "0.85 1e999 0 0", "finite"),
        (7, "0,85 -1e-6 0 0", "not 4 numbers"),
        (8, "10 -1e-4 1e-7 1e-7", "from 0 to 1e15"),
        (7, "0.85 1e16 0 0", "up to 1e15"),
        (10, "1e-7 400 -20", "centre of 0 nm"),
        (12, "1000 250 1e300", "beyond 1e15"),
        (13, "200 1e16 10", "beyond 1e15"),
        (8, "10 1_0 1e-7 1e-7", "not 4 numbers"),
        (9, "0", "number of bands"),
        (9, "-3", "number of bands"),
        (9, "2.5", "number of bands"),
        (9, "three", "not 1 numbers"),
        (9, "1e999", "number of bands"),
        (10, "0 400 -20", "centre of 0 nm"),
        (10, "333 0 -20", "FWHM of 0 nm"),
        (12, "1000 250 NaN", "not 3 numbers"),
        (12, "1000 250 \u0661", "not 3 numbers"),
        (13, "200 400 -10", "of FWHM and strength, below 0; values come first"),
    ],
)
def test_what_does_not_follow_the_layout_is_refused_by_its_line(number: int, row: str, fault: str) -> None:
    with pytest.raises(DataError, match=rf"^start\.fit: line {number}: .*{fault}") as caught:
        read(with_row(number, row))
    assert "\n" not in str(caught.value)


def test_a_wrong_number_of_bands_is_refused() -> None:
    with pytest.raises(DataError, match="line 14: holds numbers behind the last of 2 bands; correct line 9"):
        read(with_row(9, "2"))
    for count in ("4", "1000000000"):
        with pytest.raises(DataError, match="line 16: is missing"):
            read(with_row(9, count))


@pytest.mark.parametrize("content", [b"\0\1\2", b" \n \n", b"<html></html>", b"\xff\xfeQ"])
def test_other_files_are_refused(content: bytes) -> None:
    with pytest.raises(DataError, match=r"start\.fit"):
        read(content)


@given(st.binary(max_size=12), st.integers(0, len(EXAMPLE)), st.integers(0, 12))
@settings(max_examples=300, deadline=None)
def test_a_spoiled_file_is_read_or_refused_in_one_line(part: bytes, at: int, removed: int) -> None:
    content = EXAMPLE.encode()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LunarSciWarning)
        try:
            file = read(content[:at] + part + content[at + removed :])
        except DataError as error:
            assert "\n" not in str(error)
        else:
            assert read(fit_file_text(file)) == file


FINITE = st.floats(-1e15, 1e15)
NOT_BELOW_0 = st.floats(0, 1e15)
CENTRES = st.floats(10, 1e15)
BANDS = st.builds(
    FitBand,
    CENTRES,
    FINITE.filter(lambda value: abs(value) > 1e-5),
    FINITE,
    FINITE,
    NOT_BELOW_0,
    NOT_BELOW_0,
    mineral=st.sampled_from(["", *MINERALS]),
)


@given(
    st.builds(
        FitFile,
        folder=st.sampled_from(["", "C:\\data\\", "Größe", "a b, c"]),
        spectrum=st.sampled_from(["sample.asc", "3 bands", "N"]),
        plot_axis=st.tuples(FINITE, FINITE, FINITE),
        wavelength_axis=st.tuples(st.floats(1, 400), st.floats(500, 1e9), FINITE),
        rms_limit=NOT_BELOW_0,
        improvement_limit=NOT_BELOW_0,
        continuum=st.sampled_from("QTPSN"),
        coefficients=st.tuples(*[FINITE] * 4),
        coefficients_95=st.tuples(*[NOT_BELOW_0] * 4),
        bands=st.lists(BANDS, min_size=1, max_size=4).map(tuple),
    )
)
def test_what_is_written_reads_back_equal(file: FitFile) -> None:
    assert read(fit_file_text(file)) == file


@pytest.mark.parametrize(
    "change",
    [
        {"folder": "two\nlines"},
        {"spectrum": " blank"},
        {"spectrum": ""},
        {"plot_axis": (1.0, 2.0)},
        {"continuum": "log-quadratic"},
        {"coefficients": (1.0, 0.0, 0.0, np.nan)},
        {"coefficients_95": (1.0, 0.0)},
        {"bands": ()},
        {"bands": (FitBand(1000.0, np.inf, -1.0, 1.0, 1.0, 1.0),)},
    ],
)
def test_a_file_that_could_not_be_read_back_cannot_be_made(change: dict[str, object]) -> None:
    with pytest.raises(ParameterError, match=r"^line \d+: "):
        replace(FILE, **change)


def raw_polynomial(letter: str, coefficients: tuple[float, ...], wavelength_nm: np.ndarray) -> np.ndarray:
    """The continuum as the file writes it: c0 + c1 v + ... in cm^-1 (Q, T) or nm (P, S)."""
    v = 1e7 / wavelength_nm if letter in "QT" else wavelength_nm
    used = coefficients[:4]
    return sum(c * v**k for k, c in enumerate(used))


RAW = {
    "Q": ((0.85, -1e-5, 2e-10, 3e-15), (0.1, 1e-5, 1e-9, 1e-13)),
    "T": ((0.85, -1e-5, 2e-10, 3e-15), (0.1, 1e-5, 1e-9, 1e-13)),
    "P": ((0.2, 1e-4, -3e-8, 4e-12), (0.1, 1e-4, 1e-7, 1e-11)),
    "S": ((0.2, 1e-4, -3e-8, 4e-12), (0.1, 1e-4, 1e-7, 1e-11)),
}


@pytest.mark.parametrize("letter", RAW)
def test_continuum_and_its_prior_are_the_same_in_our_variable(letter: str) -> None:
    """Mean of C by the raw polynomial; its variance sum over k of (sigma_k v^k)^2 by propagation of raw errors."""
    values, errors = RAW[letter]
    model = model_of(replace(FILE, continuum=letter, coefficients=values, coefficients_95=errors))
    m, basis = model.degrees, model.basis(GRID)
    assert basis @ model.prior[:m] == pytest.approx(raw_polynomial(letter, values, GRID), rel=1e-10)
    squares = tuple((error / 1.96) ** 2 for error in errors)
    v = 1e7 / GRID if letter in "QT" else GRID
    expected = sum(s * v ** (2 * k) for k, s in enumerate(squares[:m]))
    covariance = np.linalg.inv(model.precision[:m, :m])
    assert np.einsum("ni,ij,nj->n", basis, covariance, basis) == pytest.approx(expected, rel=1e-6)


def test_no_continuum() -> None:
    model = model_of(replace(FILE, continuum="N"))
    assert (model.continuum, model.degrees, model.prior.size) == ("none", 0, 9)


def test_bands_become_a_prior_in_micrometres() -> None:
    model = model_of(replace(FILE, coefficients=(0.85, -1e-6, 1e-12, 1e-17)))
    assert model.continuum == "wavenumber-cubic"
    assert [band.name for band in model.assemblage.bands] == ["band 1", "band 2", "band 3"]
    assert [band.region for band in model.assemblage.bands] == ["uv", "um1", "um2"]
    assert model.names[4:7] == ("band_1_center_nm", "band_1_fwhm_nm", "band_1_strength")
    assert model.prior[7:10] == pytest.approx([1.0, 0.25, -1.0])
    assert model.sigma[7:10] == pytest.approx([0.2 / 1.96, 0.4 / 1.96, 10 / 1.96])
    assert model.upper[4:] == pytest.approx(np.inf)
    assert np.all(model.lower[5::3] > 0)
    assert np.all(np.isneginf(model.lower[6::3]))
    assert not model.fixed.any()


def test_regions_follow_the_centre() -> None:
    centres = (399.0, 400.0, 749.0, 750.0, 1499.0, 1500.0)
    bands = tuple(replace(FILE.bands[0], center_nm=centre) for centre in centres)
    regions = [band.region for band in model_of(replace(FILE, bands=bands)).assemblage.bands]
    assert regions == ["uv", "visible", "visible", "um1", "um1", "um2"]


def made(noise: float = 0.003, seed: int = 1) -> Spectrum:
    """Two bands on a straight line in wavenumber."""
    ln = np.log(0.5 - 1e-5 * 1e7 / GRID)
    for centre, fwhm, strength in ((950.0, 200.0, -0.5), (1950.0, 500.0, -0.3)):
        ln = ln + strength * np.exp(-4 * np.log(2) * ((GRID - centre) / fwhm) ** 2)
    ln = ln + np.random.default_rng(seed).normal(scale=noise, size=GRID.size)
    return Spectrum("made by hand", GRID, np.exp(ln), noise * np.exp(ln))


TWO = replace(FILE, continuum="T", coefficients=(0.6, -1e-9, 0.0, 0.0), bands=FILE.bands[1:])


def map_fit(file: FitFile) -> MgmFit:
    [fit] = fit_spectra([made()], model_of(file), model_error=1e-3)
    assert fit.converged
    return fit


def test_map_mode_fits_the_model_of_a_file() -> None:
    fit = map_fit(TWO)
    assert fit.bands[0].center_nm == pytest.approx(950, abs=3)
    assert fit.bands[1].strength == pytest.approx(-0.3, abs=0.01)
    assert fit.rms_ln == pytest.approx(0.003, rel=0.1)


def test_a_result_file_says_what_the_fit_says() -> None:
    fit = map_fit(TWO)
    file = fit_file_of(fit)
    assert (file.folder, file.spectrum, file.continuum) == ("", "made by hand", "T")
    assert file.wavelength_axis[:2] == (450.0, 2395.0)
    assert (file.rms_limit, file.improvement_limit) == (2e-3, 1e-6)
    assert raw_polynomial("T", file.coefficients, GRID) == pytest.approx(fit.continuum_reflectance, rel=1e-9)
    assert file.coefficients == pytest.approx((0.5, -1e-5, 0, 0), rel=0.05)
    assert all(file.coefficients)
    gradient = np.vander(1e7 / GRID, 2, increasing=True)
    basis = fit.model.basis(GRID)
    covariance = np.linalg.lstsq(gradient, basis, rcond=None)[0]
    covariance = covariance @ fit.covariance[:2, :2] @ covariance.T
    assert file.coefficients_95 == pytest.approx([*(1.96 * np.sqrt(np.diag(covariance))), 0, 0], rel=1e-6)
    for band, fitted in zip(file.bands, fit.bands, strict=True):
        assert band.values == pytest.approx((fitted.center_nm, fitted.fwhm_nm, fitted.strength))
        errors = (fitted.center_sigma_nm, fitted.fwhm_sigma_nm, fitted.strength_sigma)
        around = 1.96 * errors[0] * 1e7 / fitted.center_nm**2
        ends = [1e7 / (1e7 / fitted.center_nm + sign * around) for sign in (-1, 1)]
        assert band.center_95_nm == pytest.approx(ends[0] - ends[1])
        assert band.uncertainties[1:] == pytest.approx([1.96 * error for error in errors[1:]])
    assert model_of(read(fit_file_text(file))).prior == pytest.approx(fit.parameters)
    assert fit_file_of(fit, FILE) == replace(
        FILE, coefficients=file.coefficients, coefficients_95=file.coefficients_95, bands=file.bands
    )


@pytest.mark.parametrize("name", ["wavenumber", "wavenumber-quadratic", "wavelength-quadratic", "wavelength", "none"])
def test_continua_survive_the_way_through_a_file(name: str) -> None:
    [fit] = fit_spectra([made()], mgm_model("OPX", name))
    again = model_of(fit_file_of(fit))
    assert again.continuum == name
    assert again.prior == pytest.approx(fit.parameters, rel=1e-9, abs=1.1e-9)


def test_a_continuum_without_a_letter_is_refused() -> None:
    [fit] = fit_spectra([made()], mgm_model("OPX", "log-quadratic"))
    assert isinstance(fit, MgmFit)
    with pytest.raises(ParameterError, match="no letter for the continuum log-quadratic"):
        fit_file_of(fit)


def test_a_fit_without_errors_is_refused() -> None:
    fit = map_fit(TWO)
    with pytest.raises(ParameterError, match="no errors"):
        fit_file_of(replace(fit, covariance=np.full_like(fit.covariance, np.nan)))


def test_an_uncertainty_of_0_fixes_a_value() -> None:
    band = replace(FILE.bands[1], center_nm=940.0, center_95_nm=0.0)
    fit = map_fit(replace(TWO, bands=(band, FILE.bands[2])))
    assert fit.bands[0].center_nm == 940.0
    assert fit.bands[0].center_sigma_nm == 0.0
    again = model_of(fit_file_of(fit))
    assert again.fixed[2]
    assert again.prior[2] == pytest.approx(0.94, rel=1e-15)
    continuum = replace(TWO, coefficients=(0.5, -1e-5, 0, 0), coefficients_95=(0, 0, 0, 0))
    assert fit_file_of(map_fit(continuum)).coefficients == pytest.approx((0.5, -1e-5, 0, 0), rel=1e-9)


def test_one_fixed_continuum_coefficient_ties_ours() -> None:
    """The slope is held to a millionth of the reflectance at the shortest wavelength, while the level is free."""
    fit = map_fit(replace(TWO, coefficients=(0.6, -0.9e-5, 0, 0), coefficients_95=(10, 0, 0, 0)))
    file = fit_file_of(fit)
    assert file.coefficients[1] == pytest.approx(-0.9e-5, abs=1e-6 / 25000)
    assert file.coefficients[0] == pytest.approx(0.5, abs=0.03)
    assert file.coefficients_95[1] * 25000 < 1e-5 < file.coefficients_95[0]


@pytest.mark.parametrize(
    ("letter", "values", "errors", "continuum"),
    [
        ("Q", (0.5, 0, 1e-12, 0), (1, 1, 1, 1), "wavenumber-quadratic"),
        ("Q", (0.5, 0, 0, 0), (1, 1, 1, 1), "wavenumber"),
        ("Q", (0.5, 0, 0, 1e-15), (1, 1, 1, 0), "wavenumber-cubic"),
        ("T", (0.5, 0, 1e-12, 1e-15), (1, 1, 1, 1), "wavenumber-cubic"),
        ("T", (0.5, 0, 1e-26, 1e-30), (1, 1, 1e-26, 1e-30), "wavenumber"),
        ("P", (0.5, 0, 1e-12, 0), (1, 1, 1, 1), "wavelength-quadratic"),
        ("S", (0.5, 0, 1e-12, 0), (1, 1, 1, 1), "wavelength-quadratic"),
        ("P", (0.5, 0, 0, 0), (1, 0, 1, 1), "wavelength"),
    ],
)
def test_coefficients_of_0_are_held_and_lower_the_degree(
    letter: str, values: tuple[float, ...], errors: tuple[float, ...], continuum: str
) -> None:
    assert model_of(replace(FILE, continuum=letter, coefficients=values, coefficients_95=errors)).continuum == continuum


def test_the_axis_of_the_plot_cuts_nothing() -> None:
    """Nor does the range of the named minerals: what the program is given it fits, here from 300 to 2700 nm."""
    grid = np.arange(300.0, 2701.0, 10.0)
    wide = Spectrum("wide", grid, np.full(grid.size, 0.5))
    file = read(with_row(4, "600,1700,1"))
    for fit in (*fit_spectra([wide], model_of(file), starts=1), *fit_damping([wide], model_of(file), file=file)):
        assert fit.wavelength_nm.tolist() == grid.tolist()


NO_CONTINUUM = "\n".join([*ROWS[:5], "N", *ROWS[8:]]) + "\n"


def test_result_files_without_a_continuum_lack_its_lines() -> None:
    """So the program writes them; a start file for it has them, and they count for nothing."""
    file = read(NO_CONTINUUM)
    assert (file.continuum, file.coefficients, file.coefficients_95) == ("N", (), ())
    assert file.bands == FILE.bands
    assert fit_file_text(file).splitlines()[5:7] == ["N", "3"]
    assert model_of(file).prior == pytest.approx(model_of(read(with_row(6, "N"))).prior)
    fit = from_start(file)
    assert fit.continuum == "none"
    assert len(fit_file_of(fit, file).coefficients) == 4
    with pytest.raises(DataError, match="line 10: band 2: FWHM of 0 nm"):
        read(NO_CONTINUUM.replace("1000 250", "1000 0"))
    with pytest.raises(DataError, match="line 14: is missing"):
        read(NO_CONTINUUM.replace("N\n3", "N\n4"))
    with pytest.raises(DataError, match=r"line 7: .*not 4 numbers"):
        read(NO_CONTINUUM.replace("N\n3", "T\n3"))


def from_start(file: FitFile) -> MgmFit:
    [fit] = fit_damping([made()], model_of(file), file=file)
    assert isinstance(fit, MgmFit)
    return fit


def test_the_sign_of_a_centre_s_uncertainty_has_no_meaning_in_damping() -> None:
    """The program writes one below 0 where the error exceeds the wavenumber, and squares what it reads."""
    other = read(EXAMPLE.replace("200 400 10", "-200 400 10"))
    assert other.bands[1].center_95_nm == -200.0
    assert from_start(other).parameters.tolist() == from_start(FILE).parameters.tolist()


@pytest.mark.parametrize("width", [-0.02, -200.0, -1e5])
def test_a_true_prior_takes_an_uncertainty_below_0_for_the_wide_interval_it_is(width: float) -> None:
    """The error e of the wavenumber v = 10,000 cm^-1 with 1e7 / (v - e) - 1e7 / (v + e) = width is above v."""
    model = model_of(replace(FILE, bands=(FILE.bands[0], replace(FILE.bands[1], center_95_nm=width), FILE.bands[2])))
    error = 1.96 * model.sigma[model.index("band_2_center_nm")] * 1e3 * 1e7 / 1000.0**2
    assert error > 1e4
    assert 1e7 / (1e4 - error) - 1e7 / (1e4 + error) == pytest.approx(width, rel=1e-6)


def test_the_sign_of_a_width_has_no_meaning() -> None:
    """The model is even in it, and the program may end on either side."""
    other = read(EXAMPLE.replace("1000 250 -1", "1000 -250 -1"))
    assert model_of(other).prior.tolist() == model_of(FILE).prior.tolist()
    assert from_start(other).parameters.tolist() == from_start(FILE).parameters.tolist()


def test_an_error_beyond_the_wavenumber_is_written_as_the_program_does() -> None:
    """1e7 / (v - e) - 1e7 / (v + e) with e above v."""
    fit = from_start(FILE)
    sigma = fit.covariance.copy()
    sigma[2, 2] = 1.0
    wavenumber, around = 1e7 / fit.bands[0].center_nm, 1.96 * 1e3 * 1e7 / fit.bands[0].center_nm ** 2
    assert around > wavenumber
    written = fit_file_of(replace(fit, covariance=sigma)).bands[0].center_95_nm
    assert written == pytest.approx(1e7 / (wavenumber - around) - 1e7 / (wavenumber + around))
    assert written < 0


def test_nothing_in_a_result_file_is_0() -> None:
    """Zeros stop the program; what is there instead changes nothing, and is held when it is read again."""
    locked = replace(FILE.bands[0], strength=0.0, center_95_nm=0.0, fwhm_95_nm=0.0, strength_95=0.0)
    file = fit_file_of(from_start(replace(FILE, bands=(locked, *FILE.bands[1:]))), FILE)
    numbers = [*file.coefficients, *file.coefficients_95]
    numbers += [value for band in file.bands for value in (*band.values, *band.uncertainties)]
    assert all(numbers)
    assert abs(file.coefficients[3]) * 25_000.0**3 < 1e-11
    assert abs(file.bands[0].strength) < 1e-8
    again = model_of(file)
    assert again.continuum == "wavenumber"
    assert again.fixed[2:5].all()


@pytest.mark.parametrize(("letter", "values"), [("T", (0.6, -1e-9, 1e-13, 1e-18)), ("Q", (0.6, -1e-9, 0.0, 0.0))])
def test_a_result_keeps_the_letter_of_its_start(letter: str, values: tuple[float, ...]) -> None:
    file = replace(TWO, continuum=letter, coefficients=values)
    assert fit_file_of(from_start(file), file).continuum == letter


def test_coefficients_that_are_held_for_being_0_are_named() -> None:
    """Unless nothing else was asked for: no uncertainty, or no continuum."""
    with pytest.warns(LunarSciWarning, match=r"^start\.fit: c2, c3 of 0 stay 0"):
        model, file = read_start(InputFile("start.fit", EXAMPLE.encode()), "2=opx, 3=CPX")
    assert file == FILE
    assert [band.mineral for band in model.assemblage.bands] == ["any", "orthopyroxene", "clinopyroxene"]
    with pytest.warns(LunarSciWarning, match=r"^start\.fit: centre of band 2: an uncertainty below 0"):
        read_start(InputFile("start.fit", with_row(6, "N").replace("200 400 10", "-200 400 10").encode()))
    for content in (with_row(8, "10 1e-4 0 0"), with_row(6, "N"), NO_CONTINUUM):
        read_start(InputFile("start.fit", content.encode()))


@pytest.mark.parametrize("text", ["2", "OPX=2", "2=OPX,2=CPX", "-1=OPX", "²=OPX", "2=OPX,", "=OPX"])
def test_minerals_that_are_not_numbered_are_refused(text: str) -> None:
    with pytest.raises(ParameterError, match="write NUMBER=MINERAL for each band once"):
        parse_minerals(text)


@pytest.mark.parametrize(
    ("comment", "mineral"),
    [("OPX", "OPX"), ("! clinopyroxene, 1 um", "CPX"), ("(Ol)", "OL"), ("plagioclase PLG", "PLG"), ("cold", "")],
)
def test_a_comment_may_name_the_mineral_of_a_band(comment: str, mineral: str) -> None:
    file = read(with_row(12, f"1000 250 -1 {comment}"))
    assert [band.mineral for band in file.bands] == ["", mineral, ""]
    assert read(fit_file_text(file)) == file
    assert model_of(file).assemblage.bands[1].mineral == (MINERALS[mineral] if mineral else "any")
    assert model_of(file, {2: "OL"}).assemblage.bands[1].mineral == "olivine"


@pytest.mark.parametrize(("minerals", "said"), [({4: "OPX"}, "bands 1 to 3"), ({2: "SPINEL"}, "no 'SPINEL'")])
def test_a_mineral_or_a_band_that_is_not_there_is_refused(minerals: dict[int, str], said: str) -> None:
    with pytest.raises(ParameterError, match=said):
        model_of(FILE, minerals)


def test_map_mode_on_a_measured_orthopyroxene(reference_data: Path) -> None:
    """Orthopyroxene bands lie at 0.90-0.935 and 1.80-1.95 um: Adams (1974), 10.1029/JB079i032p04829."""
    spectra = read_spectra(read_input(str(reference_data / "spectra/relab/reflectance.csv")))
    [fit] = fit_spectra([s for s in spectra if s.id == "PE-CMP-030"], model_of(FILE), model_error=0.05, starts=1)
    assert isinstance(fit, MgmFit)
    assert 900 <= fit.bands[1].center_nm <= 935
    assert 1800 <= fit.bands[2].center_nm <= 1950
