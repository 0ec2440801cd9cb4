"""Every row of every table, and every number of a rover, a camera or a soil, names its source or is called assumed."""

import ast
import csv
import importlib.util
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "spectra_data"
NO_YEAR = ("Gazetteer of Planetary Nomenclature", "none: assumed", "measured for lunarsci", "spectra of CooperZZX")
"""Citations of things that carry no year."""
SAME_AS = re.compile(r"^as (\w+)")
DRAWN = re.compile(r"figure|charts|animation|pages/relief")
"""Modules whose numbers are sizes and places on paper."""
NUMERICAL = re.compile(r"TOLERANCE|CONVERGED|DAMPING|LEVELS|PROBABILITIES|PERCENTILES|NEGLIGIBLE|NUGGET")
"""Names of numbers that say how exactly an answer is reckoned, or how it is told, not what it is."""
SETTINGS = {
    "they are by definition what they are, or follow from others": (
        "arrays.py: NORMAL_MAD", "parallel/blocks.py: UNITS", "images/rig_files.py: METRES",
        "images/camera.py: AHEAD",
        "compiled/lanes.py: LN_2_HIGH, LN_2_LOW",
        "regolith/inference/mode.py: RISES", "regolith/prior.py: STRANGE, NINETY_FIVE",
        "regolith/prior.py: DECADES", "regolith/inference/posterior.py: DECISIVE",
        "regolith/inference/posterior.py: OTHER_SIGNS",
        "regolith/inference/posterior.py: OTHER_UNITS", "images/rig_files.py: CORNER_PX",
        "spectra/abundance/mixing.py: UNIT_NM", "spectra/abundance/end_members.py: LOWEST_NM, HIGHEST_NM",
        "spectra/mgm/selection.py: COARSE_NM",
        "spectra/chemistry/plane.py: _NM_PER_UNIT", "spectra/abundance/kinds.py: WEATHERED",
        "spectra/abundance/kinds.py: WINDOWS_NM", "spectra/abundance/kinds.py: VISIBLE_BLUE",
        "spectra/abundance/learned.py: STEP_NM", "spectra/abundance/learned.py: LEAST_DEPTH",
        "spectra/abundance/learned.py: SHARES",
        "spectra/abundance/shares.py: NOTHING", "spectra/readers/table.py: MAX_PERCENT",
        "spectra/mgm/forward.py: FWHM_OVER_SIGMA", "spectra/mgm/model.py: NM_PER_UM",
        "spectra/mgm/fit_file.py: NORMAL_95", "spectra/mgm/selection.py: LN_2PI", "spectra/noise.py: SECOND_DIFFERENCE",
        "spectra/origin/match.py: LEAST_INSIDE", "spectra/photometry.py: _LIMITS_DEG",
        "spectra/readers/solar_table.py: _NM", "spectra/readers/solar_table.py: _IRRADIANCE",
        "spectra/readers/table.py: _FACTOR_NM", "spectra/readers/table.py: SCALES",
        "spectra/solar.py: _FWHM_PER_SIGMA", "spectra/vnis/detector.py: _NOISY", "sun.py: _J2000_JD",
        "spectra/band_shape.py: HALF",
        "spectra/band_status.py: WIDTHS_NM", "spectra/mgm/fit_file.py: LEAST_NM",
        "spectra/mgm/multistart.py: SIGNIFICANT",
        "spectra/mgm/result.py: UNDETERMINED", "spectra/photometry.py: _SHORTEST_NM",
        "pages/rock_answers.py: UNIFORM",
        "sun.py: _SECONDS_PER_DAY", "twin/ground/height_errors.py: WINDOW_SIGMA",
        "twin/judgement/energy.py: SECONDS_PER_HOUR", "twin/simulation/prescribed_motion.py: ALIKE",
        "twin/assimilation/segments.py: BIN_M, MOST_BINS",
        "twin/ground/soil_map.py: REACH_M",

        "twin/simulation/contact.py: BEHIND", "twin/plans/path.py: RAMP_COUNTS_S", "twin/plans/path.py: RAMP_S",
        "twin/telemetry/hypotheses.py: REPORTED", "twin/telemetry/states.py: HARDLY", "twin/telemetry/reading.py: SURE",
        "twin/telemetry/checks.py: STOP_COSTS_S", "twin/telemetry/hypotheses.py: MIRRORED",
        "twin/telemetry/smoother.py: MEDIAN_OF_TWO",
        "units.py: DEG", "units.py: SIZES", "twin/assimilation/update.py: SLIP_OF_1"),
    "the source stands in each of the entries": (
        "regolith/states.py: PULL_OVER_LOAD, PULLING", "regolith/states.py: SLIPS",
        "constants.py: MARTIAN_GRAVITY", "spectra/indices.py: INDICES"),
    "places in rows, not numbers of the world": (
        "spectra/bands.py: TRIED, IS_CONIC, IS_HULL, AGAINST, DEEPEST_NM, OTHER_NM, CHOICES",),
    "where something is drawn or told, or how finely": (
        "images/jobs/cameras.py: RANGES_M", "images/jobs/dem.py: RANGES_M", "images/rocks.py: RANGES_M",
        "images/jobs/render.py: TRUTH_STEP_M",
        "regolith/identify.py: CURVES", "spectra/chemistry/bands.py: BELOW_NM",
        "spectra/chemistry/bands.py: X_NM, Y_NM", "spectra/mgm/fit_file.py: PLOT_AXIS",
        "spectra/vnis/calibration.py: _SHADOW, _INVALID", "spectra/vnis/calibration.py: LOOKS",
        "twin/ground/soil_map.py: MARGIN_M, NODES_ABOUT",
        "twin/routes/planner.py: LINE_STEP_M, SHOWN_MARGIN_M", "twin/telemetry/simulated.py: DENSE_M",
        "reproduce/soil.py: SINKAGES_MM", "reproduce/soil.py: TYPICAL_LOOK",
        "twin/comparison/scores.py: REGIONS", "twin/comparison/scores.py: NOMINAL",
        "twin/plans/risk.py: CONFIDENCE", "twin/drives/layouts.py: MARGIN_M, MARGIN_SHARE, NODES"),
    "how long machines are waited for, and how much memory is taken": (
        "parallel/dask_cluster.py: CONNECT_S, LONELY_S, LOOK_S", "twin/simulation/contact.py: MOST_NODES"),
    "steps, starts and ends of a search or a sum, and where floating point runs out: finer ones give the same": (
        "images/rock_network.py: DILATIONS, SEEN_PX, STEP_PX", "images/stones.py: SMALLEST_M",
        "images/matching.py: SMALL_STEP_PX",
        "compiled/lanes.py: DOUBLES_LAYOUT", "compiled/lanes.py: SINGLES_LAYOUT",
        "heights/projections.py: STEP_M", "regolith/inference/mode.py: FIRST_SHARE, ROUNDS, SETTLED",
        "regolith/inference/mode.py: LONGEST", "regolith/inference/prediction.py: STEPS, SHALLOWEST",
        "regolith/inference/problem.py: STEP", "regolith/inference/problem.py: LEAST_SHARE",
        "regolith/inference/totals.py: NEWTON, FIRST_SINKAGE, SHALLOWEST, LEAST_POWER",
        "regolith/inference/totals.py: ROUGH", "regolith/compare.py: DRAWS, SEED, SIXTY_EIGHT",
        "regolith/inference/posterior.py: SHIFTS",
        "regolith/inference/totals.py: STEP", "regolith/traction.py: DEEPEST",
        "regolith/physics_discrepancy.py: GRID, REACH", "spectra/abundance/mixing.py: LEAST, MOST",
        "spectra/abundance/learned.py: GRID_NM", "spectra/abundance/shares.py: FINE",
        "spectra/abundance/estimate.py: GAUGE", "spectra/abundance/estimate.py: LIFTED",
        "spectra/abundance/estimate.py: ORIGIN_UM", "spectra/band_shape.py: SEARCH",
        "spectra/mgm/fit.py: CONTINUUM_QUANTILE", "spectra/mgm/fit.py: FIRST_STRENGTH",
        "spectra/mgm/fit.py: HOP_SIGMAS", "spectra/mgm/fit.py: START_SIGMAS", "spectra/mgm/laplace.py: TAIL",
        "spectra/mgm/levenberg_marquardt.py: BELIEF",
        "spectra/mgm/multistart.py: COARSE_DOUBT", "spectra/mgm/multistart.py: SAME_BASIN",
        "spectra/mgm/intervals.py: COARSE_UM", "spectra/mgm/intervals.py: CONTINUUM_SPREAD",
        "spectra/mgm/intervals.py: CLOSE", "spectra/mgm/intervals.py: NARROW", "spectra/mgm/fit_file.py: NARROWEST_UM",
        "spectra/mgm/region.py: NEARLY, FINALLY", "spectra/mgm/region.py: SLACK",
        "spectra/mgm/intervals.py: AT_A_STEP, SETTLING", "spectra/mgm/intervals.py: FIRST_STEP, LEAST_STEP, MOST_STEP",
        "spectra/mgm/intervals.py: PARTED", "spectra/mgm/intervals.py: SHORTEST, LONGEST",
        "spectra/mgm/intervals.py: WANTED_ACCEPTANCE, TUNING", "spectra/origin/composition.py: SMALLEST_SIGMA",
        "spectra/solar.py: _HALF_WIDTH_FWHM", "tempering.py: EFFECTIVE_LEFT",
        "twin/assimilation/posterior.py: PROPOSALS",


        "twin/assimilation/posterior.py: LONGEST", "twin/assimilation/posterior.py: SPARE, MOST_SHARED",
        "twin/assimilation/posterior.py: GOOD", "twin/assimilation/posterior.py: FREEDOM",
        "twin/assimilation/posterior.py: DIFFERENT", "twin/assimilation/posterior.py: SHALLOW_M",
        "twin/assimilation/posterior.py: WIDTH", "twin/assimilation/residuals.py: STEP_S, SAMPLE_M",
        "twin/assimilation/segments.py: FINER",
        "twin/ground/height_errors.py: RATIO, MOST_GRAINS", "twin/jobs/chosen_drive.py: CHECKED_EVERY_M",
        "twin/jobs/plan.py: LOOKED_AT_M", "twin/judgement/endpoint.py: SHORTEST_STEP_S",
        "twin/judgement/energy.py: FINEST_S", "twin/plans/path.py: CREEP_M_S", "twin/plans/path.py: TURN_DEG",
        "twin/routes/arc_search.py: PENALTY", "twin/routes/planner.py: PATH_STEP_M",


        "twin/simulation/contact.py: CAUGHT", "twin/simulation/settle.py: CALM",
        "twin/simulation/settle.py: LONGEST_MOVE", "twin/telemetry/nodes.py: NODE_M"),
}  # fmt: skip
"""Further constants that need no source, by why not; a name that is no longer needed here fails, too."""


