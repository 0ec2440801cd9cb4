"""What craters left at a site: closed forms, a slow loop over draws as oracle, and the site's own facts.

Ejecta laws against the thicknesses and speeds computed for the Chang'E-4 site in the project's notes.

Survival of boulders against the two published times.
"""

import math

import numpy as np
import pytest

from lunarsci.constants import MOON_RADIUS_KM
from lunarsci.errors import ParameterError
from lunarsci.spectra.origin.catalogue import Crater, distance_km, embedded_catalogue
from lunarsci.spectra.origin.prior import (
    CHANG_E_4,
    LAW_SOURCES,
    PriorSettings,
    Range,
    crater_priors,
    ejecta_thickness_m,
    launch_speed_m_s,
    local_to_ejecta_ratio,
    surface_age_ma,
    survival,
    transient_radius_km,
)

SURE = {"thickness_factor": 1.0, "other_weight": 0.0}
"""Nothing is uncertain but what a test makes so."""


def crater(name: str, km_east: float, diameter_km: float, age_ma: float | tuple[float, float]) -> Crater:
    """A crater at the equator, so far east of (0, 0)."""
    ages = age_ma if isinstance(age_ma, tuple) else (age_ma, age_ma)
    degrees = float(np.degrees(km_east / 1737.4))
    return Crater(name=name, latitude_deg=0, longitude_deg=degrees, diameter_km=diameter_km, age_ma=ages)


def pike(km: float, diameter_km: float) -> float:
    radius = 420 * diameter_km if diameter_km < 18.7 else 500 * 18.7**0.15 * diameter_km**0.85
    return 0.033 * radius * (1000 * km / radius) ** -3


def probabilities(craters: list[Crater], **settings: object) -> list[float]:
    return [item.probability for item in crater_priors(craters, (0, 0), PriorSettings(**{**SURE, **settings}))]


def test_thickness_alone_is_a_ratio_of_thicknesses() -> None:
    craters = [crater("near", 30, 4, 50), crater("far", 140, 73, 3000)]
    found = probabilities(craters, exposure=False, re_excavation=False)
    assert found[1] / found[0] == pytest.approx(pike(140, 73) / pike(30, 4), rel=1e-6)
    assert sum(found) == pytest.approx(1)


def test_the_mean_over_the_spread_is_that_of_shares() -> None:
    """Two craters: the share of one is 1 / (1 + exp(d)), d normal; its mean by quadrature."""
    craters = [crater("a", 50, 10, 50), crater("b", 50, 14, 50)]
    found = probabilities(craters, exposure=False, re_excavation=False, thickness_factor=3.0)
    mean, sigma = np.log(pike(50, 14) / pike(50, 10)), np.sqrt(2) * np.log(3)
    d = np.linspace(mean - 8 * sigma, mean + 8 * sigma, 40_001)
    weight = np.exp(-0.5 * ((d - mean) / sigma) ** 2)
    assert found[0] == pytest.approx((weight / (1 + np.exp(d))).sum() / weight.sum(), abs=0.01)


def test_survival_is_a_factor() -> None:
    craters = [crater("young", 50, 10, 30), crater("older", 50, 10, 90)]
    found = probabilities(craters, re_excavation=False, rock_life_ma=Range(60, 60))
    assert found[0] / found[1] == pytest.approx(float(survival(30, 60) / survival(90, 60)), rel=1e-6)


def loop(ages: np.ndarray, thickness: np.ndarray, km: np.ndarray, life: float, garden: float) -> np.ndarray:
    """Amounts at the surface by stage, written out crater by crater."""
    amounts = np.zeros((3, len(ages)))
    shape = np.log(np.log(100) / np.log(2)) / np.log(3.75)
    left = 2.0 ** -((ages / life) ** shape)
    for c in range(len(ages)):
        amounts[0, c] = thickness[c] * left[c]
        for y in range(len(ages)):
            if ages[y] < ages[c]:
                below = sum(thickness[k] for k in range(len(ages)) if ages[k] > ages[y])
                brought = min(0.0183 * km[y] ** 0.87 * thickness[y], below)
                amounts[1, c] += thickness[c] / below * brought * left[y]
        amounts[2, c] = min(garden, thickness.sum()) * thickness[c] / thickness.sum()
    return amounts


def test_all_stages_against_a_loop() -> None:
    km, diameter = np.array([30.0, 70, 140, 280]), [4, 29, 73, 92]
    ages = np.array([40.0, 2000, 90, 3000])
    craters = [crater(str(k), km[k], diameter[k], ages[k]) for k in range(4)]
    thickness = np.array([pike(d, s) for d, s in zip(km, diameter, strict=True)])
    settings = PriorSettings(**SURE, rock_life_ma=Range(60, 60), gardening_m=Range(0.01, 0.01))  # type: ignore[arg-type]
    found = crater_priors(craters, (0, 0), settings)
    amounts = loop(ages, thickness, km, 60, 0.01)
    assert [item.probability for item in found] == pytest.approx(amounts.sum(axis=0) / amounts.sum(), rel=1e-4)
    for k, item in enumerate(found):
        parts = amounts[:, k] / amounts[:, k].sum()
        assert [item.stages[name] for name in ("direct", "stirred", "gardened")] == pytest.approx(parts, abs=1e-4)


