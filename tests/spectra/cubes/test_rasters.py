"""Cubes of ENVI, M3, GeoTIFF, NetCDF and VNIS."""

import importlib.util
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.heights.grids import read_grid
from lunarsci.spectra.cubes.cube import FLAGS, MISSING, NO_DATA, NOT_POSITIVE, SATURATED, Stated
from lunarsci.spectra.cubes.rasters import open_cube
from lunarsci.spectra.readers.dispatch import read_spectra
from lunarsci.spectra.vnis.simulation.instrument import simulate
from lunarsci.spectra.vnis.simulation.scene import Scene
from lunarsci.spectra.vnis.simulation.template import product_files

from .conftest import AXES, WAVELENGTHS, spectra, whole

CUBE = spectra(6, 5).astype("f4")
GAINS = np.linspace(1e-4, 2e-4, 85)


@pytest.mark.parametrize("interleave", AXES)
@pytest.mark.parametrize("dtype", ["<f4", ">f4", "<f8"])
@pytest.mark.parametrize("offset", [b"", b"x" * 128])
def test_every_layout_gives_the_same_numbers(envi: Any, interleave: str, dtype: str, offset: bytes) -> None:
    path = envi(CUBE, interleave=interleave, dtype=dtype, offset=offset)
    cube = open_cube(str(path))
    reflectance, flags = whole(cube)
    np.testing.assert_array_equal(reflectance, CUBE.astype(float))
    assert not flags.any()
    part, _ = cube.read(slice(2, 4), slice(1, 5))
    np.testing.assert_array_equal(part, CUBE[2:4, 1:5].astype(float))


def test_either_file_names_the_cube(envi: Any) -> None:
    path = envi(CUBE)
    for name in (path, path.with_suffix(".hdr")):
        assert open_cube(str(name)).shape == (6, 5)


def test_bad_bands_and_values_that_are_none_become_missing_and_are_flagged(envi: Any) -> None:
    spoiled = CUBE.copy()
    spoiled[0, 0] = -999
    spoiled[1, 1, 40] = np.nan
    spoiled[2, 2, 50] = -0.01
    spoiled[3, 3, 60] = -1.23e34
    good = np.ones(85)
    good[[0, 1, 7]] = 0
    cube = open_cube(str(envi(spoiled, data_ignore_value=-999.0, bbl=good)))
    reflectance, flags = whole(cube)
    assert np.isnan(reflectance[:, :, [0, 1, 7]]).all()
    assert np.isnan(reflectance[0, 0]).all()
    expected = np.zeros((6, 5), int)
    expected[0, 0], expected[1, 1], expected[2, 2], expected[3, 3] = NO_DATA | MISSING, MISSING, NOT_POSITIVE, MISSING
    np.testing.assert_array_equal(flags, expected)
    assert np.isnan(reflectance[2, 2, 50])
    assert len(FLAGS) == 5


@pytest.mark.parametrize(
    ("keys", "dtype", "number"),
    [
        ({"reflectance_scale_factor": 10000}, "<i2", lambda r: r * 10000),
        ({"data_gain_values": np.full(85, 5e-5), "data_offset_values": [0.01]}, "<u2", lambda r: (r - 0.01) / 5e-5),
        ({"data_reflectance_gain_values": GAINS}, "<i4", lambda r: r / GAINS),
    ],
)  # fmt: skip
def test_scale_gain_and_offset_are_applied(envi: Any, keys: Any, dtype: str, number: Callable[[Any], Any]) -> None:
    cube = open_cube(str(envi(np.round(number(CUBE.astype(float))), dtype=dtype, **keys)))
    reflectance, _ = whole(cube)
    np.testing.assert_allclose(reflectance, CUBE, atol=2e-4)


