"""Spectra from files and from memory: the same numbers however they are handed over."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from astropy import units
from astropy.table import Table

from lunarsci.errors import DataError
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


def test_files_and_memory_go_together_and_a_bad_one_is_remembered(tmp_path: Path) -> None:
    FRAME.to_csv(tmp_path / "a.csv", index=False)
    batch = read_batch([(WAVELENGTH[::-1], REFLECTANCE), IN_MEMORY["spectrum"], tmp_path / "*.csv", "none.csv"])
    assert batch.origins == [str(tmp_path / "a.csv"), "<rock>"]
    assert [failure.partition(":")[0] for failure in batch.failures] == ["none.csv", "spectrum 2"]


def test_nothing_to_read_is_an_error() -> None:
    with pytest.raises(DataError, match="no spectra were given"):
        read_batch([])
