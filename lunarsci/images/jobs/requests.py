"""What the jobs of this part can be asked: every option with its meaning, its type and its default.

The command line reads it at every start: it imports no module that computes.
"""

import math
import re
from dataclasses import dataclass
from typing import Any, Literal

from lunarsci.errors import RequestError
from lunarsci.images import Law, LengthUnit
from lunarsci.options import check_intervals
from lunarsci.ranges import refuse


def _floats(given: str) -> tuple[float, ...]:
    """Numbers with commas between them; one that is NaN where they are none."""
    try:
        return tuple(float(part) for part in given.split(",") if part.strip())
    except ValueError:
        return (math.nan,)


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrateCamerasRequest:
    """What the pictures show, and what is to be found.

    Attributes
    ----------
    target : What the pictures show.
    board : Columns x rows: inner corners of a chessboard, circles, or squares of a charuco.
    square : Side of a square, or distance of circles (asymmetric: half of that in a row), in m.
    marker : Side of a charuco's markers, in m.
    circle : Diameter of the circles, in m, which corrects their middles; 0 does not.
    dictionary : Dictionary of a charuco's markers, by its name in OpenCV.
    square_error : Error of the board's size, as a share; the baseline has the same.
    distortion : Terms to find: 0, 1 (k1), 2 (k2), 4 (p1, p2) or 5 (k3).
    name : Of the camera or rig.
    """

    target: Literal["chessboard", "circles", "asymmetric-circles", "charuco"] = "chessboard"
    board: str = "9x6"
    square: float = 0.025
    marker: float = 0.0
    circle: float = 0.0
    dictionary: str = "DICT_4X4_50"
    square_error: float = 0.001
    distortion: Literal[0, 1, 2, 4, 5] = 5
    name: str = "calibrated"

    def __post_init__(self) -> None:
        check_intervals(self, {"(0, 100)": "square", "[0, 0.5)": "square_error"})
        reasons = {
            f"`board` is '{self.board}'; give columns and rows, such as 9x6":
                not re.fullmatch(r"\d{1,3}x\d{1,3}", self.board),
            f"`distortion` is {self.distortion}; give 0, 1, 2, 4 or 5 terms": self.distortion not in (0, 1, 2, 4, 5),
            "`marker`: give the side of the markers in m, less than that of `square`":
                self.target == "charuco" and not 0 < self.marker < self.square,
        }  # fmt: skip
        refuse(reasons, kind=RequestError)


@dataclass(frozen=True, slots=True, kw_only=True)
class CamerasRequest:
    """At what precision of matching ranges are judged.

    Attributes
    ----------
    disparity_error : Random error of a disparity, in px, for the ranges' errors.
    translation_unit : Unit of T in a file of OpenCV, which does not state it.
    picture_size : Width x height of the pictures in px, which a file of OpenCV does not state.
    """

    disparity_error: float = 0.2
    translation_unit: LengthUnit | None = None
    picture_size: str | None = None

    def __post_init__(self) -> None:
        check_intervals(self, {"(0, 100)": "disparity_error"})
        if self.picture_size is not None and not re.fullmatch(r"[1-9]\d{0,5}x[1-9]\d{0,5}", self.picture_size):
            raise RequestError(f"`picture_size` is '{self.picture_size}'; give width and height, such as 1280x960")


@dataclass(frozen=True, slots=True, kw_only=True)
class DemRequest:
    """How a pair is to be read.

    Attributes
    ----------
    rig : The cameras: yutu2-pancam, yutu2-navcam, yutu2-hazcam, a TOML file, or the labels LEFT,RIGHT of the pictures.
    pose : Where the left camera was: TOML with position_m, heading_deg, down_deg, roll_deg.
    tilt_error : Error of the pose's down_deg and roll_deg, in deg (assumed).
    spacing : Distance of the nodes, in m.
    nearest : Smallest distance along the axis that is matched, in m.
    farthest : Largest range that is gridded, in m.
    """

    rig: str = "yutu2-navcam"
    pose: str | None = None
    tilt_error: float = 0.3
    spacing: float = 0.02
    nearest: float | None = None
    farthest: float | None = None

    def __post_init__(self) -> None:
        check_intervals(self, {"(0, 10000)": "spacing nearest farthest", "[0, 20]": "tilt_error"})
        if self.nearest is not None and self.farthest is not None and self.nearest >= self.farthest:
            raise RequestError("`nearest` must be below `farthest`")


