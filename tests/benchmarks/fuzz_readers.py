"""Every reader of a command, with files that it reads: what `fuzz.py` spoils. All files are made up (SYNTHETIC).

A reader of several files gets them joined into one input, so that what is spoilt may be any of them, or one missing.
"""

import contextlib
import functools
import inspect
import io
import json
import tempfile
import tomllib
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin
from unittest import mock

import numpy as np

from lunarsci.errors import LunarSciError
from lunarsci.io.inputs import InputFile
from lunarsci.registry import KINDS

BETWEEN = b"\n--- next file ---\n"
FORMER = Path(__file__).parents[1] / "former_results.json"
WHEELS = ("FL", "FR", "ML", "MR", "RL", "RR")
SOIL = (
    b"stiffness_kpa_m_n = 1379\nsinkage_exponent = 1.0\ncohesion_pa = 520\nfriction_angle_deg = 42\n"
    b"shear_modulus_mm = 17.8\nexternal_friction_angle_deg = 25\nlateral_modulus_mm = 20\n"
)
ZONE = '{"type": "Polygon", "coordinates": [[[0, 0], [2, 0], [2, 1], [0, 0]]]}'
WAY = np.column_stack([np.linspace(0, 5, 6), np.zeros(6)])
FEATURE = f'{{"type": "Feature", "properties": {{"name": "rock"}}, "geometry": {ZONE}}}'
SEARCHED = (
    f'{{"type": "FeatureCollection", "features": [{FEATURE}], "searched": {{"area_m2": 20, "camera_m": [0, 0, 1.5], '
    '"completeness": [{"diameter_m": 0.1, "range_from_m": 0, "range_to_m": 5, "share": 0.8}]}}'
)
START = b"""C:\\data\\
sample.asc
-100,25,10
450,2400,1
2E-03,1E-06
Q
0.85 -1e-6 0 0
10 1e-4 1e-7 1e-7
2
1000 250 -1
200 400 10
2000 300 -1
300 400 10
"""


@dataclass
class Reader:
    """What is tried.

    Attributes
    ----------
    read : called with the path of the first file.
    names : of the files that an input is written to, parted at `BETWEEN`; a part that is missing is no file.
    seeds : inputs that it reads.
    beside : further files in the folder, which stay as they are.
    """

    read: Callable[[Path], Any]
    names: Sequence[str]
    seeds: list[bytes]
    beside: Mapping[str, bytes] = field(default_factory=dict)


def _function(name: str) -> Callable[..., Any]:
    module, function = name.split(":")
    found: Any = import_module(f"lunarsci.{module}")
    for part in function.split("."):
        found = getattr(found, part)
    return found


def of_file(name: str, *more: Any) -> Callable[[Path], Any]:
    """The reader of that name, `module:function`, called with an InputFile; `more` are further arguments."""
    return lambda path: _function(name)(InputFile(str(path), path.read_bytes()), *more)


def of_path(name: str, *more: Any, **options: Any) -> Callable[[Path], Any]:
    return lambda path: _function(name)(str(path), *more, **options)


def with_rover(name: str, *more: Any) -> Callable[[Path], Any]:
    return lambda path: of_file(name, rover(), *more)(path)


@functools.cache
def rover() -> Any:
    from lunarsci.rovers import read_rover
    from lunarsci.twin.rover import build_rover

    return build_rover(read_rover("yutu2"))


def table(names: str, rows: int = 12) -> bytes:
    """A table of made-up numbers under these names."""
    numbers = np.random.default_rng(1).uniform(0.01, 0.1, (rows, len(names.split(","))))
    numbers[:, 0] = 0.005 + 0.5 * np.arange(rows) if names.startswith("time") else numbers[:, 0]
    lines = [names, *(",".join(f"{value:.5f}" for value in row) for row in numbers)]
    return "\n".join([*lines, ""]).encode()


# --- spectra ---


def curve() -> tuple[np.ndarray, np.ndarray]:
    """Wavelengths and reflectances of a made-up rock. (80,) [nm, 1]"""
    nm = np.arange(500.0, 2500.0, 25.0)
    return nm, 0.1 + 2e-5 * nm - 0.03 * np.exp(-(((nm - 980) / 120) ** 2))


def spectrum_files() -> dict[str, bytes]:
    """The same made-up spectrum in several formats."""
    from astropy.table import Table

    nm, reflectance = curve()
    plain = Table({"wavelength_nm": nm, "reflectance": reflectance})
    ecsv, fits, workbook = io.StringIO(), io.BytesIO(), io.BytesIO()
    plain.write(ecsv, format="ascii.ecsv")
    plain.write(fits, format="fits")
    plain.to_pandas().to_excel(workbook, index=False, engine="openpyxl")
    rows = list(zip(nm, reflectance, strict=True))
    return {
        ".csv": b"wavelength_nm,rock,rock_sigma\n" + b"".join(b"%.1f,%.5f,0.001\n" % row for row in rows),
        ".txt": b"# SYNTHETIC\n" + b"".join(b"%.4f %.5f\n" % (w / 1000, r) for w, r in rows),
        ".ecsv": ecsv.getvalue().encode(),
        ".fits": fits.getvalue(),
        ".xlsx": workbook.getvalue(),
        ".sed": b"Instrument: X\nData:\nWvl\tReflect. %\twavelength_nm\tb\n"
        + b"".join(b"%.1f\t%.5f\t%.1f\t%.5f\n" % (w, 100 * r, w + 3, r) for w, r in rows),
        ".tab": b"%d\n" % len(rows) + b"".join(b"  %9.4f %9.5f %9.5f\n" % (w, r, 0.001) for w, r in rows),
    }


def exchanged() -> list[bytes]:
    """A spectrum as JCAMP-DX, JSON, VOTable, and twice below each other."""
    nm, reflectance = curve()
    pairs = b"".join(b"%.1f,%.5f\n" % row for row in zip(nm, reflectance, strict=True))
    cells = b"".join(b"<TR><TD>%.1f</TD><TD>%.5f</TD></TR>" % row for row in zip(nm, reflectance, strict=True))
    fields = b'<FIELD name="wavelength" datatype="double" unit="nm"/><FIELD name="reflectance" datatype="double"/>'
    block = b"SYNTHETIC\nwavelength_nm,rock\n" + pairs
    return [
        b"##TITLE= SYNTHETIC\n##XUNITS= NANOMETERS\n##YUNITS= REFLECTANCE\n##NPOINTS= %d\n"
        b"##XYPOINTS= (XY..XY)\n%s##END=\n" % (nm.size, pairs),
        json.dumps({"wavelength_nm": nm.tolist(), "reflectance": reflectance.tolist()}).encode(),
        b'<?xml version="1.0"?><VOTABLE version="1.3"><RESOURCE><TABLE>%s<DATA><TABLEDATA>%s</TABLEDATA></DATA></TABLE>'
        b"</RESOURCE></VOTABLE>" % (fields, cells),
        block + b"\n" + block,
    ]


def envi_header(kind: str = "ENVI Standard", samples: int = 4, lines: int = 3, bands: int = 80) -> bytes:
    nm, _ = curve()
    return (
        f"ENVI\ndescription = {{SYNTHETIC}}\nsamples = {samples}\nlines = {lines}\nbands = {bands}\n"
        f"header offset = 0\nfile type = {kind}\ndata type = 4\ninterleave = bil\nbyte order = 0\n"
        f"wavelength units = Nanometers\nwavelength = {{{', '.join(f'{w:.1f}' for w in nm)}}}\n"
    ).encode()


