"""Cameras and heights among files that other programs write: told by their content, and what is in them."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lunarsci.io.inputs import InputFile

LABEL_OF_CAMERA = re.compile(r"^\s*MODEL_COMPONENT_1\s*=|_point_observe_vector>", re.MULTILINE)
MAP = re.compile(r"^\s*OBJECT\s*=\s*\"?IMAGE_MAP_PROJECTION", re.MULTILINE)
HEIGHTS = re.compile(
    r"\bUNIT\s*=\s*\"?(?:KILO)?M(?:ET(?:ER|RE)S?)?\b|elevation|topograph|terrain|\bD[TE]M|radius", re.I
)
"""What a label of a map says of heights."""
LABEL_BYTES = 1 << 16
"""A label is in so many; assumed."""


def kind_of_rover_file(file: InputFile, start: str) -> str:
    """`camera`, `rig` or `terrain`; '' of any other file. `start` are its first lines. Raises DataError."""
    from lunarsci.images.rig_files import is_rig, tree_of

    if LABEL_OF_CAMERA.search(start):
        return "camera"
    if is_map_of_heights(start) or is_table_of_heights(file, start):
        return "terrain"
    if tree_of(file) is None:
        return ""
    return "rig" if is_rig(file) else "camera"


def is_map_of_heights(label: str) -> bool:
    """Whether a PDS3 label is of a map of heights."""
    return bool(MAP.search(label) and HEIGHTS.search(label))


def is_image_of_heights(name: str) -> bool:
    """Whether an image has a label of a map of heights, at its begin or beside it."""
    labels = [Path(name).with_suffix(end) for end in (".lbl", ".LBL")]
    own = next((label for label in labels if label.is_file()), Path(name))
    with own.open("rb") as stream:
        return is_map_of_heights(stream.read(LABEL_BYTES).decode("latin-1"))


def is_envi_of_heights(name: str) -> bool:
    """Whether an image has a header of ENVI beside it with one band on a map."""
    header = Path(name).with_suffix(".hdr")
    content = header.read_text("latin-1") if header.is_file() else ""
    return bool(
        content.startswith("ENVI") and re.search(r"^bands\s*=\s*1\s*$", content, re.M) and "map info" in content
    )


def is_table_of_heights(file: InputFile, start: str) -> bool:
    """Whether a text is a grid of heights, or has a row for each node."""
    from lunarsci.heights.texts import node_columns

    if start[:6].lower().startswith(("ncols", "nrows")) or Path(file.name).suffix.lower() == ".xyz":
        return True
    whole = start if len(start) < LABEL_BYTES // 2 else start.rpartition("\n")[0]
    # Telemetry and positions have x, y and z beside others.
    return node_columns(file, whole, alone=True) is not None


def states_named_otherwise(columns: Sequence[str]) -> list[str]:
    """Columns of wheel states that are there by other names, or in other units, where there are two or more."""
    from lunarsci.regolith.written_columns import QUANTITIES, of_name

    found = [what.target for name in columns if (what := of_name(name)) and what.target not in columns]
    own = [one.column for one in QUANTITIES if one.column in columns]
    return found if len(found) + len(own) > 1 else []


def telemetry_named_otherwise(columns: Sequence[str]) -> list[str]:
    """Columns of telemetry and positions that are there by names of ROS, or in other units."""
    from lunarsci.twin.telemetry.reading import named_columns, ros_names

    ros = ros_names(list(columns))
    if not any(name.startswith("angle_") for name in ros):  # places, whichever way the rover looks
        ros = [name for name in ros if name != "yaw_deg"]
    return ros + [name for name in named_columns(list(columns)) if name not in columns]


def camera_contents(file: InputFile) -> Mapping[str, Any]:
    """What `images cameras` finds of one camera."""
    from lunarsci.images.jobs.cameras import cameras

    (camera,) = cameras([file]).to_dict()["cameras"]
    told = {
        "size_px": f"{camera['width_px']} x {camera['height_px']}",
        "focal length_px": f"{camera['fx_px']:.6g}",
        "view_deg": f"{camera['view_across_deg']:.1f} x {camera['view_down_deg']:.1f}",
    }
    if "down_deg" in camera:
        told |= {"looks": f"heading {camera['heading_deg']:.2f}, down {camera['down_deg']:.2f} deg"}
    return told | {"read as": "; ".join(camera["remarks"]) or "as written"}
