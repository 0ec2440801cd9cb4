"""Cameras as ROS, OpenCV, Kalibr, EuRoC and the labels of Mars rovers write them.

The truth is that of the formats' own descriptions. ROS: sensor_msgs/CameraInfo, whose P has -fx baseline in its fourth
column. OpenCV: `stereoCalibrate`, X_2 = R X_1 + T. Kalibr: T_cn_cnm1, from the frame of the camera before to that of
this one. EuRoC: T_BS, from the sensor's frame to the body's. Labels: Maki et al. (2003), 10.1029/2003JE002077.
"""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from lunarsci.cli import main

from lunarsci.errors import DataError
from lunarsci.guide.info import info
from lunarsci.images.camera import StereoRig
from lunarsci.images.jobs.cameras import CameraSheet, cameras
from lunarsci.images.rig_files import read_rig, rig_text

MATRIX = np.array([[700.0, 0.0, 410.0], [0.0, 702.0, 305.0], [0.0, 0.0, 1.0]])
LENS = [-0.2, 0.05, 0.001, -0.002, 0.01]
TURN = cv2.Rodrigues(np.array([0.01, -0.02, 0.005]))[0]
WAY = np.array([-0.15, 0.002, 0.001])


def listed(values: object) -> str:
    return "[" + ", ".join(f"{value!r}" for value in np.ravel(np.asarray(values)).tolist()) + "]"


