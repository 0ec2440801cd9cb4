"""Calibrated spectra as ECSV and FITS: what is written is what the readers of the other commands find."""

import io
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lunarsci.errors import DataError
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.readers.dispatch import read_spectra
from lunarsci.spectra.spectrum import Spectrum
from lunarsci.spectra.vnis.calibrate import calibrate
from lunarsci.spectra.vnis.calibration import Calibration, columns, to_ecsv, to_fits
from lunarsci.spectra.vnis.observation import read_observation
from lunarsci.spectra.vnis.simulation.instrument import simulate
from lunarsci.spectra.vnis.simulation.scene import Scene, SceneRock
from lunarsci.spectra.vnis.simulation.template import product_files

PROVENANCE = {"command": "lunarsci spectra calibrate", "inputs": [{"path": "a.2BL", "sha256": "0" * 64}], "seed": None}
WRITERS = {"ecsv": to_ecsv, "fits": to_fits}
both_formats = pytest.mark.parametrize("suffix", list(WRITERS))


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> list[Calibration]:
    """Two observations; the second has a missing channel."""
    made = []
    for sequence, scene in ((12, Scene(sequence=12)), (13, Scene(sequence=13, rock=SceneRock(), shadow_fraction=0.1))):
        folder = tmp_path_factory.mktemp(f"n{sequence}")
        for name, content in product_files(simulate(scene, seed=sequence)).items():
            if sequence == 13 and "-SD_SCI" in name and name.endswith("B"):
                rows = content.splitlines(keepends=True)
                content = b"".join([*rows[:60], rows[60].replace(b"0x00", b"0x04"), *rows[61:]])
            (folder / name).write_bytes(content)
        made.append(calibrate(read_observation(str(next(folder.glob("*SD_SCI*L"))))))
    return made


def read(calibrations: list[Calibration], suffix: str) -> list[Spectrum]:
    return read_spectra(InputFile(f"made.{suffix}", WRITERS[suffix](calibrations, PROVENANCE)))


def check_equal(found: Spectrum, wanted: Calibration) -> None:
    assert found.wavelength_nm == pytest.approx(450 + 5 * np.arange(390), abs=0)
    assert np.array_equal(found.reflectance, wanted.reflectance, equal_nan=True)
    assert found.uncertainty is not None
    assert np.array_equal(found.uncertainty[found.usable], wanted.sigma[found.usable])
    assert np.array_equal(found.usable, np.isfinite(wanted.reflectance))
    assert list(found.systematic) == list(wanted.systematic)
    for name, mode in wanted.systematic.items():
        assert np.array_equal(found.systematic[name], mode)


@both_formats
def test_what_is_written_is_read(pair: list[Calibration], suffix: str) -> None:
    spectra = read(pair, suffix)
    assert [spectrum.id for spectrum in spectra] == ["SYNTHETIC-CE4-0012", "SYNTHETIC-CE4-0013"]
    for found, wanted in zip(spectra, pair, strict=True):
        check_equal(found, wanted)
    assert np.flatnonzero(~spectra[1].usable).tolist() == [150]


@both_formats
def test_one_spectrum_alone_keeps_its_id(pair: list[Calibration], suffix: str) -> None:
    [found] = read(pair[:1], suffix)
    assert found.id == "SYNTHETIC-CE4-0012"
    check_equal(found, pair[0])


@both_formats
def test_an_id_that_comes_twice_is_numbered(pair: list[Calibration], suffix: str) -> None:
    first, second = pair
    spectra = read([first, replace(second, id=first.id), first], suffix)
    assert [spectrum.id for spectrum in spectra] == [f"SYNTHETIC-CE4-0012{end}" for end in ("", "-2", "-3")]
    for found, wanted in zip(spectra, (first, second, first), strict=True):
        check_equal(found, wanted)


@both_formats
def test_equal_input_gives_equal_bytes(pair: list[Calibration], suffix: str) -> None:
    assert WRITERS[suffix](pair, PROVENANCE) == WRITERS[suffix](pair, dict(reversed(PROVENANCE.items())))


def test_columns_are_named_after_their_spectrum(pair: list[Calibration]) -> None:
    names = list(columns(pair[:1]))
    modes = [f"SYNTHETIC-CE4-0012_systematic_{name}" for name in pair[0].systematic]
    assert names == ["wavelength_nm", "SYNTHETIC-CE4-0012", "SYNTHETIC-CE4-0012_sigma", *modes]
    assert len(columns(pair)) == 1 + sum(2 + len(item.systematic) for item in pair)


def test_ecsv_has_units_provenance_and_what_is_known(pair: list[Calibration]) -> None:
    from astropy.table import Table

    table = Table.read(to_ecsv(pair, PROVENANCE).decode().splitlines(), format="ascii.ecsv")
    assert str(table["wavelength_nm"].unit) == "nm"
    assert all(table[name].unit == "" for name in table.colnames[1:])
    assert table.meta["provenance"] == PROVENANCE
    check_description(dict(table.meta), pair)


def test_fits_has_units_provenance_and_what_is_known(pair: list[Calibration]) -> None:
    from astropy.io import fits

    with fits.open(io.BytesIO(to_fits(pair, PROVENANCE))) as hdus:
        hdus.verify("exception")
        assert [hdu.name for hdu in hdus] == ["PRIMARY", "SPECTRA", "PROVENANCE"]
        assert hdus["SPECTRA"].columns["wavelength_nm"].unit == "nm"
        record = json.loads(hdus["PROVENANCE"].data["json"][0])
    assert record["provenance"] == PROVENANCE
    check_description(record, pair)


