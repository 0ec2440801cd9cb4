"""Heights with errors from a pair of pictures."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from scipy.linalg import block_diag

from lunarsci.errors import DataError
from lunarsci.heights import TERRAINS
from lunarsci.images.adjustment import leaning
from lunarsci.images.camera import Pose, StereoRig
from lunarsci.images.elevation import ElevationModel, elevation_bytes, elevation_geotiff
from lunarsci.images.gridding import cloud_of, cloud_ply, grid_of, levelled
from lunarsci.images.jobs.requests import CamerasRequest, DemRequest
from lunarsci.images.matching import StereoMatches, match
from lunarsci.images.pictures import Picture, read_picture
from lunarsci.images.reliability import MARIA, Reliability, check_sides, reliability, ties_of
from lunarsci.images.rig_files import check_pictures, read_pose, read_rig
from lunarsci.io.inputs import Source, read_input
from lunarsci.options import request_of
from lunarsci.result import Doubt, Figures, Progress, Result, job

SOURCES = [
    "Brown (1971), Photogramm. Eng. 37, 855: lens distortion",
    "Hirschmueller (2008), IEEE Trans. PAMI 30, 328, 10.1109/TPAMI.2007.1166: semi-global matching",
    "Baarda (1968), Neth. Geod. Comm. 2, 5: which gross error contradicts a rig",
    "Gruen (1985), S. Afr. J. Photogramm. Remote Sens. Cartogr. 14, 175: adaptive least squares correlation",
]
STATEMENTS = (
    "a height is the mean over its cell and over the matching window, which smooths edges of rocks and tracks",
    "common errors are those of the rig's covariance and of the pose's tilt",
)
HONEST = 3.0
"""Heights are gridded as far as the range's error is so many cells, at the disparity's error by which `images cameras`
judges ranges; assumed. Option `farthest` says otherwise."""
RANGES_M = (0.0, 2.0, 3.0, 4.0, 6.0, 9.0, 15.0, math.inf)
"""Ends of the ranges that errors of heights are listed by. [m]"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StereoTerrain(Result):
    """An elevation model, and the matches that it was made of.

    Attributes
    ----------
    model : heights of the ground with their errors.
    matches : of the two pictures.
    rig : that took them.
    pose : of its left camera.
    farthest_m : range up to which points count. [m]
    levelled : whether the pose is one above level ground that was fitted to the points, not a given one.
    reliability : what the pictures say of rig, mast and pose; None where they show too little in common.
    inputs : SHA-256 of each file by its name.
    """

    schema: ClassVar[str] = "images-dem/1"
    sources = SOURCES
    model: ElevationModel
    matches: StereoMatches
    rig: StereoRig
    pose: Pose
    levelled: bool
    farthest_m: float
    reliability: Reliability | None
    inputs: Mapping[str, str]

    @property
    def doubt(self) -> Doubt:
        return Doubt.of(*self.reliability.doubts() if self.reliability else ())

    def to_dict(self) -> dict[str, Any]:
        return {
            "terrain": self.model.summary(),
            "rig": self.rig.summary(),
            "pose": self.pose.to_dict() | {"levelled": self.levelled},
            "pixels": self.matches.shares(),
            "row_offset_px": self.matches.row_offset_px,
            "reliability": self.reliability and self.reliability.to_dict(),
            "ranges": self.rows(),
            "notes": self.notes(),
        }

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """One a ring of ranges: nodes, and medians of their errors."""
        model = self.model
        x, y = np.meshgrid(model.x_m - self.pose.center_m[0], model.y_m - self.pose.center_m[1])
        away = np.sqrt(x**2 + y**2 + (model.height_m - self.pose.center_m[2]) ** 2)
        rings: list[dict[str, Any]] = []
        for low, high in pairwise(RANGES_M):
            inside = (away >= low) & (away < high)
            if inside.any():
                medians = {
                    f"median_{key}": float(np.nanmedian(model.layer(key)[inside]))
                    for key in ("height_m_sigma", "height_m_common_sigma", "count", "resolution_m")
                }
                top = float(away[inside].max()) if math.isinf(high) else high
                rings.append({"range_from_m": low, "range_to_m": top, "nodes": int(inside.sum())} | medians)
        return rings

    def layers(self) -> dict[str, Any]:
        return self.model.layers()

    def figures(self) -> Figures:
        from lunarsci.images.figures import dem_figure

        yield dem_figure(self.model, self.matches, self.pose)

    def as_input(self, role: str) -> dict[str, Callable[[], bytes]]:
        return {"dem.npz": lambda: self.terrain_bytes(".npz")} if role in TERRAINS else {}

    def terrain_bytes(self, ending: str) -> bytes:
        """The model as .npz or GeoTIFF."""
        return elevation_bytes(self.model) if ending == ".npz" else elevation_geotiff(self.model)

    def disparity_bytes(self, ending: str) -> bytes:
        """What was matched as .npz or .png."""
        return self.matches.archive() if ending == ".npz" else self.matches.picture()

    def cloud_bytes(self) -> bytes:
        """The points within the range of the model as PLY, in the world."""
        cloud = cloud_of(self.matches, self.pose, self.farthest_m)
        return cloud_ply(cloud, self.matches.left[cloud.pixels[:, 0], cloud.pixels[:, 1]])

    def notes(self) -> list[str]:
        """What there is to say about heights and rig."""
        notes = [*STATEMENTS]
        if self.levelled:
            notes.append(
                "no pose was given: the ground near the rover is taken as level, give or take slopes of lunar maria "
                f"({math.degrees(MARIA):.0f}° along a line); --pose and --tilt-error state the tilt and its error"
            )
        notes += [f"rig read as: {note}" for note in self.rig.read_as]
        if self.rig.assumed:
            notes.append(f"the rig ({self.rig.name}) assumes: {', '.join(self.rig.assumed)}")
        if self.model.synthetic:
            notes.append("the pictures are SYNTHETIC")
        return notes


