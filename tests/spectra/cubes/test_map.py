"""Maps of cubes: every pixel is what the single command measures there, in both formats, with flags and places."""

import base64
import json
import re
import shlex
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lunarsci.cli import main

import lunarsci
from lunarsci.errors import DataError, OutputError, ParameterError, RequestError
from lunarsci.guide.info import info
from lunarsci.pages.answers import answer
from lunarsci.pages.documents import Document
from lunarsci.spectra.jobs.bands import bands
from lunarsci.spectra.jobs.fit import fit
from lunarsci.spectra.jobs.indices import indices
from lunarsci.spectra.jobs.map_cube import map_cube, pixel
from lunarsci.spectra.origin.catalogue import Crater
from lunarsci.spectra.origin.mineral_map import minerals_of, with_maps
from lunarsci.spectra.readers.dispatch import read_spectra

from .conftest import WAVELENGTHS, spectra
from .test_rasters import CUBE as ENVI_CUBE
from .test_rasters import backplane, m3, tiff

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
    result = map_cube(str(path), out, products="bands,indices,fit", assemblage="OPX-CPX", neighbours=False)
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
        known = indices(spectrum).to_dict()["spectra"][0]
        for key in ("ibd1000", "ibd2000", "r540", "olivine_index", "omat", "feo_lucey_wt", "slope1000_per_um"):
            for part, layer in (("value", key), ("sigma", f"{key}_sigma")):
                wanted = np.nan if known[key][part] is None else known[key][part]
                np.testing.assert_allclose(float(own[layer]), wanted, rtol=1e-9)
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


NAMES = [f"{w:.2f} nm" for w in WAVELENGTHS]


def test_both_formats_hold_the_same_where_the_cube_lies(tmp_path: Path) -> None:
    """GDAL, which did not write the NetCDF, finds the same numbers at the same place in both."""
    from rasterio.transform import from_origin

    cube = tiff(tmp_path / "cube.tif", CUBE, names=NAMES, transform=from_origin(30, 20, 0.01, 0.02))
    made = [map_cube(str(cube), tmp_path / f"map.{end}", products="bands", roi="1:5,2:6") for end in ("nc", "tif")]
    found = opened(tmp_path / "map.nc")
    for one in (each.to_xarray() for each in made):
        np.testing.assert_array_equal(one["bc1000_nm"], found["bc1000_nm"])
        assert one["line"].values.tolist() == [2, 3, 4, 5] and one["bc1000_nm"].attrs["units"] == "nm"
    with rasterio.open(tmp_path / "map.tif") as file:
        assert tuple(file.transform)[:6] == pytest.approx((0.01, 0, 30.01, 0, -0.02, 19.96))
        assert file.crs.to_dict()["R"] == 1737400
        assert (file.count, np.isnan(file.nodata)) == (len(file.descriptions), True)
        for band, name in enumerate(file.descriptions, 1):
            told, values = file.tags(band), found[name].values.astype(float)
            np.testing.assert_array_equal(file.read(band), np.where(values == -1, np.nan, values))
            assert told["long_name"] == found[name].attrs["long_name"]
            assert (file.units[band - 1] or "1") == found[name].attrs.get("units", "1")
        assert json.loads(file.tags()["provenance"])["options"]["roi"] == "1:5,2:6"
        grid = file.transform, file.crs.to_dict()
    with rasterio.open(f'netcdf:"{tmp_path / "map.nc"}":bc1000_nm', driver="netCDF") as file:
        assert tuple(file.transform)[:6] == pytest.approx(tuple(grid[0])[:6])
        assert file.crs.to_dict() == grid[1]
        np.testing.assert_array_equal(file.read(1), found["bc1000_nm"].values)
    assert found["x"].attrs["standard_name"] == "longitude"
    np.testing.assert_allclose(found["y"], 19.96 - 0.02 * (np.arange(4) + 0.5))
    assert found["bc1000_nm"].attrs["units"] == "nm"
    assert found["pixel_flags"].attrs["flag_meanings"].split()[0] == "no_data"
    np.testing.assert_array_equal(found["pixel_flags"].attrs["flag_masks"], [1, 2, 4, 8, 16])
    assert found.attrs["Conventions"].startswith("CF-1.")
    assert found["cube_line"].values.tolist() == [2, 3, 4, 5]


