"""Cameras calibrated with pictures of a chessboard or another flat target."""

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError, RequestError
from lunarsci.images.calibration import (
    BoardTarget,
    CameraCalibration,
    Sighting,
    alike_turned,
    calibrate,
    check_board,
    find_target,
    of_moments,
    pictures_matching,
)
from lunarsci.images.camera import COARSE_PX, INTRINSICS, UNSTATED, StereoRig, is_swapped, vector_of
from lunarsci.images.jobs.requests import CalibrateCamerasRequest
from lunarsci.images.pictures import Picture, read_picture
from lunarsci.images.rig_files import camera_text, rig_text
from lunarsci.io.inputs import InputFile
from lunarsci.options import request_of
from lunarsci.ranges import refuse
from lunarsci.result import Doubt, Figures, Result, job

SOURCES = [
    "Brown (1971), Photogramm. Eng. 37, 855: lens distortion",
    "Zhang (2000), IEEE Trans. PAMI 22, 1330, 10.1109/34.888718: calibration with a flat target",
    "Duda & Frese (2018), Br. Mach. Vis. Conf.: corners of chessboards",
    "Foerstner & Guelch (1987), ISPRS Intercomm. Conf. Fast Process. Photogramm. Data: their places",
    "Bell & McCaffrey (2002), Surv. Methodol. 28, 169: errors from clusters",
]
SIDES = ("left", "right")
UNDETERMINED = UNSTATED[0]
"""Errors as shares of the focal length, the picture's width and the baseline, from which these are not determined: a
file without errors says as much, as `UNSTATED`."""
SWAPPED = (
    "left and right are swapped, or both cameras are upside down: the camera of `right` stands left of the other one; "
    "give its pictures first, and the others as `right`"
)
CELLS = 8