def library() -> bytes:
    from lunarsci.spectra.readers.library import EndMember, to_ecsv

    nm, reflectance = curve()
    return to_ecsv([EndMember("Fo 90", "olivine", nm, reflectance, fo=0.9, max_um=45.0, source="SYNTHETIC")])


def spectra_readers() -> dict[str, Reader]:
    of_spectra = of_path("spectra.readers:read_spectra")
    nm, reflectance = curve()
    waves = b" splib07a Record=2: SYNTHETIC\n" + b"".join(b" %.6E\n" % (w / 1000) for w in nm)
    splib = b" splib07a Record=1: SYNTHETIC\n" + b"".join(b" %.6E\n" % r for r in reflectance)
    sli = envi_header("ENVI Spectral Library", nm.size, 2, 1) + b"spectra names = {rock, soil}\n"
    rock = {"id": "rock", "nbsr": {"um2": {"opx": 0.46, "cpx": 0.54, "sigma": 0.03, "calibration": 0.04}}}
    fitted = json.dumps({"schema": "lunarsci/spectra-fit/1", "result": {"spectra": [rock]}}).encode()
    sun = b"wavelength_nm,irradiance_w_m-2_nm-1\n" + b"".join(
        b"%d,%.4f\n" % (w, irradiance) for w, irradiance in _sunlight()
    )
    return {
        f"spectra {suffix}": Reader(of_spectra, [f"spoilt{suffix}"], [data, *(exchanged() if suffix == ".txt" else [])])
        for suffix, data in spectrum_files().items()
    } | {
        "spectra splib": Reader(of_spectra, ["spoilt.txt", "splib07a_Wavelengths_SYNTHETIC.txt"],
                                [splib + BETWEEN + waves]),
        "spectra .sli": Reader(of_spectra, ["spoilt.hdr", "spoilt.sli"],
                               [sli + BETWEEN + np.tile(reflectance, 2).astype("<f4").tobytes()]),
        "spectra PDS3": Reader(of_spectra, ["spoilt.lbl", "a.tab"], [_pds_table()]),
        "spectra PDS4": Reader(of_spectra, ["spoilt.xml", "a.dat"], [_pds_binary()]),
        "library": Reader(of_file("spectra.readers.library:read_library"), ["spoilt.ecsv"], [library()]),
        "samples": Reader(of_file("spectra.readers.library:read_metadata"), ["spoilt.csv"],
                          [b"id,mineral,fo,max_um,source\nA,ol,0.9,45,SYNTHETIC\nB,Ilmenite,,,\n"]),
        "start of a fit": Reader(of_file("spectra.mgm.fit_file:read_start"), ["spoilt.fit"], [START]),
        "sunlight": Reader(of_file("spectra.readers.solar_table:read_solar_spectrum"), ["spoilt.csv"], [sun]),
        "phase function": Reader(of_file("spectra.photometry:read_phase_function"), ["spoilt.csv"],
                                 [b"phase_deg,750,1500\n0,2,2\n30,1,1\n60,0.6,0.7\n"]),
        "channel factors": Reader(of_file("spectra.vnis.detector:read_channel_factors"), ["spoilt.csv"],
                                  [_factors()]),
        "modes": Reader(of_file("spectra.abundance.end_members:read_modes"), ["spoilt.csv"],
                        [b"id,olivine,orthopyroxene,clinopyroxene\nrock,0.3,0.4,0.3\n"]),
        "craters": Reader(of_file("spectra.origin.catalogue:read_catalogue"), ["spoilt.csv"],
                          [b"name,latitude_deg,longitude_deg,diameter_km\nA,17.2,144.7,28\nB,-42.0,-177.9,72\n"]),
        "fitted rocks": Reader(of_file("spectra.origin.composition:read_rocks"), ["spoilt.json"], [fitted]),
    }  # fmt: skip


def _pds_table() -> bytes:
    """A label of PDS3 and its table, of fixed columns."""
    nm, reflectance = curve()
    column = " OBJECT = COLUMN\n  NAME = {}\n  UNIT = {}\n  START_BYTE = {}\n  BYTES = 10\n END_OBJECT = COLUMN\n"
    label = (
        f'PDS_VERSION_ID = PDS3\nRECORD_BYTES = 22\n^TABLE = ("a.tab", 1)\nOBJECT = TABLE\n ROWS = {nm.size}\n'
        f" ROW_BYTES = 22\n{column.format('WAVELENGTH', 'NANOMETER', 1)}{column.format('REFLECTANCE', 'NONE', 11)}"
        "END_OBJECT = TABLE\nEND\n"
    )
    rows = "".join(f"{w:10.2f}{r:10.5f}\r\n" for w, r in zip(nm, reflectance, strict=True))
    return label.encode() + BETWEEN + rows.encode()


def _pds_binary() -> bytes:
    """A label of PDS4 and its table of floats."""
    nm, reflectance = curve()
    field = (
        "<Field_Binary><name>{}</name><field_location>{}</field_location><data_type>IEEE754LSBSingle</data_type>"
        "<field_length>4</field_length><unit>{}</unit></Field_Binary>"
    )
    label = (
        "<Product_Observational><File_Area_Observational><File><file_name>a.dat</file_name></File><Table_Binary>"
        f"<offset>0</offset><records>{nm.size}</records><Record_Binary><record_length>8</record_length>"
        f"{field.format('Wavelength', 1, 'nm')}{field.format('Reflectance', 5, 'none')}</Record_Binary></Table_Binary>"
        "</File_Area_Observational></Product_Observational>"
    )
    return label.encode() + BETWEEN + np.stack([nm, reflectance], axis=1).astype("<f4").tobytes()


def _sunlight() -> list[tuple[int, float]]:
    """Of a black body with the Sun's radius at 1 AU: Planck's law. [nm, W m-2 nm-1]"""
    nm = np.arange(400, 2500, 25)
    metres = nm * 1e-9
    power = 2 * np.pi * 6.626e-34 * 2.998e8**2 / metres**5 / np.expm1(1.4388e-2 / metres / 5772.0)
    return list(zip(nm.tolist(), (1e-9 * power * (6.957e8 / 1.496e11) ** 2).tolist(), strict=True))


def _factors() -> bytes:
    from lunarsci.spectra.vnis.channels import SWIR_NM, VNIR_NM

    rows = [f"{name},{nm:g},1.01\n" for name, grid in (("vnir", VNIR_NM), ("swir", SWIR_NM)) for nm in grid]
    return "".join(["detector,wavelength_nm,factor\n", *rows]).encode()


# --- products of VNIS, image cubes ---


@functools.cache
def product() -> Mapping[str, bytes]:
    """One made-up observation: image cube, short-wave table, auxiliary table, labels."""
    from lunarsci.spectra.vnis.simulation.instrument import simulate
    from lunarsci.spectra.vnis.simulation.scene import Scene
    from lunarsci.spectra.vnis.simulation.template import product_files

    return {name: data for name, data in product_files(simulate(Scene(), seed=3)).items() if "truth" not in name}


