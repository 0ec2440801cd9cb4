"""Cameras as ROS, OpenCV, Kalibr, EuRoC and the labels of Mars rovers write them.

The truth is that of the formats' own descriptions. ROS: sensor_msgs/CameraInfo, whose P has -fx baseline in its fourth
column. OpenCV: `stereoCalibrate`, X_2 = R X_1 + T. Kalibr: T_cn_cnm1, from the frame of the camera before to that of
this one. EuRoC: T_BS, from the sensor's frame to the body's.
"""

import json
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from lunarsci.cli import main

from lunarsci.errors import DataError, RequestError
from lunarsci.guide.info import info
from lunarsci.guide.template import template
from lunarsci.images.camera import INTRINSICS, PARAMETERS, Camera, Sensor, StereoRig, covariance_of, rotation_of
from lunarsci.images.jobs.cameras import CameraSheet, cameras
from lunarsci.images.pictures import Picture
from lunarsci.images.rig_files import check_pictures, read_pose, read_rig, rig_names, rig_text
from lunarsci.io.inputs import InputFile

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
        assert "`translation_unit`" in rig.read_as[0]
    assert the_rig(cameras([whole], translation_unit="cm")).baseline_m == pytest.approx(1.5, rel=1e-3)
    with pytest.raises(DataError, match="the place of the right camera to the left one is missing"):
        cameras([inner])


def test_cameras_whose_names_begin_with_their_side_are_a_rig(tmp_path: Path) -> None:
    tables = {f"{side}_{name}": values for side in ("left", "right")
              for name, values in (("camera_matrix", MATRIX.tolist()), ("distortion", LENS))}  # fmt: skip
    whole = {"image_size": [800, 600], "R": TURN.tolist(), "T": WAY.tolist(), **tables}
    (tmp_path / "a.yaml").write_text("\n".join(f"{key}: {value}" for key, value in whole.items()))
    check(the_rig(cameras([str(tmp_path / "a.yaml")])))


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


@pytest.mark.parametrize("name", rig_names())
def test_own_rigs_have_their_published_views_and_say_what_is_assumed(name: str) -> None:
    known = read_rig(name)
    views = {"yutu2-pancam": (19.7, 14.5), "yutu2-navcam": (46.6, 46.6), "yutu2-hazcam": (120.0, 120.0)}
    assert known.left.field_of_view_deg() == pytest.approx(views[name], abs=0.1)
    assert {"read_noise_e", "sigma", "distortion"} <= set(known.assumed)
    assert ("baseline_m" in known.assumed) is (name != "yutu2-pancam"), "the one that is published"
    assert known.sensor == Sensor(bits=10, full_well_e=25000.0, read_noise_e=15.0, mtf_at_nyquist=0.33)


def test_the_navcam_is_as_uncertain_as_its_published_check_point() -> None:
    """Zhang et al. (2020): a check point at 2.7 m is wrong by about 4 mm."""
    navcam = read_rig("yutu2-navcam")
    by = navcam.by_parameters(*navcam.project([0.0, 0.0, 2.7]))
    assert math.sqrt(np.trace(by @ navcam.covariance @ by.T)) == pytest.approx(4e-3, rel=0.1)


def test_a_rig_file_keeps_every_digit() -> None:
    lens = Camera(
        name="l", width_px=1024, height_px=1000, fx_px=1189.0, fy_px=1187.0, cx_px=510.0, cy_px=513.0,
        k1=-0.2, k2=0.05, k3=0.01, p1=1e-3, p2=-2e-3,
    )  # fmt: skip
    sigmas = {name: 0.1 if name.endswith("px") else 1e-4 for name in PARAMETERS}
    there = StereoRig(
        name="r", left=lens, right=replace(lens, cx_px=505.0, k1=-0.21), rotation=rotation_of([0.002, -0.01, 0.004]),
        translation_m=np.array([-0.27, 0.002, 0.001]), covariance=covariance_of(sigmas), assumed=("a",),
        source='from "there"', mast_height_m=1.4,
    )  # fmt: skip
    back = read_rig(InputFile("rig.toml", rig_text(there).encode()))
    for name in ("name", "assumed", "source", "sensor", "mast_height_m"):
        assert getattr(back, name) == getattr(there, name), name
    np.testing.assert_array_equal(back.covariance, there.covariance)
    np.testing.assert_allclose(back.rotation, there.rotation, atol=1e-15)
    np.testing.assert_array_equal(back.translation_m, there.translation_m)
    assert [getattr(back.left, n) for n in INTRINSICS] == [getattr(there.left, n) for n in INTRINSICS]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ('name = "x"\nwidth_px = 10', "no left; give"),
        ("name = ", "not valid TOML"),
        ('name = "x"\nbaseline_m = 0.0\nwidth_px = 9\nheight_px = 9\nfocal_px = 5', "needs a baseline"),
        ('name = "x"\nbaseline_m = 1\nwidth_px = 9\nheight_px = 9\nfocal_px = -5', "focal length"),
        (
            'name = "x"\nbaseline_m = 1\nwidth_px = 9\nheight_px = 9\nfocal_px = 5\nsigma = {a = 1}',
            "'a' is no parameter",
        ),
        ("<?xml version='1.0'?>", "of labels give two"),
    ],
)
def test_bad_rig_files_are_refused(content: str, said: str) -> None:
    with pytest.raises(DataError, match=said):
        read_rig(InputFile("rig.toml", content.encode()))


