"""What two pictures say against the rig that is to have taken them: rows, the height of the mast, and the pose.

Features that both pictures have are tied (SIFT, Lowe 2004, 10.1023/B:VISI.0000029664.99615.94). How far their rows are
apart, and how the near ground lies below the camera, are observations; the rig within its covariance, the mast, the
pose and the slope of the ground are what they depend on. The chi-square of this adjustment says whether all can be as
stated, and by how much one gross error more lessens it which of them explains it (Baarda 1968, A testing procedure for
use in geodetic networks, Neth. Geod. Comm. 2, 5).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import NORMAL_MAD, SIGNIFICANCE, FloatArray, robust_fit, robust_scatter
from lunarsci.errors import DataError, ParameterError
from lunarsci.images.camera import MAST_M, PARAMETERS, Pose, StereoRig, unstated_covariance
from lunarsci.images.pictures import Picture, cv2

HIGHLANDS, MARIA = NORMAL_MAD * math.radians(7.5), NORMAL_MAD * math.radians(2.0)
"""Standard deviations of the ground's slope along a line, from medians over 17 m (Rosenburg et al. 2011,
10.1029/2010JE003716): the first of what the ground before a rover has, the second of its bends. [rad]"""
MAST_ERROR, MAST_UNKNOWN = 0.1, 0.5
"""Errors of the mast's height where a rig states it, by its load and what its wheels stand on, and where it does not,
as shares: assumed."""
LIKE = 0.8
"""Distance of a feature from the likest over that from the second likest one (Lowe 2004)."""
LOOKED_PX = 512 * 512
"""Pixels of the pictures in which features are looked for; assumed."""
NEWTON_STEPS = 3
"""Of the size of a gross error: observations are nearly linear in it."""
FEWEST = 50
"""Features in common below which pictures say nothing of a rig; assumed."""
COMMON = 1.5
"""Errors of the terms of rows over those by their scatter: measured on 14 rendered pairs with their true
rigs (`tests/benchmarks/wrong_rigs.py`)."""
ROW_PX = 3.0
"""Rows that are farther apart, or scatter by more, are of another rig or scene; assumed. [px]"""
NEAREST = 0.25
"""Share of the ties that are the near ground; assumed."""
OTHER = "no single error explains it: the rig is another one, or the rover moved between the pictures"


class CommonFeatures(NamedTuple):
    """Places of n features in the left and in the right picture. (n, 2) each [px]"""

    left: FloatArray
    right: FloatArray


class _Error(NamedTuple):
    """A gross error: its sentence, with its size in it, and by what a size of 1 changes rig and observations.

    text : with `{x}` for the size, `{more}` for 1 plus it, `{deg}` for it as an angle, `{high}` for the mast and it.
    step : of the size, for derivatives.
    rig : change of the rig's parameters. (24,)
    ground : change of height and slopes, of `_ground`. (3,) [m, -, -]
    """

    text: str
    step: float
    rig: FloatArray
    ground: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Reliability:
    """Whether rig, mast and pose can be those of two pictures.

    Attributes
    ----------
    ties : features that were tied.
    chi_square, freedom : of the adjustment.
    probability : of a chi-square as large as that, if all is as stated.
    causes : gross errors of which each alone would explain it where it is too large, the likeliest first; the nearest
        one where none does.
    """

    ties: int
    chi_square: float
    freedom: int
    probability: float
    causes: tuple[str, ...] = ()

    def doubts(self) -> tuple[str, ...]:
        """Why the heights should not be trusted, a cause each; none where nothing contradicts the rig."""
        if self.probability >= SIGNIFICANCE:
            return ()
        return (
            f"the pictures contradict rig, mast or pose (chi-square {self.chi_square:.3g} of {self.freedom})",
            *self.causes,
        )

    def to_dict(self) -> dict[str, Any]:
        """For a result."""
        return {**asdict(self), "causes": list(self.causes)}


def ties_of(left: Picture, right: Picture) -> CommonFeatures:
    """Features of the left picture with the likest ones of the right picture."""
    words, places = [], []
    sift = cv2.SIFT_create(nfeatures=2000, contrastThreshold=0.01)
    share = min(1.0, math.sqrt(LOOKED_PX / left.values.size))
    for picture in (left, right):
        light = np.sqrt(picture.values / max(float(np.percentile(picture.values, 99.5)), 1.0))
        eight = np.clip(255 * light, 0, 255).astype(np.uint8)
        keys, one = sift.detectAndCompute(
            cv2.resize(eight, None, fx=share, fy=share, interpolation=cv2.INTER_AREA), None
        )
        if len(keys) < FEWEST:
            return CommonFeatures(np.empty((0, 2)), np.empty((0, 2)))
        words.append(one)
        places.append((np.asarray(cv2.KeyPoint_convert(keys), dtype=float) + 0.5) / share - 0.5)
    return CommonFeatures(*likest(places, words))


def likest(
    places: Sequence[FloatArray], words: Sequence[npt.NDArray[np.float32]], within: npt.NDArray[np.uint8] | None = None
) -> tuple[FloatArray, FloatArray]:
    """Places of features of two pictures whose words are alike, and unlike those of the second likest.

    `places` (n, 2) and (m, 2) [px], `words` (n, 128) and (m, 128), `within` (n, m), above 0 for pairs that may be; what
    is returned (k, 2) each.
    """
    pairs = cv2.BFMatcher().knnMatch(*words, k=2, mask=within)
    good = [best[0] for best in pairs if best and (len(best) < 2 or best[0].distance < LIKE * best[1].distance)]
    return places[0][[one.queryIdx for one in good]], places[1][[one.trainIdx for one in good]]


def _apart(rig: StereoRig, ties: CommonFeatures) -> FloatArray:
    """Place of each tie in the rectified left picture, about its middle in widths, and its disparity and the distance
    of its rows there; NaN for none. (n, 4) [-, -, px, px]"""
    turn = rig.in_rows.T
    rays = rig.left.rays(ties.left) @ turn, rig.right.rays(ties.right) @ rig.rotation @ turn
    first, second = (rig.left.fx_px * ray[:, :2] / ray[:, 2:] for ray in rays)
    return np.column_stack([first / rig.left.width_px, first[:, 0] - second[:, 0], second[:, 1] - first[:, 1]])


def _rows_design(apart: FloatArray) -> FloatArray:
    """Terms of how rows may be apart over a picture: a shift, a turn, and what focal lengths and lenses do. (n, 6)"""
    x, y = apart[:, 0], apart[:, 1]
    return np.column_stack([np.ones(len(x)), x, y, x * y, x * x, y * y])


def _turned(pixels: FloatArray, size: tuple[int, int], quarters: int) -> FloatArray:
    """Pixels of a picture that is turned anticlockwise by so many quarters. (n, 2)"""
    for _ in range(quarters):
        pixels = np.column_stack([pixels[:, 1], size[0] - 1 - pixels[:, 0]])
        size = size[::-1]
    return pixels


TURNS = {(2, 0): "the left picture is upside down", (0, 2): "the right picture is upside down"}
"""What was done to the pictures, by the quarters that turn each of them back anticlockwise."""
QUARTERS = {
    (1, 1): "both pictures are turned by 90 deg clockwise", (3, 3): "both pictures are turned by 90 deg anticlockwise",
    (0, 1): "the right picture is turned by 90 deg", (0, 3): "the right picture is turned by 90 deg",
    (1, 0): "the left picture is turned by 90 deg", (3, 0): "the left picture is turned by 90 deg",
}  # fmt: skip
"""The same of square pictures."""


def check_sides(rig: StereoRig, ties: CommonFeatures, names: str) -> None:
    """Raise DataError where ties lie in rows, and ahead, only once a picture is turned or both are exchanged."""
    size = rig.left.size
    tries = {"": ties, "left and right are swapped, or both are upside down; give the left one first": ties[::-1]}
    for (one, two), text in (TURNS | (QUARTERS if size[0] == size[1] else {})).items():
        tries[text] = CommonFeatures(_turned(ties.left, size, one), _turned(ties.right, size, two))
    scatter = {}
    for text, (left, right) in tries.items():
        apart = _apart(rig, CommonFeatures(left, right))
        apart = apart[np.isfinite(apart).all(axis=1)]
        rows = apart[apart[:, 2] > -ROW_PX, 3]
        if 2 * len(rows) > len(apart) >= FEWEST:
            scatter[text] = robust_scatter(rows)
    likeliest = min(scatter, key=lambda text: scatter[text], default="")
    if likeliest and scatter[likeliest] < ROW_PX:
        raise DataError(f"{names}: do not match as they are: {likeliest}")


def _ground(rig: StereoRig, ties: CommonFeatures, pose: Pose | None) -> tuple[FloatArray, float]:
    """Height of the left camera over the plane of its near ground [m], and with a pose the plane's slopes to the right
    and ahead [-]; and how far ahead this ground is [m]."""
    points = rig.triangulate(*ties).points
    level = np.eye(3)
    if pose is not None:
        heading = math.radians(pose.angles_deg()[0])
        right, ahead = (math.sin(heading), -math.cos(heading), 0.0), (math.cos(heading), math.sin(heading), 0.0)
        level = np.array([right, (0.0, 0.0, -1.0), ahead]) @ pose.rotation
    x, y, z = (points[np.isfinite(points).all(axis=1)] @ level.T).T
    plane, _ = robust_fit(np.column_stack([np.ones(len(x)), x, z]), y)
    distance = float(np.median(np.hypot(x, z)))
    if pose is None:
        return plane[:1] / math.sqrt(1 + float(plane[1:] @ plane[1:])), distance
    return plane * [1, -1, -1], distance


class _Observed(NamedTuple):
    """What pictures say, as a function of the rig: six terms of the rows' distances [px], then those of `_ground`."""

    of: Callable[[StereoRig], FloatArray]
    covariance: FloatArray