def vnis_readers() -> dict[str, Reader]:
    found = product()
    cube = next(name for name, data in found.items() if len(data) > 10**6)
    small = {name: data for name, data in found.items() if name != cube}
    names = sorted(small, key=lambda name: not name.endswith("L"))
    pixels = np.frombuffer(found[cube], "<f4").reshape(100, 256, 256)[:, 100, 100]

    def whole(path: Path) -> Any:
        # Of an odd length it is the cube itself; else numbers for all pixels alike, for a cube is 26 MB.
        spoilt = path.read_bytes()
        if len(spoilt) % 2 == 0 and len(spoilt) >= 4:
            size = len(found[cube])
            path.write_bytes(np.repeat(np.resize(np.frombuffer(spoilt, "u1"), (100, 4)), 65536, axis=0).tobytes())
            assert path.stat().st_size == size
        return _function("spectra.readers:read_spectra")(str(path))

    return {
        "VNIS products": Reader(of_path("spectra.vnis.observation:read_observation"), names,
                                [BETWEEN.join(small[name] for name in names)], {cube: found[cube]}),
        "VNIS image": Reader(whole, [cube], [pixels.astype("<f4").tobytes()], small),
        "VNIS cube": Reader(all_of_cube, names, [BETWEEN.join(small[name] for name in names)],
                            {cube: found[cube]}),
    }  # fmt: skip


def all_of_cube(path: Path, **stated: Any) -> Any:
    """Open a cube, and read its first lines and its locations."""
    from lunarsci.spectra.cubes.cube import Stated
    from lunarsci.spectra.cubes.rasters import open_cube

    cube = open_cube(str(path), Stated(**stated))
    part = (slice(0, min(cube.shape[0], 8)), slice(0, min(cube.shape[1], 64)))
    return cube.read(*part), [plane.source.read(*part) for plane in cube.backplanes.values()]


def cube_files() -> dict[str, bytes]:
    """The same made-up cube (3 lines, 4 samples) in the formats of rasters."""
    import xarray

    nm, reflectance = curve()
    values = np.broadcast_to(reflectance[:, None, None], (nm.size, 3, 4)).astype("<f4")
    places = {"lat": (("y", "x"), np.zeros((3, 4)) + 40), "lon": (("y", "x"), np.zeros((3, 4)) + 20)}
    data = xarray.Dataset(
        {"reflectance": (("wavelength", "y", "x"), values), **places},
        {"wavelength": ("wavelength", nm, {"units": "nm"}), "x": np.arange(4.0), "y": np.arange(3.0)},
    )
    with tempfile.TemporaryDirectory() as place:
        data.to_netcdf(f"{place}/4.nc", engine="h5netcdf")
        data.to_netcdf(f"{place}/3.nc", engine="scipy")
        data.drop_vars(["x", "y"]).to_netcdf(f"{place}/swath.nc", engine="h5netcdf")
        netcdf = {name: Path(place, f"{name}.nc").read_bytes() for name in ("4", "3", "swath")}
    return {
        "ENVI": envi_header() + b"map info = {Equirectangular, 1, 1, 0, 0, 100, 100, units=Meters}\n"
        + BETWEEN + values.transpose(1, 0, 2).tobytes(),
        "GeoTIFF": tiff({f"{w:.0f} nm": layer for w, layer in zip(nm, values, strict=True)}),
        "NetCDF 4": netcdf["4"],
        "NetCDF 3": netcdf["3"],
        "NetCDF swath": netcdf["swath"],
    }  # fmt: skip


def shares() -> dict[str, np.ndarray]:
    """Layers of a made-up map of two minerals, as `spectra map` names them. (3, 4)"""
    return {"share_olivine": np.full((3, 4), 0.4), "share_orthopyroxene": np.full((3, 4), 0.6)}


def shares_of_swath(**layers: np.ndarray) -> bytes:
    import xarray

    where = {"latitude": np.repeat([[1.0], [0.5], [0.0]], 4, axis=1), "longitude": np.tile(0.5 * np.arange(4), (3, 1))}
    data = xarray.Dataset({name: (("y", "x"), values) for name, values in (shares() | where | layers).items()})
    with tempfile.TemporaryDirectory() as place:
        data.to_netcdf(f"{place}/map.nc", engine="h5netcdf")
        return Path(place, "map.nc").read_bytes()


ROS = b"""image_width: 64
image_height: 48
camera_matrix: {rows: 3, cols: 3, data: [50.0, 0.0, 31.5, 0.0, 50.0, 23.5, 0.0, 0.0, 1.0]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.05, 0.01, 0.0, 0.0, 0.0]}
projection_matrix: {rows: 3, cols: 4, data: [50.0, 0.0, 31.5, -5.0, 0.0, 50.0, 23.5, 0.0, 0.0, 0.0, 1.0, 0.0]}
"""
METASHAPE = (
    b"<calibration><projection>frame</projection><width>640</width><height>480</height><f>600</f><cx>1</cx><cy>2</cy>"
    b"<k1>-0.1</k1></calibration>"
)
TRANSFORMS = b'{"fl_x": 600.0, "fl_y": 601.0, "cx": 320.0, "cy": 240.0, "w": 640, "h": 480, "k1": -0.1}'
KALIBR = b"""cam0:
  distortion_coeffs: [0.0, 0.0, 0.0, 0.0]
  distortion_model: radtan
  intrinsics: [50.0, 50.0, 31.5, 23.5]
  resolution: [64, 48]
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.1]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  distortion_coeffs: [0.0, 0.0, 0.0, 0.0]
  distortion_model: radtan
  intrinsics: [50.0, 50.0, 31.5, 23.5]
  resolution: [64, 48]
"""
CRATERS = b"name,latitude_deg,longitude_deg,diameter_km\nA,0.5,0.9,10\nB,0.6,1.0,8\n"


def tiff(layers: Mapping[str, np.ndarray], spacing: float = 0.5, crs: str = "") -> bytes:
    from lunarsci.heights.grids import geotiff_bytes

    return geotiff_bytes(layers, (0.0, 0.0, spacing), synthetic=True, crs=crs)


PDS3 = b"""PDS_VERSION_ID = PDS3\r
RECORD_TYPE = FIXED_LENGTH\r
FILE_RECORDS = 8\r
RECORD_BYTES = 16\r
^IMAGE = "spoilt.img"\r
OBJECT = IMAGE\r
  LINES = 8\r
  LINE_SAMPLES = 8\r
  SAMPLE_TYPE = LSB_INTEGER\r
  SAMPLE_BITS = 16\r
  UNIT = METER\r
  SCALING_FACTOR = 0.5\r
  OFFSET = 1737400.\r
  MISSING_CONSTANT = -32768\r
END_OBJECT = IMAGE\r
OBJECT = IMAGE_MAP_PROJECTION\r
  MAP_PROJECTION_TYPE = "SIMPLE CYLINDRICAL"\r
  A_AXIS_RADIUS = 1737.4 <km>\r
  CENTER_LATITUDE = 0. <deg>\r
  CENTER_LONGITUDE = 180. <deg>\r
  MAP_SCALE = 20. <m/pix>\r
  LINE_PROJECTION_OFFSET = 79999.5 <pix>\r
  SAMPLE_PROJECTION_OFFSET = 3.5 <pix>\r
END_OBJECT = IMAGE_MAP_PROJECTION\r
END\r
"""
"""A label of heights about 53 deg north, made up in the manner of an orbiter's."""


