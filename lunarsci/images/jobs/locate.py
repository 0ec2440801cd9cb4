"""Where a rover's stations were, from their pictures."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError, RequestError
from lunarsci.images.adjustment import leaning
from lunarsci.images.camera import Pose, StereoRig
from lunarsci.images.jobs.dem import nearest_ground_m, synthetic
from lunarsci.images.jobs.requests import LocateRequest
from lunarsci.images.localisation import ODD_SIGMAS, Localised, Station, localise
from lunarsci.images.matching import match
from lunarsci.images.pictures import Picture, read_picture
from lunarsci.images.rig_files import check_pictures, pose_text, read_pose, read_rig
from lunarsci.io.documents import toml_document
from lunarsci.io.inputs import InputFile, read_input, text
from lunarsci.io.tables import csv_bytes
from lunarsci.memory import AsFiles
from lunarsci.options import request_of
from lunarsci.ranges import refuse
from lunarsci.result import Doubt, Figures, Progress, Result, job

SOURCES = [
    "Lowe (2004), Int. J. Comput. Vis. 60, 91, 10.1023/B:VISI.0000029664.99615.94: features",
    "Barath et al. (2020), Proc. IEEE/CVF Conf. CVPR, 1301, 10.1109/CVPR42600.2020.00138: MAGSAC++",
    "Triggs et al. (2000), 10.1007/3-540-44480-7_21: bundle adjustment",
    "Huber (1964), Ann. Math. Stat. 35, 73, 10.1214/aoms/1177703732: robust weights",
]
SIDES = ("left", "right")
"""Names of the pictures in a station's folder, without their endings."""
ENDINGS = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".img", ".IMG", ".vic", ".VIC", ".xml")
"""Ends of names of pictures, in the order they are looked for."""
FIRST_M = 0.001
"""Error of the first place in the table, which is exact by definition: readers need one above 0; assumed."""
ATTITUDE = ("rover_yaw_deg", "rover_pitch_deg", "rover_roll_deg")
"""Of the rover, in pose.toml: from x towards y, positive nose down, and positive with its left side up."""
AXES = "xyz"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LocatedStations(Result):
    """Where the rover, or its left camera, was, in the frame of the first pose.

    Attributes
    ----------
    localised : poses of the stations with their covariance, and the ties they follow from.
    rig : that took the pictures, as its file has it.
    inputs : SHA-256 of each file by its name.
    synthetic : whether a picture or pose says that it is made up.
    """

    schema: ClassVar[str] = "images-locate/1"
    sources = SOURCES
    localised: Localised
    rig: StereoRig
    inputs: Mapping[str, str]
    synthetic: bool

    @property
    def doubt(self) -> Doubt:
        for number, station in enumerate(self.localised.stations):
            if not self.localised.tied[number]:
                why = "; ".join(r.failure for r in self.localised.reports if r.second == number and r.failure)
                return Doubt.of(f"{station.name} is where dead reckoning puts it: {why}")
        return Doubt.of(*self.overruled())

    def overruled(self) -> list[str]:
        """Steps between stations that pictures place elsewhere than telemetry by more than its errors allow."""
        reasons, stations = [], self.localised.stations
        for number in range(1, len(stations)):
            off = self.localised.off_sigmas(number)
            if self.localised.tied[number] and off > ODD_SIGMAS:
                ways = [
                    float(np.linalg.norm(one[number].center_m - one[number - 1].center_m))
                    for one in ([station.pose for station in stations], self.localised.poses)
                ]
                reasons.append(
                    f"{stations[number].name} is {ways[0]:.2f} m from {stations[number - 1].name} by telemetry and "
                    f"{ways[1]:.2f} m by the pictures, {off:.0f} standard errors of telemetry apart: a pose.toml, its "
                    "stated errors or a picture is wrong"
                )
        return reasons

    def to_dict(self) -> dict[str, Any]:
        return {
            "positions_of": "rover" if self.localised.stations[0].rover is not None else "left camera",
            "stations": self.rows(),
            "pairs": self.pairs(),
            "covariance": self.localised.covariance.tolist(),
            "covariance_of": [
                f"{station.name} {name}"
                for station in self.localised.stations[1:]
                for name in (*(f"rotation_{a}_rad" for a in AXES), *(f"{a}_m" for a in AXES))
            ],
            "rig": self.rig.summary(),
            "notes": self.notes(),
        }

    def pairs(self) -> list[dict[str, Any]]:
        """What came of each two stations that were compared."""
        names = [station.name for station in self.localised.stations]
        tied = zip(self.localised.pairs, self.localised.adjusted.inflation, strict=True)
        inflation = {frozenset((pair.near, pair.far)): factor for pair, factor in tied}
        table = []
        for report in self.localised.reports:
            row = report._asdict()
            row |= dict(zip(("ground_near_m", "ground_far_m"), row.pop("ground_m"), strict=True))
            row |= {key: names[row[key]] for key in ("first", "second", "near")}
            row["error_inflation"] = inflation.get(frozenset((report.first, report.second)))
            table.append({k: None if isinstance(v, float) and math.isnan(v) else v for k, v in row.items()})
        return table

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """One a station, in the columns that `twin states`, `twin update` and `images merge` read of positions."""
        return [self._row(k) for k in range(len(self.localised.stations))]

    def _row(self, k: int) -> dict[str, Any]:
        station, pose = self.localised.stations[k], self.localised.poses[k]
        place, before = self.localised.place(k), self.localised.shared(k, max(k - 1, 0))
        errors = self.localised.shared(k, k)
        errors = errors if errors.any() else np.diag([0.0] * 3 + [FIRST_M**2] * 3)
        heading, down, roll = pose.angles_deg()
        turned = math.degrees(math.sqrt(errors[2, 2]))
        yaw = None if station.rover is None else math.degrees(math.atan2(*place.rotation[[1, 0], 0]))
        return {
            "station": station.name,
            "time_s": station.time_s,
            **dict(zip(("x_m", "y_m", "z_m"), map(float, place.center_m), strict=True)),
            **{f"{n}_m2": float(errors[i, j]) for n, i, j in (("xx", 3, 3), ("xy", 3, 4), ("yy", 4, 4), ("zz", 5, 5))},
            **{f"{'xyz'[i]}{'xyz'[j]}_before_m2": float(before[3 + i, 3 + j]) for i in range(2) for j in range(2)},
            "yaw_deg": yaw,
            "yaw_deg_sigma": None if yaw is None else turned,
            "camera_heading_deg": heading,
            "camera_heading_deg_sigma": turned,
            "camera_down_deg": down,
            "camera_roll_deg": roll,
            "tied": self.localised.tied[k],
            "from_dead_reckoning_m": float(np.linalg.norm(pose.center_m - station.pose.center_m)),
        }

    def as_input(self, role: str) -> dict[str, Callable[[], bytes]]:
        return {"positions.csv": self.files()["positions.csv"]} if role == "positions" else {}

    def files(self) -> dict[str, Callable[[], bytes]]:
        """Positions, poses for `images dem`, and shifts of elevation models made with them: name to what makes it."""
        result = self.localised
        made: dict[str, Callable[[], bytes]] = {"positions.csv": lambda: csv_bytes(self.to_table().to_pandas())}
        for station, pose in zip(result.stations, result.poses, strict=True):
            made[f"{station.name}.toml"] = lambda pose=pose: pose_text(pose).encode()  # type: ignore[misc]
        made["shifts.csv"] = lambda: csv_bytes(self._shifts())
        return made

    def _shifts(self) -> Any:
        """Of elevation models made with the poses found: none, with the errors of these, as `images merge` reads it."""
        import pandas as pd

        errors = [{name: row[name] for name in ("xx_m2", "xy_m2", "yy_m2", "zz_m2")} for row in self.rows()]
        return pd.DataFrame(
            [
                {"model": s.name, "x_m": 0.0, "y_m": 0.0, "z_m": 0.0} | row
                for s, row in zip(self.localised.stations, errors, strict=True)
            ]
        )

    def figures(self) -> Figures:
        from lunarsci.images.figures import ties_figure

        if not self.localised.pairs:
            raise ParameterError(f"there are no ties to draw: {self.doubt}; leave --plot out")
        for number in range(len(self.localised.pairs)):
            yield ties_figure(self.localised, number, synthetic=self.synthetic)

    @property
    def _whose(self) -> str:
        given = self.localised.stations[0].rover is not None
        return "the rover's origin" if given else "the left camera; with `mast` they are the rover's"

    def notes(self) -> list[str]:
        """What there is to say about the positions."""
        notes = [
            f"positions are those of {self._whose}; the first one's pose is taken as exact",
            "shadows that moved with the Sun pull ties along; residuals show that only in part",
        ]
        if any(station.time_s is None for station in self.localised.stations):
            notes.append("`twin states` and `twin update` need times: add time_s to each pose.toml")
        if self.rig.assumed:
            notes.append(f"the rig ({self.rig.name}) assumes: {', '.join(self.rig.assumed)}")
        if self.synthetic:
            notes.append("the pictures are SYNTHETIC")
        return notes


