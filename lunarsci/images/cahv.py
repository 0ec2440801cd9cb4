"""Cameras of the CAHV family: their formula, and where labels and files of JPL keep it.

CAHV is of Yakimovsky & Cunningham (1978), 10.1016/0146-664X(78)90112-0; CAHVOR and CAHVORE of Gennery (2006),
10.1007/s11263-006-5168-1. Signs, types and the place of each number are those of JPL's own programs, VICAR's
`cmod_cahvore.c`, `PigCAHVORE.cc` and `PigFileModelMER.cc` (https://github.com/NASA-AMMOS/VICAR). Labels of PDS3 and
VICAR are `KEY = value` in groups, those of PDS4 XML; VICAR's text files have a line a vector. It is our own since no
library reads the models of all four.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError
from lunarsci.io.documents import xml_root
from lunarsci.io.inputs import InputFile, read_input, text
from lunarsci.ranges import refuse

MOST_PX = 65_535
"""Lines or samples of a picture: the most that JPEG has (ITU-T T.81, 1992, B.2.2)."""
LABEL_BYTES = 1 << 18
"""Of a file that labels lie in: five times those of Mars 2020."""
RANGES = (2.0, 5.0, 20.0)
"""Ranges that a model is looked at by, since the pupil of CAHVORE moves; a lens is right at the first one; assumed.
[m]"""
LINEARITY = {1.0: 1.0, 2.0: 0.0}
"""Of CAHVORE's types, perspective and fish-eye; the third one states its own: Gennery (2006) and `cmod_cahvore.c`."""
NUMBER = r"[-+]?(?:\d++\.?+\d*+|\.\d++)(?:[eEdD][-+]?\d++)?"
"""A number of a label."""
LEVEL = ("SITE", "LOCAL_LEVEL", "LANDER")
"""Begins of names of frames whose z is the vertical."""
DOWNWARDS = (*LEVEL, "ROVER")
"""Begins of names of frames whose z points down: Maki et al. (2003), 10.1029/2003JE002077, for MER; MSL and Mars 2020
as well."""
_VALUE = rf"\([^()]*+\)|\"[^\"]*+\"|'[^']*+'|[^\s,=]++(?:[ \t,]++{NUMBER}(?![\w=]))*+"
_ENTRY = re.compile(rf"\b(END_(?:GROUP|OBJECT))\b|(?<![\w:^])([\w:^]++)[ \t]*+=\s*+({_VALUE})")
_NUMBERS = re.compile(r"\.(img|vic|dat|2[abc])", re.IGNORECASE)
_ODL, _VICAR = re.compile(rb"^\s*(?:PDS|ODL)_VERSION_ID"), re.compile(rb"\bLBLSIZE\s*=\s*(\d{1,8})")
_LETTERS = {"center": "C", "axis": "A", "horizontal": "H", "vertical": "V", "optical": "O", "radial": "R",
            "entrance": "E"}  # fmt: skip