def test_what_lies_below_the_surface_counts_nothing() -> None:
    craters = [crater("buried", 140, 73, 3900), crater("above", 140, 40, 3000), crater("both", 140, 40, (3000, 4000))]
    found = crater_priors(craters, (0, 0), PriorSettings(surface_age_ma=3500))
    assert found[0].probability == 0
    share = np.log(3500 / 3000) / np.log(4000 / 3000)
    assert found[2].above_surface == pytest.approx(share, abs=0.02)
    assert found[2].probability < found[1].probability


def test_a_crater_that_contains_the_site_is_left_out_under_every_prior() -> None:
    craters = [crater("host", 20, 100, 3000), crater("near", 30, 4, 50)]
    for kind in ("ejecta", "uniform"):
        host, near = crater_priors(craters, (0, 0), PriorSettings(kind=kind))  # type: ignore[arg-type]
        assert (host.ejecta_m, host.probability) == (None, 0)
        assert near.probability == pytest.approx(0.9)
    with pytest.raises(ParameterError, match="every crater of the catalogue contains the site"):
        crater_priors(craters[:1], (0, 0), PriorSettings())


def test_uniform_is_uniform_and_leaves_room_for_other_sources() -> None:
    craters = [crater(str(k), 30 + 50 * k, 4 + k, 50 + 900 * k) for k in range(4)]
    found = probabilities(craters, kind="uniform", other_weight=0.2)
    assert found == pytest.approx([0.2] * 4)


def test_the_antipode_and_the_other_side_are_far_but_possible() -> None:
    craters = [crater("antipode", np.pi * 1737.4, 500, 1000), crater("near", 30, 4, 500)]
    found = crater_priors(craters, (0, 0), PriorSettings())
    assert found[0].distance_km == pytest.approx(np.pi * 1737.4)
    assert 0 < found[0].probability < 0.9


def test_when_no_rock_can_be_left_it_says_so() -> None:
    with pytest.raises(ParameterError, match="no crater can have left a rock"):
        crater_priors([crater("a", 30, 4, 4000)], (0, 0), PriorSettings(surface_age_ma=3000))


def test_the_site_of_the_paper() -> None:
    """Mass alone is Finsen's, survival alone is Zhinyu's, and what is dug up again decides between them."""
    craters = embedded_catalogue()
    names = [item.name for item in craters]

    def odds(**settings: object) -> float:
        found = crater_priors(craters, CHANG_E_4, PriorSettings(**settings))  # type: ignore[arg-type]
        return found[names.index("Finsen")].probability / found[names.index("Zhinyu")].probability

    assert odds(exposure=False, re_excavation=False, thickness_factor=1.0) == pytest.approx(1200, rel=0.03)
    assert odds(re_excavation=False) < 0.01
    assert odds(gardening_m=Range(1e-3, 1e-3)) < 1 < odds(gardening_m=Range(0.1, 0.1))


def test_the_surface_is_the_mare_only_at_chang_e_4() -> None:
    assert surface_age_ma(CHANG_E_4, PriorSettings()) == 3600
    assert surface_age_ma((0, 0), PriorSettings()) == 4560
    assert surface_age_ma(CHANG_E_4, PriorSettings(surface_age_ma=2000)) == 2000


def test_equal_seeds_give_equal_priors_and_the_draws_are_enough() -> None:
    craters = embedded_catalogue()
    first, again, other = (
        [item.probability for item in crater_priors(craters, CHANG_E_4, PriorSettings(seed=seed))] for seed in (0, 0, 1)
    )
    assert first == again
    assert first != other
    assert first == pytest.approx(other, abs=0.01)


def test_a_large_catalogue_is_drawn_in_parts() -> None:
    craters = [crater(f"c{k}", 40 + k, 4 + k % 7, (50, 3000)) for k in range(400)]
    found = probabilities(craters)
    assert sum(found) == pytest.approx(1)


@pytest.mark.parametrize(
    "settings",
    [
        {"thickness_factor": 0.5},
        {"other_weight": 1.0},
        {"other_weight": float("nan")},
        {"stirring": -1},
        {"rock_size_m": 0},
        {"life_exponent": 9},
        {"surface_age_ma": 0},
    ],
)
def test_impossible_settings_are_refused(settings: dict) -> None:
    with pytest.raises(ParameterError, match="; give "):
        PriorSettings(**settings)


TABLE = {
    "Zhinyu": (214, 0.0078, 0.0049, 0.016),
    "Finsen": (417, 9.3, 2.7, 19),
    "Von Kármán L": (297, 3.4, 1.2, 7.0),
    "Alder": (417, 11, 3.2, 22),
    "Maksutov": (674, 1.09, 0.31, 2.2),
    "Davisson": (612, 2.5, 0.7, 5.2),
    "Antoniadi": (968, 0.57, 0.14, 1.2),
    "Leibnitz": (470, 128, 29, 257),
}
"""Launch speed [m/s] and thickness [m] at the site after Pike, McGetchin, Xie, computed from the transient radius."""
CRATERS = {crater.name: crater for crater in embedded_catalogue()}


