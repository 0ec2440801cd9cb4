"""The crater a rock came from: what can be asked, and what composition and prior say of each candidate."""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lunarsci.constants import PAPER
from lunarsci.errors import BatchError, DataError, Failure, LunarSciError, RequestError, warn
from lunarsci.io.inputs import InputFile, expand_inputs, read_input
from lunarsci.io.records import Records, RecordsInBlocks, in_blocks
from lunarsci.io.tables import table_hashes
from lunarsci.minerals import WORDS
from lunarsci.names import some_of
from lunarsci.options import request_of
from lunarsci.result import NOT_TO_BE_TRUSTED, Doubt, MadeFrom, Progress, Result, job
from lunarsci.spectra.jobs.requests import MatchRequest
from lunarsci.spectra.jobs.unmix import unmix
from lunarsci.spectra.origin.catalogue import (
    TABLE,
    Crater,
    Point,
    checked_point,
    distance_km,
    embedded_catalogue,
    read_catalogue,
)
from lunarsci.spectra.origin.composition import (
    ERRORS,
    Rock,
    joined,
    read_rocks,
    stated_composition,
    stated_numbers,
)
from lunarsci.spectra.origin.match import (
    MatchSettings,
    RockMatch,
    RockMatches,
    assumptions,
    match_records,
    match_rocks,
    match_table,
)
from lunarsci.spectra.origin.mineral_map import MapReport, minerals_of, with_maps
from lunarsci.spectra.origin.prior import CHANG_E_4, LAW_SOURCES, SURVIVAL_SOURCE, PriorSettings, Range
from lunarsci.spectra.readers.batch import places_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


EMBEDDED_KM = 1000.0
"""The embedded craters lie within 739 km of Chang'E-4 (Antoniadi); for sites farther off than this, assumed, they are
not asked."""
STIRRING = "Oberbeck et al. (1975), Moon 12, 19, 10.1007/BF00577878 (coefficients from later literature, not checked)"
NAMED = 4
"""Rocks without a decided crater that are named."""
BLOCK_ROCKS = 1024
"""Rocks whose craters are put down at once: some 20 MB."""


def settings_of(request: MatchRequest) -> MatchSettings:
    """As the formulas take them. Raises ParameterError for a value out of range, RequestError for a text."""
    return MatchSettings(
        systematic=request.systematic,
        band_systematic_nm=request.band_systematic,
        use_modes=request.use != "bands",
        use_bands=request.use != "modes",
        prior=PriorSettings(
            kind=request.prior,
            law=request.ejecta_law,
            thickness_factor=request.thickness_factor,
            exposure=request.exposure,
            rock_life_ma=_span(request.rock_life, "rock_life"),
            rock_size_m=request.rock_size,
            life_exponent=request.life_exponent,
            re_excavation=request.re_excavation,
            stirring=request.stirring,
            gardening_m=_span(request.gardening, "gardening"),
            surface_age_ma=request.surface_age,
            other_weight=request.other,
            seed=request.seed,
        ),
    )


@dataclass(frozen=True, slots=True)
class Matches(Result):
    """Every rock with every crater, and what was assumed; `inputs` and `tables` are hashes by name."""

    matches: RockMatches
    site: Point
    site_assumed: bool
    settings: MatchSettings
    assumptions: Sequence[str]
    maps: Sequence[MapReport]
    inputs: Mapping[str, str]
    tables: Mapping[str, str]
    unread: Sequence[Failure]
    schema = "spectra-match/1"

    @property
    def made_from(self) -> MadeFrom:
        prior = self.settings.prior
        survival = [SURVIVAL_SOURCE] if prior.exposure else []
        stirring = [STIRRING] if prior.re_excavation else []
        sources = [PAPER, LAW_SOURCES[prior.law], *survival, *stirring]
        return MadeFrom(inputs=self.inputs, tables=self.tables, sources=sources, seed=prior.seed)

    @property
    def failures(self) -> Sequence[Failure]:
        return self.unread

    @property
    def doubt(self) -> Doubt:
        pairs = zip(self.matches.rocks, self.matches.decided.tolist(), strict=True)
        left = [rock.id for rock, decided in pairs if not decided]
        undecided = f"the crater is not decided for {some_of(left, NAMED)}" if left else ""
        return Doubt.of(undecided, verdict=NOT_TO_BE_TRUSTED)

    def content(self) -> dict[str, Any]:
        return {
            "site": {
                "latitude_deg": self.site[0],
                "longitude_deg": self.site[1],
                "assumed": self.site_assumed,
            },
            "rocks": in_blocks(len(self.matches), self._of_some(match_records), rows=BLOCK_ROCKS),
            "assumptions": self.assumptions,
            "maps": [
                {"crater": item.crater, "covered": dict(item.covered), "status": item.status} for item in self.maps
            ],
        }

    def rows(self) -> Records | RecordsInBlocks:
        """One a crater, and one for other sources, of each rock."""
        count, each = len(self.matches), len(self.matches[0].craters) + 1
        return in_blocks(count, self._of_some(match_table), size=count * each, rows=BLOCK_ROCKS)

    def rows_each(self) -> Sequence[Mapping[str, Any]]:
        """One a rock: its likeliest source, which is the `best` where that is decided, and what remains."""
        return [
            {
                "rock": one.rock.id,
                "best": one.best,
                "likeliest": one.remaining[0],
                "posterior": max(one.other_posterior, *(crater.posterior for crater in one.craters)),
                "status": one.status,
            }
            for one in self.matches
        ]

    def answers(self) -> Sequence[Mapping[str, Any]]:
        """The same, of each rock the likeliest first."""
        places = {match.rock.id: place for place, match in enumerate(self.matches)}
        return sorted(self.rows(), key=lambda row: (places[row["rock"]], -row["posterior"]))

    def _of_some(self, make: Callable[[Sequence[RockMatch]], Records]) -> Callable[[range], Records]:
        return lambda block: make(self.matches[block.start : block.stop])

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.spectra.origin.figure import match_pages

        return match_pages(self.matches, self.site)


