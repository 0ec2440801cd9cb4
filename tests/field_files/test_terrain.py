"""Terrains as archives and programs write them, each after a public description that its kind names.

The ground is one made-up plane with a bump, so that its slopes, its steps between nodes and its heights are known.
"""

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lunarsci.cli import main

from lunarsci.guide.info import info
from lunarsci.heights.grids import read_grid

STEP = 2.0
X, Y = 500.0 + STEP * np.arange(40), 300.0 + STEP * np.arange(30)
EAST, NORTH = 0.12, -0.05
"""Slopes of the ground along x and y."""
SLOPE_DEG = float(np.degrees(np.arctan(np.hypot(EAST, NORTH))))
HEIGHT = -1500.0 + EAST * (X[None, :] - X[0]) + NORTH * (Y[:, None] - Y[0])
RADIUS_M = 1_737_400.0
LONGITUDE, LATITUDE = 10.0, 5.0
METRES = RADIUS_M * np.pi / 180
"""A degree of the Moon."""
LON = LONGITUDE + np.arange(40) * STEP / METRES / np.cos(np.radians(LATITUDE))
LAT = LATITUDE + np.arange(30) * STEP / METRES
GEOGRAPHIC = (
    'GEOGCS["Moon 2000",DATUM["D_Moon_2000",SPHEROID["Moon_2000_IAU_IAG",1737400.0,0.0]],'
    'PRIMEM["Greenwich",0],UNIT["Degree",0.0174532925199433]]'
)


def nodes(
    line: str, head: str = "", *, x: Any = X, y: Any = Y, factor: float = 1.0, hole: str = "", end: str = "\n"
) -> str:
    """A row for each node, the northern ones first; `hole` stands for the height of the second one."""
    lines = [
        line.format(x[i], y[k], factor * HEIGHT[k, i], n=len(x) * (len(y) - 1 - k) + i)
        for k in reversed(range(len(y)))
        for i in range(len(x))
    ]
    if hole:
        lines[1] = lines[1].replace(line.format(0, 0, factor * HEIGHT[-1, 1], n=1).split(line[5])[-1], hole)
    return head + end.join([*lines, ""])


def grid(gap: str = " ", digits: int = 4, factor: float = 1.0) -> str:
    return "".join(gap.join(f"{factor * value:.{digits}f}" for value in row) + "\n" for row in HEIGHT[::-1])


ASCII = "ncols 40\nnrows 30\nxllcorner 499.0\nyllcorner 299.0\ncellsize 2.0\nNODATA_value -9999\n"