def cube_readers() -> dict[str, Reader]:
    found = cube_files()
    header, image = found["ENVI"].split(BETWEEN)
    plane = io.BytesIO()
    np.save(plane, np.ones((3, 4)))
    nm, _ = curve()
    m3 = "M3G20090203T175131_V01_{}.{}"
    loc = header.replace(b"bands = 80", b"bands = 3").partition(b"wavelength units")[0]
    place = np.tile(np.float32([20.0, 40.0, 1737.4])[:, None], (3, 1, 4)).tobytes()
    beside = {"cube.hdr": header, "cube.img": image}

    def regions(path: Path) -> Any:
        from lunarsci.spectra.cubes.rasters import open_cube

        return _function("spectra.cubes.regions:region_of")(open_cube(str(path.with_name("cube.nc"))), str(path))

    def mapped(path: Path) -> Any:
        """Shares of minerals around two craters, as `spectra match --mineral-map` finds them."""
        from lunarsci.spectra.origin.catalogue import read_catalogue

        craters = read_catalogue(InputFile("SYNTHETIC.csv", CRATERS))
        minerals = _function("spectra.origin.mineral_map:minerals_of")(str(path))
        return _function("spectra.origin.mineral_map:with_maps")(craters, dict.fromkeys(minerals, str(path)))

    return {
        "cube ENVI": Reader(all_of_cube, ["spoilt.hdr", "spoilt.img"], [found["ENVI"]]),
        "cube M3": Reader(
            all_of_cube, [m3.format(part, end) for part, end in (("RFL", "HDR"), ("RFL", "IMG"), ("LOC", "HDR"),
                                                                 ("LOC", "IMG"))],
            [BETWEEN.join((header.partition(b"map info")[0], image, loc, place))]),
        "cube GeoTIFF": Reader(all_of_cube, ["spoilt.tif"], [found["GeoTIFF"]]),
        "cube NetCDF 4": Reader(all_of_cube, ["spoilt.nc"], [found["NetCDF 4"]]),
        "cube NetCDF swath": Reader(all_of_cube, ["spoilt.nc"], [found["NetCDF swath"]]),
        "cube NetCDF 3": Reader(all_of_cube, ["spoilt.nc"], [found["NetCDF 3"]]),
        "mask .npy": Reader(_read_plane, ["spoilt.npy"], [plane.getvalue()]),
        "mask .tif": Reader(_read_plane, ["spoilt.tif"], [tiff({"mask": np.ones((3, 4))})]),
        "wavelengths": Reader(
            lambda path: all_of_cube(path.with_name("cube.img"), wavelengths=str(path)), ["spoilt.csv"],
            [b"wavelength_nm,fwhm,good\n" + b"".join(b"%.1f,20,1\n" % w for w in nm)], beside),
        "locations": Reader(lambda path: all_of_cube(path.with_name("cube.img"), locations=str(path)),
                            ["spoilt.hdr", "spoilt.img"], [loc + BETWEEN + place], beside),
        "mineral map .tif": Reader(mapped, ["spoilt.tif"], [tiff(shares())]),
        "mineral map .nc": Reader(mapped, ["spoilt.nc"], [shares_of_swath()]),
        "any image": Reader(_told, ["spoilt.nc"],
                            [found["NetCDF 3"], shares_of_swath(pixel_flags=np.zeros((3, 4)))]),
        "regions": Reader(regions, ["spoilt.geojson"],
                          [ZONE.replace("[0, 0], [2, 0], [2, 1], [0, 0]",
                                        "[19, 39], [21, 39], [20, 42], [19, 39]").encode()],
                          {"cube.nc": found["NetCDF swath"]}),
    }  # fmt: skip


def _read_plane(path: Path) -> Any:
    source, shape = _function("spectra.cubes.rasters:plane_of")(str(path))
    return source.read(slice(0, min(shape[0], 64)), slice(0, min(shape[1], 64)))


# --- pictures, cameras ---


def label(
    turned: tuple[float, float, float] = (0.0, 0.0, 0.0), center: tuple[float, float, float] = (1.0, 2.0, 1.5)
) -> bytes:
    """A PDS4 label with the elements of a panorama camera's: corners and focal length of a pinhole."""
    from scipy.spatial.transform import Rotation

    width, height, focal = 1176, 864, 3380.0
    corners = {"up_left": (0, 0), "down_left": (0, 1), "up_right": (1, 0), "down_right": (1, 1), "center": (0.5, 0.5)}

    def tag(name: str, content: object) -> str:
        return f"<{name}>{content}</{name}>"

    told = []
    for name, (x, y) in corners.items():
        ray = np.array([(x - 0.5) * (width - 1), (y - 0.5) * (height - 1), focal])
        way = Rotation.from_rotvec(turned).apply(ray / np.linalg.norm(ray))
        told.append(tag(f"{name}_point_observe_vector", "".join(map(tag, "xyz", np.round(way, 6)))))
    axes = [tag("Axis_Array", tag("axis_name", n) + tag("elements", e)) for n, e in (("Line", 864), ("Sample", 1176))]
    places = [tag(f"camera_center_position_{axis}", value) for axis, value in zip("xyz", center, strict=True)]
    middle = tag("principle_point_coordinate", tag("x", 0.0) + tag("y0", 0.0))
    parm = tag("pixel_size", 14.8) + tag("focal_length", focal * 14.8e-3) + middle
    inner = "".join([*axes, tag("Instrument_Parm", parm), *told, *places])
    return f'<?xml version="1.0"?><Product_Observational>{inner}</Product_Observational>'.encode()


CAHV = (b"NS = 1024\nNL = 1024\nC = 1.0 0.2 -1.0\nA = 0.0 0.0 1.0\nH = 1200.0 0.0 511.0\nV = 0.0 1200.0 512.0\n"
        b"O = 0.0 0.0 1.0\nR = 0.0001 -0.1 0.03\n")  # fmt: skip
FISHEYE = (
    b"MODEL_TYPE='CAHVORE'  MODEL_COMPONENT_ID=('C','A','H','V','O','R','E','T','P')  "
    b"MODEL_COMPONENT_1=(0.6,-0.04,-0.2)  "
    b"MODEL_COMPONENT_2=(0.703447,-0.005161,0.710729)  MODEL_COMPONENT_3=(351.362,452.204,353.494)  "
    b"MODEL_COMPONENT_4=(35.8065,-1.75143,682.705)  MODEL_COMPONENT_5=(0.704402,-0.006062,0.709775)  "
    b"MODEL_COMPONENT_6=(3e-06,-0.012015,-0.007525)  MODEL_COMPONENT_7=(0.001442,0.001522,0.000483)  "
    b"MODEL_COMPONENT_8=3.0  MODEL_COMPONENT_9=0.37  REFERENCE_COORD_SYSTEM_NAME='ROVER_FRAME'  "
)
VICAR = (
    b"FORMAT='BYTE'  TYPE='IMAGE'  BUFSIZ=32  DIM=3  EOL=0  RECSIZE=32  ORG='BSQ'  NL=24  NS=32  NB=1  N1=32  N2=24  "
    b"N3=1  N4=0  NBB=0  NLB=0  HOST='X86-LINUX'  INTFMT='LOW'  REALFMT='RIEEE'  SAMPLE_BIT_MASK='2#11111111#'  "
    b"PROPERTY='ROVER_COORDINATE_SYSTEM'  COORDINATE_SYSTEM_NAME='ROVER_FRAME'  "
    b"ORIGIN_ROTATION_QUATERNION=(0.994261,-0.095668,-0.0233068,0.0418276)  PROPERTY='GEOMETRIC_CAMERA_MODEL'  "
)
"""Labels of VICAR and of its camera, with the numbers of MER's hazard camera."""
POSE = (b"position_m = [0.0, 0.0, 1.5]\nheading_deg = 10.0\ndown_deg = 15.0\ntime_s = 5.0\nyaw_deg = 10.0\n"
        b"pitch_deg = 1.0\nroll_deg = 0.0\n")  # fmt: skip
