"""Cameras and heights among files that other programs write: told by their content, and what is in them."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

from lunarsci.inputs import InputFile

LABEL_OF_CAMERA = re.compile(r"^\s*MODEL_COMPONENT_1\s*=|_point_observe_vector>", re.MULTILINE)
LABEL_OF_HEIGHTS = re.compile(r"^\s*OBJECT\s*=\s*IMAGE_MAP_PROJECTION", re.MULTILINE)


def kind_of_rover_file(file: InputFile, start: str) -> str:
    """`camera`, `rig` or `terrain`; '' of any other file. `start` are its first lines. Raises DataError."""
    from lunarsci.images.camera_files import is_rig, tree_of

    if LABEL_OF_CAMERA.search(start):
        return "camera"
    if LABEL_OF_HEIGHTS.search(start):
        return "terrain"
    if tree_of(file) is None:
        return ""
    return "rig" if is_rig(file) else "camera"


def states_named_otherwise(columns: Sequence[str]) -> list[str]:
    """Columns of wheel states that are there by other names, or in other units, where two or more of them are."""
    from lunarsci.regolith.written_columns import of_name

    found = [what.target for name in columns if (what := of_name(name)) and what.target not in columns]
    return found if len(found) > 1 else []


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
