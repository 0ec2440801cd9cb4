"""Text tables: separators, headers, numbers, missing values, roles of columns."""

from collections.abc import Callable

import numpy as np
import pytest

from lunarsci.errors import LunarSciWarning
from lunarsci.spectra.spectrum import Spectrum

Read = Callable[..., list[Spectrum]]
Refuse = Callable[..., str]

WAVELENGTH = [400.5, 500.0, 600.0]
REFLECTANCE = [0.1, 0.2, 0.3]


@pytest.mark.parametrize(
    "content",
    [
        "wavelength_nm,reflectance\n400.5,0.1\n500,0.2\n600,0.3\n",
        "wavelength_nm,reflectance\r\n400.5,0.1\r\n500,0.2\r\n600,0.3\r\n",
        "wavelength_nm,reflectance\r400.5,0.1\r500,0.2\r600,0.3",
        "wavelength_nm , reflectance\n400.5, 1e-1\n500, +.2\n600, 3.D-1\n",
        "Wavelength (nm)\tReflectance\n400.5\t0.1\n500\t0.2\n600\t0.3\n",
        "Wavelength [nm] Reflectance\n400.5 0.1\n500   0.2\n 600 0.3\n",
        "wavelength_nm;reflectance\n400,5;0,1\n500;0,2\n600;0.3\n",
        "wavelength_nm;reflectance\n400.5;0.1\n500;0.2\n600;0.3\n",
        "# a comment\n% another\n! third\n\nwavelength_nm,reflectance\n400.5,0.1\n# within\n500,0.2\n\n600,0.3\n\x1a",
        "# wavelength_nm reflectance\n400.5 0.1\n500 0.2\n600 0.3\n",
        '"wavelength_nm","reflectance"\n"400.5","0.1"\n500,0.2\n600,0.3\n',
        "wavelength_nm,reflectance,\n400.5,0.1,\n500,0.2,\n600,0.3,\n",
        "wavelength_nm,reflectance\n400.5,0.1,\n500,0.2,\n600,0.3,\n",
        "reflectance,wavelength_nm\n0.1,400.5\n0.2,500\n0.3,600\n",
        ",reflectance,wavelength_nm\n,0.1,400.5\n,0.2,500\n,0.3,600\n".replace("\n,", "\n").removeprefix(","),
    ],
)
def test_every_way_of_writing_gives_the_same_spectrum(read: Read, content: str) -> None:
    (spectrum,) = read(content)
    assert spectrum.id == "rock"
    assert spectrum.uncertainty is None
    np.testing.assert_array_equal(spectrum.wavelength_nm, WAVELENGTH)
    np.testing.assert_array_equal(spectrum.reflectance, REFLECTANCE)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_unicode_with_a_mark(read: Read, encoding: str) -> None:
    (spectrum,) = read("wavelength (µm),reflectance\n0.4,0.1\n0.5,0.2\n".encode(encoding))
    np.testing.assert_allclose(spectrum.wavelength_nm, [400, 500], rtol=1e-12)


def test_micro_sign_in_latin_1(read: Read) -> None:
    with pytest.warns(LunarSciWarning, match="Latin-1"):
        (spectrum,) = read("wavelength (µm),reflectance\n0.4,0.1\n0.5,0.2\n".encode("latin-1"))
    np.testing.assert_allclose(spectrum.wavelength_nm, [400, 500], rtol=1e-12)


def test_blanks_in_names_between_wide_gaps(read: Read) -> None:
    (spectrum,) = read("Wavelength (nm)   Reflectance   Standard Deviation\n400 0.1 0.01\n500 0.2 0.02\n")
    np.testing.assert_array_equal(spectrum.uncertainty, [0.01, 0.02])


def test_many_columns_keep_their_names_even_with_separators_in_them(read: Read) -> None:
    first, second = read('wavelength_nm,"65315,153 <45 um","85% Opx 15% Cpx"\n400,0.1,0.3\n500,0.2,0.4\n')
    assert (first.id, second.id) == ("65315,153 <45 um", "85% Opx 15% Cpx")
    # The names hold 'um' and '%', but as part of a sample's name: neither is a unit.
    np.testing.assert_array_equal(first.wavelength_nm, [400, 500])
    np.testing.assert_array_equal(second.reflectance, [0.3, 0.4])


