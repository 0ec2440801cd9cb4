"""What two pictures have in common, pixel by pixel: rectification, dense matching, and what cannot be matched and why.

Semi-global matching (Hirschmueller 2008, 10.1109/TPAMI.2007.1166) of OpenCV gives where to begin, least squares on
windows of the rectified pictures go on: about a pixel the left picture is the right one, moved by a disparity
that changes linearly over the window, times a gain, plus an offset (Gruen 1985, S. Afr. J. Photogramm. 14, 175:
adaptive least squares correlation). The normal matrix and what is left of the light give the disparity's error.

Where texture is weak a small window keeps what it began with. Least squares therefore go from coarse pictures to fine
ones first, which forgets it: a smooth field. Small windows begin at this field and, where they differ, at semi-global
matching; what they find is weighed by the light that is left, and their disagreement is part of the error. Then field
and small window are weighed by their errors, that of the field being the relief about it.
"""

import io
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lunarsci.arrays import FloatArray, robust_fit, robust_scatter
from lunarsci.compiled import compiled, each_in_threads
from lunarsci.errors import DataError
from lunarsci.images.camera import COARSE_PX, StereoRig
from lunarsci.images.pictures import Picture, cv2, png_bytes
from lunarsci.images.reliability import ROW_PX, check_sides, ties_of
from lunarsci.ranges import refuse
from lunarsci.result import Progress

HALF_PX = 3
"""Windows are 7 x 7 pixels: the compromise between noise and relief that was nearest to the truth of two rendered pairs
(`tests/benchmarks/scenes.py`: NavCam 2, PanCam 1) of 5, 7 and 9."""
STEPS = 5
"""Steps of least squares on a window, at most."""
SMALL_STEP_PX = 0.01
"""Step of a disparity that ends them; ten times as large a last one is taken for an answer, too. [px]"""
STARTS_PX, START_SIGMAS = 0.5, 3.0
"""How far semi-global matching may be off what least squares find before it is another surface: a step of it, and so
many errors of a window. Measured (`tests/benchmarks/image_numbers.py`, 30 November 2026, a rendered pair): of 0.25, 0.5
and 1 px errors of heights are 1.12, 1.23 and 1.28 of the stated ones, of 2, 3 and 4.5 errors 1.20, 1.23 and 1.26."""
FARTHEST_PX = 0.9
"""A window whose disparity moves farther from where it began is on something else. Measured as `STARTS_PX`, with this
file changed: of 0.45 and 1.8 px 97 and 100 % of the nodes have a height, with errors of 1.26 and 1.25. [px]"""
STEEPEST = 2 / 3
"""Largest change of disparity from pixel to pixel of the left picture: 1 from pixel to pixel between both pictures
(Pollard et al. 1985, Perception 14, 449, 10.1068/p140449). [px/px]"""
LEVELS = (4, 4, 2, 2)
"""Pictures that many times smaller in which the smooth field is found, one after the other: twice each, as the second
time begins at slopes that the ground has."""
WIDE_HALF_PX, WIDE_SMOOTH_PX = 4, 5
"""Windows of the field, in pixels of its pictures, and width over which it is smoothed: so wide that in two pairs of
smooth ruts (`scenes.py`: pressed 100 and 101) nothing of the start is left. Measured as `STARTS_PX`: by 1 and 2 more
and less errors are 1.17 to 1.28 of the stated ones."""
ROWS = 16
"""Rows of refined pixels that a thread takes at a time."""
REASONS = ("matched", "edge", "saturated", "shadow", "no texture", "occluded", "no match", "island")
MATCHED, EDGE, SATURATED, SHADOW, NO_TEXTURE, OCCLUDED, NO_MATCH, ISLAND = range(len(REASONS))
"""Numbers in `StereoMatches.reason`, and their words."""
BLOCK_PX = 5
"""Window of semi-global matching: the manual of OpenCV (Bradski 2000, Dr. Dobb's J. Softw. Tools 25, 120) advises 3 to
11 px, and penalties of 8 and 32 times its area."""
DARK = 0.05
"""Light below this share of the bright tenth of a picture is shadow. Measured as `STARTS_PX`: of half and twice as much
heights and their errors are the same to a thousandth."""
FEWEST = 0.1
"""Share of pixels that must match before anything is said of a pair; assumed."""
ALIKE = 0.999
"""Correlation of two pictures, pixel on pixel, from which they are one. Measured (30 November 2026): both pictures of
five rendered pairs have 0.38 to 0.56, one of them and itself as JPEG of quality 90 0.9984 to 0.9989."""
TOO_FEW = f"less than {FEWEST:.0%} of the pixels match; are they of one place, one moment and this rig?"
UNEVEN_PX = 0.45
"""Robust scatter of the rows' distances about their plane from which the pictures are of two moments; measured: a
rendered pair has 0.05 px, 0.11 px where the rover moved by 1 cm between its pictures, 0.52 px by 3 cm."""
ISLAND_PX, ISLAND_STEP_PX = 400, 1.0
"""Pixels of a patch below which it is an island, and the step of disparity at which a patch ends. Measured on
six rendered pairs of ground without texture: a third of the pixels on islands were wrong, of all others 2 %."""
ISLAND_OFF, ABOUT_PX = 0.5, 33
"""How far an island may be off the ground about it, as a share of its disparity, and the width of the window in which
this ground is looked for [px]; measured: of shares from 0.1 on this one costs a real pair the fewest pixels."""
CORRELATED = 1.8
"""Random errors over those of the normal matrix, since what is left of the light is correlated: fitted to four
rendered pairs (`tests/benchmarks/scenes.py`: NavCam 2 and 4, PanCam 1 and 10), and tried on others."""
RELIEF = 0.9
"""Share of the relief within a window, beyond its plane, that the middle is off by: as `CORRELATED`."""
SMALLEST_SIGMA_PX = 0.02
"""Error that is left where light and relief say none: as `CORRELATED`."""


