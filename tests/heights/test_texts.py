"""Heights as text and as rasters of other programs, and numbers that stand for none.

The formats are those of GDAL's descriptions: XYZ (https://gdal.org/drivers/raster/xyz.html), AAIGrid (aaigrid.html),
GSAG (gsag.html), HFA (hfa.html) and PDS (pds.html); of PDS3 labels those of the PDS Standards Reference 3.8.
"""

from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.guide.info import info
from lunarsci.heights.grid import HeightGrid, without_markers
from lunarsci.heights.grids import read_grid

X, Y = 100.0 + 0.5 * np.arange(12), 20.0 + 0.5 * np.arange(10)
HEIGHT = -2500.0 + 0.03 * X[None, :] - 0.02 * Y[:, None]
MARKED = [-9999.0, -32768.0, -32767.0, -99999.0, 65535.0, -3.4028235e38, 1e20, 1.70141e38, -1e32]


def nodes(end: str = "{:.2f} {:.2f} {:.4f}", names: str = "", *, north_first: bool = True) -> str:
    rows = range(len(Y) - 1, -1, -1) if north_first else range(len(Y))
    lines = [end.format(X[i], Y[k], HEIGHT[k, i]) for k in rows for i in range(len(X))]
    return "\n".join([*([names] if names else []), *lines, ""])


def check(grid: HeightGrid, holes: int = 0, digits: float = 1e-3) -> None:
    assert (grid.x0_m, grid.y0_m, grid.spacing_m) == pytest.approx((100.0, 20.0, 0.5))
    assert np.isnan(grid.height_m).sum() == holes
    assert np.nanmax(np.abs(grid.height_m - HEIGHT)) < digits


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.xyz", nodes()),
        ("a.xyz", nodes("{:.2f}\t{:.2f}\t{:.4f}", "X\tY\tZ")),
        ("a.xyz", nodes("{:.2f},{:.2f},{:.4f}", north_first=False)),
        ("a.xyz", "# made for a test\n" + nodes("   {:.2f}   {:.2f}   {:.4e}".replace("4e", "7e"))),
        ("a.dat", nodes()),
    ],
)
def test_tables_of_nodes_are_read_with_and_without_names(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    grid = read_grid(tmp_path / name)
    check(grid)
    assert any("as x, y and height" in said for said in grid.read_as)
    told = info(tmp_path / name)
    assert (told.kind, told.trouble) == ("terrain", "")
    assert "as x, y and height" in told.contents["read as"]


def test_a_table_names_the_unit_of_its_heights_and_holes_are_what_is_not_there(tmp_path: Path) -> None:
    lines = nodes("{:.2f} {:.2f} {:.6f}", "x y z_km").splitlines()
    cells = [line.split() for line in lines[1:]]
    (tmp_path / "a.xyz").write_text(
        "\n".join([lines[0], *(f"{x} {y} {float(z) / 1e3:.7f}" for x, y, z in cells[3:]), ""])
    )
    grid = read_grid(tmp_path / "a.xyz")
    check(grid, holes=3)
    assert "heights are in km, as the file states" in grid.read_as


def test_rounded_places_are_on_even_steps(tmp_path: Path) -> None:
    lines = [f"{x:.2f} {y:.2f} 1.5" for y in np.arange(9) / 3 for x in np.arange(9) / 3]
    (tmp_path / "a.xyz").write_text("\n".join([*lines, ""]))
    assert read_grid(tmp_path / "a.xyz").spacing_m == pytest.approx(1 / 3, abs=2e-3)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("lon lat z\n1 2 3\n2 2 3\n", "2 longitudes and 1 latitudes"),
        ("wavelength_nm,a,b\n500,0.1,0.2\n", "no table of x, y and height"),
        ("x y z\n0 0 1\n1 0 1\n0 1 1\n", "at least 3"),
        ("x y z\n0 0 1\n1 0\n", "no table of x, y and height"),
    ],
)
def test_other_tables_are_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "a.xyz").write_text(text)
    with pytest.raises(DataError, match=said):
        read_grid(tmp_path / "a.xyz")


def test_three_columns_of_a_spectrum_are_no_terrain(tmp_path: Path) -> None:
    lines = [f"{w} {0.1 + 1e-5 * w:.3f} 0.001" for w in range(450, 2400, 5)]
    (tmp_path / "rock.txt").write_text("\n".join([*lines, ""]))
    assert info(tmp_path / "rock.txt").kind == "spectra"


def ascii_grid(path: Path, header: str, fill: float) -> Path:
    height = HEIGHT[::-1].copy()
    height[2:4, 3:6] = fill
    rows = "\n".join(" ".join(f"{h!r}" for h in row) for row in height.tolist())
    path.write_text(f"ncols 12\nnrows 10\nxllcenter 100\nyllcenter 20\ncellsize 0.5\n{header}{rows}\n")
    return path


@pytest.mark.parametrize("name", ["a.asc", "a.txt", "a.grd"])
@pytest.mark.parametrize("fill", [*MARKED, np.nan, 0.0])
def test_usual_markers_are_holes_where_the_file_names_none_or_another(tmp_path: Path, name: str, fill: float) -> None:
    for header in ("", "NODATA_value -1\n"):
        unsaid = not np.isnan(fill) and (header != "" or fill != -9999)
        with pytest.warns(LunarSciWarning, match="without data") if unsaid else nullcontext():
            grid = read_grid(ascii_grid(tmp_path / name, header, fill))
        check(grid, holes=6)
        assert any("without data" in said for said in grid.read_as) == unsaid


@pytest.mark.parametrize("heights", [[-9000.0, 9000.0, 9999.0, 0.0], [1.0, 1.0, 2.0, 3.0], [-9999.0] * 4, [0.0, 5.0]])
def test_heights_that_could_be_are_kept(heights: list[float]) -> None:
    found, said = without_markers(np.array(heights))
    assert (list(found), said) == (heights, "")


def test_a_box_on_level_ground_stays_one(tmp_path: Path) -> None:
    height = np.zeros((10, 12))
    height[4:6, 4:6] = 1.0
    np.savez(tmp_path / "box.npz", x_m=X, y_m=Y, height_m=height)
    assert read_grid(tmp_path / "box.npz").height_m.max() == 1.0


@pytest.mark.parametrize(("end", "driver"), [("img", "HFA"), ("grd", "GSBG"), ("grd", "GSAG"), ("tif", "GTiff")])
def test_rasters_of_other_programs(tmp_path: Path, end: str, driver: str) -> None:
    rasterio, copying = pytest.importorskip("rasterio"), pytest.importorskip("rasterio.shutil")
    transform = rasterio.transform.from_origin(99.75, 24.75, 0.5, 0.5)
    height = HEIGHT[::-1].astype(np.float32)
    height[0, 0] = -32768.0
    kind = {"width": 12, "height": 10, "count": 1, "dtype": "float32", "transform": transform}
    with rasterio.open(tmp_path / "made.tif", "w", driver="GTiff", **kind) as raster:
        raster.write(height, 1)
    path = tmp_path / f"a.{end}"
    if driver == "GTiff":
        path = tmp_path / "made.tif"
    else:
        copying.copy(tmp_path / "made.tif", path, driver=driver)
    with pytest.warns(LunarSciWarning, match="1 nodes of -32768 are without data"):
        grid = read_grid(path)
    check(grid, holes=1, digits=2e-3)
    assert "1 nodes of -32768 are without data" in "; ".join(grid.read_as)
    assert (info(path).kind, info(path).trouble) == ("terrain", "")