@job
def match(
    rocks: Any = (), request: MatchRequest | None = None, *, progress: Progress | None = None, **options: Any
) -> Matches:
    """Match rocks with candidate craters.

    `rocks` are results of `unmix`, `fit` and `bands`, one or many: files of their JSON, patterns, open files, or the
    results themselves; the same id in two is one rock. Spectra are unmixed first, as by `unmix`. None with `modes` or
    `bands`, which describe one.

    Raises DataError when no rock can be read, ParameterError where no crater can have delivered one.

    Examples
    --------
    >>> craters = lunarsci.match(modes="ol=0.25:0.05,opx=0.35:0.05,cpx=0.4:0.05").to_table()
    """
    asked = request_of(MatchRequest, request, options)
    settings, stated = settings_of(asked), None if asked.site is None else _site(asked.site)
    if asked.craters is None:
        _check_near(asked.site, stated)
    given = _rocks(list(rocks) if isinstance(rocks, list | tuple) else [rocks], asked)
    result = _candidates(asked)
    site = stated or _assumed_site(asked, result)
    matches = match_rocks(given.rocks, result.craters, site, settings, progress)
    return Matches(
        matches,
        site,
        stated is None,
        settings,
        assumptions(matches, (result.source, result.map_reports), (site, stated is None), settings),
        result.map_reports,
        given.inputs | result.inputs,
        result.tables | table_hashes(*(table for rock in given.rocks for table in rock.tables)),
        given.failures,
    )


def _check_near(text: str | tuple[float, ...] | None, site: Point | None) -> None:
    """Raises RequestError for a site that the embedded craters do not lie round."""
    if site is not None and (far := distance_km(CHANG_E_4, site)) > EMBEDDED_KM:
        raise RequestError(
            f"`site` {text} is {far:.0f} km from Chang'E-4, round which the embedded craters lie; give the "
            "craters round yours as `craters` (`lunarsci template craters`)"
        )


def _assumed_site(asked: MatchRequest, result: "Candidates") -> Point:
    """Chang'E-4's, round which the embedded craters lie. Raises RequestError for craters of one's own."""
    if asked.craters is None:
        return CHANG_E_4
    near = min(result.craters, key=lambda crater: distance_km(CHANG_E_4, crater.center))
    raise RequestError(
        f"`craters` {result.source} are your own, and nothing says where the rocks were found; give LAT,LON as `site`, "
        f"of Chang'E-4 {CHANG_E_4[0]:g},{CHANG_E_4[1]:g} (nearest to it is {near.name}, {near.latitude_deg:g},"
        f"{near.longitude_deg:g}, {distance_km(CHANG_E_4, near.center):.0f} km)"
    )


@dataclass(frozen=True, slots=True)
class MatchInputs:
    """The rocks, hashes of the inputs by name, and what could not be read."""

    rocks: list[Rock]
    inputs: dict[str, str] = field(default_factory=dict)
    failures: list[Failure] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Candidates:
    """The craters, the name of their catalogue, hashes of what they were read from, by name, and what maps gave."""

    craters: Sequence[Crater]
    source: str
    inputs: dict[str, str] = field(default_factory=dict)
    tables: dict[str, str] = field(default_factory=dict)
    map_reports: Sequence[MapReport] = ()


