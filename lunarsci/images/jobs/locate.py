"""Where a rover's stations were, from their pictures."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lunarsci.errors import DataError, RequestError
from lunarsci.inputs import read_input
from lunarsci.result import MadeFrom, Result, request_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from lunarsci.images.localisation import Localised
    from lunarsci.images.rig import StereoRig
    from lunarsci.images.ties import Station


Progress = Callable[[int, int], None]
SOURCES = [
    "Lowe (2004), Int. J. Comput. Vis. 60, 91, 10.1023/B:VISI.0000029664.99615.94: features",
    "Torr and Zisserman (2000), Comput. Vis. Image Underst. 78, 138, 10.1006/cviu.1999.0832: MSAC",
    "Triggs et al. (2000), 10.1007/3-540-44480-7_21: bundle adjustment",
    "Huber (1964), Ann. Math. Stat. 35, 73, 10.1214/aoms/1177703732: robust weights",
]
SIDES = ("left", "right")
ENDINGS = (".png", ".tif", ".tiff", ".jpg", ".jpeg")
LEAST_DRIFT_M = 0.02
"""Error of dead reckoning that is left without any way; assumed. [m]"""
FIRST_M = 0.001
"""Error of the first place in the table, which is exact by definition: readers need one above 0; assumed."""
AXES = "xyz"


@dataclass(frozen=True, slots=True, kw_only=True)
class LocateRequest:
    """How stations are to be found.

    Attributes
    ----------
    rig : name or TOML file, of all stations.
    drift : error of dead reckoning as a share of the way between stations, > 0; assumed.
    heading_error, tilt_error : of the given directions, > 0; assumed. [deg]
    """

    rig: str = "yutu2-navcam"
    drift: float = 0.03
    heading_error: float = 1.0
    tilt_error: float = 0.3

    def __post_init__(self) -> None:
        for name, top in (("drift", 1.0), ("heading_error", 45.0), ("tilt_error", 20.0)):
            if not 0 < getattr(self, name) <= top:
                raise RequestError(f"`{name}` is {getattr(self, name):g}; give a number above 0, at most {top:g}")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LocatedStations(Result):
    """Where left cameras were, in the frame of the first one's pose."""

    schema: ClassVar[str] = "images-locate/1"
    found: "Localised"
    rig: "StereoRig"
    inputs: Mapping[str, str]
    synthetic: bool

    @property
    def made_from(self) -> MadeFrom:
        return MadeFrom(inputs=self.inputs, sources=SOURCES)

    @property
    def untrusted(self) -> str:
        from lunarsci.images.localisation import ODD_SIGMAS

        for number, station in enumerate(self.found.stations):
            if not self.found.tied[number]:
                why = "; ".join(r.failure for r in self.found.reports if r.second == number and r.failure)
                return f"{station.name} is where dead reckoning puts it: {why}"
            if number and self.found.off_sigmas(number) > ODD_SIGMAS:
                off = self.found.off_sigmas(number)
                return f"{station.name} is {off:.0f} sigmas from its dead reckoning: one of them is wrong"
        return ""

    def to_dict(self) -> dict[str, Any]:
        return {
            "stations": self.rows(),
            "pairs": [self._pair(report._asdict()) for report in self.found.reports],
            "covariance": self.found.covariance.tolist(),
            "covariance_of": [
                f"{station.name} {name}"
                for station in self.found.stations[1:]
                for name in (*(f"rotation_{a}_rad" for a in AXES), *(f"{a}_m" for a in AXES))
            ],
            "rig": {"name": self.rig.name, "baseline_m": self.rig.baseline_m, "assumed": list(self.rig.assumed)},
            "notes": self.notes(),
        }

    def _pair(self, report: dict[str, Any]) -> dict[str, Any]:
        names = [station.name for station in self.found.stations]
        named = {key: names[report[key]] for key in ("first", "second", "near")}
        number = next(
            (k for k, p in enumerate(self.found.pairs) if {p.near, p.far} == {report["first"], report["second"]}), None
        )
        adjusted = self.found.adjusted
        inflation = None if number is None or adjusted is None else adjusted.inflation[number]
        distances = dict(zip(("ground_near_m", "ground_far_m"), report.pop("ground_m"), strict=True))
        clean = {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in (report | distances).items()}
        return clean | named | {"error_inflation": inflation}

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """One a station, in the columns that `twin states`, `twin update` and `images merge` read of positions."""
        import numpy as np

        rows = []
        for k, (station, pose) in enumerate(zip(self.found.stations, self.found.poses, strict=True)):
            part = slice(6 * k - 6, 6 * k)
            own = self.found.covariance[part, part] if k else np.diag([0.0] * 3 + [FIRST_M**2] * 3)
            heading, down, roll = pose.angles_deg()
            x, y, z = map(float, pose.center_m)
            rows.append(
                {
                    "station": station.name,
                    "time_s": station.time_s,
                    "x_m": x,
                    "y_m": y,
                    "z_m": z,
                    **{
                        f"{n}_m2": float(own[i, j])
                        for n, i, j in (("xx", 3, 3), ("xy", 3, 4), ("yy", 4, 4), ("zz", 5, 5))
                    },
                    "heading_deg": heading,
                    "heading_deg_sigma": math.degrees(math.sqrt(own[2, 2])),
                    "down_deg": down,
                    "roll_deg": roll,
                    "tied": self.found.tied[k],
                    "from_dead_reckoning_m": float(np.linalg.norm(pose.center_m - station.pose.center_m)),
                }
            )
        return rows

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.images.locate_figure import ties_figure

        for number in range(len(self.found.pairs)):
            yield ties_figure(self.found, number, synthetic=self.synthetic)

    def notes(self) -> list[str]:
        """What there is to say about the positions."""
        notes = [
            "positions are those of the left camera, not of the rover's origin; the first one's pose is taken as exact",
            "shadows that moved with the Sun pull ties along; residuals show that only in part",
        ]
        if any(station.time_s is None for station in self.found.stations):
            notes.append("`twin states` and `twin update` need times: add time_s to each pose.toml")
        if self.rig.assumed:
            notes.append(f"the rig assumes: {', '.join(self.rig.assumed)}")
        if self.synthetic:
            notes.append("the pictures are SYNTHETIC")
        return notes