def test_unknown_rigs_and_pictures_of_others_are_refused() -> None:
    with pytest.raises(DataError, match="no rig of that name"):
        read_rig("yutu3")
    navcam, pancam = read_rig("yutu2-navcam"), read_rig("yutu2-pancam")

    def taken(width: int, height: int) -> list[Picture]:
        light = np.random.default_rng(1).uniform(0, 255, (height, width))
        return [Picture(source=InputFile("a.png", b""), values=light, bits=8)]

    check_pictures(navcam, taken(1024, 1024))
    with pytest.raises(DataError, match="another rig's"):
        check_pictures(navcam, taken(1176, 864))
    with pytest.raises(DataError, match="turned"):
        check_pictures(pancam, taken(864, 1176))


def test_what_opencv_writes_of_boards_in_mm_is_a_rig_without_the_size_of_its_pictures(tmp_path: Path) -> None:
    """With P1 and P2 of `stereoRectify`, whose fourth column has the unit of T, as YAML and as `np.savez`."""
    size = (800, 600)
    made = cv2.stereoRectify(MATRIX, np.array(LENS), MATRIX, np.array(LENS), size, TURN, 1e3 * WAY[:, None])
    values = {"M1": MATRIX, "D1": np.array([LENS]), "M2": MATRIX, "D2": np.array([LENS]), "R": TURN}
    values |= {"T": 1e3 * WAY[:, None]} | dict(zip(("R1", "R2", "P1", "P2", "Q"), made, strict=False))
    writer = cv2.FileStorage(str(tmp_path / "whole.yml"), cv2.FILE_STORAGE_WRITE)
    for key, value in values.items():
        writer.write(key, np.asarray(value))
    writer.release()
    check(the_rig(cameras([str(tmp_path / "whole.yml")], picture_size="800x600")))
    check(read_rig(str(tmp_path / "whole.yml"), picture_px=size))
    with pytest.raises(DataError, match="`picture_size`"):
        cameras([str(tmp_path / "whole.yml")])
    with pytest.raises(RequestError, match="such as 1280x960"):
        cameras([], picture_size="800")
    np.savez(tmp_path / "whole.npz", image_size=size, picture=np.zeros((600, 800)), **values)
    rig = the_rig(cameras([str(tmp_path / "whole.npz")]))
    check(rig)
    assert info(str(tmp_path / "whole.npz")).kind == "rig"
    assert rig.assumed == ("its errors",)
    assert rig.sigmas["translation_x_m"] == pytest.approx(0.0015, rel=1e-3)
    assert rig.sigmas["rotation_y_rad"] * 700 == pytest.approx(0.4)
    np.savez(tmp_path / "ground.npz", height_m=np.zeros((20, 20)), x_m=np.arange(20.0), y_m=np.arange(20.0))
    assert info(str(tmp_path / "ground.npz")).kind == "terrain"


@pytest.mark.parametrize(
    "names",
    [
        "cameraMatrix1 distCoeffs1 cameraMatrix2 distCoeffs2",
        "K1 dist1 K2 dist2",
        "cameraMatrix1 D1 cameraMatrix2 D2",
        "mtxL distL mtxR distR",
        "camera_matrix_left dist_left camera_matrix_right dist_right",
    ],
)
def test_cameras_go_by_the_names_that_programs_of_opencv_give_them(tmp_path: Path, names: str) -> None:
    """Those of the parameters of `stereoCalibrate`, of its samples, and of what people write."""
    values = dict(zip(names.split(), (MATRIX, np.array([LENS]), MATRIX, np.array([LENS])), strict=True))
    np.savez(tmp_path / "stereo.npz", R=TURN, T=1e3 * WAY[:, None], **values)
    check(read_rig(str(tmp_path / "stereo.npz"), picture_px=(800, 600)))


def test_the_template_of_a_rig_is_the_navcam_with_its_errors(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "rig.toml").write_text(template("rig").text)
    made, known = read_rig(str(tmp_path / "rig.toml")), read_rig("yutu2-navcam")
    assert (made.left.vector() == known.left.vector()).all() and (made.right.vector() == known.right.vector()).all()
    assert made.covariance == pytest.approx(known.covariance)
    assert (made.baseline_m, made.mast_height_m, made.left.size) == (0.27, 1.5, (1024, 1024))
    text = template("rig").text
    for line in [line for line in text.splitlines() if line.startswith("# ") and " = " in line and "X_" not in line]:
        text = text.replace(line, line.removeprefix("# "))
    assert read_rig(InputFile("rig.toml", text.encode())).sensor == known.sensor
    assert main(["images", "cameras", str(tmp_path / "rig.toml"), "--field", "rigs.0.baseline_m"]) == 0
    assert float(capsys.readouterr().out) == 0.27
    (tmp_path / "pose.toml").write_text(template("pose").text)
    assert read_pose(str(tmp_path / "pose.toml")).angles_deg() == pytest.approx((0.0, 25.0, 0.0), abs=1e-9)
