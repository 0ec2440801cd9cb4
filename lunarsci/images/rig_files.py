"""Stereo rigs by name, from TOML files, and from the labels of two pictures."""

import tomllib
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError
from lunarsci.images.camera import INTRINSICS, Camera, Pose, rotation_of, vector_of
from lunarsci.images.camera_files import rig_or_camera
from lunarsci.images.labels import rig_of_labels
from lunarsci.images.rig import PARAMETERS, RELATIVE, Sensor, StereoRig, covariance_of, is_swapped
from lunarsci.io.documents import toml_document
from lunarsci.io.inputs import InputFile, read_input, text

OWN = "rigs.toml"
ONE_CAMERA = "is one camera; a rig needs two"
SENSOR = ("bits", "full_well_e", "read_noise_e", "mtf_at_nyquist")
SIGMA_GROUPS = {"rotation_rad": RELATIVE[:3], "translation_m": RELATIVE[3:]}
FORM = (
    "give [left] and [right] (width_px, height_px, fx_px, fy_px, cx_px, cy_px, k1, k2, k3, p1, p2) and [relative] "
    "(rotation_rad, translation_m), or width_px, height_px, focal_px and baseline_m of two equal cameras side by side"
)


class SingleCamera(NamedTuple):
    """A camera alone, with the covariance of its intrinsics (9, 9), and where its numbers are from."""

    camera: Camera
    covariance: FloatArray
    source: str


def read_camera(file: InputFile) -> SingleCamera | None:
    """The camera of a file that `camera_text` made; None for any other TOML. Raises DataError."""
    try:
        plain = toml_document(text(file))
        if "camera" not in plain:
            return None
        covariance = np.array(plain["covariance"], dtype=float)
        if covariance.shape != (len(INTRINSICS),) * 2 or not np.isfinite(covariance).all():
            raise DataError(f"{file.name}: its covariance has shape {covariance.shape}; give 9 x 9 numbers")
        return SingleCamera(_camera(plain["camera"], str(plain["name"])), covariance, str(plain.get("source", "")))
    except KeyError as error:
        raise DataError(f"{file.name}: no {error.args[0]}; a camera has a name, a covariance and [camera]") from error
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise DataError(f"{file.name}: {error}") from error


def known_rigs() -> tuple[str, ...]:
    """Names of the rigs that come with lunarsci."""
    return tuple(tomllib.loads(own_text()))


def own_text() -> str:
    """The file of the rigs that come with lunarsci."""
    return files("lunarsci.images").joinpath(OWN).read_text("utf-8")


def read_rig(*sources: str | InputFile) -> StereoRig:
    """A rig by name (`yutu2-navcam`), from a TOML file, from files of ROS, OpenCV or Kalibr, or from two labels.

    Labels are PDS4 XML of Chang'E cameras, or text with a CAHV, CAHVOR or CAHVORE model: PDS3 labels and VICAR files.
    Raises DataError for anything else.
    """
    if 1 <= len(sources) <= 2 and sources[0] not in known_rigs():
        given = [read_input(source) for source in sources] if _are_files(sources) else []
        if isinstance(found := rig_or_camera(given), StereoRig):
            return found
        if found is not None:
            raise DataError(f"{given[0].name}: {ONE_CAMERA}")
    if len(sources) == 2:
        return rig_of_labels(read_input(sources[0]), read_input(sources[1]))
    if len(sources) != 1:
        raise DataError("a rig is a name, a TOML file, or two labels, left and right; give one of these")
    if sources[0] in known_rigs():
        return _read(tomllib.loads(own_text())[sources[0]], str(sources[0]))
    try:
        file = read_input(sources[0])
        return _read(toml_document(text(file)), file.name)
    except tomllib.TOMLDecodeError as error:
        hint = "; of labels give two, left and right" if text(file).lstrip().startswith("<") else ""
        raise DataError(f"{file.name}: not valid TOML: {error}{hint}") from error
    except DataError as error:
        if "no such file" in str(error):
            raise DataError(
                f"{sources[0]}: no rig of that name ({', '.join(known_rigs())}) and no such file"
            ) from error
        raise