class Refined(NamedTuple):
    """What windows about the pixels of the left picture were fitted by; NaN where nothing fitted. (h, w) each

    Attributes
    ----------
    disparity : u in the left picture less u in the right one. [px]
    sigma : its standard error, by the normal matrix and what is left of the light. [px]
    slope_u, slope_v : change of the disparity along u and v. [px/px]
    misfit : rms of what is left of the light over that of the left window about its mean. [-]
    row_offset : v in the right picture less v in the left one, 0 where it was not solved for. [px]
    """

    disparity: FloatArray
    sigma: FloatArray
    slope_u: FloatArray
    slope_v: FloatArray
    misfit: FloatArray
    row_offset: FloatArray

    @property
    def variance(self) -> FloatArray:
        """Of the disparity, with `CORRELATED`. Noise has derivatives, too, as if it were texture: information is the
        share of the light that is none, 1 - misfit^2. (h, w) [px2]"""
        return np.asarray((CORRELATED * self.sigma) ** 2 / np.maximum(1.0 - self.misfit**2, 1e-6))


def refine(
    left: npt.NDArray[np.float32],
    right: npt.NDArray[np.float32],
    first: FloatArray,
    slopes: tuple[FloatArray, FloatArray],
    *,
    half_px: int = HALF_PX,
    step_px: int = 1,
    rows: bool = False,
) -> Refined:
    """Refine disparities by least squares on windows.

    Parameters
    ----------
    left, right : rectified pictures, in any unit of light. (h, w)
    first : disparities to begin with, NaN where none is refined. (h, w) [px]
    slopes : how they change along u and v. (h, w) each [px/px]
    half_px : windows have 2 half_px + 1 pixels along each side.
    step_px : every such row and column alone is refined.
    rows : solve for the distance of the rows as well.
    """
    shape = left.shape
    refined = Refined(*(np.full(shape, np.nan) for _ in Refined._fields))
    grids = [np.ascontiguousarray(a, dtype=np.float32) for a in (left, right)]
    starts = tuple(np.ascontiguousarray(a, dtype=float) for a in (first, *slopes))
    blocks = [(low, min(low + ROWS * step_px, shape[0])) for low in range(0, shape[0], ROWS * step_px)]
    each_in_threads(lambda n: _refine_rows(*grids, starts, *blocks[n], half_px, step_px, rows, refined), len(blocks))
    return refined


