"""Rocks against those put into made-up ground, of other shapes than those the completeness is tried with."""

import json
from functools import cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from stamped_ground import NAVCAM, PANCAM, with_rocks

from lunarsci.errors import ParameterError, RequestError
from lunarsci.images.elevation import ElevationModel
from lunarsci.images.jobs.requests import RocksRequest
from lunarsci.images.jobs.rocks import RockList
from lunarsci.images.rocks import RockSurvey, find_rocks

CAMERA = (-1.5, 1.5, 1.5)


@cache
def looked_at(
    seed: int, focal: float, sizes_m: tuple[float, ...] = ()
) -> tuple[ElevationModel, RockSurvey, np.ndarray]:
    rng = np.random.default_rng(seed)
    ground, rocks = with_rocks(rng, [0.2] * 2 + [0.1] * 6 + [0.05] * 12)
    model = ground.seen(rng, focal, CAMERA, holes=0.02)
    return model, find_rocks(model, largest_m=0.4, sizes_m=sizes_m), rocks


def hits(model: ElevationModel, survey: RockSurvey, rocks: np.ndarray) -> tuple[dict[float, float], int]:
    """Share of seen rocks that were found, by diameter, and how many finds are none."""
    found = np.array([(rock.x_m, rock.y_m) for rock in survey.rocks]).reshape(-1, 2)
    apart = np.hypot(*(found[:, None] - rocks[:, :2]).transpose(2, 0, 1))
    near = apart <= np.maximum(0.6 * rocks[:, 2], 0.03)
    seen = np.isfinite(model.at("height_m", rocks[:, 0], rocks[:, 1]))
    shares = {size: float(near.any(axis=0)[seen & (rocks[:, 2] == size)].mean()) for size in (0.05, 0.1, 0.2)}
    return shares, int((~near.any(axis=1)).sum())


def test_pancam_finds_five_centimetres_within_five_metres() -> None:
    shares, false, finds = [], 0, 0
    for seed in (700, 701):
        model, survey, rocks = looked_at(seed, PANCAM)
        share, wrong = hits(model, survey, rocks)
        shares.append(list(share.values()))
        false, finds = false + wrong, finds + len(survey.rocks)
        for rock in survey.rocks:
            apart = np.hypot(rocks[:, 0] - rock.x_m, rocks[:, 1] - rock.y_m)
            if apart.min() < 0.03:
                assert rock.diameter_m == pytest.approx(rocks[apart.argmin(), 2], abs=4 * rock.diameter_m_sigma)
                assert rock.keepout_m > 0.4 * rocks[apart.argmin(), 2]
    assert np.mean(shares, axis=0) == pytest.approx(1.0, abs=0.1)
    assert false <= 0.05 * finds + 1


def test_completeness_says_what_is_missed() -> None:
    """NavCam is too coarse for rocks of 5 cm: few are found, and that is said."""
    model, survey, rocks = looked_at(703, NAVCAM, (0.05, 0.1, 0.2))
    shares, false = hits(model, survey, rocks)
    said = {size: np.mean([e.share for e in survey.completeness if e.diameter_m == size]) for size in (0.05, 0.1, 0.2)}
    assert shares[0.2] == 1.0
    assert said[0.2] > 0.9
    assert said[0.05] < said[0.1] <= said[0.2] + 0.05
    assert shares[0.05] == pytest.approx(said[0.05], abs=0.4)
    assert false <= 1


def test_ground_without_rocks_has_next_to_none() -> None:
    finds = 0
    for seed in range(2):
        rng = np.random.default_rng(seed)
        ground, _ = with_rocks(rng, [])
        finds += len(find_rocks(ground.seen(rng, PANCAM, CAMERA), largest_m=0.4, sizes_m=()).rocks)
    assert finds <= 4


def test_relief_of_the_ground_is_no_rock_where_errors_are_small() -> None:
    """Berms of 8 mm along a track, ten times as high as the errors near the camera, with some 340 bumps."""
    rng, step = np.random.default_rng(31), 0.02
    x, y = np.meshgrid(step * np.arange(300), step * np.arange(150))
    relief = gaussian_filter(rng.standard_normal(x.shape), 3.0)
    height = 0.004 * relief / relief.std()
    for side in (0.9, 1.1, 1.9, 2.1):
        height += 0.008 * np.exp(-(((y - side) / 0.03) ** 2)) * (0.6 + 0.4 * np.sin(2 * np.pi * x / 0.07))
    rocks = np.array([[1.0, 0.5], [2.5, 2.6], [3.5, 1.5]])
    for place in rocks:
        height += 0.06 * np.sqrt(np.clip(1 - ((x - place[0]) ** 2 + (y - place[1]) ** 2) / 0.06**2, 0, None))
    sigma = 0.0007 * (1.0 + (x / 1.5) ** 2)
    seen = height + sigma * gaussian_filter(rng.standard_normal(x.shape), 1.0) / 0.28
    model = ElevationModel(
        name="berms",
        x0_m=0.0,
        y0_m=0.0,
        spacing_m=step,
        height_m=seen,
        height_m_sigma=sigma,
        resolution_m=np.array(0.04),
    )
    found = np.array([(rock.x_m, rock.y_m) for rock in find_rocks(model, sizes_m=()).rocks])
    apart = np.hypot(*(found[:, None] - rocks).transpose(2, 0, 1))
    assert (apart.min(axis=0) < 0.04).all() and (apart.min(axis=1) > 0.08).sum() <= 6


def test_keep_outs_and_refusals() -> None:
    model, survey, _ = looked_at(700, PANCAM)
    found = RockList(model=model, survey=survey, request=RocksRequest(margin=0.1), inputs={})
    features = json.loads(found.geojson())["features"]
    assert len(features) == len(survey.rocks) > 15
    ring = np.array(features[0]["geometry"]["coordinates"][0])
    rock = survey.rocks[0]
    assert (np.hypot(*(ring - [rock.x_m, rock.y_m]).T) >= rock.keepout_m + 0.1).all()
    with pytest.raises(ParameterError, match="show no rocks"):
        find_rocks(model, largest_m=0.03)
    for options in ({"largest": 9.0}, {"false_share": 0.0}, {"sizes": "a"}, {"sizes": "0.9"}):
        with pytest.raises(RequestError):
            RocksRequest(**options)