def test_the_largest_whole_number_is_saturated(envi: Any) -> None:
    numbers = np.round(CUBE * 10000)
    numbers[4, 4, 30] = 65535
    numbers[0, 0, :] = 65535
    path = envi(numbers, dtype="<u2", reflectance_scale_factor=10000)
    reflectance, flags = whole(open_cube(str(path)))
    assert flags[4, 4] == SATURATED
    assert np.isnan(reflectance[4, 4, 30])
    assert flags[0, 0] == SATURATED | NO_DATA
    ignoring = envi(numbers, dtype="<u2", reflectance_scale_factor=10000, data_ignore_value=65535)
    assert whole(open_cube(str(ignoring)))[1][4, 4] == MISSING
    lower = open_cube(str(path), Stated(saturated=float(numbers[3, 3, 80])))
    assert whole(lower)[1][3, 3] & SATURATED


def test_wavelengths_in_any_order_and_unit_end_ascending_in_nm(envi: Any) -> None:
    down = envi(CUBE[:, :, ::-1], wavelength=WAVELENGTHS[::-1], fwhm=np.linspace(50, 20, 85))
    cube = open_cube(str(down))
    np.testing.assert_allclose(cube.wavelength_nm, WAVELENGTHS)
    np.testing.assert_array_equal(whole(cube)[0], CUBE.astype(float))
    assert cube.fwhm_nm is not None
    np.testing.assert_allclose(cube.fwhm_nm, np.linspace(20, 50, 85))
    micro = envi(CUBE, wavelength=WAVELENGTHS / 1000, wavelength_units="Micrometers", fwhm=np.full(85, 0.02))
    cube = open_cube(str(micro))
    np.testing.assert_allclose(cube.wavelength_nm, WAVELENGTHS, rtol=1e-9)
    np.testing.assert_allclose(cube.fwhm_nm, 20)


@pytest.mark.parametrize("unit", [None, "Unknown"])
def test_a_missing_unit_is_told_by_the_numbers_and_said(envi: Any, unit: str | None) -> None:
    with pytest.warns(LunarSciWarning, match="read as"):
        cube = open_cube(str(envi(CUBE, wavelength=WAVELENGTHS / 1000, wavelength_units=unit)))
    np.testing.assert_allclose(cube.wavelength_nm, WAVELENGTHS, rtol=1e-9)


def test_a_wrong_unit_is_overruled_and_said(envi: Any) -> None:
    with pytest.warns(LunarSciWarning, match="are in um; read as nm"):
        cube = open_cube(str(envi(CUBE, wavelength_units="Micrometers")))
    np.testing.assert_allclose(cube.wavelength_nm, WAVELENGTHS)
    with pytest.warns(LunarSciWarning, match="are in nm; read as um"):
        cube = open_cube(str(envi(CUBE, wavelength=WAVELENGTHS / 1000)))
    np.testing.assert_allclose(cube.wavelength_nm, WAVELENGTHS, rtol=1e-9)


def test_unsorted_wavelengths_are_sorted_and_said(envi: Any) -> None:
    order = np.r_[40:85, 0:40]
    with pytest.warns(LunarSciWarning, match="no order"):
        cube = open_cube(str(envi(CUBE[:, :, order], wavelength=WAVELENGTHS[order])))
    np.testing.assert_array_equal(whole(cube)[0], CUBE.astype(float))


def test_wavelengths_from_a_table(envi: Any, tmp_path: Path) -> None:
    path, table = envi(CUBE, wavelength=None, wavelength_units=None), tmp_path / "channels.csv"
    good = [0, *[1] * 84]
    rows = [f"{w / 1000:.6f},{0.02},{g}" for w, g in zip(WAVELENGTHS, good, strict=True)]
    table.write_text("\n".join(["wavelength_um,fwhm,good", *rows]))
    cube = open_cube(str(path), Stated(wavelengths=str(table)))
    np.testing.assert_allclose(cube.wavelength_nm, WAVELENGTHS, rtol=1e-9)
    assert cube.bad.tolist() == [True, *[False] * 84]
    np.testing.assert_allclose(cube.fwhm_nm, 20)