@compiled(error_model="numpy", fastmath={"contract", "nsz", "reassoc", "arcp"})
def _refine_rows(left, right, starts, low, high, half, step, rows, refined):  # type: ignore[no-untyped-def]
    """Refine pixels of the rows from `low` to below `high`, and write them into `refined`, a `Refined`.

    `starts` : disparity to begin with and its slopes along u and v (h, w) each; `half`, `step`, `rows` : as `refine`
    takes them, in pixels. The unknowns, `values`, are offset and gain of the light, slopes of the disparity along u and
    v, the distance of the rows, and the disparity.
    """
    first, first_u, first_v = starts
    normal, rhs, values = np.empty((6, 6)), np.empty(6), np.empty(6)
    height, width = left.shape
    for v in range(low, high, step):
        if v < half + 1 or v >= height - half - 1:
            continue
        for u in range(half, width - half, step):
            start = first[v, u]
            if not np.isfinite(start):
                continue
            values[:] = 0.0
            values[1], values[2], values[3], values[5] = 1.0, first_u[v, u], first_v[v, u], start
            good, change, total = True, 1.0, 0.0
            for _ in range(STEPS):
                total = _normal_equations(left, right, u, v, half, values, normal, rhs, rows)
                good = total >= 0.0 and _solved(normal, rhs)
                if not good:
                    break
                change = abs(rhs[5])
                for k in range(6):
                    values[k] += rhs[k]
                good = abs(values[5] - start) <= FARTHEST_PX and max(abs(values[2]), abs(values[3])) <= STEEPEST
                if not good or change < SMALL_STEP_PX:
                    break
            if good and change < 10 * SMALL_STEP_PX:
                freedom = (2 * half + 1) ** 2 - (6 if rows else 5)
                refined.disparity[v, u], refined.row_offset[v, u] = values[5], values[4]
                refined.slope_u[v, u], refined.slope_v[v, u] = values[2], values[3]
                # The disparity is the last unknown: of its variance the factor's last number says all.
                refined.sigma[v, u] = np.sqrt(total / freedom) / normal[5, 5]
                refined.misfit[v, u] = np.sqrt(total / max(_spread(left, u, v, half), 1e-12))


@compiled(error_model="numpy", fastmath={"contract", "nsz", "reassoc", "arcp"})
def _normal_equations(left, right, u, v, half, values, normal, rhs, rows):  # type: ignore[no-untyped-def]
    """Sum of squares left of the light; negative where the window leaves the right picture.

    Fills `normal` (6, 6), its lower triangle, and `rhs` (6,) for the unknowns at `values` (6,) of the window about
    (u, v). Names of sums of a row: of s, the light's change with the disparity, of the light g, of m, what is missing
    of it, and of the column u.
    """
    normal[:], rhs[:], total = 0.0, 0.0, 0.0
    level, gain = values[0], values[1]
    for dv in range(-half, half + 1):
        line = right[v + dv]
        s, su, sg, sgu, ss, ssu, ssuu, sm, smu = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for du in range(-half, half + 1):
            x = u + du - values[5] - values[2] * du - values[3] * dv
            i = int(np.floor(x))
            if i < 1 or i > right.shape[1] - 3:
                return -1.0
            t = x - i
            a, b, c, d = line[i - 1], line[i], line[i + 1], line[i + 2]
            # Catmull & Rom (1974): value and slope between four pixels.
            p, q, r = 0.5 * (c - a), a - 2.5 * b + 2.0 * c - 0.5 * d, 0.5 * (d - a) + 1.5 * (b - c)
            g = b + t * (p + t * (q + t * r))
            slope = -gain * (p + t * (2.0 * q + 3.0 * t * r))
            missing = left[v + dv, u + du] - gain * g - level
            if rows:
                near = i if t < 0.5 else i + 1
                across = 0.5 * gain * (right[v + dv + 1, near] - right[v + dv - 1, near])
                missing -= across * values[4]
                for k, by in enumerate((1.0, g, slope * du, slope * dv, across)):
                    normal[4, k] += across * by
                normal[5, 4] += across * slope
                rhs[4] += across * missing
            total += missing * missing
            s, su, sg, sgu = s + slope, su + slope * du, sg + slope * g, sgu + slope * g * du
            ss, ssu, ssuu = ss + slope * slope, ssu + slope * slope * du, ssuu + slope * slope * du * du
            sm, smu = sm + slope * missing, smu + slope * missing * du
            normal[1, 0], normal[1, 1] = normal[1, 0] + g, normal[1, 1] + g * g
            rhs[0], rhs[1] = rhs[0] + missing, rhs[1] + g * missing
        for k, by in enumerate((su, sgu, ssuu)):
            normal[2, k] += by
        for k, by in enumerate((s, sg, ssu, dv * ss)):
            normal[3, k] += dv * by
        for k, by in enumerate((s, sg, ssu, dv * ss)):
            normal[5, k] += by
        normal[5, 5] += ss
        rhs[2], rhs[3], rhs[5] = rhs[2] + smu, rhs[3] + dv * sm, rhs[5] + sm
    normal[0, 0] = (2 * half + 1) ** 2
    if not rows:
        normal[4, 4] = 1.0
    return total


@compiled(error_model="numpy")
def _solved(normal, rhs):  # type: ignore[no-untyped-def]
    """Cholesky in place: the lower triangle of `normal` (6, 6) becomes its factor, `rhs` (6,) the solution; False where
    it has none."""
    for k in range(6):
        for m in range(k + 1):
            total = normal[k, m]
            for n in range(m):
                total -= normal[k, n] * normal[m, n]
            if k > m:
                normal[k, m] = total / normal[m, m]
            else:
                if not total > 1e-9 * normal[k, k] + 1e-30:
                    return False
                normal[k, k] = np.sqrt(total)
    for k in range(6):
        for n in range(k):
            rhs[k] -= normal[k, n] * rhs[n]
        rhs[k] /= normal[k, k]
    for k in range(5, -1, -1):
        for n in range(k + 1, 6):
            rhs[k] -= normal[n, k] * rhs[n]
        rhs[k] /= normal[k, k]
    return True