@job
def locate(
    stations: Sequence[str | Path | AsFiles],
    request: LocateRequest | None = None,
    *,
    progress: Progress | None = None,
    **options: Any,
) -> LocatedStations:
    """Poses of stations from what their pictures share, with the covariance of all.

    stations : folders in the order of the drive, each with a left and a right picture (`left.png`, `right.png`) and
        `pose.toml`, which dead reckoning gives: position_m, heading_deg, down_deg and roll_deg of the left camera; it
        may have time_s, and needs rover_yaw_deg, rover_pitch_deg (nose down) and rover_roll_deg (left side up) for
        `mast`.

    Raises DataError for folders that are none and pairs that do not match, RequestError for fewer than two.

    Examples
    --------
    >>> stations = lunarsci.locate(["lunarsci-demo", "station-2"], rig="lunarsci-demo/rig.toml")
    """
    request = request_of(LocateRequest, request, options)
    rig, count = read_rig(request.rig), len(stations)
    report = progress or (lambda done, total: None)
    errors = DeadReckoning(request.drift, request.heading_error, request.tilt_error, mast_m=request.mast_m())
    read = read_stations([*map(str, stations)], errors, lambda _: rig, progress=lambda done: report(done, 2 * count))
    result = localise(read.stations, progress=lambda done, total: report(count + done, 2 * count))
    return LocatedStations(localised=result, rig=rig, inputs=read.inputs, synthetic=read.synthetic)


