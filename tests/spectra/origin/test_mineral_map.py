"""Compositions from mineral maps: made-up maps whose ring means are known, in every layout a map may have."""

import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.crs import CRS
from rasterio.transform import from_bounds

from lunarsci.errors import DataError, ParameterError
from lunarsci.spectra.origin.catalogue import Crater
from lunarsci.spectra.origin.composition import Composition
from lunarsci.spectra.origin.mineral_map import _looks_like_degrees, ring_values, with_maps

MOON = CRS.from_proj4("+proj=longlat +R=1737400 +no_defs")
POLAR = CRS.from_proj4("+proj=stere +lat_0=-90 +lon_0=0 +R=1737400 +units=m +no_defs")
CYLINDER = CRS.from_proj4("+proj=eqc +lon_0=180 +R=1737400 +units=m +no_defs")
Field = Callable[[np.ndarray, np.ndarray], np.ndarray]


def write(
    path: Path,
    field: Field,
    bounds: tuple[float, float, float, float],
    crs: CRS | None = MOON,
    size: int = 720,
    **kind: Any,
) -> str:
    """A map whose values are `field` of the pixel's x and y."""
    west, south, east, north = bounds
    height = max(2, round(size * (north - south) / (east - west)))
    x = west + (np.arange(size) + 0.5) * (east - west) / size
    y = north - (np.arange(height) + 0.5) * (north - south) / height
    values = field(*np.meshgrid(x, y))
    profile = {"driver": "GTiff", "width": size, "height": height, "count": 1, "dtype": "float32"} | kind
    transform = from_bounds(west, south, east, north, size, height)
    with rasterio.open(path, "w", crs=crs, transform=transform, **profile) as file:
        file.write(values.astype(profile["dtype"]), 1)
    return str(path)


def even(value: float) -> Field:
    return lambda x, y: np.full(x.shape, value)


def crater(latitude: float, longitude: float, diameter_km: float = 60) -> Crater:
    return Crater(name="A", latitude_deg=latitude, longitude_deg=longitude, diameter_km=diameter_km)


def values(path: str, one: Crater, annulus: tuple[float, float] = (1, 2)) -> np.ndarray:
    with rasterio.open(path) as dataset:
        return ring_values(dataset, one, annulus)