@dataclass(frozen=True, slots=True, kw_only=True)
class LocateRequest:
    """How stations are to be found.

    Attributes
    ----------
    rig : The cameras of all stations: yutu2-pancam, yutu2-navcam, yutu2-hazcam or a TOML file.
    mast : Middle between both cameras in the rover's frame, in m ahead, left and up: positions are then the rover's.
    drift : Error of dead reckoning as a share of the way between stations (assumed).
    heading_error : Error of the headings in pose.toml, in deg (assumed).
    tilt_error : Error of down_deg and roll_deg in pose.toml, in deg (assumed).
    """

    rig: str = "yutu2-navcam"
    mast: str | None = None
    drift: float = 0.03
    heading_error: float = 1.0
    tilt_error: float = DemRequest().tilt_error

    def __post_init__(self) -> None:
        check_intervals(self, {"(0, 1]": "drift", "(0, 45]": "heading_error", "(0, 20]": "tilt_error"})
        self.mast_m()

    def mast_m(self) -> tuple[float, ...] | None:
        """`mast` as numbers."""
        if self.mast is None:
            return None
        place = _floats(self.mast)
        if len(place) != 3 or not all(map(math.isfinite, place)):
            raise RequestError(f"`mast` is '{self.mast}'; give x,y,z in m, ahead, left and up from the rover's origin")
        return place


