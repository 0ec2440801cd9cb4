"""Files of heights that lie or are too large: refused with the reason, before they fill the memory."""

import resource
import struct
import subprocess
import sys
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError
from lunarsci.heights.grid import spacing_of
from lunarsci.heights.grids import read_grid
from lunarsci.heights.rasters import MOST_NODES
from lunarsci.images.pictures import read_picture
from lunarsci.io.inputs import InputFile, text

HEIGHTS = "\n".join(" ".join(f"{0.25 + 0.01 * (row + column):.2f}" for column in range(6)) for row in range(6))
HEADER = "ncols 6\nnrows 6\nxllcorner 10\nyllcorner 20\ncellsize 0.5\n"


def ascii_grid(folder: Path, header: str = HEADER, heights: str = HEIGHTS, end: str = "\n") -> Path:
    file = folder / "SYNTHETIC.asc"
    file.write_text(header + heights + end)
    return file


def test_a_sound_grid_is_read(tmp_path: Path) -> None:
    grid = read_grid(ascii_grid(tmp_path))
    assert (grid.x0_m, grid.y0_m, grid.spacing_m) == (10.25, 20.25, 0.5)
    assert grid.height_m[0, 0] == 0.30, "row 0 is the southern one, the last in the file"


@pytest.mark.parametrize(
    ("wrong", "right", "why"),
    [
        ("ncols 6", "ncols 6.9", "counts"),
        ("cellsize 0.5", "cellsize 0.5\ncellsize 5", "twice"),
        ("yllcorner 20", "yllcenter 20", "corner of the first cell, or its centre"),
        ("yllcorner 20", "yllcorner 20\nxllcenter 10", "corner of the first cell, or its centre"),
        ("cellsize 0.5", "cellsize nan", "cellsize"),
        ("cellsize 0.5", "cellsize -0.5", "cellsize"),
        ("ncols 6", "ncols 60000", "at most 40 million"),
        ("cellsize 0.5", "dx 0.5", "no dy"),
        ("cellsize 0.5", "cellsize 0.5\ndx 0.5\ndy 0.5", "cellsize and dx, dy"),
        ("cellsize 0.5", "dx 0.5\ndy -0.5", "cellsize of -0.5"),
    ],
)
def test_headers_that_contradict_themselves(wrong: str, right: str, why: str, tmp_path: Path) -> None:
    header = HEADER.replace(wrong, right)
    header = header.replace("nrows 6", "nrows 40000") if "60000" in right else header
    with pytest.raises(DataError, match=why):
        read_grid(ascii_grid(tmp_path, header))


def test_cells_by_both_their_sides(tmp_path: Path) -> None:
    """A rise of 0.01 a column and -0.01 a row to the north, on cells of 0.5 m by 0.25 m: 0.02 and -0.04."""
    even = read_grid(ascii_grid(tmp_path, HEADER.replace("cellsize 0.5", "dx 0.5\ndy 0.5")))
    assert np.array_equal(even.height_m, read_grid(ascii_grid(tmp_path)).height_m) and even.spacing_m == 0.5
    pytest.importorskip("rasterio")
    oblong = read_grid(ascii_grid(tmp_path, HEADER.replace("cellsize 0.5", "dx 0.5\ndy 0.25")))
    assert oblong.spacing_m == 0.5 and "cells are not square" in oblong.read_as[1]
    along_y, along_x = np.gradient(oblong.height_m, 0.5)
    assert np.nanmax(np.abs(along_x - 0.02)) < 1e-9 and np.nanmax(np.abs(along_y + 0.04)) < 1e-9
    assert oblong.y0_m == pytest.approx(20.125)


def test_a_height_that_stands_for_none(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="stands for no data"):
        read_grid(ascii_grid(tmp_path, heights=HEIGHTS.replace("0.30", "77777", 1)))
    named = ascii_grid(tmp_path, HEADER + "NODATA_value 99999\n", HEIGHTS.replace("0.30", "99999", 1))
    assert np.isnan(read_grid(named).height_m).sum() == 1


@pytest.mark.parametrize("cut", [1, 2])
def test_a_grid_cut_inside_its_last_height(cut: int, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="cut"):
        read_grid(ascii_grid(tmp_path, heights=HEIGHTS[:-cut], end=""))
    assert read_grid(ascii_grid(tmp_path, end="")).height_m.size == 36, "only the line's end is missing"


@pytest.mark.parametrize(
    "rows", ["1.0 0.1234\n2.0 0.1235\n3.0 0.1236\n4.0 0.12", "1,1.2e-10\n2,2.2e-10\n3,1.1e-11\n4,1.3e-1"]
)
def test_text_cut_inside_its_last_number(rows: str) -> None:
    with pytest.raises(DataError, match="cut"):
        text(InputFile("cut.txt", rows.encode()))
    assert text(InputFile("whole.txt", f"{rows}\n".encode()))