@compiled(error_model="numpy")
def _spread(picture, u, v, half):  # type: ignore[no-untyped-def]
    """Sum of squares of the light about its mean in the window about (u, v)."""
    total, square = 0.0, 0.0
    for dv in range(-half, half + 1):
        for du in range(-half, half + 1):
            value = picture[v + dv, u + du]
            total += value
            square += value * value
    return square - total * total / (2 * half + 1) ** 2


class Rectified(NamedTuple):
    """Two pinholes side by side, as a rig's cameras would see with their rows in line.

    Attributes
    ----------
    turn : turns a direction of the left camera's frame into theirs. (3, 3)
    focal_px : focal length of both. [px]
    center_px : principal point (u, v) of both. [px]
    baseline_m : distance of the right one along x. [m]
    maps : (u, v) of a rectified pixel in the left and in the right picture as taken, NaN for none. (2, h, w, 2) [px]
    """

    turn: FloatArray
    focal_px: float
    center_px: tuple[float, float]
    baseline_m: float
    maps: npt.NDArray[np.float32]

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width. [px]"""
        return self.maps.shape[1], self.maps.shape[2]

    def points(self, disparity: FloatArray) -> FloatArray:
        """Points (h, w, 3) of the left camera's frame [m] from disparities (h, w) [px]."""
        v, u = np.mgrid[: self.shape[0], : self.shape[1]]
        depth = self.focal_px * self.baseline_m / disparity
        x, y = (u - self.center_px[0]) / self.focal_px, (v - self.center_px[1]) / self.focal_px
        return np.asarray(np.stack([x * depth, y * depth, depth], axis=-1) @ self.turn)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StereoMatches:
    """Disparities of a pair.

    Attributes
    ----------
    rectified : the frame they are in.
    left, right : light of both pictures in it, rows in line, in the numbers of the left one's file. (h, w)
    disparity, sigma_px : u in the left picture less u in the right one, and its random error; NaN for none. (h, w) [px]
    window_px : width over which it is a mean, and over which its error is one. (h, w) [px]
    reason : place in `REASONS` of why there is none. (h, w)
    row_offset_px : how far the rows of the two pictures were apart at the middle, before they were moved. [px]
    """

    rectified: Rectified
    left: FloatArray
    right: FloatArray
    disparity: FloatArray
    sigma_px: FloatArray
    window_px: FloatArray
    reason: npt.NDArray[np.uint8]
    row_offset_px: float

    def archive(self) -> bytes:
        """Disparities, their errors and windows, and reasons as a NumPy archive, with what turns them into depths."""
        made, frame = io.BytesIO(), self.rectified
        content: dict[str, Any] = {
            f"{key}_px": getattr(self, name).astype(np.float32)
            for key, name in (("disparity", "disparity"), ("sigma", "sigma_px"), ("window", "window_px"))
        }
        content |= {"reason": self.reason, "reasons": REASONS, "turn": frame.turn, "focal_px": frame.focal_px}
        np.savez_compressed(made, center_px=frame.center_px, baseline_m=frame.baseline_m, **content)
        return made.getvalue()

    def picture(self) -> bytes:
        """Disparities times 256 as a PNG of 16 bits, 0 for none, as those of KITTI (Geiger et al. 2013,
        10.1177/0278364913491297)."""
        values = np.clip(np.rint(256 * np.nan_to_num(self.disparity)), 0, 65535)
        return png_bytes(values.astype(np.uint16), {"Unit": "px / 256"})

    def shares(self) -> dict[str, float]:
        """Share of the pixels by reason."""
        counts = np.bincount(self.reason.ravel(), minlength=len(REASONS)) / self.reason.size
        return {name.replace(" ", "_"): float(share) for name, share in zip(REASONS, counts, strict=True)}


