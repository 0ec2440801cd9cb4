"""Files as instruments, archives and programs of the field write them, made here after public descriptions.

One made-up rock stands in all of them: what is read must be its reflectance, however it was written.
"""

import io
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

import lunarsci
from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.guide.info import info
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.readers.batch import SpectraBatch, read_batch
from lunarsci.spectra.readers.columns import of_kubelka_munk
from lunarsci.spectra.readers.dispatch import read_spectra
from lunarsci.spectra.readers.likely import markers_of
from lunarsci.spectra.spectrum import Spectrum

NM = np.arange(400.0, 2501.0, 10.0)


def rock(nm: FloatArray, depth: float = 0.3) -> FloatArray:
    """A rock with bands at 940 and 1980 nm, its noise the same whenever it is made."""
    one, two = (np.exp(-0.5 * ((nm - at) / width) ** 2) for at, width in ((940, 60), (1980, 170)))
    wiggle = 1e-4 * np.sin(nm * 12.9898) * np.cos(nm * 78.233)
    return np.asarray((0.2 + 4e-5 * (nm - 400)) * (1 - depth * one) * (1 - 0.17 * two) + wiggle)


R = rock(NM)


def rows(*columns: FloatArray, gap: str = ",", digits: int = 7) -> str:
    return "".join(gap.join(f"{value:.{digits}g}" for value in row) + "\n" for row in zip(*columns, strict=True))


def told(content: str | bytes, name: str = "a.csv") -> tuple[list[Spectrum], list[str]]:
    """The spectra of a file, and how it says that it was read."""
    data = content.encode() if isinstance(content, str) else content
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LunarSciWarning)
        found = list(read_spectra(InputFile(name, data)))
    return found, list(found[0].metadata.get("read_as", ()))


def is_rock(spectrum: Spectrum, tolerance: float = 2e-5) -> bool:
    good = spectrum.usable
    return bool(np.abs(spectrum.reflectance - rock(spectrum.wavelength_nm))[good].max() < tolerance)


NAMES = "wavelength_nm,rock\n"
HEADS: dict[str, tuple[str, str]] = {
    # ECOSTRESS spectral library, ASCII spectra: key: value lines, x and y units named (Meerdink et al. 2019).
    "ecostress": (
        "Name: Basalt\nType: Rock\nFirst Column: X\nX Units: Wavelength (micrometers)\n"
        "Y Units: Reflectance (percent)\nFirst X Value: 0.4\n\n" + rows(NM / 1000, 100 * R, gap="\t"),
        "a.txt",
    ),
    # Spectral Evolution SED files: a head, `Data:`, names with tabs.
    "sed": (
        "Comment: \nVersion: 2.3\nColumns [4]:\nData:\nWvl\tRad. (Ref.)\tRad. (Target)\tTgt./Ref. %\n"
        + rows(NM, 0 * NM + 900, 900 * R, 100 * R, gap="\t"),
        "a.sed",
    ),
    # Spectra Vista SIG files (SVC HR-1024i user manual): four columns without names under `data=`.
    "sig": (
        "/*** Spectra Vista SIG Data ***/\nname= a.sig\nunits= Radiance, Radiance\n"
        "factors= 1.000, 1.000, 1.000 [Overlap: Remove @ 980,1900]\ndata=\n"
        + rows(NM, 0 * NM + 900, 900 * R, 100 * R, gap="  "),
        "a.sig",
    ),
    # ASD ViewSpec Pro text export with the header: lines of text, then `Wavelength` and the file's name.
    "asd": (
        "Text conversion of header file a.asd\nThe instrument number was 1234/5\nVNIR dark signal subtracted: yes\n\n"
        "Wavelength\ta.asd\n" + rows(NM, R, gap="\t"),
        "a.txt",
    ),
    "excel's separator": ("sep=;\nwavelength_nm;rock\n" + rows(NM, R, gap=";"), "a.csv"),
    "names over units": ("Wavelength,Reflectance\nnm,%\n" + rows(NM, 100 * R), "a.csv"),
    "several lines of names": ("Spectrum: A1\nsample,basalt\nwavelength_nm,rock\n" + rows(NM, R), "a.csv"),
    "text below": (NAMES + rows(NM, R) + "\nMeasured by: A. B.\n", "a.csv"),
    # RELAB's own layout: the number of channels, the rows, and name, sample and geometry below.
    "relab": (
        f"{NM.size}\n" + rows(NM, R, 0 * R + 1e-3, gap="  ") + "\n\nc1aa01.asc\n\nAA-BCD-001\nBasalt, <45 um\n"
        "Source Ang: 30.00   Detect Ang:  0.00\n",
        "a.asc",
    ),
}


