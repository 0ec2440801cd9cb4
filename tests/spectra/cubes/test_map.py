"""Maps of cubes: every pixel is what the single command measures there, in both formats, with flags and places."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lunarsci.spectra.jobs.bands import bands
from lunarsci.spectra.jobs.fit import fit
from lunarsci.spectra.jobs.map import map as map_cube
from lunarsci.spectra.jobs.map import pixel
from lunarsci.spectra.readers import read_spectra

from .conftest import spectra

rasterio = pytest.importorskip("rasterio")
xarray = pytest.importorskip("xarray")
pytest.importorskip("h5netcdf")

CUBE = spectra(6, 5, seed=4).astype("f4")
PLACES = [(0, 0), (4, 5), (2, 3), (1, 1)]


def opened(path: Path) -> Any:
    with xarray.open_dataset(path, engine="h5netcdf") as data:
        return data.load()


def spoiled() -> Any:
    cube = CUBE.copy()
    cube[5, 0] = -999
    cube[3, 2, [20, 50]] = -999
    cube[1, 1, 60] = -0.001
    return cube


def test_a_pixel_is_what_the_single_commands_measure_on_its_spectrum(envi: Any, tmp_path: Path) -> None:
    path = envi(spoiled(), data_ignore_value=-999)
    out = tmp_path / "map.nc"
    result = map_cube(str(path), out, products="bands,fit", assemblage="OPX-CPX")
    found = opened(out)
    assert result.counts == {
        "pixels": 30, "no_data": 1, "left_out": 0, "channels_missing": 2, "channels_saturated": 0,
        "channels_not_positive": 1,
    }  # fmt: skip
    for sample, line in PLACES:
        if (sample, line) == (0, 5):
            continue
        table = tmp_path / f"{sample}-{line}.csv"
        rows = pixel(str(path), f"{sample},{line}").rows()
        names = list(rows[0])
        cells = ["" if row[names[1]] != row[names[1]] else repr(row[names[1]]) for row in rows]
        lines = [",".join(names), *(f"{row[names[0]]!r},{cell}" for row, cell in zip(rows, cells, strict=True))]
        table.write_text("\n".join(lines))
        spectrum = read_spectra(str(table))[0]
        own = found.isel(line=line, sample=sample)
        measured = bands(spectrum).to_dict()["spectra"][0]
        for key in ("bc1000_nm", "bc1000_sigma_nm", "bd1000", "bd2000_sigma", "bc2000_nm", "ba2000_nm", "bas1000"):
            np.testing.assert_allclose(float(own[key]), np.nan if measured[key] is None else measured[key], rtol=1e-9)
        fitted = fit(spectrum, assemblage="OPX-CPX").to_dict()["spectra"][0]
        for band in fitted["bands"]:
            stem = band["name"].lower().replace(" ", "_").replace(".", "_")
            for key in ("center_nm", "center_sigma_nm", "fwhm_nm", "fwhm_sigma_nm", "strength", "strength_sigma"):
                np.testing.assert_allclose(float(own[f"{stem}_{key}"]), band[key], rtol=1e-9)
        for region, ratio in fitted["nbsr"].items():
            wanted = np.nan if ratio is None else ratio["opx"]
            np.testing.assert_allclose(float(own[f"nbsr_{region}_opx"]), wanted, rtol=1e-9)
        np.testing.assert_allclose(float(own["fit_rms_ln"]), fitted["rms_ln"], rtol=1e-9)
        np.testing.assert_allclose(float(own["fit_reduced_chi2"]), fitted["reduced_chi2"], rtol=1e-9)
    empty = found.isel(line=5, sample=0)
    assert int(empty["pixel_flags"]) & 1
    assert np.isnan(float(empty["bc1000_nm"]))
    assert np.isnan(float(empty["fit_rms_ln"]))