@pytest.mark.parametrize(
    ("bounds", "longitude"),
    [((-180, -90, 180, 90), 179.5), ((-180, -90, 180, 90), -180), ((0, -90, 360, 90), 359.8), ((0, -90, 360, 90), -0.2),
     ((170, -60, 190, -30), -180.0), ((-190, -60, -170, -30), 178), ((-30, -60, 30, -30), 359)],
)  # fmt: skip
def test_longitudes_of_either_kind_and_across_the_seam(tmp_path: Path, bounds: tuple, longitude: float) -> None:
    """The map rises towards the crater's meridian, whichever way its longitude is written."""

    def field(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 10 + 5 * np.cos(np.radians(x - longitude) * 20)

    path = write(tmp_path / "map.tif", field, bounds, size=3600 if bounds[2] - bounds[0] > 100 else 600)
    found = values(path, crater(-45, longitude))
    assert np.isfinite(found).all()
    assert found.min() > 10 + 5 * np.cos(np.radians(20 * 3)), "the ring reaches 2.8 deg in longitude"


def test_the_ring_is_the_ring(tmp_path: Path) -> None:
    """Inside the rim 80, in the ring 20, beyond 50 (distance by the cosine rule): only 20 is read."""
    center = np.radians([-45.0, 10.0])

    def field(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        lon, lat = np.radians(x), np.radians(y)
        cosine = np.sin(lat) * np.sin(center[0]) + np.cos(lat) * np.cos(center[0]) * np.cos(lon - center[1])
        radii = 1737.4 * np.arccos(np.clip(cosine, -1, 1)) / 30
        return np.where(radii < 0.97, 80.0, np.where(radii < 2.03, 20.0, 50.0))

    path = write(tmp_path / "map.tif", field, (0, -55, 20, -35), size=2000)
    assert np.unique(values(path, crater(-45, 10))) == pytest.approx([20])
    assert np.unique(values(path, crater(-45, 10), (0, 0.9))) == pytest.approx([80])
    assert np.unique(values(path, crater(-45, 10), (2.2, 3))) == pytest.approx([50])


def test_the_ring_is_even_by_area(tmp_path: Path) -> None:
    """The mean of the squared distance in rim radii over a flat ring from 1 to 2 is (2^4 - 1) / (2 (2^2 - 1)) = 2.5."""

    def field(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        km = 1737.4 * np.arccos(np.clip(np.cos(np.radians(y)) * np.cos(np.radians(x)), -1, 1))
        return (km / 30) ** 2

    path = write(tmp_path / "map.tif", field, (-4, -4, 4, 4), size=1600)
    assert values(path, crater(0, 0)).mean() == pytest.approx(2.5, rel=2e-3)


@pytest.mark.parametrize(
    ("crs", "one", "bounds"),
    [
        (POLAR, crater(-88, 77), (-300e3, -300e3, 300e3, 300e3)),
        (POLAR, crater(-90, 0), (-300e3, -300e3, 300e3, 300e3)),
        (CYLINDER, crater(-45.44, 177.56), (-600e3, -1700e3, 600e3, -1000e3)),
        (CYLINDER, crater(10, -175), (-600e3, -100e3, 600e3, 700e3)),
    ],
)
def test_projected_maps(tmp_path: Path, crs: CRS, one: Crater, bounds: tuple) -> None:
    """A blob about the crater's own place in map coordinates, by the projections' formulas for a sphere."""
    lat, lon = np.radians(one.latitude_deg), np.radians(one.longitude_deg)
    if crs is POLAR:
        rho = 2 * 1737400 * np.tan(np.pi / 4 + lat / 2)
        x0, y0 = rho * np.sin(lon), rho * np.cos(lon)
    else:
        x0 = 1737400 * ((lon - np.pi + np.pi) % (2 * np.pi) - np.pi)
        y0 = 1737400 * lat

    def field(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        stretch = np.cos(lat) if crs is CYLINDER else 1.0
        return 60 - np.hypot((x - x0) * stretch, y - y0) / 1e3 / 2

    found = values(write(tmp_path / "map.tif", field, bounds, crs, 1200), one, (1, 1.05))
    assert np.isfinite(found).all()
    assert found.mean() == pytest.approx(60 - 30 * 1.025 / 2, abs=0.2)
    assert found.std() < 0.8


def test_a_window_too_large_is_read_coarsely(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "map.tif", lambda x, y: 30 + 2 * (y + 45), (0, -55, 20, -35), size=2000)
    fine = values(path, crater(-45, 10))
    monkeypatch.setattr("lunarsci.spectra.origin.mineral_map.LARGEST_SIDE", 60)
    coarse = values(path, crater(-45, 10))
    assert not np.array_equal(fine, coarse)
    assert coarse == pytest.approx(fine, abs=2 * 4 / 60 + 0.05), "the ring is 4 deg high"


def test_holes_edges_and_special_values_are_left_out(tmp_path: Path) -> None:
    def field(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.where(x < 10, 30.0, np.where(y > -45, -9999.0, np.where(x < 10.6, np.nan, -3e38)))

    one = crater(-45, 10)
    found = values(write(tmp_path / "a.tif", field, (0, -55, 20, -35), nodata=-9999.0), one)
    assert np.isfinite(found).mean() == pytest.approx(0.5, abs=0.01)
    assert np.nanmax(found) == np.nanmin(found) == 30
    edge = values(write(tmp_path / "b.tif", even(30), (10, -55, 20, -35)), one)
    assert np.isfinite(edge).mean() == pytest.approx(0.5, abs=0.01)


def maps(folder: Path, **fields: float) -> dict[str, str]:
    return {name: write(folder / f"{name}.tif", even(v), (0, -55, 20, -35), size=400) for name, v in fields.items()}


def test_modes_of_the_maps_replace_those_of_the_catalogue(tmp_path: Path) -> None:
    before = Composition({"olivine": (0.5, 0.1), "plagioclase": (0.5, 0.1)}, {"bc1000_nm": (930, 5)})
    inside = Crater(name="in", latitude_deg=-45, longitude_deg=10, diameter_km=60, composition=before)
    outside = Crater(name="out", latitude_deg=45, longitude_deg=10, diameter_km=60, composition=before)
    for scale in (1.0, 0.01):
        files = maps(tmp_path, olivine=8 * scale, plagioclase=62 * scale, orthopyroxene=30 * scale)
        (found, kept), reports = with_maps([inside, outside], files)
        assert {name: value for name, (value, _) in found.composition.modes.items()} == pytest.approx(
            {"olivine": 0.08, "plagioclase": 0.62, "orthopyroxene": 0.30}
        )
        assert found.composition.bands == before.bands
        assert "olivine.tif" in found.sources["composition"]
        assert kept == outside
        assert "100 % of its ring covered" in reports[0].status
        assert "no values in its ring" in reports[1].status


def test_a_stretched_picture_is_refused_and_a_scaled_one_is_not(tmp_path: Path) -> None:
    plain = write(tmp_path / "p.tif", even(128), (0, -55, 20, -35), dtype="uint8")
    good = maps(tmp_path, plagioclase=60)
    with pytest.raises(DataError, match="8-bit numbers without a scale"):
        with_maps([crater(-45, 10)], {"olivine": plain, **good})
    with rasterio.open(plain, "r+") as file:
        file.scales, file.offsets = (0.3,), (1.6,)
    [found], _ = with_maps([crater(-45, 10)], {"olivine": plain, **good})
    assert found.composition.modes["olivine"][0] == pytest.approx(0.40)


def test_unusable_maps_say_why(tmp_path: Path) -> None:
    good = maps(tmp_path, plagioclase=60)
    bounds = (0.0, -55.0, 20.0, -35.0)
    text = tmp_path / "text.tif"
    text.write_text("no map")
    cases = {
        str(text): "cannot be read",
        str(tmp_path / "missing.tif"): "no such file",
        write(tmp_path / "high.tif", even(5000), bounds): "a mode is 0 to 1, or 0 to 100 percent",
        write(tmp_path / "share.tif", even(0.3), bounds): "some are in percent, others in fractions",
        write(tmp_path / "metres.tif", even(3), (0, 0, 9e5, 9e5), None): "has no coordinate system",
    }
    for file, said in cases.items():
        with pytest.raises(DataError, match=said):
            with_maps([crater(-45, 10)], {"olivine": file, **good})
    with rasterio.open(tmp_path / "two.tif", "w", driver="GTiff", width=2, height=2, count=2, dtype="float32") as file:
        file.write(np.ones((2, 2, 2), "float32"))
    with pytest.raises(DataError, match="has 2 bands"):
        with_maps([crater(-45, 10)], {"olivine": str(tmp_path / "two.tif"), **good})


def test_requests_that_cannot_be_met(tmp_path: Path) -> None:
    files = maps(tmp_path, olivine=10, plagioclase=60)
    for wrong, ring, said in (
        ({"olivine": files["olivine"]}, (1.0, 2.0), "give two or more"),
        ({"ilmenite": "x", **files}, (1.0, 2.0), "maps of ilmenite"),
        (files, (2.0, 1.0), "end of the ring is 1; give a number above 2"),
    ):
        with pytest.raises(ParameterError, match=said):
            with_maps([crater(-45, 10)], wrong, ring)


def test_an_empty_window_keeps_the_catalogue_and_no_map_is_needed_without_one(tmp_path: Path) -> None:
    hole = write(tmp_path / "hole.tif", even(np.nan), (0, -55, 20, -35))
    other = write(tmp_path / "other.tif", even(np.nan), (0, -55, 20, -35))
    [found], [report] = with_maps([crater(-45, 10)], {"olivine": hole, "plagioclase": other})
    assert not found.composition.comparable
    assert report.covered == {"olivine": 0.0, "plagioclase": 0.0}


def test_without_rasterio_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = maps(tmp_path, olivine=10, plagioclase=60)
    monkeypatch.setitem(sys.modules, "rasterio", None)
    with pytest.raises(ParameterError, match=r"lunarsci\[cubes\]"):
        with_maps([crater(-45, 10)], files)


@pytest.mark.parametrize("to_edge", [0.5, -0.5])
@pytest.mark.parametrize("side", range(4))
def test_bounds_are_degrees_where_the_moon_has_such_places(side: int, to_edge: float) -> None:
    """From -180 to 360 deg and from pole to pole, to a degree beyond at each side."""
    bounds = np.array([-181.0, -91.0, 361.0, 91.0])
    inward = np.array([1.0, 1.0, -1.0, -1.0])
    bounds += 5.0 * inward * (np.arange(4) != side) + to_edge * inward * (np.arange(4) == side)
    dataset: Any = SimpleNamespace(bounds=tuple(bounds))
    assert _looks_like_degrees(dataset) == (to_edge > 0)
