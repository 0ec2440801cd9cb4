"""`lunarsci spectra`: what the rock is made of."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from .command import command
from .options import Output
from .progress import progress
from .report import Report

__all__ = ["Files", "ReflectanceUnit", "WavelengthUnit", "app"]

app = typer.Typer(
    no_args_is_help=True, help="What the rock is made of: absorption bands and minerals from reflectance spectra."
)

Files = Annotated[
    list[str],
    typer.Argument(
        help="Spectra: ECSV, CSV or text (first column wavelength, then one or many spectra), RELAB .tab/.asc, FITS "
        "table, ENVI library (.sli, .hdr), USGS splib07 text, VNIS products (.2BL, .2B); several files, folders or "
        "patterns; - is stdin."
    ),
]
WavelengthUnit = Annotated[
    Literal["nm", "um"] | None,
    typer.Option("--wavelength-unit", help="State the unit of the wavelengths where the file does not."),
]
ReflectanceUnit = Annotated[
    Literal["fraction", "percent"] | None, typer.Option("--reflectance-unit", help="State the unit of the reflectance.")
]


Products = Annotated[
    list[str],
    typer.Argument(
        help="Labels (.2BL) or data files (.2B) of Chang'E-4 VNIS level 2B, or folders of them; the other files of an "
        "observation are found beside it by their sequence number."
    ),
]


@command(app, "calibrate")
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

    from .vnis_report import calibrate_report, check_fits, observations, settings_from

    settings = settings_from(solar, photometry, phase, shadow, vnir_steps, calibration, radiance_per)
    paths, failures = observations(files)
    check_fits(output.path, len(paths))
    with progress("calibrating", quiet=output.quiet) as update:
        results = calibrate_files(paths, settings, update)
    return calibrate_report([*failures, *results], settings)


@command(app, "simulate", folder=True)
def simulate(
    soil: Annotated[
        str, typer.Option(metavar="MINERALS", help="Fractions of ol, opx, cpx, plg that add up to 1.")
    ] = "ol=0.05,opx=0.20,cpx=0.20,plg=0.55",
    rock: Annotated[
        str | None, typer.Option(metavar="MINERALS", help="The same for a rock in the image; none if left out.")
    ] = None,
    rock_radius: Annotated[float, typer.Option(help="Radius of the rock in px; the SWIR detector sees 53.8.")] = 54.0,
    shadow: Annotated[float, typer.Option(help="Share of the image in shadow, 0 to below 1.")] = 0.0,
    incidence: Annotated[float, typer.Option(help="Angle of the Sun from the normal in deg.")] = 64.412,
    emission: Annotated[float, typer.Option(help="Angle of the view from the normal in deg.")] = 45.557,
    phase_angle: Annotated[float, typer.Option(help="Angle between Sun and view in deg.")] = 54.505,
    photometry: Annotated[
        Literal["lommel-seeliger", "akimov", "mcewen", "none"],
        typer.Option(help="Disk function that the ground obeys; none for the same reflectance at all angles."),
    ] = "akimov",
    phase: Annotated[
        Literal["sp-low", "sp-mid", "sp-high", "flat"], typer.Option(help="Phase function that the ground obeys.")
    ] = "sp-high",
    noise: Annotated[float, typer.Option(help="Factor on the instrument's noise; 0 for none.")] = 1.0,
    time: Annotated[str, typer.Option(help="UTC time of the short-wave scan, ISO 8601.")] = "2020-07-16T08:20:00",
    sequence: Annotated[int, typer.Option(min=1, max=9999, help="Number of the observation.")] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Seed of texture, shadows and noise.")] = 0,
) -> Report:
    """Synthetic VNIS products of a made-up scene: image cube, table, labels, and the truth.

    -o DIR writes them; every name and label says SYNTHETIC.
    """
    from lunarsci.spectra.photometry import Geometry
    from lunarsci.spectra.vnis.simulation.instrument import Instrument
    from lunarsci.spectra.vnis.simulation.instrument import simulate as simulated
    from lunarsci.spectra.vnis.simulation.scene import ROCK, SOIL, Scene, SceneRock

    from .simulate_report import composition, moment, simulate_report

    scene = Scene(
        soil=replace(SOIL, composition=composition(soil)),
        rock=SceneRock(replace(ROCK, composition=composition(rock)), radius_px=rock_radius) if rock else None,
        shadow_fraction=shadow,
        geometry=Geometry(incidence, emission, phase_angle),
        disk=None if photometry == "none" else photometry,
        phase=phase,
        time=moment(time),
        sequence=sequence,
    )
    return simulate_report(simulated(scene, Instrument(noise=noise), seed))


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

    from .bands_report import bands_report
    from .spectra_report import read_batch

    output.check_extra("--plane", plane)
    batch = read_batch(files, wavelength_unit, reflectance_unit)
    with progress("measuring bands", quiet=output.quiet) as update:
        measured = measure_batch(
            batch.spectra, continuum_name=continuum, smooth_points=smooth, smooth_order=smooth_order, progress=update
        )
    return bands_report(batch, measured, plane)
