"""Stereo rigs and cameras: by name, from TOML files, from the labels of two pictures, and as other programs write them.

ROS: https://docs.ros.org/en/noetic/api/sensor_msgs/html/msg/CameraInfo.html, and Videre's INI. OpenCV:
`cv::FileStorage`, which is YAML with a head and tags that no reader of YAML takes, and XML. Kalibr:
https://github.com/ethz-asl/kalibr/wiki/yaml-formats. COLMAP (https://colmap.github.io/format.html) and Metashape (user
manual, appendix on camera models) count pixels from the corner of the first one, so that its centre is at 0.5; OpenCV
from its centre. Also VINS, ORB-SLAM 3 and instant-ngp.
"""

import io
import re
import tomllib
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.images import LengthUnit
from lunarsci.images.cahv import CahvModel, count_of, is_product, label_of, orthonormal
from lunarsci.images.camera import (
    COARSE_PX,
    INTRINSICS,
    PARAMETERS,
    RELATIVE,
    Camera,
    Pose,
    Sensor,
    StereoRig,
    covariance_of,
    is_swapped,
    rotation_of,
    unstated_covariance,
    vector_of,
)
from lunarsci.images.labels import fit_cahv, read_label, rig_of_labels
from lunarsci.images.pictures import Picture, cv2
from lunarsci.io.documents import json_document, toml_document, xml_root, yaml_document
from lunarsci.io.inputs import InputFile, beginning, read_input, text
from lunarsci.memory import toml_text
from lunarsci.ranges import refuse

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
METRES: Mapping[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Metres of a unit."""
USUAL_BASELINE_M = 0.2
"""Of stereo rigs on rovers: 0.1 m (hazard cameras) to 0.42 m (Maki et al. 2003, 10.1029/2003JE002077). [m]"""
BROWN = ("k1", "k2", "p1", "p2", "k3")
"""Terms of Brown in the order of OpenCV, ROS and Kalibr."""
NAMES: Mapping[str, tuple[str, ...]] = {
    "matrix": ("cameramatrix", "intrinsicmatrix", "k", "m", "mtx", "intrinsics"),
    "lens": ("distortioncoefficients", "distortioncoeffs", "distcoeffs", "distcoeff", "distortion", "dist", "d"),
    "model": ("distortionmodel",),
    "width": ("imagewidth", "width"),
    "height": ("imageheight", "height"),
    "size": ("imagesize", "resolution", "imagedimensions"),
    "rectification": ("rectificationmatrix", "r"),
    "projection": ("projectionmatrix", "p"),
    "name": ("cameraname",),
    "body": ("tbs",),
}
"""What is read of a camera, by names in small letters without what is between them."""
TURN = ("r", "rotation", "rotationmatrix", "rot", "rmat")
SHIFT = ("t", "translation", "translationvector", "trans", "tvec", "transvector")
"""Names of the rotation and of the translation from one camera to the other, in small letters."""
SIDES = (("1", "left", "l"), ("2", "right", "r"))
"""What names of a file of two cameras begin or end with."""
ONE_BY_ONE = (("fx",), ("fy",), ("cx", "ppx"), ("cy", "ppy"))
"""Intrinsics that have a key each, as in ORB-SLAM's settings."""
FISHEYE = ("equidistant", "fisheye", "equi", "kannalabrandt4")
"""Names of the fish-eye model of OpenCV, in small letters."""
KEYS = re.compile(
    r"^[ \t]*[\"']?(?:[\w.]*(?:camera|intrinsic|distort|opencv)\w*|[\w.]*f[xy]|[kmtrd][12]?|T_cn_cnm1|T_BS)[\"']?"
    r"[ \t]*:",
    re.MULTILINE | re.IGNORECASE,
)
"""A line that a file of cameras in YAML has."""
SURELY = re.compile(r"camera_?matrix|distortion_|intrinsics|opencv|camera_model|image_width", re.IGNORECASE)
"""What no other text has."""
ZIPPED, SMALL_BYTES = b"PK\x03\x04", 128 + 16 * 8
"""How an archive begins, and bytes of the largest array of a camera: 4 x 4 doubles and the head of NumPy's format (NEP
1, 2007)."""
STATED = "errors: a file of this kind states none"
CAMERA_FORM = "a camera has image_width, image_height, camera_matrix and distortion_coefficients"
ONE_CAMERA = "is one camera; a rig needs two"
SENSOR = ("bits", "full_well_e", "read_noise_e", "mtf_at_nyquist")
"""Keys of the table of a `Sensor`."""
SIGMA_GROUPS = {"rotation_rad": RELATIVE[:3], "translation_m": RELATIVE[3:]}
"""Keys of errors that stand for three parameters of a rig each."""
FORM = (
    "give [left] and [right] (width_px, height_px, fx_px, fy_px, cx_px, cy_px, k1, k2, k3, p1, p2) and [relative] "
    "(rotation_rad, translation_m), or width_px, height_px, focal_px and baseline_m of two equal cameras side by side"
)


def _written(file: InputFile, start: str) -> Mapping[str, Any] | None:
    """The keys that a file of COLMAP, Metashape, Videre or instant-ngp stands for; None of any other file."""
    if _COLMAP.search(start):
        return {f"cam{one[1]}": _of_colmap(one) for one in _COLMAP.finditer(text(file))}
    if "[image]" in start and "camera matrix" in start:
        return _of_ini(text(file))
    if "<calibration>" in start and "<projection>" in start:
        return _of_metashape(file)
    if start.lstrip().startswith("{") and re.search(r'"fl_x"\s*:', start):
        return _of_transforms(file)
    return None


def _plainer(tree: Mapping[str, Any]) -> Mapping[str, Any]:
    """The keys of settings of VINS and ORB-SLAM 3 as those of one camera, or of two and the way between them."""
    if isinstance(projection := tree.get("projection_parameters"), Mapping):
        lens = tree.get("distortion_parameters")
        tree = {key: one for key, one in tree.items() if not isinstance(one, Mapping)}
        if {"mu", "mv", "u0", "v0"} <= {*projection}:
            place = [projection[name] for name in ("mu", "mv", "u0", "v0")]
            lens = {"d": [projection.get(f"k{k}", 0.0) for k in range(2, 6)], "distortion_model": "equidistant"}
            return {**tree, "intrinsics": place, **lens}
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


def _of_colmap(line: re.Match[str]) -> dict[str, Any]:
    given = dict(zip(COLMAP[line[2]], map(float, line[5].split()), strict=False))
    size = given.get("f", 0.0)
    middle = [given.get(name, 0.0) - CORNER_PX for name in ("cx", "cy")]
    fisheye = line[2] == "OPENCV_FISHEYE"
    terms = ("k1", "k2", "k3", "k4") if fisheye else (*BROWN, "k4", "k5", "k6")
    lens = [given.get(term, 0.0) for term in terms]
    made = _as_camera(line[3], line[4], [given.get("fx", size), given.get("fy", size), *middle], lens)
    return made | {"distortion_model": "equidistant" if fisheye else ""}


def _as_camera(width: object, height: object, pinhole: list[float], lens: list[float]) -> dict[str, Any]:
    """Keys of a camera; `pinhole` is fx, fy, cx, cy [px], `lens` in the order of OpenCV."""
    size = {"image_width": int(str(width)), "image_height": int(str(height))}
    return {**size, "intrinsics": pinhole, "distortion": lens}


def _of_ini(content: str) -> dict[str, Any]:
    parts = _SECTION.split(content)
    size = dict(_SIZE.findall(parts[parts.index("image") + 1]))
    cameras = dict[str, dict[str, Any]]()
    for name, body in zip(parts[1::2], parts[2::2], strict=True):
        blocks = {match[1]: [float(one) for one in match[2].split()] for match in _BLOCK.finditer(body)}
        if "camera matrix" in blocks:
            words = {"camera matrix": "camera_matrix", "distortion": "distortion_coefficients"}
            cameras[name] = {
                **{words.get(key, f"{key}_matrix"): values for key, values in blocks.items()},
                "image_width": int(size["width"]),
                "image_height": int(size["height"]),
            }
    return dict(cameras)


def _of_metashape(file: InputFile) -> dict[str, Any]:
    given = {child.tag: child.text or "" for child in xml_root(file.name, file.data)}
    number = {key: float(one) for key, one in given.items() if key not in ("projection", "date")}
    if given.get("projection") != "frame" or number.get("b2") or number.get("k4"):
        raise DataError(
            f"{file.name}: a camera of Metashape with projection '{given.get('projection')}', b2 or k4; calibrate it "
            "as frame with k1 to k3, p1 and p2 alone"
        )
    width, height, size = (number.get(key, 0.0) for key in ("width", "height", "f"))
    middle = [0.5 * width + number.get("cx", 0.0) - CORNER_PX, 0.5 * height + number.get("cy", 0.0) - CORNER_PX]
    terms = [number.get(key, 0.0) for key in ("k1", "k2", "p2", "p1", "k3")]
    return _as_camera(int(width), int(height), [size + number.get("b1", 0.0), size, *middle], terms)


def _of_transforms(file: InputFile) -> dict[str, Any]:
    given = json_document(text(file))
    pinhole = [given["fl_x"], given.get("fl_y", given["fl_x"]), given["cx"], given["cy"]]
    return _as_camera(int(given["w"]), int(given["h"]), pinhole, [given.get(term, 0.0) for term in BROWN])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WrittenCamera:
    """A camera as a file has it.

    Attributes
    ----------
    camera : of the picture as it is taken.
    rectification, projection : R (3, 3) and P (3, 4) of ROS; None where the file has none.
    body : of EuRoC, from the camera's frame to that of the body (4, 4); None where the file has none.
    remarks : how it was read, where there was a choice.
    """

    camera: Camera
    rectification: FloatArray | None = None
    projection: FloatArray | None = None
    body: FloatArray | None = None
    remarks: tuple[str, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """How it was read, and what P says of its partner."""
        apart = float(np.linalg.norm(self.from_partner_m))
        partner = (f"P: {apart:.4g} m from its partner, whose file makes a rig with this one",) if apart else ()
        return (*self.remarks, *partner, STATED)

    @property
    def from_partner_m(self) -> FloatArray:
        """Where its partner's centre is in its rectified frame, by P. (3,) [m]"""
        given = self.projection
        if given is None or not given[0, 0] > 0 or not given[1, 1] > 0:
            return np.zeros(3)
        return np.array([given[0, 3] / given[0, 0], given[1, 3] / given[1, 1], 0.0])


class _Way(NamedTuple):
    """From one camera's frame to another one's.

    rotation, translation : X_other = rotation X_one + translation. (3, 3), (3,) [unit]
    unit : of the translation, None where the file does not say.
    """

    rotation: FloatArray
    translation: FloatArray
    unit: LengthUnit | None

    @classmethod
    def of(cls, matrix: FloatArray) -> "_Way":
        """Of a matrix (4, 4) in metres."""
        return cls(matrix[:3, :3], matrix[:3, 3], "m")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _LensModel(CahvModel):
    """A camera at the origin with a lens of OpenCV that is not Brown's: rational, thin prism, or fish-eye.

    lens : terms of its distortion, in the order of OpenCV. [-]
    fisheye : whether they are those of the fish-eye model.
    """

    lens: FloatArray
    fisheye: bool

    def project(self, points: FloatArray) -> FloatArray:
        """Pixels (n, 2) of points (n, 3)."""
        matrix = np.stack([self.vectors[name] for name in "HVA"])
        lens = cv2.fisheye.projectPoints if self.fisheye else cv2.projectPoints
        return np.asarray(lens(points.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), matrix, self.lens)[0])[:, 0]


def tree_of(file: InputFile) -> Mapping[str, Any] | None:
    """The keys of a file of YAML, of OpenCV's XML or of NumPy's .npz that has cameras, or a way from one to the other;
    None of any other one. Raises DataError for one that is broken."""
    if is_product(file):
        return None
    start = "" if file.data.startswith(ZIPPED) else beginning(file)
    try:
        if written := _written(file, start):
            return written
        if "<opencv_storage" in start:
            tree = _of_element(xml_root(file.name, file.data))
        elif file.data.startswith(ZIPPED):
            tree = _of_archive(file)
        else:
            tree = _of_yaml(file, start) if KEYS.search(start) else None
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        if isinstance(error, DataError):
            raise
        raise DataError(f"{file.name}: a camera that lacks something ({str(error)[:80]}); export it again") from error
    return tree if isinstance(tree, Mapping) and (_cameras_in(tree) or _way_in(tree)) else None


def _of_yaml(file: InputFile, start: str) -> Any:
    try:
        tree = yaml_document(text(file))
    except ValueError as error:
        if not SURELY.search(start):
            return None
        raise DataError(f"{file.name}: broken YAML: {error}; fetch it again") from error
    return _plainer(tree) if isinstance(tree, Mapping) else tree


def _of_archive(file: InputFile) -> dict[str, Any] | None:
    """The small arrays of NumPy's .npz, by their names; None of any other archive."""
    try:
        with np.load(io.BytesIO(file.data), allow_pickle=False) as archive:
            small = [one.filename for one in archive.zip.infolist() if one.file_size <= SMALL_BYTES]
            return {name.removesuffix(".npy"): archive[name].squeeze().tolist() for name in small}
    except (ValueError, OSError, zipfile.BadZipFile):
        return None


def _of_element(node: Element) -> Any:
    if len(node):
        return {child.tag: _of_element(child) for child in node}
    words = (node.text or "").split()
    return words[0] if len(words) == 1 else words


def _flattened(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Keys in small letters without what is between them; intrinsics that have a key each as a matrix and its lens."""
    keys = {re.sub(r"[^a-z0-9]", "", str(key).lower()): value for key, value in tree.items()}
    keys = {re.sub("^camera(?!matrix|name)", "", key): value for key, value in keys.items()}
    cells = [next((keys[name] for name in names if name in keys), None) for names in ONE_BY_ONE]
    if None not in cells:
        keys |= {"intrinsics": cells}
        keys |= {"d": [keys.get(term, 0.0) for term in BROWN]} if "k1" in keys else {}
    return keys


def _part(tree: Mapping[str, Any], side: Sequence[str]) -> dict[str, Any]:
    """Keys of one camera of two, without what tells the camera, and those that both share."""
    names = {name for group in NAMES.values() for name in group}
    bare = {cut(mark): value for mark in side for key, value in tree.items()
            for cut in (key.removeprefix, key.removesuffix) if cut(mark) != key and cut(mark) in names}  # fmt: skip
    return {**tree, **bare}


def _has_camera(tree: Mapping[str, Any]) -> bool:
    matrix = next((tree[name] for name in NAMES["matrix"] if name in tree), None)
    return matrix is not None and len(_floats(matrix)) in (4, 9)


def _cameras_in(tree: Mapping[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """Cameras of a file, by name: one, those of a chain, or two whose names tell them apart."""
    chain = [(str(key), _flattened(value)) for key, value in tree.items() if isinstance(value, Mapping)]
    if nested := [(key, value) for key, value in chain if _has_camera(value)]:
        return nested
    flat = _flattened(tree)
    if _has_camera(flat):
        return [(str(flat.get("cameraname", "")), flat)]
    parts = [(side[1], _part(flat, side)) for side in SIDES]
    return [(name, part) for name, part in parts if _has_camera(part)]


def _way_in(tree: Mapping[str, Any]) -> "_Way | None":
    """The way from the first camera's frame to the second one's, if a file has one."""
    flat = _flattened(tree)
    for value in tree.values():
        chain = _floats(_flattened(value).get("tcncnm1", ())) if isinstance(value, Mapping) else np.empty(0)
        if chain.size == 16:
            return _Way.of(chain.reshape(4, 4))
    shift, turn = (next((_floats(flat[n]) for n in names if n in flat), np.empty(0)) for names in (SHIFT, TURN))
    if shift.size != 3 or turn.size not in (3, 9):
        return None
    return _Way(rotation_of(turn) if turn.size == 3 else turn.reshape(3, 3), shift, None)


def _floats(value: Any) -> FloatArray:
    """Numbers of a list, of lists, or of a matrix with `data`; none where something in it is no number."""
    if isinstance(value, Mapping):
        value = value.get("data", ())
    try:
        return np.array(value, dtype=float).ravel()
    except (TypeError, ValueError):
        return np.empty(0)


def _camera_of(file: str, name: str, tree: Mapping[str, Any], picture_px: tuple[int, int] | None) -> WrittenCamera:
    """Raises DataError for one that lacks something; `picture_px` stands for a size that the file does not have."""
    given = {what: next((tree[key] for key in names if key in tree), ()) for what, names in NAMES.items()}
    matrix, lens = _floats(given["matrix"]), _floats(given["lens"])
    fx, fy, cx, cy = map(float, matrix if matrix.size == 4 else matrix[[0, 4, 2, 5]])
    size: list[Any] = [given["width"], given["height"]]
    if () in size:
        size = list(_floats(given["size"])) or list(picture_px or ())
    if len(size) != 2:
        raise DataError(f"{file}: the size of the picture is missing; add image_width: … and image_height: …, or give "
                        "`picture_size`")  # fmt: skip
    width, height = (count_of(file, one, what) for one, what in zip(size, ("samples", "lines"), strict=True))
    title = str(given["name"] or name or file)
    plain = Camera(name=title, width_px=width, height_px=height, fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy)
    model = str(given["model"] or "").lower().replace("_", "").replace(" ", "")
    camera, remarks = _bent(plain, lens, model)
    turn, onto, body = (_floats(given[key]) for key in ("rectification", "projection", "body"))
    return WrittenCamera(
        camera=camera,
        rectification=orthonormal(turn.reshape(3, 3)) if turn.size == 9 and turn.any() else None,
        projection=onto.reshape(3, 4) if onto.size == 12 else None,
        body=body.reshape(4, 4) if body.size == 16 else None,
        remarks=remarks,
    )


def _bent(plain: Camera, lens: FloatArray, model: str) -> tuple[Camera, tuple[str, ...]]:
    """A camera with its lens: Brown's terms as they are, any other by the nearest ones."""
    fisheye = model in FISHEYE
    if not lens.any() and not fisheye:
        return plain, ()
    if model == "fov" or lens.size > 14:
        raise ParameterError(f"{plain.name}: a lens '{model}' of {lens.size} numbers is not known; give plumb_bob")
    if not fisheye and not lens[len(BROWN) :].any():
        terms = dict(zip(BROWN, map(float, lens), strict=False))
        return replace(plain, **terms), ()  # type: ignore[arg-type]
    vectors = {"C": np.zeros(3), "A": np.array([0.0, 0.0, 1.0])}
    vectors |= {"H": np.array([plain.fx_px, 0.0, plain.cx_px]), "V": np.array([0.0, plain.fy_px, plain.cy_px])}
    size = {"width_px": plain.width_px, "height_px": plain.height_px}
    fitted = fit_cahv(_LensModel(vectors=vectors, lens=lens, fisheye=fisheye, **size), plain.name)
    missed = (
        f"a {'fish-eye' if fisheye else 'rational'} lens, fitted by Brown's terms to {fitted.residual_max_px:.2g} px"
    )
    doubt = "; its edge is not to be trusted" if fitted.residual_max_px > COARSE_PX else ""
    return fitted.camera, (missed + doubt,)


def is_rig(file: InputFile) -> bool:
    """Whether a file by itself has two cameras, and the way between them. Raises DataError for a broken one."""
    tree = tree_of(file)
    return tree is not None and len(_cameras_in(tree)) == 2 and _way_in(tree) is not None


def rig_or_camera(
    files: Sequence[InputFile], unit: LengthUnit | None = None, picture_px: tuple[int, int] | None = None
) -> "StereoRig | WrittenCamera | None":
    """The rig, or the one camera, that one or two files of ROS, OpenCV or Kalibr tell; None where one is none of these.

    Two files are of the left and the right camera, or of both cameras and of the way between them. `unit` is that of
    OpenCV's translation, whose file never says it, and `picture_px` the size of pictures of cameras without one. Raises
    DataError.
    """
    trees = [tree for file in files if (tree := tree_of(file)) is not None]
    if not trees or len(trees) < len(files):
        return None
    names = ", ".join(file.name for file in files)
    try:
        named = [(file.name, *one) for file, tree in zip(files, trees, strict=True) for one in _cameras_in(tree)]
        cameras = [_camera_of(*one, picture_px) for one in named]
        if len(cameras) == 1 and len(files) == 1:
            return cameras[0]
        if len(cameras) != 2:
            raise ParameterError(f"{len(cameras)} cameras; a rig has two, {CAMERA_FORM}")
        way = next((way for tree in trees if (way := _way_in(tree)) is not None), None)
        bodies = [one.body for one in cameras if one.body is not None]
        if way is None and len(bodies) == 2:
            way = _Way.of(np.linalg.inv(bodies[1]) @ bodies[0])
        rig = _rig_of_written(names, cameras, way, unit)
        if not is_swapped(rig.translation_m):
            return rig
        if named[0][0] != named[1][0]:
            raise ParameterError("left and right are swapped; give the left one first")
        return _exchanged(rig)
    except (ParameterError, TypeError, ValueError, OverflowError) as error:
        raise DataError(f"{names}: {error}") from error


def _exchanged(rig: StereoRig) -> StereoRig:
    """A rig with its first camera as the right one."""
    note = "the second camera stands left of the first one, and is taken as the left one"
    return replace(
        rig,
        left=rig.right,
        right=rig.left,
        rotation=rig.rotation.T,
        translation_m=-rig.rotation.T @ rig.translation_m,
        read_as=(*rig.read_as, note),
    )


def _rig_of_written(names: str, cameras: list[WrittenCamera], way: _Way | None, unit: LengthUnit | None) -> StereoRig:
    """A rig whose cameras stand as the way between them says, else as P of both does."""
    first, second = cameras
    remarks = [*first.remarks, *(one for one in second.remarks if one not in first.remarks)]
    by_projection = second.from_partner_m - first.from_partner_m
    if way is not None:  # P of OpenCV is in the unit of its T
        scale, notes = _scale_of(float(np.linalg.norm(way.translation)), way.unit or unit)
        rotation, translation = orthonormal(way.rotation), scale * way.translation
        remarks += notes
    elif by_projection.any():
        turns = [np.eye(3) if one.rectification is None else one.rectification for one in cameras]
        rotation, translation = turns[1].T @ turns[0], turns[1].T @ by_projection
        remarks.append("baseline from the projection matrices P; intrinsics are those of pictures before rectification")
    else:
        raise ParameterError(
            "the place of the right camera to the left one is missing; give P of both (ROS), T_cn_cnm1 (Kalibr), or R "
            "and T (OpenCV), in the file or in one beside it"
        )
    return StereoRig(
        name=names,
        left=first.camera,
        right=second.camera,
        rotation=rotation,
        translation_m=translation,
        covariance=unstated_covariance(first.camera, second.camera, translation),
        assumed=("its errors",),
        source=f"calibration {names}",
        read_as=tuple(remarks),
    )


def _scale_of(length: float, unit: LengthUnit | None) -> tuple[float, list[str]]:
    """Metres in the unit of a translation: the one asked for, else m or mm, whichever makes the baseline more usual."""
    if unit is not None:
        return METRES[unit], []
    apart = {name: abs(np.log(max(length, 1e-12) * METRES[name] / USUAL_BASELINE_M)) for name in ("m", "mm")}
    likely = min(apart, key=lambda name: apart[name])
    return METRES[likely], [
        f"T is in {likely}, a baseline of {length * METRES[likely]:.4g} m, as the file names no unit "
        "(`translation_unit`)"
    ]


@contextmanager
def _read_from(name: str, form: str) -> Iterator[None]:
    """What a file lacks, or has wrong, as a DataError with its name and the form that it should have."""
    try:
        yield
    except DataError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        lacks = f"no {error.args[0]}; {form}" if isinstance(error, KeyError) else str(error)
        raise DataError(f"{name}: {lacks}") from error


class SingleCamera(NamedTuple):
    """A camera alone.

    Attributes
    ----------
    camera : with its distortion.
    covariance : of its `INTRINSICS`. (9, 9)
    source : where its numbers are from.
    """

    camera: Camera
    covariance: FloatArray
    source: str


def read_camera(file: InputFile) -> SingleCamera | None:
    """The camera of a file that `camera_text` made; None for any other TOML. Raises DataError."""
    with _read_from(file.name, "a camera has a name, a covariance and [camera]"):
        plain = toml_document(text(file))
        if "camera" not in plain:
            return None
        covariance = np.array(plain["covariance"], dtype=float)
        if covariance.shape != (len(INTRINSICS),) * 2 or not np.isfinite(covariance).all():
            raise ValueError(f"its covariance has shape {covariance.shape}; give 9 x 9 numbers")
        return SingleCamera(_camera(plain["camera"], str(plain["name"])), covariance, str(plain.get("source", "")))


def rigs_text() -> str:
    """The file of the rigs that come with lunarsci."""
    return files("lunarsci.images").joinpath("rigs.toml").read_text("utf-8")


def rig_names() -> tuple[str, ...]:
    """Names of the rigs that come with lunarsci."""
    return tuple(tomllib.loads(rigs_text()))


def read_rig(*sources: str | InputFile, picture_px: tuple[int, int] | None = None) -> StereoRig:
    """A rig by name (`yutu2-navcam`), from a TOML file, from files of ROS, OpenCV or Kalibr, or from two labels.

    Labels are PDS4 XML of Chang'E cameras, or text with a CAHV, CAHVOR or CAHVORE model: PDS3 labels and VICAR files.
    `picture_px` is the size of their pictures, where a file of OpenCV does not say it. Raises DataError.
    """
    given, first = tomllib.loads(rigs_text()), str(sources[0]) if sources else ""
    if len(sources) == 1 and first in given:
        return _read(given[first], first)
    named = len(sources) == 1 and isinstance(sources[0], str) and first != "-" and not Path(first).exists()
    reasons = {
        "a rig is a name, a TOML file, or two labels, left and right; give one of these": len(sources) not in (1, 2),
        f"{first}: no rig of that name ({', '.join(given)}) and no such file": named,
    }
    refuse(reasons, "", DataError)
    inputs = [read_input(source) for source in sources]
    written = rig_or_camera(inputs, picture_px=picture_px)
    if isinstance(written, StereoRig):
        return written
    if written is not None:
        raise DataError(f"{inputs[0].name}: {ONE_CAMERA}")
    if len(inputs) == 2:
        return rig_of_labels(*inputs)
    content = text(inputs[0])
    try:
        return _read(toml_document(content), inputs[0].name)
    except tomllib.TOMLDecodeError as error:
        hint = "; of labels give two, left and right" if content.lstrip().startswith("<") else ""
        raise DataError(f"{inputs[0].name}: not valid TOML: {error}{hint}") from error


def _read(document: Mapping[str, Any], origin: str) -> StereoRig:
    """Raises DataError for a rig whose right camera is left of the left one."""
    if "camera" in document:
        raise DataError(f"{origin}: {ONE_CAMERA}: calibrate the right one's pictures with it")
    with _read_from(origin, FORM):
        rig = _rig(_plain(document), (*document.get("assumed", ()), *_assumed(document)))
    if not is_swapped(rig.translation_m):
        return rig
    turn, way = vector_of(rig.rotation.T), -rig.rotation.T @ rig.translation_m
    raise DataError(
        f"{origin}: the right camera is left of the left one. If the cameras are swapped exchange [left] and [right], "
        f"with rotation_rad = {turn.tolist()} and translation_m = {way.tolist()}; if translation_m is meant as "
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
    size = int(table["width_px"]), int(table["height_px"])
    lens = CahvModel.of_table(table["lens"], size) if "lens" in table else None
    return Camera(name=name, width_px=size[0], height_px=size[1], lens=lens, **numbers)


def _covariance(plain: Mapping[str, Any]) -> Any:
    if "covariance" in plain:
        return np.array(plain["covariance"], dtype=float)
    sigmas: dict[str, float] = {}
    for name, value in plain.get("sigma", {}).items():
        both = (f"left_{name}", f"right_{name}") if name in INTRINSICS else (name,)
        sigmas |= dict.fromkeys(SIGMA_GROUPS.get(name, both), float(value))
    return covariance_of(sigmas)


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
    given = {key: getattr(rig, key) for key in ("name", "source", "assumed", "nearest_m", "mast_height_m")}
    lines = toml_text(given | {name: getattr(rig.sensor, name) for name in SENSOR}).splitlines()
    lines += [*_covariance_lines(PARAMETERS, rig.covariance), ""]
    for side, camera in (("left", rig.left), ("right", rig.right)):
        lines += [*_camera_lines(side, camera), ""]
    way = {"rotation_rad": vector_of(rig.rotation), "translation_m": rig.translation_m}
    return "\n".join([*lines, "[relative]", toml_text(way)])


def camera_text(camera: Camera, covariance: FloatArray, *, name: str, source: str) -> str:
    """The TOML file of one camera with the covariance of its intrinsics (9, 9), which `read_camera` reads."""
    lines = [*toml_text({"name": name, "source": source}).splitlines(), *_covariance_lines(INTRINSICS, covariance), ""]
    return "\n".join([*lines, *_camera_lines("camera", camera), ""])


def _covariance_lines(names: Sequence[str], covariance: FloatArray) -> list[str]:
    """Of a TOML file, with the names of rows and columns as a remark."""
    rows = [f"  {row}," for row in covariance.tolist()]
    return [f"# rows and columns: {', '.join(names)}", "covariance = [", *rows, "]"]


def _camera_lines(table: str, camera: Camera) -> list[str]:
    numbers: dict[str, Any] = {"width_px": camera.width_px, "height_px": camera.height_px}
    numbers |= {key: float(getattr(camera, key)) for key in INTRINSICS}
    lens = camera.lens.to_dict() if isinstance(camera.lens, CahvModel) else None
    return [f"[{table}]", *toml_text(numbers | {"lens": lens}).splitlines()]


def check_pictures(rig: StereoRig, pictures: Sequence[Picture]) -> None:
    """Raise DataError where a picture cannot be of a rig's camera, or shows nothing."""
    for picture in pictures:
        if not picture.size == rig.left.size == rig.right.size:
            given, needed = (" x ".join(map(str, size)) for size in (picture.size, rig.left.size))
            turned = "it seems to be turned" if picture.size[::-1] == rig.left.size else "is it another rig's?"
            raise DataError(f"{picture.source.name}: {given} px, and {rig.name} takes pictures of {needed}; {turned}")
        picture.check()


def read_pose(source: str | InputFile) -> Pose:
    """The pose of a left camera: TOML with position_m, heading_deg, down_deg and, if it is not 0, roll_deg; or that of
    the label of its picture.

    Raises DataError.
    """
    file = read_input(source)
    if label_of(file):
        return read_label(file).pose
    with _read_from(file.name, "a pose has position_m, heading_deg and down_deg"):
        table = toml_document(text(file))
        roll = float(table.get("roll_deg", 0.0))
        return Pose.looking(table["position_m"], float(table["heading_deg"]), float(table["down_deg"]), roll)


def pose_text(pose: Pose) -> str:
    """The TOML file of a pose."""
    return "".join(f"{key} = {value!r}\n" for key, value in pose.to_dict().items())
