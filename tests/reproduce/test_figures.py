"""The figures: what must be in them is in them, and names can be read."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from matplotlib.text import Text

from lunarsci.figure import name_points
from lunarsci.regolith.wheel import read_wheel
from lunarsci.reproduce.drive import Drives, drive_pages
from lunarsci.reproduce.numbers import published_value
from lunarsci.reproduce.soil import histograms, soil_numbers, soil_pages
from lunarsci.reproduce.spectra import fit_rocks, spectra_pages
from lunarsci.spectra.spectrum import Spectrum
from lunarsci.spectra.vnis.simulation.scene import Material, SceneComposition, surface_reflectance

WHEEL = read_wheel("yutu2")


@pytest.fixture(scope="module")
def soil() -> list[Figure]:
    return list(soil_pages(WHEEL))


def curves(axes: object) -> Iterator[np.ndarray]:
    for line in axes.get_lines():
        points = np.column_stack([np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)])
        if len(points) > 10 and line.get_linestyle() != "None":
            yield points


def at(points: np.ndarray, x: float) -> float:
    good = np.isfinite(points[:, 1])
    return float(np.interp(x, points[good, 0], points[good, 1]))


def test_published_dots_lie_on_the_curves_that_belong_to_them(soil: list[Figure]) -> None:
    bearing, shear, lateral = soil[0].axes
    at_5, at_8, _, at_15 = curves(bearing)
    assert at(at_5, 0.87) == pytest.approx(1443, rel=0.03)
    assert at(at_8, 1.0) == pytest.approx(1443, rel=1e-3)
    assert at(at_15, 1.0) == pytest.approx(556.7, rel=1e-3)
    skidding, rolling = curves(shear)
    assert at(skidding, 520) == pytest.approx(21.5, abs=0.01)
    assert at(rolling, 3154) == pytest.approx(42.0, abs=0.01)
    steep, slight = curves(lateral)
    assert at(steep, 13) == pytest.approx(8.3, abs=0.01)
    assert at(slight, 40) == pytest.approx(16.5, abs=0.01)


def test_published_regions_are_drawn(soil: list[Figure]) -> None:
    expected = ((0.87, 556.7, 1.0, 1443), (520, 21.5, 3154, 42.0), (13, 8.3, 40, 16.5), (520, 21.5, 3154, 42.0))
    for axes, corners in zip([*soil[0].axes, *soil[1].axes], expected, strict=True):
        [region] = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
        assert region.get_extents().transformed(axes.transData.inverted()).extents == pytest.approx(corners)


def test_histograms_have_the_published_sample_size_and_the_deviations_of_the_table() -> None:
    found = {item.sd_id: item for item in histograms(WHEEL)}
    for number in soil_numbers():
        if number.id in found:
            draws = found[number.id].draws
            assert 1000 < draws.size <= 1024
            assert draws.std(ddof=1) == pytest.approx(number.ours, rel=0.1)
            assert draws.mean() == pytest.approx(published_value(found[number.id].mean_id), rel=0.01)
    assert len(found) == 3


def test_the_published_circle_is_about_the_destination(drives: Drives) -> None:
    fans, slips = drive_pages(drives)
    ends = fans.axes[1], fans.axes[4]
    for axes in ends:
        circles = [patch for patch in axes.patches if isinstance(patch, Circle)]
        assert {round(circle.radius, 3) for circle in circles} >= {0.762}
        for circle in circles:
            assert circle.center == pytest.approx(tuple(drives.stand_in.planned[-1, :2]))
    assert len(slips.axes) == 3


def test_rocks_add_a_page() -> None:
    wavelength = np.arange(450.0, 2396.0, 5.0)
    reflectance = surface_reflectance(wavelength, Material(SceneComposition(0.2, 0.5, 0.3), albedo=0.15))
    noise = np.exp(0.005 * np.random.default_rng(0).standard_normal(wavelength.size))
    rocks = fit_rocks([Spectrum("fin", wavelength, reflectance * noise)])
    plane, fit = spectra_pages(rocks)
    assert "spectra given: 1" in plane.axes[0].get_title()
    assert any("smoothed over 41 points" in axes.get_title() for axes in fit.axes)
    [only] = spectra_pages(None)
    assert "--boulders" in only.axes[0].get_title()


def test_names_keep_off_each_other_and_within_the_panel() -> None:
    figure = Figure(figsize=(8, 6), layout="constrained")
    axes = figure.subplots()
    points = {f"soil number {k}": (1.0 + 0.02 * k, 1.0 + 0.01 * (k % 3)) for k in range(4)} | {"at the edge": (1.99, 1)}
    axes.set(xlim=(0, 2), ylim=(0, 2))
    name_points(figure, {axes: [(name, *point) for name, point in points.items()]})
    figure.draw_without_rendering()
    boxes = [Text.get_window_extent(text) for text in axes.texts]
    assert len(boxes) == len(points)
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
    assert all(box.x1 <= axes.bbox.x1 for box in boxes)