class DeadReckoning(NamedTuple):
    """How far telemetry is off, and what else there is to know of rover and mast.

    Attributes
    ----------
    drift : share of the way between stations. [-]
    heading_deg, tilt_deg : of the rover at each station. [deg]
    mast_deg : of the mast from pair to pair of one station. Without it each folder is a station of its own, and the
        first one's pose is exact. [deg]
    mast_m : middle between both cameras in the rover's frame; None where positions are the cameras'. (3,) [m]
    """

    drift: float
    heading_deg: float
    tilt_deg: float
    mast_deg: float | None = None
    mast_m: tuple[float, ...] | None = None


class StationsRead(NamedTuple):
    """Matched stations, SHA-256 of each file by its name, and whether a picture or a rig says that it is made up."""

    stations: list[Station]
    inputs: dict[str, str]
    synthetic: bool


def read_stations(
    stations: Sequence[str | Path],
    errors: DeadReckoning,
    rig_of: Callable[[Path], StereoRig],
    *,
    progress: Callable[[int], None],
) -> StationsRead:
    """Stations of folders, each by its rig, with their pairs matched. Raises DataError and RequestError."""
    whole = [Path(folder).resolve() for folder in stations]
    reasons = ["one station has nothing to be tied to; give two or more folders"] if len(whole) < 2 else [
        f"{folder} is given twice; each station is a folder of its own"
        for k, folder in enumerate(stations) if whole[k] in whole[:k]
    ]  # fmt: skip
    refuse(reasons, kind=RequestError)
    inputs: dict[str, str] = {}
    names = _names(whole)
    rigs = [rig_of(Path(folder)) for folder in stations]
    read = [_read(Path(folder), rig, errors.mast_m, inputs) for folder, rig in zip(stations, rigs, strict=True)]
    matched: list[Station] = []
    for number, (name, content, rig) in enumerate(zip(names, read, rigs, strict=True)):
        progress(number)
        matched.append(_station(name, content, rig, errors, matched))
    made_up = any(synthetic(rig, one.left, one.right) for one, rig in zip(read, rigs, strict=True))
    return StationsRead(matched, inputs, made_up)


def _names(whole: Sequence[Path]) -> list[str]:
    """Names of folders, with those above them where two have the same."""
    for depth in range(1, 1 + max(len(path.parts) for path in whole)):
        names = ["-".join(path.parts[-depth:]).strip("-/") for path in whole]
        if len(set(names)) == len(names):
            break
    return names


class _Read(NamedTuple):
    """What a station's folder holds; `pose`, `time_s` and `rover` as `Station` has them.

    stand : name of the place where the rover did not move, or how it stood there; '' where neither is known.
    """

    left: Picture
    right: Picture
    pose: Pose
    time_s: float | None
    rover: Pose | None
    stand: str