def _load() -> ModuleType:
    path = ROOT / "docs/_extension/pages_of_sources.py"
    spec = importlib.util.spec_from_file_location("pages_of_sources", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


PAGES = _load()


def _works() -> dict[str, dict[str, Any]]:
    return tomllib.loads((FOLDER / "references.toml").read_text("utf-8"))


def lacking(source: str, *, assumed: bool = False) -> str:
    """What a source lacks: an author with a year, a DOI, or the word that it is assumed or measured; '' if nothing."""
    if not source.strip():
        return "there is no source"
    if assumed or PAGES.STATED.search(source) or SAME_AS.match(source) or source.startswith(NO_YEAR):
        return ""
    return f"'{source}' has no year, no DOI, and is not called assumed or measured"


@pytest.mark.parametrize(("source", "good"), [
    ("Wong (2008), Theory of Ground Vehicles", True), ("10.1016/j.asr.2008.07.006", True), ("width assumed", True),
    ("", False), ("a colleague", False), ("see there", False),
])  # fmt: skip
def test_what_counts_as_a_source(source: str, good: bool) -> None:
    assert (lacking(source) == "") is good


@pytest.mark.parametrize("kind", ["of_rovers", "of_soils", "of_published"])
def test_every_number_has_a_source(kind: str) -> None:
    stated = list(getattr(PAGES, kind)())
    assert len(stated) > 40 or kind == "of_published"
    wrong = [(row.file, row.name, why) for row in stated if (why := lacking(row.source, assumed=row.assumed))]
    assert wrong == []


def test_every_published_number_has_its_place_in_the_paper() -> None:
    with (ROOT / "lunarsci/reproduce/published.csv").open(newline="", encoding="utf-8") as file:
        places = [row["passage"] for row in csv.DictReader(file)]
    assert len(places) == 41
    assert [place for place in places if not re.match(r"Results|Discussion|Methods", place)] == []


NO_DOI = {"clinopyroxene-trend", "finsen-age"}
"""Works whose DOI no record that was seen has; their citations say so."""


def test_every_source_of_a_table_is_whole() -> None:
    entries = PAGES.of_tables()
    assert {name for name, entry in entries.items() if "DOI not found" in entry["citation"]} == NO_DOI
    for name, entry in entries.items():
        assert lacking(f"{entry['citation']} {entry.get('doi', '')}") == "", name
        known = name in NO_DOI or "doi" in entry or "url" in entry
        assert known or "assumed" in entry["what"].lower() or not re.search(
            r"(?:199\d|20\d\d)\), (?!Mineralogy of asteroids)", entry["citation"]), f"{name}: give the DOI"  # fmt: skip
        assert re.fullmatch(r"10\.\d{4,9}/\S+", entry.get("doi", "10.1000/x")), name


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.csv")), ids=lambda path: path.name)
def test_every_row_of_a_table_leads_to_a_source(path: Path) -> None:
    """By its column of sources, or all rows by the one source of the table."""
    entries = PAGES.of_tables()
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    columns = [name for name in rows[0] if name == "source" or name.endswith("_source")]
    own = {name for name, entry in entries.items() if entry["table"] == path.name}
    assert own
    for row in rows if own >= {row[name] for row in rows for name in columns if row[name]} else []:
        values = {name: row[name] for name in columns}
        assert not columns or values.get("source", "x"), row
        for place in ("position", "age"):
            assert row.get(f"{place}_source", "x"), row
        given = any(row.get(mineral) for mineral in ("olivine", "orthopyroxene", "bc1000_nm"))
        assert not given or row.get("composition_source", "x"), row
    used = {row[name] for row in rows for name in columns if row[name]}
    assert used <= own or path.name == "end_members.csv", used - own
    if path.name == "end_members.csv":
        assert used == {"relab", "usgs", "c-tape"} & used and len(own) == 1


def test_the_page_shows_every_source() -> None:
    page = PAGES.sources_text()
    for entry in PAGES.of_tables().values():
        assert entry["table"] in page
        assert entry.get("doi", "") in page
    for row in PAGES.of_soils():
        assert row.name in page
    recalled = [str(one["recalled"]) for one in _works().values() if "recalled" in one]
    assert recalled and page.count("(recalled: ") == len(recalled)
    assert [text for text in recalled if "doi" in text.lower()] == []


def a_setting(row: Any) -> bool:
    """Whether it is drawn with, reckoned with, or a power of ten so small or large that it stands for rounding."""
    name, _, value = row.name.partition(" = ")
    numbers = [abs(one.value) for one in ast.walk(ast.parse(value)) if isinstance(one, ast.Constant) and isinstance(
        one.value, int | float) and one.value]  # fmt: skip
    rounding = all(f"{one:e}".startswith("1.000000e") and not 2e-5 < one < 5e5 for one in numbers)
    return bool(DRAWN.search(row.file) or NUMERICAL.search(name) or (numbers and rounding))


def without_source(rows: Iterable[Any]) -> set[str]:
    """Constants that neither say where they come from nor name another one that does."""
    rows = list(rows)
    cited = {name for row in rows if PAGES.CITED.search(row.source) for name in row.name.split(" = ")[0].split(", ")}
    refer = {row: PAGES.REFERS.findall(row.source) for row in rows}
    return {f"{row.file.removeprefix('lunarsci/')}: {row.name.split(' = ')[0]}" for row in rows
            if not (PAGES.CITED.search(row.source) or cited & {*refer[row]} or a_setting(row))}  # fmt: skip


def test_every_constant_has_a_source_or_is_a_setting() -> None:
    """Give the source below the constant, or 'assumed' and why; what moves no answer is one of `SETTINGS`.

    Benchmarks that are named exist.
    """
    rows = list(PAGES.of_constants())
    assert without_source(rows) == {name for names in SETTINGS.values() for name in names}
    named = {path for row in rows for path in re.findall(r"tests/[\w/]+\.py", row.source)}
    assert len(named) > 3
    assert [path for path in sorted(named) if not (ROOT / path).is_file()] == []


@pytest.mark.parametrize(("text", "refused"), [
    ("DENSITY = 1500.0", True), ("WIDTH_M = 2", True), ("COUNT = 2", False), ("SOLVER_TOLERANCE = 1e-3", False),
    ("ROUNDING = 1e-9", False), ("SPEED = 3e8", True), ("LIGHT = 2.99792458e-8", True), ("PAIR, OTHER = 2.0, 3", True),
    ('DENSITY = 1500.0\n"""Of regolith. [kg/m3]"""', True), ('DENSITY = 1500.0\n"""Of regolith, in 1991."""', True),
    ('DENSITY = 1500.0\n"""Lunar Sourcebook (1991), ch. 9."""', False), ("DENSITY = 1500.0  # assumed", False),
    ('DENSITY = 1500.0\n"""From measured states, 900 to 2400 nm."""', True),
    ('DENSITY = 1500.0\n"""As `OTHER`."""', True), ('A = 1.0\n"""Assumed."""\nB = 2.0\n"""As `A`."""', False),
    ("# Assumed.\nA = 1.5\nB = 2.5", False), ('A = 1.5\n"""Assumed."""\nB = 2.5', True),
])  # fmt: skip
def test_a_planted_constant_is_refused(tmp_path: Path, text: str, refused: bool) -> None:
    (tmp_path / "module.py").write_text(text, encoding="utf-8")
    assert bool(without_source(PAGES.of_constants(tmp_path))) is refused


SOILS = ("soils.toml", "priors.toml", "reference_soils.csv", "lateral_soils.csv")


def test_every_doi_of_a_table_is_that_of_a_work_which_is_cited_for_it() -> None:
    """Else `lunarsci cite` leaves out what a result rests on."""
    tables = tomllib.loads((FOLDER / "sources.toml").read_text("utf-8")).values()
    works = _works().values()
    cited = {(str(work.get("doi", "")).lower(), table) for work in works for table in work.get("tables", ())}
    stated = {(one["doi"].lower(), one["table"]) for one in tables if "doi" in one}
    assert stated - cited == set()
    assert {one["table"] for one in tables} <= {table for _, table in cited}
    known = {str(work["doi"]) for work in works if "doi" in work}
    soils = [ROOT / "lunarsci/regolith" / name for name in SOILS]
    named = {(doi.lower(), path.name) for path in soils for doi in known if doi in path.read_text("utf-8")}
    assert {table for _, table in named} == {*SOILS} and named - cited == set()
