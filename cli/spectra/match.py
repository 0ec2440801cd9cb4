"""`lunarsci spectra match`: the crater a rock came from."""

from collections.abc import Mapping, Sequence
from typing import Annotated

import typer

from lunarsci.spectra.jobs.match import Matches, MatchRequest
from lunarsci.spectra.origin.match import OTHER, CraterMatch, RockMatch

from ..shared.command import command
from ..shared.options import SPREAD, Output, option
from ..shared.progress import progress
from ..shared.report import Report
from ..shared.table import SHOWN, TextTable

ROCK, CRATERS, PRIOR, EXPOSURE = "Rock", "Craters", "Prior", "Survival and re-excavation"

Rocks = Annotated[
    list[str] | None,
    typer.Argument(
        help="JSON results of `lunarsci spectra unmix` (shares of minerals), `spectra fit` (NBSR at 2 µm, if any) and "
        " `spectra bands` (band centres, which none of the embedded craters has); the same id in two is one rock; - "
        "is stdin. None with --modes or --bands.",
        metavar="[ROCK]...",
    ),
]
OPTIONS = {
    "modes": option(
        "Modes of a rock without a file: olivine, orthopyroxene, clinopyroxene, plagioclase (or ol, opx, cpx, "
        "plg); two or more, compared as shares of those given.",
        panel=ROCK,
        metavar="MINERAL=FRACTION:ERROR,…",
    ),
    "bands": option("Its band centres, bc1000 and bc2000, in nm.", panel=ROCK, metavar="bc1000=NM:ERROR,…"),
    "kind": option(
        "Kind of target of --modes; errors are raised to those known for this kind. Left out: errors as given.",
        panel=ROCK,
    ),
    "name": option("Name of that rock.", panel=ROCK),
    "site": option(
        "Where the rock was found, in degrees, east positive. Left out: Chang'E-4, -45.44,177.56; --craters need it.",
        panel=ROCK,
        kind=str | None,
        metavar="LAT,LON",
    ),
    "use": option("Which kind of composition is compared, where a crater has it.", panel=ROCK),
    "systematic": option("What two methods disagree by in the share of a mineral, one standard deviation.", panel=ROCK),
    "band_systematic": option("The same for band centres, in nm.", panel=ROCK),
    "craters": option(
        "Candidates as CSV: name, latitude_deg, longitude_deg, diameter_km; also age_low_ma, age_high_ma, "
        "olivine, olivine_sigma, …, bc1000_nm, bc1000_sigma_nm, …, source. Left out: the craters around Chang'E-4.",
        panel=CRATERS,
        kind=str | None,
        metavar="FILE",
    ),
    "mineral_map": option(
        "GeoTIFF of a mineral's mode: its values in the ring of ejecta replace a crater's modes. May be repeated. Or a "
        "file of `spectra map --products unmix`.",
        panel=CRATERS,
        metavar="MINERAL=FILE.tif|MAP",
    ),
    "annulus": option("That ring, in rim radii.", panel=CRATERS, metavar="IN:OUT"),
    "prior": option(
        "Prior of the craters. ejecta: by what each left at the site; uniform: all alike.",
        "--crater-prior",
        panel=PRIOR,
    ),
    "ejecta_law": option("Law of the ejecta's thickness, from the transient crater.", panel=PRIOR),
    "thickness_factor": option(
        "Spread of the thickness about the law, one standard deviation, as a factor; 1 for none.", panel=PRIOR
    ),
    "surface_age": option(
        "Age of the site's surface in Ma: ejecta of older craters lie below it. Left out: 3600 at Chang'E-4, none "
        "elsewhere.",
        panel=PRIOR,
    ),
    "other": option("Prior probability that the rock is from none of the craters.", panel=PRIOR),
    "exposure": option("Rocks are destroyed at the surface.", "--exposure/--no-exposure", panel=EXPOSURE),
    "rock_life": option("Median life of a 2 m boulder, in Ma.", panel=EXPOSURE, metavar="LOW:HIGH"),
    "rock_size": option("Size of the rock, in m.", panel=EXPOSURE),
    "life_exponent": option("Its life goes with this power of its size; assumed.", panel=EXPOSURE),
    "re_excavation": option(
        "Buried ejecta are brought up again.", "--re-excavation/--no-re-excavation", panel=EXPOSURE
    ),
    "stirring": option("Factor on the local ground that falling ejecta stir up (Oberbeck).", panel=EXPOSURE),
    "gardening": option(
        "Buried rock that small local craters keep at the surface, as a thickness in m; assumed.",
        panel=EXPOSURE,
        metavar="LOW:HIGH",
    ),
    "seed": option("Seed of the draws for the prior.", panel=PRIOR, min=0),
}


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "match", batch=True, request=MatchRequest, options=OPTIONS, blocks=SPREAD)(match)