RAW_LABEL = (
    b'<?xml version="1.0"?><Product_Observational><File><offset>0</offset></File><Array_2D_Image>'
    b"<data_type>UnsignedByte</data_type><Axis_Array><axis_name>Line</axis_name><elements>24</elements></Axis_Array>"
    b"<Axis_Array><axis_name>Sample</axis_name><elements>32</elements></Axis_Array></Array_2D_Image>"
    b"</Product_Observational>"
)


def rig() -> bytes:
    from lunarsci.images.rig_files import read_rig, rig_text

    return rig_text(read_rig("yutu2-navcam")).encode()


def stereo_archive() -> bytes:
    """Two cameras as OpenCV's stereoCalibrate gives them, in NumPy's archive."""
    written, matrix = io.BytesIO(), np.array([[464.0, 0, 199.5], [0, 464.0, 199.5], [0, 0, 1]])
    np.savez(written, M1=matrix, D1=np.zeros(5), M2=matrix, D2=np.zeros(5), R=np.eye(3), T=[-0.27, 0, 0],
             image_size=[400, 400])  # fmt: skip
    return written.getvalue()


def pictures() -> dict[str, bytes]:
    """The same made-up picture (24 x 32) in three formats."""
    from PIL import Image

    values = np.random.default_rng(2).integers(0, 255, (24, 32), dtype=np.uint8)
    found = {}
    for kind in ("png", "tiff", "jpeg"):
        written = io.BytesIO()
        Image.fromarray(values).save(written, format=kind)
        found[kind] = written.getvalue()
    return found | {"raw": values.tobytes()}


def picture_readers() -> dict[str, Reader]:
    from lunarsci.images.camera import Camera
    from lunarsci.images.rig_files import camera_text

    shown = pictures()
    of_picture = of_path("images.pictures:read_picture")
    one = Camera(name="p", width_px=1176, height_px=864, fx_px=3380.0, fy_px=3380.0, cx_px=590.0, cy_px=428.0, k1=-0.05)
    alone = camera_text(one, np.eye(9) * 1e-4, name="one", source="SYNTHETIC")
    right = label((0.0, 0.004, 0.0), (1.27, 2.0, 1.5))
    places = b"x_m,y_m,z_m,sigma_m\n0,0,1.5,0.01\n2.5,0,1.5,0.02\n"
    line = b'{"type": "LineString", "coordinates": [[0, 0], [1.5, 0.2], [3, 0.1]]}'

    def of_labels(path: Path) -> Any:
        both = (str(path), str(path.with_name("right.2BL")))
        return _function("images.rig_files:read_rig")(*both)

    def pose(path: Path) -> Any:
        return of_file("images.rig_files:read_pose")(path), of_file("images.jobs.locate:_more_of_pose")(path)

    return {
        **{f"picture {kind}": Reader(of_picture, [f"spoilt.{kind}"], [shown[kind]])
           for kind in ("png", "tiff", "jpeg")},
        "picture PDS4": Reader(of_picture, ["PCAM-C-1.2BL", "PCAM-C-1.2B"], [RAW_LABEL + BETWEEN + shown["raw"]]),
        "picture VICAR": Reader(_told, ["spoilt.VIC"],
                                [b"LBLSIZE=1600  " + (VICAR + FISHEYE).ljust(1586, b"\0") + shown["raw"]]),
        "camera label": Reader(of_path("images.jobs.cameras:cameras"), ["spoilt.2BL"], [label()]),
        "camera CAHVORE": Reader(of_path("images.jobs.cameras:cameras"), ["spoilt.lbl"],
                                 [b"PDS_VERSION_ID = PDS3\nGROUP = G\n" + FISHEYE.replace(b"  ", b"\n")
                                  + b"END_GROUP = G\nOBJECT = IMAGE\n LINES = 1024\n LINE_SAMPLES = 1024\nEND\n",
                                  b"LBLSIZE=1600  " + (VICAR + FISHEYE).ljust(1586, b"\0")]),
        "camera CAHVOR": Reader(of_path("images.jobs.cameras:cameras"), ["spoilt.lbl"], [CAHV]),
        "camera": Reader(of_path("images.jobs.cameras:cameras"), ["spoilt.toml"], [alone.encode()]),
        "camera YAML": Reader(of_path("images.jobs.cameras:cameras"), ["spoilt.yaml"],
                              [ROS, KALIBR, METASHAPE, TRANSFORMS]),
        "rig": Reader(of_path("images.rig_files:read_rig"), ["spoilt.toml"],
                      [rig()]),
        "rig of NumPy": Reader(of_path("images.rig_files:read_rig"), ["spoilt.npz"], [stereo_archive()]),
        "rig of labels": Reader(of_labels, ["left.2BL", "right.2BL"], [label() + BETWEEN + right]),
        "pose": Reader(pose, ["spoilt.toml"], [POSE]),
        "stations": Reader(of_file("images.jobs.merge:read_positions", 2), ["spoilt.csv"], [places]),
        "track in a picture": Reader(of_path("images.render:read_track"), ["spoilt.csv"],
                                     [table("x_m,y_m,rut_m")]),
        "line": Reader(of_path("images.tracks:read_line"), ["spoilt.geojson"], [line]),
    }  # fmt: skip


# --- ground ---


def ground_files() -> dict[str, bytes]:
    """The same made-up ground (8 x 8 nodes) in five formats."""
    axis = 0.5 * np.arange(8)
    height = 0.05 * np.sin(axis[:, None] + axis)
    archive = io.BytesIO()
    np.savez_compressed(archive, x_m=axis, y_m=axis, height_m=height, friction_angle_deg=30.0, height_m_sigma=0.01)
    rows = "\n".join(" ".join(f"{value:.3f}" for value in row) for row in height)
    nodes = "".join(f"{x},{y},{height[j, i]:.4f}\n" for j, y in enumerate(axis) for i, x in enumerate(axis))
    return {
        ".npz": archive.getvalue(),
        ".asc": f"ncols 8\nnrows 8\nxllcorner 0\nyllcorner 0\ncellsize 0.5\nNODATA_value -9999\n{rows}\n".encode(),
        ".csv": f"x_m,y_m,height_m\n{nodes}".encode(),
        ".tif": tiff({"height_m": height}),
        ".nc": bytes(import_module("xarray").DataArray(height, {"y": axis, "x": axis}, name="height").to_netcdf()),
    }


@functools.cache
def ground() -> Any:
    from lunarsci.regolith.soil import read_soil
    from lunarsci.twin.ground.terrain import build_terrain

    return build_terrain("SYNTHETIC", 0.0, 0.0, 0.5, np.zeros((8, 8)), read_soil("longji"))


def in_degrees() -> bytes:
    """Heights on degrees of the Moon."""
    rasterio = import_module("rasterio")
    return tiff({"height_m": np.eye(8)}, 0.001, rasterio.crs.CRS.from_user_input("+proj=longlat +R=1737400").to_wkt())


def ground_readers() -> dict[str, Reader]:
    found = ground_files()

    def terrain(path: Path) -> Any:
        from lunarsci.regolith.soil import read_soil

        return _function("twin.ground.terrain:read_terrain_file")(path, read_soil("longji"))

    def layer(path: Path) -> Any:
        return _function("twin.ground.hazards:read_cost_layer")(str(path), ground(), {3.0: 2.0})

    return {
        **{f"terrain {suffix}": Reader(terrain, [f"spoilt{suffix}"], [data]) for suffix, data in found.items()},
        "terrain in degrees": Reader(terrain, ["spoilt.tif"], [in_degrees()]),
        "terrain PDS3": Reader(terrain, ["spoilt.lbl", "spoilt.img"],
                               [PDS3 + BETWEEN + np.arange(64, dtype="<i2").tobytes()]),
        "elevation": Reader(of_path("images.elevation:read_elevation"), ["spoilt.npz"], [found[".npz"]]),
        "layer": Reader(layer, ["spoilt.asc"], [found[".asc"]]),
        "keep-outs": Reader(of_file("twin.ground.hazards:read_keep_outs"), ["spoilt.geojson"],
                            [f'{{"type": "FeatureCollection", "features": [{FEATURE}]}}'.encode()]),
        "search for rocks": Reader(of_file("twin.ground.missed_rocks:missed_rocks", WAY, 0.6, 0.1), ["spoilt.geojson"],
                                   [SEARCHED.encode()]),
    }  # fmt: skip


