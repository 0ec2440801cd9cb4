"""Cameras as calibrations of others write them, each after a public description that its kind names.

One made-up camera, or two of it 0.24 m apart, stands in all of them.
"""

import json
from pathlib import Path

import pytest
from lunarsci.cli import main

import lunarsci
from lunarsci.guide.info import info

FX, FY, CX, CY = 612.5, 611.0, 322.25, 238.75
WIDTH, HEIGHT = 640, 480
K1, K2, P1, P2 = -0.21, 0.048, 0.0004, -0.0006
BASE_M = 0.24
MATRIX = f"[{FX}, 0.0, {CX}, 0.0, {FY}, {CY}, 0.0, 0.0, 1.0]"
LENS = f"[{K1}, {K2}, {P1}, {P2}, 0.0]"
OPENCV = "    rows: {}\n    cols: {}\n    dt: d\n    data: {}\n"


def colmap(model: str, numbers: str) -> str:
    """COLMAP counts from the corner of the first pixel, OpenCV and lunarsci from its centre."""
    head = "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
    place = f"{FX} {FY} {CX + 0.5} {CY + 0.5}"
    return f"{head}# Number of cameras: 1\n1 {model} {WIDTH} {HEIGHT} {place} {numbers}\n"


KINDS: dict[str, tuple[str, str, str, bool]] = {
    "colmap opencv": (
        "COLMAP documentation, cameras.txt", "cameras.txt",
        colmap("OPENCV", f"{K1} {K2} {P1} {P2}"), True,
    ),
    "colmap pinhole": ("COLMAP documentation", "cameras.txt", colmap("PINHOLE", ""), False),
    "colmap full opencv": (
        "COLMAP documentation, FULL_OPENCV", "cameras.txt",
        colmap("FULL_OPENCV", f"{K1} {K2} {P1} {P2} 0 0 0 0"), True,
    ),
    "ros ini": (
        "ROS camera_calibration_parsers, INI files of Videre", "ost.ini",
        f"# oST version 5.0 parameters\n\n[image]\n\nwidth\n{WIDTH}\n\nheight\n{HEIGHT}\n\n[narrow_stereo/left]\n\n"
        f"camera matrix\n{FX} 0.000000 {CX}\n0.000000 {FY} {CY}\n0.000000 0.000000 1.000000\n\ndistortion\n"
        f"{K1} {K2} {P1} {P2} 0.000000\n\nrectification\n1 0 0\n0 1 0\n0 0 1\n\nprojection\n{FX} 0 {CX} 0\n"
        f"0 {FY} {CY} 0\n"
        "0 0 1 0\n", True,
    ),
    "ros message": (
        "sensor_msgs/CameraInfo, rational_polynomial", "info.yaml",
        f"header:\n  seq: 3\n  stamp:\n    secs: 12\n    nsecs: 5\n  frame_id: left\nheight: {HEIGHT}\n"
        f"width: {WIDTH}\n"
        f"distortion_model: rational_polynomial\nD: [{K1}, {K2}, {P1}, {P2}, 0.0, 0.0, 0.0, 0.0]\nK: {MATRIX}\n"
        f"R: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]\n"
        f"P: [{FX}, 0.0, {CX}, 0.0, 0.0, {FY}, {CY}, 0.0, 0.0, 0.0, 1.0, 0.0]\n"
        "binning_x: 0\nbinning_y: 0\n", True,
    ),
    "opencv json": (
        "OpenCV cv::FileStorage, JSON", "camera.json",
        json.dumps({"image_width": WIDTH, "image_height": HEIGHT, "camera_matrix": {
            "type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d",
            "data": [FX, 0.0, CX, 0.0, FY, CY, 0.0, 0.0, 1.0]}, "distortion_coefficients": {
            "type_id": "opencv-matrix", "rows": 1, "cols": 5, "dt": "d",
            "data": [K1, K2, P1, P2, 0.0]}}, indent=4), True,
    ),
    "nerf transforms": (
        "instant-ngp, transforms.json", "transforms.json",
        json.dumps({"fl_x": FX, "fl_y": FY, "cx": CX, "cy": CY, "w": WIDTH, "h": HEIGHT, "k1": K1, "k2": K2, "p1": P1,
                    "p2": P2, "frames": []}), True,
    ),
    "camodocal": (
        "https://github.com/HKUST-Aerial-Robotics/VINS-Mono, camera files", "cam0.yaml",
        f"%YAML:1.0\n---\nmodel_type: PINHOLE\ncamera_name: cam0\nimage_width: {WIDTH}\nimage_height: {HEIGHT}\n"
        f"distortion_parameters:\n   k1: {K1}\n   k2: {K2}\n   p1: {P1}\n   p2: {P2}\nprojection_parameters:\n"
        f"   fx: {FX}\n   fy: {FY}\n   cx: {CX}\n   cy: {CY}\n", True,
    ),
    "orb-slam3": (
        "https://github.com/UZ-SLAMLab/ORB_SLAM3, settings files 1.0", "cam.yaml",
        f'%YAML:1.0\nFile.version: "1.0"\nCamera.type: "PinHole"\nCamera1.fx: {FX}\nCamera1.fy: {FY}\n'
        f'Camera1.cx: {CX}\n'
        f"Camera1.cy: {CY}\nCamera1.k1: {K1}\nCamera1.k2: {K2}\nCamera1.p1: {P1}\nCamera1.p2: {P2}\n"
        f"Camera.width: {WIDTH}\n"
        f"Camera.height: {HEIGHT}\nCamera.fps: 20\n", True,
    ),
    "metashape": (
        "Agisoft Metashape user manual, camera calibration in XML", "camera.xml",
        f'<?xml version="1.0" encoding="UTF-8"?>\n<calibration>\n  <projection>frame</projection>\n'
        f'  <width>{WIDTH}</width>\n'
        f"  <height>{HEIGHT}</height>\n  <f>{FY}</f>\n  <cx>{CX - WIDTH / 2 + 0.5}</cx>\n"
        f"  <cy>{CY - HEIGHT / 2 + 0.5}</cy>\n"
        f"  <b1>{FX - FY}</b1>\n  <k1>{K1}</k1>\n  <k2>{K2}</k2>\n  <p1>{P2}</p1>\n  <p2>{P1}</p2>\n"
        f"</calibration>\n", True,
    ),
}  # fmt: skip
STEREO: dict[str, tuple[str, str, str]] = {
    "opencv stereo": (
        "OpenCV, samples/cpp/stereo_calib.cpp, in one file with image_size", "stereo.yml",
        "%YAML:1.0\n---\nimage_size: [ 640, 480 ]\n" + "".join(
            f"{name}: !!opencv-matrix\n" + OPENCV.format(*shape, numbers)
            for name, shape, numbers in (
                ("M1", (3, 3), MATRIX), ("D1", (1, 5), LENS), ("M2", (3, 3), MATRIX), ("D2", (1, 5), LENS),
                ("R", (3, 3), "[1., 0., 0., 0., 1., 0., 0., 0., 1.]"), ("T", (3, 1), f"[{-1e3 * BASE_M}, 0., 0.]"))),
    ),
    "kalibr": (
        "https://github.com/ethz-asl/kalibr/wiki/yaml-formats, radtan", "camchain.yaml",
        "".join(
            f"cam{k}:\n" + (
                f"  T_cn_cnm1:\n  - [1.0, 0.0, 0.0, {-BASE_M}]\n  - [0.0, 1.0, 0.0, 0.0]\n  - [0.0, 0.0, 1.0, 0.0]\n"
                "  - [0.0, 0.0, 0.0, 1.0]\n" if k else "")
            + f"  camera_model: pinhole\n  distortion_coeffs: [{K1}, {K2}, {P1}, {P2}]\n  distortion_model: radtan\n"
            f"  intrinsics: [{FX}, {FY}, {CX}, {CY}]\n  resolution: [{WIDTH}, {HEIGHT}]\n"
            f"  rostopic: /cam{k}/image_raw\n"
            for k in (0, 1)),
    ),
    "orb-slam3 stereo": (
        "https://github.com/UZ-SLAMLab/ORB_SLAM3, settings files 1.0, stereo", "stereo.yaml",
        '%YAML:1.0\nFile.version: "1.0"\nCamera.type: "PinHole"\n' + "".join(
            f"Camera{k}.fx: {FX}\nCamera{k}.fy: {FY}\nCamera{k}.cx: {CX}\nCamera{k}.cy: {CY}\nCamera{k}.k1: {K1}\n"
            f"Camera{k}.k2: {K2}\nCamera{k}.p1: {P1}\nCamera{k}.p2: {P2}\n" for k in (1, 2))
        + f"Camera.width: {WIDTH}\nCamera.height: {HEIGHT}\nStereo.ThDepth: 60.0\nStereo.T_c1_c2: !!opencv-matrix\n"
        + OPENCV.format(4, 4, f"[1., 0., 0., {BASE_M}, 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.]"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_the_camera_is_read(kind: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    _, name, content, bent = KINDS[kind]
    (tmp_path / name).write_text(content)
    (found,) = lunarsci.cameras([str(tmp_path / name)]).to_dict()["cameras"]
    assert main(["images", "cameras", str(tmp_path / name), "--json"]) in (0, 3)
    (told,) = json.loads(capfd.readouterr().out)["result"]["cameras"]
    for camera in (found, told):
        assert [camera[key] for key in ("fx_px", "fy_px", "cx_px", "cy_px")] == pytest.approx(
            [FX, FY, CX, CY], rel=1e-6
        )
        assert (camera["width_px"], camera["height_px"]) == (WIDTH, HEIGHT)
        lens = [camera.get(key, 0.0) for key in ("k1", "k2", "p1", "p2")]
        assert lens == pytest.approx([K1, K2, P1, P2] if bent else [0.0] * 4, rel=1e-6)
    assert (info(tmp_path / name).kind, info(tmp_path / name).trouble) == ("camera", "")


@pytest.mark.parametrize("kind", STEREO)
def test_the_rig_is_read(kind: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    _, name, content = STEREO[kind]
    (tmp_path / name).write_text(content)
    found = lunarsci.cameras([str(tmp_path / name)]).to_dict()
    assert main(["images", "cameras", str(tmp_path / name), "--json"]) in (0, 3)
    told = json.loads(capfd.readouterr().out)["result"]
    for answer in (found, told):
        (rig,) = answer["rigs"]
        assert rig["baseline_m"] == pytest.approx(BASE_M)
        assert rig["relative"]["translation_m"] == pytest.approx([-BASE_M, 0.0, 0.0])
        assert rig["ranges"][0]["disparity_px"] == pytest.approx(FX * BASE_M, rel=1e-3)
    assert (info(tmp_path / name).kind, info(tmp_path / name).trouble) == ("rig", "")