def _site(site: str | tuple[float, ...]) -> Point:
    """Two numbers, or the text `LAT,LON`, in degrees."""
    text = site if isinstance(site, str) else ",".join(map(str, site))
    return stated_numbers("site", text, "LAT,LON, such as -45.44,177.56,", checked_point)


def _span(text: str, option: str) -> Range:
    """`LOW:HIGH`, or one number for both."""
    return stated_numbers(option, text, "LOW:HIGH", lambda *ends: Range(ends[0], ends[-1]), (1, 2))


def _rocks(sources: Sequence[Any], asked: MatchRequest) -> MatchInputs:
    """The rocks of results of `spectra fit` or `spectra unmix`, or the one that the request states.

    Raises RequestError for both or neither, DataError when no result can be read.
    """
    stated = asked.modes is not None or asked.bands is not None
    if stated == bool(sources):
        raise RequestError("give results of `spectra unmix` or `fit`, or `modes` or `bands` of one rock, not both")
    if asked.kind and asked.bands and asked.modes is None:
        raise RequestError("`kind` is of `modes`, or of files of spectra; centres of bands have none")
    if stated:
        tables = (ERRORS,) if asked.kind else ()
        return MatchInputs([Rock(asked.name, *stated_composition(asked.modes, asked.bands, asked.kind), tables)])
    return _read(sources, asked)


def _read(sources: Sequence[Any], asked: MatchRequest) -> MatchInputs:
    rocks: list[Rock] = []
    hashes: dict[str, str] = {}
    failures: list[Failure] = []
    for item in sources:
        try:
            for source in _opened(item):
                hashes[source.name] = source.sha256
                rocks += read_rocks(_shares_of(source, asked))
        except LunarSciError as error:
            name = str(item) if isinstance(item, str | Path) else f"<{type(item).__name__}>"
            failures.append(Failure.of(name, error))
    if not rocks:
        raise BatchError.of(failures)
    rocks = joined(rocks)
    chosen = places_of([rock.id for rock in rocks], asked.id) if asked.id else range(len(rocks))
    return MatchInputs([rocks[k] for k in chosen], hashes, failures)


def _opened(item: Any) -> Iterator[InputFile]:
    if isinstance(item, Mapping) and "schema" not in item:
        raise DataError("is a dict; give the result itself, as in `lunarsci.match(shares)`, or the file of its JSON")
    if isinstance(item, Result):
        yield InputFile(f"<{type(item).__name__}>", item.to_json(time=False).encode())
    else:
        for name in expand_inputs([str(item)]) if isinstance(item, str | Path) else [item]:
            yield read_input(name)


def _shares_of(source: InputFile, asked: MatchRequest) -> InputFile:
    """A result as it is; of spectra the result of `unmix`, of the kind that is stated."""
    if source.data.lstrip()[:1] in (b"{", b"[", b""):
        if asked.kind:
            raise RequestError("`kind` is of spectra; this is a result, whose shares were made for a kind already")
        return source
    shares = unmix(source, kind=asked.kind or "auto")
    how = f" of the kind {asked.kind}" if asked.kind else ", whose kind it weighs by itself"
    warn(f"{source.name}: shares were made by `spectra unmix` of these spectra{how}")
    return InputFile(source.name, shares.to_json(time=False).encode())


def _candidates(asked: MatchRequest) -> Candidates:
    """The embedded craters or those of a table, with modes from maps where these are given."""
    if asked.craters is None:
        result = Candidates(embedded_catalogue(), f"embedded {TABLE}", tables=table_hashes(TABLE))
    else:
        source = read_input(asked.craters)
        result = Candidates(read_catalogue(source), source.name, {source.name: source.sha256})
    return _mapped(result, asked.mineral_map, asked.annulus) if asked.mineral_map else result


def _mapped(result: Candidates, maps: Sequence[str], annulus: str) -> Candidates:
    names: dict[str, str] = {}
    for item in maps:
        if "=" not in item and Path(item).suffix and (written := minerals_of(item)):
            names |= dict.fromkeys(written, item)
            continue
        key, equals, file = item.partition("=")
        mineral = WORDS.get(key.strip().lower(), key.strip().lower())
        if not equals or not file or mineral in names:
            raise RequestError(f"`mineral_map` '{item}': give MINERAL=FILE.tif, each mineral once, or MAP.nc of shares")
        names[mineral] = file
    ring = stated_numbers("annulus", annulus, "IN:OUT (such as 1:2)", lambda *ends: ends)
    craters, reports = with_maps(result.craters, names, ring)
    hashes = {file: _digest(file) for file in names.values()}
    return Candidates(craters, result.source, result.inputs | hashes, result.tables, reports)


def _digest(file: str) -> str:
    """SHA-256 of a map, which may not fit into memory."""
    with Path(file).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