def _are_files(sources: Sequence[str | InputFile]) -> bool:
    return all(isinstance(source, InputFile) or Path(source).is_file() for source in sources)


def _read(document: Mapping[str, Any], origin: str) -> StereoRig:
    if "camera" in document:
        raise DataError(f"{origin}: {ONE_CAMERA}: calibrate the right one's pictures with it")
    try:
        assumed = (*document.get("assumed", ()), *_assumed(document))
        return _checked(_rig(_plain(document), assumed), origin)
    except KeyError as error:
        raise DataError(f"{origin}: no {error.args[0]}; {FORM}") from error
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise DataError(f"{origin}: {error}") from error


def _checked(rig: StereoRig, origin: str) -> StereoRig:
    """Raises DataError for a rig whose right camera is left of the left one."""
    if not is_swapped(rig.translation_m):
        return rig
    turn, way = vector_of(rig.rotation.T), -rig.rotation.T @ rig.translation_m
    raise DataError(
        f"{origin}: the right camera is left of the left one. If the cameras are swapped exchange [left] and [right], "
        f"with rotation_rad = [{_numbers(turn)}] and translation_m = [{_numbers(way)}]; if translation_m is meant as "
        "the right camera's place in the left one's frame change its signs"
    )


def _rig(plain: Mapping[str, Any], assumed: tuple[str, ...]) -> StereoRig:
    if "baseline_m" in plain and "left" not in plain:
        left = right = _twin(plain)
        rotation, translation = np.eye(3), np.array([-float(plain["baseline_m"]), 0.0, 0.0])
    else:
        left, right = (_camera(plain[side], f"{side} camera") for side in ("left", "right"))
        relative = plain["relative"]
        rotation, translation = rotation_of(relative["rotation_rad"]), np.array(relative["translation_m"], dtype=float)
    sensor = {name: plain[name] for name in SENSOR if name in plain}
    return StereoRig(
        name=str(plain["name"]),
        left=left,
        right=right,
        rotation=rotation,
        translation_m=translation,
        covariance=_covariance(plain),
        sensor=Sensor(**sensor),
        mast_height_m=plain.get("mast_height_m"),
        nearest_m=float(plain.get("nearest_m", 0.0)),
        assumed=assumed,
        source=str(plain.get("source", "")),
    )


def _twin(plain: Mapping[str, Any]) -> Camera:
    """The camera that a rig has twice."""
    width, height, focal = plain["width_px"], plain["height_px"], float(plain["focal_px"])
    middle = plain.get("principal_px", [0.5 * (width - 1), 0.5 * (height - 1)])
    terms = dict(zip(INTRINSICS[4:], plain.get("distortion", [0.0] * 5), strict=True))
    numbers = {"fx_px": focal, "fy_px": focal, "cx_px": middle[0], "cy_px": middle[1]} | terms
    return _camera({"width_px": width, "height_px": height} | numbers, str(plain["name"]))


def _camera(table: Mapping[str, Any], name: str) -> Camera:
    numbers = {key: float(table[key] if index < 4 else table.get(key, 0.0)) for index, key in enumerate(INTRINSICS)}
    return Camera(name=name, width_px=int(table["width_px"]), height_px=int(table["height_px"]), **numbers)


def _covariance(plain: Mapping[str, Any]) -> Any:
    if "covariance" in plain:
        return np.array(plain["covariance"], dtype=float)
    found: dict[str, float] = {}
    for name, value in plain.get("sigma", {}).items():
        both = (f"left_{name}", f"right_{name}") if name in INTRINSICS else (name,)
        found |= dict.fromkeys(SIGMA_GROUPS.get(name, both), float(value))
    return covariance_of(found)


def _plain(value: Any) -> Any:
    """Tables that hold a `value` with its source as the value alone."""
    if isinstance(value, Mapping):
        return value["value"] if "value" in value else {key: _plain(inner) for key, inner in value.items()}
    return value