def rectify(rig: StereoRig) -> Rectified:
    """Rows in line: x along the baseline, z between both axes; pixels as large as the left camera's.

    Raises DataError for a rig whose right camera is not to the right.
    """
    turn = rig.in_rows
    if turn[0, 0] < 0.5:
        raise DataError(
            f"{rig.name}: its right camera is not to the right of the left one; ask `lunarsci images cameras`"
        )
    width, height = rig.left.size
    focal = 0.5 * (rig.left.fx_px + rig.left.fy_px)
    middles = [c.rays([0.5 * (width - 1), 0.5 * (height - 1)]) for c in (rig.left, rig.right)]
    ways = turn @ middles[0], turn @ rig.rotation.T @ middles[1]
    place = np.mean([way[:2] / way[2] for way in ways], axis=0)
    center = 0.5 * (width - 1) - focal * float(place[0]), 0.5 * (height - 1) - focal * float(place[1])
    v, u = np.mgrid[:height, :width]
    rays = np.stack([(u - center[0]) / focal, (v - center[1]) / focal, np.ones(u.shape)], axis=-1) @ turn
    maps = np.stack([rig.left.project(rays), rig.right.project(rays @ rig.rotation.T)]).astype(np.float32)
    return Rectified(turn, focal, center, rig.baseline_m, maps)


def match(
    left: Picture,
    right: Picture,
    rig: StereoRig,
    *,
    nearest_m: float,
    farthest_m: float = math.inf,
    progress: Progress | None = None,
) -> StereoMatches:
    """Match two pictures of a rig, between two distances along their axis [m].

    `left`, `right` are as the cameras took them; `progress` is called with (done, 5). Raises DataError where they do
    not match.
    """
    report = progress or (lambda done, total: None)
    report(0, 5)
    names = f"{left.source.name}, {right.source.name}"
    one, two = (p.values[::4, ::4].ravel() for p in (left, right))
    if left.size == right.size and np.corrcoef(one, two)[0, 1] > ALIKE:
        raise DataError(f"{names}: show the same, pixel on pixel; give the pictures of the left and the right camera")
    frame = rectify(rig)
    alike = (2**left.bits - 1) / (2**right.bits - 1)
    pictures = [_warped(left.values, frame.maps[0]), _warped(alike * right.values, frame.maps[1])]
    full = [_warped(p.saturated.astype(float), m) > 0.01 for p, m in zip((left, right), frame.maps, strict=True)]
    report(1, 5)
    span = frame.focal_px * frame.baseline_m / nearest_m, frame.focal_px * frame.baseline_m / farthest_m
    first = _semi_global(pictures, span)
    if np.isfinite(first).mean() < FEWEST:
        check_sides(rig, ties_of(left, right), names)
        raise DataError(f"{names}: {TOO_FEW}")
    report(2, 5)
    offset, moved = _rows_in_line(pictures, first, names)
    report(3, 5)
    disparity, sigma, share = _weighed(pictures[0], moved, first)
    report(4, 5)
    reason = _reasons(pictures, full, disparity, sigma, frame)
    reason[(reason == MATCHED) & _islands(np.where(reason == MATCHED, disparity, np.nan))] = ISLAND
    known = reason == MATCHED
    if known.mean() < FEWEST:
        check_sides(rig, ties_of(left, right), names)
        raise DataError(f"{names}: {TOO_FEW}")
    small, wide = 2 * HALF_PX + 1, LEVELS[-1] * (2 * WIDE_HALF_PX + WIDE_SMOOTH_PX)
    window = small + share * (wide - small)
    report(5, 5)
    return StereoMatches(
        rectified=frame,
        left=pictures[0].astype(float),
        right=moved.astype(float),
        disparity=np.where(known, disparity, np.nan),
        sigma_px=np.where(known, sigma, np.nan),
        window_px=np.where(known, window, np.nan),
        reason=reason,
        row_offset_px=offset,
    )


