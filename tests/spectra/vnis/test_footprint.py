"""The footprint's statistics against an obvious loop over its pixels."""

import math
import statistics
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from lunarsci.spectra.vnis.footprint import (
    Footprint,
    average_footprint,
    registration_error,
    saturated_pixels,
    shadow_limit_shift,
)

SHADOW_BAND, FIRST_OVERLAP = 3, 90
"""465 nm and 900 nm, from 450 nm in steps of 5."""
LIMIT = 0.004
PIXELS = [256 * y + x for y in range(256) for x in range(256) if (y - 127) ** 2 + (x - 97) ** 2 <= 53.8**2]


@dataclass
class Expected:
    """What a loop finds; lists have one value per band."""

    shadowed: set[int]
    invalid: set[int]
    mean: list[float]
    scatter: list[float]
    count: list[int]
    clipped: list[int]
    negative: list[int]
    constant: list[bool]
    dilution: float


def clipping_level(frame: np.ndarray) -> tuple[float, bool]:
    """The value from which a frame is clipped, and whether it is of one value."""
    known = frame[np.isfinite(frame)]
    largest, count = (float(known.max()), int((known == known.max()).sum())) if known.size else (0.0, 0)
    if count == known.size:
        return math.inf, bool(count)
    return (largest if largest > 0 and count >= 20 else math.inf), False


def expected(cube: np.ndarray, limit: float) -> Expected:
    clipped: list[int] = []
    frames = [dict(zip(PIXELS, frame.ravel()[PIXELS].tolist(), strict=True)) for frame in cube]
    dark = {pixel: frames[SHADOW_BAND][pixel] for pixel in PIXELS}
    invalid = {pixel for pixel, value in dark.items() if not math.isfinite(value)}
    shadowed = {pixel for pixel, value in dark.items() if value < limit} - invalid
    bright = [pixel for pixel in PIXELS if pixel not in invalid and pixel not in shadowed]
    levels = [clipping_level(frame) for frame in cube]
    too_many = set()
    for band, (frame, (level, _)) in enumerate(zip(frames, levels, strict=True)):
        over = {pixel for pixel in bright if math.isfinite(level) and frame[pixel] >= level}
        clipped.append(len(over))
        if len(over) > 0.05 * len(bright):
            too_many.add(band)
        else:
            invalid |= over
    lit = [pixel for pixel in bright if pixel not in invalid]
    found = Expected(shadowed, invalid, [], [], [], clipped, [], [flat for _, flat in levels], math.nan)
    ratios = []
    for band, frame in enumerate(frames):
        values = [frame[pixel] for pixel in lit]
        found.negative.append(sum(value <= 0 for value in values))
        good = [value for value in values if math.isfinite(value) and value > 0]
        found.count.append(len(good))
        enough = band not in too_many and len(good) >= max(1, 0.95 * len(lit))
        found.mean.append(math.fsum(good) / len(good) if enough else math.nan)
        found.scatter.append((statistics.stdev(good) if len(good) > 1 else 0.0) if enough else math.nan)
        if band >= FIRST_OVERLAP:
            seen = [frame[pixel] for pixel in PIXELS if pixel not in invalid]
            parts = [[value for value in part if math.isfinite(value)] for part in (seen, values)]
            if all(parts):
                ratios.append(statistics.fmean(parts[0]) / statistics.fmean(parts[1]))
    found.dilution = statistics.median(ratios) if ratios else math.nan
    return found


def assert_same(found: Footprint, wanted: Expected) -> None:
    assert set(np.flatnonzero(found.inside).tolist()) == set(PIXELS)
    assert set(np.flatnonzero(found.shadowed).tolist()) == wanted.shadowed
    assert set(np.flatnonzero(found.invalid).tolist()) == wanted.invalid
    assert found.lit.sum() == len(PIXELS) - len(wanted.shadowed) - len(wanted.invalid)
    assert found.mean == pytest.approx(wanted.mean, rel=1e-12, nan_ok=True)
    assert found.scatter == pytest.approx(wanted.scatter, rel=1e-7, abs=1e-8, nan_ok=True)
    assert found.count.tolist() == wanted.count
    assert found.clipped.tolist() == wanted.clipped
    assert found.negative.tolist() == wanted.negative
    assert found.constant.tolist() == wanted.constant
    assert found.dilution == pytest.approx(wanted.dilution, rel=1e-12, nan_ok=True)


