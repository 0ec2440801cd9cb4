"""Rocks in pictures: what is rendered, measured and judged, against geometry and made-up ground of known parallax."""

import json
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.signal import correlate
from scipy.stats import norm

from lunarsci.errors import DataError, RequestError
from lunarsci.images.camera import Pose
from lunarsci.images.jobs.requests import RocksRequest
from lunarsci.images.jobs.rocks import RockList
from lunarsci.images.matching import Rectified, StereoMatches
from lunarsci.images.rock_network import RockCandidates, _convolved, embedded_network, levels, rock_candidates, scores
from lunarsci.images.rocks import (
    RockSurvey,
    _false_rate,
    _logistic,
    _parallax,
    _pits,
    _scene,
    _share_of_bumps,
    _with_false_share,
    find_rocks,
)
from lunarsci.images.stones import StonePair, put_stone, spots
from lunarsci.io.inputs import read_input
from lunarsci.result import Doubt
from lunarsci.twin.ground.missed_rocks import missed_rocks

FOCAL_PX, BASE_M, SIDE = 600.0, 0.27, 512
POSE = Pose.looking([0.0, 0.0, 1.5], 0.0, 30.0)


def plane(*bumps: tuple[float, float, float, float]) -> StereoMatches:
    """A pair of level ground 1.5 m below, with a texture, and round bumps u, v, radius, disparity [px] on it."""
    rng = np.random.default_rng(4)
    v, u = np.mgrid[:SIDE, :SIDE].astype(float)
    ray = np.stack([(u - 255.5) / FOCAL_PX, (v - 255.5) / FOCAL_PX, np.ones_like(u)], axis=-1) @ POSE.rotation.T
    depth = np.where(ray[..., 2] < -0.01, -1.5 / np.minimum(ray[..., 2], -0.01), np.inf)
    disparity = FOCAL_PX * BASE_M / depth
    for x, y, radius, rise in bumps:
        disparity += rise * ((u - x) ** 2 + (v - y) ** 2 < radius**2)
    light = 400 + 60 * gaussian_filter(rng.standard_normal((SIDE, SIDE + 400)), 1.2) / 0.24
    right = light[:, 200 : 200 + SIDE]
    left = map_coordinates(light, [v, u + 200 - disparity], order=3, mode="nearest")
    frame = Rectified(np.eye(3), FOCAL_PX, (255.5, 255.5), BASE_M, np.zeros((2, SIDE, SIDE, 2), np.float32))
    seen = np.where((disparity > 10) & (u - disparity > 3), disparity, np.nan)
    noise = [p + rng.standard_normal(p.shape) for p in (left, right)]
    return StereoMatches(
        rectified=frame, left=noise[0], right=noise[1], disparity=seen, sigma_px=0 * seen + 0.05,
        window_px=0 * seen + 7.0,
        reason=np.isnan(seen).astype(np.uint8), row_offset_px=0.0,
    )  # fmt: skip


@cache
def survey() -> RockSurvey:
    return find_rocks(plane(), POSE, sun_deg=(60.0, 30.0))


def test_parallax_is_that_of_the_ground() -> None:
    """A disc raised by 1.5 px; Gaussian windows lose a tenth of what is three of their widths across."""
    matches = plane((300.0, 300.0, 12.0, 1.5))
    scene, _ = _scene(matches, POSE, (60.0, 30.0))
    above = _parallax(scene.ground, scene.left, scene.right)
    disc = above[296:305, 296:305].mean() - np.median(above[260:280, 280:320])
    assert disc == pytest.approx(1.5, abs=0.2)
    assert np.abs(above[scene.searched] - np.median(above[scene.searched])).mean() < 0.1


def test_stones_stand_where_both_cameras_see_them() -> None:
    """The same stone in both pictures, apart by f B / Z of its foot."""
    scene, _ = _scene(plane(), POSE, (60.0, 30.0))
    rng = np.random.default_rng(1)
    pictures = scene.left.copy(), scene.right.copy()
    spot = np.array([330.0, 300.0, 0.12, 0.05])
    u, v, width, height = put_stone(scene, pictures, spot, 0.0, rng)
    _, (disparity,) = scene.feet(spot[None])
    assert width == pytest.approx(0.12 * disparity / BASE_M, rel=0.3)
    assert 0.3 * width < height < 1.2 * width
    assert abs(u - 330.0) < 0.3 * width and v < 302.0
    changed = [np.argwhere(np.abs(a - b) > 40).mean(axis=0) for a, b in zip(pictures, scene[:2], strict=True)]
    assert changed[0][1] - changed[1][1] == pytest.approx(disparity, abs=0.05 * disparity)
    put = spots(scene, 0.3, rng)
    assert len(put) > 20 and (put[:, 2] >= 0.03).all() and (put[:, 2] <= 0.3).all()


