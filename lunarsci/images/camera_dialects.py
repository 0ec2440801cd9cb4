"""Cameras in the words of other programs, as the keys of `camera_files`: COLMAP, Metashape, Videre's INI of ROS, VINS.

Also ORB-SLAM 3 and instant-ngp. COLMAP (https://colmap.github.io/format.html) and Metashape (user manual, appendix on
camera models) count pixels from the corner of the first one, so that its centre is at 0.5; OpenCV from its centre.
"""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from lunarsci.errors import DataError
from lunarsci.io.documents import json_document, xml_root
from lunarsci.io.inputs import InputFile, text

COLMAP: Mapping[str, tuple[str, ...]] = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "OPENCV_FISHEYE": ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
}
"""Models of COLMAP and their numbers, in order."""
CORNER_PX = 0.5
"""From the corner of the first pixel to its centre."""
_COLMAP = re.compile(rf"^\s*(\d+)\s+({'|'.join(COLMAP)})\s+(\d+)\s+(\d+)\s+(.*)$", re.MULTILINE)
_SECTION = re.compile(r"^\s*\[([^\]]+)\]\s*$", re.MULTILINE)
_BLOCK = re.compile(r"^(camera matrix|distortion|rectification|projection)\s*\n((?:[-+\d.eE \t]+\n?)+)", re.MULTILINE)
_SIZE = re.compile(r"^(width|height)\s+(\d+)", re.MULTILINE)
_SIDE = re.compile(r"^Camera([12])\.(\w+)$")
_TERMS = ("k1", "k2", "p1", "p2", "k3")


def written_tree(file: InputFile, start: str) -> Mapping[str, Any] | None:
    """The keys that a file of COLMAP, Metashape, Videre or instant-ngp stands for; None of any other file.

    Raises DataError for a model with terms that Brown's have not.
    """
    try:
        return _written(file, start)
    except DataError:
        raise
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise DataError(f"{file.name}: a camera that lacks something ({str(error)[:80]}); export it again") from error


def _written(file: InputFile, start: str) -> Mapping[str, Any] | None:
    if _COLMAP.search(start):
        return {f"cam{one[1]}": _of_colmap(one) for one in _COLMAP.finditer(text(file))}
    if "[image]" in start and "camera matrix" in start:
        return _of_ini(text(file))
    if "<calibration>" in start and "<projection>" in start:
        return _of_metashape(file)
    if start.lstrip().startswith("{") and re.search(r'"fl_x"\s*:', start):
        return _of_transforms(file)
    return None


def plainer(tree: Mapping[str, Any]) -> Mapping[str, Any]:
    """The keys of settings of VINS and ORB-SLAM 3 as those of one camera, or of two and the way between them."""
    if isinstance(projection := tree.get("projection_parameters"), Mapping):
        lens = tree.get("distortion_parameters")
        tree = {key: one for key, one in tree.items() if not isinstance(one, Mapping)}
        if {"mu", "mv", "u0", "v0"} <= {*projection}:
            place = [projection[name] for name in ("mu", "mv", "u0", "v0")]
            own = {"d": [projection.get(f"k{k}", 0.0) for k in range(2, 6)], "distortion_model": "equidistant"}
            return {**tree, "intrinsics": place, **own}
        return {**tree, **projection, **(lens if isinstance(lens, Mapping) else {})}
    sides = {str(key): match for key in tree if (match := _SIDE.match(str(key)))}
    if not sides:
        return tree
    shared = {"image_width": tree.get("Camera.width"), "image_height": tree.get("Camera.height")}
    shared |= {"distortion_model": "equidistant"} if "Kannala" in str(tree.get("Camera.type")) else {}
    cameras = dict[str, dict[str, Any]]()
    for key, match in sides.items():
        cameras.setdefault(match[1], dict(shared))[match[2]] = tree[key]
    if len(cameras) == 1:
        return next(iter(cameras.values()))
    between = tree.get("Stereo.T_c1_c2")
    if isinstance(between, Mapping) and len(between.get("data", ())) == 16:
        matrix = np.linalg.inv(np.array(between["data"], dtype=float).reshape(4, 4))
        cameras["2"]["T_cn_cnm1"] = matrix.tolist()
    return {"left": cameras["1"], "right": cameras["2"]}


def _of_colmap(found: re.Match[str]) -> dict[str, Any]:
    given = dict(zip(COLMAP[found[2]], map(float, found[5].split()), strict=False))
    size = given.get("f", 0.0)
    fx, fy = given.get("fx", size), given.get("fy", size)
    fisheye = found[2] == "OPENCV_FISHEYE"
    terms = ("k1", "k2", "k3", "k4") if fisheye else (*_TERMS, "k4", "k5", "k6")
    return {
        "image_width": int(found[3]),
        "image_height": int(found[4]),
        "intrinsics": [fx, fy, given.get("cx", 0.0) - CORNER_PX, given.get("cy", 0.0) - CORNER_PX],
        "distortion": [given.get(term, 0.0) for term in terms],
        "distortion_model": "equidistant" if fisheye else "",
    }


def _of_ini(content: str) -> dict[str, Any]:
    parts = _SECTION.split(content)
    size = dict(_SIZE.findall(parts[parts.index("image") + 1]))
    cameras = dict[str, dict[str, Any]]()
    for name, body in zip(parts[1::2], parts[2::2], strict=True):
        own = {match[1]: [float(one) for one in match[2].split()] for match in _BLOCK.finditer(body)}
        if "camera matrix" in own:
            words = {"camera matrix": "camera_matrix", "distortion": "distortion_coefficients"}
            cameras[name] = {
                **{words.get(key, f"{key}_matrix"): values for key, values in own.items()},
                "image_width": int(size["width"]),
                "image_height": int(size["height"]),
            }
    return dict(cameras)


def _of_metashape(file: InputFile) -> dict[str, Any]:
    given = {child.tag: child.text or "" for child in xml_root(file.name, file.data)}
    try:
        number = {key: float(one) for key, one in given.items() if key not in ("projection", "date")}
    except ValueError as error:
        raise DataError(f"{file.name}: {error}; export the calibration again") from error
    if given.get("projection") != "frame" or number.get("b2") or number.get("k4"):
        raise DataError(
            f"{file.name}: a camera of Metashape with projection '{given.get('projection')}', b2 or k4; calibrate it "
            "as frame with k1 to k3, p1 and p2 alone"
        )
    width, height, size = (number.get(key, 0.0) for key in ("width", "height", "f"))
    middle = [0.5 * width + number.get("cx", 0.0) - CORNER_PX, 0.5 * height + number.get("cy", 0.0) - CORNER_PX]
    terms = [number.get(key, 0.0) for key in ("k1", "k2", "p2", "p1", "k3")]
    return {
        "image_width": int(width),
        "image_height": int(height),
        "intrinsics": [size + number.get("b1", 0.0), size, *middle],
        "distortion": terms,
    }


def _of_transforms(file: InputFile) -> dict[str, Any]:
    try:
        given = json_document(text(file))
        return {
            "image_width": int(given["w"]),
            "image_height": int(given["h"]),
            "intrinsics": [given["fl_x"], given.get("fl_y", given["fl_x"]), given["cx"], given["cy"]],
            "distortion": [given.get(term, 0.0) for term in _TERMS],
        }
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(f"{file.name}: transforms without {error}; a camera has fl_x, fl_y, cx, cy, w and h") from error