def text(name: str, content: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        (folder / name).write_bytes(content.encode())
        return folder / name

    return write


def degrees_with_prj(folder: Path) -> Path:
    side = STEP / METRES
    head = (
        f"ncols 40\nnrows 30\nxllcenter {LONGITUDE}\nyllcenter {LATITUDE}\ncellsize {side:.12f}\nnodata_value -9999\n"
    )
    (folder / "a.asc").write_text(head + grid())
    (folder / "a.prj").write_text(GEOGRAPHIC)
    return folder / "a.asc"


def bil(folder: Path) -> Path:
    HEIGHT[::-1].astype("<f4").tofile(folder / "a.bil")
    (folder / "a.hdr").write_text(
        "BYTEORDER I\nLAYOUT BIL\nNROWS 30\nNCOLS 40\nNBANDS 1\nNBITS 32\nPIXELTYPE FLOAT\nULXMAP 500\nULYMAP 358\n"
        "XDIM 2\nYDIM 2\nNODATA -32768\n"
    )
    return folder / "a.bil"


def gridfloat(folder: Path) -> Path:
    HEIGHT[::-1].astype("<f4").tofile(folder / "a.flt")
    (folder / "a.hdr").write_text(ASCII + "byteorder LSBFIRST\n")
    return folder / "a.flt"


def envi(folder: Path) -> Path:
    HEIGHT[::-1].astype("<f4").tofile(folder / "a.img")
    (folder / "a.hdr").write_text(
        "ENVI\nsamples = 40\nlines = 30\nbands = 1\nheader offset = 0\nfile type = ENVI Standard\ndata type = 4\n"
        "interleave = bsq\nbyte order = 0\nmap info = {Arbitrary, 1.0, 1.0, 499.0, 359.0, 2.0, 2.0, units=Meters}\n"
    )
    return folder / "a.img"


def gmt(folder: Path) -> Path:
    from scipy.io import netcdf_file

    with netcdf_file(folder / "a.grd", "w") as file:
        file.Conventions = "COARDS, CF-1.5"
        for name, values in (("x", X), ("y", Y)):
            file.createDimension(name, values.size)
            file.createVariable(name, "d", (name,))[:] = values
        z = file.createVariable("z", "f", ("y", "x"))
        z[:] = HEIGHT
        z.units = "m"
    return folder / "a.grd"


def netcdf4(folder: Path) -> Path:
    import xarray

    data = xarray.DataArray(
        HEIGHT / 1000, coords={"y": Y, "x": X}, dims=("y", "x"), attrs={"units": "km"}, name="elevation"
    )
    data.to_netcdf(folder / "a.nc")
    return folder / "a.nc"


def netcdf_of_mars(folder: Path) -> Path:
    """Longitudes and latitudes on the sphere that the file names: the same ground is 1.95 times as wide there."""
    import xarray

    size = RADIUS_M / 3_396_190.0
    lat, lon = LATITUDE + size * (LAT - LATITUDE), LONGITUDE + size * (LON - LONGITUDE)
    data = xarray.Dataset(
        {"topo": (("lat", "lon"), HEIGHT, {"units": "m", "grid_mapping": "crs"})}, {"lat": lat, "lon": lon}
    )
    data["crs"] = xarray.DataArray(0, attrs={"grid_mapping_name": "latitude_longitude", "earth_radius": 3_396_190.0})
    data.to_netcdf(folder / "a.nc")
    return folder / "a.nc"


def npz(folder: Path) -> Path:
    x, y = np.meshgrid(X, Y)
    np.savez(folder / "a.npz", X=x, Y=y, Z=HEIGHT)
    return folder / "a.npz"


def vrt(folder: Path) -> Path:
    counts = np.round((HEIGHT[::-1] + 1500) * 100).astype("<i2")
    counts.tofile(folder / "a.raw")
    (folder / "a.vrt").write_text(
        '<VRTDataset rasterXSize="40" rasterYSize="30"><GeoTransform>499, 2, 0, 359, 0, -2</GeoTransform>'
        '<VRTRasterBand dataType="Int16" band="1" subClass="VRTRawRasterBand"><Scale>0.01</Scale><Offset>-1500</Offset>'
        '<UnitType>m</UnitType><SourceFilename relativetoVRT="1">a.raw</SourceFilename><ImageOffset>0</ImageOffset>'
        "<PixelOffset>2</PixelOffset><LineOffset>80</LineOffset><ByteOrder>LSB</ByteOrder></VRTRasterBand></VRTDataset>"
    )
    return folder / "a.vrt"


def world_file(folder: Path) -> Path:
    import warnings

    import rasterio

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(folder / "a.tif", "w", "GTiff", width=40, height=30, count=1, dtype="float32") as raster:
            raster.write(HEIGHT[::-1].astype(np.float32), 1)
    (folder / "a.tfw").write_text("2.0\n0.0\n0.0\n-2.0\n500.0\n358.0\n")
    return folder / "a.tif"


def surfer7(folder: Path) -> Path:
    body = HEIGHT.astype("<f8").tobytes()
    head = struct.pack("<4sii", b"DSRB", 4, 1)
    part = struct.pack("<4sii", b"GRID", 72, 30) + struct.pack(
        "<i8d", 40, X[0], Y[0], 2.0, 2.0, HEIGHT.min(), HEIGHT.max(), 0.0, 1.70141e38
    )
    (folder / "a.grd").write_bytes(head + part + struct.pack("<4si", b"DATA", len(body)) + body)
    return folder / "a.grd"


def dteec(folder: Path) -> Path:
    """A label attached to floats, marked by the bits of the lowest one."""
    record = 40 * 4
    label = (
        f"PDS_VERSION_ID = PDS3\r\nRECORD_TYPE = FIXED_LENGTH\r\nRECORD_BYTES = {record}\r\nFILE_RECORDS = 42\r\n"
        "LABEL_RECORDS = 12\r\n^IMAGE = 13\r\nOBJECT = IMAGE\r\n LINES = 30\r\n LINE_SAMPLES = 40\r\n"
        " SAMPLE_TYPE = PC_REAL\r\n"
        " SAMPLE_BITS = 32\r\n MISSING_CONSTANT = 16#FF7FFFFB#\r\n UNIT = METER\r\nEND_OBJECT = IMAGE\r\n"
        'OBJECT = IMAGE_MAP_PROJECTION\r\n MAP_PROJECTION_TYPE = "POLAR STEREOGRAPHIC"\r\n'
        " A_AXIS_RADIUS = 1737.4 <KM>\r\n"
        " B_AXIS_RADIUS = 1737.4 <KM>\r\n C_AXIS_RADIUS = 1737.4 <KM>\r\n CENTER_LATITUDE = -90.0 <DEG>\r\n"
        " CENTER_LONGITUDE = 0.0 <DEG>\r\n MAP_SCALE = 2.0 <METERS/PIXEL>\r\n LINE_PROJECTION_OFFSET = 15.0\r\n"
        " SAMPLE_PROJECTION_OFFSET = 20.0\r\nEND_OBJECT = IMAGE_MAP_PROJECTION\r\nEND\r\n"
    )
    values = HEIGHT[::-1].astype("<f4").copy()
    values[0, 1] = np.frombuffer(bytes.fromhex("FBFF7FFF"), "<f4")[0]
    (folder / "a.img").write_bytes(label.encode().ljust(12 * record) + values.tobytes())
    return folder / "a.img"


KINDS: dict[str, tuple[str, Callable[[Path], Path], int]] = {
    "esri, upper case, nan": (
        "https://gdal.org/drivers/raster/aaigrid.html",
        text("a.asc", ASCII.upper().replace("-9999", "nan") + grid().replace(f"{HEIGHT[-1, 1]:.4f}", "nan", 1)), 1,
    ),
    "esri, decimal comma": (
        "Esri ASCII raster format, German system", text("a.asc", (ASCII + grid()).replace(".", ",")), 0),
    "esri in degrees with a .prj": ("Esri, projection files beside rasters", degrees_with_prj, 150),
    "bil": ("https://gdal.org/drivers/raster/ehdr.html", bil, 0),
    "gridfloat": ("Esri, GridFloat of the USGS elevation data", gridfloat, 0),
    "envi": ("NV5 ENVI header files; https://gdal.org/drivers/raster/envi.html", envi, 0),
    "gmt": ("Wessel et al. 2019, 10.1029/2019GC008515, grid files (COARDS)", gmt, 0),
    "netcdf4 in km": ("CF conventions 1.10, units", netcdf4, 0),
    "netcdf of another body": ("CF conventions 1.10, appendix F, earth_radius", netcdf_of_mars, 150),
    "meshgrid": ("NumPy, savez of a meshgrid", npz, 0),
    "vrt": ("https://gdal.org/drivers/raster/vrt.html", vrt, 0),
    "world file": ("Esri, world files for rasters", world_file, 0),
    "surfer 7": ("Golden Software, Surfer 7 grid file format", surfer7, 0),
    "dteec": ("HiRISE DTM, McEwen et al. 2007, 10.1029/2005JE002605; PDS3 label", dteec, 1),
    "cloudcompare": (
        "CloudCompare, ASCII files",
        text("a.asc", nodes("{:.3f} {:.3f} {:.5f} 120 118 99", "//X Y Z R G B\n1200\n")), 0),
    "pandas": ("pandas, DataFrame.to_csv", text("a.csv", nodes("{n},{:.2f},{:.2f},{:.4f}", ",x,y,z\n")), 0),
    "decimal comma": (
        "RFC 4180 and locale de_DE", text("a.csv", nodes("{:.2f};{:.2f};{:.4f}", "X;Y;Z\n").replace(".", ",")), 0),
    "kilometres": (
        "units in names",
        text("a.csv", nodes("{:.4f},{:.4f},{:.7f}", "x_km,y_km,z_km\n", x=X / 1e3, y=Y / 1e3, factor=1e-3)), 0,
    ),
    "millimetres of heights": (
        "Leica Cyclone, points in mm",
        text("a.txt", nodes("{:.2f}\t{:.2f}\t{:.1f}", "X (m)\tY (m)\tZ (mm)\n", factor=1e3)), 0),
    "degrees": (
        "GMT grd2xyz of a map in degrees",
        text("a.csv", nodes("{:.10f},{:.10f},{:.4f}", "longitude_deg,latitude_deg,height_m\n", x=LON, y=LAT)), 150,
    ),
    "degrees without names of units": (
        "QGIS, raster pixels to points",
        text("a.xyz", nodes("{:.10f} {:.10f} {:.4f}", "lon lat elevation\n", x=LON, y=LAT)), 150,
    ),
    "qgis points": (
        "QGIS, field table of sampled points",
        text("a.csv", nodes('"{n}","{:.2f}","{:.2f}","{:.4f}"', '"fid","X","Y","Elevation"\n')), 0,
    ),
    "not sorted, Windows": (
        "https://gdal.org/drivers/raster/xyz.html", text("a.xyz", nodes("{:.2f} {:.2f} {:.4f}", end="\r\n")), 0),
    "pivot table": (
        "pandas, DataFrame.pivot; Origin matrices",
        text("a.csv", ",".join(["y\\x", *(f"{x:g}" for x in X)]) + "\n" + "".join(
            ",".join([f"{y:g}", *(f"{one:.4f}" for one in row)]) + "\n"
            for y, row in zip(Y[::-1], HEIGHT[::-1], strict=True))), 0,
    ),
    "latitude first": (
        "PDS Geosciences Node, LOLA points in order of latitude",
        text("a.csv", nodes("{1:.10f},{0:.10f},{2:.4f}", "lat,lon,elev\n", x=LON, y=LAT)), 150,
    ),
    "survey": (
        "total stations, point, easting, northing, height",
        text("a.csv", nodes("{n},{:.2f},{:.2f},{:.4f}", "Point,Easting (m),Northing (m),Height (m)\n")), 0,
    ),
}  # fmt: skip


def check(height_m: Any, spacing_m: float, holes: int) -> None:
    assert spacing_m == pytest.approx(STEP, rel=2e-3)
    across, up = (np.nanmedian(np.diff(height_m, axis=axis)) / spacing_m for axis in (1, 0))
    assert (across, up) == pytest.approx((EAST, NORTH), abs=3e-3)
    assert np.isnan(height_m).sum() <= holes


@pytest.mark.parametrize("kind", KINDS)
def test_the_ground_is_read(kind: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    _, write, holes = KINDS[kind]
    path = write(tmp_path)
    found = read_grid(path)
    check(found.height_m, found.spacing_m, holes)
    told = info(path)
    assert (told.kind, told.trouble) == ("terrain", "")
    assert main(["twin", "terrain", str(path), "--json", "--no-time"]) in (0, 3)
    answer = json.loads(capfd.readouterr().out)["result"]
    assert answer["maps"]["slope_deg"]["p50"] == pytest.approx(SLOPE_DEG, abs=0.15)
