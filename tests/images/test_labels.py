"""Labels beside closed forms, and models of other people."""

import importlib.util
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from lunarsci.errors import DataError
from lunarsci.guide.info import info
from lunarsci.images.cahv import CahvModel, label_values
from lunarsci.images.camera import Camera, Pose, StereoRig, covariance_of, rotation_of, vector_of
from lunarsci.images.jobs.cameras import cameras
from lunarsci.images.jobs.dem import dem
from lunarsci.images.labels import LabelCamera, fit_cahv, read_label
from lunarsci.images.pictures import read_picture
from lunarsci.images.render import landscape_on, render
from lunarsci.images.rig_files import read_pose, read_rig, rig_text
from lunarsci.io.inputs import InputFile, read_input


def tag(name: str, content: object) -> str:
    return f"<{name}>{content}</{name}>"


def vector_tag(name: str, vector: np.ndarray) -> str:
    return tag(name, "".join(tag(axis, f"{value:.6f}") for axis, value in zip("xyz", vector, strict=True)))


def pds4(lens: Camera, pose: Pose, sign: float = 1.0) -> bytes:
    """A label with the elements of PCAM's, as its readers list them; corners are the middles of the last pixels."""
    right, low, pitch = lens.width_px - 1, lens.height_px - 1, 14.8e-3
    places: dict[str, tuple[float, float]] = {
        "up_left": (0, 0),
        "down_left": (0, low),
        "up_right": (right, 0),
        "down_right": (right, low),
    }
    ways = {
        name: pose.rotation @ lens.rays(place) for name, place in (places | {"center": (right / 2, low / 2)}).items()
    }
    told = "".join(vector_tag(f"{n}_point_observe_vector", w / np.linalg.norm(w)) for n, w in ways.items())
    offset = (lens.cx_px - right / 2) * pitch, sign * (lens.cy_px - low / 2) * pitch
    sizes = (("Line", lens.height_px), ("Sample", lens.width_px))
    axes = "".join(tag("Axis_Array", tag("axis_name", n) + tag("elements", e)) for n, e in sizes)
    center = "".join(tag(f"camera_center_position_{a}", v) for a, v in zip("xyz", pose.center_m, strict=True))
    middle = tag("principle_point_coordinate", tag("x", offset[0]) + tag("y0", offset[1]))
    instrument = tag(
        "Instrument_Parm", tag("pixel_size", pitch * 1e3) + tag("focal_length", lens.fx_px * pitch) + middle
    )
    pointing = tag("Vector_Cartesian_3_Pointing", told) + tag("Exterior_Orientation_Elements", center)
    start = '<?xml version="1.0"?><Product_Observational xmlns="http://pds.nasa.gov/pds4/pds/v1">'
    return f"{start}{axes}{tag('Mission_Area', instrument + pointing)}</Product_Observational>".encode()


def pancam(k1: float = -0.05) -> Camera:
    return Camera(name="p", width_px=1176, height_px=864, fx_px=3380.0, fy_px=3380.0, cx_px=590.0, cy_px=428.0, k1=k1)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_distortion_and_pointing_come_from_a_labels_corners(sign: float) -> None:
    pose = Pose.looking([1.0, 2.0, 1.5], 70, 25, 2)
    found = read_label(InputFile("a.2BL", pds4(pancam(), pose, sign)))
    assert found.camera.k1 == pytest.approx(-0.05, abs=2e-3)
    assert (found.camera.cx_px, found.camera.cy_px) == pytest.approx((590.0, 428.0), abs=1e-6)
    assert vector_of(found.pose.rotation.T @ pose.rotation) == pytest.approx(np.zeros(3), abs=1e-5)
    assert found.residual_max_px < 0.05 < 1 < found.pinhole_max_px


def test_two_labels_make_a_rig_and_swapped_ones_are_refused() -> None:
    pose = Pose.looking([1.0, 2.0, 1.5], 70, 25, 2)
    other = Pose(rotation=pose.rotation @ rotation_of([0.001, 0.004, 0]), center_m=pose.to_world([0.27, 0, 0]))
    files = [InputFile(f"{n}.2BL", pds4(pancam(), p)) for n, p in (("left", pose), ("right", other))]
    pair = read_rig(*files)
    assert pair.baseline_m == pytest.approx(0.27, abs=1e-6)
    assert vector_of(pair.rotation) == pytest.approx([-0.001, -0.004, 0], abs=1e-5)
    assert any("calibration" in line for line in pair.assumed)
    with pytest.raises(DataError, match="swapped"):
        read_rig(*files[::-1])
    with pytest.raises(DataError, match="one place"):
        read_rig(files[0], files[0])