RECKONED = LocateRequest()
"""Errors of dead reckoning that `images merge` assumes, too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MergeRequest:
    """How models, or pairs, are laid together.

    Attributes
    ----------
    positions : Where each model belongs, in their order: CSV with x_m, y_m, z_m and xx_m2, xy_m2, yy_m2, zz_m2 or
        sigma_m. Without it they share a frame.
    spacing : Distance of the map's nodes, in m; that of the finest model, or 0.02 m, by default.
    rig : The cameras of all folders: a name or a file as of `dem`. Without it each folder's rig.toml.
    farthest : Largest range that is gridded, in m.
    drift : Error of dead reckoning as a share of the way between stations (assumed).
    heading_error : Error of the headings of the rover from station to station, in deg (assumed).
    tilt_error : Error of the rover's level at each station, in deg (assumed).
    mast_error : Error of the mast's angles from pair to pair of one station, in deg (assumed).
    """

    positions: str | Any | None = None
    spacing: float | None = None
    rig: str | None = None
    farthest: float | None = None
    drift: float = RECKONED.drift
    heading_error: float = RECKONED.heading_error
    tilt_error: float = RECKONED.tilt_error
    mast_error: float = 0.2

    def __post_init__(self) -> None:
        check_intervals(self, {"(0, 1000)": "spacing", "(0, 10000)": "farthest", "(0, 1]": "drift"})
        check_intervals(self, {"(0, 45]": "heading_error", "(0, 20]": "tilt_error", "[0, 20]": "mast_error"})


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderRequest:
    """What is looked at, with what, and from where.

    Attributes
    ----------
    rig : The cameras: yutu2-pancam, yutu2-navcam, yutu2-hazcam, or a TOML file.
    x : Where the left camera is, along x, in m.
    y : Where the left camera is, along y, in m.
    heading : Direction in which it looks, from x towards y, in deg.
    down : Angle below the horizon, in deg.
    roll : Turned clockwise about its axis, in deg.
    height : Height above the ground, in m.
    spacing : Side of the ground's triangles, in m.
    rocks : Rocks of 4 cm and more on a square metre.
    roughness : Factor on the roughness assumed of regolith; 0 leaves the terrain as it is.
    track : Track of the wheels: CSV of x_m, y_m, and rut_m or sinkage_m; the ground is lower there.
    track_width : Width of the wheels, in m.
    sun_azimuth : Azimuth of the Sun, from x towards y, in deg.
    sun_elevation : Elevation of the Sun above the horizon, in deg.
    law : How the ground scatters light.
    samples : Rays along each side of a pixel.
    exact : Take the rig as it is, not a draw from its covariance.
    seed : Seed of ground, noise and the rig's draw.
    """

    rig: str = "yutu2-navcam"
    x: float = 0.0
    y: float = 0.0
    heading: float = 0.0
    down: float = 25.0
    roll: float = 0.0
    height: float | None = None
    spacing: float = 0.01
    rocks: float = 0.5
    roughness: float = 1.0
    track: str | None = None
    track_width: float = 0.15
    sun_azimuth: float = 60.0
    sun_elevation: float = 30.0
    law: Law = "lommel-seeliger"
    samples: int = 2
    exact: bool = False
    seed: int = 1

    def __post_init__(self) -> None:
        check_intervals(
            self, {"[0.001, 1]": "spacing", "[0, 100]": "rocks", "[0, 10]": "roughness", "[1, 8]": "samples"}
        )
        check_intervals(self, {"[0.01, 2]": "track_width", "(0, 90]": "sun_elevation"})


@dataclass(frozen=True, slots=True, kw_only=True)
class RocksRequest:
    """What rocks are looked for, and how the pictures were taken.

    Attributes
    ----------
    rig : The cameras: yutu2-pancam, yutu2-navcam, yutu2-hazcam, a TOML file, or the labels LEFT,RIGHT of the pictures.
    pose : Where the left camera was: TOML with position_m, heading_deg, down_deg, roll_deg.
    sun : Azimuth of the Sun, from x towards y, and elevation, in deg: two numbers with a comma.
    largest : Diameter of the largest rock, in m; what is wider is ground.
    false_share : Share of the finds that may be no rocks.
    sizes : Diameters in m for which it is said how many are found: numbers with commas.
    margin : Further distance to keep from a rock, in m.
    seed : Seed of the rocks put in for trial.
    """

    rig: str = "yutu2-navcam"
    pose: str | None = None
    sun: str | None = None
    largest: float = 0.3
    false_share: float = 0.05
    sizes: str = "0.05,0.07,0.1,0.2"
    margin: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        check_intervals(self, {"[0.04, 5]": "largest", "(0, 1)": "false_share", "[0, 100)": "margin"})
        self.diameters()
        self.sun_deg()

    def sun_deg(self) -> tuple[float, float] | None:
        """`sun` as numbers. Raises RequestError."""
        if self.sun is None:
            return None
        sun = _floats(self.sun)
        if len(sun) != 2 or not (math.isfinite(sun[0]) and 0 < sun[1] <= 90):
            raise RequestError(f"`sun` is '{self.sun}'; give azimuth,elevation in deg, the elevation above 0 to 90")
        return sun[0], sun[1]

    def diameters(self) -> tuple[float, ...]:
        """`sizes` as numbers. Raises RequestError."""
        sizes = _floats(self.sizes)
        if not all(0.01 <= size <= self.largest for size in sizes):
            raise RequestError(f"`sizes` '{self.sizes}': give numbers from 0.01 m to `largest`, commas between them")
        return sizes


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackRequest:
    """Where the track is and what left it.

    Attributes
    ----------
    line : Along the middle of the track: x1,y1,x2,y2,... in m, or a GeoJSON file.
    before : Heights before the drive, with errors. The depth is their difference, and no ground is interpolated.
    rover : Whose wheel it was: a name (yutu2, small-four) or a TOML file.
    width : Width of the wheel in m, in place of the rover's.
    window : Length of track in m that gives one depth.
    step : Distance of the depths, in m.
    search : How far from the line the middle of the track may lie, in m; 0 keeps to the line.
    disparity_bias : Bias of the disparity between the floor and the ground beside it, in px: 0.12 on 8 rendered floors.
    rebound : Share of the sinkage by which the ground rose again after the wheel; assumed.
    """

    line: str = ""
    before: str | None = None
    rover: str = "yutu2"
    width: float | None = None
    window: float = 0.5
    step: float = 0.1
    search: float = 0.05
    disparity_bias: float = 0.1
    rebound: float = 0.0

    def __post_init__(self) -> None:
        if not self.line:
            raise RequestError("`line` says where the track is; give x1,y1,x2,y2,... or a GeoJSON file")
        check_intervals(self, {"(0, 100)": "width window step", "[0, 1]": "search", "[0, 10]": "disparity_bias"})
        check_intervals(self, {"[0, 0.9)": "rebound"})