def ros(name: str, turn: np.ndarray, shift: float) -> str:
    onto = np.array([[650.0, 0.0, 400.0, shift], [0.0, 650.0, 300.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
    tables = {"camera_matrix": MATRIX, "distortion_coefficients": np.array([LENS]), "rectification_matrix": turn}
    tables |= {"projection_matrix": onto}
    lines = ["image_width: 800", "image_height: 600", f"camera_name: {name}", "distortion_model: plumb_bob"]
    for key, table in tables.items():
        lines += [f"{key}:", f"  rows: {len(table)}", f"  cols: {len(table[0])}", f"  data: {listed(table)}"]
    return "\n".join(lines) + "\n"


def pair(folder: Path) -> tuple[str, str]:
    """Rectified frames of both cameras are turned by TURN from that of the right one."""
    paths = folder / "left.yaml", folder / "right.yaml"
    paths[0].write_text(ros("left", np.eye(3), 0.0))
    paths[1].write_text(ros("right", TURN, -650.0 * 0.15))
    return str(paths[0]), str(paths[1])


def the_rig(sheet: CameraSheet) -> StereoRig:
    (rig,) = sheet.rigs
    return rig


def check(rig: StereoRig) -> None:
    assert (rig.left.fx_px, rig.left.cy_px, rig.left.k3, rig.left.p2) == (700.0, 305.0, 0.01, -0.002)
    assert rig.left.size == (800, 600)
    assert rig.rotation == pytest.approx(TURN, abs=1e-9)
    assert rig.translation_m == pytest.approx(WAY, abs=1e-9)


def test_two_files_of_ros_are_a_rig_whose_baseline_is_that_of_p(tmp_path: Path) -> None:
    left, right = pair(tmp_path)
    rig = the_rig(cameras([left, right]))
    assert rig.rotation == pytest.approx(TURN.T, abs=1e-9)
    assert rig.translation_m == pytest.approx(TURN.T @ [-0.15, 0.0, 0.0], abs=1e-9)
    assert (rig.left.k1, rig.left.k2, rig.left.p1, rig.left.p2, rig.left.k3) == tuple(LENS)
    assert "baseline from the projection matrices" in rig.read_as[0]
    assert read_rig(left, right).baseline_m == rig.baseline_m


def test_swapped_files_of_ros_are_told_and_the_advice_gives_the_rig(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    left, right = pair(tmp_path)
    assert main(["images", "cameras", right, left]) == 1
    told = capsys.readouterr()
    assert "left and right are swapped; give the left one first" in told.err
    assert not told.out
    assert main(["images", "cameras", left, right, "--field", "rigs.0.baseline_m"]) == 0
    assert float(capsys.readouterr().out) == pytest.approx(0.15)


def test_one_file_of_ros_is_a_camera_without_errors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, right = pair(tmp_path)
    assert main(["images", "cameras", right, "--json", "--no-time"]) == 0
    (camera,) = json.loads(capsys.readouterr().out)["result"]["cameras"]
    assert (camera["fx_px"], camera["fx_px_sigma"]) == (700.0, None)
    assert "0.15 m from its partner" in camera["remarks"][0]
    with pytest.raises(DataError, match="one camera"):
        read_rig(right)


def test_a_topic_of_ros_2_that_was_printed_is_a_camera(tmp_path: Path) -> None:
    lines = ["header:", "  frame_id: mast", "height: 600", "width: 800", "distortion_model: plumb_bob", "d:"]
    lines += [f"- {value}" for value in LENS] + ["k:"] + [f"- {value}" for value in MATRIX.ravel()] + ["---"]
    (tmp_path / "topic.yaml").write_text("\n".join(lines))
    (found,) = cameras([str(tmp_path / "topic.yaml")]).alone.values()
    assert (found.camera.fy_px, found.camera.k2, found.camera.size) == (702.0, 0.05, (800, 600))


@pytest.mark.parametrize("end", ["yml", "xml", "json"])
def test_files_of_opencv_are_a_rig_in_metres(tmp_path: Path, end: str) -> None:
    """Written by `cv2.FileStorage` itself: YAML with its head and tags, XML and JSON."""
    whole, inner, outer = (str(tmp_path / f"{name}.{end}") for name in ("whole", "inner", "outer"))
    for path, what in ((whole, "io"), (inner, "i"), (outer, "o")):
        writer = cv2.FileStorage(path, cv2.FILE_STORAGE_WRITE)
        if "i" in what:
            writer.write("image_width", 800)
            writer.write("image_height", 600)
            for side in "12":
                writer.write(f"M{side}", MATRIX)
                writer.write(f"D{side}", np.array([LENS]))
        if "o" in what:
            writer.write("R", TURN)
            writer.write("T", 1e3 * WAY[:, None])
        writer.release()
    for given in ([whole], [inner, outer], [outer, inner]):
        rig = the_rig(cameras(given))
        check(rig)
        assert "T is in mm" in rig.read_as[0]
        assert "--translation-unit" in rig.read_as[0]
    assert the_rig(cameras([whole], translation_unit="cm")).baseline_m == pytest.approx(1.5, rel=1e-3)
    with pytest.raises(DataError, match="nothing tells how the two cameras stand"):
        cameras([inner])


def test_one_camera_of_opencv_needs_its_size_and_the_advice_is_right(tmp_path: Path) -> None:
    path = tmp_path / "camera.yml"
    writer = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    writer.write("camera_matrix", MATRIX)
    writer.write("distortion_coefficients", np.array([LENS]).T)
    writer.release()
    with pytest.raises(DataError, match="add image_width: … and image_height: …"):
        cameras([str(path)])
    path.write_text(path.read_text() + "image_width: 800\nimage_height: 600\n")
    (found,) = cameras([str(path)]).alone.values()
    assert found.camera.k3 == 0.01


@pytest.mark.parametrize("fisheye", [False, True])
def test_other_lenses_are_fitted_by_browns(tmp_path: Path, fisheye: bool) -> None:
    lens = [0.05, -0.01, 0.002, 0.001] if fisheye else [0.3, 0.05, 0.001, -0.0005, 0.0, 0.5, 0.1, 0.0]
    model = "equidistant" if fisheye else "rational_polynomial"
    text = f"image_width: 800\nimage_height: 600\ncamera_matrix: {listed(MATRIX)}\ndistortion_model: {model}\n"
    (tmp_path / "a.yaml").write_text(f"{text}distortion_coefficients: {listed(lens)}\n")
    (found,) = cameras([str(tmp_path / "a.yaml")]).alone.values()
    assert f"{'fish-eye' if fisheye else 'rational'} lens, fitted" in found.source
    points = np.array([[0.3, -0.2, 1.0], [-0.4, 0.3, 1.0], [0.1, 0.1, 1.0]])
    project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
    wanted = project(points[:, None], np.zeros(3), np.zeros(3), MATRIX, np.array(lens))[0][:, 0]
    assert found.camera.project(points) == pytest.approx(wanted, abs=0.5)


def kalibr(first: str, second: str, chain: np.ndarray) -> str:
    own = (
        "  camera_model: pinhole\n  distortion_model: radtan\n  distortion_coeffs: [-0.2, 5e-2, 1e-3, -2e-3, 1e-2]\n"
        "  intrinsics: [700.0, 702.0, 410.0, 305.0]\n  resolution: [800, 600]\n"
    )
    rows = "".join(f"  - {listed(row)}\n" for row in chain)
    return f"{first}:\n{own}  rostopic: /a\n{second}:\n  T_cn_cnm1:\n{rows}{own}  rostopic: /b\n"


def test_chains_of_kalibr_are_a_rig_whichever_camera_comes_first(tmp_path: Path) -> None:
    chain = np.eye(4)
    chain[:3, :3], chain[:3, 3] = TURN, WAY
    path = tmp_path / "camchain.yaml"
    path.write_text(kalibr("cam0", "cam1", chain))
    check(the_rig(cameras([str(path)])))
    assert not the_rig(cameras([str(path)])).read_as
    path.write_text(kalibr("cam0", "cam1", np.linalg.inv(chain)))
    rig = the_rig(cameras([str(path)]))
    check(rig)
    assert "taken as the left one" in rig.read_as[-1]


def test_two_sensors_of_euroc_are_a_rig(tmp_path: Path) -> None:
    body = np.eye(4)
    body[:3, :3] = cv2.Rodrigues(np.array([0.3, -1.2, 0.5]))[0]
    body[:3, 3] = [0.1, 0.5, -0.2]
    chain = np.eye(4)
    chain[:3, :3], chain[:3, 3] = TURN, WAY
    names = []
    for name, place in (("a", body), ("b", body @ np.linalg.inv(chain))):
        names.append(str(tmp_path / f"{name}.yaml"))
        Path(names[-1]).write_text(
            f"sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: {listed(place)}\nresolution: [800, 600]\n"
            f"camera_model: pinhole\nintrinsics: [700.0, 702.0, 410.0, 305.0]\n"
            f"distortion_coefficients: {listed(LENS)}\n"
        )
    check(the_rig(cameras(names)))
    with pytest.raises(DataError, match="left and right are swapped"):
        cameras(names[::-1])


def test_settings_with_a_key_for_each_number_are_a_camera(tmp_path: Path) -> None:
    """As ORB-SLAM's examples have them."""
    numbers = {"fx": 700.0, "fy": 702.0, "cx": 410.0, "cy": 305.0, "k1": -0.2, "k2": 0.05, "p1": 0.001, "p2": -0.002}
    lines = [f"Camera.{key}: {value}" for key, value in numbers.items()]
    (tmp_path / "a.yaml").write_text("%YAML:1.0\n" + "\n".join([*lines, "Camera.width: 800", "Camera.height: 600"]))
    (found,) = cameras([str(tmp_path / "a.yaml")]).alone.values()
    assert (found.camera.fx_px, found.camera.p2, found.camera.k3) == (700.0, -0.002, 0.0)


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


def test_a_rig_file_with_swapped_cameras_is_refused_and_both_advices_work(tmp_path: Path) -> None:
    left, right = pair(tmp_path)
    good = read_rig(left, right)
    swapped = tmp_path / "swapped.toml"
    turned = (
        rig_text(good).replace("[left]", "[was left]").replace("[right]", "[left]").replace("[was left]", "[right]")
    )
    back = -good.rotation.T @ good.translation_m
    vector = cv2.Rodrigues(good.rotation.T)[0].ravel()
    head, _, _ = turned.partition("[relative]")
    swapped.write_text(f"{head}[relative]\nrotation_rad = {listed(vector)}\ntranslation_m = {listed(back)}\n")
    with pytest.raises(DataError, match=r"exchange \[left\] and \[right\]") as refused:
        read_rig(str(swapped))
    advice = str(refused.value)
    numbers = {
        name: advice.partition(f"{name} = ")[2].partition("]")[0] + "]" for name in ("rotation_rad", "translation_m")
    }
    original, _, _ = rig_text(good).partition("[relative]")
    lines = [f"{name} = {value}" for name, value in numbers.items()]
    swapped.write_text("\n".join([original, "[relative]", *lines, ""]))
    assert read_rig(str(swapped)).translation_m == pytest.approx(good.translation_m, abs=1e-9)
    assert read_rig(str(swapped)).rotation == pytest.approx(good.rotation, abs=1e-9)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("camera_matrix: [1, 2\n", "broken YAML"),
        ("image_width: 8\nimage_height: x\nK: [1, 0, 1, 0, 1, 1, 0, 0, 1]\n", "lines is 'x', no number"),
        (
            "image_width: 80\nimage_height: 60\nK: [0, 0, 1, 0, 1, 1, 0, 0, 1]\n",
            "a focal length above 0 and finite numbers are needed, not .* fx_px 0.0",
        ),
        ("image_width: 8\nK: " + "[" * 3000, "broken YAML"),
        ('{"fl_x": 900, "cx": 4, "cy": 3, "h": 6}', "lacks something .'w'.; export it again"),
        (
            "<calibration><projection>frame</projection><f>much</f></calibration>",
            "lacks something .could not convert string to float: 'much'.; export it again",
        ),
    ],
)
def test_broken_files_are_refused_in_one_line(tmp_path: Path, content: str, said: str) -> None:
    (tmp_path / "a.yaml").write_text(content)
    with pytest.raises(DataError, match=said) as refused:
        cameras([str(tmp_path / "a.yaml")])
    assert "\n" not in str(refused.value)


def test_info_tells_cameras_and_rigs(tmp_path: Path) -> None:
    left, _ = pair(tmp_path)
    told = info(left)
    assert (told.kind, told.contents["size_px"]) == ("camera", "800 x 600")
    (tmp_path / "chain.yaml").write_text(kalibr("cam0", "cam1", np.eye(4) + 0.1 * np.eye(4, k=3)))
    assert info(tmp_path / "chain.yaml").kind == "rig"
    assert "taken as the left one" in str(info(tmp_path / "chain.yaml").contents["read as"])