def _weighed(
    left: npt.NDArray[np.float32], right: npt.NDArray[np.float32], first: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Disparities from small windows and a smooth field by their errors, their errors, and the field's share. (h, w)

    Least squares begin at the field, and at semi-global matching `first` (h, w) where it is elsewhere. [px], [px], [-]
    """
    field = _field(left, right, first)
    smooth, slopes = field.disparity, (field.slope_u, field.slope_v)
    one = refine(left, right, smooth, slopes)
    elsewhere = ~(np.abs(first - one.disparity) < STARTS_PX)
    two = refine(left, right, np.where(elsewhere, first, np.nan), _Planes.of(first, 11)[1:3])
    apart = (one.disparity - smooth) ** 2 - one.variance
    relief = np.maximum(_mean_in_window(apart, 2 * (2 * HALF_PX + 1))[0], 0.0)
    wide = np.nan_to_num(field.variance + relief, nan=1e6)
    small, variance = _mixture(one, two, smooth, wide)
    del one, two, field, slopes, apart, relief
    smooth = np.where(np.isfinite(smooth), smooth, small)
    # Both windows show the same: their errors are one. So is what starts differ by, beyond what weak texture explains.
    share = variance / (variance + wide)
    mean = (1.0 - share) * small + share * smooth
    total = ((1.0 - share) * np.sqrt(variance) + share * np.sqrt(wide)) ** 2
    total += share * (1.0 - share) * (small - smooth) ** 2
    total += np.maximum((first - mean) ** 2 - START_SIGMAS**2 * variance - STARTS_PX**2, 0.0)
    return mean, np.sqrt(total + (RELIEF * _relief(mean)) ** 2 + SMALLEST_SIGMA_PX**2), share


def _mixture(one: Refined, two: Refined, field: FloatArray, wide: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and variance of the disparity where windows from two starts found two, or one of them none. (h, w) [px]

    Each is as likely as the light that it leaves says: exp(-chi^2 / 2), of which `CORRELATED`^2 are one measurement;
    times Cauchy's law about the `field` (h, w) [px], whose variance is `wide` (h, w) [px2]: rocks are off it by far.
    """
    free = ((2 * HALF_PX + 1) ** 2 - 5) / CORRELATED**2
    table = np.array([(a.disparity, a.variance, a.misfit) for a in (one, two)])
    places, errors, misfits = table.swapaxes(0, 1)
    none = np.isnan(places)
    squares = np.where(none, np.inf, misfits**2)
    with np.errstate(invalid="ignore"):
        about = 1.0 + np.nan_to_num((places - field) ** 2 / wide)
        weights = np.exp(-0.5 * free * (squares / squares.min(axis=0) - 1.0)) / about
        weights = np.nan_to_num(weights / weights.sum(axis=0))
    places[none] = errors[none] = 0.0
    mean = (weights * places).sum(axis=0)
    variance = (weights * (errors + (places - mean) ** 2)).sum(axis=0)
    return np.where(none.all(axis=0), np.nan, mean), np.where(none.all(axis=0), np.nan, variance)


def _warped(values: npt.NDArray[Any], places: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """A picture at places (u, v) (h, w, 2) of it [px]; 0 beyond its border and where a place is NaN. (h, w)"""
    maps = np.nan_to_num(places, nan=-9.0)
    return np.asarray(
        cv2.remap(values.astype(np.float32), maps[..., 0], maps[..., 1], cv2.INTER_LANCZOS4, borderValue=0)
    )


def _semi_global(pictures: list[npt.NDArray[np.float32]], span: tuple[float, float]) -> FloatArray:
    """Disparity by OpenCV, in steps of a sixteenth of a pixel; NaN where it finds none. (h, w) [px]

    `pictures` are the rectified left and right one (h, w), `span` the largest and the least disparity [px].
    """
    eight = [_even(p) for p in pictures]
    lowest = max(math.floor(span[1]) - 1, 0)
    count = 16 * math.ceil((span[0] + 2 - lowest) / 16)
    matcher = cv2.StereoSGBM_create(
        minDisparity=lowest,
        numDisparities=count,
        blockSize=BLOCK_PX,
        P1=8 * BLOCK_PX**2,
        P2=32 * BLOCK_PX**2,
        disp12MaxDiff=1,
        uniquenessRatio=5,
        speckleWindowSize=100,
        speckleRange=2,
        preFilterCap=63,
        mode=cv2.STEREO_SGBM_MODE_SGBM,
    )
    # A border as wide as the disparities keeps the left side of the picture.
    padded = [cv2.copyMakeBorder(p, 0, 0, count, 0, cv2.BORDER_REPLICATE) for p in eight]
    disparity = np.asarray(matcher.compute(*padded)[:, count:], dtype=float) / 16
    return np.where((disparity >= lowest) & (disparity <= np.arange(disparity.shape[1])), disparity, np.nan)


def _even(picture: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    """A picture with the same contrast everywhere, so that smooth ground is no tie, of which the least disparity wins:
    two standard deviations of the light about a pixel fill 8 bits. (h, w)"""
    light = picture.astype(float)
    rest = light - _mean_in_window(light, ABOUT_PX)[0]
    spread = _mean_in_window(rest**2, ABOUT_PX)[0] + (1e-3 * light.max()) ** 2
    return np.asarray(np.clip(127.5 * (1.0 + 0.5 * rest / np.sqrt(spread)), 0, 255), dtype=np.uint8)


def _mean_in_window(values: FloatArray, side: int) -> tuple[FloatArray, FloatArray]:
    """Mean of what is known in a square window about each pixel, and the share of it that is. (h, w), (h, w)"""
    valid = np.isfinite(values)
    share = cv2.blur(valid.astype(float), (side, side))
    return cv2.blur(np.where(valid, values, 0.0), (side, side)) / np.maximum(share, 1e-9), share


class _Planes(NamedTuple):
    """Planes of least squares through what is known in a square window about each pixel. (h, w) each

    Attributes
    ----------
    middle : of the plane at the pixel; NaN where less than a tenth of the window is known.
    slope_u, slope_v : its change along u and v; held at 0 as far as the window is not known. [1/px]
    rms : of values about it.
    """

    middle: FloatArray
    slope_u: FloatArray
    slope_v: FloatArray
    rms: FloatArray

    @classmethod
    def of(cls, values: FloatArray, side: int, weight: FloatArray | float = 1.0) -> "_Planes":
        """Through values (h, w) with weights (h, w) in windows of `side` pixels."""
        known = np.isfinite(values) & (weight > 0)
        w, d = np.where(known, weight, 0.0), np.where(known, values, 0.0)
        share = cv2.blur(known.astype(float), (side, side))
        total = np.maximum(cv2.blur(w, (side, side)), 1e-30)

        def mean(product: FloatArray) -> FloatArray:
            return np.asarray(cv2.blur(w * product, (side, side)) / total)

        v, u = np.mgrid[: d.shape[0], : d.shape[1]].astype(float)
        mu, mv, md = mean(u), mean(v), mean(d)
        uu, vv, uv = mean(u * u) - mu**2 + 1.0 - share, mean(v * v) - mv**2 + 1.0 - share, mean(u * v) - mu * mv
        dd, du, dv = mean(d * d) - md**2, mean(d * u) - md * mu, mean(d * v) - md * mv
        by = np.maximum(uu * vv - uv**2, 1e-9)
        slopes = [np.clip(s / by, -STEEPEST, STEEPEST) for s in (vv * du - uv * dv, uu * dv - uv * du)]
        middle = md + slopes[0] * (u - mu) + slopes[1] * (v - mv)
        left = dd - slopes[0] * du - slopes[1] * dv
        middle = np.where(share > FEWEST, middle, np.nan)
        return cls(middle, slopes[0], slopes[1], np.sqrt(np.maximum(left, 0.0)))


def _scaled(values: npt.NDArray[Any], shape: tuple[int, int]) -> npt.NDArray[Any]:
    """Values on another number of pixels (h, w), means where these are fewer, linear between them where more."""
    fewer = shape[0] < values.shape[0]
    return np.asarray(cv2.resize(values, shape[::-1], interpolation=cv2.INTER_AREA if fewer else cv2.INTER_LINEAR))


def _field(left: npt.NDArray[np.float32], right: npt.NDArray[np.float32], first: FloatArray) -> Refined:
    """Smooth disparities from wide windows in pictures from coarse to fine; `first` (h, w) is where they begin. [px]

    Their `sigma` is that of a window; `misfit` and `row_offset` are those of windows in the last pictures.
    """
    shape = first.shape
    tall, wide = (math.ceil(n / LEVELS[0]) * LEVELS[0] for n in shape)
    ends = (0, tall - shape[0]), (0, wide - shape[1])
    one, two = (np.pad(p, ends, mode="edge") for p in (left, right))
    known = np.pad(np.isfinite(first).astype(float), ends)
    small = tall // LEVELS[0], wide // LEVELS[0]
    with np.errstate(invalid="ignore"):
        start = _scaled(np.pad(np.nan_to_num(first), ends), small) / _scaled(known, small) / LEVELS[0]
    planes = _Planes.of(start, WIDE_SMOOTH_PX)
    planes = planes._replace(middle=np.where(np.isfinite(start), planes.middle, np.nan))
    for level in LEVELS:
        small = tall // level, wide // level
        ratio = small[0] / planes.middle.shape[0]
        middle, u, v = (_scaled(a, small) for a in planes[:3])
        begun = _scaled(one, small), _scaled(two, small), ratio * middle, (u, v)
        windows = refine(*begun, half_px=WIDE_HALF_PX)
        weight = np.nan_to_num(1.0 / (windows.sigma**2 + SMALLEST_SIGMA_PX**2))
        planes = _Planes.of(windows.disparity, WIDE_SMOOTH_PX, weight)
        planes = planes._replace(middle=np.where(np.isfinite(planes.middle), planes.middle, ratio * middle))
    disparity, sigma = level * planes.middle, level * windows.sigma
    windows = windows._replace(disparity=disparity, sigma=sigma, slope_u=planes.slope_u, slope_v=planes.slope_v)
    return Refined(*(_scaled(a, (tall, wide))[: shape[0], : shape[1]] for a in windows))


def _rows_in_line(
    pictures: list[npt.NDArray[np.float32]], first: FloatArray, names: str
) -> tuple[float, npt.NDArray[np.float32]]:
    """By how much rows of the right picture are moved at its middle [px], and it with its rows on the left one's.

    A calibration that is a little off leaves them apart; the distance is a plane over the picture. Raises DataError
    where it is large, or scatters as in no pair of one moment.
    """
    right, total = pictures[1], 0.0
    height, width = right.shape
    grid = np.mgrid[:height, :width].astype(np.float32)
    for _ in range(2):
        refined = refine(pictures[0], right, first, _Planes.of(first, 11)[1:3], step_px=12, rows=True)
        good = (refined.variance < COARSE_PX**2) & (np.abs(refined.row_offset) < ROW_PX)
        if good.sum() < 50:
            return total, right
        v, u = np.nonzero(good)
        terms = np.column_stack([np.ones(len(u)), u / width - 0.5, v / height - 0.5])
        plane, _ = robust_fit(terms, refined.row_offset[good])
        total += float(plane[0])
        scatter = robust_scatter(refined.row_offset[good] - terms @ plane)
        reasons = {
            f"rows of the pictures are {abs(total):.1f} px apart; is the rig another one?": abs(total) > ROW_PX,
            f"rows are apart unevenly, by {scatter:.1f} px; did the rover move between them, is one turned, or the rig "
            "another one?": scatter > UNEVEN_PX,
        }
        refuse(reasons, names, DataError)
        shift = plane[0] + plane[1] * (grid[1] / width - 0.5) + plane[2] * (grid[0] / height - 0.5)
        right = _warped(right, np.stack([grid[1], grid[0] + shift], axis=-1).astype(np.float32))
    return total, right


def _reasons(
    pictures: list[npt.NDArray[np.float32]],
    full: list[npt.NDArray[np.bool_]],
    disparity: FloatArray,
    sigma: FloatArray,
    frame: Rectified,
) -> npt.NDArray[np.uint8]:
    """Why a pixel has no disparity, by its number in `REASONS`; the first reason that holds. (h, w)

    pictures, full : the rectified left and right one, and where they are saturated. (h, w) each
    disparity, sigma : disparities and their errors. (h, w) [px]
    frame : the rectified frame.
    """
    window = (2 * HALF_PX + 1,) * 2
    light = cv2.boxFilter(pictures[0], -1, window)
    black = float(np.percentile(pictures[0], 0.5))
    bright = float(np.percentile(pictures[0], 90)) - black
    reach, last = HALF_PX + 0.5, np.array(frame.shape[::-1]) - HALF_PX - 1.5
    inside = ((frame.maps[0] >= reach) & (frame.maps[0] <= last)).all(axis=-1)
    reason = np.full(frame.shape, MATCHED, dtype=np.uint8)
    for code, mask in (
        (NO_MATCH, ~np.isfinite(disparity)),
        (OCCLUDED, _occluded(disparity)),
        (NO_TEXTURE, sigma > COARSE_PX),
        (SHADOW, light - black < DARK * bright),
        (SATURATED, cv2.boxFilter(full[0].astype(np.float32), -1, window) > 1e-6),
        (EDGE, ~inside | (np.arange(frame.shape[1]) - np.nan_to_num(disparity) < HALF_PX + 2)),
    ):
        reason[mask] = code
    return reason


def _occluded(first: FloatArray) -> npt.NDArray[np.bool_]:
    """Pixels whose place in the right picture belongs to something nearer. (h, w)"""
    height, width = first.shape
    valid = np.isfinite(first)
    v, u = np.nonzero(valid)
    there = np.clip(np.rint(u - first[valid]).astype(int), 0, width - 1)
    nearest = np.zeros((height, width))
    np.maximum.at(nearest, (v, there), first[valid])
    hidden = np.zeros((height, width), dtype=bool)
    hidden[valid] = nearest[v, there] > first[valid] + 1.5
    return hidden


def _islands(disparity: FloatArray) -> npt.NDArray[np.bool_]:
    """Pixels of small patches that are off the ground about them, or have none about them. (h, w)"""
    valid = np.isfinite(disparity)
    steps = np.where(valid, np.rint(16 * np.nan_to_num(disparity)), -1).astype(np.int16)
    ground = cv2.filterSpeckles(steps, -1, ISLAND_PX, 16 * ISLAND_STEP_PX)[0] >= 0
    mean, share = _mean_in_window(np.where(ground, disparity, np.nan), ABOUT_PX)
    off = np.abs(np.nan_to_num(disparity) - mean) > ISLAND_OFF * mean
    return np.asarray(valid & ~ground & ((share < 1e-6) | off))


def _relief(disparity: FloatArray, side: int = 2 * HALF_PX + 1) -> FloatArray:
    """Rms of neighbouring disparities about each window's plane. (h, w) [px]"""
    return _Planes.of(disparity, side).rms
