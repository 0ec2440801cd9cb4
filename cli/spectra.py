"""`lunarsci spectra`: what the rock is made of."""

from typing import Annotated, Literal

import typer

from .command import command
from .options import Output
from .progress import progress
from .report import Report

__all__ = ["app"]

app = typer.Typer(
    no_args_is_help=True, help="What the rock is made of: absorption bands and minerals from reflectance spectra."
)

Files = Annotated[
    list[str],
    typer.Argument(
        help="Spectra: ECSV, CSV or text (first column wavelength, then one or many spectra), RELAB .tab/.asc, FITS "
        "table; several files, folders or patterns; - is stdin."
    ),
]
WavelengthUnit = Annotated[
    Literal["nm", "um"] | None,
    typer.Option("--wavelength-unit", help="State the unit of the wavelengths where the file does not."),
]
ReflectanceUnit = Annotated[
    Literal["fraction", "percent"] | None, typer.Option("--reflectance-unit", help="State the unit of the reflectance.")
]


@command(app, "bands")
def bands(
    files: Files,
    output: Output,
    continuum: Annotated[
        Literal["conic", "hull", "linear"],
        typer.Option(
            help="conic: through 700, 1345, 1580 nm, guarded; hull: upper convex hull; linear: between shoulders."
        ),
    ] = "conic",
    smooth: Annotated[int, typer.Option(min=0, help="Savitzky-Golay window [channels], odd; 0 for none.")] = 41,
    smooth_order: Annotated[int, typer.Option(min=0, help="Order of the smoothing polynomial.")] = 3,
    wavelength_unit: WavelengthUnit = None,
    reflectance_unit: ReflectanceUnit = None,
) -> Report:
    """Centre, depth and area of the 1 and 2 µm absorption bands, with standard errors."""
    from lunarsci.spectra.bands import measure_batch

    from .spectra_report import bands_report, read_batch

    batch = read_batch(files, wavelength_unit, reflectance_unit)
    with progress("measuring bands", quiet=output.quiet) as update:
        measured = measure_batch(
            batch.spectra, continuum_name=continuum, smooth_points=smooth, smooth_order=smooth_order, progress=update
        )
    return bands_report(batch, measured)


@command(app, "fit")
def fit(
    files: Files,
    output: Output,
    assemblage: Annotated[
        str, typer.Option(help="Minerals whose bands are fitted: OL, OPX, CPX, joined by hyphens.")
    ] = "OL-OPX-CPX",
    continuum: Annotated[
        Literal["wavelength", "wavelength-quadratic", "wavenumber", "wavenumber-quadratic"],
        typer.Option(help="Polynomial inside the logarithm: straight or quadratic in wavelength or wavenumber."),
    ] = "wavelength-quadratic",
    model_error: Annotated[
        float, typer.Option(help="Share of ln R the model cannot explain, added to the noise; above 0, below 1.")
    ] = 0.02,
    starts: Annotated[int, typer.Option(min=1, max=100, help="Starting points; the lowest minimum is reported.")] = 24,
    wavelength_unit: WavelengthUnit = None,
    reflectance_unit: ReflectanceUnit = None,
) -> Report:
    """Modified Gaussian Model: absorption bands of olivine, ortho- and clinopyroxene, with errors and NBSR."""
    from lunarsci.spectra.mgm.assemblages import assemblage as named_assemblage
    from lunarsci.spectra.mgm.fit import fit_spectra

    from .spectra_report import fit_report, read_batch

    chosen = named_assemblage(assemblage)
    batch = read_batch(files, wavelength_unit, reflectance_unit)
    with progress("fitting", quiet=output.quiet) as update:
        fits = fit_spectra(
            batch.spectra, chosen, continuum=continuum, model_error=model_error, starts=starts, progress=update
        )
    return fit_report(batch, fits)