# --- soils ---


@functools.cache
def belief() -> bytes:
    """A belief after two drives that taught little."""
    from dataclasses import replace

    from lunarsci.regolith.belief import first_belief

    first = first_belief()
    entry = {"states": "states.csv", "plan": "plan", "before": json.loads(first.to_json())}
    return replace(first, history=(entry,), population=np.tile(first.mean, (3, 1))).to_json().encode()


def soil_map() -> bytes:
    from lunarsci.regolith.belief import first_belief
    from lunarsci.twin.ground.soil_map import SoilMap, Zone, soil_map_bytes

    places = np.array([[0.0, 0.0], [1.0, 0.2]])
    return soil_map_bytes(SoilMap(zones=(Zone(name="first", place_m=places, belief=first_belief()),)))


def soil_readers() -> dict[str, Reader]:
    samples = b"friction_angle_deg,cohesion_pa\n35,500\n40,600\n38,400\n"
    states = table(
        "sinkage_m,slip_ratio,side_slip_deg,normal_force_n,drawbar_pull_n,lateral_force_n,resistance_torque_nm"
    )
    found = former("identify joint")["result"]
    # Long lists are kept in parts there.
    found = found | {"joint": found["joint"] | {"correlation": [[float(i == k) for k in range(8)] for i in range(8)]}}
    identified = {"schema": "lunarsci/regolith-identify/1", "result": found}

    def wheel_states(path: Path) -> Any:
        from lunarsci.regolith.wheel import read_wheel

        of_file("regolith.columns:rover_of_states", None, "yutu2")(path)
        return of_file("regolith.states:read_states", read_wheel("yutu2"))(path)

    def to_predict(path: Path) -> Any:
        """All that is looked at before forces are predicted."""
        from lunarsci.regolith.wheel import read_wheel

        module = "regolith.inference.prediction"
        with (
            mock.patch(f"lunarsci.{module}.predict_forces", side_effect=StopIteration),
            contextlib.suppress(StopIteration),
        ):
            _function(f"{module}:predict_states")(None, read_wheel("yutu2"), InputFile(str(path), path.read_bytes()))

    def given(path: Path) -> Any:
        return _function("twin.jobs.drive_inputs:GivenSoil.read")([str(path)])

    return {
        "soil": Reader(of_path("regolith.soil:read_soil"), ["spoilt.toml"], [SOIL]),
        "prior": Reader(of_file("regolith.prior:read_prior"), ["spoilt.toml"],
                        [b'[cohesion_pa]\nof = "ln"\nmedian = 500.0\nsd = 0.5\n']),
        "states": Reader(wheel_states, ["spoilt.csv"], [states]),
        "states to predict": Reader(to_predict, ["spoilt.csv"], [states]),
        "wheel": Reader(lambda path: _function("regolith.wheel:read_wheel")(str(path)), ["spoilt.toml"],
                        [(files("lunarsci") / "rovers/yutu2.toml").read_bytes()]),
        "identified soil": Reader(lambda path: of_path("regolith.jobs.compare_soils:compare_soils")(path).to_json(),
                                  ["spoilt.json"], [json.dumps(identified).encode()]),
        "belief": Reader(lambda path: of_path("twin.jobs.history:history")(path).to_json(), ["spoilt.json"],
                         [belief()]),
        "verdict": Reader(of_file("regolith.belief:read_verdict"), ["spoilt.json"], [belief()]),
        "soil map": Reader(given, ["spoilt.json"], [soil_map()]),
        "soil samples": Reader(of_file("twin.ground.driven_soil:read_soil_samples"), ["spoilt.csv"], [samples]),
    }  # fmt: skip


# --- drives ---


def telemetry() -> dict[str, bytes]:
    import pandas as pd
    from astropy.table import Table

    wheels = [f"{kind}_{wheel}_{unit}" for wheel in WHEELS for kind, unit in (("speed", "m_s"), ("steered", "deg"))]
    plain = table(",".join(["time_s,x_m,y_m,sigma_m,z_m,roll_deg,pitch_deg,yaw_deg", *wheels]))
    frame = pd.read_csv(io.BytesIO(plain))
    ecsv, parquet = io.StringIO(), io.BytesIO()
    Table.from_pandas(frame).write(ecsv, format="ascii.ecsv")
    frame.to_parquet(parquet)
    return {".csv": plain, ".ecsv": ecsv.getvalue().encode(), ".parquet": parquet.getvalue()}


def mission() -> bytes:
    return (Path(__file__).parents[2] / "examples/mission.toml").read_bytes()


def drive_readers() -> dict[str, Reader]:
    own = files("lunarsci")
    plan = (own / "twin/plans/plan.toml").read_bytes()
    states = b"time_s,wheel,sinkage_m,sinkage_m_sigma,slip_ratio,valid\n2,FL,0.009,0.001,0.05,true\n3,FR,0.008,,,true\n"
    commands = ",".join(f"{name}_{wheel}_{unit}" for wheel in WHEELS for name, unit in
                        (("steering", "deg"), ("speed", "m_s")))  # fmt: skip

    def rut(path: Path) -> Any:
        return of_file("twin.telemetry.sinkage:is_table_of_ruts")(path), of_file("twin.telemetry.sinkage:read_track")(
            path
        )

    def record(path: Path) -> Any:
        from lunarsci.errors import DataError, RequestError
        from lunarsci.io.inputs import read_input
        from lunarsci.io.tables import read_csv_table
        from lunarsci.rovers import read_rover
        from lunarsci.twin.ground.synthetic import synthetic_terrain
        from lunarsci.twin.plans.made_for_check import MadeForCheck

        ground = synthetic_terrain(extent_m=4.0, spacing_m=1.0, craters=0)
        check = MadeForCheck(read_rover("yutu2"), rover(), False, ground, False)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with contextlib.suppress(DataError, RequestError):
                check.tables([read_input(str(path))])
                check.states(str(path), read_csv_table(str(path)))
        return with_rover("twin.assimilation.residuals:read_record")(path)

    def sent(path: Path) -> Any:
        from lunarsci.twin.telemetry.reading import Findings

        return with_rover("twin.telemetry.reading:read_telemetry", Findings(str(path)))(path)

    public = of_path("twin.drives.layouts:read_public_drive")
    captured, run = public_drives()
    return {
        "captured drive": Reader(public, ["Processed_Data.csv"], [captured]),
        "run of a public drive": Reader(public, ["wheel-encoder.txt"], [run.pop("wheel-encoder.txt")], run),
        "plan": Reader(of_path("twin.plans.plan:read_plan"), ["spoilt.toml"], [plan]),
        "rover": Reader(lambda path: _function("twin.rover:build_rover")(of_path("rovers:read_rover")(path)),
                        ["spoilt.toml"], [(own / "rovers/yutu2.toml").read_bytes()]),
        "mission": Reader(of_path("twin.mission.mission:read_mission"), ["spoilt.toml"], [mission()]),
        **{f"telemetry {suffix}": Reader(sent, [f"spoilt{suffix}"], [data]) for suffix, data in telemetry().items()},
        "track": Reader(rut, ["spoilt.csv"], [table("x_m,y_m,rut_m")]),
        "positions": Reader(of_file("twin.telemetry.reading:read_positions"), ["spoilt.csv"],
                            [table("time_s,x_m,y_m,sigma_m")]),
        "motion": Reader(with_rover("twin.plans.motion:read_motion"), ["spoilt.csv"],
                         [table(f"time_s,x_m,y_m,yaw_deg,{commands}")]),
        "start of a plan": Reader(lambda path: _function("twin.jobs.chosen_drive:last_pose")(str(path)), ["spoilt.csv"],
                                  [b"time_s,member,x_m,y_m,yaw_deg\n0,0,0,0,0\n1,0,0.1,0,2\n"]),
        "states of poses": Reader(with_rover("twin.simulation.prescribed_motion:read_pose_states"), ["spoilt.csv"],
                                  [states]),
        "record": Reader(record, ["spoilt.csv"], [states]),
        "prediction": Reader(lambda path: _function("twin.comparison.forecast:read_forecast")(path.parent),
                             ["prediction.json"], [forecast()[0]], forecast()[1]),
    }  # fmt: skip