def base(seed: int) -> np.ndarray:
    """Random radiances of 0.01 and 10 % scatter; shape (100, 256, 256)."""
    rng = np.random.default_rng(seed)
    return (0.01 * (1 + 0.1 * rng.standard_normal((100, 256, 256), dtype=np.float32))).astype(np.float32)


def shadow(cube: np.ndarray) -> None:
    cube[:, 60:110, :90] *= np.float32(0.05)


def missing(cube: np.ndarray) -> None:
    cube[:, 130:134, 90:100] = np.nan
    cube[20, 140:150, 90:100] = np.nan
    cube[30, 100:130, 80:110] = np.nan
    cube[7] = np.nan


def missing_in_the_overlap(cube: np.ndarray) -> None:
    shadow(cube)
    cube[93, 130, 97] = np.nan
    cube[95, 120:125, 97] = np.inf
    cube[97] = np.nan


def infinite(cube: np.ndarray) -> None:
    cube[SHADOW_BAND, 130, 97] = np.inf
    cube[30, 130, 97] = np.inf
    cube[31, 131, 97] = -np.inf


def clipped(cube: np.ndarray) -> None:
    np.minimum(cube[40], np.float32(0.012), out=cube[40])  # 2 % of the pixels: lost in all channels
    np.minimum(cube[44], np.float32(0.0122), out=cube[44])
    np.minimum(cube[41], np.float32(0.011), out=cube[41])  # 16 %: the channel is lost
    cube[42, 0, :25] = 1.0  # clipped, but nowhere within the field of view
    cube[43, 127, 80:99] = 1.0  # one pixel too few


def clipped_beside_an_infinite_pixel(cube: np.ndarray) -> None:
    np.minimum(cube[40], np.float32(0.012), out=cube[40])
    cube[40, 0, 0] = np.inf


def negative(cube: np.ndarray) -> None:
    cube[50, 120:125, 90:100] *= -1
    cube[51] *= -1
    cube[52, 127, 97] = 0
    cube[53] = 0


def constant(cube: np.ndarray) -> None:
    cube[10], cube[92], cube[60] = 0.01, 0.02, 0.0
    cube[61] = 0.01
    cube[61, 3, 3] = np.nan


def everything(cube: np.ndarray) -> None:
    for change in (shadow, missing, clipped, negative, constant):
        change(cube)


def nothing(cube: np.ndarray) -> None:
    del cube


CASES: dict[str, Callable[[np.ndarray], None]] = {
    change.__name__: change
    for change in (
        nothing, shadow, missing, missing_in_the_overlap, infinite, clipped, clipped_beside_an_infinite_pixel, negative,
        constant, everything,
    )
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_statistics_are_those_of_a_loop(case: str) -> None:
    cube = base(len(case))
    CASES[case](cube)
    assert_same(average_footprint(cube, LIMIT), expected(cube, LIMIT))


def test_the_cube_is_left_as_it_was() -> None:
    cube = base(1)
    everything(cube)
    before = cube.copy()
    cube.setflags(write=False)
    average_footprint(cube, LIMIT)
    assert np.array_equal(cube, before, equal_nan=True)


def test_nothing_outside_the_field_of_view_counts() -> None:
    cube, rng = base(2), np.random.default_rng(9)
    inside = average_footprint(cube, LIMIT).inside
    other = np.where(inside, cube, rng.uniform(0, 0.01, cube.shape).astype(np.float32))
    first, second = average_footprint(cube, LIMIT), average_footprint(other, LIMIT)
    assert np.array_equal(first.mean, second.mean)
    assert first.dilution == second.dilution == 1


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9])
def test_dilution_is_what_black_shadows_take_away(share: float) -> None:
    """Black ground over a share of the field of view leaves 1 - share of the mean."""
    cube = np.full((100, 256, 256), 0.01, dtype=np.float32)
    cube[:, 0, 0] = 0.02  # so that the frames are neither flat nor clipped
    dark = PIXELS[: round(share * len(PIXELS))]
    cube.reshape(100, -1)[:, dark] = 0
    found = average_footprint(cube, LIMIT)
    assert found.dilution == pytest.approx(1 - len(dark) / len(PIXELS), rel=1e-9)
    assert found.shadowed.sum() == len(dark)
    assert found.mean == pytest.approx(np.full(100, np.float32(0.01), dtype=float), rel=1e-12)
    assert found.scatter == pytest.approx(np.zeros(100), abs=1e-8)
    assert not found.constant.any()