def _assumed(document: Mapping[str, Any]) -> list[str]:
    marked = [key for key, entry in document.items() if isinstance(entry, Mapping) and entry.get("assumed")]
    return [*marked, *(["sigma"] if document.get("baseline_m") and "sigma" in document else [])]


def rig_text(rig: StereoRig) -> str:
    """The TOML file of a rig, which `read_rig` reads back to the last digit."""
    lines = [f"name = {_quoted(rig.name)}", f"source = {_quoted(rig.source)}"]
    lines.append(f"assumed = [{', '.join(map(_quoted, rig.assumed))}]")
    lines += [f"{name} = {getattr(rig.sensor, name)!r}" for name in SENSOR]
    lines += [f"nearest_m = {rig.nearest_m!r}"]
    lines += [] if rig.mast_height_m is None else [f"mast_height_m = {rig.mast_height_m!r}"]
    lines += [f"# rows and columns: {', '.join(PARAMETERS)}", "covariance = ["]
    lines += [f"  [{_numbers(row)}]," for row in rig.covariance]
    lines += ["]", ""]
    for side, camera in (("left", rig.left), ("right", rig.right)):
        lines += [f"[{side}]", f"width_px = {camera.width_px}", f"height_px = {camera.height_px}"]
        lines += [f"{name} = {float(getattr(camera, name))!r}" for name in INTRINSICS] + [""]
    lines += ["[relative]", f"rotation_rad = [{_numbers(vector_of(rig.rotation))}]"]
    lines += [f"translation_m = [{_numbers(rig.translation_m)}]", ""]
    return "\n".join(lines)


def camera_text(camera: Camera, covariance: FloatArray, *, name: str, source: str) -> str:
    """The TOML file of one camera with the covariance of its intrinsics (9, 9), which `read_camera` reads."""
    lines = [f"name = {_quoted(name)}", f"source = {_quoted(source)}"]
    lines += [f"# rows and columns: {', '.join(INTRINSICS)}", "covariance = ["]
    lines += [f"  [{_numbers(row)}]," for row in covariance]
    lines += ["]", "", "[camera]", f"width_px = {camera.width_px}", f"height_px = {camera.height_px}"]
    return "\n".join([*lines, *(f"{key} = {float(getattr(camera, key))!r}" for key in INTRINSICS), ""])


def _numbers(values: Sequence[float] | Any) -> str:
    return ", ".join(repr(float(value)) for value in values)


def _quoted(words: str) -> str:
    return '"' + words.replace("\\", "\\\\").replace('"', '\\"') + '"'


def check_rig_of(rig: StereoRig, width_px: int, height_px: int, name: str) -> None:
    """Raise DataError where a picture cannot be of a rig's camera."""
    if (width_px, height_px) == rig.left.size == rig.right.size:
        return
    own = " x ".join(map(str, rig.left.size))
    turned = "; it seems to be turned" if (height_px, width_px) == rig.left.size else "; is it another rig's?"
    raise DataError(f"{name}: {width_px} x {height_px} px, and {rig.name} takes pictures of {own}{turned}")


def read_pose(source: str | InputFile) -> Pose:
    """The pose of a left camera: TOML with position_m, heading_deg, down_deg and, if it is not 0, roll_deg.

    Raises DataError.
    """
    file = read_input(source)
    try:
        table = toml_document(text(file))
        heading, down = float(table["heading_deg"]), float(table["down_deg"])
        return Pose.looking(table["position_m"], heading, down, float(table.get("roll_deg", 0.0)))
    except KeyError as error:
        raise DataError(f"{file.name}: no {error.args[0]}; a pose has position_m, heading_deg and down_deg") from error
    except (TypeError, ValueError, OverflowError) as error:
        raise DataError(f"{file.name}: {error}; a pose has position_m, heading_deg and down_deg") from error


def pose_text(pose: Pose) -> str:
    """The TOML file of a pose."""
    heading, down, roll = pose.angles_deg()
    lines = [f"position_m = [{_numbers(pose.center_m)}]", f"heading_deg = {heading!r}", f"down_deg = {down!r}"]
    return "\n".join([*lines, f"roll_deg = {roll!r}", ""])