def test_plain_ground_has_next_to_no_rocks_and_larger_ones_are_missed_less() -> None:
    assert len(survey().rocks) <= 2
    shares = {(one.diameter_m, one.range_from_m): one for one in survey().completeness}
    assert shares[0.2, 2.5].share >= shares[0.05, 2.5].share - 0.02
    for one in survey().completeness:
        assert 0 <= one.share_low <= one.share <= one.share_high <= 1
    # 30 deg down with 46 deg across: 1.5 m of height see some 20 m2 within 7 m.
    assert 8 < survey().searched_m2 < 40


def test_false_finds_are_counted_by_the_laws_of_scores() -> None:
    """Two normal laws: the chance at a score is the ratio of their densities, by the numbers in each."""
    rng = np.random.default_rng(2)
    own = np.concatenate([rng.normal(-2, 1, 4000), rng.normal(3, 1, 1000)])

    def odds(at: np.ndarray) -> np.ndarray:
        return np.asarray(np.exp(norm.logpdf(at, 3, 1) - norm.logpdf(at, -2, 1)))

    doubt, threshold = _false_rate(own, odds, 0.05)
    above = np.sort(own[:4000][own[:4000] > threshold])
    assert len(above) / (own > threshold).sum() == pytest.approx(0.05, abs=0.02)
    assert doubt(np.array([4.0]))[0] < 0.05 < doubt(np.array([-1.0]))[0]
    # Where no rock is, one that surely looks like one would be seen all the same.
    empty, at = _false_rate(rng.normal(-2, 1, 4000), odds, 0.05)
    assert empty(np.array([1.0]))[0] > 0.5 and at < 8 and empty(np.array([at + 1]))[0] < 0.05


def test_layers_are_correlations() -> None:
    """As scipy has them, with holes between the weights and places left out."""
    rng = np.random.default_rng(5)
    values, weights = rng.standard_normal((2, 21, 24)), rng.standard_normal((3, 2, 3, 3))
    for dilation, step in ((1, 1), (2, 1), (3, 2)):
        wide = np.zeros((3, 2, 2 * dilation + 1, 2 * dilation + 1))
        wide[:, :, ::dilation, ::dilation] = weights
        right = [correlate(values, w, mode="valid")[0, ::step, ::step] + 0.5 for w in wide]
        assert _convolved(values, weights, np.full(3, 0.5), dilation, step) == pytest.approx(np.array(right))


def test_scores_are_of_their_places() -> None:
    """In strips and inside a part as in one piece."""
    _, images = next(levels(_scene(plane(), POSE, (60.0, 30.0))[0]))
    part = np.zeros(images.shape[1:], dtype=bool)
    part[301:450, 77:120] = True
    every = scores(embedded_network(), images[:, 200:500, :200], np.ones((300, 200), bool))
    some = scores(embedded_network(), images, part)
    assert np.isfinite(some).sum() == part[::2, ::2].sum()
    assert some[151:225, 39:60] == pytest.approx(every[51:125, 39:60], abs=1e-3)


def test_a_stone_is_seen_where_it_is() -> None:
    scene, _ = _scene(plane(), POSE, (60.0, 30.0))
    rng = np.random.default_rng(1)
    pictures = scene.left.copy(), scene.right.copy()
    boxes = [
        put_stone(scene, pictures, np.array([u, v, 0.12, 0.06]), 0.0, rng)
        for u, v in ((330.0, 300.0), (200.0, 260.0), (420.0, 350.0))
    ]
    above = _parallax(scene.ground, *pictures)
    detected = rock_candidates(scene._replace(left=pictures[0], right=pictures[1], above=above), 0.3)
    likeliest = sorted(detected.places[:3].tolist())
    for (u, v, width, height), place in zip(sorted(map(tuple, boxes)), likeliest, strict=True):
        assert abs(place[0] - u) < 0.35 * width and abs(place[1] - v) < 0.35 * height
        assert 0.6 * width < place[2] < 1.6 * width


def test_logistic_regression_finds_the_law_it_was_drawn_from() -> None:
    rng = np.random.default_rng(3)
    x = rng.standard_normal((20000, 2))
    true = rng.random(20000) < 1 / (1 + np.exp(-(0.5 + x @ [1.0, -2.0])))
    values, covariance = _logistic(x, true.astype(float), 1e-6)
    assert (np.abs(values - [0.5, 1.0, -2.0]) < 4 * np.sqrt(np.diag(covariance))).all()


def test_rocks_of_a_rig_in_doubt_are_in_doubt() -> None:
    ground = SimpleNamespace(doubt=Doubt.of("the pictures contradict rig, mast or pose"))
    survey = SimpleNamespace(false_share=0.1)
    assert RockList(ground=ground, survey=survey, request=RocksRequest(rig="rig.toml")).untrusted.startswith(
        "the pictures"
    )


