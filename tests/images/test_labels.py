"""Labels beside closed forms, and models of other people."""

from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError
from lunarsci.guide.info import info
from lunarsci.images.camera import Camera, Pose, rotation_of, vector_of
from lunarsci.images.jobs.cameras import cameras
from lunarsci.images.labels import CahvModel, fit_cahv, read_label
from lunarsci.images.rig_files import read_rig
from lunarsci.io.inputs import InputFile


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