@pytest.mark.parametrize("name", TABLE)
def test_thickness_and_speed_at_the_site(name: str) -> None:
    crater = CRATERS[name]
    distance = distance_km(CHANG_E_4, crater.center)
    speed, *thickness = TABLE[name]
    for law, expected in zip(("pike", "mcgetchin", "xie"), thickness, strict=True):
        assert ejecta_thickness_m(law, crater.diameter_km, distance) == pytest.approx(expected, rel=0.05), law
    assert launch_speed_m_s(crater.diameter_km, distance) == pytest.approx(speed, rel=0.01)


def test_mass_alone_prefers_finsen_twelve_hundred_times() -> None:
    zhinyu, finsen = (
        ejecta_thickness_m("pike", CRATERS[n].diameter_km, distance_km(CHANG_E_4, CRATERS[n].center))
        for n in ("Zhinyu", "Finsen")
    )
    assert finsen / zhinyu == pytest.approx(1200, rel=0.03)


def test_housen_by_hand() -> None:
    """A crater whose transient radius is 10 km, seen from 100 km: 0.0078 x 10000 x 10^-2.61."""
    diameter = (20 / 18.7**0.15) ** (1 / 0.85)
    assert transient_radius_km(diameter) == pytest.approx(10)
    assert ejecta_thickness_m("housen", diameter, 100) == pytest.approx(78 * 10**-2.61)


def test_transient_craters() -> None:
    assert transient_radius_km(10) == pytest.approx(4.2)
    assert transient_radius_km(18.7) == pytest.approx(18.7 / 2)
    assert transient_radius_km(73) == pytest.approx(29.75, abs=0.02)


@pytest.mark.parametrize("law", LAW_SOURCES)
def test_there_is_no_blanket_within_the_rim_and_less_farther_out(law: str) -> None:
    assert ejecta_thickness_m(law, 73, 36) is None
    assert launch_speed_m_s(73, 36) is None
    steps = [ejecta_thickness_m(law, 73, km) for km in (37, 80, 200, 1000, math.pi * MOON_RADIUS_KM)]
    assert steps == sorted(steps, reverse=True)
    assert steps[-1] > 0


def test_speed_on_a_flat_moon_and_to_the_antipode() -> None:
    """Near: v^2 = g x range at 45 deg; the farthest point takes the escape speed, 2374 m/s with g 1.622."""
    assert launch_speed_m_s(0.001, 1.0) == pytest.approx(math.sqrt(1.622 * 1000), rel=1e-3)
    escape = math.sqrt(2 * 1.622 * 1737400)
    assert launch_speed_m_s(0.001, math.pi * MOON_RADIUS_KM) == pytest.approx(escape, rel=1e-4)


def test_stirred_ground_grows_with_distance() -> None:
    assert local_to_ejecta_ratio(1.0) == pytest.approx(0.0183)
    assert local_to_ejecta_ratio(100.0) / local_to_ejecta_ratio(10.0) == pytest.approx(10**0.87)


@pytest.mark.parametrize("diameter", [0, -3, float("nan"), float("inf")])
def test_impossible_diameters_are_refused(diameter: float) -> None:
    with pytest.raises(ParameterError, match="above 0"):
        transient_radius_km(diameter)


@pytest.mark.parametrize(("half", "nearly_all"), [(40, 150), (80, 300)])
def test_half_and_99_percent_are_gone_when_they_were_counted(half: float, nearly_all: float) -> None:
    """Basilevsky, Head & Hoerz (2013), abstract: median 40-80 Ma, 99 % gone after 150-300 Ma."""
    assert survival(half, half) == pytest.approx(0.5)
    assert survival(nearly_all, half) == pytest.approx(0.01, rel=1e-9)


def test_larger_rocks_last_longer_only_if_asked() -> None:
    assert survival(60, 60, size_m=8) == pytest.approx(0.5)
    assert survival(120, 60, size_m=8, size_exponent=0.5) == pytest.approx(0.5)
    assert survival(0, 60) == 1
    assert survival(4000, 60) == pytest.approx(0)


def test_a_range_is_uniform_in_its_logarithm() -> None:
    assert Range(1, 100).quantile([0, 0.5, 1]) == pytest.approx([1, 10, 100])
    assert np.ptp(Range(7, 7).quantile(np.linspace(0, 1, 5))) == 0


@pytest.mark.parametrize("ends", [(0, 1), (-1, 1), (2, 1), (1, float("inf")), (float("nan"), 1)])
def test_impossible_ranges_are_refused(ends: tuple) -> None:
    with pytest.raises(ParameterError, match="; give "):
        Range(*ends)


def test_a_rock_has_a_size() -> None:
    with pytest.raises(ParameterError, match="above 0"):
        survival(10, 60, size_m=0)
