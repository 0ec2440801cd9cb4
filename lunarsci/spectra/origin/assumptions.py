"""What a match of rocks and craters assumes, in sentences."""

from collections import Counter
from collections.abc import Sequence

from lunarsci.spectra.origin.catalogue import Point
from lunarsci.spectra.origin.match import CraterMatch, MatchSettings, RockMatch
from lunarsci.spectra.origin.mineral_map import MapReport
from lunarsci.spectra.origin.prior import Range, surface_age_ma

BEYOND_LAW_KM = 2729.0
"""A quarter of the way round the Moon; the laws of ejecta are those of a flat surface. Assumed."""


def assumptions(
    matches: Sequence[RockMatch],
    given: tuple[str, Sequence[MapReport]],
    found_at: tuple[Point, bool],
    settings: MatchSettings,
) -> list[str]:
    """In sentences; `given` are where the craters are from and what maps gave of them, `found_at` the site of the
    rocks and whether it is that of Chang'E-4 because none was given."""
    (source, maps), (site, site_assumed) = given, found_at
    prior, whose = settings.prior, ", that of Chang'E-4, since none was given (assumed)" if site_assumed else ""
    lines = [
        f"site {site[0]:g}, {site[1]:g} deg{whose}; craters from {source}",
        f"two methods disagree by {settings.systematic:g} in the share of a mineral and "
        f"{settings.band_systematic_nm:g} nm in a band centre, one standard deviation (assumed)",
        f"other sources than these craters: prior {prior.other_weight:g}, any composition (assumed)",
        *_craters_notes(matches[0].craters, settings),
    ]
    if prior.kind == "uniform":
        return [*lines, "prior: all craters alike but those that contain the site", *_map_notes(maps)]
    return [*lines, *_prior_notes(site, settings, matches[0].craters), *_map_notes(maps)]


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
            f"half of the 2 m boulders gone in {_shown(prior.rock_life_ma)} Ma (Basilevsky et al. 2013); rock of "
            f"{prior.rock_size_m:g} m, life with size^{prior.life_exponent:g} (assumed)"
        )
    else:
        lines.append("rocks last for ever (--no-exposure)")
    if prior.re_excavation:
        lines.append(
            f"buried ejecta come up with younger ejecta ({prior.stirring:g} times Oberbeck's ratio) and by small local "
            f"craters ({_shown(prior.gardening_m)} m, assumed: it decides between young and old craters)"
        )
    else:
        lines.append("buried ejecta stay buried (--no-re-excavation)")
    far = [i.crater.name for i in items if i.prior.distance_km > BEYOND_LAW_KM]
    if far:
        lines.append(f"beyond a quarter of the Moon the laws are too low, ejecta converge: {', '.join(far)}")
    return lines


def _shown(span: Range) -> str:
    return f"{span.low:g}" if span.low == span.high else f"{span.low:g}-{span.high:g}"


def _map_notes(reports: Sequence[MapReport]) -> list[str]:
    return list(Counter(sorted(f"{item.crater}: {item.status}" for item in reports)))