def test_a_rotated_frame_and_a_swath_have_places_of_their_own(tmp_path: Path) -> None:
    rotated = tiff(tmp_path / "rotated.tif", CUBE, names=NAMES)
    map_cube(str(rotated), tmp_path / "rotated.nc", products="bands", roi="0:3,0:2")
    found = opened(tmp_path / "rotated.nc")
    line, sample = np.mgrid[:2, :3] + 0.5
    np.testing.assert_allclose(found["longitude"], 30 + 0.01 * sample + 0.002 * line)
    np.testing.assert_allclose(found["latitude"], 20 + 0.001 * sample - 0.01 * line)
    path = m3(tmp_path)
    places = np.stack([30 + 0.1 * np.arange(30).reshape(6, 5), np.full((6, 5), 20.0), np.full((6, 5), 1737400.0)], 2)
    backplane(tmp_path, "LOC", places, "<f8")
    map_cube(str(path), tmp_path / "swath.nc", products="bands", every=2)
    found = opened(tmp_path / "swath.nc")
    np.testing.assert_allclose(found["longitude"], places[::2, ::2, 0])
    assert found["bd1000"].encoding["coordinates"] == "longitude latitude"


def test_a_cube_of_shares_gives_craters_their_modes(tmp_path: Path) -> None:
    """Layers as `--products unmix` writes them, of a frame, a swath and a GeoTIFF: the ring has what was put there."""
    import h5netcdf

    line, sample = np.mgrid[:200, :200]
    latitude, longitude = 5 - 0.05 * (line + 0.5), 10 + 0.05 * (sample + 0.5)
    shares = {"olivine": np.full((200, 200), 0.25), "plagioclase": np.where(longitude < 15, 0.5, 0.7)}
    with h5netcdf.File(tmp_path / "swath.nc", "w") as file:
        file.dimensions = {"line": 200, "sample": 200}
        planes = {"latitude": latitude, "longitude": longitude % 360}
        for name, values in (planes | {f"share_{key}": value for key, value in shares.items()}).items():
            file.create_variable(name, ("line", "sample"), data=values)
    from rasterio.transform import from_origin

    both = np.stack([line, shares["olivine"], shares["plagioclase"]], 2).astype("f8")
    names = ["other", "share_olivine", "share_plagioclase"]
    tiff(tmp_path / "grid.tif", both, names=names, transform=from_origin(10, 5, 0.05, 0.05))
    for file in ("swath.nc", "grid.tif"):
        path = str(tmp_path / file)
        assert minerals_of(path) == ["olivine", "plagioclase"]
        crater = Crater(name="Made up", latitude_deg=0.0, longitude_deg=15.0, diameter_km=60.0)
        [found], [report] = with_maps([crater], dict.fromkeys(minerals_of(path), path))
        assert found.composition.modes["olivine"][0] == pytest.approx(0.25)
        assert found.composition.modes["plagioclase"][0] == pytest.approx(0.6, abs=0.01)
        assert min(report.covered.values()) == 1.0
        elsewhere = Crater(name="Elsewhere", latitude_deg=0.0, longitude_deg=40.0, diameter_km=60.0)
        _, [away] = with_maps([elsewhere], dict.fromkeys(minerals_of(path), path))
        assert max(away.covered.values()) == 0.0