@pytest.mark.parametrize("name", ["Reflectance", "R", "I/F", "reflectance_factor", "Reflectance (%)", "refl [I/F]"])
def test_a_name_that_says_only_reflectance_gives_the_files_stem(read: Read, name: str) -> None:
    (spectrum,) = read(f"wavelength_nm,{name}\n400,1.5\n500,1.8\n", "folder/yutu.v2.csv")
    assert spectrum.id == "yutu.v2"


def test_a_sample_name_is_the_id_of_a_single_spectrum(read: Read) -> None:
    assert read("wavelength_nm,Bronzite HS9\n400,0.1\n500,0.2\n")[0].id == "Bronzite HS9"


def test_without_a_header_two_columns_are_one_spectrum(read: Read) -> None:
    with pytest.warns(LunarSciWarning, match="400-500 .*read as nm"):
        (spectrum,) = read("400 0.1\n500 0.2\n", "a/basalt.txt")
    assert (spectrum.id, spectrum.metadata["wavelength_unit_from"]) == ("basalt", "values")


def test_without_a_header_four_columns_are_three_spectra(read: Read) -> None:
    with pytest.warns(LunarSciWarning, match="3 columns without names read as spectra; name the columns"):
        spectra = read("400,.1,.2,.3\n500,.1,.2,.3\n", wavelength_unit="nm")
    assert [s.id for s in spectra] == ["rock:column-2", "rock:column-3", "rock:column-4"]


def test_without_a_header_three_columns_are_ambiguous(refuse: Refuse) -> None:
    message = refuse("400,.1,.01\n500,.1,.02\n", wavelength_unit="nm")
    assert "wavelength_nm,reflectance,reflectance_sigma" in message


def test_a_header_in_a_comment_resolves_three_columns(read: Read) -> None:
    (spectrum,) = read("# made by hand\n# wavelength_nm,reflectance,std\n400,.1,.01\n500,.1,.02\n")
    np.testing.assert_array_equal(spectrum.uncertainty, [0.01, 0.02])
    assert spectrum.metadata["comments"] == ["made by hand", "wavelength_nm,reflectance,std"]


def test_names_of_spectra_may_be_numbers(read: Read) -> None:
    assert [s.id for s in read("wavelength_nm,1,2\n400,.1,.2\n500,.1,.2\n")] == ["1", "2"]


@pytest.mark.parametrize("cell", ["", "nan", "NaN", "NA", "-", "N/A", "inf"])
def test_missing_cells_are_masked_and_counted(read: Read, cell: str) -> None:
    (spectrum,) = read(f"wavelength_nm,reflectance\n400,0.1\n500,{cell}\n600,0.3\n")
    np.testing.assert_array_equal(spectrum.reflectance, [0.1, np.nan, 0.3])
    np.testing.assert_array_equal(spectrum.usable, [True, False, True])
    assert spectrum.metadata["channels_missing"] == 1


@pytest.mark.parametrize("cell", ["-1.23e34", "-1.23E+34", "-1e30", "-inf"])
def test_markers_of_deleted_channels_are_missing_and_said(read: Read, cell: str) -> None:
    with pytest.warns(LunarSciWarning, match=r"^rock\.csv: .*deleted.*: 1"):
        (spectrum,) = read(f"wavelength_nm,reflectance\n400,0.1\n500,{cell}\n600,0.3\n")
    np.testing.assert_array_equal(spectrum.reflectance, [0.1, np.nan, 0.3])
    assert spectrum.metadata["channels_deleted"] == 1


@pytest.mark.parametrize("cell", ["abc", "0.2.1", "1_000", "0x1f", "1e", "٣", "--1", "0,2"])
def test_a_cell_that_is_no_number_is_named(refuse: Refuse, cell: str) -> None:
    message = refuse(f"# c\nwavelength_nm   rockA\n400 0.1\n500 {cell}\n")
    assert "line 4, column 'rockA'" in message
    assert f"'{cell}' is not a number" in message
    assert ("decimal comma" in message) == ("," in cell)


def test_a_row_of_another_width_is_named(refuse: Refuse) -> None:
    message = refuse("wavelength_nm,a,b\n400,.1,.2\n500,.1,.2\n600,.1")
    assert "line 4 has 2 fields, the others 3" in message
    assert "truncated" in message


def test_a_header_of_another_width_is_named(refuse: Refuse) -> None:
    assert "2 names and the rows 3 fields" in refuse("wavelength_nm,a\n400,.1,.2\n500,.1,.2\n")


