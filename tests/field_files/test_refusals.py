"""What has no reading, or two that are alike, is refused; the advice of a refusal, followed, gives what is right.

Kinds and sources are those of the other files of this folder.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from lunarsci.cli import main

import lunarsci
from lunarsci.errors import DataError, LunarSciError
from lunarsci.heights.grids import read_grid
from lunarsci.io.inputs import read_input
from lunarsci.spectra.readers.dispatch import read_spectra
from lunarsci.twin.telemetry.reading import read_positions

NM = np.arange(400.0, 2501.0, 10.0)
R = 0.2 + 1e-5 * (NM - 400) - 0.05 * np.exp(-(((NM - 950) / 100) ** 2)) + 1e-4 * np.sin(NM)
X, Y = 500.0 + 2.0 * np.arange(8), 300.0 + 2.0 * np.arange(6)
HEIGHT = -100.0 + 0.1 * (X[None, :] - 500) - 0.05 * (Y[:, None] - 300)


def said(path: Path, read: Callable[[str], object]) -> str:
    with pytest.raises(LunarSciError) as refused:
        read(str(path))
    text = str(refused.value)
    assert "\n" not in text
    return text


def test_three_columns_without_names_and_a_header(tmp_path: Path) -> None:
    path, body = tmp_path / "a.csv", "".join(f"{a:g},{b:.7g},{0.1 * b:.7g}\n" for a, b in zip(NM, R, strict=True))
    path.write_text(body)
    assert "wavelength_nm,reflectance,reflectance_sigma" in said(path, read_spectra)
    path.write_text("wavelength_nm,reflectance,reflectance_sigma\n" + body)
    [spectrum] = read_spectra(str(path))
    np.testing.assert_allclose(spectrum.reflectance, R, rtol=1e-6)
    assert spectrum.uncertainty is not None


@pytest.mark.parametrize("unit", ["TRANSMITTANCE", "RADIANCE"])
def test_another_quantity_of_jcamp_is_no_reflectance(unit: str, tmp_path: Path) -> None:
    """McDonald & Wilks 1988: YUNITS says what is measured."""
    pairs = "\n".join(f"{a:g},{b:.7g}" for a, b in zip(NM, R, strict=True))
    path = tmp_path / "a.jdx"
    path.write_text(
        f"##TITLE= a\n##XUNITS= NANOMETERS\n##YUNITS= {unit}\n##NPOINTS= {NM.size}\n##XYPOINTS= (XY..XY)\n{pairs}\n"
        "##END=\n"
    )
    assert f"no reflectance column beside '{unit}'" in said(path, read_spectra)
    assert main(["spectra", "bands", str(path), "-q"]) == 1
    path.write_text(path.read_text().replace(unit, "REFLECTANCE").replace(f"= {NM.size}", f"= {NM.size + 1}"))
    assert f"{NM.size} points, NPOINTS says {NM.size + 1}" in said(path, read_spectra)
    path.write_text(path.read_text().replace(f"= {NM.size + 1}", f"= {NM.size}"))
    [spectrum] = read_spectra(str(path))
    np.testing.assert_allclose(spectrum.reflectance, R, rtol=1e-6)


def test_a_damaged_line_of_squeezed_jcamp_is_told_by_its_check(tmp_path: Path) -> None:
    path = tmp_path / "a.jdx"
    head = "##TITLE= a\n##XUNITS= NANOMETERS\n##YUNITS= REFLECTANCE\n##YFACTOR= 0.001\n##FIRSTX= 400\n##LASTX= 450\n"
    body = "##NPOINTS= 6\n##XYDATA= (X++(Y..Y))\n400B00J1J1\n420{}J1J1J1\n##END=\n"
    path.write_text(head + body.format("B22"))
    [spectrum] = read_spectra(str(path))
    assert spectrum.reflectance == pytest.approx([0.200, 0.211, 0.222, 0.233, 0.244, 0.255])
    path.write_text(head + body.format("B23"))
    assert "the check of a line is 223, not 222" in said(path, read_spectra)


def test_heights_without_places_and_the_archive(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", HEIGHT)
    assert "numpy.savez" in said(tmp_path / "a.npy", read_grid)
    np.savez(tmp_path / "a.npz", x_m=X, y_m=Y, height_m=HEIGHT)
    np.testing.assert_array_equal(read_grid(tmp_path / "a.npz").height_m, HEIGHT)


def test_longitudes_beyond_a_circle_are_metres_by_their_names(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    table = pd.DataFrame({"lon": np.tile(X, Y.size), "lat": np.repeat(Y, X.size), "height": HEIGHT.ravel()})
    table.to_csv(path, index=False)
    assert "name columns in m x_m and y_m" in said(path, read_grid)
    table.rename(columns={"lon": "x_m", "lat": "y_m", "height": "height_m"}).to_csv(path, index=False)
    np.testing.assert_allclose(read_grid(path).height_m, HEIGHT)


def test_a_system_beside_a_grid_that_is_none_is_taken_away(tmp_path: Path) -> None:
    rows = "\n".join(" ".join(f"{value:.6f}" for value in row) for row in HEIGHT[::-1])
    path = tmp_path / "a.asc"
    path.write_text(f"ncols 8\nnrows 6\nxllcenter 500\nyllcenter 300\ncellsize 2\n{rows}\n")
    (tmp_path / "a.prj").write_text("nothing of the kind")
    assert "correct it or take it away" in said(path, read_grid)
    (tmp_path / "a.prj").unlink()
    np.testing.assert_allclose(read_grid(path).height_m, HEIGHT, atol=1e-6)


def test_two_variables_of_netcdf_and_the_name_that_tells(tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    coordinates = {"y": Y, "x": X}
    data = xarray.Dataset(dict.fromkeys(("one", "other"), (("y", "x"), HEIGHT)), coords=coordinates)
    data.to_netcdf(tmp_path / "a.nc")
    assert "keep one, named height_m" in said(tmp_path / "a.nc", read_grid)
    data.rename(one="height_m").to_netcdf(tmp_path / "b.nc")
    np.testing.assert_array_equal(read_grid(tmp_path / "b.nc").height_m, HEIGHT)


def test_a_fisheye_of_metashape_and_the_frame(tmp_path: Path) -> None:
    path = tmp_path / "a.xml"
    path.write_text(
        "<calibration><projection>fisheye</projection><width>640</width><height>480</height><f>600</f><cx>0</cx>"
        "<cy>0</cy></calibration>"
    )
    assert "calibrate it as frame" in said(path, lambda name: lunarsci.cameras([name]))
    path.write_text(path.read_text().replace("fisheye", "frame"))
    (camera,) = lunarsci.cameras([str(path)]).to_dict()["cameras"]
    assert (camera["fx_px"], camera["cx_px"]) == (600.0, 319.5)


def test_two_localisations_of_one_rover_and_one_of_them(tmp_path: Path) -> None:
    path, time = tmp_path / "a.csv", np.arange(5.0)
    table = pd.DataFrame({"__time": time} | {
        f"/{topic}/pose/pose/position/{axis}": time + k for topic in ("slam", "gps") for k, axis in enumerate("xy")
    } | {f"/slam/pose/covariance[{k}]": 0.01 if k != 1 else 0.0 for k in (0, 1, 7)})  # fmt: skip
    table.to_csv(path, index=False)
    assert "keep the localised ones" in said(path, lambda name: read_positions(read_input(name)))
    table.drop(columns=[name for name in table if "gps" in name]).to_csv(path, index=False)
    found = read_positions(read_input(path))
    np.testing.assert_allclose(found.place_m[:, 1], time + 1)
    np.testing.assert_allclose(found.covariance_m2[:, 1, 1], 0.01)


def test_json_without_two_lists(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text('{"reflectance": [0.1, 0.2, 0.3]}')
    assert "save the spectra as CSV" in said(path, read_spectra)
    with pytest.raises(DataError):
        read_spectra(str(path))