@pytest.mark.parametrize("way", [(0.2, 0.05, 0.15), (0.1, 0.03, 0.25), (-0.1, 0.05, 0.25)])
def test_a_baseline_far_from_the_rows_is_laid_along_them(way: tuple[float, float, float]) -> None:
    """Its centres are in another frame than the directions; it is neither taken as it is nor called swapped."""
    pose = Pose.looking([1.0, 2.0, 1.5], 70, 25, 2)
    other = Pose(rotation=pose.rotation, center_m=pose.to_world(list(way)))
    pair = read_rig(*(InputFile(f"{n}.2BL", pds4(pancam(), p)) for n, p in (("left", pose), ("right", other))))
    assert pair.translation_m == pytest.approx([-np.linalg.norm(way), 0, 0], abs=1e-9)
    assert any("laid along the rows" in line for line in pair.assumed)


def test_labels_without_a_camera_are_refused() -> None:
    whole = pds4(pancam(), Pose.looking([1, 2, 1.5]))
    for gone, said in (
        (b"focal_length", "no focal_length"),
        (b"axis_array", "no lines"),
        (b"observe_vector", "directions"),
    ):
        with pytest.raises(DataError, match=said):
            read_label(
                InputFile(
                    "a.2BL",
                    whole.replace(gone, b"other").replace(
                        b"Axis_Array", b"other" if gone == b"axis_array" else b"Axis_Array"
                    ),
                )
            )
    with pytest.raises(DataError, match="broken XML"):
        read_label(InputFile("a.2BL", whole[:-30]))
    with pytest.raises(DataError, match="no camera model"):
        read_label(InputFile("a.lbl", b"LINES = 4"))


def cahv(**more: np.ndarray) -> CahvModel:
    turn = Pose.looking([0, 0, 0], 30, 20, 5).rotation
    axis = turn[:, 2]
    vectors = {
        "C": np.array([1.0, 0.2, -1.0]),
        "A": axis,
        "H": 1200 * turn[:, 0] + 511 * axis,
        "V": 1200 * turn[:, 1] + 512 * axis,
    }
    return CahvModel(vectors=vectors | more, width_px=1024, height_px=1024)


def test_cahv_models_become_cameras() -> None:
    """CAHV is a pinhole (closed form). CAHVOR with O = A has k1 = R1, k2 = R2 over (1 + R0) (Di & Li 2004)."""
    plain = cahv(O=cahv().vectors["A"], R=np.zeros(3))
    found = fit_cahv(plain, "x")
    assert (found.camera.fx_px, found.camera.fy_px, found.camera.cx_px, found.camera.cy_px) == pytest.approx(
        (1200, 1200, 511, 512), abs=1e-6
    )
    assert found.residual_max_px < 1e-6
    assert found.pose.center_m == pytest.approx([1.0, 0.2, -1.0], abs=1e-6)
    bent = fit_cahv(cahv(O=plain.vectors["A"], R=np.array([0.001, -0.1, 0.03])), "x")
    assert bent.camera.fx_px == pytest.approx(1200 * 1.001, rel=1e-6)
    assert (bent.camera.k1, bent.camera.k2) == pytest.approx((-0.1 / 1.001, 0.03 / 1.001), rel=1e-3)
    assert bent.residual_max_px < 1e-3 < 5 < bent.pinhole_max_px


class Ahead(CahvModel):
    """Sees from 5 cm ahead of its centre, as a moving pupil may."""

    def project(self, points: np.ndarray) -> np.ndarray:
        return CahvModel.project(self, points - 0.05 * self.vectors["A"])


def test_a_camera_stands_where_its_pupil_is() -> None:
    model = cahv()
    fitted = fit_cahv(Ahead(vectors=model.vectors, width_px=1024, height_px=1024), "x")
    assert fitted.pose.center_m == pytest.approx(model.vectors["C"] + 0.05 * model.vectors["A"], abs=1e-6)
    assert fitted.residual_max_px < 1e-6


def test_cahvore_without_entrance_and_linear_is_cahvor() -> None:
    axis = cahv().vectors["A"]
    bend = {"O": axis, "R": np.array([1e-4, -0.05, 0.01])}
    there = np.random.default_rng(3).uniform(-0.3, 0.3, (20, 3)) + cahv().vectors["C"] + 4 * axis
    with_entrance = cahv(**bend, E=np.zeros(3))
    np.testing.assert_allclose(with_entrance.project(there), cahv(**bend).project(there), atol=1e-8)