def match(request: MatchRequest, output: Output, rocks: Rocks = None) -> Report:
    """The crater a rock came from: composition (ln Bayes factor), prior and posterior, each apart.

    ln Bayes factors compare with a rock of any composition; a crater of unknown composition has 0.
    """
    from lunarsci.spectra.jobs.match import match

    with progress("matching", quiet=output.quiet) as update:
        result = match(rocks or (), request, progress=update)
    return Report.of(result, lambda: result_tables(result))


def result_tables(result: Matches) -> list[TextTable]:

    matches, notes = result.matches, [f"- {text}" for text in result.assumptions]
    if len(matches) == 1:
        told = (
            "ln BF: composition alone, against a rock of any composition; main route to the surface: the impact itself "
            "(direct), the fall of younger ejecta (stirred) or small local craters (gardened), with its share; assumed "
            "or known:"
        )
        return [_craters_table(matches[0], [matches[0].status, *matches[0].rock.remarks, told, *notes])]
    shown = matches[:SHOWN]
    rows = [[m.rock.id, m.remaining[0], f"{_best(m):.2f}", f"{m.other_posterior:.2f}", m.status] for m in shown]
    headers = ["rock", "likeliest", "posterior", OTHER, "status"]
    return [
        TextTable(headers, rows, total=len(matches), notes=["all craters: --csv or --json; assumed or known:", *notes])
    ]


def _best(match: RockMatch) -> float:
    return max(match.other_posterior, *(item.posterior for item in match.craters))


def _craters_table(match: RockMatch, notes: Sequence[str]) -> TextTable:

    headers = ["crater", "distance [km]", "azimuth [deg]", "ejecta [m]", "main route", "ln BF", "prior", "posterior"]
    headers.append("compared")
    ordered = sorted(match.craters, key=lambda item: item.posterior, reverse=True)
    rows = [_crater_row(item) for item in ordered]
    other = [OTHER, "-", "-", "-", "-", "0.00", f"{match.other_prior:.3f}", f"{match.other_posterior:.3f}", "-"]
    return TextTable(headers, [*rows, other], title=match.rock.id, notes=notes)


def _crater_row(item: CraterMatch) -> list[str]:
    below = item.prior.above_surface == 0
    basis = "older than the surface, counts nothing" if below else item.evidence.basis
    compared = "contains the site: no ejecta" if item.contains_site else basis
    return [
        item.crater.name,
        f"{item.prior.distance_km:.1f}",
        "-" if item.azimuth_deg is None else f"{item.azimuth_deg:.0f}",
        "-" if item.prior.ejecta_m is None else f"{item.prior.ejecta_m:.3g}",
        _brought_up_by(item.prior.stages),
        f"{item.ln_bayes_factor:.2f}",
        f"{item.prior.probability:.3f}",
        f"{item.posterior:.3f}",
        compared,
    ]


def _brought_up_by(stages: Mapping[str, float]) -> str:
    """The stage that brought most of its rocks to the surface, and its share."""
    if not stages or not sum(stages.values()):
        return "-"
    name = max(stages, key=lambda key: stages[key])
    return f"{name} {100 * stages[name]:.0f} %"