def locate(
    stations: Sequence[str | Path],
    request: LocateRequest | None = None,
    *,
    progress: Progress | None = None,
    **options: Any,
) -> LocatedStations:
    """Poses of stations from what their pictures share, with the covariance of all.

    stations : folders in the order of the drive, each with a left and a right picture (`left.png`, `right.png`) and
        `pose.toml`, which dead reckoning gives (and may have `time_s`).

    Raises DataError for folders that are none and pairs that do not match, RequestError for fewer than two.
    """
    from lunarsci.images.localisation import localise
    from lunarsci.images.rig_files import read_rig

    asked = request_of(LocateRequest, request, options)
    if len(stations) < 2:
        raise RequestError("one station has nothing to be tied to; give two or more folders")
    rig = read_rig(asked.rig)
    told = progress or (lambda done, total: None)
    inputs: dict[str, str] = {}
    read: list[Station] = []
    synthetic = "SYNTHETIC" in rig.name
    for number, folder in enumerate(stations):
        told(number, len(stations) + 1)
        station, made_up = _station(Path(folder), rig, asked, read[-1] if read else None, inputs)
        read.append(station)
        synthetic |= made_up
    told(len(stations), len(stations) + 1)
    found = localise(read, rig)
    told(len(stations) + 1, len(stations) + 1)
    return LocatedStations(found=found, rig=rig, inputs=inputs, synthetic=synthetic)


def _station(
    folder: Path, rig: "StereoRig", asked: LocateRequest, before: "Station | None", inputs: dict[str, str]
) -> "tuple[Station, bool]":
    """A station of a folder, its pair matched, and whether its pictures are SYNTHETIC."""
    import tomllib

    from lunarsci.images.jobs.dem import MAST_M, nearest_ground_m
    from lunarsci.images.matching import match
    from lunarsci.images.pictures import read_picture
    from lunarsci.images.rig_files import check_rig_of, read_pose
    from lunarsci.images.ties import Station
    from lunarsci.inputs import text

    pose_file = read_input(folder / "pose.toml")
    files = [read_input(_picture(folder, side)) for side in SIDES]
    inputs |= {file.name: file.sha256 for file in (pose_file, *files)}
    pose = read_pose(pose_file)
    pictures = [read_picture(file) for file in files]
    for picture in pictures:
        check_rig_of(rig, *picture.size, picture.source.name)
        picture.check()
    nearest = nearest_ground_m(rig, pose, rig.mast_height_m or MAST_M)
    time_s = tomllib.loads(text(pose_file)).get("time_s")
    station = Station(
        name=folder.name,
        matches=match(pictures[0], pictures[1], rig, nearest_m=nearest),
        pose=pose,
        covariance=_covariance(pose, before, asked),
        time_s=None if time_s is None else float(time_s),
    )
    return station, any(b"SYNTHETIC" in file.data[:4000] for file in files)


def _picture(folder: Path, side: str) -> Path:
    """The picture of a side in a station's folder. Raises DataError."""
    for ending in ENDINGS:
        if (folder / f"{side}{ending}").is_file():
            return folder / f"{side}{ending}"
    raise DataError(f"{folder}: no {side}.png; a station is a folder with left.png, right.png and pose.toml")


def _covariance(pose: Any, before: "Station | None", asked: LocateRequest) -> Any:
    """Of dead reckoning since the first station: variances of place add up from one to the next. (6, 6)"""
    import numpy as np

    way = 0.0 if before is None else float(np.linalg.norm(pose.center_m - before.pose.center_m))
    place = math.hypot(asked.drift * way, LEAST_DRIFT_M) ** 2
    so_far = 0.0 if before is None else float(before.covariance[3, 3])
    tilt, turn = math.radians(asked.tilt_error) ** 2, math.radians(asked.heading_error) ** 2
    return np.diag([tilt, tilt, turn, *[so_far + place] * 3])