def _observed(rig: StereoRig, ties: CommonFeatures, pose: Pose | None, tilt_deg: float) -> _Observed | None:
    """Observations of ties whose rows agree, with the covariance of their own errors and of the ground's form; None
    where these are too few to say."""
    apart = _apart(rig, ties)
    seen = np.isfinite(apart).all(axis=1)
    if seen.sum() < FEWEST:
        return None
    ties, apart = CommonFeatures(ties.left[seen], ties.right[seen]), apart[seen]
    design = _rows_design(apart)
    plane, weight = robust_fit(design, apart[:, 3])
    good = (weight > 0) & (apart[:, 2] > 0)
    if good.sum() < FEWEST:
        return None
    ties, design, apart = CommonFeatures(ties.left[good], ties.right[good]), design[good], apart[good]
    root = np.sqrt(weight[good])[:, None]
    scatter = robust_scatter(apart[:, 3] - design @ plane)
    inverse = np.linalg.pinv((design * root).T @ (design * root))
    near = apart[:, 2] >= np.quantile(apart[:, 2], 1 - NEAREST)
    ground = CommonFeatures(ties.left[near], ties.right[near])

    def of(one: StereoRig) -> FloatArray:
        rows = _apart(one, ties)[:, 3]
        if not np.isfinite(rows).all():
            raise ParameterError(f"{one.name}: does not see what it saw")
        terms = np.linalg.lstsq(design * root, rows * root[:, 0], rcond=None)[0]
        return np.append(terms, _ground(one, ground, pose)[0])

    _, distance = _ground(rig, ground, pose)
    tilt = math.radians(tilt_deg)
    mast = MAST_UNKNOWN * MAST_M if rig.mast_height_m is None else MAST_ERROR * rig.mast_height_m
    variances = [mast**2 + (MARIA * distance) ** 2] + ([] if pose is None else [HIGHLANDS**2 + tilt**2] * 2)
    covariance = np.zeros((6 + len(variances),) * 2)
    covariance[:6, :6] = (COMMON * scatter) ** 2 * inverse
    covariance[range(6, len(covariance)), range(6, len(covariance))] = variances
    return _Observed(of, covariance)


