"""The report of `lunarsci spectra match`."""

from collections.abc import Mapping, Sequence
from typing import Any

from lunarsci.spectra.origin.catalogue import Point
from lunarsci.spectra.origin.match import OTHER, CraterMatch, MatchSettings, RockMatch
from lunarsci.spectra.origin.prior import LAW_SOURCES, SURVIVAL_SOURCE, surface_age_ma

from ..shared.report import Report
from ..shared.table import TextTable, counted
from .match_run import Candidates, MatchInputs

__all__ = ["match_report"]

STIRRING = "Oberbeck et al. (1975), Moon 12, 19, 10.1007/BF00577878 (coefficients from later literature, not checked)"
PAPER = "Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8"
BEYOND_LAW_KM = 2729.0


def match_report(
    given: MatchInputs, found: Candidates, matches: Sequence[RockMatch], site: Point, settings: MatchSettings
) -> Report:
    """The report of `spectra match`."""
    assumptions = _assumptions(matches, found, site, settings)

    def figures() -> Any:
        from lunarsci.spectra.origin.figure import match_pages

        return match_pages(matches, site)

    return Report(
        schema="spectra-match/1",
        result={
            "site": {"latitude_deg": site[0], "longitude_deg": site[1]},
            "rocks": [match.to_dict() for match in matches],
            "assumptions": assumptions,
            "maps": [
                {"crater": item.crater, "covered": dict(item.covered), "status": item.status}
                for item in found.map_reports
            ],
        },
        tables=_tables(matches, assumptions),
        rows=[row for match in matches for row in _rows(match)],
        figures=figures,
        inputs=given.inputs | found.inputs,
        data_tables=found.tables,
        sources=_sources(settings),
        seed=settings.prior.seed,
        failures=given.failures,
    )


def _sources(settings: MatchSettings) -> list[str]:
    prior = settings.prior
    ejecta = [LAW_SOURCES[prior.law]]
    return [
        PAPER,
        *ejecta,
        *([SURVIVAL_SOURCE] if prior.exposure else []),
        *([STIRRING] if prior.re_excavation else []),
    ]


def _tables(matches: Sequence[RockMatch], assumptions: Sequence[str]) -> list[TextTable]:
    notes = [f"- {text}" for text in assumptions]
    if len(matches) == 1:
        match = matches[0]
        remarks = [
            *match.rock.remarks,
            "ln BF: composition alone, against a rock of any composition; assumed or known:",
        ]
        return [_craters_table(match, [match.status, *remarks, *notes])]
    rows = [[m.rock.id, m.to_dict()["best"], f"{_best(m):.2f}", f"{m.other_posterior:.2f}", m.status] for m in matches]
    headers = ["rock", "likeliest", "posterior", OTHER, "status"]
    return [TextTable(headers, rows, notes=["all craters: --csv or --json; assumed or known:", *notes])]


def _best(match: RockMatch) -> float:
    return max(match.other_posterior, *(item.posterior for item in match.craters))


def _craters_table(match: RockMatch, notes: Sequence[str]) -> TextTable:
    headers = ["crater", "distance [km]", "azimuth [deg]", "ejecta [m]", "came by", "ln BF", "prior", "posterior"]
    headers.append("compared")
    ordered = sorted(match.craters, key=lambda item: item.posterior, reverse=True)
    rows = [_crater_row(item) for item in ordered]
    other = [OTHER, "-", "-", "-", "-", "0.00", f"{match.other_prior:.3f}", f"{match.other_posterior:.3f}", "-"]
    return TextTable(headers, [*rows, other], title=match.rock.id, notes=notes)


def _crater_row(item: CraterMatch) -> list[str]:
    compared = "contains the site: no ejecta" if item.contains_site else item.evidence.basis
    return [
        item.crater.name,
        f"{item.prior.distance_km:.1f}",
        "-" if item.azimuth_deg is None else f"{item.azimuth_deg:.0f}",
        "-" if item.prior.ejecta_m is None else f"{item.prior.ejecta_m:.3g}",
        _came_by(item.prior.stages),
        f"{item.ln_bayes_factor:.2f}",
        f"{item.prior.probability:.3f}",
        f"{item.posterior:.3f}",
        compared,
    ]