def public_drives() -> tuple[bytes, dict[str, bytes]]:
    """Five rows in each layout of a public data set."""
    from made_trials import HUSKY, ROSEY, made_drive, write_captured, write_run

    with tempfile.TemporaryDirectory() as folder:
        short = {"speed_m_s": 0.1, "seconds": 6.0, "rate_hz": 4.0}
        write_captured(Path(folder) / "a", made_drive(**short, **ROSEY))
        write_run(Path(folder) / "b", made_drive(**short, **HUSKY))
        captured = (Path(folder) / "a/Processed_Data.csv").read_bytes()
        return captured, {file.name: file.read_bytes() for file in (Path(folder) / "b").iterdir()}


@functools.cache
def forecast() -> tuple[bytes, Mapping[str, bytes]]:
    """A prediction of one drive of three steps: its document, and its tables."""
    from lunarsci.provenance import sha256
    from lunarsci.twin.comparison.forecast import SCHEMA
    from lunarsci.twin.simulation.ensemble import PATH_COLUMNS, STATE_COLUMNS

    steps = 3
    rows = [["member,wheel,time_s", *STATE_COLUMNS], ["member,time_s", *PATH_COLUMNS]]
    states = [f"0,{wheel},{k}" + ",0.01" * len(STATE_COLUMNS) for k in range(steps) for wheel in WHEELS]
    paths = [f"0,{k}" + ",0.05" * len(PATH_COLUMNS) for k in range(steps)]
    tables = {
        name: "\n".join([",".join(head), *body, ""]).encode()
        for name, head, body in zip(("states.csv", "paths.csv"), rows, (states, paths), strict=True)
    }
    document = {
        "schema": SCHEMA,
        "rover": {"name": "yutu2", "sha256": "0", "wheels": WHEELS, "wheel_radius_m": 0.15},
        "terrain": {"name": "SYNTHETIC", "synthetic": True},
        "soils": "one",
        "soil": {},
        "plan": (files("lunarsci") / "twin/plans/plan.toml").read_text("utf-8"),
        "time_s": [0.0, 1.0, 2.0],
        "distance_m": [0.0, 0.05, 0.1],
        "planned": [[0, 0, 0], [0.05, 0, 0], [0.1, 0, 0]],
        "halted": [False] * steps,
        "recorded": [steps],
        "outcome": ["finished"],
        "discrepancy": None,
        "tables": {name: sha256(content) for name, content in tables.items()},
    }
    return json.dumps(document).encode(), tables


# --- documents of other commands, configuration ---


@functools.cache
def _former() -> Any:
    return json.loads(FORMER.read_text("utf-8"))["answers"]


def _whole(value: Any) -> Any:
    """Lists that the table of former answers has shortened, as short lists."""
    if isinstance(value, dict) and {"length", "first", "last"} <= value.keys():
        return [_whole(value["first"]), _whole(value["middle"]), _whole(value["last"])]
    if isinstance(value, dict):
        return {key: _whole(item) for key, item in value.items()}
    return [_whole(item) for item in value] if isinstance(value, list) else value


def former(name: str) -> dict[str, Any]:
    """What a command answered, by its name in the table of former answers."""
    one = _former()[name]
    record = {"command": "lunarsci", "options": {}, "sources": ["Somebody (2000)"], "warnings": []}
    return {"schema": one["schema"], "result": _whole(one["result"]), "provenance": record}


def document_readers() -> dict[str, Reader]:
    every = [json.dumps(former(name)).encode() for name, one in _former().items() if "schema" in one]
    own = files("lunarsci")
    configuration = b'continuum = "hull"\nsmooth = 0\n'
    picture = pictures()["png"]

    def page(path: Path) -> Any:
        given = [str(path), *([str(other)] if (other := path.with_name("given.png")).exists() else [])]
        return _function("pages.job:report")(given).html(time=False)

    drawn = [*every, belief(), soil_map()]
    folder = BETWEEN.join([json.dumps(former("predict")).encode(), table("time_s,x_m,y_m"), picture])
    ground_m = b"x_m,y_m,height_m\n" + b"".join(b"%d,%d,0.1\n" % (x, y) for y in range(3) for x in range(3))
    tables = [spectrum_files()[".csv"], telemetry()[".csv"], table("sinkage_m,slip_ratio,normal_force_n"), ground_m,
              b"name,latitude_deg,longitude_deg,diameter_km\nA,17.2,144.7,28\n", belief(), soil_map(),
              json.dumps(former("fit")).encode(), FEATURE.encode(),
              b"slip,avg_Fx,avg_Fz\n0.1,2,3\n", ROS]  # fmt: skip
    settings = [SOIL, POSE, mission(), rig(), (own / "rovers/yutu2.toml").read_bytes(),
                (own / "twin/plans/plan.toml").read_bytes(),
                _function("guide.template:template")("prior").text.encode()]  # fmt: skip

    return {
        "any table": Reader(_told, ["spoilt.csv"], tables),
        "any settings": Reader(_told, ["spoilt.toml"], settings),
        "sources": Reader(lambda path: of_path("guide.cite:cite")(path).bibtex(), ["spoilt.json"], every),
        "results": Reader(page, ["spoilt.json", "given.png"], [one + BETWEEN + picture for one in drawn]),
        "folder of results": Reader(lambda path: _function("pages.job:report")([str(path.parent)]).html(time=False),
                                    ["result.json", "paths.csv", "map.png"], [folder]),
        "TOML": Reader(_toml, ["spoilt.toml"],
                       [(own / "twin/plans/plan.toml").read_bytes(), (own / "rovers/yutu2.toml").read_bytes()]),
        "configuration": Reader(_configured, ["spoilt.toml"], [configuration]),
    }  # fmt: skip


def _told(path: Path) -> Any:
    """What `lunarsci info` says of a file; what its reader says of it there is raised as by other commands."""
    found = _function("guide.info:info")(path)
    if found.trouble:
        raise LunarSciError(found.trouble)
    return found.to_json()


def _toml(path: Path) -> Any:
    try:
        return _function("io.documents:toml_document")(path.read_text("utf-8", errors="replace"))
    except tomllib.TOMLDecodeError as error:
        raise LunarSciError(str(error)) from error


