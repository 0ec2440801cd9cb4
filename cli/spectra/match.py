"""`lunarsci spectra match`: the crater a rock came from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from lunarsci.spectra.jobs.requests import MatchRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import SPREAD, Output, option
from ..shared.table import SHOWN, TextTable

if TYPE_CHECKING:
    from lunarsci.spectra.jobs.match import Matches
    from lunarsci.spectra.origin.match import CraterMatch, RockMatch

ROCK, CRATERS, PRIOR, EXPOSURE = "Rock", "Craters", "Prior", "Survival and re-excavation"

Rocks = Annotated[
    list[str] | None,
    typer.Argument(
        help="Spectra, which then get shares as by `lunarsci spectra unmix`; or JSON results of `spectra unmix`, "
        "`spectra fit` (NBSR at 2 µm, if any) and `spectra bands` (band centres, which no embedded crater has). The "
        "same id in two results is one rock. - is stdin. None with --modes or --bands.",
        metavar="[ROCK]...",
    ),
]
OPTIONS = {
    "modes": option(panel=ROCK, metavar="MINERAL=FRACTION:ERROR,…"),
    "bands": option(panel=ROCK, metavar="bc1000=NM:ERROR,…"),
    "kind": option(panel=ROCK),
    "id": option(panel=ROCK, metavar="NAME"),
    "name": option(panel=ROCK),
    "site": option(panel=ROCK, kind=str | None, metavar="LAT,LON"),
    "use": option(panel=ROCK),
    "systematic": option(panel=ROCK),
    "band_systematic": option(panel=ROCK),
    "craters": option(panel=CRATERS, kind=str | None, metavar="FILE"),
    "mineral_map": option(panel=CRATERS, metavar="MINERAL=FILE.tif|MAP"),
    "annulus": option(panel=CRATERS, metavar="IN:OUT"),
    "prior": option("--crater-prior", panel=PRIOR),
    "ejecta_law": option(panel=PRIOR),
    "thickness_factor": option(panel=PRIOR),
    "surface_age": option(panel=PRIOR),
    "other": option(panel=PRIOR),
    "exposure": option("--exposure/--no-exposure", panel=EXPOSURE),
    "rock_life": option(panel=EXPOSURE, metavar="LOW:HIGH"),
    "rock_size": option(panel=EXPOSURE),
    "life_exponent": option(panel=EXPOSURE),
    "re_excavation": option("--re-excavation/--no-re-excavation", panel=EXPOSURE),
    "stirring": option(panel=EXPOSURE),
    "gardening": option(panel=EXPOSURE, metavar="LOW:HIGH"),
    "seed": option(panel=PRIOR, min=0),
}
EXAMPLES = (
    "lunarsci spectra match --modes ol=0.25:0.05,opx=0.35:0.05,cpx=0.4:0.05",
    "lunarsci spectra match shares.json --site=-45.44,177.56",
)


@command("match", EXAMPLES, OPTIONS, batch=True, blocks=SPREAD)
def match(request: MatchRequest, output: Output, rocks: Rocks = None) -> Report:
    """The crater a rock came from: composition (ln Bayes factor), prior and posterior, each apart.

    A ln Bayes factor compares a crater with a rock of any composition. A crater of unknown composition has 0.
    """
    from lunarsci.spectra.jobs.match import match

    result = match(rocks or (), request, progress=output.progress("matching"))
    return Report(result, lambda: result_tables(result))


def result_tables(result: Matches) -> list[TextTable]:
    from lunarsci.spectra.origin.match import OTHER

    matches, notes = result.matches, [f"- {text}" for text in result.assumptions]
    if len(matches) == 1:
        remark = (
            "ln BF: composition alone, against a rock of any composition; main route to the surface: the impact itself "
            "(direct), the fall of younger ejecta (stirred) or small local craters (gardened), with its share; assumed "
            "or known:"
        )
        match = matches[0]
        remarks = [text for text in match.rock.remarks if text not in match.status]
        return [_craters_table(match, [match.status, *remarks, remark, *notes])]
    shown = matches[:SHOWN]
    rows = [[m.rock.id, m.remaining[0], f"{_best(m):.2f}", f"{m.other_posterior:.2f}", m.status] for m in shown]
    headers = ["rock", "likeliest", "posterior", OTHER, "status"]
    return [
        TextTable(headers, rows, total=len(matches), notes=["all craters: --csv or --json; assumed or known:", *notes])
    ]


def _best(match: RockMatch) -> float:
    return max(match.other_posterior, *(item.posterior for item in match.craters))


def _craters_table(match: RockMatch, notes: Sequence[str]) -> TextTable:
    from lunarsci.spectra.origin.match import OTHER

    headers = ["name", "distance [km]", "azimuth [deg]", "ejecta [m]", "main route", "ln BF", "prior", "posterior"]
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
