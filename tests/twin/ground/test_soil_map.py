"""Soil by place: against simple kriging worked by hand, the limits of the blend, and draws."""

import dataclasses
import json

import numpy as np
import numpy.typing as npt
import pytest

from lunarsci.errors import DataError, ParameterError
from lunarsci.io.inputs import InputFile
from lunarsci.regolith.belief import SoilBelief, first_belief
from lunarsci.regolith.prior import PARAMETERS, default_prior, values_of
from lunarsci.regolith.soil import read_soil
from lunarsci.twin.assimilation.segments import planned_places
from lunarsci.twin.figures.maps import soil_pages
from lunarsci.twin.ground.soil_map import SoilMap, Zone, drawn_grounds, read_soil_map, soil_layers, soil_map_bytes
from lunarsci.twin.ground.terrain import SOIL_COLUMNS, Terrain, build_terrain, read_terrain, terrain_bytes
from lunarsci.twin.judgement.endpoint import step_error_m
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import predict

FloatArray = npt.NDArray[np.float64]
FIRST = first_belief()
WIDTH = np.sqrt(np.diag(FIRST.covariance))


def belief(shift: float, share: float, *, population: int = 0) -> SoilBelief:
    """Means `shift` widths of the first laws away, standard deviations `share` of theirs, correlated by 0.5."""
    mean = FIRST.mean + shift * WIDTH
    correlation = 0.5 * np.eye(8) + 0.5
    covariance = share**2 * np.outer(WIDTH, WIDTH) * correlation
    if not population:
        return SoilBelief(FIRST.laws, mean, covariance)
    random = np.random.default_rng(5)
    points = mean + random.standard_normal((population, 8)) @ np.linalg.cholesky(covariance).T
    return SoilBelief(FIRST.laws, points.mean(axis=0), np.cov(points.T), (), points)


def zone(x: float | FloatArray, y: float, known: SoilBelief, name: str = "zone") -> Zone:
    places = np.column_stack([np.atleast_1d(x), np.full(np.size(x), y)])
    return Zone(name=name, place_m=places, belief=known)


def at(*places: tuple[float, float]) -> FloatArray:
    return np.array(places, dtype=float)


def test_one_zone_fades_with_the_kernel() -> None:
    """Simple kriging from one datum: share k, variance (1 - k^2) of the first laws' plus k^2 of the datum's."""
    known = belief(2.0, 0.3)
    soil = SoilMap(correlation_m=4.0, reach_m=0.5, zones=(zone(0.0, 0.0, known),))
    mean, covariance = soil.moments(at((3.5, 0.0), (0.0, -8.5)))
    for row, k in enumerate((np.exp(-3.0 / 4.0), np.exp(-8.0 / 4.0))):
        assert mean[row] == pytest.approx(FIRST.mean + 2.0 * k * WIDTH, rel=1e-7)
        wanted = k**2 * known.covariance + (1 - k**2) * FIRST.covariance
        assert covariance[row] == pytest.approx(wanted, abs=1e-7)


def test_two_zones_are_kriged_as_by_hand() -> None:
    """Two points 3 m apart, a node 1 m and 2 m from them on the line between: exp kernel, L = 2 m.

    On a line the exponential kernel is Markov: weights sinh(b / L) / sinh(c / L) and sinh(a / L) / sinh(c / L) for
    distances a, b with c = a + b, and beyond the end only the nearest counts.
    """
    one, two = belief(1.0, 0.2), belief(-2.0, 0.4)
    soil = SoilMap(correlation_m=2.0, reach_m=0.0, zones=(zone(0.0, 0.0, one), zone(3.0, 0.0, two)))
    blend = soil.blend(at((1.0, 0.0), (4.0, 0.0)))
    near, far = np.sinh(1.0) / np.sinh(1.5), np.sinh(0.5) / np.sinh(1.5)
    assert blend.zone[0].tolist() == [0, 1] and blend.zone[1].tolist() == [1, 0]
    assert blend.share[0] == pytest.approx([near, far], abs=1e-7)
    assert blend.share[1] == pytest.approx([np.exp(-0.5), 0.0], abs=1e-7)
    assert blend.unknown[0] == pytest.approx(1 - near * np.exp(-0.5) - far * np.exp(-1.0), abs=1e-7)
    mean, _ = soil.moments(at((1.0, 0.0)))
    assert mean[0] == pytest.approx(FIRST.mean + (near - 2.0 * far) * WIDTH, rel=1e-6)