@pytest.mark.parametrize(
    "rows", ["1 0.5\n2 0.25\n3 0.125\n4 0.5", "1 2\n2 3\n3 4\n4 1", "a = 1.25\nb = 2.25\nc = 3.5", "x"]
)
def test_text_whose_last_number_is_like_others_is_whole(rows: str) -> None:
    assert text(InputFile("whole.txt", rows.encode())) == rows


@pytest.mark.parametrize(
    ("x", "y", "why"),
    [
        ([0.0, 1.0], [0.0, 1.0, 2.0], "at least 3"),
        ([[0.0, 1.0, 2.0]], [0.0, 1.0, 2.0], "lists of at least 3"),
        ([0.0, 1.0, 2.5], [0.0, 1.0, 2.0], "x_m must ascend in even steps"),
        ([0.0, 1.0, 2.0], [2.0, 1.0, 0.0], "y_m must ascend in even steps"),
        ([0.0, 1.0, 2.0], [0.0, 2.0, 4.0], "cells must be square: steps are 1 m in x_m and 2 m in y_m"),
    ],
)
def test_nodes_that_are_on_no_square_cells(x: list[float], y: list[float], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        spacing_of(np.array(x), np.array(y))
    assert spacing_of(np.array([0.0, 0.5, 1.00004]), np.array([3.0, 3.5, 4.0])) == pytest.approx(0.5, rel=1e-4)


def test_a_file_that_is_no_grid_is_answered_with_those_that_are(tmp_path: Path) -> None:
    path = tmp_path / "site.toml"
    path.write_text("name = 'site'\n")
    with pytest.raises(DataError, match=r"no heights; give a grid of them in .*\.asc.*\.npz.*\.tif"):
        read_grid(path)


def test_complex_heights(tmp_path: Path) -> None:
    axis = 0.5 * np.arange(6)
    np.savez(tmp_path / "complex.npz", x_m=axis, y_m=axis, height_m=np.full((6, 6), 1j))
    with pytest.raises(DataError, match="height_m has complex numbers"):
        read_grid(tmp_path / "complex.npz")


def test_another_format_under_the_name_of_a_geotiff(tmp_path: Path) -> None:
    """A VRT names other files, which whoever reads it would open."""
    secret = tmp_path / "secret.asc"
    secret.write_text(HEADER + HEIGHTS)
    (tmp_path / "named.tif").write_text(
        '<VRTDataset rasterXSize="6" rasterYSize="6"><VRTRasterBand dataType="Float32" band="1"><SimpleSource>'
        f"<SourceFilename>{secret}</SourceFilename></SimpleSource></VRTRasterBand></VRTDataset>"
    )
    with pytest.raises(DataError, match="not a GeoTIFF"):
        read_grid(tmp_path / "named.tif")


READ = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, (3 << 30, 3 << 30))
from lunarsci.errors import DataError
from lunarsci.heights.grids import read_grid
for name in sys.argv[1:]:
    try:
        read_grid(name)
    except DataError as error:
        print(error)
"""


def large_archive(file: Path, name: str) -> Path:
    """480 MB of zeros under a name, in half a MB."""
    np.savez(file, x_m=np.arange(6.0), y_m=np.arange(6.0))
    about = {"descr": "<f8", "fortran_order": False, "shape": (60, 1_000_000)}
    with (
        zipfile.ZipFile(file, "a", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open(name, "w", force_zip64=True) as entry,
    ):
        np.lib.format.write_array_header_1_0(entry, about)
        for _ in range(60):
            entry.write(bytes(8_000_000))
    return file


@pytest.mark.skipif(sys.platform != "linux", reason="limits the memory")
def test_files_that_unpack_to_more_than_the_memory(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    where = rasterio.transform.from_origin(0, 0, 1, 1)
    how = {"driver": "GTiff", "count": 1, "dtype": "float32", "SPARSE_OK": True, "tiled": True}
    sparse = tmp_path / "large.tif"
    rasterio.open(sparse, "w", height=40_000, width=60_000, transform=where, **how).close()
    archives = [large_archive(tmp_path / f"{name}.npz", f"{name}.npy") for name in ("extra", "height_m")]
    files = [*archives, sparse]
    assert all(file.stat().st_size < 10e6 for file in files)
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    done = subprocess.run([sys.executable, "-c", READ, *files], capture_output=True, text=True, check=True)
    most = f"at most {MOST_NODES / 1e6:.0f} million"
    for line, why in zip(done.stdout.splitlines(), ("not a key", most, most), strict=True):
        assert why in line
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before < 30


def test_a_picture_of_more_pixels_than_are_unpacked(tmp_path: Path) -> None:
    """A header of 60 million pixels, and none of them: it is refused before anything is unpacked."""
    pytest.importorskip("cv2")
    chunks = (b"IHDR" + struct.pack(">IIBBBBB", 10_000, 6_000, 8, 0, 0, 0, 0), b"IDAT" + zlib.compress(b""))
    packed = [struct.pack(">I", len(one) - 4) + one + struct.pack(">I", zlib.crc32(one)) for one in chunks]
    file = tmp_path / "large.png"
    file.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(packed))
    with pytest.raises(DataError, match="more than 50 million pixels; cut out the part that is wanted"):
        read_picture(file)