@pytest.mark.parametrize(
    ("keys", "why"),
    [
        ({"wavelength": None}, "has no wavelengths; name a file with one for each band"),
        ({"wavelength": np.r_[WAVELENGTHS[:40], WAVELENGTHS[40:] / 1000]}, "are in several units"),
        ({"wavelength": np.r_[WAVELENGTHS[:84], WAVELENGTHS[0]]}, "two bands have the wavelength"),
        ({"wavelength": WAVELENGTHS[:80]}, "80 'wavelength' for bands = 85"),
        ({"wavelength_units": "GHz"}, "'wavelength units' is 'GHz'"),
        ({"wavelength_units": "Index", "wavelength": np.arange(85)}, "have no unit and the values do not tell it"),
        ({"band_names": "{" + ", ".join(f"PC Band {k}" for k in range(1, 86)) + "}"}, "is a rotated component"),
        ({"band_names": "{" + ", ".join(f"MNF {k}" for k in range(1, 86)) + "}"}, "is a rotated component"),
        ({"file_type": "ENVI Classification"}, "no image of spectra"),
        ({"interleave": "bsx"}, "'interleave' is 'bsx'"),
        ({"data_type": 6}, "real numbers are 1, 2"),
        ({"lines": 7}, "shorter than the"),
        ({"lines": 5}, "longer than the"),
        ({"samples": 0}, "are no image"),
        ({"lines": "many"}, "'lines' is 'many', no whole number"),
        ({"file_compression": 1}, "compressed"),
        ({"bbl": np.zeros(85)}, "0 good channels"),
        ({"reflectance_scale_factor": 0}, "must be above 0"),
        ({"reflectance_scale_factor": 1e4, "data_gain_values": np.ones(85)}, "leave the wrong one out"),
    ],
)
def test_headers_that_cannot_be_meant_are_refused(envi: Any, refused: Any, keys: Any, why: str) -> None:
    extra = {key: keys.pop(key) for key in ("interleave",) if key in keys}
    path = envi(CUBE, **keys)
    for key, value in extra.items():
        header = path.with_suffix(".hdr")
        header.write_text(header.read_text().replace("interleave = bil", f"{key} = {value}"))
    assert why in refused(path)


@pytest.mark.parametrize(
    ("factor", "dtype", "why"),
    [
        (255 / CUBE.max(), "u1", "8-bit numbers without a scale"),
        (10000, "<i2", "need `scale` (10000 is common"),
        (100, "<f4", "percent have `scale` 100"),
        (5000, "<f4", "of radiance take its reflectance: of M3"),
    ],
)
def test_numbers_that_are_no_reflectances_are_refused(
    envi: Any, refused: Any, factor: float, dtype: str, why: str
) -> None:
    assert why in refused(envi(np.round(CUBE * factor), dtype=dtype))


def test_a_stated_scale_makes_percent_a_fraction(envi: Any) -> None:
    reflectance, _ = whole(open_cube(str(envi(CUBE * 100)), Stated(scale=100.0)))
    np.testing.assert_allclose(reflectance, CUBE, rtol=1e-6)


def test_files_that_are_missing_or_no_cube(envi: Any, refused: Any, tmp_path: Path) -> None:
    path = envi(CUBE)
    path.unlink()
    assert "data file (.img) is missing" in refused(path.with_suffix(".hdr"))
    assert "no such file" in refused(path)
    (tmp_path / "notes.img").write_text("nothing")
    assert "is no cube" in refused(tmp_path / "notes.img")
    header = tmp_path / "open.hdr"
    header.write_text("ENVI\nsamples = 5\nwavelength = {1, 2\n")
    header.with_suffix(".img").write_bytes(b"0")
    assert "never closed" in refused(header)