def test_a_pixel_exactly_at_the_limit_is_lit() -> None:
    cube = np.full((100, 256, 256), 0.5, dtype=np.float32)
    cube[:, 127, 97] = 0.25
    assert average_footprint(cube, 0.25).shadowed.sum() == 0
    assert average_footprint(cube, 0.2500001).shadowed.sum() == 1


def test_no_light_at_all_gives_no_statistics() -> None:
    found = average_footprint(np.zeros((100, 256, 256), dtype=np.float32), LIMIT)
    assert found.lit.sum() == 0
    assert np.isnan(found.mean).all()
    assert np.isnan(found.scatter).all()
    assert math.isnan(found.dilution)
    assert (found.count == 0).all()


def test_no_value_at_all_gives_no_statistics() -> None:
    found = average_footprint(np.full((100, 256, 256), np.nan, dtype=np.float32), LIMIT)
    assert found.invalid.sum() == 9085
    assert np.isnan(found.mean).all()
    assert math.isnan(found.dilution)
    assert not found.constant.any()


@pytest.mark.parametrize("change", [nothing, shadow, missing])
def test_the_limit_of_shadows_shifts_by_half_the_way_between_two_limits(change: Callable[[np.ndarray], None]) -> None:
    """Twilight of 0.25 to 1.75 times the limit over a third of the field of view."""
    cube = base(3)
    cube[:, :, 100:151] *= np.linspace(0.1, 0.7, 51).astype(np.float32)
    change(cube)
    found = average_footprint(cube, LIMIT)
    of_mean, of_dilution = shadow_limit_shift(cube, found, LIMIT)
    low, high = (average_footprint(cube, factor * LIMIT) for factor in (0.5, 1.5))
    assert low.lit.sum() > found.lit.sum() > high.lit.sum()
    known = np.isfinite(found.mean)
    assert of_mean[known] == pytest.approx(np.log(high.mean / low.mean)[known] / 2, rel=1e-9)
    assert of_dilution == pytest.approx(math.log(high.dilution / low.dilution) / 2, rel=1e-9)
    assert (of_mean[known] > 0).all()


def test_without_twilight_the_limit_of_shadows_does_not_matter() -> None:
    cube = base(3)
    shadow(cube)
    of_mean, of_dilution = shadow_limit_shift(cube, average_footprint(cube, LIMIT), LIMIT)
    assert (of_mean == 0).all()
    assert of_dilution == 0


def test_a_slope_of_brightness_tells_how_much_a_pixel_of_registration_matters() -> None:
    """Mean 0.01, 1 % more for each sample: 1 % in two of four directions, nothing in the others, 0.71 % rms."""
    cube = np.empty((100, 256, 256), dtype=np.float32)
    cube[:] = 0.01 * (1 + 0.01 * (np.arange(256) - 97))
    assert registration_error(cube, average_footprint(cube, LIMIT)) == pytest.approx(0.01 / math.sqrt(2), rel=1e-4)
    even = np.full((100, 256, 256), 0.01, dtype=np.float32)
    assert registration_error(even, average_footprint(even, LIMIT)) == pytest.approx(0, abs=1e-9)


def test_clipping_is_many_pixels_of_the_largest_value() -> None:
    cube = base(4)
    cube[0].flat[:19] = 0.5
    cube[1].flat[:20] = 0.5
    cube[2] = 0.5
    cube[3] = -1
    cube[3].flat[:40] = 0
    limits, flat = saturated_pixels(cube)
    assert np.isinf(limits[0])
    assert limits[1] == 0.5
    assert np.isinf(limits[2:]).all()
    assert np.flatnonzero(flat).tolist() == [2]
