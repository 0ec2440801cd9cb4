"""Stacks in GeoTIFF and NetCDF, images of VNIS: wavelengths from wherever they are, frames, what is refused."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lunarsci.errors import DataError
from lunarsci.heights.grids import read_grid
from lunarsci.spectra.cubes.cube import NO_DATA, SATURATED, Stated
from lunarsci.spectra.cubes.rasters import open_cube
from lunarsci.spectra.readers import read_spectra
from lunarsci.spectra.vnis.simulation.instrument import simulate
from lunarsci.spectra.vnis.simulation.scene import Scene
from lunarsci.spectra.vnis.simulation.template import product_files

from .conftest import WAVELENGTHS, spectra, whole

rasterio = pytest.importorskip("rasterio")
xarray = pytest.importorskip("xarray")
CUBE = spectra(6, 5, seed=2).astype("f4")
MOON = "+proj=longlat +R=1737400 +no_defs"


def tiff(path: Path, cube: Any = CUBE, *, names: Any = None, tags: Any = None, **profile: Any) -> Path:
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
    np.testing.assert_array_equal(whole(cube)[0], CUBE.astype(float))


def test_a_rotated_transform_is_kept(tmp_path: Path) -> None:
    cube = open_cube(str(tiff(tmp_path / "stack.tif", names=[f"{w} nm" for w in WAVELENGTHS])))
    assert cube.frame is not None
    assert cube.frame.rotated
    np.testing.assert_allclose(cube.frame.transform, [0.01, 0.002, 30, 0.001, -0.01, 20])
    x, y = cube.frame.part(2, 1, 3).middles(np.array(1.0), np.array(1.0))
    np.testing.assert_allclose([x, y], [30 + 0.01 * 4.5 + 0.002 * 5.5, 20 + 0.001 * 4.5 - 0.01 * 5.5])


def test_no_value_scale_and_saturation_of_whole_numbers(tmp_path: Path) -> None:
    numbers = np.round(CUBE * 10000).astype("u2")
    numbers[1, 1], numbers[2, 2, 8] = 0, 65535
    path = tiff(tmp_path / "stack.tif", numbers, names=[f"{w} nm" for w in WAVELENGTHS], nodata=0, scale=1e-4)
    reflectance, flags = whole(open_cube(str(path)))
    assert flags[1, 1] & NO_DATA
    assert flags[2, 2] == SATURATED
    np.testing.assert_allclose(reflectance[3], CUBE[3], atol=6e-5)


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
    picture = tiff(tmp_path / "picture.tif", np.round(CUBE * 900).astype("u1"), names=names)
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
        {"reflectance": (("y", "x", "wavelength"), CUBE), **more.pop("variables", {})},
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
    np.testing.assert_array_equal(whole(cube)[0], CUBE.astype(float))
    assert cube.frame is not None
    np.testing.assert_allclose(cube.frame.transform, [0.01, 0, 29.995, 0, -0.02, 20.01])


def test_packed_numbers_bad_bands_and_places_of_netcdf(tmp_path: Path) -> None:
    waves = {"radiation": ("band", WAVELENGTHS, {"units": "nm", "standard_name": "radiation_wavelength"})}
    good = np.ones(85)
    good[3] = 0
    data = xarray.Dataset(
        {
            "refl": (("row", "column", "band"), CUBE),
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
    np.testing.assert_allclose(reflectance[:, :, 4:], CUBE[:, :, 4:], atol=6e-5)
    assert cube.bad.tolist() == [k == 3 for k in range(85)]
    assert cube.frame is None
    np.testing.assert_array_equal(cube.backplanes["longitude"].read(slice(1, 3), slice(0, 2)), [[5, 6], [10, 11]])
    assert cube.fwhm_nm is not None


def test_netcdf_that_is_no_cube(tmp_path: Path, refused: Any) -> None:
    flat = tmp_path / "flat.nc"
    xarray.Dataset({"albedo": (("y", "x"), np.ones((3, 3)))}).to_netcdf(flat, engine="h5netcdf")
    assert "no variable of lines, samples and wavelengths" in refused(flat)
    two = netcdf(tmp_path / "two.nc", variables={"other": (("y", "x", "wavelength"), CUBE)})
    assert "several cubes" in refused(two)
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


@pytest.mark.parametrize("samples", [10_000_001, 4_000_000_000])
def test_axes_of_netcdf_too_long_to_be_read_are_refused_unread(samples: int, tmp_path: Path) -> None:
    """The second would take 32 GB."""
    with pytest.raises(DataError, match=f"'x' has {samples} numbers, too many for an axis"):
        open_cube(declared(tmp_path / "long.nc", samples, axis=True))
    assert open_cube(declared(tmp_path / "sound.nc", 1000, axis=True)).shape == (3, 1000)


def test_chunks_of_netcdf_too_large_to_be_unpacked_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="'reflectance' is packed in chunks too large"):
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