REAL_M3 = """ENVI
description = {{M3 L2: reflectance, I/F, photometrically and thermally corrected}}
samples = {samples}
lines = {lines}
bands = 85
header offset = 0
file type = ENVI Standard
data type = 4
interleave = bil
sensor type = Unknown
byte order = 0
flip = 2
wavelength units = Nanometers
data ignore value = -999.00000000e+000
wavelength = {{
 {wavelengths}}}
fwhm = {{
 {fwhm}}}
bbl = {{
 {good}}}
"""
"""After the header of M3G20090203T175131_V01_RFL in the PDS archive (CH1M3_0004), as inspected in a public repository:
32-bit floats, bil, little endian, -999, 85 centres of 460.99 to 2976.20 nm, the first two bands marked bad."""


def m3(folder: Path, cube: Any = CUBE, suffix: str = ".IMG") -> Path:
    name = "M3G20090203T175131_V01_RFL"
    values = {
        "wavelengths": ",\n ".join(f"{w:.2f}" for w in WAVELENGTHS),
        "fwhm": ", ".join(["12.60"] * 85),
        "good": ", ".join(["0", "0", *["1"] * 83]),
    }
    header = REAL_M3.format(lines=cube.shape[0], samples=cube.shape[1], **values)
    (folder / f"{name}.HDR").write_bytes(header.replace("\n", "\r\n").encode())
    (folder / f"{name}{suffix}").write_bytes(cube.transpose(0, 2, 1).astype("<f4").tobytes())
    return folder / f"{name}{suffix}"


def backplane(folder: Path, kind: str, planes: Any, dtype: str) -> None:
    lines, samples, bands = planes.shape
    code = {"<f4": 4, "<f8": 5}[dtype]
    (folder / f"M3G20090203T175131_V03_{kind}.HDR").write_text(
        f"ENVI\nsamples = {samples}\nlines = {lines}\nbands = {bands}\nheader offset = 0\nfile type = ENVI Standard\n"
        f"data type = {code}\ninterleave = bil\nbyte order = 0\n"
    )
    (folder / f"M3G20090203T175131_V03_{kind}.IMG").write_bytes(planes.transpose(0, 2, 1).astype(dtype).tobytes())


def test_a_header_of_m3_is_read_with_its_planes(tmp_path: Path) -> None:
    spoiled = CUBE.copy()
    spoiled[0] = -999
    path = m3(tmp_path, spoiled)
    places = np.stack([30 + 0.1 * np.arange(30).reshape(6, 5), np.full((6, 5), 20.0), np.full((6, 5), 1737400.0)], 2)
    backplane(tmp_path, "LOC", places, "<f8")
    backplane(tmp_path, "OBS", np.arange(300.0).reshape(6, 5, 10), "<f4")
    (tmp_path / "M3G20090203T175131_V01_L2.LBL").write_text("PDS_VERSION_ID = PDS3\n")
    for name in (path, path.with_name("M3G20090203T175131_V01_L2.LBL"), path.with_suffix(".HDR")):
        cube = open_cube(str(name))
        assert (cube.format, cube.shape, int(cube.bad.sum())) == ("m3", (6, 5), 2)
    reflectance, flags = whole(cube)
    assert (flags[0] & NO_DATA).all()
    assert not flags[1:].any()
    np.testing.assert_array_equal(reflectance[1:, :, 2:], CUBE[1:, :, 2:].astype(float))
    part = slice(2, 4), slice(1, 3)
    np.testing.assert_allclose(cube.backplanes["longitude"].read(*part), places[2:4, 1:3, 0])
    np.testing.assert_allclose(cube.backplanes["facet_cos_incidence"].read(*part), [[119, 129], [169, 179]])
    assert any("flip = 2" in text for text in cube.remarks)
    assert len(cube.inputs) == 6


def test_planes_of_another_size_are_not_used(tmp_path: Path) -> None:
    path = m3(tmp_path)
    backplane(tmp_path, "LOC", np.zeros((7, 5, 3)), "<f8")
    with pytest.warns(LunarSciWarning, match="it is not used"):
        assert not open_cube(str(path)).backplanes