def test_the_nearest_zones_stand_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of ten zones along a way that bends, at places about it, means are near those by all of them."""
    random, width, end = np.random.default_rng(0), np.sqrt(np.diag(FIRST.covariance)), np.zeros(2)
    zones = []
    for heading in random.uniform(0.0, 2.0 * np.pi, 10):
        places = end + np.linspace(0.0, 4.0, 40)[:, None] * (np.cos(heading), np.sin(heading))
        soil = SoilBelief(FIRST.laws, FIRST.mean + 0.5 * width * random.standard_normal(8), 0.1 * FIRST.covariance)
        zones.append(Zone(name="zone", place_m=places, belief=soil))
        end = places[-1]
    soil_map, ways = SoilMap(zones=tuple(zones)), np.concatenate([one.place_m for one in zones])
    places = random.uniform(ways.min(axis=0) - 4.0, ways.max(axis=0) + 4.0, (400, 2))
    by_nearest, _ = soil_map.moments(places)
    monkeypatch.setattr("lunarsci.twin.ground.soil_map.NEIGHBOURS", 10)
    by_all, _ = soil_map.moments(places)
    assert 0.0 < np.sqrt((((by_nearest - by_all) / width) ** 2).mean()) < 0.07


def test_driven_places_have_their_zones_belief_and_far_ones_the_first_laws() -> None:
    line = np.arange(0.0, 4.01, 0.1)
    one, two = belief(1.5, 0.1), belief(-1.0, 0.3)
    soil = SoilMap(zones=(zone(line, 0.0, one), zone(line + 4.1, 0.0, two)))
    mean, covariance = soil.moments(at((1.0, 0.4), (3.9, -0.5), (4.2, 0.3), (8.0, 0.0), (400.0, 0.0)))
    for row, wanted in enumerate((one, one, two, two, FIRST)):
        assert mean[row] == pytest.approx(wanted.mean, abs=1e-9)
        assert covariance[row] == pytest.approx(wanted.covariance, abs=1e-9)


def test_zones_that_know_nothing_leave_the_first_laws_everywhere() -> None:
    zones = tuple(zone(float(x), float(y), FIRST) for x, y in ((0, 0), (3, 1), (-1, 2), (5, -2), (2, 2)))
    random = np.random.default_rng(0)
    mean, covariance = SoilMap(correlation_m=3.0, zones=zones).moments(random.uniform(-6, 6, (200, 2)))
    assert mean == pytest.approx(np.tile(FIRST.mean, (200, 1)))
    assert covariance == pytest.approx(np.tile(FIRST.covariance, (200, 1, 1)), abs=1e-6)


def test_no_place_is_known_better_than_a_zone_or_less_than_the_first_laws() -> None:
    random = np.random.default_rng(1)
    zones = tuple(zone(float(x), float(y), belief(0.5, 0.2)) for x, y in random.uniform(-4, 4, (9, 2)))
    _, deviation = SoilMap(correlation_m=3.0, zones=zones).spread(random.uniform(-9, 9, (500, 2)))
    left = deviation / WIDTH
    assert left.min() > 0.15 and left.max() <= 1.0 + 1e-9
    assert left.max() > 0.9


def test_the_belief_along_a_way_is_the_mixture_over_it() -> None:
    one, two = belief(1.0, 0.1), belief(-1.0, 0.2)
    line = np.arange(0.0, 2.01, 0.1)
    soil = SoilMap(zones=(zone(line, 0.0, one), zone(line + 50.0, 0.0, two)))
    whole = soil.belief_along(at((0.5, 0.0), (51.0, 0.0)))
    assert whole.mean == pytest.approx(FIRST.mean, abs=1e-9)
    wanted = 0.5 * (one.covariance + two.covariance) + np.outer(WIDTH, WIDTH)
    assert whole.covariance == pytest.approx(wanted, abs=1e-9)
    forgotten = soil.belief_along(at((0.5, 0.0))).forgotten(1.0)
    assert forgotten.mean == pytest.approx(FIRST.mean) and forgotten.covariance == pytest.approx(FIRST.covariance)


def test_a_new_zone_ends_an_older_one_where_it_passes() -> None:
    line = np.arange(0.0, 4.01, 0.1)
    old, new = belief(1.0, 0.3), belief(-1.0, 0.1)
    soil = SoilMap(zones=(zone(line, 0.0, old, "old"), zone(line, 9.0, old, "aside"))).with_zones(
        [zone(2.0, 0.0, new, "new")]
    )
    assert [part.name for part in soil.zones] == ["old", "aside", "new"]
    mean, _ = soil.moments(at((2.0, 0.2), (0.2, 0.0), (2.0, 9.0)))
    assert [row[0] > FIRST.mean[0] for row in mean] == [False, True, True]
    gone = soil.with_zones([zone(line, 0.0, new, "newest")])
    assert [part.name for part in gone.zones] == ["aside", "newest"]
    assert soil.with_zones([]) is soil


def test_the_file_holds_the_map() -> None:
    known = dataclasses.replace(belief(1.0, 0.3, population=20), history=({"states": "a.csv"},))
    soil = SoilMap(correlation_m=3.5, reach_m=0.4, zones=(zone(np.array([0.0, 0.5]), 1.0, known, "first"),))
    again = read_soil_map(_file(soil))
    assert soil_map_bytes(again) == soil_map_bytes(soil)
    assert again.belief_along(at((0.0, 1.0))).history == ({"states": "a.csv"},)


def _file(soil: SoilMap, **changes: object) -> InputFile:
    document = json.loads(soil_map_bytes(soil)) | changes
    return InputFile("map.json", json.dumps(document).encode())


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"schema": "lunarsci/soil-belief/1"}, "not a soil map"),
        ({"correlation_m": 0}, "correlation_m is 0; give a number above 0"),
        ({"reach_m": -1}, "reach_m is -1; give 0 or more"),
        ({"zones": [{"name": "a"}]}, "no 'x_m'"),
        ({"zones": 3}, "not iterable"),
        ({"laws": {}}, "no 'stiffness_kpa_m_n'"),
    ],
)
def test_files_that_are_no_map_say_why(changes: dict[str, object], says: str) -> None:
    with pytest.raises(DataError, match=r"map\.json: ") as caught:
        read_soil_map(_file(SoilMap(), **changes))
    assert says in str(caught.value)


def test_zones_of_other_first_laws_do_not_fit() -> None:
    laws = dict(default_prior())
    laws["cohesion_pa"] = dataclasses.replace(laws["cohesion_pa"], median=100.0)
    with pytest.raises(ParameterError, match="other first priors"):
        SoilMap(zones=(zone(0.0, 0.0, first_belief(laws)),))
    with pytest.raises(ParameterError, match="give finite x and y"):
        zone(np.nan, 0.0, FIRST)


@pytest.fixture(scope="module")
def ground() -> Terrain:
    height = 0.02 * np.sin(np.arange(41))[:, None] * np.ones(61)
    return build_terrain("waves", -2.0, -4.0, 0.2, height, read_soil("longji"), synthetic=True)


def test_layers_are_a_terrain_that_is_read_again(ground: Terrain, tmp_path) -> None:  # type: ignore[no-untyped-def]
    soil = SoilMap(zones=(zone(np.arange(0.0, 3.01, 0.1), 0.0, belief(1.0, 0.2)),))
    layers = soil_layers(soil, ground)
    left = layers.sd_ratio["cohesion_pa"]
    assert left[20, 15] == pytest.approx(0.2) and left.shape == ground.height_m.shape and left.max() < 1.0
    path = tmp_path / "layers.npz"
    path.write_bytes(terrain_bytes(layers.terrain, sd_ratio=layers.sd_ratio))
    again = read_terrain(path, read_soil("longji"))
    assert again.soil == pytest.approx(layers.terrain.soil)
    median = values_of(FIRST.laws, FIRST.mean + WIDTH)[0]
    assert again.soil[20, 15, SOIL_COLUMNS["stiffness_kpa_m_n"]] == pytest.approx(1e3 * median)
    with np.load(path) as archive:
        assert archive["cohesion_pa_left_of_prior"] == pytest.approx(left, rel=1e-5)
    assert len(list(soil_pages(layers, soil))) == 2


def test_draws_have_the_moments_of_the_map_at_every_node(ground: Terrain) -> None:
    """4000 draws: a standard deviation is known to 1.1 %, a mean to 1.6 % of it."""
    zones = (zone(np.arange(0.0, 2.01, 0.1), 0.0, belief(1.0, 0.3)), zone(6.0, 1.0, belief(-1.0, 0.5)))
    soil = SoilMap(correlation_m=3.0, zones=zones)
    places = at((1.0, 0.0), (4.5, 0.5), (6.0, 1.2), (300.0, 0.0))
    mean, covariance = soil.moments(places)
    for row in range(len(places)):
        draws = drawn_grounds(soil, ground, places[row : row + 1], 4000, seed=row).parameters
        points = np.column_stack([FIRST.laws[name].transformed(draws[name]) for name in PARAMETERS])
        spread = np.sqrt(np.diag(covariance[row]))
        assert (np.abs(points.mean(axis=0) - mean[row]) < 4 * 0.016 * spread).all()
        # Between zones the correlation of what they do not know is that of their tracks, a little off the node's.
        assert points.std(axis=0) == pytest.approx(spread, rel=0.08 if row == 1 else 0.045)


def test_draws_in_a_zone_are_its_population_and_one_soil(ground: Terrain) -> None:
    known = belief(1.0, 0.3, population=50)
    soil = SoilMap(zones=(zone(np.arange(0.0, 4.01, 0.1), 0.0, known), zone(20.0, 0.0, belief(0.0, 0.1))))
    drawn = drawn_grounds(soil, ground, at((1.0, 0.0)), 50, seed=3)
    population = np.sort(values_of(FIRST.laws, known.population)[:, 0])
    assert np.sort(drawn.parameters["stiffness_kpa_m_n"]) == pytest.approx(population)
    terrain = drawn.terrain(7)
    inside = terrain.soil[19:22, 11:30].reshape(-1, 8)
    assert inside == pytest.approx(np.tile(inside[0], (len(inside), 1)))
    assert drawn.only(7).terrain(0).soil == pytest.approx(terrain.soil)
    assert np.ptp(terrain.soil[:, :, 0]) > 0
    with pytest.raises(ParameterError, match="give 1 or more"):
        drawn_grounds(soil, ground, at((1.0, 0.0)), 0)


def test_a_drive_within_one_zone_is_one_on_the_drawn_soils(yutu2: Rover, ground: Terrain) -> None:
    """The same soil at every node drives as the soil given for the whole terrain."""
    plan = Plan(name="test", legs=(Leg(1.0, 0.1),), speed_m_s=0.05)
    known = SoilMap(zones=(zone(np.arange(-3.0, 12.0, 0.5), 0.0, belief(0.3, 0.2)),), reach_m=30.0)
    grounds = drawn_grounds(known, ground, planned_places(plan, yutu2), 3, seed=1)
    by_map = predict(yutu2, ground, plan, grounds=grounds, time_step_s=0.2)
    by_soil = predict(yutu2, ground, plan, samples=grounds.parameters, time_step_s=0.2)
    assert by_map.finished.all()
    assert by_map.states == pytest.approx(by_soil.states, rel=1e-6, abs=1e-9)
    assert step_error_m(by_map) == pytest.approx(step_error_m(by_soil), rel=1e-3)
    with pytest.raises(ParameterError, match="two ways"):
        predict(yutu2, ground, plan, grounds=grounds, samples=grounds.parameters)


def test_wheels_meet_the_soil_of_the_place(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    """Softer from x = 3 m on: sinkage before is that of the stiff soil, after it that of the soft one."""
    plan = Plan(name="test", legs=(Leg(4.0),), speed_m_s=0.05, x_m=0.5)
    stiff, soft = (dataclasses.replace(belief(0.0, 1e-4), mean=FIRST.mean + s * WIDTH * np.eye(8)[0]) for s in (1, -1))
    line = np.arange(-1.0, 3.0, 0.1)
    soil = SoilMap(zones=(zone(line, 0.0, stiff), zone(line + 4.0, 0.0, soft)))
    grounds = drawn_grounds(soil, slope(), planned_places(plan, yutu2), 2)
    both = predict(yutu2, slope(), plan, grounds=grounds, time_step_s=0.2).states[0, :, :, 2]
    one, two = (
        predict(
            yutu2,
            slope(),
            plan,
            samples={name: [value] for name, value in zip(PARAMETERS, values_of(FIRST.laws, b.mean), strict=True)},
            time_step_s=0.2,
        ).states[0, :, :, 2]
        for b in (stiff, soft)
    )
    assert both[10] == pytest.approx(one[10], rel=0.01) and both[-1] == pytest.approx(two[-1], rel=0.01)
    assert two[-1].min() > 1.5 * one[-1].max()