@pytest.mark.parametrize("kind", HEADS)
def test_lines_around_a_table_are_no_part_of_it(kind: str) -> None:
    [spectrum], _ = told(*HEADS[kind])
    assert spectrum.wavelength_nm.size == NM.size and is_rock(spectrum)


def test_what_stands_around_a_table_is_kept() -> None:
    [spectrum], _ = told(*HEADS["ecostress"])
    assert spectrum.metadata["keys"]["Type"] == "Rock"
    [spectrum], _ = told(*HEADS["relab"])
    assert "AA-BCD-001" in spectrum.metadata["comments"]


@pytest.mark.parametrize("end", ["2510,O.21\n", "2510\n", "2510,0.21,0.3\n", "2510,x\n", "x,0.21\n"])
def test_a_spoilt_last_row_is_no_text_below(end: str) -> None:
    with pytest.raises(DataError, match=f"line {NM.size + 2}"):
        read_spectra(InputFile("a.csv", (NAMES + rows(NM, R) + end).encode()))


@pytest.mark.parametrize(
    "name",
    ["Reflect. %", "Refl (%)", "Reflectance [%]", "R%", "%R", "R (%)", "% Reflectance", "Reflectance, %", "rock [%]",
     "Reflectance_percent", "Reflectance (percent)", "Refl. in %", "Tgt./Ref. %", "Reflexion [%]"],
)  # fmt: skip
@pytest.mark.parametrize("albedo", [1.0, 0.07])
def test_percent_is_read_however_it_is_written(name: str, albedo: float) -> None:
    [spectrum], _ = told(f'wavelength_nm,"{name}"\n' + rows(NM, 100 * albedo * R))
    np.testing.assert_allclose(spectrum.reflectance, albedo * R, rtol=1e-5)


@pytest.mark.parametrize("name", ["50% olivine", "ol50%_opx50%", "An 90 %"])
def test_a_share_in_a_name_is_no_unit(name: str) -> None:
    [spectrum], _ = told(f'wavelength_nm,"{name}"\n' + rows(NM, R))
    assert is_rock(spectrum) and spectrum.id == name


def kubelka_munk(r: FloatArray) -> FloatArray:
    return (1 - r) ** 2 / (2 * r)


@pytest.mark.parametrize(
    ("name", "made"),
    [
        *((name, lambda r: -np.log10(r)) for name in ("log(1/R)", "log 1/R", "log10(1/R)", "-log(R)", "Absorbance")),
        *((name, lambda r: -np.log10(r)) for name in ("rock absorbance", "LOG (1/R)", "Log(1/Refl.)")),
        ("ln(1/R)", lambda r: -np.log(r)),
        ("ln R", np.log),
        *((name, kubelka_munk) for name in ("Kubelka-Munk", "K-M", "F(R)", "KM")),
    ],
)
def test_what_is_computed_from_reflectance_is_made_it(name: str, made: Callable[[FloatArray], FloatArray]) -> None:
    [spectrum], said = told(f"wavelength_nm,{name}\n" + rows(NM, made(R), digits=9))
    np.testing.assert_allclose(spectrum.reflectance, R, rtol=1e-6)
    assert any("made reflectance" in line for line in said)


def test_kubelka_and_munks_function_is_inverted() -> None:
    r = np.linspace(0.01, 1.0, 50)
    np.testing.assert_allclose(of_kubelka_munk(kubelka_munk(r)), r, rtol=1e-12)


def test_errors_of_absorbance_become_those_of_reflectance() -> None:
    [spectrum], _ = told("wavelength_nm,absorbance,sd\n" + rows(NM, -np.log10(R), 0 * R + 1e-3, digits=9))
    assert spectrum.uncertainty is not None
    np.testing.assert_allclose(spectrum.uncertainty, R * np.log(10) * 1e-3, rtol=1e-4)


def test_absorbance_beside_reflectance_is_left_out() -> None:
    spectra, _ = told("wavelength_nm,reflectance,absorbance\n" + rows(NM, R, -np.log10(R)))
    assert len(spectra) == 1 and is_rock(spectra[0])