def _configured(path: Path) -> Any:
    """The options of a command by `--config`; with sound ones it fails later, for want of a file."""
    from lunarsci.cli import main

    heard = io.StringIO()
    with contextlib.redirect_stderr(heard), contextlib.redirect_stdout(heard):
        code = main(["spectra", "bands", "--config", str(path), "no such file.csv"])
    said = heard.getvalue()
    if code not in (1, 2) or said.count("\n") != 1 or "error: unexpected" in said:
        raise RuntimeError(f"exit code {code}, {said}")
    if "no such file" not in said:
        raise LunarSciError(said)
    return said


PARTS = (spectra_readers, cube_readers, picture_readers, ground_readers, soil_readers, drive_readers, document_readers,
         vnis_readers)  # fmt: skip


# --- which reader a parameter of a command comes to ---

SPECTRA = (
    "spectra .csv, spectra .txt, spectra .ecsv, spectra .fits, spectra .sed, spectra .tab, spectra .xlsx, "
    "spectra splib, spectra .sli, spectra PDS3, spectra PDS4"
)
PICTURES = "picture png, picture tiff, picture jpeg"
GROUND = "terrain .npz, terrain .asc, terrain .csv, terrain .tif, terrain .nc, terrain in degrees, terrain PDS3"
SOILS = "soil, belief, soil map, soil samples, TOML"
CUBES = "cube ENVI, cube M3, cube GeoTIFF, cube NetCDF 4, cube NetCDF 3, cube NetCDF swath, VNIS cube"
READ_BY = {
    "against": "belief",
    "before": "plan",
    "belief": "belief, verdict",
    "calibration": "channel factors",
    "config": "configuration, TOML",
    "craters": "craters",
    "cube": CUBES,
    "dem": "elevation",
    "dems": "elevation",
    "file": "any table, any settings, any image",
    "files": SPECTRA,
    "keep_out": "keep-outs, search for rocks",
    "known": "modes",
    "layer": "layer",
    "left": f"{PICTURES}, picture PDS4, picture VICAR, camera label",
    "library": "library",
    "line": "line",
    "local": GROUND,
    "locations": "locations",
    "mask": "mask .npy, mask .tif",
    "metadata": "samples",
    "mineral_map": "mineral map .tif, mineral map .nc",
    "mission": "mission",
    "motion": "motion",
    "phase": "phase function",
    "pictures": PICTURES,
    "plan": "plan",
    "plans": "plan",
    "pose": "pose",
    "positions": "positions",
    "predict": "states to predict",
    "predict_rover": "rover",
    "prior": "prior",
    "result": "identified soil",
    "results": "results, folder of results, sources",
    "rig": "rig, rig of NumPy, rig of labels",
    "right": f"{PICTURES}, picture PDS4, picture VICAR, camera label",
    "rocks": SPECTRA,
    "roi": "regions",
    "rover": "rover, wheel",
    "soil": SOILS,
    "solar": "sunlight",
    "sources": "rig, rig of labels, camera label, camera CAHVOR, camera CAHVORE, camera, camera YAML",
    "start": "start of a fit",
    "stations": f"{PICTURES}, rig, pose",
    "states": "record",
    "telemetry": "telemetry .csv, telemetry .ecsv, telemetry .parquet, captured drive, run of a public drive",
    "terrain": GROUND,
    "track": "track, track in a picture",
    "wavelengths": "wavelengths",
}
"""Readers of this table that come to the file of a parameter, by the parameter's name."""
READ_BY_COMMAND = {
    "images merge positions": "stations",
    "images render terrain": "elevation",
    "regolith identify states": "states",
    "regolith infer states": "states",
    "spectra calibrate files": "VNIS products, VNIS image",
    "spectra library list files": f"library, {SPECTRA}",
    "spectra library check files": f"library, {SPECTRA}",
    "spectra library plot files": f"library, {SPECTRA}",
    "spectra match rocks": "fitted rocks",
    "twin compare inputs": "prediction, telemetry .csv, captured drive, run of a public drive",
    "twin loads states": "states of poses",
    "twin plan limits": "plan",
    "twin plan start": "start of a plan",
    "twin states track": f"track, {GROUND}",
}
"""The same where a parameter of that name is another file in one command."""
OF_KIND = {
    **{"spectra": SPECTRA, "vnis": "VNIS products", "mgm": "start of a fit", "camera": READ_BY["sources"]},
    **{
        "zones": "keep-outs, search for rocks",
        "soil map": "soil map",
        "slips": "record",
        "soils": "soil samples",
        "picture": PICTURES,
    },
    **{"result": "results", "config": READ_BY["config"]},
}
"""The same by the kind of file that a command takes, as `lunarsci.registry.KINDS` says, if that is not in `READ_BY`."""
NO_FILE = {
    *("path", "plot", "plane", "animate", "failed"),  # are written
    *("posterior", "assemblage", "dictionary", "interpolation", "kind", "lateral_modulus", "name", "sizes", "time",
      "title", "gravity", "form", "scheduler"),
    *("images dem terrain", "images dem disparity", "images dem cloud", "images merge cloud",
      "images rocks sun", "spectra simulate soil"),
}  # fmt: skip
"""Parameters with a text that names no file to read, and no metavar to say so; with the command where others of that
name do."""


def path_parameters() -> Iterator[tuple[str, str | None]]:
    """Every parameter of a command that takes a text, after the words of the command, and of an option the metavar."""
    from lunarsci.cli import command_line
    from typer.models import OptionInfo

    def walk(app: Any, words: str) -> Iterator[tuple[str, str | None]]:
        for one in app.registered_commands:
            for name, parameter in inspect.signature(one.callback).parameters.items():
                if takes_text(parameter.annotation):
                    about = get_args(parameter.annotation)[1]
                    yield f"{words}{one.name} {name}", (about.metavar or "") if isinstance(about, OptionInfo) else None
        for group in app.registered_groups:
            yield from walk(group.typer_instance, f"{words}{group.name} ")

    return walk(command_line(), "")


def takes_text(kind: Any) -> bool:
    if get_origin(kind) is Literal:
        return False
    parts = get_args(kind)[:1] if get_origin(kind) is Annotated else get_args(kind)
    return kind in (str, Path) or any(takes_text(part) for part in parts)


def readers_of(parameter: str, metavar: str | None) -> list[str] | None:
    """Names of the readers that its file comes to; none where it names no file, None where nothing is declared.

    An option is declared by its metavar, too, where this does not say FILE, and one that begins with `save` is written.
    """
    name = parameter.rpartition(" ")[2]
    if parameter in READ_BY_COMMAND:
        return READ_BY_COMMAND[parameter].split(", ")
    if parameter in NO_FILE or name in NO_FILE:
        return []
    if name in READ_BY:
        return READ_BY[name].split(", ")
    if name.startswith("save") or (metavar and "FILE" not in metavar):
        return []
    words = parameter.rpartition(" ")[0]
    takes = words if metavar is None else f"{words} --{name.replace('_', '-')}"
    kinds = [kind for kind, one in KINDS.items() if takes in one.commands]
    return [reader for kind in kinds for reader in OF_KIND.get(kind, READ_BY.get(kind, kind)).split(", ")] or None


def readers() -> dict[str, Reader]:
    """All that is tried, by name."""
    found: dict[str, Reader] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for part in PARTS:
            found |= part()
    return found


def reader_of(name: str) -> Reader:
    """One of them, without making files of the parts that follow."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return next(found[name] for part in PARTS if name in (found := part()))