def _came_by(stages: Mapping[str, float]) -> str:
    """The stage that brought most of its rocks to the surface, and its share."""
    if not stages or not sum(stages.values()):
        return "-"
    name = max(stages, key=lambda key: stages[key])
    return f"{name} {100 * stages[name]:.0f} %"


def _rows(match: RockMatch) -> list[dict[str, Any]]:
    """One row per crater and one for other sources."""
    rows = []
    for item in match.craters:
        record = item.to_dict()
        terms, sources = record.pop("terms"), record.pop("sources")
        stages = {f"stage_{name}": share for name, share in terms["stages"].items()}
        flat = {"survival": terms["survival"], "above_surface": terms["above_surface"], **stages}
        rows.append({"rock": match.rock.id, **record, **flat, "sources": "; ".join(sources.values())})
    rest = {"log_bayes_factor": 0.0, "prior": match.other_prior, "posterior": match.other_posterior}
    return [*rows, {"rock": match.rock.id, "name": OTHER, **rest}]


def _assumptions(matches: Sequence[RockMatch], found: Candidates, site: Point, settings: MatchSettings) -> list[str]:
    prior = settings.prior
    lines = [
        f"site {site[0]:g}, {site[1]:g} deg; craters from {found.source}",
        f"two methods disagree by {settings.systematic:g} in the share of a mineral and "
        f"{settings.band_systematic_nm:g} nm in a band centre, one standard deviation (assumed)",
        f"other sources than these craters: prior {prior.other_weight:g}, any composition (assumed)",
        *_craters_notes(matches[0].craters, settings),
    ]
    if prior.kind == "uniform":
        return [*lines, "prior: all craters alike but those that contain the site", *_map_notes(found)]
    return [*lines, *_prior_notes(site, settings, matches[0].craters), *_map_notes(found)]


def _craters_notes(items: Sequence[CraterMatch], settings: MatchSettings) -> list[str]:
    unknown = [i.crater.name for i in items if not i.crater.composition.known and not i.contains_site]
    inside = [i.crater.name for i in items if i.contains_site]
    both = [i.crater.name for i in items if i.evidence.minerals and i.evidence.bands]
    lines = []
    if unknown:
        lines.append(f"composition unknown, any is as likely, ln BF 0 (neither for nor against): {', '.join(unknown)}")
    if inside:
        lines.append(f"contain the site, so that no ejecta of theirs lie there; left out: {', '.join(inside)}")
    if both:
        lines.append(
            "modes and bands are counted as independent, which from one spectrum they are not (--use): "
            f"{', '.join(both)}"
        )
    return lines


def _prior_notes(site: Point, settings: MatchSettings, items: Sequence[CraterMatch]) -> list[str]:
    prior = settings.prior
    surface = surface_age_ma(site, prior)
    lines = [
        f"prior: ejecta thickness ({prior.law}, transient crater), within a factor of {prior.thickness_factor:g}",
        f"ejecta of craters older than {surface:g} Ma lie below the surface and count nothing",
        "ages uniform in the logarithm over their range; where the catalogue has none 1-4200 Ma (assumed)",
    ]
    if prior.exposure:
        lines.append(
            f"half of the 2 m boulders gone in {_span(prior.rock_life_ma)} Ma (Basilevsky et al. 2013); rock of "
            f"{prior.rock_size_m:g} m, life with size^{prior.life_exponent:g} (assumed)"
        )
    else:
        lines.append("rocks last for ever (--no-exposure)")
    if prior.re_excavation:
        lines.append(
            f"buried ejecta come up with younger ejecta ({prior.stirring:g} times Oberbeck's ratio) and by small local "
            f"craters ({_span(prior.gardening_m)} m, assumed: it decides between young and old craters)"
        )
    else:
        lines.append("buried ejecta stay buried (--no-re-excavation)")
    far = [i.crater.name for i in items if i.prior.distance_km > BEYOND_LAW_KM]
    if far:
        lines.append(f"beyond a quarter of the Moon the laws are too low, ejecta converge: {', '.join(far)}")
    return lines


def _span(span: Any) -> str:
    return f"{span.low:g}" if span.low == span.high else f"{span.low:g}-{span.high:g}"


def _map_notes(found: Candidates) -> list[str]:
    reports = found.map_reports
    return counted(sorted(f"{item.crater}: {item.status}" for item in reports), 1, "craters")