@pytest.mark.parametrize("marker", [65535, -999, 1e30, -1.23e34, 9999, -32768, 1.0e32])
@pytest.mark.parametrize("scale", [1.0, 100.0])
def test_marks_of_no_data_are_no_reflectance(marker: float, scale: float) -> None:
    values = np.where(NM > 2400, marker, scale * R)
    [spectrum], said = told(f"wavelength_nm,rock{' (%)' if scale > 1 else ''}\n" + rows(NM, values))
    assert is_rock(spectrum) and spectrum.usable.sum() == (NM <= 2400).sum()
    assert marker == -1.23e34 or any(f"{marker:g} read as the mark" in line for line in said)


def test_a_spectrum_of_marks_alone_has_no_channel() -> None:
    (one, two), _ = told("wavelength_nm,a,b\n" + rows(NM, np.where(NM > 2400, 65535, R), 0 * R + 65535))
    assert is_rock(one) and not two.usable.any()


def test_a_steep_or_rounded_spectrum_has_no_marks() -> None:
    steep = np.geomspace(0.001, 0.9, 200)
    assert markers_of(np.stack([steep, np.round(steep, 1), np.repeat([0.001, 0.9], 100)])) == [0.9]
    assert markers_of(np.round(steep, 2)[None]) == []


def detectors(step: float, *, order: str) -> str:
    """A rock on two detectors that overlap at 970-1010 nm, the first brighter by `step`."""
    low, high = np.arange(350, 1011, 1.5), np.arange(971, 2500, 3.7)
    nm, r = np.concatenate([low, high]), np.concatenate([(1 + step) * rock(low), rock(high)])
    at = {"one by one": np.arange(nm.size), "descending": np.arange(nm.size)[::-1]}.get(order, np.argsort(nm))
    return NAMES + rows(nm[at], r[at])


@pytest.mark.parametrize("order", ["one by one", "descending", "interleaved"])
@pytest.mark.parametrize("step", [0.05, -0.05, 0.2])
def test_detectors_that_overlap_are_joined_on_one_level(order: str, step: float) -> None:
    [spectrum], said = told(detectors(step, order=order))
    assert is_rock(spectrum, 1e-4) and (np.diff(spectrum.wavelength_nm) > 1).all()
    assert any("two detectors overlap at 971-1010" in line for line in said)


def test_detectors_that_repeat_one_wavelength_are_joined() -> None:
    nm = np.concatenate([np.arange(350.0, 1001), np.arange(1000.0, 1801)])
    r = rock(nm) * np.where(np.arange(nm.size) < 651, 1.04, 1.0)
    [spectrum], said = told(NAMES + rows(nm, r))
    assert is_rock(spectrum, 1e-4) and spectrum.wavelength_nm.size == 1451 and "scaled by 0.96" in said[0]


def test_a_finer_part_of_one_grid_is_no_second_detector() -> None:
    nm = np.concatenate([np.arange(460, 730, 40.0), np.arange(730, 1550, 20.0), np.arange(1550, 3000, 40.0)])
    [spectrum], said = told(NAMES + rows(nm, rock(nm)))
    assert spectrum.wavelength_nm.size == nm.size and not any("detector" in line for line in said)


@pytest.mark.parametrize("names", [NM.astype(int), NM / 1000, [f"{nm:g}nm" for nm in NM], [f"X{nm:g}" for nm in NM]])
@pytest.mark.parametrize("corner", ["", "sample", "wavelength"])
def test_spectra_may_stand_in_rows(names: list[str], corner: str) -> None:
    lines = [",".join([corner, *map(str, names)]), *(",".join([id, *(f"{v:.7g}" for v in R)]) for id in ("a", "b"))]
    spectra, said = told("\n".join(lines) + "\n")
    assert [one.id for one in spectra] == ["a", "b"] and all(map(is_rock, spectra))
    assert any("2 spectra in rows" in line for line in said)


def test_spectra_in_rows_may_have_other_columns_and_numbers_as_names() -> None:
    head = "id,lat," + ",".join(f"{nm:g}" for nm in NM)
    spectra, _ = told(head + "".join(f"\n{k},{k / 7:.3f}," + ",".join(f"{v:.7g}" for v in R) for k in (1, 2, 3)) + "\n")
    assert [one.id for one in spectra] == ["row 1", "row 2", "row 3"] and all(map(is_rock, spectra))


def test_names_that_are_numbers_are_no_wavelengths() -> None:
    names = ",".join(str(number) for number in range(1001, 1012))
    spectra, _ = told(f"wavelength_nm,{names}\n" + rows(NM, *[R] * 11))
    assert [one.id for one in spectra] == [str(number) for number in range(1001, 1012)]


