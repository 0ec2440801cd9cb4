"""`lunarsci spectra calibrate`: VNIS radiance to reflectance factor."""

from typing import Annotated, Literal

import typer

from ..shared.command import command
from ..shared.options import Output
from ..shared.progress import progress
from ..shared.report import Report

__all__ = ["add_to"]

Products = Annotated[
    list[str],
    typer.Argument(
        help="Labels (.2BL) or data files (.2B) of Chang'E-4 VNIS level 2B, or folders of them; the other files of an "
        "observation are found beside it by their sequence number."
    ),
]


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "calibrate")(calibrate)


def calibrate(
    files: Products,
    output: Output,
    photometry: Annotated[
        Literal["lommel-seeliger", "akimov", "mcewen", "none"],
        typer.Option(help="Disk function of the correction to i 30, e 0, g 30 deg; none keeps the measured angles."),
    ] = "lommel-seeliger",
    phase: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="Phase function: sp-low, sp-mid, sp-high, flat, or a CSV table.")
    ] = "sp-mid",
    solar: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="Solar irradiance: e490, g173, or a table of nm and W m-2 nm-1.")
    ] = "e490",
    shadow: Annotated[
        float, typer.Option(help="Pixels with less reflectance at 465 nm are shadows; 0 to below 1.")
    ] = 0.02,
    vnir_steps: Annotated[
        Literal["keep", "remove"],
        typer.Option(help="Steps at 632.5 and 757.5 nm between sub-bands of the imager: keep or remove."),
    ] = "keep",
    calibration: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="Channel factors for radiance from before the in-flight calibration (label version 1): CSV with "
            "detector (vnir, swir), wavelength_nm, factor.",
        ),
    ] = None,
    radiance_per: Annotated[
        Literal["nm", "um"], typer.Option(help="Radiance of the files is in W m-2 sr-1 per nm or um.")
    ] = "nm",
) -> Report:
    """VNIS radiance to reflectance factor, 390 channels, with independent and shared errors.

    -o FILE.ecsv or FILE.fits writes the spectra with units and provenance; the other commands read them. They also take
    the labels themselves and calibrate as this command does without options.
    """
    from lunarsci.spectra.vnis.calibrate import calibrate_files

    from .calibrate_report import calibrate_report, check_fits, observations, settings_from

    settings = settings_from(solar, photometry, phase, shadow, vnir_steps, calibration, radiance_per)
    paths, failures = observations(files)
    check_fits(output.path, len(paths))
    with progress("calibrating", quiet=output.quiet) as update:
        results = calibrate_files(paths, settings, update)
    return calibrate_report([*failures, *results], settings)