def board_target(request: CalibrateCamerasRequest) -> BoardTarget:
    """The board as a target. Raises ParameterError."""
    columns, rows = map(int, request.board.split("x"))
    return BoardTarget(
        kind=request.target,
        columns=columns,
        rows=rows,
        square_m=request.square,
        marker_m=request.marker,
        circle_m=request.circle,
        dictionary=request.dictionary,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CalibratedCameras(Result):
    """One camera, or a stereo rig, from pictures of a board.

    Attributes
    ----------
    calibration : the cameras, and how well they fit.
    used : moments that were used, each as the files of one camera or of both.
    points : how many points each picture shows, by its file, None where it has no board.
    request : what was asked.
    inputs : SHA-256 of each file by its name.
    """

    schema: ClassVar[str] = "images-calibrate/1"
    sources = SOURCES
    calibration: CameraCalibration
    used: tuple[tuple[str, ...], ...]
    points: Mapping[str, int | None]
    request: CalibrateCamerasRequest
    inputs: Mapping[str, str]

    @property
    def swapped(self) -> bool:
        """Whether the camera of the right pictures stands left of the other one."""
        return len(self.calibration.cameras) > 1 and is_swapped(self.calibration.translation_m)

    @property
    def doubt(self) -> Doubt:
        if self.calibration.residual_px > COARSE_PX:
            return Doubt.of(
                f"the board's points are off by {self.calibration.residual_px:.2g} px; is it flat, and its size right?"
            )
        if self.swapped:
            return Doubt.of(SWAPPED)
        vital = [line for line in self.not_determined() if line.startswith(("focal", "baseline"))]
        return Doubt.of(f"these pictures do not determine the {vital[0]}" if vital else "")

    def to_dict(self) -> dict[str, Any]:
        fit = self.calibration
        cameras = [
            {"width_px": camera.width_px, "height_px": camera.height_px}
            | self._numbers(k)
            | {"residual_rms_px": float(np.sqrt(np.mean(fit.residuals[k][:, 3:] ** 2)))}
            | {"seen_share": _seen_share(fit, k)}
            | {"corner_uncertainty_px": float(np.nanmax(self._uncertainty(k)))}
            for k, camera in enumerate(fit.cameras)
        ]
        result: dict[str, Any] = {
            "cameras": dict(zip(SIDES, cameras, strict=False)) if len(cameras) > 1 else {"camera": cameras[0]},
            "residual_px": fit.residual_px,
            "errors_between_pictures": fit.between_pictures,
            "tilt_deg": fit.tilt_deg,
            "left_out_points": fit.left_out,
            "pictures": self.rows(),
            "not_determined": self.not_determined(),
            "notes": self.notes(),
        }
        if len(cameras) > 1:
            result |= {"baseline_m": fit.baseline_m, "baseline_m_sigma": self._baseline_sigma()}
            result |= {"rotation_rad": [float(v) for v in vector_of(fit.rotation)]}
            result |= {"translation_m": [float(v) for v in fit.translation_m]}
        return result

    def _numbers(self, index: int) -> dict[str, float]:
        """Intrinsics of a camera with their errors."""
        vector = self.calibration.cameras[index].vector()
        sigma = self.calibration.covariance.diagonal()[9 * index : 9 * index + 9] ** 0.5
        cells: dict[str, float] = {}
        for name, value, error in zip(INTRINSICS, vector, sigma, strict=True):
            cells |= {name: float(value), f"{name}_sigma": float(error)}
        return cells

    def _uncertainty(self, index: int) -> FloatArray:
        """Of directions at 7 x 7 places of the picture, its corners among them; NaN where there is none. (49,) [px]"""
        right, low = (n - 1.0 for n in self.calibration.cameras[index].size)
        places = np.array([[u, v] for u in np.linspace(0, right, 7) for v in np.linspace(0, low, 7)])
        return self.calibration.uncertainty_px(index, places)

    def _baseline_sigma(self) -> float:
        way = self.calibration.translation_m / self.calibration.baseline_m
        return math.sqrt(float(way @ self.calibration.covariance[-3:, -3:] @ way))

    def not_determined(self) -> list[str]:
        """What these pictures leave open, with its value and error."""
        lines = []
        for k, camera in enumerate(self.calibration.cameras):
            side = f" of the {camera.name}" if len(self.calibration.cameras) > 1 else ""
            cells = self._numbers(k)
            for name, largest in (
                ("fx_px", UNDETERMINED * camera.fx_px),
                ("fy_px", UNDETERMINED * camera.fy_px),
                ("cx_px", UNDETERMINED * camera.width_px),
                ("cy_px", UNDETERMINED * camera.height_px),
                *((term, 0.5 * abs(cells[term])) for term in ("k1", "k2", "k3", "p1", "p2")),
            ):
                if cells[f"{name}_sigma"] > largest:
                    word = "focal length" if name[0] == "f" else "principal point" if name[0] == "c" else "distortion"
                    lines.append(f"{word} {name}{side}: {cells[name]:.4g} ± {cells[f'{name}_sigma']:.2g}")
        if self.calibration.baseline_m and self._baseline_sigma() > UNDETERMINED * self.calibration.baseline_m:
            lines.append(f"baseline: {self.calibration.baseline_m:.4g} ± {self._baseline_sigma():.2g} m")
        return lines

    def notes(self) -> list[str]:
        """What the numbers rest on, and what would make them better."""
        fit = self.calibration
        notes = [f"errors are those of the residuals, {max(fit.between_pictures, 1):.2g} times, as pictures differ"]
        for k, camera in enumerate(fit.cameras):
            share = _seen_share(fit, k)
            notes.append(f"the board was seen in {share:.0%} of the {camera.name}'s picture; beyond is extrapolated")
            hint = "see the board there, or find fewer terms (--distortion)"
            edge = self._uncertainty(k)
            if np.isnan(edge).any():
                notes.append(f"the {camera.name}'s terms leave its edge without directions: {hint}")
            elif edge.max() > COARSE_PX:
                notes.append(
                    f"directions at the {camera.name}'s edge are uncertain by up to {edge.max():.1f} px: {hint}"
                )
        if fit.tilt_deg < 30:
            notes.append(f"normals of the board lie within {fit.tilt_deg:.0f} deg; more tilt gives the focal length")
        held = {0: "k1 k2 k3 p1 p2", 1: "k2 k3 p1 p2", 2: "k3 p1 p2", 4: "k3", 5: ""}[self.request.distortion]
        if held:
            notes.append(f"held at 0: {held}")
        if "circles" in self.request.target and not self.request.circle:
            notes.append("middles of the circles' pictures are not quite those of circles: give --circle")
        if len(fit.cameras) > 1:
            notes.append(f"the board's size is taken as right to {self.request.square_error:.2%} (--square-error)")
        return notes

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """One a picture: points found, and what is left of them."""
        left = {
            names[index]: rows[rows[:, 0] == k, 3:]
            for index, rows in enumerate(self.calibration.residuals) for k, names in enumerate(self.used)
        }  # fmt: skip
        table = []
        for name, count in self.points.items():
            off = np.abs(left.get(name, np.empty((0, 2))))
            rms, largest = (float(np.sqrt(np.mean(off**2))), float(off.max())) if len(off) else (None, None)
            row = {"file": name, "points": count or 0, "used": len(off), "rms_px": rms, "largest_px": largest}
            table.append(row)
        return table

    def figures(self) -> Figures:
        from lunarsci.images.figures import calibration_page

        yield calibration_page(self.calibration, self.request.name)

    def rig(self) -> StereoRig:
        """The stereo rig. Raises ParameterError for a single camera."""
        if len(self.calibration.cameras) < 2:
            raise ParameterError("one camera is no stereo rig; give the right camera's pictures too, as `right`")
        return StereoRig(
            name=self.request.name,
            left=self.calibration.cameras[0],
            right=self.calibration.cameras[1],
            rotation=self.calibration.rotation,
            translation_m=self.calibration.translation_m,
            covariance=self.calibration.covariance,
            assumed=("bits", "full_well_e", "read_noise_e", "mtf_at_nyquist", "the target's size"),
            source=self._source("moments"),
        )

    def as_input(self, role: str) -> dict[str, Callable[[], bytes]]:
        return {"rig.toml": self.toml} if role in ("rig", "sources") else {}

    def toml(self) -> bytes:
        """The file of the rig, or of the camera, that `images cameras` reads."""
        if len(self.calibration.cameras) > 1:
            return rig_text(self.rig()).encode()
        camera, covariance = self.calibration.cameras[0], self.calibration.covariance
        return camera_text(camera, covariance, name=self.request.name, source=self._source("pictures")).encode()

    def _source(self, what: str) -> str:
        return (
            f"calibrated with a {self.request.target}, {len(self.used)} {what}, {self.calibration.residual_px:.2f} px"
        )


def _with_scale(fit: CameraCalibration, square_error: float) -> CameraCalibration:
    """The calibration with the error of the target's size in its translation."""
    covariance = fit.covariance.copy()
    if len(fit.cameras) > 1:
        covariance[-3:, -3:] += square_error**2 * np.outer(fit.translation_m, fit.translation_m)
    return dataclasses.replace(fit, covariance=covariance)


def _seen_share(fit: CameraCalibration, index: int) -> float:
    """Share of the cells of a picture, 8 x 8, in which a point of the board was seen."""
    size = np.array(fit.cameras[index].size, dtype=float)
    cells = np.clip((fit.residuals[index][:, 1:3] / size * CELLS).astype(int), 0, CELLS - 1)
    return len(np.unique(cells, axis=0)) / CELLS**2


@job
def calibrate_cameras(
    pictures: str | Sequence[str | Path | InputFile],
    right: str | Sequence[str | Path | InputFile] = (),
    request: CalibrateCamerasRequest | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> CalibratedCameras:
    """Calibrate one camera with pictures of a board, or a stereo rig with `pictures` of its left and `right` camera.

    Both are files, or a pattern; pictures of both cameras belong together by the numbers in their names, else in their
    order. Raises RequestError, ParameterError, and DataError where the board is seen too seldom or from one side.

    Examples
    --------
    >>> rig = lunarsci.calibrate_cameras("left*.png", "right*.png", board="9x6", square=0.03)  # doctest: +SKIP
    """
    request = request_of(CalibrateCamerasRequest, request, options)
    target, steps = board_target(request), progress or (lambda *_: None)
    first = pictures_matching([pictures]) if isinstance(pictures, str) else pictures
    second = pictures_matching([right], "right") if isinstance(right, str) else right
    sides = [list(side) for side in (of_moments(first, second) if second else (first,))]
    shown = [[read_picture(one) for one in side] for side in sides]
    if not all(shown):
        raise RequestError("no pictures; give those of the board")
    refuse(_faults(shown), "", DataError)
    count = 1 + sum(map(len, shown))
    seen = []
    for n, side in enumerate(shown):
        before = n * len(side)
        seen.append(_sightings(side, target, lambda k, before=before: steps(before + k, count)))  # type: ignore[misc]
    if len(shown) > 1 and target.kind != "charuco":
        seen[1] = [b if a is None or b is None else alike_turned(a, b, target) for a, b in zip(*seen, strict=True)]
    names = [[picture.source.name for picture in side] for side in shown]
    moments = [(tuple(s[k] for s in seen), tuple(n[k] for n in names)) for k in range(len(sides[0]))]
    used = [(view, files) for view, files in moments if any(s is not None for s in view)]
    fit = calibrate([v for v, _ in used], target, [side[0].size for side in shown], distortion=request.distortion)
    steps(count, count)
    return CalibratedCameras(
        calibration=_with_scale(fit, request.square_error),
        used=tuple(files for _, files in used),
        points={
            name: None if s is None else len(s.numbers)
            for side, sightings in zip(names, seen, strict=True) for name, s in zip(side, sightings, strict=True)
        },
        request=request,
        inputs={p.source.name: p.source.sha256 for side in shown for p in side},
    )  # fmt: skip


def _sightings(pictures: Sequence[Picture], target: BoardTarget, step: Callable[[int], None]) -> list[Sighting | None]:
    """Where each picture of a camera shows the board; where a short look finds it in some, others get a long one."""
    seen: list[Sighting | None] = []
    for k, picture in enumerate(pictures):
        seen.append(find_target(picture, target, patient=False))
        step(k + 1)
    check_board(pictures, seen, target)
    if any(seen):
        seen = [find_target(p, target) if s is None else s for p, s in zip(pictures, seen, strict=True)]
    return seen


def _faults(shown: Sequence[Sequence[Picture]]) -> Iterator[str]:
    """What speaks against the pictures of one camera or two."""
    names = [picture.source.name for side in shown for picture in side]
    yield from (f"{name}: is given twice; each picture counts once" for name in names if names.count(name) > 1)
    for side in shown:
        for picture in side:
            if picture.size != side[0].size:
                sizes = (" x ".join(map(str, p.size)) for p in (picture, side[0]))
                yield f"{picture.source.name}: {' px, the first one '.join(sizes)}; one camera has one size"
