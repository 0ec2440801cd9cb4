"""`lunarsci spectra simulate`: synthetic VNIS products of a made-up scene."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import typer

from lunarsci.spectra.jobs.simulate import SimulateVnisRequest

from ..shared.command import command
from ..shared.options import option
from ..shared.report import Report
from ..shared.table import TextTable

OPTIONS = {
    "soil": option("Fractions of ol, opx, cpx, plg that add up to 1.", metavar="MINERALS"),
    "rock": option("The same for a rock in the image; none if left out.", metavar="MINERALS"),
    "rock_radius": option("Radius of the rock in px; the SWIR detector sees 53.8."),
    "shadow": option("Share of the image in shadow, 0 to below 1."),
    "incidence": option("Angle of the Sun from the normal in deg."),
    "emission": option("Angle of the view from the normal in deg."),
    "phase_angle": option("Angle between Sun and view in deg."),
    "photometry": option("Disk function that the ground obeys; none for the same reflectance at all angles."),
    "phase": option("Phase function that the ground obeys."),
    "noise": option("Factor on the instrument's noise; 0 for none."),
    "time": option("UTC time of the short-wave scan, ISO 8601."),
    "sequence": option("Number of the observation.", min=1, max=9999),
    "seed": option("Seed of texture, shadows and noise.", min=0),
}


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "simulate", folder=True, request=SimulateVnisRequest, options=OPTIONS)(simulate)


def simulate(request: SimulateVnisRequest) -> Report:
    """Synthetic VNIS products of a made-up scene: image cube, table, labels, and the truth.

    -o DIR writes them; every name and label says SYNTHETIC.
    """
    from lunarsci.spectra.jobs.simulate import simulate

    result = simulate(request)
    files = {name: partial(bytes, content) for name, content in result.files.items()}
    return Report.of(result, [_table(result.to_dict())], files=files)


def _table(result: Mapping[str, Any]) -> TextTable:
    shares = ", ".join(f"{name} {100 * share:.0f} %" for name, share in result["composition"].items() if share)
    notes = [
        f"lit ground in the SWIR field of view: {shares}; rock covers {100 * result['rock_fraction']:.0f} % of it, "
        f"{100 * result['shadow_fraction']:.0f} % of the field lies in shadow",
        "Synthetic: made up, not a measurement. Strengths of bands, albedo and texture are assumed.",
    ]
    rows = [[item["name"], str(item["bytes"])] for item in result["files"]]
    return TextTable(["file", "bytes"], rows, title=f"{result['observation']}", notes=notes)
