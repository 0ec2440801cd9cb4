"""`lunarsci images cameras`: what is known of cameras."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lunarsci.images.jobs.requests import CamerasRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import Output, option
from ..shared.table import TextTable, plus_minus

if TYPE_CHECKING:
    from lunarsci.images.jobs.cameras import CameraSheet

OPTIONS = {
    "disparity_error": option(),
    "translation_unit": option(show_default="m or mm, by its length"),
    "picture_size": option(metavar="WxH"),
}
Sources = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[RIG|LABEL|FILE...]",
        help="Rigs by name or TOML file; labels, or YAML, XML and .npz of ROS, OpenCV and Kalibr: one is a camera or "
        "a rig, two are the left and the right camera.",
        show_default="the rigs that come with lunarsci",
    ),
]
SHOWN = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "k3", "p1", "p2")
"""Intrinsics of a camera that the table has, in their order."""
EXAMPLES = (
    "lunarsci images cameras yutu2-pancam",
    "lunarsci images cameras lunarsci-demo/rig.toml --disparity-error 0.2",
)


@command("cameras", EXAMPLES, OPTIONS)
def cameras(output: Output, request: CamerasRequest, sources: Sources = None) -> Report:
    """Cameras and stereo rigs: intrinsics, baseline, field of view, size of a pixel and errors of ranges.

    Labels are PDS4 of Chang'E's PCAM, or have a CAHV, CAHVOR or CAHVORE model. The camera is fitted to them, and the
    residual is shown. Errors are those that a file states. -o FILE.toml writes a rig for `images dem`.
    """
    from lunarsci.images.jobs.cameras import cameras

    sheet = cameras(sources or (), request)

    return Report(sheet, result_tables(sheet), formats={".toml": lambda _: sheet.toml()})


def result_tables(result: CameraSheet) -> list[TextTable]:
    record, tables = result.to_dict(), []
    for rig in record["rigs"]:
        tables += [_intrinsics(rig), _ranges(rig)]
    return tables + [_alone(camera) for camera in record["cameras"]]


def number(name: str, camera: Mapping[str, Any]) -> str:
    """An intrinsic parameter of a camera with its error; one without an error was held."""
    if camera[f"{name}_sigma"] == 0:
        return f"{camera[name]:g}, held"
    return plus_minus(camera[name], camera[f"{name}_sigma"], digits=2 if name.endswith("px") else 5)


def _intrinsics(rig: Mapping[str, Any]) -> TextTable:
    sides = rig["left"], rig["right"]
    rows = [[name, *(number(name, side) for side in sides)] for name in SHOWN]
    rows.append(["view [deg]", *(f"{side['view_across_deg']:.1f} x {side['view_down_deg']:.1f}" for side in sides)])
    rows.append(["size [px]", *(f"{side['width_px']} x {side['height_px']}" for side in sides)])
    error = rig["baseline_m_sigma"]
    notes = [f"baseline {plus_minus(1e3 * rig['baseline_m'], error and 1e3 * error, digits=2)} mm"]
    notes += [f"read as: {note}" for note in rig["read_as"]]
    notes += [f"assumed: {', '.join(rig['assumed'])}"] if rig["assumed"] else []
    notes += [f"source: {rig['source']}"] if rig["source"] else []
    return TextTable(["", "left", "right"], rows, title=rig["name"], notes=notes)


def _ranges(rig: Mapping[str, Any]) -> TextTable:
    rows = [
        [
            f"{row['range_m']:g}",
            f"{row['disparity_px']:.1f}",
            f"{1e3 * row['pixel_m']:.2f}",
            f"{1e3 * row['range_random_m_sigma']:.2f}",
            _millimetres(row["range_common_m_sigma"]),
            "yes" if row["seen_by_both"] else "no",
        ]
        for row in rig["ranges"]
    ]
    headers = ["range [m]", "disparity [px]", "a pixel [mm]", "random [mm]", "common [mm]", "sharp in both"]
    return TextTable(headers, rows, title="Errors of the range along the left camera's axis")


def _millimetres(metres: float) -> str:
    return f"{1e3 * metres:.2f}" if math.isfinite(metres) else "-"


def _alone(camera: Mapping[str, Any]) -> TextTable:
    rows = [[name, number(name, camera)] for name in SHOWN]
    rows.append(["view [deg]", f"{camera['view_across_deg']:.1f} x {camera['view_down_deg']:.1f}"])
    notes = list(camera["remarks"])
    if "residual_rms_px" in camera:
        rows.append(["looks [deg]", f"heading {camera['heading_deg']:.2f}, down {camera['down_deg']:.2f}"])
        missed = f"{camera['residual_rms_px']:.2g} px rms, {camera['residual_largest_px']:.2g} px at most"
        without = f"{camera['pinhole_residual_largest_px']:.2g} px"
        notes.insert(0, f"the fit misses the label by {missed}; without distortion {without}")
    return TextTable(["", "camera"], rows, title=camera["name"], notes=notes)