@pytest.mark.parametrize("names", ["wl_nm,a,wavelength_nm,b", "Wavelength (nm),a,Wavelength (nm),b", "nm 1,a,nm 2,b"])
def test_each_spectrum_may_have_its_own_wavelengths(names: str) -> None:
    other = NM + 3
    (one, two), said = told(f"{names}\n" + rows(NM, R, other, rock(other)))
    assert (one.id, two.id) == ("a", "b") and is_rock(one) and is_rock(two)
    np.testing.assert_array_equal(one.wavelength_nm[one.usable], NM)
    np.testing.assert_array_equal(two.wavelength_nm[two.usable], other)
    assert any("2 columns of wavelengths" in line for line in said)


def test_columns_without_names_are_told_by_their_numbers() -> None:
    [spectrum], said = told(rows(NM / 1000, R, 0.01 * R, 0 * R + 5, gap=" "), "a.txt")
    assert is_rock(spectrum) and spectrum.uncertainty is not None
    assert any("column 4 without a name read as a count" in line for line in said)
    assert any("read as errors: 3 of 2" in line for line in said)


def test_copies_and_ratios_without_names_are_told() -> None:
    """As tables of spectra of CRISM: ratio, numerator and denominator, each twice (Viviano et al. 2014)."""
    under = 0.26 + 1e-5 * (NM - 400)
    spectra, said = told(rows(NM / 1000, R / under, R / under, R, R, under, under, digits=8), "a.tab")
    assert len(spectra) == 3 and is_rock(spectra[1])
    assert any("column 2 is column 4 over 6" in line for line in said)


@pytest.mark.parametrize(
    "names",
    ["rock,std", "rock,sd", "rock,StdDev", "rock,error", "rock,±", "rock,rock ±", "rock,avg std", "rock,Std. Dev.",
     "rock,rock_err", "rock,err_rock", "rock,uncertainty", "rock,1-sigma", "rock,+/-", "Mean,Stdev", "rock,rock SD"],
)  # fmt: skip
def test_scatter_has_many_names(names: str) -> None:
    spectra, _ = told(f"wavelength_nm,{names}\n" + rows(NM, R, 0.02 * R))
    assert len(spectra) == 1 and spectra[0].uncertainty is not None
    np.testing.assert_allclose(spectra[0].uncertainty, 0.02 * R, rtol=1e-5)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("Wavenumber (cm-1)", 1e7 / NM), ("wavenumber", 1e7 / NM), ("wavelength (cm^-1)", 1e7 / NM),
        ("Wavelength [Å]", 10 * NM), ("wavelength_angstrom", 10 * NM), ("Angstrom", 10 * NM), ("cm-1", 1e7 / NM),
    ],
)  # fmt: skip
def test_wavenumbers_and_angstroms_are_wavelengths(name: str, values: FloatArray) -> None:
    [spectrum], _ = told(f"{name},rock\n" + rows(values, R, digits=12))
    np.testing.assert_allclose(spectrum.wavelength_nm, NM, rtol=1e-9)
    assert is_rock(spectrum)


def envi(folder: Path, unit: str, *, kind: int = 4, more: str = "") -> Path:
    """A library as SPy writes it (spectral.io.envi), floats, or whole numbers of 10,000 times the reflectance."""
    listed = ", ".join(f"{nm / 1000:g}" for nm in NM)
    (folder / "lib.hdr").write_text(
        f"ENVI\nsamples = {NM.size}\nlines = 1\nbands = 1\nheader offset = 0\nfile type = ENVI Spectral Library\n"
        f"data type = {kind}\ninterleave = bsq\nbyte order = 0\n{unit}{more}spectra names = {{ rock }}\n"
        f"wavelength = {{ {listed} }}\n"
    )
    values = R.astype("<f4") if kind == 4 else np.round(1e4 * R).astype("<i2")
    (folder / "lib.sli").write_bytes(values.tobytes())
    return folder / "lib.sli"


@pytest.mark.parametrize("unit", ["wavelength units = <unspecified>\n", "", "wavelength units = Unknown\n"])
def test_a_library_without_a_unit_is_read_by_its_range_or_the_option(tmp_path: Path, unit: str) -> None:
    with pytest.warns(LunarSciWarning, match="read as µm"):
        [spectrum] = read_spectra(str(envi(tmp_path, unit)))
    assert is_rock(spectrum)
    [spectrum] = read_spectra(str(envi(tmp_path, unit)), wavelength_unit="um")
    assert is_rock(spectrum)