PDS3 = """PDS_VERSION_ID = PDS3
GROUP = GEOMETRIC_CAMERA_MODEL_PARMS
 MODEL_TYPE = CAHVOR
 MODEL_COMPONENT_ID = ("C","A","H","V","O","R")
 MODEL_COMPONENT_1 = ({C})
 MODEL_COMPONENT_2 = ({A})
 MODEL_COMPONENT_3 = ({H})
 MODEL_COMPONENT_4 = ({V})
 MODEL_COMPONENT_5 = ({A})
 MODEL_COMPONENT_6 = (1.0e-4,-0.1,0.03)
END_GROUP = GEOMETRIC_CAMERA_MODEL_PARMS
OBJECT = IMAGE
 LINES = 1024
 LINE_SAMPLES = 1024
END_OBJECT = IMAGE
END
"""


def test_pds3_labels_and_vicar_texts_are_read() -> None:
    rows = {key: ",".join(f"{x:.12f}" for x in v) for key, v in cahv().vectors.items()}
    label = read_label(InputFile("a.lbl", PDS3.format(**rows).encode()))
    assert label.camera.k1 == pytest.approx(-0.1, rel=2e-3)
    lines = [f"{key} = {row.replace(',', ' ')}" for key, row in rows.items()]
    text = "\n".join(["NS = 1024", "NL = 1024", *lines])
    assert read_label(InputFile("a.cahv", text.encode())).camera.k1 == pytest.approx(0, abs=1e-9)


def cahvor(place: np.ndarray, *, down: float, frame: str, unit: str = "") -> str:
    """A camera that looks along x, down by an angle in degrees, in a frame whose z points down; its O is its A."""
    axis = np.array([np.cos(np.radians(down)), 0.0, np.sin(np.radians(down))])
    low = np.array([-axis[2], 0.0, axis[0]])
    across, line = 1200.0 * np.array([0.0, 1.0, 0.0]) + 500.0 * axis, 1200.0 * low + 520.0 * axis
    parts = [place, axis, across, line, axis, np.array([0.0, 0.02, 0.0])]
    lines = ["PDS_VERSION_ID = PDS3", "  LINES = 1024", "  LINE_SAMPLES = 1024", "  MODEL_TYPE = CAHVOR"]
    lines += ['  MODEL_COMPONENT_ID = ("C", "A", "H",', '     "V", "O", "R")']
    for k, part in enumerate(parts, start=1):
        lines += [f"  MODEL_COMPONENT_{k} = ( {part[0]:.9f}{unit},", f"   {part[1]:.9f}{unit}, {part[2]:.9f}{unit} )"]
    return "\n".join([*lines, f'  REFERENCE_COORD_SYSTEM_NAME = "{frame}"', "END", ""])


def model(**parts: str) -> dict[str, np.ndarray]:
    """Vectors and numbers by letter."""
    return {letter: np.array([float(cell) for cell in text.split()]) for letter, text in parts.items()}


MER_HAZCAM = model(
    C="0.609331 -0.041064 -0.233849", A="0.703447 -0.005161 0.710729", H="351.362 452.204 353.494",
    V="35.8065 -1.75143 682.705", O="0.704402 -0.006062 0.709775", R="3e-06 -0.012015 -0.007525",
    E="0.001442 0.001522 0.000483", T="3", P="0.37",
)  # fmt: skip
"""Label of 1F483288473EFFCMUFP1214L0M1.IMG (NASA-AMMOS/VICAR, vos/p2/prog/shadow/test/data)."""


def longer(v: Mapping[str, np.ndarray], times: float) -> dict[str, np.ndarray]:
    """The same camera with a focal length so many times as long."""
    axis = v["A"] / np.linalg.norm(v["A"])
    return {**v, **{n: times * v[n] + (1 - times) * (axis @ v[n]) * axis for n in "HV"}}


MODELS = {
    "MSL Mastcam, CAHV": (model(
        C="6.831825e-01 5.243722e-01 -1.955875e+00", A="-3.655151e-01 5.396012e-01 7.584387e-01",
        H="-1.156881e+04 -7.518712e+03 6.618359e+02", V="5.843885e+03 -8.213856e+03 9.438374e+03"), (1323, 1180)),
    "MER Navcam, CAHVOR": (model(
        C="0.454993 0.141198 -1.23312", A="-0.69585 0.571462 0.435", H="-1075.03 -654.572 220.543",
        V="50.6594 -19.3653 1294.76", O="-0.61985 0.672629 0.404174", R="0.019876 -0.014281 0.020876"), (1024, 1024)),
    "MER Hazcam, CAHVORE of type 3": (MER_HAZCAM, (1024, 1024)),
    "Mars 2020 Navcam, CAHVORE of type 2": (model(
        C="0.955584 0.764515 -1.95254", A="-0.35631 0.916392 0.182443", H="-3229.43 141.993 229.563",
        V="-168.067 400.716 3088.89", O="-0.357624 0.915861 0.182539", R="1.736e-06 0.0501396 -0.0171254",
        E="-8.0e-09 1.0e-08 -2.9e-08", T="2", P="0.0"), (1296, 976)),
    "SYNTHETIC, CAHVORE of type 1": ({**longer(MER_HAZCAM, 2.5), **model(T="1", P="0.37")}, (1024, 1024)),
}  # fmt: skip
"""Vectors and size of 1664MR0086340000802438C00_DRCL (DOI-USGS/ale, tests/pytests/data), 2N292280938EFFB100P0703L0M1
(PDS, mer2no_0xxx), `MER_HAZCAM`, and NLF_0629_0722782785_631ECM (pds-data-dictionaries/ldd-img, user guide)."""