def test_other_files_of_m3_are_refused(tmp_path: Path, refused: Any) -> None:
    backplane(tmp_path, "LOC", np.zeros((7, 5, 3)), "<f8")
    assert "of M3 the _RFL.IMG of Level 2" in refused(tmp_path / "M3G20090203T175131_V03_LOC.IMG")
    (bare := tmp_path / "M3G20090203T175131_V03_RDN.IMG").write_bytes(b"\0" * 64)
    assert "is M3's RDN file, radiance; take its reflectance: of M3" in refused(bare)


needs_rasterio = pytest.mark.skipif(importlib.util.find_spec("rasterio") is None, reason="needs rasterio")
UTM = (
    'PROJCS["UTM_Zone_11N",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],'
    'PRIMEM["Greenwich",0],UNIT["Degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],'
    'PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",-117],PARAMETER["scale_factor",0.9996],'
    'PARAMETER["false_easting",500000],PARAMETER["false_northing",0],UNIT["Meter",1]]'
)


@needs_rasterio
def test_a_real_header_with_a_rotated_frame_is_read(envi: Any) -> None:
    """After `caltech_15_20_20_data_ignore_bb.hdr` of WISER's tests (Ehlmann-research-group/WISER, an AVIRIS scene)."""
    waves = [1308.469971, 1313.47998, 1318.48999, 1323.5, 1328.51001, 1333.52002, 1338.52002, 1343.530029, 1348.540039]
    waves += [1353.550049, 1433.689941, 1438.699951, 1443.709961, 1448.719971, 1453.719971]
    good = [1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 1, 1, 1, 1, 1]
    scene = spectra(20, 20, np.array(waves)).astype("f4")
    scene[:4, :3] = -9999
    path = envi(
        scene,
        "scene",
        interleave="bsq",
        wavelength=waves,
        bbl=good,
        data_ignore_value=-9999,
        map_info="{UTM, 1, 1, 395929.418275835, 3777660.07180369, 2, 2, 11, North, WGS-84, rotation=-2}",
        coordinate_system_string="{" + UTM + "}",
    )
    cube = open_cube(str(path))
    _, flags = whole(cube)
    assert (flags[:4, :3] & NO_DATA).all()
    assert not flags[4:].any()
    assert cube.bad.tolist() == [not item for item in good]
    assert cube.frame is not None
    assert cube.frame.rotated
    a, b, c, d, e, f = cube.frame.transform
    assert (c, f) == pytest.approx((395929.418275835, 3777660.07180369))
    assert np.hypot(a, d) == pytest.approx(2)
    assert np.degrees(np.arctan2(d, a)) == pytest.approx(-2)
    assert a * e - b * d == pytest.approx(-4)
    assert "Transverse_Mercator" in cube.frame.crs_wkt


rasterio = pytest.importorskip("rasterio")
xarray = pytest.importorskip("xarray")
BANDS_OF_RASTERS = spectra(6, 5, seed=2).astype("f4")
MOON = "+proj=longlat +R=1737400 +no_defs"


def tiff(path: Path, cube: Any = BANDS_OF_RASTERS, *, names: Any = None, tags: Any = None, **profile: Any) -> Path:
    from rasterio.transform import Affine

    kind = {
        "driver": "GTiff", "width": cube.shape[1], "height": cube.shape[0], "count": cube.shape[2], "crs": MOON,
        "dtype": cube.dtype.name, "transform": Affine(0.01, 0.002, 30, 0.001, -0.01, 20), **profile,
    }  # fmt: skip
    scale = kind.pop("scale", None)
    with rasterio.open(path, "w", **kind) as file:
        file.write(cube.transpose(2, 0, 1))
        for band in range(1, cube.shape[2] + 1):
            if names is not None:
                file.set_band_description(band, names[band - 1])
            if tags is not None:
                file.update_tags(band, **tags[band - 1])
        if scale:
            file.scales = [scale] * cube.shape[2]
    return path