def test_mixed_separators_are_named_by_line(refuse: Refuse) -> None:
    message = refuse("wavelength_nm,reflectance\n400,.1\n500,.1\n600;.1\n700,.1\n")
    assert "line 4 has 1 fields" in message
    assert "separator" in message


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("wavelength_nm,reflectance\n", "no data rows"),
        ("# only\n# comments\n", "only comments"),
        ("wavelength_nm\n400\n500\n", "one column"),
        ('wavelength_nm,"reflectance\n400,0.1\n', "line 1: cannot be split"),
        ("wavelength_nm,a,a\n400,.1,.2\n", "two columns are named 'a'"),
        ("wavelength_nm,wavelength_um,a\n400,.4,.2\n", "both wavelengths"),
        ("band,reflectance\n1,.2\n", "no wavelength column"),
        ("a,b\n0.1,0.2\n0.3,0.2\n", "a right table is `wavelength_nm,NAME`, below it `450,0.061`"),
        ("wavelength_nm,solar_irradiance\n400,1800\n", "no reflectance column beside 'solar_irradiance'"),
    ],
)
def test_tables_that_are_no_spectra_are_refused(refuse: Refuse, content: str, reason: str) -> None:
    assert reason in refuse(content)


@pytest.mark.parametrize("suffix", ["sigma", "std", "err", "uncertainty", "SIGMA", "Std"])
def test_named_uncertainties_belong_to_their_column(read: Read, suffix: str) -> None:
    a, b = read(f"wavelength_nm,a_{suffix},a,b\n400,.01,.1,.3\n500,.02,.2,.4\n")
    np.testing.assert_array_equal(a.uncertainty, [0.01, 0.02])
    assert (a.id, b.id, b.uncertainty) == ("a", "b", None)


@pytest.mark.parametrize(
    "name", ["std", "StDev", "sigma", "Error", "ERR", "uncertainty", "Standard Deviation", "Std. Dev."]
)
def test_a_bare_uncertainty_belongs_to_the_only_reflectance(read: Read, name: str) -> None:
    (spectrum,) = read(f"wavelength_nm,basalt,{name}\n400,.1,.01\n500,.2,.02\n")
    assert spectrum.id == "basalt"
    np.testing.assert_array_equal(spectrum.uncertainty, [0.01, 0.02])


def test_a_bare_uncertainty_belongs_to_the_only_one_without_its_own(read: Read) -> None:
    first, second = read("wavelength_nm,reflectance,std,scaled,scaled_std\n400,.1,.01,.5,.05\n500,.2,.02,.6,.06\n")
    np.testing.assert_array_equal(first.uncertainty, [0.01, 0.02])
    np.testing.assert_array_equal(second.uncertainty, [0.05, 0.06])


@pytest.mark.parametrize("names", ["a,b,std", "a,b,c_std"])
def test_an_uncertainty_of_nobody_is_refused(refuse: Refuse, names: str) -> None:
    assert "unclear whose uncertainty" in refuse(f"wavelength_nm,{names}\n400,.1,.2,.01\n500,.1,.2,.01\n")


def test_two_uncertainties_of_one_column_are_refused(refuse: Refuse) -> None:
    assert "whose uncertainty 'a_err' is, beside 'a_std' of 'a'" in refuse(
        "wavelength_nm,a,a_std,a_err\n400,.1,.2,.01\n500,.1,.2,.01\n"
    )


@pytest.mark.parametrize("name", ["fwhm_nm", "FWHM", "Band", "flag", "wavelength_err", "radiance", "cal_factor"])
def test_columns_that_are_no_spectra_are_left_out_and_said(read: Read, name: str) -> None:
    with pytest.warns(LunarSciWarning, match=f"^rock.csv: left out '{name}'"):
        spectra = read(f"wavelength_nm,{name},a,b\n400,10,.1,.3\n500,10,.2,.4\n")
    assert [s.id for s in spectra] == ["a", "b"]


def test_a_radiance_factor_is_a_reflectance(read: Read) -> None:
    assert read("wavelength_nm,radiance_factor\n400,.1\n500,.2\n")[0].id == "rock"


def test_the_text_of_a_column_left_out_need_not_be_numbers(read: Read) -> None:
    with pytest.warns(LunarSciWarning, match="'flag'"):
        assert len(read("wavelength_nm,reflectance,flag\n400,.1,good\n500,.2,bad\n")) == 1