def test_whole_numbers_in_a_library_have_a_scale(tmp_path: Path) -> None:
    unit, scale = "wavelength units = Micrometers\n", "reflectance scale factor = 10000\n"
    [spectrum] = read_spectra(str(envi(tmp_path, unit, kind=2, more=scale)))
    assert is_rock(spectrum, 1e-4)
    with pytest.warns(LunarSciWarning, match="reflectance times 10000"):
        [spectrum] = read_spectra(str(envi(tmp_path, unit, kind=2)))
    assert is_rock(spectrum, 1e-4)


def as_fits(*parts: object) -> bytes:
    stream = io.BytesIO()
    fits.HDUList(list(parts)).writeto(stream)
    return stream.getvalue()


def test_fits_files_of_several_spectra_are_read() -> None:
    """specutils `tabular-fits`: a channel in each row, a cell of fluxes; and tables with a spectrum in each row."""
    cells = Table({"wavelength": 10 * NM, "flux": np.stack([R, R], axis=1), "uncertainty": np.full((NM.size, 2), 1e-3)})
    cells["wavelength"].unit = "Angstrom"
    spectra, _ = told(as_fits(fits.PrimaryHDU(), fits.table_to_hdu(cells)), "a.fits")
    assert [one.id for one in spectra] == ["flux_1", "flux_2"] and all(map(is_rock, spectra))
    assert all(one.uncertainty is not None for one in spectra)
    each = Table({"name": ["a", "b"], "wavelength_nm": np.stack([NM, NM]), "flux": np.stack([R, R])})
    spectra, _ = told(as_fits(fits.PrimaryHDU(), fits.table_to_hdu(each)), "a.fits")
    assert [one.id for one in spectra] == ["a", "b"] and all(map(is_rock, spectra))


def test_an_image_with_linear_wavelengths_is_a_spectrum() -> None:
    """specutils `wcs1d-fits`: one axis, CRVAL1 and CDELT1 (Greisen et al. 2006)."""
    hdu = fits.PrimaryHDU(R)
    hdu.header.update({"CTYPE1": "WAVE", "CUNIT1": "nm", "CRVAL1": 400.0, "CDELT1": 10.0, "CRPIX1": 1.0})
    [spectrum], _ = told(as_fits(hdu), "a.fits")
    assert is_rock(spectrum)


PDS3 = """PDS_VERSION_ID = PDS3
RECORD_TYPE = FIXED_LENGTH
RECORD_BYTES = 32
FILE_RECORDS = {rows}
^TABLE = "A.TAB"
OBJECT = TABLE
  INTERCHANGE_FORMAT = ASCII
  ROWS = {rows}
  COLUMNS = 3
  ROW_BYTES = 32
  OBJECT = COLUMN
    NAME = WAVELENGTH
    UNIT = MICROMETER
    DATA_TYPE = ASCII_REAL
    START_BYTE = 1
    BYTES = 10
  END_OBJECT = COLUMN
  OBJECT = COLUMN
    NAME = "REFLECTANCE"
    MISSING_CONSTANT = 65535.
    START_BYTE = 11
    BYTES = 10
  END_OBJECT = COLUMN
  OBJECT = COLUMN
    NAME = "STANDARD DEVIATION"
    START_BYTE = 21
    BYTES = 10
  END_OBJECT = COLUMN
END_OBJECT = TABLE
END
"""
PDS4 = """<?xml version="1.0" encoding="UTF-8"?>
<Product_Observational xmlns="http://pds.nasa.gov/pds4/pds/v1">
 <File_Area_Observational><File><file_name>a.tab</file_name></File>
  <Table_Character><offset unit="byte">0</offset><records>{rows}</records>
   <Record_Character><fields>3</fields><record_length unit="byte">32</record_length>{fields}</Record_Character>
  </Table_Character></File_Area_Observational>
</Product_Observational>
"""


def pds_rows() -> str:
    marked = np.where(NM > 2450, 65535, R)
    return "".join(f"{nm / 1000:10.4f}{r:10.6g}{0.001:10.5f}\r\n" for nm, r in zip(NM, marked, strict=True))


def pds4_field(name: str, start: int, unit: str = "", mark: str = "") -> str:
    unit = f"<unit>{unit}</unit>" if unit else ""
    mark = f"<Special_Constants><missing_constant>{mark}</missing_constant></Special_Constants>" if mark else ""
    return (
        f"<Field_Character><name>{name}</name><field_location unit='byte'>{start}</field_location>"
        f"<data_type>ASCII_Real</data_type><field_length unit='byte'>10</field_length>{unit}{mark}</Field_Character>"
    )