def _errors(rig: StereoRig, posed: bool) -> list[_Error]:
    """Gross errors that are tried."""
    none, unit = np.zeros(len(PARAMETERS)), np.eye(len(PARAMETERS))
    lengths = np.concatenate([rig.left.vector(), rig.right.vector(), np.zeros(6)])
    focal = np.where([name[-5:] in ("fx_px", "fy_px") for name in PARAMETERS], lengths, 0.0)
    ahead, along = (np.append(none[:21], way) for way in (-rig.rotation[:, 2], rig.translation_m))
    errors = [
        _Error("the baseline is {more:.2g} times as long as the rig's", 0.01, along),
        _Error("focal lengths are {more:.2g} times those of the rig", 0.01, focal),
        _Error("the right picture, or its camera, is turned by {deg:.2g} deg about its axis", 1e-3, unit[20]),
        _Error("the right picture is {x:.2g} px too low, or its camera looks too high", 1.0, unit[12]),
        _Error(
            "the right camera stood {x:.2g} m ahead of its place, or the rover moved between the pictures", 0.01, ahead
        ),
        _Error(f"the camera is {{high:.2g}} m over the ground, not {rig.height_m:g} m", 0.1, none, (1.0, 0.0, 0.0)),
    ]
    return errors if not posed else [
        *errors,
        _Error("the ground rises ahead by {deg:.2g} deg, or the pose's down_deg is off", 0.1, none, (0.0, 0.0, 1.0)),
        _Error("the ground rises aside by {deg:.2g} deg, or the pose's roll_deg is off", 0.1, none, (0.0, 1.0, 0.0)),
    ]  # fmt: skip