def test_the_same_bytes_however_it_is_computed_and_after_a_stop(envi: Any, tmp_path: Path) -> None:
    import lunarsci.spectra.jobs.map_cube as job
    from lunarsci.parallel.blocks import computing

    cube = str(envi(spectra(70, 2, seed=8).astype("f4")))
    plan: dict[str, Any] = {"products": "bands", "time": False}
    map_cube(cube, tmp_path / "whole.nc", **plan)
    with computing(workers=1):
        map_cube(cube, tmp_path / "parts.nc", **plan)
    wanted = (tmp_path / "whole.nc").read_bytes()
    assert (tmp_path / "parts.nc").read_bytes() == wanted

    told: list[int] = []

    def stop(done: int, total: int) -> None:
        told.append(done)
        if len(told) == 3:  # none, the first block, which is saved by now, and the second one
            raise KeyboardInterrupt

    target = tmp_path / "stopped.nc"
    with pytest.raises(KeyboardInterrupt), computing(keep=target):
        map_cube(cube, target, **plan, progress=stop)
    assert not target.exists()
    assert list(tmp_path.glob("stopped.nc.partial*"))
    with computing(keep=target):
        map_cube(cube, target, **plan)
    assert target.read_bytes() == wanted
    assert not list(tmp_path.glob("stopped.nc.partial*"))
    assert job.ROWS == 32


def test_what_cannot_be_mapped(envi: Any, tmp_path: Path) -> None:
    cube = str(envi(CUBE))
    for options, said in (
        ({"products": "bands,gold"}, "`products` gold"),
        ({"products": " , "}, "`products` is empty"),
        ({"scale": 0.0}, "`scale` is 0"),
        ({"every": 0}, "`every` is 0"),
    ):
        with pytest.raises(RequestError, match=said):
            map_cube(cube, tmp_path / "map.nc", **options)
    with pytest.raises(RequestError, match=r"ends in .nc"):
        map_cube(cube, tmp_path / "map.png")
    (tmp_path / "there.nc").write_bytes(b"")
    with pytest.raises(OutputError, match="exists already"):
        map_cube(cube, tmp_path / "there.nc", products="bands")
    for place, said in (("5,0", "samples 0 to 4"), ("0,6", "lines 0 to 5"), ("here", "give sample and line")):
        with pytest.raises(RequestError, match=said):
            pixel(cube, place)
    with pytest.raises(DataError, match="no such file"):
        map_cube(str(tmp_path / "none.img"), tmp_path / "map.nc")


def test_names_of_where_a_minimum_was_found_are_those_of_the_fit() -> None:
    from lunarsci.spectra.jobs.map_products import ORIGINS
    from lunarsci.spectra.jobs.requests import ROWS
    from lunarsci.spectra.mgm import region

    assert (ORIGINS, ROWS) == (region.ORIGINS, region.TILE)


def test_a_map_of_nothing_says_so(envi: Any, tmp_path: Path) -> None:
    result = map_cube(
        str(envi(np.full((4, 4, 85), -999.0), data_ignore_value=-999)), tmp_path / "map.nc", products="bands"
    )
    assert "no pixel" in result.untrusted


def test_a_cube_in_memory_keeps_its_places_and_may_have_its_channels_first() -> None:
    places = {"y": [10.0, 8.0, 6.0, 4.0, 2.0, 0.0], "x": np.arange(5.0)}
    cube = xarray.DataArray(CUBE, dims=("y", "x", "wavelength"), coords={**places, "wavelength": WAVELENGTHS})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        maps = [
            map_cube(one, products=["indices"], every=2)
            for one in (cube, (WAVELENGTHS, CUBE), (WAVELENGTHS, np.moveaxis(CUBE, -1, 0)))
        ]
    first, second, third = (one.to_xarray() for one in maps)
    assert first["y"].values.tolist() == [10.0, 6.0, 2.0] and first["x"].values.tolist() == [0.0, 2.0, 4.0]
    assert {"y", "x"} <= set(first.coords) and "y" not in second
    np.testing.assert_array_equal(second["r540"], third["r540"])
    assert {one.to_dict()["cube"]["file"] for one in maps} == {"cube.nc"} and maps[0].request.products == "indices"
    with pytest.raises(ParameterError, match="reflectances of 6 x 5 x 85 beside 4 wavelengths; give"):
        map_cube((WAVELENGTHS[:4], CUBE))


