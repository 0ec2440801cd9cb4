"""`lunarsci spectra fit`: the Modified Gaussian Model."""

from typing import Annotated, Literal

import typer

from ..shared.command import command
from ..shared.options import Output
from ..shared.report import Report
from .options import Files, ReflectanceUnit, WavelengthUnit

__all__ = ["add_to"]

MODEL, LIMITS, ANSWER = "Model", "Constraints", "Errors"

Assemblage = Annotated[
    str,
    typer.Option(
        help="Minerals whose bands are fitted: OL, OPX, CPX, PLG, joined by hyphens; auto compares all and takes "
        "the one with the most evidence (with an error of its own, not --model-error).",
        rich_help_panel=MODEL,
    ),
]
Continuum = Annotated[
    Literal[
        "wavelength",
        "wavelength-quadratic",
        "wavelength-cubic",
        "wavenumber",
        "wavenumber-quadratic",
        "wavenumber-cubic",
        "log-quadratic",
        "none",
    ],
    typer.Option(
        help="Polynomial inside the logarithm, in wavelength or wavenumber; log-quadratic: of the logarithm.",
        rich_help_panel=MODEL,
    ),
]
Composition = Annotated[
    str | None,
    typer.Option(
        metavar="KEY=MEAN:ERROR,…",
        help="What is known of Fo, Fs, Wo in mol %, such as fo=70:5; moves the bands along their trends.",
        rich_help_panel=MODEL,
    ),
]
Start = Annotated[
    str | None,
    typer.Option(
        metavar="FILE.fit",
        help="Bands, continuum and their uncertainties from a start file of the RELAB MGM program, instead of "
        "--assemblage and --continuum.",
        rich_help_panel=MODEL,
    ),
]
Prior = Annotated[
    Literal["map", "damping"],
    typer.Option(
        help="map: priors count as measurements; damping: they only shorten steps, as in the RELAB MGM program.",
        rich_help_panel=MODEL,
    ),
]
ModelError = Annotated[
    float,
    typer.Option(
        help="Share of ln R the model cannot explain, added to the noise; above 0, below 1.", rich_help_panel=MODEL
    ),
]
Starts = Annotated[
    int,
    typer.Option(
        min=1, max=100, help="Starting points, beside a search around the lowest minimum.", rich_help_panel=MODEL
    ),
]
Fix = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME[=VALUE]",
        help="Hold a parameter, such as opx_1_center_nm=915; also …_fwhm_nm, …_strength, and c0, c1, … of the "
        "continuum, whose variable runs from -1 to 1 over 400-2600 nm. May be repeated.",
        rich_help_panel=LIMITS,
    ),
]
Bound = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=LOW:HIGH", help="Keep a parameter within a range. May be repeated.", rich_help_panel=LIMITS
    ),
]
Tie = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=K*OTHER+C", help="Make a parameter follow another. May be repeated.", rich_help_panel=LIMITS
    ),
]
Errors = Annotated[
    Literal["laplace", "profile", "sample"],
    typer.Option(
        help="laplace: from the curvature; profile, sample: 68 and 95 % intervals that need not be symmetric, by "
        "refitting or by drawing from the posterior; seconds per spectrum.",
        rich_help_panel=ANSWER,
    ),
]
ContinuumSpread = Annotated[
    bool,
    typer.Option(
        "--continuum-spread",
        help="Fit under all continua and report the spread of every value as a systematic.",
        rich_help_panel=ANSWER,
    ),
]
AbundanceMethod = Annotated[
    Literal["nbsr", "unmix", "hapke", "absorbance"],
    typer.Option(
        help="Shares of the minerals: nbsr, from the pyroxenes' band strengths; unmix, with end members, by "
        "two mixing laws weighted by their evidence; hapke or absorbance: one of them.",
        rich_help_panel=ANSWER,
    ),
]
Library = Annotated[
    str | None,
    typer.Option(
        metavar="FILE",
        help="End members for --abundance, instead of the embedded ones; see `spectra library`.",
        rich_help_panel=ANSWER,
    ),
]
Together = Annotated[
    bool,
    typer.Option(
        "--together",
        help="Take all spectra as mixtures of the same powders, which --abundance then finds far better than one by "
        "one.",
        rich_help_panel=ANSWER,
    ),
]
Known = Annotated[
    str | None,
    typer.Option(
        metavar="FILE",
        help="Table of id and one column per mineral, in shares of 1, of mixtures whose modes are known; empty cells "
        "are sought, a 0 beside them is absent. Implies --together.",
        rich_help_panel=ANSWER,
    ),
]
Opaque = Annotated[
    bool,
    typer.Option("--opaque", help="Allow --abundance a dark, flat powder beside the minerals.", rich_help_panel=ANSWER),
]
Iron = Annotated[
    bool,
    typer.Option(
        "--iron", help="Allow --abundance submicroscopic iron on all grains: space weathering.", rich_help_panel=ANSWER
    ),
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of --errors sample.", rich_help_panel=ANSWER)]


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "fit")(fit)


def fit(
    files: Files,
    output: Output,
    assemblage: Assemblage = "OL-OPX-CPX",
    continuum: Continuum = "wavelength-quadratic",
    composition: Composition = None,
    start: Start = None,
    prior: Prior = "map",
    model_error: ModelError = 0.02,
    starts: Starts = 4,
    fix: Fix = None,
    bound: Bound = None,
    tie: Tie = None,
    errors: Errors = "laplace",
    continuum_spread: ContinuumSpread = False,
    abundance: AbundanceMethod = "nbsr",
    library: Library = None,
    together: Together = False,
    known: Known = None,
    opaque: Opaque = False,
    iron: Iron = False,
    seed: Seed = 0,
    wavelength_unit: WavelengthUnit = None,
    reflectance_unit: ReflectanceUnit = None,
) -> Report:
    """Modified Gaussian Model: absorption bands of olivine, pyroxenes and plagioclase, with errors and NBSR.

    -o FILE.fit writes a result file of the RELAB MGM program (one spectrum).
    """
    from lunarsci.spectra.readers.batch import read_batch

    from .fit_report import fit_report
    from .fit_run import FitRequest, run_fit

    request = FitRequest(
        assemblage=assemblage,
        continuum=continuum,
        composition=composition,
        start=start,
        prior=prior,
        model_error=model_error,
        starts=starts,
        fixed=fix or (),
        bounds=bound or (),
        ties=tie or (),
        errors=errors,
        continuum_spread=continuum_spread,
        seed=seed,
        abundance=abundance,
        library=library,
        together=together or known is not None,
        known=known,
        opaque=opaque,
        iron=iron,
        to_fit_file=output.path is not None and output.path.suffix.lower() == ".fit",
    )
    request.check()
    batch = read_batch(files, wavelength_unit, reflectance_unit)
    return fit_report(batch, run_fit(batch.spectra, request, output.quiet), request)