def large(rows: int = 60, columns: int = 400) -> list[list[str]]:
    """A table of numbers as people write them, too large to be read field by field."""
    rng = np.random.default_rng(3)
    styles = ("{!r}", "{:.6g}", "{:.3e}", "{:.4E}", " {:.17g}", "+{:.5f}")
    values = (0.01 + rng.random((rows, columns))) * rng.choice([0.5, 0.01], (rows, 1))
    cells = [[styles[k % 6].format(value) for k, value in enumerate(row)] for row in values.tolist()]
    return [[str(400 + 5 * n), *row] for n, row in enumerate(cells)]


@pytest.mark.parametrize("separator", [",", "\t", ";", ", "])
@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
def test_a_large_table_is_read_to_the_last_bit(read: Read, separator: str) -> None:
    rows = large()
    rows[5][7] = rows[9][300] = ""
    names = ["wavelength_nm", *(f"s{k}" for k in range(400))]
    found = read("\n".join(separator.join(row) for row in [names, *rows]))
    wanted = np.array([[float(cell) if cell else np.nan for cell in row[1:]] for row in rows])
    np.testing.assert_array_equal(np.array([spectrum.reflectance for spectrum in found]).T, wanted)
    assert [spectrum.metadata["channels_missing"] for spectrum in found].count(1) == 2
    np.testing.assert_array_equal(found[-1].wavelength_nm, [float(row[0]) for row in rows])


@pytest.mark.parametrize("cell", ["1e", "0.1.2", "1-2", "nan", "-", "NA", "0x1", "1_0", '"0.5"', "0.2 3", "1d-1"])
def test_one_odd_cell_of_a_large_table(read: Read, refuse: Refuse, cell: str) -> None:
    rows = large()
    rows[30][200] = cell
    text = "\n".join(",".join(row) for row in [["wavelength_nm", *(f"s{k}" for k in range(400))], *rows])
    known = {"nan": np.nan, "-": np.nan, "NA": np.nan, '"0.5"': 0.5, "1d-1": 0.1}
    if cell in known:
        np.testing.assert_array_equal(read(text)[199].reflectance[30], known[cell])
    else:
        assert "line 32, column 's199'" in refuse(text)


def test_a_line_of_a_large_table_is_cut(refuse: Refuse) -> None:
    lines = [",".join(row) for row in [["wavelength_nm", *(f"s{k}" for k in range(400))], *large()]]
    lines[40] = lines[40].rpartition(",")[0]
    assert "line 41 has 400 fields, the others 401" in refuse("\n".join(lines))


@pytest.mark.parametrize("separator", [",", "\t", ";"])
def test_lines_before_the_table_are_kept(read: Read, separator: str) -> None:
    rows = "".join(f"{nm}{separator}0.3\n" for nm in range(400, 410))
    [spectrum] = read(f"Instrument: ASD\nOperator: A, B\nwavelength_nm{separator}rock\n{rows}")
    assert spectrum.id == "rock" and spectrum.metadata["keys"] == {"Instrument": "ASD", "Operator": "A, B"}


def test_channel_numbers_and_errors_of_another_language_are_no_spectra(read: Read) -> None:
    with pytest.warns(LunarSciWarning, match="left out 'Kanal'"):
        [spectrum] = read(
            "Kanal;Wellenlaenge [nm];Reflexion;Fehler\n1;400,5;0,1;0,01\n2;500;0,2;0,01\n3;600;0,3;0,01\n"
        )
    assert np.allclose(spectrum.wavelength_nm, WAVELENGTH) and np.allclose(spectrum.reflectance, REFLECTANCE)
    assert spectrum.uncertainty is not None and np.allclose(spectrum.uncertainty, 0.01)


_EXPORTED = """\
Kanal;Wellenlänge [nm];Refl;StdAbw [-];Integr.Zeit [ms];Detektor;temp
1;400,5;0,1;0,001;12;VIS;12,4
2;500;0,2;0,002;12;VIS;12,4
3;600;0,3;0,003;12;SWIR;12,4
"""