def _size(left: Callable[[float], FloatArray], step: float, inverse: FloatArray) -> tuple[float, float]:
    """Size of a gross error at which what is `left` of the observations is smallest, and its chi-square there."""
    x = 0.0
    for _ in range(NEWTON_STEPS):
        now = left(x)
        by = (left(x + step) - now) / step
        x -= float(by @ inverse @ now) / float(by @ inverse @ by)
    return x, float(left(x) @ inverse @ left(x))


def reliability(rig: StereoRig, ties: CommonFeatures, pose: Pose | None, tilt_deg: float) -> Reliability | None:
    """Whether rig, mast and pose can be those of the pictures of some ties; None where these are too few to say, or
    at the edge of what the lenses see.

    `tilt_deg` is the standard deviation of the pose's angles below the horizon and about its axis. [deg]
    """
    from scipy.special import chdtrc

    if (observed := _observed(rig, ties, pose, tilt_deg)) is None:
        return None
    expected = np.zeros(len(observed.covariance))
    expected[6] = rig.height_m
    off = observed.of(rig) - expected
    prior = rig.covariance if rig.covariance.any() else unstated_covariance(rig.left, rig.right, rig.translation_m)
    sigma = np.sqrt(np.diag(prior))
    slopes = np.zeros((len(off), len(sigma)))
    for k in np.flatnonzero(sigma):
        step = 0.1 * sigma[k] * np.eye(len(sigma))[k]
        try:
            slopes[:, k] = (observed.of(rig.moved(step)) - expected - off) / (0.1 * sigma[k])
        except ParameterError:
            return None
    inverse = np.asarray(np.linalg.pinv(observed.covariance + slopes @ prior @ slopes.T), dtype=float)
    square = float(off @ inverse @ off)
    explained = list[tuple[float, str]]()
    probability = float(chdtrc(len(off), square))
    for error in _errors(rig, pose is not None) if probability < SIGNIFICANCE else ():
        ground = np.append(np.zeros(6), error.ground)[: len(off)]
        try:
            x, rest = _size(lambda x, e=error, g=ground: observed.of(rig.moved(x * e.rig)) - expected - x * g,  # type: ignore[misc]
                            error.step, inverse)  # fmt: skip
        except ParameterError:
            continue
        explained.append((rest, error.text.format(x=x, more=1 + x, deg=math.degrees(x), high=rig.height_m + x)))
    explained.sort()
    causes = tuple(text for rest, text in explained if chdtrc(len(off) - 1, rest) >= SIGNIFICANCE)
    if explained and not causes:
        rest, text = explained[0]
        causes = OTHER, f"nearest to it: {text}, which leaves a chi-square of {rest:.3g}"
    return Reliability(ties=len(ties.left), chi_square=square, freedom=len(off), probability=probability, causes=causes)
