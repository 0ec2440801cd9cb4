"""Files with two readings: the much likelier one is taken and said. Truth is the spectrum that each file is made of."""

import io
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.readers import text
from lunarsci.spectra.readers.dispatch import read_spectra
from lunarsci.spectra.solar import solar_spectrum
from lunarsci.spectra.spectrum import Spectrum

Read = Callable[..., list[Spectrum]]
Refuse = Callable[..., str]

NM = np.arange(430.0, 2500.0, 10.0)
R = 0.1 + 4e-5 * (NM - 430) - 0.03 * np.exp(-(((NM - 950) / 100) ** 2))


def table(head: str, *columns: FloatArray) -> str:
    return head + "\n" + "".join(",".join(f"{v:.7g}" for v in row) + "\n" for row in zip(*columns, strict=True))


@pytest.mark.parametrize("name", ["Reflectance", "rock A", "R"])
@pytest.mark.parametrize(("times", "what"), [(100.0, "percent"), (10_000.0, "reflectance times 10000")])
def test_a_size_that_only_percent_or_whole_numbers_have(read: Read, name: str, times: float, what: str) -> None:
    values = times * R if times < 1000 else np.round(times * R)
    with pytest.warns(LunarSciWarning, match=f"{what}; `reflectance_unit` decides otherwise"):
        (spectrum,) = read(table(f"wavelength_nm,{name}", NM, values))
    np.testing.assert_allclose(spectrum.reflectance, R, atol=5.1e-5)
    assert spectrum.metadata["reflectance_unit_from"] == "values" and len(spectrum.metadata["read_as"]) == 1


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
def test_dark_and_bright_rocks_in_percent_are_in_one_unit(read: Read) -> None:
    dark, bright = read(table("wavelength_nm,Refl dark,Refl bright", NM, 15 * R, 300 * R))
    np.testing.assert_allclose(dark.reflectance, 0.15 * R, rtol=1e-6)
    np.testing.assert_allclose(bright.reflectance, 3 * R, rtol=1e-6)


def test_sunlight_from_a_rock_is_no_reflectance(refuse: Refuse) -> None:
    """L = R E / pi, here in W m-2 sr-1 um-1: 4 to 75, as percent would be."""
    sun = solar_spectrum("e490")
    radiance = 1000 * R * np.interp(NM, sun.wavelength_nm, sun.irradiance) / np.pi
    assert "radiance or DN" in refuse(table("wavelength_nm,rock A", NM, radiance))
    near = NM < 950  # sunlight hardly varies: both are as likely
    assert "give `reflectance_unit` percent" in refuse(table("wavelength_nm,rock A", NM[near], 100 * R[near]))


@pytest.mark.parametrize(
    "name", ["rel_error_%", "Reflectance rel_err_%", "relative error [%]", "Rel. Err. (%)", "RSD %"]
)
def test_relative_errors_in_percent(read: Read, name: str) -> None:
    (spectrum,) = read(table(f"wavelength_nm,Reflectance,{name}", NM, R, np.full(NM.size, 2.0)))
    np.testing.assert_allclose(spectrum.uncertainty, 0.02 * R, rtol=1e-5)


@pytest.mark.parametrize(("times", "share", "unit"), [(1.0, 0.02, "shares of 1"), (100.0, 2.0, "percent")])
def test_relative_errors_without_a_unit_are_told_by_their_size(
    read: Read, times: float, share: float, unit: str
) -> None:
    content = table("wavelength_nm,R (%),rel_err", NM, 100 * R, np.full(NM.size, share))
    content = content if times > 1 else table("wavelength_nm,R,rel_err", NM, R, np.full(NM.size, share))
    with pytest.warns(LunarSciWarning, match=f"read as relative errors in {unit}"):
        (spectrum,) = read(content)
    np.testing.assert_allclose(spectrum.uncertainty, 0.02 * R, rtol=1e-5)


def test_an_error_of_a_sample_named_rel_is_absolute(read: Read) -> None:
    (spectrum,) = read(table("wavelength_nm,rel,rel_error", NM, R, np.full(NM.size, 0.002)))
    np.testing.assert_allclose(spectrum.uncertainty, 0.002, rtol=1e-5)


@pytest.mark.parametrize(("unit", "values"), [("nm", NM), ("um", NM / 1000), ("angstrom", 10 * NM), ("1/cm", 1e7 / NM)])
def test_every_unit_of_wavelengths_may_be_stated(read: Read, unit: str, values: FloatArray) -> None:
    content = "\n".join(["axis,R", *(f"{w!r},{r!r}" for w, r in zip(values.tolist(), R.tolist(), strict=True))])
    (spectrum,) = read(content + "\n", wavelength_unit=unit)
    np.testing.assert_allclose(spectrum.wavelength_nm, NM, rtol=1e-12)
    np.testing.assert_allclose(spectrum.reflectance, R)


@pytest.mark.parametrize("row", ["420,oops", "oops,0.17", "420,0.1x"])
def test_a_spoilt_first_row_is_not_the_header(refuse: Refuse, row: str) -> None:
    spoilt = next(cell for cell in row.split(",") if cell not in ("420", "0.17"))
    said = refuse(table(f"wavelength_nm,rock\n{row}", NM, R))
    assert (
        f"line 2, column '{'wavelength_nm' if row.startswith('oops') else 'rock'}': '{spoilt}' is not a number" in said
    )


def workbook(**sheets: Any) -> bytes:
    import pandas as pd

    made = io.BytesIO()
    with pd.ExcelWriter(made, engine="openpyxl") as writer:
        for name, (first, frame) in sheets.items():
            pd.DataFrame(frame).to_excel(writer, sheet_name=name, index=False, startrow=first)
    return made.getvalue()


def test_a_workbook_of_excel_is_read() -> None:
    pytest.importorskip("openpyxl")
    frame = {"Wavelength (nm)": NM, "rock, fresh": R, "rock, fresh sigma": np.full(NM.size, 0.001)}
    data = workbook(about=(0, {"made": ["by hand"]}), spectra=(2, frame))
    with pytest.warns(LunarSciWarning, match="sheet 'spectra' of 2"):
        [spectrum] = read_spectra(InputFile("a.xlsx", data))
    assert spectrum.id == "rock, fresh" and spectrum.metadata["format"] == "excel"
    assert spectrum.metadata["sha256"] == InputFile("a.xlsx", data).sha256
    np.testing.assert_allclose(spectrum.reflectance, R, rtol=1e-14)
    np.testing.assert_allclose(spectrum.uncertainty, 0.001)


def test_a_workbook_that_cannot_be_read_says_what_to_do(refuse: Refuse, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("openpyxl")
    data = workbook(spectra=(0, {"nm": NM, "R": R}))
    assert "save its sheet as CSV" in refuse(data[: len(data) // 2], "a.xlsx")
    assert "no sheet" in refuse(workbook(one=(0, {"nm": ["x"]})), "a.xlsx")
    with monkeypatch.context() as small:
        small.setattr(text, "MOST_UNPACKED", 1000)
        assert "save its sheet as CSV" in refuse(data, "a.xlsx")
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(DataError, match=r"pip install 'lunarsci\[excel\]', or save the sheet as CSV"):
        read_spectra(InputFile("a.xlsx", data))
