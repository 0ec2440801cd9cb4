"""`lunarsci spectra bands`: centres, depths and areas of the 1 and 2 µm bands."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from ..shared.command import command
from ..shared.options import Output
from ..shared.progress import progress
from ..shared.report import Report
from .options import Files, ReflectanceUnit, WavelengthUnit

__all__ = ["add_to"]


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "bands")(bands)


def bands(
    files: Files,
    output: Output,
    continuum: Annotated[
        Literal["conic", "hull", "linear"],
        typer.Option(
            help="conic: through 700, 1345, 1580 nm, guarded; hull: upper convex hull; linear: between shoulders."
        ),
    ] = "conic",
    smooth: Annotated[int, typer.Option(min=0, help="Savitzky-Golay window in channels, odd; 0 for none.")] = 41,
    smooth_order: Annotated[int, typer.Option(min=0, help="Order of the smoothing polynomial.")] = 3,
    plane: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Draw the 2 µm centre over the 1 µm centre among the pyroxenes (.png, …)."),
    ] = None,
    wavelength_unit: WavelengthUnit = None,
    reflectance_unit: ReflectanceUnit = None,
) -> Report:
    """Centre, depth and area of the 1 and 2 µm absorption bands, with standard errors.

    Composition of pyroxene and olivine from them by published regressions, each with error and range.
    """
    from lunarsci.spectra.bands import measure_batch
    from lunarsci.spectra.readers.batch import read_batch

    from .bands_report import bands_report

    output.check_extra("--plane", plane)
    batch = read_batch(files, wavelength_unit, reflectance_unit)
    with progress("measuring bands", quiet=output.quiet) as update:
        measured = measure_batch(
            batch.spectra, continuum_name=continuum, smooth_points=smooth, smooth_order=smooth_order, progress=update
        )
    return bands_report(batch, measured, plane)
