"""Units of wavelength and reflectance: who decides, and what is said."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lunarsci.errors import LunarSciWarning, ParameterError
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.readers.dispatch import read_spectra
from lunarsci.spectra.spectrum import Spectrum

Read = Callable[..., list[Spectrum]]
Refuse = Callable[..., str]


def table(name: str, wavelengths: list[float], reflectance: str = "reflectance", scale: float = 0.1) -> str:
    rows = "".join(f"{w!r},{scale * (k + 1)!r}\n" for k, w in enumerate(wavelengths))
    return f"{name},{reflectance}\n{rows}"


@pytest.mark.parametrize(
    "name",
    [
        "wavelength_nm",
        "Wavelength (nm)",
        "nm",
        "WL [nm]",
        "wavelength nanometers",
        "lambda_nm",
        "Channel wavelength (air, nm)",
    ],
)
def test_names_for_nanometres(read: Read, name: str) -> None:
    (spectrum,) = read(table(f'"{name}"', [400, 2500]))
    np.testing.assert_array_equal(spectrum.wavelength_nm, [400, 2500])
    assert (spectrum.metadata["wavelength_unit"], spectrum.metadata["wavelength_unit_from"]) == ("nm", "file")


@pytest.mark.parametrize(
    "name",
    [
        "wavelength_um",
        "Wavelength (µm)",
        "Wavelength (μm)",
        "wl [um]",
        "microns",
        "Wavelength (micron)",
        "Wavelength in micrometers",
    ],
)
def test_names_for_micrometres(read: Read, name: str) -> None:
    (spectrum,) = read(table(name, [0.4, 2.5]))
    np.testing.assert_allclose(spectrum.wavelength_nm, [400, 2500], rtol=1e-15)
    assert (spectrum.metadata["wavelength_unit"], spectrum.metadata["wavelength_unit_from"]) == ("um", "file")


@pytest.mark.parametrize(
    "name",
    [
        "wavelength (eV)",
        "wavelength_thz",
        "energy_eV",
        "wavelength_nm (um)",
    ],
)
def test_other_units_in_a_name_are_refused(refuse: Refuse, name: str) -> None:
    assert "name it wavelength_nm or _um" in refuse(table(name, [400, 2500]))


def test_the_caller_states_what_the_file_does_not(read: Read) -> None:
    (spectrum,) = read(table("wavelength", [0.4, 25.0]), wavelength_unit="um")
    np.testing.assert_allclose(spectrum.wavelength_nm, [400, 25000])
    assert spectrum.metadata["wavelength_unit_from"] == "caller"


@pytest.mark.parametrize(("values", "unit", "factor"), [([0.35, 2.6], "µm", 1000), ([350, 2600], "nm", 1)])
def test_values_decide_last_and_this_is_said(read: Read, values: list[float], unit: str, factor: int) -> None:
    with pytest.warns(LunarSciWarning, match=rf"^rock\.csv: wavelengths {values[0]:g}-{values[1]:g} .*read as {unit};"):
        (spectrum,) = read(table("wavelength", values))
    np.testing.assert_allclose(spectrum.wavelength_nm, np.multiply(values, factor))


@pytest.mark.parametrize("values", [[4.0, 25.0], [0.4, 2500.0], [100.0, 500.0], [1.0, 222.0], [4000.0, 6000.0]])
def test_values_that_tell_nothing_are_refused(refuse: Refuse, values: list[float]) -> None:
    assert "give `wavelength_unit` nm or um" in refuse(table("wavelength", values))


@pytest.mark.parametrize(
    ("name", "values", "truth", "factor"),
    [
        ("wavelength_nm", [0.4, 2.5], "um", 1000),
        ("wavelength_um", [400, 2500], "nm", 1),
        ("wavelength_nm", [0.4, 2500], "nm", 1),
    ],
)
@pytest.mark.filterwarnings("ignore:.*do not look like it:lunarsci.errors.LunarSciWarning")
def test_a_name_that_contradicts_the_values_needs_the_callers_word(
    read: Read, refuse: Refuse, name: str, values: list[float], truth: str, factor: int
) -> None:
    assert "as the file says; give `wavelength_unit` nm or um" in refuse(table(name, values))
    (spectrum,) = read(table(name, values), wavelength_unit=truth)
    np.testing.assert_allclose(spectrum.wavelength_nm, np.multiply(values, factor))


def test_a_name_the_values_allow_wins_over_the_caller(read: Read) -> None:
    with pytest.warns(LunarSciWarning, match="read as nm, .* not um"):
        (spectrum,) = read(table("wavelength_nm", [400, 2500]), wavelength_unit="um")
    np.testing.assert_array_equal(spectrum.wavelength_nm, [400, 2500])


def test_an_unlikely_word_of_the_caller_is_said(read: Read) -> None:
    with pytest.warns(LunarSciWarning, match="do not look like it"):
        (spectrum,) = read(table("wavelength", [400, 2500]), wavelength_unit="um")
    np.testing.assert_array_equal(spectrum.wavelength_nm, [4e5, 2.5e6])


@pytest.mark.parametrize(
    "name", ["reflectance (%)", "Reflectance [percent]", "reflectance_percent", "R%", "refl %", "olivine (%)"]
)
def test_percent_in_a_name(read: Read, name: str) -> None:
    (spectrum,) = read(table("wavelength_nm", [400, 500, 600], name, 10.0))
    np.testing.assert_allclose(spectrum.reflectance, [0.1, 0.2, 0.3], rtol=1e-15)
    assert spectrum.id == ("olivine" if "olivine" in name else "rock")
    assert (spectrum.metadata["reflectance_unit"], spectrum.metadata["reflectance_unit_from"]) == ("percent", "file")


def test_percent_holds_for_the_uncertainty_too(read: Read) -> None:
    (spectrum,) = read("wavelength_nm,reflectance (%),std\n400,10,1\n500,20,2\n")
    np.testing.assert_allclose(spectrum.uncertainty, [0.01, 0.02], rtol=1e-15)


def test_an_uncertainty_in_percent_of_a_fraction_is_ambiguous(refuse: Refuse) -> None:
    assert "give both in one unit" in refuse("wavelength_nm,reflectance,error (%)\n400,.1,1\n500,.2,2\n")


def test_values_above_two_are_percent(read: Read) -> None:
    content = table("wavelength_nm", [400, 500, 600], scale=10.0)
    with pytest.warns(LunarSciWarning, match="read as percent; `reflectance_unit` decides otherwise"):
        (spectrum,) = read(content)
    np.testing.assert_allclose(spectrum.reflectance, [0.1, 0.2, 0.3])
    (spectrum,) = read(content, reflectance_unit="percent")
    np.testing.assert_allclose(spectrum.reflectance, [0.1, 0.2, 0.3])
    with pytest.warns(LunarSciWarning, match="unlikely"):
        (spectrum,) = read(content, reflectance_unit="fraction")
    np.testing.assert_allclose(spectrum.reflectance, [10, 20, 30])


def test_values_far_above_a_hundred_look_like_radiance(refuse: Refuse) -> None:
    assert "radiance or DN" in refuse(table("wavelength_nm", [400, 500], scale=500.5))


def test_percent_that_the_values_contradict_needs_a_word(read: Read, refuse: Refuse) -> None:
    content = table("wavelength_nm", [400, 500, 600], "mix_50_percent")
    assert "no percent as the file says" in refuse(content)
    np.testing.assert_allclose(read(content, reflectance_unit="fraction")[0].reflectance, [0.1, 0.2, 0.3])


def test_the_files_percent_wins_over_the_caller_and_is_said(read: Read) -> None:
    with pytest.warns(LunarSciWarning, match="unit that the file states"):
        (spectrum,) = read(table("wavelength_nm", [400, 500], "reflectance (%)", 1.5), reflectance_unit="fraction")
    np.testing.assert_allclose(spectrum.reflectance, [0.015, 0.03])


@pytest.mark.parametrize("option", [{"wavelength_unit": "mm"}, {"reflectance_unit": "dn"}, {"format": "xlsx"}])
def test_unknown_options_are_refused(read: Read, option: dict[str, str]) -> None:
    with pytest.raises(ParameterError, match="use one of"):
        read(table("wavelength_nm", [400, 500]), **option)


@given(st.lists(st.floats(350, 2600), min_size=2, max_size=30, unique=True), st.booleans())
def test_nm_um_and_order_give_the_same_spectrum(wavelengths: list[float], percent: bool) -> None:
    ascending = sorted(wavelengths)
    reflectance = [0.05 + 0.9 * k / len(ascending) for k in range(len(ascending))]
    texts = []
    for name, factor, turn in (("nm", 1.0, 1), ("um", 1e-3, 1), ("nm", 1.0, -1), ("um", 1e-3, -1)):
        pairs = list(zip(ascending, reflectance, strict=True))[::turn]
        texts.append(f"wavelength_{name},reflectance\n" + "".join(f"{w * factor!r},{r!r}\n" for w, r in pairs))
    spectra = [read_spectra(InputFile("a.csv", t.encode()))[0] for t in texts if _still_distinct(t)]
    for spectrum in spectra:
        np.testing.assert_allclose(spectrum.wavelength_nm, ascending, rtol=1e-9)
        np.testing.assert_array_equal(spectrum.reflectance, reflectance)


def _still_distinct(text: str) -> bool:
    """Neighbouring floats may round to one number when divided by 1000."""
    values = [float(line.split(",")[0]) for line in text.splitlines()[1:]]
    factor = 1000.0 if text.startswith("wavelength_um") else 1.0
    return len({v * factor for v in values}) == len(values)