Values = Mapping[tuple[str, str], str]
"""Values of a label by group and key; the first one where a key comes twice."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CahvModel:
    """A camera of the CAHV family: centre C, axis A, image vectors H and V, optical axis O, radial R, entrance E.

    A point at X is seen at u = H.p / A.p, v = V.p / A.p. For CAHV p = X - C. With zeta = (X - C).O, and lambda the
    part of X - C across O,

        CAHVOR:   p = zeta O + lambda (1 + r0 + r1 t^2 + r2 t^4),      t = |lambda| / zeta
        CAHVORE:  p = (|lambda| / chi) O + lambda (1 + r0 + r1 chi^2 + r2 chi^4)
                  chi = tan(P theta) / P, theta or sin(P theta) / P for P > 0, 0 or less
                  zeta sin(theta) - |lambda| cos(theta) - (theta - sin(theta)) (e0 + e1 theta^2 + e2 theta^4) = 0

    Attributes
    ----------
    vectors : by letter, (3,); C and E in m, H and V in px, the others without unit. O, R and E may be missing.
    linearity : P of CAHVORE: 1 perspective, 0 fish-eye.
    width_px, height_px : size of its picture. [px]
    """

    vectors: Mapping[str, FloatArray]
    width_px: int
    height_px: int
    linearity: float = 1.0

    def project(self, points: FloatArray) -> FloatArray:
        """Pixels (n, 2) of points (n, 3) of the model's frame [m]; NaN for those that it does not see."""
        v = self.vectors
        seen = points - v["C"]
        if "O" in v:
            along = seen @ v["O"]
            aside = seen - along[:, None] * v["O"]
            away = np.linalg.norm(aside, axis=1)
            with np.errstate(divide="ignore", invalid="ignore"):
                if "E" in v:
                    chi = self._chi(self._angle(along, away))
                    along = np.where(chi > 0, away / chi, along)
                else:
                    chi = np.where(along > 0, away / along, np.nan)
            seen = along[:, None] * v["O"] + aside * (1 + v["R"] @ [chi**0, chi**2, chi**4])[:, None]
        depth = np.where((axial := seen @ v["A"]) > 0, axial, np.nan)
        return np.stack([seen @ v["H"] / depth, seen @ v["V"] / depth], axis=1)

    def _angle(self, along: FloatArray, away: FloatArray) -> FloatArray:
        """Theta of rays by Newton's method, from where they lie along O and away from it. (n) [rad]"""
        e0, e1, e2 = self.vectors["E"]
        theta = np.arctan2(away, along)
        for _ in range(20):
            t2 = theta**2
            moved, change = e0 + e1 * t2 + e2 * t2**2, 2 * e1 * theta + 4 * e2 * theta**3
            sine, cosine = np.sin(theta), np.cos(theta)
            value = sine * along - cosine * away - (theta - sine) * moved
            slope = cosine * along + sine * away - (1 - cosine) * moved - (theta - sine) * change
            theta = theta - value / slope
            if not (np.abs(value) > 1e-15 * np.abs(slope)).any():
                break
        return theta

    def _chi(self, theta: FloatArray) -> FloatArray:
        """What stands for the tangent of the angle; NaN past a right angle of P theta. (n) [-]"""
        bent = self.linearity * theta
        if abs(self.linearity) < 1e-15:
            return theta
        chi = (np.tan(bent) if self.linearity > 0 else np.sin(bent)) / self.linearity
        return np.where(np.abs(bent) < 0.5 * np.pi, chi, np.nan)

    def axes(self) -> tuple[FloatArray, FloatArray]:
        """Its frame, x along the rows, z along A (3, 3), and fx, fy, cx, cy without distortion (4,) [px].

        Raises ValueError where A, H and V span no picture.
        """
        v = self.vectors
        axis = v["A"] / np.linalg.norm(v["A"])
        across, down = np.cross(np.cross(axis, v["H"]), axis), np.cross(np.cross(axis, v["V"]), axis)
        focal = float(np.linalg.norm(across)), float(np.linalg.norm(down))
        if not 0 < min(focal) <= max(focal) < MOST_PX**2:
            raise ValueError(f"A, H and V span no picture ({focal[0]:g}, {focal[1]:g} px); check the label")
        turn = orthonormal(np.stack([across / focal[0], np.cross(axis, across / focal[0]), axis], axis=1))
        return turn, np.array([*focal, axis @ v["H"], axis @ v["V"]])

    def in_its_frame(self) -> "CahvModel":
        """The same camera in the frame of `axes`, at its origin."""
        turn, _ = self.axes()
        turned = {letter: self.vectors[letter] @ turn for letter in "AHVO" if letter in self.vectors}
        return replace(self, vectors={**self.vectors, **turned, "C": np.zeros(3)})

    def bent(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels over the focal length, from the principal point, of directions over their z, as `Camera.lens`. [-]

        The directions are those of points at the first of `RANGES` from the origin of its frame.
        """
        _, (fx, fy, cx, cy) = self.axes()
        ways = np.stack([x, y, np.ones_like(x)], axis=-1)
        points = RANGES[0] * ways / np.linalg.norm(ways, axis=-1, keepdims=True)
        pixels = self.project(points.reshape(-1, 3)).reshape(*np.shape(x), 2)
        return (pixels[..., 0] - cx) / fx, (pixels[..., 1] - cy) / fy

    @classmethod
    def of_table(cls, table: Mapping[str, Any], size: tuple[int, int]) -> "CahvModel":
        """The model of a table that `to_dict` made. Raises KeyError and ValueError."""
        vectors = {
            letter: np.array(table[letter], dtype=float) for letter in "CAHVORE" if letter in table or letter in "CAHV"
        }
        if any(part.shape != (3,) or not np.isfinite(part).all() for part in vectors.values()) or len(vectors) == 5:
            raise ValueError("a lens has C, A, H and V, O with R, and E, of 3 numbers each, and linearity")
        return cls(vectors=vectors, width_px=size[0], height_px=size[1], linearity=float(table.get("linearity", 1.0)))

    def to_dict(self) -> dict[str, Any]:
        """Its numbers as `of_table` reads them."""
        return {**self.vectors, "linearity": self.linearity}

    @property
    def title(self) -> str:
        """CAHV, CAHVOR or CAHVORE, with P."""
        kind = "".join(letter for letter in "CAHVORE" if letter in self.vectors)
        return f"{kind} with P = {self.linearity:g}" if "E" in kind else kind


class StatedModel(NamedTuple):
    """What a label says of its picture's camera.

    Attributes
    ----------
    model : of the picture as it is in the file.
    frame : name of the frame that the model is in, '' where there is none.
    turn : from that frame to one whose z is up (3, 3); None where nothing tells.
    remarks : how it was read, one sentence each.
    """

    model: CahvModel
    frame: str
    turn: FloatArray | None
    remarks: tuple[str, ...]


def orthonormal(matrix: FloatArray) -> FloatArray:
    """The orthogonal matrix nearest to one. (3, 3)"""
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ right)


def count_of(name: str, cell: str | float | None, what: str) -> int:
    """A number of pixels. Raises DataError for text, parts of one, and what no picture has."""
    count = finite(name, what, str(cell))
    if not (1 <= count <= MOST_PX and count.is_integer()):
        raise DataError(f"{name}: its {what} are {cell}; a picture has 1 to {MOST_PX}")
    return int(count)


def finite(name: str, tag: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise DataError(f"{name}: {tag} is '{cell}', no number; fetch it again")
    return value


# --- labels ---


def is_xml(file: InputFile) -> bool:
    return file.data.lstrip()[:5] == b"<?xml" or file.data.lstrip(b"\xef\xbb\xbf \r\n\t").startswith(b"<Product_")


def label_parts(file: InputFile) -> list[str]:
    """Labels of PDS3 and VICAR that a file begins with, without the picture behind them; none of any other file."""
    start, parts = file.data[:LABEL_BYTES], []
    if _ODL.match(start):
        end = re.search(rb"^[ \t]*+END[ \t\r]*+$", start, re.MULTILINE)
        parts.append(start[: end.start() if end else None])
    vicar = _VICAR.search(start)
    if vicar and (parts or vicar.start() == 0):
        parts.append(start[vicar.start() : vicar.start() + int(vicar[1])])
    return [part.decode("latin-1") for part in parts]


def is_product(file: InputFile) -> bool:
    """Whether a file is of a picture with a label of PDS3 or VICAR, or by its name numbers with a label beside them."""
    return bool(_NUMBERS.fullmatch(Path(file.name).suffix) or label_parts(file))


def label_of(file: InputFile) -> InputFile | None:
    """The file with the label of a picture: itself, or one beside it of the same name; None where there is none."""
    if is_xml(file) or label_parts(file):
        return file
    if not is_product(file):
        return None
    path = Path(file.name)
    beside = (path.with_suffix(end) for end in (".LBL", ".lbl", ".xml", ".XML", f"{path.suffix}L"))
    there = next((each for each in beside if each.is_file()), None)
    return None if there is None else read_input(there)


def model_in(label: InputFile) -> StatedModel | None:
    """The model of the CAHV family that a label or a text of `C = …` has; None where it has none.

    Raises DataError for one that is not whole.
    """
    if is_xml(label):
        values: Values = _of_xml(xml_root(label.name, label.data))
    else:
        values = {}
        for part in label_parts(label) or [text(label)]:
            values = {**label_values(part), **values}
        if spelled := re.search(rf"CAHVORE([123])(?:[\s,]+({NUMBER}))?", values.get(("", "MODEL"), "")):
            values = {("", "T"): spelled[1], ("", "P"): spelled[2] or "", **values}
    group = next((group for group, key in values if key == "MODEL_COMPONENT_1"), "")
    vectors = _components(values, group)
    if not {*"CAHV"} <= vectors.keys():
        return None
    frame = values.get((group, "REFERENCE_COORD_SYSTEM_NAME"), values.get(("", "COORDINATE_SYSTEM_NAME"), ""))
    turn, remarks = _upright(values, frame.upper())
    return StatedModel(_model_of(label.name, values, group, vectors), frame, turn, (*remarks, *_of_subframe(values)))


def label_values(content: str) -> dict[tuple[str, str], str]:
    """Values of a label of PDS3 or VICAR, or of a text of `KEY = value`, by group and key in capitals."""
    values: dict[tuple[str, str], str] = {}
    groups = [""]
    for end, name, value in _ENTRY.findall(re.sub(r"/\*[^\n]{0,200}?\*/", " ", content)):
        key, cell = name.upper(), value.strip().strip("\"'")
        if end or key in ("END_GROUP", "END_OBJECT"):
            groups = groups[:-1] or [""]
        elif key in ("GROUP", "OBJECT"):
            groups.append(cell)
        elif key in ("PROPERTY", "TASK"):
            groups = ["", cell]
        else:
            values.setdefault((groups[-1], key), cell)
    return values


def _of_xml(root: Element) -> dict[tuple[str, str], str]:
    """Values of a label of PDS4 (`geom`, Geometry Dictionary 1.9) under the names that they have in PDS3."""
    values: dict[tuple[str, str], str] = {}
    for kind in ("cahvore_model", "cahvor_model", "cahv_model"):
        for part in (part for model in root.iter(kind) for part in model):
            word = part.tag.removeprefix("vector_").removesuffix("_terms")
            if word in _LETTERS:
                values.setdefault(("", _LETTERS[word]), " ".join(cell.text or "" for cell in part))
            elif part.tag in ("cahvore_model_type", "cahvore_model_parameter"):
                values.setdefault(("", "T" if part.tag.endswith("type") else "P"), part.text or "")
    frame = next((node.text for each in root.iter("camera_model_parameters")
                  for node in each.iter("coordinate_space_frame_type") if node.text), "")  # fmt: skip
    values["", "COORDINATE_SYSTEM_NAME"] = str(frame).strip()
    for space in root.iter("coordinate_space_definition"):
        name = next((str(n.text).strip() for n in space.iter("coordinate_space_frame_type")), "")
        turn = next(space.iter("quaternion_plus_direction"), None)
        if turn is not None:
            values.setdefault((name, "COORDINATE_SYSTEM_NAME"), name)
            cells = (turn.findtext(tag, "") for tag in ("qcos", "qsin1", "qsin2", "qsin3"))
            values.setdefault((name, "ORIGIN_ROTATION_QUATERNION"), " ".join(cells))
    for axis in root.iter("axis_array"):
        key = {"line": "LINES", "sample": "LINE_SAMPLES"}.get(str(axis.findtext("axis_name")).strip().lower(), "")
        values.setdefault(("IMAGE", key), str(axis.findtext("elements")))
    for tag, key in (("first_line", "FIRST_LINE"), ("first_sample", "FIRST_LINE_SAMPLE")):
        for node in (node for part in root.iter("subframe") for node in part.iter(tag)):
            values.setdefault(("IMAGE", key), str(node.text))
    return values


def _numbers(cell: str) -> FloatArray:
    """Numbers of a value, without units in <>. (n)"""
    cells = re.findall(rf"(?<![\w.]){NUMBER}(?![\w.])", re.sub(r"<[^<>]*>", " ", cell))
    return np.array([float(one.upper().replace("D", "E")) for one in cells])


def _first(values: Values, *places: tuple[str, str]) -> FloatArray:
    """Numbers of the first of some places that has any. (n)"""
    return next((numbers for place in places if (numbers := _numbers(values.get(place, ""))).size), np.empty(0))


def _components(values: Values, group: str) -> dict[str, FloatArray]:
    """Vectors by letter: MODEL_COMPONENT_1 … of PDS3 and VICAR in the order of MODEL_COMPONENT_ID, or C = x y z."""
    letters = re.findall(r"\w+", values.get((group, "MODEL_COMPONENT_ID"), "")) or [*"CAHVORE"]
    places = {letter: ((group, f"MODEL_COMPONENT_{k}"), (group, letter)) for k, letter in enumerate(letters, start=1)}
    vectors = {letter: _first(values, *both) for letter, both in places.items() if letter in "CAHVORE"}
    return {letter: part for letter, part in vectors.items() if part.size == 3}


def _model_of(name: str, values: Values, group: str, vectors: dict[str, FloatArray]) -> CahvModel:
    """Raises DataError for a model that lacks something."""
    image = next((group for group, key in values if key == "LINES" and group.endswith("IMAGE")), "IMAGE")
    pair = _first(values, ("", "DIMENSIONS"))
    width, height = (
        _first(values, (image, long), ("", short), ("", long), ("", other))
        for long, short, other in (("LINE_SAMPLES", "NS", "XDIM"), ("LINES", "NL", "YDIM"))
    )
    size = np.concatenate([width[:1], height[:1]]) if pair.size != 2 else pair
    halves = {"O", "R"} & vectors.keys()
    reasons = {
        f"a CAHVOR model needs O and R, not {''.join(halves)} alone": len(halves) == 1,
        "a CAHVORE model needs O and R": "E" in vectors and not halves,
        "the size of the picture is missing; add LINES = … and LINE_SAMPLES = …": size.size != 2,
    }
    refuse(reasons, name, DataError)
    if halves:
        vectors = {**vectors, "O": vectors["O"] / np.linalg.norm(vectors["O"])}
    return CahvModel(
        vectors=vectors,
        width_px=count_of(name, size[0], "samples"),
        height_px=count_of(name, size[1], "lines"),
        linearity=_linearity(name, values, group) if "E" in vectors else 1.0,
    )


def _linearity(name: str, values: Values, group: str) -> float:
    """P of CAHVORE from its type and its parameter. Raises DataError where these are missing or unknown."""
    kind = _first(values, (group, "MODEL_COMPONENT_8"), (group, "MTYPE"), (group, "T"))
    parameter = _first(values, (group, "MODEL_COMPONENT_9"), (group, "MPARM"), (group, "P"))
    number = float(kind[0]) if kind.size else 3.0
    linearity = LINEARITY.get(number, float(parameter[0]) if number == 3 and parameter.size else math.nan)
    if not -1 <= linearity <= 1:
        raise DataError(
            f"{name}: a CAHVORE model needs its type T (MODEL_COMPONENT_8: 1 perspective, 2 fish-eye, 3 general) and, "
            "where this is 3, P of -1 to 1 (MODEL_COMPONENT_9); "
            f"T is {', '.join(map(str, kind)) or 'missing'}, P {', '.join(map(str, parameter)) or 'missing'}"
        )
    return linearity


def _upright(values: Values, frame: str) -> tuple[FloatArray | None, tuple[str, ...]]:
    """From a label's frame to one whose z is up (3, 3), and what was done; None where the frame is not known."""
    if not frame.startswith(DOWNWARDS):
        return None, (f"frame {frame}: which way is up is not known",) if frame else ()
    up = np.diag([1.0, -1.0, -1.0])
    remark = f"z of the label's frame {frame} points down: x, -y, -z of it are told"
    if frame.startswith(LEVEL):
        return up, (remark,)
    groups = (g for (g, key), cell in values.items() if key == "COORDINATE_SYSTEM_NAME" and g and cell.upper() == frame)
    quaternion = _first(values, *((g, "ORIGIN_ROTATION_QUATERNION") for g in groups))
    if quaternion.size != 4 or not math.isclose(float(np.linalg.norm(quaternion)), 1, abs_tol=1e-3):
        return up, ("the label has no tilt of the rover: its frame is as tilted as the rover was", remark)
    level = Rotation.from_quat(quaternion[[1, 2, 3, 0]]).as_matrix()
    return up @ level, (f"turned from {frame} to x north, y west, z up by the rover's quaternion in the label",)


def _of_subframe(values: Values) -> tuple[str, ...]:
    """A remark on a picture that is a part of the detector's, or has fewer pixels."""
    cells = [(key, cell) for (group, key), cell in values.items() if not re.search("REQUEST|REF|THUMB", group)]
    line, sample = (next((c for k, c in cells if k == key), "1") for key in ("FIRST_LINE", "FIRST_LINE_SAMPLE"))
    binned = {cell for key, cell in cells if key.startswith("PIXEL_AVERAGING")} - {"1", "1.0"}
    if {line, sample} == {"1"} and not binned:
        return ()
    return (
        f"the picture begins at line {line}, sample {sample} of the detector{' and is binned' if binned else ''}: the "
        "model is that of the picture, as JPL writes it",
    )