def test_a_map_with_too_few_channels_for_a_fit_says_so_as_the_fit_of_a_spectrum_does() -> None:
    few = WAVELENGTHS[::3], CUBE[..., ::3]
    with pytest.raises(DataError, match="; 40 are needed") as caught:
        fit((few[0], few[1][0, 0]))
    reason = str(caught.value).partition("no result: ")[2]
    assert map_cube(few, products="fit").untrusted == f"not to be trusted: no pixel has a value of fit; {reason}"


def test_a_map_of_soil_alone_says_why_it_has_no_shares_and_one_of_rock_has_all_four(envi: Any, tmp_path: Path) -> None:
    how: dict[str, Any] = {"path": tmp_path / "map.nc", "products": "indices,unmix", "every": 2, "force": True}
    soil = map_cube(str(envi(CUBE)), kind="weathered-soil", **how)
    assert soil.untrusted.startswith("not to be trusted: no pixel has a value of unmix; kind weathered_soil in 9 of 9")
    assert "composition of the soil in one pixel" in soil.untrusted
    rock = map_cube(str(envi(CUBE)), kind="powder-mixture", **how)
    assert not rock.untrusted
    page = Document("", rock.schema, rock.to_dict(), {})
    for mineral in ("Medians of shares, and of their 95 % intervals: olivine", ", orthopyroxene", ", plagioclase"):
        assert re.search(rf"{mineral} \d+ % \(\d+ % to \d+ %\)", answer(page).text)