@pytest.mark.parametrize("given", ["a.lbl", "a.tab"])
def test_a_table_of_pds3_is_read_from_label_and_table(tmp_path: Path, given: str) -> None:
    """PDS Standards Reference 3.8, chapter 12 and appendix A.29."""
    (tmp_path / "a.tab").write_text(pds_rows(), newline="")
    (tmp_path / "a.lbl").write_text(PDS3.format(rows=NM.size))
    [spectrum] = read_spectra(str(tmp_path / given))
    assert is_rock(spectrum) and spectrum.usable.sum() == (NM <= 2450).sum() and spectrum.uncertainty is not None
    assert info(tmp_path / "a.lbl").kind == "spectra"
    (tmp_path / "a.tab").write_text(pds_rows()[:-320], newline="")
    with pytest.raises(DataError, match="its label says 211"):
        read_spectra(str(tmp_path / given))


def test_a_table_of_pds4_is_read(tmp_path: Path) -> None:
    """PDS4 Standards Reference, Table_Character; the layout of RELAB's bundle."""
    fields = pds4_field("Wavelength", 1, "micrometer") + pds4_field("Reflectance", 11, mark="65535")
    label = PDS4.format(rows=NM.size, fields=fields + pds4_field("Standard Deviation", 21))
    (tmp_path / "a.xml").write_text(label)
    (tmp_path / "a.tab").write_text(pds_rows(), newline="")
    [spectrum] = read_spectra(str(tmp_path / "a.xml"))
    assert is_rock(spectrum) and spectrum.usable.sum() == (NM <= 2450).sum()


def test_a_label_of_radiance_is_said_to_be_one(tmp_path: Path) -> None:
    label = (
        "PDS_VERSION_ID = PDS3\nObject = RDN_FILE\n  ^RDN_IMAGE = X.IMG\n  RECORD_BYTES = 40\n  Object = RDN_IMAGE\n"
        "    LINES = 2\n    LINE_SAMPLES = 5\n    SAMPLE_TYPE = PC_REAL\n    SAMPLE_BITS = 32\n    BANDS = 3\n"
        '    UNIT = "W/(m^2 um sr)"\n  End_Object\nEnd_Object\nEND\n'
    )
    (tmp_path / "x.lbl").write_text(label)
    found = info(tmp_path / "x.lbl")
    assert found.kind == "cube" and "radiance" in found.trouble and "2 lines, 5 samples and 3 bands" in found.trouble
    with pytest.raises(DataError, match="radiance, no reflectance"):
        read_spectra(str(tmp_path / "x.lbl"))


def test_a_cube_of_a_label_is_opened(tmp_path: Path) -> None:
    """As CRISM's targeted data: bands by line, floats, 65535 where there is nothing (PDS Geosciences Node)."""
    from lunarsci.spectra.cubes.rasters import open_cube

    numbers = np.tile(R[:, None], (4, 1, 3)).astype("<f4")
    numbers[0, :, 0] = 65535
    (tmp_path / "A.IMG").write_bytes(numbers.tobytes())
    centres = ", ".join(f"{nm:g}" for nm in NM)
    (tmp_path / "a.lbl").write_text(
        f'PDS_VERSION_ID = PDS3\nRECORD_BYTES = 12\n^IMAGE = "A.IMG"\nOBJECT = IMAGE\n LINES = 4\n LINE_SAMPLES = 3\n'
        f" SAMPLE_TYPE = PC_REAL\n SAMPLE_BITS = 32\n BANDS = {NM.size}\n BAND_STORAGE_TYPE = LINE_INTERLEAVED\n"
        f" GROUP = BAND_BIN\n  BAND_BIN_CENTER = ({centres})\n  BAND_BIN_UNIT = NANOMETER\n END_GROUP = BAND_BIN\n"
        f"END_OBJECT = IMAGE\nEND\n"
    )
    cube = open_cube(str(tmp_path / "a.lbl"))
    values, _ = cube.read(slice(0, 4), slice(0, 3))
    np.testing.assert_allclose(values[1, 2], R, rtol=1e-5)
    assert np.isnan(values[0, 0]).all() and any("65535 read as the mark" in line for line in cube.remarks)