@job
def dem(
    left: Source,
    right: Source,
    request: DemRequest | None = None,
    *,
    progress: Progress | None = None,
    **options: Any,
) -> StereoTerrain:
    """Heights on a grid from the left and the right picture of a stereo rig, each with its errors.

    Raises DataError where the pictures are none, do not belong to the rig or do not match, and says why.

    Examples
    --------
    >>> demo = ("lunarsci-demo/left.png", "lunarsci-demo/right.png")
    >>> ground = lunarsci.dem(*demo, rig="lunarsci-demo/rig.toml", pose="lunarsci-demo/pose.toml")
    """
    request = request_of(DemRequest, request, options)
    files = read_input(left), read_input(right)
    pictures = [read_picture(file) for file in files]
    names = request.rig.split(",") if request.rig.count(",") == 1 else [request.rig]
    rig = read_rig(*names, picture_px=pictures[0].size)
    check_pictures(rig, pictures)
    pose = None if request.pose is None else read_pose(request.pose)
    nearest = request.nearest or nearest_ground_m(rig, pose, rig.height_m)
    farthest = request.farthest or farthest_ground_m(rig, request.spacing)
    ties = ties_of(*pictures)
    both = ", ".join(file.name for file in files)
    check_sides(rig, ties, both)
    known = reliability(rig, ties, pose, request.tilt_error)
    try:
        matches = match(pictures[0], pictures[1], rig, nearest_m=nearest, progress=progress)
    except DataError as error:
        if known and (doubts := known.doubts()):
            raise DataError(f"{both}: {'; '.join(doubts)}") from error
        raise
    place = pose or levelled(matches, rig.height_m)
    leant = math.radians(request.tilt_error) if pose else MARIA
    model = grid_of(
        matches,
        rig,
        place,
        name=files[0].stem,
        spacing_m=request.spacing,
        farthest_m=farthest,
        covariance=block_diag(leaning(leant, rig.height_m), rig.covariance),
        synthetic=synthetic(rig, *pictures),
    )
    inputs = {file.name: file.sha256 for file in files}
    inputs |= {} if request.pose is None else {request.pose: read_input(request.pose).sha256}
    return StereoTerrain(
        model=model,
        matches=matches,
        rig=rig,
        pose=place,
        levelled=pose is None,
        farthest_m=farthest,
        reliability=known,
        inputs=inputs,
    )


def synthetic(rig: StereoRig, *pictures: Picture) -> bool:
    """Whether a rig or a picture of it says that it is made up."""
    return "SYNTHETIC" in rig.name or any(b"SYNTHETIC" in picture.source.data[:4000] for picture in pictures)


def nearest_ground_m(rig: StereoRig, pose: Pose | None, mast_m: float) -> float:
    """Depth of what may be nearest in a picture of level ground, with a quarter to spare for what stands on it. [m]"""
    if pose is None:
        return max(0.6 * mast_m, 0.6 * rig.nearest_m)
    width, height = rig.left.size
    rays = rig.left.rays([[u, height - 1.0] for u in (0.0, 0.5 * width, width - 1.0)])
    steep = -np.nanmin((rays / np.linalg.norm(rays, axis=1, keepdims=True) @ pose.rotation.T)[:, 2])
    slant = mast_m / max(float(steep), 0.05)
    return max(0.7 * slant / float(np.linalg.norm(rays, axis=1).max()), 0.3 * mast_m)


def farthest_ground_m(rig: StereoRig, spacing_m: float) -> float:
    """Range at which its error is three cells. [m]"""
    return math.sqrt(HONEST * spacing_m / float(rig.range_error_m(1.0, CamerasRequest().disparity_error)))