def seen_by(v: Mapping[str, np.ndarray], point: np.ndarray) -> np.ndarray:
    """The pixel of a point, by Gennery's equations with JPL's sign, theta by bisection."""
    p = point - v["C"]
    if "O" in v:
        axis = v["O"] / np.linalg.norm(v["O"])
        zeta, aside = p @ axis, p - (p @ axis) * axis
        lam = float(np.linalg.norm(aside))
        chi = lam / zeta
        if "E" in v:
            e0, e1, e2 = v["E"]

            def pupil(t: float) -> float:
                return zeta * np.sin(t) - lam * np.cos(t) - (t - np.sin(t)) * (e0 + e1 * t**2 + e2 * t**4)

            theta = brentq(pupil, 0.0, 2.5, xtol=1e-14)
            kind, own = int(v["T"][0]), v["P"][0]
            chi = np.tan(theta) if kind == 1 else theta if kind == 2 else np.tan(own * theta) / own
            zeta = lam / chi
        p = zeta * axis + (1 + v["R"][0] + v["R"][1] * chi**2 + v["R"][2] * chi**4) * aside
    return np.array([p @ v["H"], p @ v["V"]]) / (p @ v["A"])


TILT = Rotation.from_euler("ZYX", [40, 5, -8], degrees=True)


def frame_words(key: Callable[[str, str], str]) -> list[str]:
    numbers = ",".join(f"{x:.12f}" for x in TILT.as_quat()[[3, 0, 1, 2]])
    return [key("COORDINATE_SYSTEM_NAME", "ROVER_FRAME"), key("ORIGIN_ROTATION_QUATERNION", f"({numbers})")]


def of_pds3(v: Mapping[str, np.ndarray], size: tuple[int, int]) -> bytes:
    """As MER and MSL write it: SUBFRAME with LINES of its own, T and P beside MODEL_COMPONENT_ID with nine letters."""
    letters = [letter for letter in "CAHVORE" if letter in v]
    parts = [
        f"  MODEL_COMPONENT_{k} = ({','.join(map(repr, map(float, v[n])))})".replace(",", ",\r\n    ", 1)
        for k, n in enumerate(letters, 1)
    ]
    parts += [f"  MODEL_COMPONENT_{k} = {v[n][0]}" for k, n in ((8, "T"), (9, "P")) if n in v]
    ids = ",".join([*letters, *(n for n in "TP" if n in v)])
    rows = [
        "PDS_VERSION_ID = PDS3", "/* THE ROVER'S STATE */", "NOTE = \"C = 1 2 3, LINES =", "  5\"",
        "GROUP = GEOMETRIC_CAMERA_MODEL", "  MODEL_TYPE = CAHVORE", f"  MODEL_COMPONENT_ID = ({ids})", *parts,
        "  REFERENCE_COORD_SYSTEM_NAME = ROVER_FRAME", "END_GROUP = GEOMETRIC_CAMERA_MODEL",
        "GROUP = ROVER_COORDINATE_SYSTEM", *frame_words(lambda key, cell: f"  {key} = {cell}"),
        "END_GROUP = ROVER_COORDINATE_SYSTEM", "GROUP = SUBFRAME_REQUEST_PARMS", "  LINES = 64", "  LINE_SAMPLES = 64",
        "  FIRST_LINE = 9", "END_GROUP = SUBFRAME_REQUEST_PARMS", "OBJECT = IMAGE", f"  LINES = {size[1]}",
        f"  LINE_SAMPLES = {size[0]}", "  FIRST_LINE = 1", "END_OBJECT = IMAGE", "END", "",
    ]  # fmt: skip
    return "\r\n".join(rows).encode()