def test_columns_of_an_exporter_that_are_no_spectrum_are_left_out_and_said(read: Read) -> None:
    with pytest.warns(LunarSciWarning) as heard:
        (spectrum,) = read(_EXPORTED)
    assert spectrum.id == "rock"
    np.testing.assert_array_equal(spectrum.reflectance, REFLECTANCE)
    np.testing.assert_array_equal(spectrum.uncertainty, [0.001, 0.002, 0.003])
    assert sorted(str(one.message) for one in heard) == [
        "rock.csv: left out 'Kanal', 'Integr.Zeit [ms]', 'Detektor': no reflectance by name, unit or content",
        "rock.csv: left out 'temp': the same value in all rows, no reflectance",
    ]


@pytest.mark.parametrize(
    "error", ["A Std.Abw.", "A_écart-type", "A incertidumbre", "A_погрешность", "Fehler A", "err_A", "A_stderr"]
)
def test_errors_are_known_in_other_languages_too(read: Read, error: str) -> None:
    first, second = read(f"wavelength_nm,A,B,{error}\n400.5,.1,.4,.01\n500,.2,.5,.02\n600,.3,.6,.03\n")
    np.testing.assert_array_equal(first.uncertainty, [0.01, 0.02, 0.03])
    assert second.uncertainty is None


def test_a_sample_whose_name_begins_like_an_error_stays_a_spectrum(read: Read) -> None:
    names = [one.id for one in read("wavelength_nm,Std 99,Errol 2,devitrified\n400,.1,.4,.3\n500,.2,.5,.3\n")]
    assert names == ["Std 99", "Errol 2", "devitrified"]


def test_a_column_as_small_as_an_error_is_said(read: Read) -> None:
    with pytest.warns(LunarSciWarning, match="'q' is below 5 % of 'rock A' before it: .* name it 'rock A_sigma'"):
        assert len(read("wavelength_nm,rock A,q\n400,.1,.001\n500,.2,.002\n600,.3,.003\n")) == 2


@pytest.mark.parametrize("stated", [None, "percent"])
def test_a_column_in_another_unit_is_not_taken_for_a_spectrum_in_percent(refuse: Refuse, stated: str | None) -> None:
    rows = "400,.1,12.1\n500,.2,12.4\n600,.3,12.2\n"
    message = refuse(f"wavelength_nm,rock,temp\n{rows}", reflectance_unit=stated)
    assert "'rock' and 'temp' have medians of 0.2 and 12.2" in message
    assert "'temp (%)'" in message


def test_rows_that_begin_as_comments_are_counted(read: Read) -> None:
    rows = [f"{400 + 10 * k},0.{k + 1}" for k in range(9)]
    rows[3:5] = ["#N/A,0.4", "#N/A,0.5"]
    text = "# made, today\nwavelength_nm,rock\n" + "\n".join(rows) + "\n"
    with pytest.warns(LunarSciWarning, match="left out 2 lines among the data .* the first is line 6"):
        (spectrum,) = read(text)
    assert len(spectrum.wavelength_nm) == 7


def test_tabs_leave_a_comma_for_the_decimal_point(read: Read) -> None:
    (spectrum,) = read("nm\tRefl\tSdev\n400,5\t0,1\t0,01\n500\t0,2\t0,02\n600\t0,3\t0,03\n")
    np.testing.assert_array_equal(spectrum.wavelength_nm, WAVELENGTH)
    np.testing.assert_array_equal(spectrum.uncertainty, [0.01, 0.02, 0.03])


def test_an_error_may_be_named_after_a_column_with_its_unit(read: Read) -> None:
    (spectrum,) = read("Wvl_nm;Refl_pct;Refl_pct_sigma\n400;10;1\n500;11;2\n600;12;3\n")
    np.testing.assert_allclose(spectrum.uncertainty, [0.01, 0.02, 0.03], rtol=1e-12)


def test_lines_of_text_as_wide_as_the_table_are_told_from_its_names(read: Read) -> None:
    [spectrum] = read("Probe;Basalt;\nGerät;ASD;\nlambda_um;R;sd\n0,4;0,1;0,01\n0,5;0,2;0,01\n0,6;0,2;0,01\n")
    np.testing.assert_allclose(spectrum.reflectance, [0.1, 0.2, 0.2])
    np.testing.assert_allclose(spectrum.uncertainty, 0.01)


def test_text_above_numbers_that_have_no_names_is_kept(read: Read) -> None:
    [spectrum] = read("Basalt of the north\nmeasured twice\n400,0.1\n500,0.2\n600,0.2\n700,0.2\n", wavelength_unit="nm")
    assert spectrum.metadata["comments"] == ["Basalt of the north", "measured twice"]