@pytest.mark.parametrize(
    "named",
    [
        {"names": [f"{w:.2f} nm" for w in WAVELENGTHS]},
        {"names": [f"Band {k} ({w / 1000:.5f} um)" for k, w in enumerate(WAVELENGTHS, 1)]},
        {"names": [f"{w:.2f} Nanometers" for w in WAVELENGTHS]},
        {"tags": [{"wavelength": f"{w:.2f}", "wavelength_units": "Nanometers"} for w in WAVELENGTHS]},
    ],
)
def test_wavelengths_of_bands_are_told_by_descriptions_or_tags(tmp_path: Path, named: Any) -> None:
    cube = open_cube(str(tiff(tmp_path / "stack.tif", **named)))
    np.testing.assert_allclose(cube.wavelength_nm, WAVELENGTHS, atol=0.006)
    np.testing.assert_array_equal(whole(cube)[0], BANDS_OF_RASTERS.astype(float))


def test_a_rotated_transform_is_kept(tmp_path: Path) -> None:
    cube = open_cube(str(tiff(tmp_path / "stack.tif", names=[f"{w} nm" for w in WAVELENGTHS])))
    assert cube.frame is not None
    assert cube.frame.rotated
    np.testing.assert_allclose(cube.frame.transform, [0.01, 0.002, 30, 0.001, -0.01, 20])
    x, y = cube.frame.part(2, 1, 3).middles(np.array(1.0), np.array(1.0))
    np.testing.assert_allclose([x, y], [30 + 0.01 * 4.5 + 0.002 * 5.5, 20 + 0.001 * 4.5 - 0.01 * 5.5])


def test_no_value_scale_and_saturation_of_whole_numbers(tmp_path: Path) -> None:
    numbers = np.round(BANDS_OF_RASTERS * 10000).astype("u2")
    numbers[1, 1], numbers[2, 2, 8] = 0, 65535
    path = tiff(tmp_path / "stack.tif", numbers, names=[f"{w} nm" for w in WAVELENGTHS], nodata=0, scale=1e-4)
    reflectance, flags = whole(open_cube(str(path)))
    assert flags[1, 1] & NO_DATA
    assert flags[2, 2] == SATURATED
    np.testing.assert_allclose(reflectance[3], BANDS_OF_RASTERS[3], atol=6e-5)


def test_a_stack_without_wavelengths_needs_a_table(tmp_path: Path, refused: Any) -> None:
    path, table = tiff(tmp_path / "stack.tif", names=[f"Band {k}" for k in range(85)]), tmp_path / "nm.txt"
    assert "has no wavelengths; name a file" in refused(path)
    table.write_text("\n".join(f"{w:.2f}" for w in WAVELENGTHS[:80]))
    assert "has 80 wavelengths" in refused(path, wavelengths=str(table), wavelength_unit="nm")
    table.write_text("\n".join(f"{w:.2f}" for w in WAVELENGTHS))
    cube = open_cube(str(path), Stated(wavelengths=str(table), wavelength_unit="nm"))
    np.testing.assert_allclose(cube.wavelength_nm, WAVELENGTHS)


def test_pictures_and_damaged_files_are_refused(tmp_path: Path, refused: Any) -> None:
    names = [f"{w} nm" for w in WAVELENGTHS]
    picture = tiff(tmp_path / "picture.tif", np.round(BANDS_OF_RASTERS * 900).astype("u1"), names=names)
    assert "8-bit numbers without a scale" in refused(picture)
    cut = tmp_path / "cut.tif"
    cut.write_bytes(picture.read_bytes()[:40])
    assert "cannot be read" in refused(cut)
    with rasterio.open(
        tmp_path / "waves.tif", "w", driver="GTiff", width=2, height=2, count=6, dtype="complex64"
    ) as file:
        file.write(np.ones((6, 2, 2), "complex64"))
        for band in range(1, 7):
            file.set_band_description(band, f"{500 + band} nm")
    assert "complex numbers" in refused(tmp_path / "waves.tif")