def test_very_many_channels_are_averaged(tmp_path: Path) -> None:
    nm = np.linspace(400, 2500, 100_000)
    (tmp_path / "a.csv").write_text(NAMES + rows(nm, rock(nm)))
    with pytest.warns(LunarSciWarning, match="100000 channels, every 20 averaged"):
        found = lunarsci.bands(tmp_path / "a.csv")
    [one] = found.to_dict()["spectra"]
    [few] = lunarsci.bands((NM, R)).to_dict()["spectra"]
    assert abs(one["bc1000_nm"] - few["bc1000_nm"]) < 3 * few["bc1000_sigma_nm"]
    assert found.to_dict()["read_as"] == [f"{tmp_path / 'a.csv'}: 100000 channels, every 20 averaged"]


def batch_of(*given: object) -> SpectraBatch:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LunarSciWarning)
        return read_batch(given if len(given) > 1 else given[0])  # type: ignore[arg-type]


def test_arrays_are_read_as_files_are() -> None:
    import xarray

    marked = np.where(NM > 2450, 65535, R)
    coded = xarray.DataArray(R, dims=["wavelength"], coords={"wavelength": ("wavelength", NM / 1000, {"units": "um"})})
    for given in ((NM, R), (NM[::-1], R[::-1]), (NM, marked), (coded,)):
        batch = batch_of(*given)
        assert len(batch.spectra) == 1 and is_rock(batch.spectra[0])
    assert "65535 read as the mark" in batch_of(NM, marked).read_as[0]


def test_wavelengths_and_reflectances_may_be_given_one_after_the_other() -> None:
    one, same = lunarsci.bands(NM, R), lunarsci.bands((NM, R))
    assert one.to_dict() == same.to_dict()
    with_errors = lunarsci.bands(NM, R, 0 * R + 1e-3)
    assert with_errors.to_dict() == lunarsci.bands((NM, R, 0 * R + 1e-3)).to_dict()


def test_info_knows_all_of_them(tmp_path: Path) -> None:
    for number, (content, name) in enumerate(HEADS.values()):
        path = tmp_path / f"{number}{Path(name).suffix}"
        path.write_text(content)
        found = info(path)
        assert (found.kind, found.trouble) == ("spectra", ""), path
        assert found.contents["channels"] == NM.size


@pytest.mark.parametrize("step", [0.05, -0.04])
def test_a_step_between_detectors_is_no_band(tmp_path: Path, step: float) -> None:
    """Three detectors that meet at 1000 and 1800 nm, as of field spectrometers (Hueni & Bialek 2017)."""
    nm = np.arange(350.0, 2501.0, 5)
    stepped = rock(nm) * np.where(nm < 1002, 1 + step, 1.0) * np.where(nm < 1802, 1 - step / 2, 1.0)
    (tmp_path / "a.csv").write_text(NAMES + rows(nm, stepped, digits=9))
    batch = batch_of(str(tmp_path / "a.csv"))
    assert is_rock(batch.spectra[0], 2e-3) and "a step between two channels" in batch.read_as[0]
    assert is_rock(batch_of(nm, stepped).spectra[0], 2e-3)


def test_spectra_may_stand_one_below_another() -> None:
    """The long ("tidy") form of a data frame (Wickham 2014): a row for each sample and wavelength."""
    lines = "".join(f"A-{k},{nm:g},{r:.7g},0.001\n" for k in (1, 2) for nm, r in zip(NM, R * k, strict=True))
    (one, two), said = told("sample,wavelength_nm,reflectance,sd\n" + lines)
    assert (one.id, two.id) == ("A-1", "A-2") and is_rock(one) and one.uncertainty is not None
    np.testing.assert_allclose(two.reflectance, 2 * R, rtol=1e-5)
    assert any("2 spectra one below another" in line for line in said)


@pytest.mark.parametrize("names", ["wl_a,a,wl_b,b", "X,a,X,b"])
def test_wavelengths_are_told_by_how_their_names_repeat(names: str) -> None:
    (one, two), _ = told(f"{names}\n" + rows(NM, R, NM + 1, rock(NM + 1)))
    assert is_rock(one) and is_rock(two)


def test_errors_of_one_name_belong_to_the_columns_before_them() -> None:
    spectra, _ = told("wavelength_nm,a,SD,b,SD\n" + rows(NM, R, 0.01 * R, R, 0.02 * R))
    assert [one.id for one in spectra] == ["a", "b"]
    for one, share in zip(spectra, (0.01, 0.02), strict=True):
        assert one.uncertainty is not None
        np.testing.assert_allclose(one.uncertainty, share * R, rtol=1e-5)


def test_cells_of_spreadsheets_without_a_number_are_missing() -> None:
    [spectrum], _ = told(NAMES + rows(NM, R) + "2510,#N/A\n2520,#DIV/0!\n2530,-1.#IND\n")
    assert is_rock(spectrum) and spectrum.usable.sum() == NM.size