def _read(folder: Path, rig: StereoRig, mast: tuple[float, ...] | None, inputs: dict[str, str]) -> _Read:
    """A station's folder; `inputs` takes its files. Raises DataError for what belongs to no station of this rig."""
    pose_file = read_input(folder / "pose.toml")
    files = [read_input(_picture(folder, side)) for side in SIDES]
    for file in files:
        if again := next((other for other, digest in inputs.items() if digest == file.sha256), None):
            raise DataError(f"{file.name}: the same picture as {again}; each camera and station has its own")
        inputs[file.name] = file.sha256
    inputs[pose_file.name] = pose_file.sha256
    pose = read_pose(pose_file)
    pictures = [read_picture(file) for file in files]
    check_pictures(rig, pictures)
    time_s, attitude, stand = _more_of_pose(pose_file)
    if mast is not None and attitude is None:
        raise DataError(f"{pose_file.name}: `mast` needs how the rover stood there; add {', '.join(ATTITUDE)}")
    rover = None if mast is None or attitude is None else _rover(rig, pose, attitude, mast)
    return _Read(pictures[0], pictures[1], pose, time_s, rover, stand)


def _station(name: str, content: _Read, rig: StereoRig, errors: DeadReckoning, before: Sequence[Station]) -> Station:
    """A station with its pair matched, after those `before`. Raises DataError where it does not match."""
    nearest = nearest_ground_m(rig, content.pose, rig.height_m)
    one = Station(
        name=name,
        matches=match(content.left, content.right, rig, nearest_m=nearest),
        rig=rig,
        pose=content.pose,
        covariance=_covariance(content.pose, before, errors, rig.height_m),
        time_s=content.time_s,
        rover=content.rover,
    )
    if errors.mast_deg is None:
        return one
    mast = math.radians(errors.mast_deg) * np.array([1.0, 1.0, 1.0, *[rig.baseline_m] * 3])
    stand = content.stand or name
    same = next((station.covariance for station in before if station.stand == stand), one.covariance)
    return replace(one, covariance=same, stand=stand, mast=np.diag(mast**2))


def _more_of_pose(file: InputFile) -> tuple[float | None, tuple[float, ...] | None, str]:
    """Time, yaw, pitch and roll of the rover, and where it stood, of a pose.toml; None and '' where it does not say
    them. Raises DataError."""
    table = toml_document(text(file))
    given = [name for name in ("time_s", *ATTITUDE) if name in table]
    for name in given:
        if isinstance(table[name], bool) or not isinstance(table[name], int | float) or not math.isfinite(table[name]):
            raise DataError(f"{file.name}: {name} is {table[name]!r}; give a number")
    time_s = float(table["time_s"]) if "time_s" in table else None
    attitude = tuple(float(table[name]) for name in ATTITUDE) if set(ATTITUDE) <= set(given) else None
    return time_s, attitude, str(table.get("station", "" if attitude is None else attitude))


def _rover(rig: StereoRig, pose: Pose, attitude: Sequence[float], mast_m: Sequence[float]) -> Pose:
    """The rover's frame in that of the left camera: the middle between both cameras is `mast_m` in the rover's."""
    turned = pose.rotation.T @ Rotation.from_euler("ZYX", attitude, degrees=True).as_matrix()
    middle = -0.5 * rig.rotation.T @ rig.translation_m
    return Pose(rotation=turned, center_m=middle - turned @ np.asarray(mast_m))


def _picture(folder: Path, side: str) -> Path:
    """The picture of a side in a station's folder. Raises DataError."""
    for ending in ENDINGS:
        if (folder / f"{side}{ending}").is_file():
            return folder / f"{side}{ending}"
    raise DataError(f"{folder}: no {side}.png; a station is a folder with left.png, right.png and pose.toml")


def _covariance(pose: Pose, before: Sequence[Station], errors: DeadReckoning, height_m: float) -> FloatArray:
    """Of dead reckoning: of direction, and of the step from the station before. (6, 6)

    A camera at `height_m` over the wheels is moved by their way, and by what the rover leans at both stations. Of the
    first station place and heading are the map's.
    """
    tilt, turn = math.radians(errors.tilt_deg), math.radians(errors.heading_deg)
    if not before:
        return leaning(tilt * (errors.mast_deg is not None), height_m)
    way = float(np.linalg.norm(pose.center_m - before[-1].pose.center_m))
    step = math.hypot(errors.drift * way, math.sqrt(2) * tilt * height_m)
    return np.diag(np.square([tilt, tilt, turn, step, step, step]))