def netcdf(path: Path, *, order: tuple[str, ...] = ("y", "x", "wavelength"), waves: Any = None, **more: Any) -> Path:
    data = xarray.Dataset(
        {"reflectance": (("y", "x", "wavelength"), BANDS_OF_RASTERS), **more.pop("variables", {})},
        coords={"x": 30 + 0.01 * np.arange(5), "y": 20 - 0.02 * np.arange(6), **more.pop("coords", {})},
    )
    data = data.assign_coords(waves or {"wavelength": ("wavelength", WAVELENGTHS / 1000, {"units": "um"})})
    data["reflectance"] = data["reflectance"].transpose(*order)
    data.to_netcdf(path, engine="h5netcdf", encoding={"reflectance": {"_FillValue": -999.0, **more}})
    return path


@pytest.mark.parametrize("order", [("y", "x", "wavelength"), ("wavelength", "y", "x"), ("y", "wavelength", "x")])
def test_netcdf_in_any_order_of_dimensions(tmp_path: Path, order: tuple[str, ...]) -> None:
    cube = open_cube(str(netcdf(tmp_path / "cube.nc", order=order)))
    np.testing.assert_allclose(cube.wavelength_nm, WAVELENGTHS, rtol=1e-9)
    np.testing.assert_array_equal(whole(cube)[0], BANDS_OF_RASTERS.astype(float))
    assert cube.frame is not None
    np.testing.assert_allclose(cube.frame.transform, [0.01, 0, 29.995, 0, -0.02, 20.01])


def test_packed_numbers_bad_bands_and_places_of_netcdf(tmp_path: Path) -> None:
    waves = {"radiation": ("band", WAVELENGTHS, {"units": "nm", "standard_name": "radiation_wavelength"})}
    good = np.ones(85)
    good[3] = 0
    data = xarray.Dataset(
        {
            "refl": (("row", "column", "band"), BANDS_OF_RASTERS),
            "good_wavelengths": (("band",), good),
            "fwhm": (("band",), np.full(85, 12.0)),
            "lon": (("row", "column"), np.arange(30.0).reshape(6, 5), {"standard_name": "longitude"}),
            "lat": (("row", "column"), np.full((6, 5), 4.0), {"standard_name": "latitude"}),
            **waves,
        }
    )
    path = tmp_path / "packed.nc"
    data.to_netcdf(path, engine="h5netcdf", encoding={"refl": {"dtype": "i2", "scale_factor": 1e-4, "_FillValue": -1}})
    cube = open_cube(str(path))
    reflectance, _ = whole(cube)
    np.testing.assert_allclose(reflectance[:, :, 4:], BANDS_OF_RASTERS[:, :, 4:], atol=6e-5)
    assert cube.bad.tolist() == [k == 3 for k in range(85)]
    assert cube.frame is None
    np.testing.assert_array_equal(cube.backplanes["longitude"].read(slice(1, 3), slice(0, 2)), [[5, 6], [10, 11]])
    assert cube.fwhm_nm is not None


def test_netcdf_that_is_no_cube(tmp_path: Path, refused: Any) -> None:
    flat = tmp_path / "flat.nc"
    xarray.Dataset({"albedo": (("y", "x"), np.ones((3, 3)))}).to_netcdf(flat, engine="h5netcdf")
    assert "no variables of lines, samples and wavelengths" in refused(flat)
    two = netcdf(tmp_path / "two.nc", variables={"other": (("y", "x", "wavelength"), BANDS_OF_RASTERS)})
    assert "has 2 variables" in refused(two)
    bare = netcdf(tmp_path / "bare.nc", waves={"channel": ("wavelength", np.arange(85))})
    assert "has no wavelengths" in refused(bare)
    cut = tmp_path / "cut.nc"
    cut.write_bytes(two.read_bytes()[:2000])
    assert "cannot be read as NetCDF" in refused(cut)


@pytest.fixture(scope="module")
def products() -> Mapping[str, bytes]:
    return product_files(simulate(Scene(), seed=3))


