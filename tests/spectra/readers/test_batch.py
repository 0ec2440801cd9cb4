"""Spectra from files and from memory: the same numbers however they are handed over."""

import io
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from astropy import units
from astropy.table import Table

from lunarsci.errors import DataError
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.readers.batch import read_batch
from lunarsci.spectra.spectrum import Spectrum

WAVELENGTH = np.linspace(500.0, 2500.0, 21)
REFLECTANCE = 0.1 + 1e-5 * WAVELENGTH
FRAME = pd.DataFrame({"wavelength_nm": WAVELENGTH, "rock": REFLECTANCE})
IN_MEMORY: dict[str, Any] = {
    "arrays": (WAVELENGTH, REFLECTANCE),
    "lists": (WAVELENGTH.tolist(), REFLECTANCE.tolist()),
    "quantity": (WAVELENGTH / 1000 * units.um, REFLECTANCE),
    "spectrum": Spectrum("rock", WAVELENGTH, REFLECTANCE),
    "frame": FRAME,
    "table": Table({"wavelength_nm": WAVELENGTH, "rock": REFLECTANCE}),
    "open file": io.StringIO(FRAME.to_csv(index=False)),
}


@pytest.mark.parametrize("name", IN_MEMORY)
def test_a_spectrum_in_memory_is_the_same_however_it_comes(name: str) -> None:
    batch = read_batch(IN_MEMORY[name])
    assert len(batch.spectra) == len(batch.origins) == len(batch.inputs) == 1
    np.testing.assert_allclose(batch.spectra[0].wavelength_nm, WAVELENGTH, rtol=1e-12)
    np.testing.assert_allclose(batch.spectra[0].reflectance, REFLECTANCE, rtol=1e-12)


def test_a_table_of_many_spectra_takes_little_more_memory_than_its_numbers() -> None:
    """60 channels are 480 bytes of numbers a spectrum, 600 of text; objects of each took 5,000."""

    def taken(count: int) -> np.ndarray:
        """Bytes that are there after reading, and at most."""
        values = np.random.default_rng(0).uniform(0.1, 0.4, (60, count))
        names = ",".join(f"s{k}" for k in range(count))
        lines = [",".join(f"{v:.7g}" for v in row) for row in np.column_stack([np.linspace(460, 2400, 60), values])]
        source = InputFile("many.csv", "\n".join([f"wavelength_nm,{names}", *lines]).encode())
        tracemalloc.start()
        batch = read_batch(source)
        found = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert len(batch.spectra) == count
        return np.array(found)

    taken(600)  # imports
    kept, most = (taken(10_000) - taken(5_000)) / 5_000
    assert kept < 1000
    assert most < 2000


def test_files_and_memory_go_together_and_a_bad_one_is_remembered(tmp_path: Path) -> None:
    FRAME.to_csv(tmp_path / "a.csv", index=False)
    batch = read_batch([(WAVELENGTH[[0, 0, 1]], REFLECTANCE), IN_MEMORY["spectrum"], tmp_path / "*.csv", "none.csv"])
    assert batch.origins == [str(tmp_path / "a.csv"), "<rock>"]
    assert [failure.partition(":")[0] for failure in batch.failures] == ["none.csv", "spectrum 3"]


def test_nothing_to_read_is_an_error() -> None:
    with pytest.raises(DataError, match="no spectra were given"):
        read_batch([])