def of_vicar(v: Mapping[str, np.ndarray], size: tuple[int, int], mask: str = "2#0000111111111111#") -> bytes:
    """As VICAR writes it: in one line, padded to whole records with NULs."""
    letters = [letter for letter in "CAHVORE" if letter in v]
    parts = [f"MODEL_COMPONENT_{k}=({','.join(map(repr, map(float, v[n])))})" for k, n in enumerate(letters, 1)]
    parts += [f"MODEL_COMPONENT_{k}={v[n][0]}" for k, n in ((8, "T"), (9, "P")) if n in v]
    rows = [
        f"FORMAT='HALF'  TYPE='IMAGE'  BUFSIZ={2 * size[0]}  DIM=3  EOL=0  RECSIZE={2 * size[0]}  ORG='BSQ'",
        f"NL={size[1]}  NS={size[0]}  NB=1  N1={size[0]}  N2={size[1]}  N3=1  N4=0  NBB=0  NLB=0  HOST='X86-LINUX'",
        "INTFMT='HIGH'  REALFMT='RIEEE'  PROPERTY='SUBFRAME_REQUEST_PARMS'  LINES=64  LINE_SAMPLES=64",
        f"PROPERTY='IMAGE_DATA'  SAMPLE_BIT_MASK='{mask}'  PROPERTY='ROVER_COORDINATE_SYSTEM'",
        *frame_words(lambda key, cell: f"{key}={cell}" if cell[0] == "(" else f"{key}='{cell}'"),
        "PROPERTY='GEOMETRIC_CAMERA_MODEL'  MODEL_TYPE='CAHVORE'",
        f"MODEL_COMPONENT_ID=({','.join(map(repr, letters))})", *parts, "REFERENCE_COORD_SYSTEM_NAME='ROVER_FRAME'",
        "TASK='SYNTHETIC'  USER='me'  LINES=3",
    ]  # fmt: skip
    whole = "  ".join(rows)
    length = -(-(len(whole) + 24) // (2 * size[0])) * 2 * size[0]
    return f"LBLSIZE={length:<12d}{whole}".encode().ljust(length, b"\0")


def of_pds4(v: Mapping[str, np.ndarray], size: tuple[int, int], file: str = "none.IMG") -> bytes:
    """As Mars 2020 writes it."""
    names = {"C": "Vector_Center", "A": "Vector_Axis", "H": "Vector_Horizontal", "V": "Vector_Vertical",
             "O": "Vector_Optical", "R": "Radial_Terms", "E": "Entrance_Terms"}  # fmt: skip
    kind = "CAHVORE" if "E" in v else "CAHVOR" if "O" in v else "CAHV"
    cells = [tag(f"geom:{names[n]}", "".join(tag(f"geom:c{k}", repr(float(x))) for k, x in enumerate(v[n])))
             for n in "CAHVORE" if n in v]  # fmt: skip
    cells += [tag("geom:cahvore_model_type", int(v["T"][0])) + tag("geom:cahvore_model_parameter", v["P"][0])
              for _ in "T" if "T" in v]  # fmt: skip
    frame = tag("geom:Coordinate_Space_Indexed", tag("geom:coordinate_space_frame_type", "ROVER_FRAME"))
    turn = "".join(tag(f"geom:{n}", x) for n, x in
                   zip(("qcos", "qsin1", "qsin2", "qsin3"), TILT.as_quat()[[3, 0, 1, 2]], strict=True))  # fmt: skip
    space = tag("geom:Coordinate_Space_Present", frame) + tag("geom:Quaternion_Plus_Direction", turn)
    camera = tag("geom:Camera_Model_Parameters", tag(f"geom:{kind}_Model", "".join(cells)) + frame)
    mask = tag("img:sample_bit_mask", "2#0000111111111111#")
    area = mask + tag("geom:Geometry", camera + tag("geom:Coordinate_Space_Definition", space))
    axes = "".join(tag("Axis_Array", tag("axis_name", n) + tag("elements", e) + tag("sequence_number", k)) for k, (n, e)
                   in enumerate((("Band", 1), ("Line", size[1]), ("Sample", size[0])), 1))  # fmt: skip
    order = tag("axes", 3) + tag("axis_index_order", "Last Index Fastest")
    array = '<offset unit="byte">0</offset>' + order + tag("Element_Array", tag("data_type", "UnsignedMSB2")) + axes
    there = tag("File_Area_Observational", tag("File", tag("file_name", file)) + tag("Array_3D_Image", array))
    start = '<?xml version="1.0"?><Product_Observational xmlns="http://pds.nasa.gov/pds4/pds/v1" '
    start += 'xmlns:geom="g" xmlns:img="i">'
    return f"{start}{tag('Observation_Area', area)}{there}</Product_Observational>".encode()


def of_text(v: Mapping[str, np.ndarray], size: tuple[int, int]) -> bytes:
    """As JPL's `cmod_cahvore_write` does."""
    rows = [
        f"Dimensions = {size[0]} {size[1]}",
        *(f"{n} = {' '.join(map(repr, map(float, v[n])))}" for n in v if n not in "TP"),
    ]
    spelled = {1: "CAHVORE1 = perspective, distortion, pupil", 2: "CAHVORE2 = fish-eye"}
    kinds = [spelled.get(int(v["T"][0]), f"CAHVORE3,{v['P'][0]:g} = general")] if "T" in v else ["CAHVOR = perspective"]
    return "\n".join(["# a comment", *(f"Model = {kind}" for kind in kinds), *rows, "Hs    =  600.0", ""]).encode()


FORMS = {"a.lbl": of_pds3, "a.VIC": of_vicar, "a.xml": of_pds4, "a.cahvore": of_text}


def misses(
    found: LabelCamera, v: Mapping[str, np.ndarray], size: tuple[int, int], turn: np.ndarray, away: float
) -> float:
    """Largest distance from the pixels of `seen_by` of points so far away, all over a picture, in px."""
    u, w = np.meshgrid(*(np.linspace(0, count - 1, 9) for count in size))
    pixels = np.stack([u, w], -1).reshape(-1, 2)
    rays = found.camera.rays(pixels)
    ways = (rays / np.linalg.norm(rays, axis=1, keepdims=True))[np.isfinite(rays).all(axis=1)]
    assert len(ways) > 75
    points = found.pose.to_world(away * ways)
    there = np.array([seen_by(v, turn.T @ point) for point in points])
    return float(np.linalg.norm(found.camera.project(found.pose.to_camera(points)) - there, axis=1).max())


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", MODELS)
def test_pixels_are_those_of_the_fields_own_formula(name: str, form: str) -> None:
    """To 0.05 px at 2 m; where the pupil moves, by no more than what is stated at other ranges."""
    v, size = MODELS[name]
    found = read_label(InputFile(form, FORMS[form](v, size)))
    up = np.diag([1.0, -1.0, -1.0])
    if form == "a.cahvore":
        turned = up if any("points down" in told for told in found.remarks) else np.eye(3)
    else:
        turned = up @ TILT.as_matrix()
    assert misses(found, v, size, turned, 2.0) < 0.05
    assert misses(found, v, size, turned, 20.0) < found.residual_max_px + 1e-4
    assert found.residual_max_px < (1.0 if name.startswith(("MER Haz", "SYN")) else 0.05)


def test_a_lens_is_written_read_and_differentiated(tmp_path: Path) -> None:
    """The rig file keeps it to the last digit; derivatives are those of differences."""
    v, size = MODELS["MER Hazcam, CAHVORE of type 3"]
    one = read_label(InputFile("a.VIC", of_vicar(v, size)))
    rig = StereoRig(name="r", left=one.camera, right=one.camera, rotation=np.eye(3),
                    translation_m=np.array([-0.1, 0, 0]), covariance=covariance_of({}))  # fmt: skip
    (tmp_path / "rig.toml").write_text(rig_text(rig))
    points = np.random.default_rng(4).uniform([-1, -1, 1], [1, 1, 2], (20, 3))
    np.testing.assert_array_equal(read_rig(str(tmp_path / "rig.toml")).left.project(points), one.camera.project(points))
    turn, way, step = np.array([0.1, -0.05, 0.02]), np.array([0.1, 0.0, 0.2]), 1e-5
    found = one.camera.project_with_derivatives(points, turn, way)

    def moved(change: np.ndarray) -> np.ndarray:
        return one.camera.project(points @ rotation_of(turn + change[:3]).T + way + change[3:])

    by_pose = [(moved(step * e) - moved(-step * e)) / (2 * step) for e in np.eye(6)]
    np.testing.assert_allclose(found.pixels, moved(np.zeros(6)), atol=1e-9)
    np.testing.assert_allclose(found.by_pose, np.stack(by_pose, -1), atol=2e-3)
    vector = one.camera.vector()
    ends = [[one.camera.with_vector(vector + sign * e).project(points) for sign in (1, -1)] for e in np.eye(9)]
    by_lens = [0.5 * (more - less) for more, less in ends]
    at_rest = one.camera.project_with_derivatives(points)
    np.testing.assert_allclose(at_rest.by_intrinsics, np.stack(by_lens, -1), atol=1e-6)


@pytest.mark.parametrize("gone", [b"MODEL_COMPONENT_8", b"MODEL_COMPONENT_9"])
def test_a_fisheye_without_its_type_or_parameter_is_no_camera(gone: bytes) -> None:
    v, size = MODELS["MER Hazcam, CAHVORE of type 3"]
    label = of_vicar(v, size).replace(gone, b"MODEL_COMPONENT_X")
    if gone.endswith(b"8"):  # P alone is that of type 3
        assert read_label(InputFile("a.VIC", label)).camera.lens.linearity == 0.37  # type: ignore[union-attr]
        label = label.replace(b"MODEL_COMPONENT_9", b"MODEL_COMPONENT_Y")
    with pytest.raises(DataError, match="needs its type T"):
        read_label(InputFile("a.VIC", label))


def test_the_model_is_that_of_the_picture_and_its_part_of_the_detector_is_told() -> None:
    v, size = MODELS["MSL Mastcam, CAHV"]
    label = of_pds3(v, size).replace(b"  FIRST_LINE = 1\r", b"  FIRST_LINE = 17\r\n  FIRST_LINE_SAMPLE = 161\r")
    found = read_label(InputFile("a.lbl", label))
    assert found.camera.size == size
    assert (found.camera.cx_px, found.camera.cy_px) == pytest.approx((673.43, 590.19), abs=0.01)  # near its middle
    assert any("line 17, sample 161" in remark for remark in found.remarks)


def test_keys_are_read_by_their_groups() -> None:
    content = """A = 1
GROUP = G /* one's */
 B = (1,
  2) <m>
OBJECT = IMAGE
 B = 'x = 3'
END_OBJECT
 C = 4
END_GROUP
B = "5"
"""
    assert label_values(content) == {
        ("", "A"): "1", ("G", "B"): "(1,\n  2)", ("IMAGE", "B"): "x = 3", ("G", "C"): "4", ("", "B"): "5",
    }  # fmt: skip


needs_gdal = pytest.mark.skipif(importlib.util.find_spec("rasterio") is None, reason="rasterio reads products of PDS")


@needs_gdal
@pytest.mark.parametrize("form", ["a.VIC", "a.IMG", "odl.IMG", "beside.LBL", "a.xml"])
def test_products_are_pictures_with_their_cameras(form: str, tmp_path: Path) -> None:
    """Each layout of the archives: numbers, bits, size, camera, and what `lunarsci info` says of it."""
    v, size = {**MODELS["MER Navcam, CAHVOR"][0]}, (80, 60)
    v |= {"H": v["H"] / 12.8, "V": v["V"] / 17.07}
    values = np.random.default_rng(1).integers(3, 900, size[::-1]).astype(">i2")
    path = tmp_path / form.replace("LBL", "IMG").replace("xml", "IMG")
    vicar, odl = of_vicar(v, size), of_pds3(v, size)
    of_image = ["  SAMPLE_TYPE = MSB_INTEGER", "  SAMPLE_BITS = 16", "  SAMPLE_BIT_MASK = 2#0000111111111111#"]
    pointer = f'"{path.name}"' if form == "beside.LBL" else str(1 + 8192 // (2 * size[0]))
    of_file = ["RECORD_TYPE = FIXED_LENGTH", f"RECORD_BYTES = {2 * size[0]}", f"^IMAGE = {pointer}"]
    odl = odl.replace(b"GROUP = GEOM", "\r\n".join([*of_file, "GROUP = GEOM"]).encode(), 1)
    odl = odl.replace(b"END_OBJECT = IMAGE", "\r\n".join([*of_image, "END_OBJECT = IMAGE"]).encode())
    if form in ("a.IMG", "odl.IMG"):
        whole = 8192 // (2 * size[0]) * 2 * size[0]
        path.write_bytes(odl.ljust(whole) + values.tobytes())
        if form == "odl.IMG":
            odl = odl.replace(b"PDS_VERSION_ID = PDS3", b"ODL_VERSION_ID = ODL3")
            path.write_bytes(odl.ljust(whole) + vicar + values.tobytes())
    else:
        path.write_bytes((vicar if form == "a.VIC" else b"") + values.tobytes())
        if form != "a.VIC":
            path.with_suffix(f".{form.split('.')[1]}").write_bytes(
                odl if form == "beside.LBL" else of_pds4(v, size, path.name)
            )
    picture = read_picture(path)
    np.testing.assert_array_equal(picture.values, values)
    assert (picture.size, picture.bits) == (size, 12)
    assert read_label(read_input(path)).camera.size == size
    told = info(path)
    assert (told.kind, told.trouble, told.contents["size_px"]) == ("picture", "", "80 x 60")
    assert {"lunarsci images dem", "lunarsci images cameras"} <= {*told.commands}
    assert read_pose(str(path)).angles_deg() == pytest.approx(read_label(read_input(path)).pose.angles_deg())


@needs_gdal
def test_heights_come_from_fisheye_pictures_and_their_labels_alone(tmp_path: Path) -> None:
    """SYNTHETIC pair of hazard cameras with MER's lens, 90 degrees wide, over nearly level ground."""
    size, focal = (240, 240), 1.4 * 454.8 * 240 / 1024
    left = Pose.looking([0.0, 0.0, 0.5], 10, 40, 1.0)
    right = Pose(rotation=left.rotation @ rotation_of([0.001, 0.004, -0.002]), center_m=left.to_world([0.1, 0.0, 0.0]))
    up, vectors, lenses = np.diag([1.0, -1.0, -1.0]), [], []
    for pose in (left, right):
        turn = (up @ TILT.as_matrix()).T
        axes = turn @ pose.rotation
        vectors.append({
            **MER_HAZCAM, "C": turn @ pose.center_m, "A": axes[:, 2], "O": axes @ rotation_of([0.0016, 0, 0])[:, 2],
            "H": focal * axes[:, 0] + 117 * axes[:, 2], "V": focal * axes[:, 1] + 122 * axes[:, 2],
        })  # fmt: skip
        lenses.append(read_label(InputFile("a.VIC", of_vicar(vectors[-1], size))).camera)
    rig = StereoRig(
        name="SYNTHETIC", left=lenses[0], right=lenses[1], rotation=right.rotation.T @ left.rotation,
        translation_m=right.to_camera(left.center_m), covariance=covariance_of({}),
    )  # fmt: skip
    flat = (-0.5, -2.0, 0.1, np.zeros((41, 41)))
    sun = {"sun_azimuth_deg": 110, "sun_elevation_deg": 30}
    ground = landscape_on(flat, name="g", seed=4, spacing_m=0.01, roughness=0.3, rocks_per_m2=0.0, **sun)
    pair = render(ground, rig, left, seed=3)
    for name, v, values in zip("LR", vectors, (pair.left, pair.right), strict=True):
        (tmp_path / f"{name}.VIC").write_bytes(
            of_vicar(v, size, "2#0000001111111111#") + values.astype(">i2").tobytes()
        )
    files = [str(tmp_path / f"{name}.VIC") for name in "LR"]
    found = dem(*files, rig=",".join(files), pose=files[0]).model
    known = np.isfinite(found.height_m)
    nodes = np.stack(np.meshgrid(found.x_m, found.y_m), -1)[known]
    shown = pair.truth.points_m[np.isfinite(pair.truth.points_m).all(axis=-1)]
    away, nearest = cKDTree(shown[:, :2]).query(nodes)
    error = (found.height_m[known] - shown[nearest, 2])[away < 0.02]
    assert error.size > 4000
    assert read_rig(*files).mast_height_m == pytest.approx(0.5)
    assert abs(np.median(error)) < 1e-3
    assert np.sqrt(np.mean((error / found.layer("height_m_sigma")[known][away < 0.02]) ** 2)) < 1.2


@needs_gdal
def test_a_real_navcam_product_is_a_picture_that_looks_where_its_label_says(reference_data: Path) -> None:
    """Its SITE_DERIVED_GEOMETRY_PARMS have INSTRUMENT_AZIMUTH 144.003, INSTRUMENT_ELEVATION -16.9835, of its mast."""
    path = reference_data / "images" / "mer" / "2n292280938effb100p0703l0m1.img"
    told, found = info(path), read_label(read_input(path))
    assert (told.kind, told.contents["camera"], told.contents["bits"]) == ("picture", "NAVCAM_LEFT", 12)
    x, y, z = found.pose.rotation @ found.camera.rays([511.5, 511.5])
    assert np.degrees(np.arctan2(-y, x)) == pytest.approx(144.003, abs=1.0)
    assert np.degrees(np.arctan2(z, np.hypot(x, y))) == pytest.approx(-16.9835, abs=1.0)


@pytest.mark.parametrize(("frame", "unit"), [("ROVER_NAV_FRAME", ""), ("SITE_FRAME", " <METER>"), ("MINE", "")])
def test_labels_with_z_down_look_down(tmp_path: Path, frame: str, unit: str) -> None:
    paths = tmp_path / "L.LBL", tmp_path / "R.LBL"
    for path, y in zip(paths, (-0.21, 0.21), strict=True):
        path.write_text(cahvor(np.array([0.9, y, -1.9]), down=15.0, frame=frame, unit=unit))
    told = cameras([*map(str, paths)]).to_dict()
    assert told["rigs"][0]["baseline_m"] == pytest.approx(0.42, abs=1e-6)
    for camera, side in zip(told["cameras"], (0.21, -0.21), strict=True):
        assert camera["down_deg"] == pytest.approx(15.0, abs=1e-4)
        assert camera["position_m"] == pytest.approx([0.9, side, 1.9], abs=1e-6)
        assert "points down" in camera["remarks"][-1]
    assert info(paths[0]).kind == "camera"
    assert info(paths[0]).contents["looks"] == "heading 0.00, down 15.00 deg"
