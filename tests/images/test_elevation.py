"""Merged maps against the ground that models were made of, with offsets and shifts that are not told."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from stamped_ground import FINE, NAVCAM, fractal, with_track

from lunarsci.errors import DataError, ParameterError
from lunarsci.images.elevation import (
    ElevationModel,
    StationPosition,
    elevation_bytes,
    elevation_geotiff,
    merge,
    read_elevation,
)
from lunarsci.images.jobs.merge import MergedStations, read_positions
from lunarsci.io.inputs import InputFile
from lunarsci.regolith.soil import read_soil
from lunarsci.twin.ground.terrain import read_terrain

SPACING = 0.02


def stations(
    rng: np.random.Generator, sigmas: tuple[float, ...], common: float, shift: float
) -> tuple[np.ndarray, list[ElevationModel], np.ndarray, np.ndarray]:
    """Truth, models of it with overlapping parts, and what each is really off by in height and place."""
    step = round(SPACING / FINE)
    fine = fractal(rng, (400, 800), 6.0) * 1.5
    truth = fine[::step, ::step]
    models, offsets, moves = [], [], []
    for k, sigma in enumerate(sigmas):
        offset, move = rng.normal(0.0, common), rng.normal(0.0, shift, 2)
        rows, columns = (np.arange(n) * SPACING for n in truth.shape)
        from scipy.interpolate import RegularGridInterpolator

        field = RegularGridInterpolator((np.arange(400) * FINE, np.arange(800) * FINE), fine, bounds_error=False)
        # A model that lies `move` too far along x, y shows at x the ground of x - move.
        at = np.meshgrid(rows - move[1], columns - move[0], indexing="ij")
        height = field(np.stack(at, axis=-1)) + offset + rng.normal(0.0, sigma, truth.shape)
        height[:, : 40 * k] = np.nan
        height[:, 120 + 40 * k :] = np.nan
        models.append(
            ElevationModel(
                name=str(k),
                x0_m=0.0,
                y0_m=0.0,
                spacing_m=SPACING,
                height_m=height,
                height_m_sigma=np.array(sigma),
                height_m_common_sigma=np.array(common),
                synthetic=True,
            )
        )
        offsets.append(offset)
        moves.append(move)
    return truth, models, np.array(offsets), np.array(moves)


def test_errors_hold_and_shrink() -> None:
    z_common, z_random = [], []
    for seed in range(14):
        truth, models, _, _ = stations(np.random.default_rng(seed), (0.004, 0.002), 0.01, 0.0)
        found = merge(models).model
        both = found.layer("count") == 2
        off = (found.height_m - truth)[both]
        assert found.layer("height_m_sigma")[both] == pytest.approx((0.004**-2 + 0.002**-2) ** -0.5, rel=0.15)
        z_common.append(off.mean() / found.layer("height_m_common_sigma")[both].mean())
        z_random.append((off - off.mean()).std() / np.median(found.layer("height_m_sigma")[both]))
    # Fourteen draws of an error that all nodes share tell its size to 19 %.
    assert np.sqrt(np.mean(np.square(z_common))) == pytest.approx(1.0, abs=0.45)
    assert np.mean(z_random) == pytest.approx(1.0, abs=0.05)


def test_differences_of_offsets_and_places_are_found_with_their_errors() -> None:
    z = []
    for seed in range(6):
        place = StationPosition(covariance_m2=np.diag([0.02**2, 0.02**2, 0.0]))
        _, models, offsets, moves = stations(np.random.default_rng(300 + seed), (0.003, 0.003, 0.003), 0.02, 0.02)
        found = merge(models, [place] * 3)
        real = np.column_stack([offsets / 0.02, moves])
        step = np.zeros((3, 9))
        for column in range(3):
            step[column, [column, 3 + column]] = -1.0, 1.0
        off = step @ (found.corrections - real).ravel()
        z.append(off / np.sqrt(np.diag(step @ found.covariance @ step.T)))
        assert np.abs(off[1:]).max() < 0.01, "of shifts of 28 mm"
    assert np.sqrt(np.mean(np.square(z))) < 1.6


def test_a_stone_moved_between_stations_is_shown(answered: Callable[..., str]) -> None:
    _, models, _, _ = stations(np.random.default_rng(5), (0.002, 0.002), 0.005, 0.0)
    models[1].height_m[50:55, 80:85] += 0.05
    found = merge(models)
    told = answered(MergedStations(names=("a", "b"), models=tuple(models), merged=found, inputs={}))
    assert "Heights of 2 stations are one grid now, a node every " in told
    assert f"they differ by {found.overlaps[0].rms_z:.2g} times their errors" in told
    inside = np.abs(found.z_score[50:55, 80:85])
    assert np.nanmin(inside) > 5
    assert np.nanpercentile(np.abs(found.z_score), 95) < 3
    assert np.abs(found.corrections[:, 0] - found.corrections[:, 0].mean()).max() < 4


def test_refusals() -> None:
    _, models, _, _ = stations(np.random.default_rng(6), (0.002, 0.002), 0.005, 0.0)
    with pytest.raises(ParameterError, match="two or more"):
        merge(models[:1])
    with pytest.raises(ParameterError, match="nothing to compare"):
        far = StationPosition(x_m=50.0, covariance_m2=np.zeros((3, 3)))
        merge(models, [StationPosition(), far])
    with pytest.raises(ParameterError, match="height_m_sigma"):
        merge([models[0], ElevationModel(name="b", x0_m=0, y0_m=0, spacing_m=1, height_m=np.zeros((3, 3)))])


@pytest.mark.parametrize(
    ("table", "why"),
    [
        ("x_m,z_m,sigma_m\n0,0,1\n1,0,1\n", "no column y_m; there are: x_m, z_m, sigma_m"),
        ("x_m,y_m,sigma_m\n0,0,1\n", "1 rows for 2 elevation models"),
        ("x_m,y_m\n0,0\n1,1\n", "no errors of the positions"),
        ("x_m,y_m,sigma_m\n0,0,1\n1,,1\n", "row 2: a position"),
    ],
)
def test_positions_that_are_none(table: str, why: str) -> None:
    with pytest.raises(DataError, match=why):
        read_positions(InputFile("p.csv", table.encode()), 2)


def test_files_come_back_and_are_terrain_too(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    model = with_track(rng, 0.005).seen(rng, NAVCAM, (-1.8, 1.2, 1.5))
    for name, content in (("a.npz", elevation_bytes(model)), ("a.tif", elevation_geotiff(model))):
        (tmp_path / name).write_bytes(content)
        back = read_elevation(tmp_path / name)
        assert back.synthetic
        for key in ("height_m", "height_m_sigma", "height_by_disparity_m_px", "resolution_m"):
            np.testing.assert_allclose(back.layer(key), model.layer(key), rtol=1e-6, atol=1e-7)
        terrain = read_terrain(tmp_path / name, read_soil("longji"))
        np.testing.assert_allclose(terrain.height_m, model.height_m, rtol=1e-6, atol=1e-7)
        assert (terrain.x0_m, terrain.y0_m, terrain.spacing_m) == pytest.approx((0.0, 0.0, 0.01), abs=1e-9)


def test_heights_between_nodes() -> None:
    height = np.add.outer(2.0 * np.arange(4), 3.0 * np.arange(5))
    model = ElevationModel(name="plane", x0_m=1.0, y0_m=-1.0, spacing_m=0.5, height_m=height)
    assert model.at("height_m", [1.0, 1.25, 3.0], [-1.0, -0.75, 0.5]) == pytest.approx([0.0, 2.5, 18.0])
    assert np.isnan(model.at("height_m", [0.9], [0.0])).all()
    layers = model.layers()
    assert (
        list(layers) == ["y_m", "x_m", "height_m", "resolution_m"]
        and layers["x_m"][1][-1] == 3.0
        and layers["y_m"][1][-1] == 0.5
    )
    assert layers["height_m"][0] == ("y_m", "x_m") and layers["height_m"][1][1, 2] == 8.0
    assert FINE < 0.01