def check_description(record: Mapping[str, Any], pair: list[Calibration]) -> None:
    assert record["title"] == "SYNTHETIC reflectance factor of Chang'E-4 VNIS observations"
    assert [item["id"] for item in record["observations"]] == [item.id for item in pair]
    for stated, item in zip(record["observations"], pair, strict=True):
        assert stated["splice"]["gain"] == item.splice.gain
        assert stated["footprint"]["pixels"] == 9085
        assert stated["notes"] == list(item.notes)
        assert stated["synthetic"] is True


def test_only_synthetic_observations_are_called_so(pair: list[Calibration]) -> None:
    real = [replace(item, synthetic=False) for item in pair]
    assert b"SYNTHETIC reflectance" not in to_ecsv(real, PROVENANCE)
    assert b"SYNTHETIC reflectance" in to_ecsv([*real, pair[0]], PROVENANCE)


# -- Columns of shifts in other tables --------------------------------------------------------------------------------

GRID = 450 + 5 * np.arange(50)


def text(names: list[str], *, separator: str = ",") -> InputFile:
    """Values 0.1, 0.2, ... by column."""
    rows = [separator.join(f"{0.1 * k:.1f}" for k in range(1, len(names) + 1)) for _ in GRID]
    lines = [f"{w}{separator}{row}" for w, row in zip(GRID, rows, strict=True)]
    return InputFile("table.csv", "\n".join([separator.join(["wavelength_nm", *names]), *lines]).encode())


@pytest.mark.parametrize("separator", [",", "\t"])
def test_shifts_are_read_from_text(separator: str) -> None:
    names = ["a", "a_sigma", "a_systematic_level", "b", "a_systematic_slope_2", "b_systematic_level"]
    first, second = read_spectra(text(names, separator=separator))
    assert (first.id, second.id) == ("a", "b")
    assert set(first.systematic) == {"level", "slope_2"}
    assert first.systematic["level"] == pytest.approx(np.full(50, 0.3))
    assert first.systematic["slope_2"] == pytest.approx(np.full(50, 0.5))
    assert first.uncertainty == pytest.approx(np.full(50, 0.2))
    assert set(second.systematic) == {"level"}
    assert second.systematic["level"] == pytest.approx(np.full(50, 0.6))
    assert second.uncertainty is None


def test_shifts_are_in_the_unit_of_their_spectrum() -> None:
    """13 per cent with a shift of 1.3 is 0.13 with 0.013; shifts have either sign."""
    rows = [f"{w},13.0,{1.3 if k % 2 else -1.3}" for k, w in enumerate(GRID)]
    source = InputFile("t.csv", "\n".join(["wavelength_nm,r [%],r_systematic_level", *rows]).encode())
    [found] = read_spectra(source, reflectance_unit="percent")
    assert found.reflectance == pytest.approx(np.full(50, 0.13))
    assert found.systematic["level"] == pytest.approx(0.013 * np.where(np.arange(50) % 2, 1, -1))


def test_descending_rows_are_turned_with_their_shifts() -> None:
    rows = [f"{w},0.1,{w / 1e5}" for w in GRID[::-1]]
    [found] = read_spectra(InputFile("t.csv", "\n".join(["wavelength_nm,r,r_systematic_level", *rows]).encode()))
    assert found.systematic["level"] == pytest.approx(GRID / 1e5)


@pytest.mark.parametrize("suffix", ["csv", "ecsv"])
def test_a_shift_of_nothing_is_refused(suffix: str) -> None:
    source = text(["a", "b_systematic_level"])
    if suffix == "ecsv":
        body = source.data.decode().replace(",", " ")
        head = ["# %ECSV 1.0", "# ---", "# datatype:"]
        head += [f"# - {{name: {name}, datatype: float64}}" for name in ("wavelength_nm", "a", "b_systematic_level")]
        source = InputFile("table.ecsv", "\n".join([*head, body]).encode())
    with pytest.raises(DataError, match=f"^table.{suffix}: there is no column 'b' that 'b_systematic_level' belongs"):
        read_spectra(source)


def test_a_shift_with_a_gap_is_refused() -> None:
    rows = [f"{w},0.1,{'' if k == 3 else 0.01}" for k, w in enumerate(GRID)]
    source = InputFile("t.csv", "\n".join(["wavelength_nm,r,r_systematic_level", *rows]).encode())
    with pytest.raises(DataError, match="systematic 'level' is not known in every usable channel"):
        read_spectra(source)


@pytest.mark.parametrize("name", ["a_Systematic_x", "A_systematic_y"])
def test_letters_of_either_case(name: str) -> None:
    if name.startswith("A"):
        with pytest.raises(DataError, match="there is no column 'A'"):
            read_spectra(text(["a", name]))
    else:
        assert set(read_spectra(text(["a", name]))[0].systematic) == {"x"}


Write = Callable[[Mapping[str, bytes]], Path]


def test_a_label_is_read_as_the_calibrated_spectrum(products: dict[str, bytes], write: Write) -> None:
    folder = write(products)
    for name in products:
        if "_SCI_" in name:
            [found] = read_spectra(str(folder / name))
            wanted = calibrate(read_observation(str(folder / name)))
            check_equal(found, wanted)
            assert found.metadata["inputs"] == wanted.inputs