@pytest.mark.slow
def test_shares_and_matches_of_pixels_are_those_of_the_single_commands(envi: Any, tmp_path: Path) -> None:
    from lunarsci.spectra.jobs.match import match
    from lunarsci.spectra.jobs.unmix import unmix

    craters = tmp_path / "craters.csv"
    craters.write_text(
        "name,latitude_deg,longitude_deg,diameter_km,orthopyroxene,orthopyroxene_sigma,clinopyroxene,"
        "clinopyroxene_sigma,bc1000_nm,bc1000_sigma_nm\nRed,-44,177,60,0.6,0.05,0.2,0.05,940,10\n"
        "Blue,-46,178,60,0.1,0.05,0.6,0.05,1010,10\n"
    )
    cube = str(envi(spectra(2, 2, seed=5).astype("f4")))
    how: dict[str, Any] = {"assemblage": "OL-OPX-CPX-PLG"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        map_cube(cube, tmp_path / "map.nc", products="unmix,match", craters=str(craters), **how)
        found = opened(tmp_path / "map.nc").isel(line=1, sample=0)
        row = pixel(cube, "0,1")
        spectrum = row.cube.wavelength_nm, row.reflectance
        shares = unmix([spectrum]).to_dict()["spectra"][0]["abundance"]
        results = [bands([spectrum]), fit([spectrum], **how)]
        matched = match(results, craters=str(craters), site="-45.44,177.56").to_dict()["rocks"][0]
    for mineral in ("olivine", "orthopyroxene", "clinopyroxene", "plagioclase"):
        for key, layer in (("fraction", ""), ("low", "_low"), ("high", "_high")):
            wanted = np.nan if shares[mineral][key] is None else shares[mineral][key]
            np.testing.assert_allclose(float(found[f"share_{mineral}{layer}"]), wanted, rtol=1e-9)
    for crater in matched["craters"]:
        layer = f"ln_bayes_factor_{crater['name'].lower()}"
        np.testing.assert_allclose(float(found[layer]), crater["log_bayes_factor"], rtol=1e-9)


@pytest.mark.slow
def test_shares_of_named_minerals_by_both_methods_are_those_of_the_single_command(envi: Any, tmp_path: Path) -> None:
    from lunarsci.spectra.jobs.unmix import unmix

    cube = str(envi(spectra(1, 2, seed=5).astype("f4")))
    how: dict[str, Any] = {"kind": "powder-mixture", "assemblage": "OL-OPX"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        made = map_cube(cube, tmp_path / "map.nc", products="unmix", both=True, **how)
        found = opened(tmp_path / "map.nc").isel(line=0, sample=1)
        row = pixel(cube, "1,0")
        spectrum = row.cube.wavelength_nm, row.reflectance
        shares = unmix([spectrum], **how).to_dict()["spectra"][0]["abundance"]
    assert made.to_dict()["unmix"] == {"method": "learned", "both": True, "minerals": ["olivine", "orthopyroxene"]}
    assert "share_plagioclase" not in found
    assert "method: learned" in found["share_olivine"].attrs["long_name"]
    for mineral in ("olivine", "orthopyroxene"):
        for key, layer in (("fraction", ""), ("low", "_low"), ("high", "_high")):
            np.testing.assert_allclose(float(found[f"share_{mineral}_both{layer}"]), shares[mineral][key], rtol=1e-9)
    assert float(found["share_olivine"]) != float(found["share_olivine_both"])


def test_a_quick_look_has_a_scale_kilometres_and_north(tmp_path: Path) -> None:
    """2.5 pixels of 0.1 degrees are 7.6 km of the Moon's equator; north is up where lines go south."""
    from rasterio.transform import from_origin

    cube = tiff(tmp_path / "cube.tif", CUBE, names=NAMES, transform=from_origin(0, 0.3, 0.1, 0.1))
    page = map_cube(str(cube), tmp_path / "map.nc", products="bands").plot()
    panel = page.axes[0]
    assert panel.get_xlabel() == "along the lines [km]"
    assert panel.get_images()[0].get_extent()[1] == pytest.approx(5 * 0.1 * np.pi / 180 * 1737.4, rel=1e-3)
    arrow = next(item for item in panel.texts if item.arrow_patch is not None)
    assert arrow.xy[0] == pytest.approx(arrow.xyann[0])
    assert arrow.xy[1] > arrow.xyann[1]
    assert any("bc1000_nm" in one.get_title() for one in page.axes)


def test_info_tells_a_map_from_a_cube(envi: Any, tmp_path: Path) -> None:
    cube, command = envi(CUBE), "lunarsci spectra match --mineral-map"
    whole = info(cube.with_suffix(".hdr")).contents
    assert (whole["lines"], whole["samples"], whole["bands"]) == CUBE.shape
    for products, name, commands in (("unmix", "a.nc", [command]), ("indices", "b.tif", [])):
        map_cube(str(cube), tmp_path / name, products=products, kind="powder-mixture")
        told = info(tmp_path / name)
        assert (told.kind, told.commands) == ("map", commands)


def test_shares_are_drawn_first_on_one_scale_and_hatched_out_of_domain() -> None:
    made = map_cube((WAVELENGTHS, CUBE), products="bands,unmix", kind="powder-mixture")
    outside = made.codes["shares_in_domain"]["out_of_domain"]
    page = made.plot()
    panels = [one for one in page.axes if one.get_title().startswith("share_")]
    assert outside and f"hatched: out of domain, {outside} of 30 pixels" in " ".join(page.get_suptitle().split())
    assert len(panels) == 8 and panels[0] is page.axes[1] and "95 %" in panels[1].get_title()
    assert {one.get_images()[0].get_clim() for one in panels} == {(0.0, 1.0)}
    assert {len(one.get_images()) for one in panels} == {2}
    width = made.layers()["share_olivine_high95"][1] - made.layers()["share_olivine_low95"][1]
    np.testing.assert_allclose(panels[1].get_images()[0].get_array(), width)


pytest.importorskip("rasterio")
pytest.importorskip("h5netcdf")
DOCS = Path(__file__).parents[3] / "docs/howto/cubes.md"


def test_the_script_of_the_documents_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any) -> None:
    """On a made-up cube of M3's name and layout, six lines long."""
    m3(tmp_path)
    monkeypatch.chdir(tmp_path)
    (script,) = re.findall(r"```sh\n(.*?)```", DOCS.read_text("utf-8"), re.DOTALL)
    smaller = {"0:304,5000:6000": "0:3,1:4", "120,5400": "1,2"}
    for shown, used in smaller.items():
        assert shown in script
        script = script.replace(shown, used)
    for line in script.splitlines():
        assert main([*shlex.split(line)[1:], "-q"]) == 0, capfd.readouterr().err
    assert {"map.nc", "map.png", "pixel.csv"} <= {path.name for path in tmp_path.iterdir()}
    assert not list(tmp_path.glob("*.partial*"))


def test_a_map_without_a_name_for_its_file_is_told_so(capfd: Any) -> None:
    assert main(["spectra", "map", "cube.img"]) == 2
    assert "--output: a map is a file; give a name that ends in .nc" in capfd.readouterr().err


def test_json_says_what_was_mapped_and_the_file_is_named(tmp_path: Path, capfd: Any) -> None:
    path, out = m3(tmp_path), tmp_path / "map.tif"
    assert main(["spectra", "map", str(path), "-o", str(out), "--products", "bands", "--every", "2", "--json"]) == 0
    told = capfd.readouterr()
    assert f"written: {out}" in told.err
    document = json.loads(told.out)
    assert document["schema"] == "lunarsci/spectra-map/1"
    found = document["result"]
    assert (found["cube"]["format"], found["cube"]["bad_channels"]) == ("m3", 2)
    assert (found["map"]["lines"], found["map"]["samples"], found["pixels"]["pixels"]) == (3, 3, 9)
    assert {"bc1000_nm", "bc1000_sigma_nm", "pixel_flags"} <= {layer["name"] for layer in found["layers"]}
    (tmp_path / "map.json").write_text(told.out)
    assert main(["report", str(tmp_path / "map.json")]) == 0
    said = capfd.readouterr().out
    assert re.search(r"Of 9 pixels \d could be used\. Centre of the 1000 nm band: median 9\d\d nm, ", said), said
    assert "standard error" not in said
    assert main(["spectra", "map", str(path), "--spectrum", "1,2", "--json", "-q"]) == 0
    (tmp_path / "pixel.json").write_text(capfd.readouterr().out)
    assert main(["report", str(tmp_path / "pixel.json")]) == 0
    assert re.search(r"The spectrum of .*, \d+ of \d+ channels", capfd.readouterr().out)


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (["--products", "gold", "-o", "map.nc"], 2, "--products gold"),
        (["-o", "map.png"], 2, "ends in .nc"),
        ([], 2, "ends in .nc"),
        (["--roi", "0:99,0:2", "-o", "map.nc"], 2, "--roi"),
        (["--spectrum", "9,9"], 2, "--spectrum 9,9"),
        (["--mask", "none.tif", "-o", "map.nc"], 1, "no such file"),
        (["-o", "no/folder/map.nc"], 1, "no folder"),
    ],
)
def test_what_is_wrong_is_one_line_and_nothing_is_written(
    options: list[str], code: int, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    path = m3(tmp_path, ENVI_CUBE)
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    assert main(["spectra", "map", path.name, *options]) == code
    told = capfd.readouterr()
    assert told.out == ""
    assert said in told.err
    assert len(told.err.strip().splitlines()) == 1
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("suffix", [".nc", ".tif"])
def test_a_page_has_the_picture_of_a_map_that_is_still_there(
    suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    """From the map file, as --plot draws it; none of a file that is another map, or is none any more."""
    monkeypatch.chdir(tmp_path)
    cube, name = m3(tmp_path), f"map{suffix}"

    def mapped(*options: str) -> str:
        assert main(["spectra", "map", str(cube), "-o", name, "--products", "bands", "--json", *options]) == 0
        return str(capfd.readouterr().out)

    def pictures(place: Path) -> list[str]:
        html = lunarsci.report(place / "map.json").html().decode()
        return re.findall(r"data:image/png;base64,([\w+/=]+)", html)

    (tmp_path / "map.json").write_text(mapped("--plot", "map.png"))
    plotted = [base64.b64encode((tmp_path / "map.png").read_bytes()).decode()]
    assert pictures(tmp_path) == plotted
    moved = tmp_path / "moved"
    moved.mkdir()
    for file in (name, "map.json"):
        (tmp_path / file).rename(moved / file)
    assert pictures(moved) == plotted
    mapped("--force", "--roi", "0:3,0:4")
    (moved / name).write_bytes(b"no map")
    assert pictures(moved) == []
    (moved / name).unlink()
    assert pictures(moved) == []