def test_rows_that_come_twice_count_once() -> None:
    [spectrum], said = told(NAMES + rows(NM, R) + rows(NM[-2:], R[-2:]))
    assert is_rock(spectrum) and said == ["a.csv: 2 rows that repeat another one are left out"]


def test_a_cube_of_pds4_is_opened(tmp_path: Path) -> None:
    """PDS4 Standards Reference, Array_3D_Image; axes as of IIRS: band, line, sample."""
    from lunarsci.spectra.cubes.rasters import open_cube

    (tmp_path / "a.qub").write_bytes(np.tile(R[:, None, None], (1, 4, 3)).astype("<f4").tobytes())
    axes = "".join(
        f"<Axis_Array><axis_name>{name}</axis_name><elements>{count}</elements><sequence_number>{k}</sequence_number>"
        "</Axis_Array>"
        for k, (name, count) in enumerate((("Band", NM.size), ("Line", 4), ("Sample", 3)), 1)
    )
    bins = "".join(f'<Band_Bin><center_wavelength unit="nm">{nm:g}</center_wavelength></Band_Bin>' for nm in NM)
    (tmp_path / "a.xml").write_text(
        f"<Product_Observational><Band_Bin_Set>{bins}</Band_Bin_Set><File_Area_Observational><File><file_name>a.qub"
        f"</file_name></File><Array_3D_Image><offset>0</offset><axes>3</axes><Element_Array><data_type>IEEE754LSBSingle"
        f"</data_type></Element_Array>{axes}</Array_3D_Image></File_Area_Observational></Product_Observational>"
    )
    cube = open_cube(str(tmp_path / "a.xml"))
    np.testing.assert_allclose(cube.wavelength_nm, NM)
    np.testing.assert_allclose(cube.read(slice(0, 4), slice(0, 3))[0][3, 1], R, rtol=1e-5)
    assert info(tmp_path / "a.xml").contents == {"a.qub": "4 lines, 3 samples, 211 bands"}


def test_raw_columns_beside_a_reflectance_are_left_out() -> None:
    spectra, _ = told("nm,White,Dark,Sample,Reflectance\n" + rows(NM, 0 * R + 900, 0 * R + 3, 900 * R, R))
    assert len(spectra) == 1 and is_rock(spectra[0])


def test_a_unit_of_radiance_is_none_of_reflectance() -> None:
    with pytest.raises(DataError, match="no reflectance column"):
        told("nm,L (W/m2/sr/um)\n" + rows(NM, R))


def test_errors_may_stand_in_the_row_below() -> None:
    head = "id,kind," + ",".join(f"{nm:g}" for nm in NM)
    lines = [",".join(["a", kind, *(f"{k * v:.7g}" for v in R)]) for kind, k in (("mean", 1.0), ("sd", 0.01))]
    [spectrum], _ = told("\n".join([head, *lines]) + "\n")
    assert is_rock(spectrum) and spectrum.uncertainty is not None


def test_samples_are_named_above_columns_of_one_name() -> None:
    head = "Sample,A,B\nWavelength (nm),Reflectance (%),Reflectance (%)\n"
    spectra, _ = told(head + rows(NM, 100 * R, 100 * R))
    assert [one.id for one in spectra] == ["A", "B"] and all(map(is_rock, spectra))


def test_a_binary_table_of_pds4_is_read(tmp_path: Path) -> None:
    """PDS4 Standards Reference, Table_Binary: floats of IEEE 754, lowest byte first."""
    fields = "".join(
        f"<Field_Binary><name>{name}</name><field_location>{start}</field_location><data_type>IEEE754LSBDouble"
        f"</data_type><field_length>8</field_length><unit>{unit}</unit></Field_Binary>"
        for name, start, unit in (("Wavelength", 1, "nm"), ("Reflectance", 9, "percent"))
    )
    (tmp_path / "a.xml").write_text(
        f"<Product_Observational><File_Area_Observational><File><file_name>a.dat</file_name></File><Table_Binary>"
        f"<offset>0</offset><records>{NM.size}</records><Record_Binary><record_length>16</record_length>{fields}"
        "</Record_Binary></Table_Binary></File_Area_Observational></Product_Observational>"
    )
    (tmp_path / "a.dat").write_bytes(np.stack([NM, 100 * R], axis=1).astype("<f8").tobytes())
    [spectrum] = read_spectra(str(tmp_path / "a.xml"))
    assert is_rock(spectrum)
