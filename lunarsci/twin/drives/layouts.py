"""Public rover drives as they are laid out, turned into telemetry: trials with motion capture, and runs with GPS.

* "Rover Mobility in a Lunar Analogue Dataset", Hopkins et al. (2025), iSpaRo: `Trial_Data/CONFIGURATION/Trial_N` with
  `Processed_Data.csv` (README of RoSE-Lab-Admin/Rover-Mobility-Dataset).
* Energy-aware navigation at the Canadian Space Agency, Lamarre et al. (2020), Int. J. Robot. Res. 39, 641,
  10.1177/0278364920908922: a folder a run with `wheel-encoder.txt`, `global-pose-utm.txt`, `gps-utm18t.txt`
  (`generate_human_readable.py` of utiasSTARS/enav-planetary-dataset).
"""

import glob
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError
from lunarsci.io.inputs import InputFile, read_input, text
from lunarsci.io.tables import check_columns, csv_bytes, numbers_of, read_csv_table
from lunarsci.regolith.soil import read_soil
from lunarsci.twin.ground.terrain import Terrain, build_terrain
from lunarsci.twin.plans.motion import GAP
from lunarsci.twin.telemetry.log_names import yaw_roll_pitch

if TYPE_CHECKING:
    import pandas as pd

WHEELS = ("FL", "FR", "RL", "RR")
"""Order of the wheels in both data sets: front left, front right, back left, back right."""
PROCESSED = "Processed_Data.csv"
OFF_NOMINAL = {"Off_Nominal_Data", "Bad_Data"}
"""Folders of trials that its makers do not use."""
CAPTURED = ("time_s", "pos_x", "pos_y", "pos_z", "quat_x", "quat_y", "quat_z", "quat_w")
CAPTURE_SIGMA_M, CAPTURE_YAW_SIGMA_DEG = 0.002, 0.3
"""Errors of motion capture, assumed: markers are found to less than a millimetre; the rest is the body that holds them
and the time that is shared out between two samples. [m, deg]"""
ENCODERS, POSES, GPS = "wheel-encoder.txt", "global-pose-utm.txt", "gps-utm18t.txt"
GPS_SIGMA_M, POSE_SIGMA_M, POSE_YAW_SIGMA_DEG = 0.03, 0.1, 1.0
"""Errors of the fixes, and of the poses that fuse them with pictures and inertial measurements; assumed. [m, m, deg]"""
ANTENNA_M = (-0.260, 0.0, 0.340)
"""The GPS antenna from base_link: Lamarre et al. (2020), rover_main.urdf.xacro. [m]"""
HEIGHT_SIGMA_M, ATTITUDE_SIGMA = 0.01, 0.035
"""How far heights of a drive are off a plane, and slopes that follow from the attitude, 2 deg; assumed. [m, -]"""
MARGIN_M, MARGIN_SHARE, NODES = 3.0, 0.25, 200
"""Ground about the places of a drive, and more of it by its extent, in so many spacings: of a plane. [m, -, -]"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PublicDrive:
    """A drive of a public data set, as telemetry.

    Attributes
    ----------
    name : as it was given.
    rover, gravity : that drove, by the name in lunarsci, and where.
    table : columns as `lunarsci template telemetry` has them.
    place_m, attitude_deg : measured x, y, z [m], and yaw, roll, pitch [deg] of its rows, else NaN. (n, 3) each
    inputs : files that were read, with their SHA-256.
    read_as : how they were read, where there was a choice.
    """

    name: str
    rover: str
    table: "pd.DataFrame"
    place_m: FloatArray
    attitude_deg: FloatArray
    inputs: dict[str, str]
    read_as: tuple[str, ...]
    gravity: str = "earth"

    @property
    def telemetry(self) -> InputFile:
        """The table as a file that `read_telemetry` takes."""
        return InputFile(self.name, csv_bytes(self.table))

    def plane(self) -> Terrain:
        """The plane that the drive's heights and attitude tell of, below it; level across where neither does.

        Slopes follow from places by their spread and from the attitude by its error: a straight drive tells its grade
        by heights, and the slope across by the roll.
        """
        given = np.isfinite(self.place_m).all(axis=1)
        place = self.place_m[given]
        middle = place.mean(axis=0)
        off = place - middle
        spread = off[:, :2].T @ off[:, :2] / len(off) / HEIGHT_SIGMA_M**2
        grade = off[:, :2].T @ off[:, 2] / len(off) / HEIGHT_SIGMA_M**2
        up = _turned(self.attitude_deg, (0.0, 0.0, 1.0))
        tilted = np.nanmedian(-up[:, :2] / up[:, 2:], axis=0)
        slope = np.linalg.solve(spread + np.eye(2) / ATTITUDE_SIGMA**2, grade + tilted / ATTITUDE_SIGMA**2)
        low, high = place[:, :2].min(axis=0), place[:, :2].max(axis=0)
        reach = float((high - low).max())
        margin = MARGIN_M + MARGIN_SHARE * reach
        spacing = (reach + 2.0 * margin) / NODES
        x, y = (np.arange(low[k] - margin, high[k] + margin + spacing, spacing) for k in range(2))
        height = slope[0] * (x[None, :] - middle[0]) + slope[1] * (y[:, None] - middle[1])
        name = f"plane below {Path(self.name).name}"
        return build_terrain(name, float(x[0]), float(y[0]), spacing, height, read_soil("longji"))


def read_public_drive(source: Any) -> PublicDrive | None:
    """The drive of a folder or file of a known layout; None for anything else.

    Raises DataError for a file of a known layout that cannot be used.
    """
    if not isinstance(source, str | Path) or str(source) == "-":
        return None
    path = Path(source)
    for file, read in LAYOUTS.items():
        if path.is_dir() and (path / file).is_file():
            return read(str(source), path / file)
        if path.name == file and path.is_file():
            return read(str(source), path)
    return _captured(str(source), path) if path.suffix.lower() == ".csv" and _is_captured(path) else None


def trials_in(path: str) -> list[str]:
    """The drives below a folder or a pattern, sorted; a file, or a folder that is a drive, is one. Raises DataError."""
    folder, below = Path(path), list[str]()
    if glob.has_magic(path) and not folder.exists():
        below = [trial for one in sorted(glob.glob(path, recursive=True)) for trial in trials_in(one)]  # noqa: PTH207
    elif not folder.is_dir() or any((folder / file).is_file() for file in LAYOUTS):
        below = [path]
    else:
        files = [file for layout in LAYOUTS for file in folder.rglob(layout)]
        below = sorted(str(file.parent) for file in files if not OFF_NOMINAL & {*file.relative_to(folder).parts})
    if not below:
        raise DataError(f"{path}: no drive in it: neither {' nor '.join(LAYOUTS)}; name folders or files of drives")
    return below


def _is_captured(path: Path) -> bool:
    try:
        with path.open("r", encoding="utf-8", errors="replace") as file:
            names = {name.strip() for name in file.readline(4096).split(",")}
    except OSError:
        return False
    return names >= set(CAPTURED)


def _captured(name: str, path: Path) -> PublicDrive:
    file = read_input(path)
    table = read_csv_table(file)
    check_columns(file.name, table.columns, tuple(table.columns), CAPTURED)
    values = {column: numbers_of(file.name, column, table[column]) for column in CAPTURED}
    place = np.column_stack([values[f"pos_{axis}"] for axis in "xyz"])
    attitude = _attitude(np.column_stack([values[f"quat_{axis}"] for axis in "xyzw"]))
    angles, how = _captured_angles(file.name, table)
    read_as = (f"a trial of Rover Mobility (motion capture): wheels by {how}, positions of its body",)
    return _drive(
        name, "rosey", values["time_s"], place, attitude, angles,
        (CAPTURE_SIGMA_M, CAPTURE_YAW_SIGMA_DEG), [file], read_as, synthetic="synthetic" in table,
    )  # fmt: skip


def _captured_angles(name: str, table: "pd.DataFrame") -> tuple[FloatArray, str]:
    """Angles of the wheels, and what they were read from. (n, 4) [deg]

    `encN_rad` is in rad; the README says so of `encN`, too, but the notebooks beside it read turns.
    """
    for form, factor, unit in (("enc{}_rad", np.degrees(1.0), "rad"), ("enc{}", 360.0, "turns")):
        names = [form.format(k) for k in range(1, 5)]
        if all(column in table for column in names):
            columns = [numbers_of(name, column, table[column]) for column in names]
            return factor * np.column_stack(columns), f"{names[0]} to {names[-1]} in {unit}"
    raise DataError(f"{name}: no columns enc1_rad to enc4_rad, nor enc1 to enc4; the wheels' angles are needed")


def _with_gps(name: str, path: Path) -> PublicDrive:
    folder = path.parent
    files = [read_input(path)]
    encoders = _rows(files[0], 9)
    files.append(read_input(folder / POSES))
    poses = _rows(files[1], 8)
    attitude = _attitude(poses[:, 4:8])
    time, place, sigma, source = poses[:, 0], poses[:, 1:4], POSE_SIGMA_M, f"positions of {POSES}"
    if (folder / GPS).is_file():
        files.append(read_input(folder / GPS))
        fixes = _rows(files[2], 4)
        time, sigma, source = fixes[:, 0], GPS_SIGMA_M, f"positions of {GPS}, moved from the antenna to the base"
        place = fixes[:, 1:] - _turned(_between(time, poses[:, 0], attitude), ANTENNA_M)
    rows = np.unique(np.concatenate([encoders[:, 0], time]))
    where = np.full((len(rows), 3), np.nan)
    where[np.searchsorted(rows, time)] = place
    angles = np.degrees(_between(rows, encoders[:, 0], encoders[:, 1:5]))
    heading = _between(rows, poses[:, 0], attitude)
    used = np.isfinite(angles).all(axis=1) & (rows >= poses[0, 0]) & (rows <= poses[-1, 0])
    if not used.any():
        raise DataError(f"{name}: {ENCODERS} and {POSES} have no time in common; are they of one run?")
    read_as = (f"a run of the energy-aware navigation data set: {source}, headings of {POSES}",)
    return _drive(
        name, "husky", rows[used] - rows[used][0], where[used], heading[used], angles[used],
        (sigma, POSE_YAW_SIGMA_DEG), files, read_as, synthetic=b"synthetic" in files[0].data[:4096],
    )  # fmt: skip


LAYOUTS: dict[str, Callable[[str, Path], PublicDrive]] = {PROCESSED: _captured, ENCODERS: _with_gps}
"""The file by which a layout is known, and what reads it."""


def _rows(file: InputFile, columns: int) -> FloatArray:
    """Numbers of a table in the order of time, by place: its header is a comment, whose names hold commas."""
    try:
        rows = np.loadtxt(text(file).splitlines(), delimiter=",", ndmin=2)
    except ValueError as error:
        raise DataError(f"{file.name}: {error}; rows of {columns} numbers are needed") from error
    if rows.shape[1] != columns or len(rows) < 2:
        raise DataError(f"{file.name}: has no rows of {columns} numbers; is the file complete?")
    _, first = np.unique(rows[:, 0], return_index=True)
    return np.asarray(rows[first])


def _attitude(quaternion: FloatArray) -> FloatArray:
    """As of `yaw_roll_pitch`, without full turns of the heading between rows. (n, 3) [deg]"""
    attitude = yaw_roll_pitch(quaternion)
    given = np.isfinite(attitude[:, 0])
    attitude[given, 0] = np.unwrap(attitude[given, 0], period=360.0)
    return attitude


def _turned(attitude_deg: FloatArray, arm_m: tuple[float, float, float]) -> FloatArray:
    """An arm of the body in the world. (n, 3) [m]"""
    from scipy.spatial.transform import Rotation

    result = np.full((len(attitude_deg), 3), np.nan)
    given = np.isfinite(attitude_deg).all(axis=1)
    yaw, roll, pitch = attitude_deg[given].T
    if given.any():
        result[given] = Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll]), degrees=True).apply(arm_m)
    return result


def _between(time_s: FloatArray, given_s: FloatArray, values: FloatArray) -> FloatArray:
    """Values at some times, linear between the known ones; NaN before, after, and over gaps. (n, columns)"""
    result = np.column_stack([np.interp(time_s, given_s, column, np.nan, np.nan) for column in values.T])
    steps = np.diff(given_s)
    number = np.clip(np.searchsorted(given_s, time_s, side="right") - 1, 0, len(steps) - 1)
    lost = (steps[number] > GAP * np.median(steps)) & ~np.isin(time_s, given_s)
    result[lost] = np.nan
    return result


def _drive(
    name: str, rover: str, time_s: FloatArray, place_m: FloatArray, attitude_deg: FloatArray, angle_deg: FloatArray,
    sigmas: tuple[float, float], files: Iterable[InputFile], read_as: tuple[str, ...], *, synthetic: bool,
) -> PublicDrive:  # fmt: skip
    import pandas as pd

    fixed = np.isfinite(place_m).all(axis=1)
    columns: dict[str, Any] = {
        "time_s": time_s,
        "x_m": np.where(fixed, place_m[:, 0], np.nan),
        "y_m": np.where(fixed, place_m[:, 1], np.nan),
        "sigma_m": np.where(fixed, sigmas[0], np.nan),
        "yaw_deg": attitude_deg[:, 0],
        "yaw_deg_sigma": sigmas[1],
        "roll_deg": attitude_deg[:, 1],
        "pitch_deg": attitude_deg[:, 2],
    }
    for k, wheel in enumerate(WHEELS):
        columns |= {f"angle_{wheel}_deg": angle_deg[:, k], f"steered_{wheel}_deg": 0.0}
    table = pd.DataFrame(columns | ({"synthetic": True} if synthetic else {}))
    read_as = (*read_as, f"rover {rover} and Earth's gravity, where no other is named")
    inputs = {file.name: file.sha256 for file in files}
    return PublicDrive(
        name=name, rover=rover, table=table, place_m=place_m, attitude_deg=attitude_deg, inputs=inputs, read_as=read_as
    )