def test_too_little_ground_is_refused() -> None:
    matches = plane()
    dark = StereoMatches(**{k: getattr(matches, k) for k in StereoMatches.__slots__} | {"left": 0 * matches.left})
    with pytest.raises(DataError, match="lit ground"):
        find_rocks(dark, POSE)


def test_requests_that_cannot_be() -> None:
    for options in ({"largest": 9.0}, {"false_share": 0.0}, {"sizes": "a"}, {"sizes": "0.9"}, {"sun": "a"}):
        with pytest.raises(RequestError):
            RocksRequest(**options)
    assert RocksRequest(sun="60,30").sun_deg() == (60.0, 30.0)


def test_what_may_have_been_missed_on_the_way(tmp_path: Path) -> None:
    """Poisson by hand: (1 + 1/2) rocks on 20 m2 over 0.75 found, half missed on 2 m of 4 m, all beyond 5 m."""
    share = {"diameter_m": 0.2, "range_from_m": 0.0, "range_to_m": 3.0, "share": 1.0}
    rows = [share, share | {"range_from_m": 3.0, "range_to_m": 5.0, "share": 0.5}]
    told = {"camera_m": [0.0, 0.0, 0.0], "area_m2": 20.0, "completeness": rows}
    small = {"diameter_m": 0.1, "height_m": 0.04, "height_m_sigma": 0.01}
    rocks = [{"properties": {"diameter_m": 0.4}}, {"properties": small}]
    path = tmp_path / "rocks.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": rocks, "searched": told}))
    way = np.column_stack([np.linspace(2.0, 6.0, 401), np.zeros(401)])
    text = missed_rocks(read_input(str(path)), way, 1.0, 0.09)
    chance = 1 - np.exp(-1.5 / 20 / 0.75 * (0.5 * 2 + 1.0))
    assert text is not None and f"missed there is {100 * chance:.0f} %" in text
    assert "1 of 2 rocks may be higher than the 9 cm" in text and "0 % to 100 %" in text
    path.write_text(json.dumps({"type": "FeatureCollection", "features": []}))
    assert missed_rocks(read_input(str(path)), way, 1.0, 0.09) is None


def test_bumps_of_the_ground_are_counted_by_pits_away_from_rocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of three pits that look like rocks under the reversed Sun one is a rock's own shadow, and one below the level."""
    image = np.zeros((4, 4), dtype=np.float32)
    above, up, sun = image + 0.5, np.array([0.0, -1.0, 0.0]), np.array([0.6, -0.8, 0.0])
    scene = StonePair(image, image, image + 9, above, image > -1, 400.0, (2.0, 2.0), 0.3, up, sun)
    looked = list[StonePair]()

    def candidates_at(places: list[list[float]], scored: list[float]) -> RockCandidates:
        return RockCandidates(np.array(places), np.array(scored), *np.zeros((3, len(scored))))

    def candidates(turned: StonePair, largest_m: float) -> RockCandidates:
        looked.append(turned)
        return candidates_at([[10.0, 10.0, 5.0], [60.0, 10.0, 5.0], [90.0, 10.0, 5.0]], [6.0, 6.0, 2.0])

    monkeypatch.setattr("lunarsci.images.rocks.rock_candidates", candidates)
    assert _pits(scene, 0.3, candidates_at([[12.0, 12.0, 8.0]], [9.0]), 4.0) == 1
    np.testing.assert_allclose(looked[0].sun, [-0.6, -0.8, 0.0])
    np.testing.assert_array_equal(looked[0].above, -above)


def test_probabilities_of_rocks_agree_with_how_many_are_false() -> None:
    """Their odds keep their ratios; where more are true than is counted, and without any, they stay."""
    chances = np.array([0.9999, 0.99, 0.95, 0.8])
    less = _with_false_share(chances, 0.6)
    assert less.mean() == pytest.approx(0.4)
    ratio = (less / (1 - less)) / (chances / (1 - chances))
    np.testing.assert_allclose(ratio, ratio[0])
    assert _with_false_share(chances, 3.0).max() < 1e-9
    np.testing.assert_array_equal(_with_false_share(chances, 0.01), chances)
    assert _with_false_share(chances[:0], 0.0).size == 0


def test_few_pits_leave_open_how_many_finds_are_bumps() -> None:
    """Sums by hand for three of each; of many, as many bumps as pits, up to all finds."""
    weights = np.array([1.0, 3.5 / 2, 3.5 * 4.5 / 2 / 4, 3.5 * 4.5 * 5.5 / 6 / 8])
    assert _share_of_bumps(3, 3) == pytest.approx(weights @ np.arange(4) / weights.sum() / 3)
    assert _share_of_bumps(0, 200) == pytest.approx(0.5 / 200, rel=0.01)
    assert _share_of_bumps(200, 1000) == pytest.approx(0.2, rel=0.01)
    assert 0.8 < _share_of_bumps(500, 50) < 1.0
    assert _share_of_bumps(3, 0) == 0.0