def test_an_image_of_vnis_is_as_bright_as_its_calibrated_spectrum(
    products: Mapping[str, bytes], tmp_path: Path
) -> None:
    """The mean over the field of view of SWIR, that the calibration averages: science.md's centre and radius."""
    for name, content in products.items():
        (tmp_path / name).write_bytes(content)
    label = next(name for name in products if "VD_SCI" in name.replace("VNIS-", "") or ("VD" in name and "SCI" in name))
    cube = open_cube(str(tmp_path / label))
    assert (cube.format, cube.shape, cube.wavelength_nm.size) == ("vnis", (256, 256), 100)
    reflectance, _ = whole(cube)
    line, sample = np.mgrid[:256, :256]
    inside = (sample - 97) ** 2 + (line - 127) ** 2 <= 53.8**2
    spectrum = read_spectra(str(tmp_path / label))[0]
    shown = np.interp(cube.wavelength_nm, spectrum.wavelength_nm, spectrum.reflectance)
    ratio = reflectance[inside].mean(axis=0) / shown
    # Splicing scales the spectrum of the image to that of SWIR: one factor, near 1.
    assert ratio[:80].std() < 0.01
    assert abs(ratio[:80].mean() - 1) < 0.05


def declared(path: Path, samples: int, chunks: tuple[int, int, int] = (1, 1, 1000), *, axis: bool = False) -> str:
    """A NetCDF cube of eight channels and three lines in whose chunks nothing was ever written: some kB of file."""
    h5netcdf = pytest.importorskip("h5netcdf")
    with h5netcdf.File(path, "w") as file:
        file.dimensions = {"wavelength": 8, "y": 3, "x": samples}
        wave = file.create_variable("wavelength", ("wavelength",), float, data=500.0 + 100 * np.arange(8))
        wave.attrs["units"] = "nm"
        file.create_variable("reflectance", ("wavelength", "y", "x"), "f4", chunks=chunks)
        if axis:
            file.create_variable("x", ("x",), float, chunks=(1000,))
    assert path.stat().st_size < 20_000
    return str(path)


@pytest.mark.parametrize("samples", [50_000_001, 4_000_000_000])
def test_axes_of_netcdf_too_long_to_be_read_are_refused_unread(samples: int, tmp_path: Path) -> None:
    """The second would take 32 GB."""
    with pytest.raises(DataError, match=f"'x' has {samples} numbers.*, too many to be read at once"):
        open_cube(declared(tmp_path / "long.nc", samples, axis=True))
    assert open_cube(declared(tmp_path / "sound.nc", 1000, axis=True)).shape == (3, 1000)


def test_chunks_of_netcdf_too_large_to_be_unpacked_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="'reflectance' has 144000000 numbers in chunks of 81600000, too many"):
        open_cube(declared(tmp_path / "chunks.nc", 6_000_000, (8, 3, 3_400_000)))


def test_lines_too_long_for_the_memory_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="6250001 samples of 8 bands on a line, and at most 50 million"):
        open_cube(declared(tmp_path / "long.nc", 6_250_001))


def test_blocks_of_rasters_too_large_to_be_unpacked_are_refused(tmp_path: Path) -> None:
    """A picture of 50 x 50 in one tile of 339 MB, in which nothing was written."""
    how: dict[str, Any] = {"driver": "GTiff", "count": 6, "dtype": "float32", "SPARSE_OK": True, "tiled": True}
    how["transform"] = rasterio.Affine(1, 0, 0, 0, -1, 0)
    for side, refused in ((9_200, True), (64, False)):
        tiles = {"blockxsize": side, "blockysize": side}
        with rasterio.open(tmp_path / f"{side}.tif", "w", height=50, width=50, **tiles, **how) as file:
            for band in range(1, 7):
                file.set_band_description(band, f"{400 + 100 * band} nm")
        if refused:
            for read in (open_cube, read_grid):
                with pytest.raises(DataError, match=f"packed in blocks of {side} x {side}, too large to be read"):
                    read(str(tmp_path / f"{side}.tif"))
        else:
            assert open_cube(str(tmp_path / f"{side}.tif")).shape == (50, 50)
