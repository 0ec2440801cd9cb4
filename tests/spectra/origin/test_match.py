"""Posteriors: arithmetic, calibration on simulated rocks, and the paper's rock on its published numbers.

ln Bayes factors of compositions against brute force: simulated rocks counted, and integrals on a grid.
"""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from lunarsci.errors import ParameterError
from lunarsci.minerals import WITH_BANDS
from lunarsci.spectra.origin.catalogue import Crater, embedded_catalogue
from lunarsci.spectra.origin.composition import Composition, Rock
from lunarsci.spectra.origin.match import (
    OTHER,
    CompositionRows,
    MatchSettings,
    RockMatch,
    evidence_rows,
    ln_shares_broad,
    ln_shares_crater,
    match_rocks,
)
from lunarsci.spectra.origin.prior import CHANG_E_4, PriorSettings, Range

PAPER_ROCK = Rock(
    "fin-shaped rock",
    Composition({"olivine": (0.25, 0.05), "orthopyroxene": (0.345, 0.05), "clinopyroxene": (0.405, 0.05)}),
)
"""Ding et al. (2024): OPX : CPX 46 : 54, olivine 20-30 % of the mafic minerals; the errors are half of that range."""


@pytest.fixture(scope="module")
def bench(load_benchmark: Callable[[str], Any]) -> Any:
    return load_benchmark("bench_match")


def matched(rock: Rock = PAPER_ROCK, craters: Any = None, **prior: object) -> RockMatch:
    settings = MatchSettings(prior=PriorSettings(**prior))  # type: ignore[arg-type]
    return match_rocks([rock], craters or embedded_catalogue(), CHANG_E_4, settings)[0]


def by_name(match: RockMatch) -> dict[str, Any]:
    return {item.crater.name: item for item in match.craters}


def with_modes(name: str, modes: dict[str, tuple[float, float]]) -> list[Crater]:
    return [
        replace(crater, composition=Composition(modes)) if crater.name == name else crater
        for crater in embedded_catalogue()
    ]


def test_posterior_is_prior_times_the_factor_over_the_sum() -> None:
    match = matched()
    weights = [item.prior.probability * np.exp(item.ln_bayes_factor) for item in match.craters]
    total = sum(weights) + match.other_prior
    assert [item.posterior for item in match.craters] == pytest.approx([w / total for w in weights])
    assert match.other_posterior == pytest.approx(match.other_prior / total)
    assert sum(item.prior.probability for item in match.craters) + match.other_prior == pytest.approx(1)


CLEAR = {"olivine": (0.60, 0.02), "orthopyroxene": (0.20, 0.02), "clinopyroxene": (0.20, 0.02)}
OPPOSITE = {"olivine": (0.05, 0.02), "orthopyroxene": (0.20, 0.02), "clinopyroxene": (0.75, 0.02)}


def two_craters(near: dict[str, Any] | None, far: dict[str, Any] | None, **prior: object) -> RockMatch:
    """A rock of 60 % olivine, found beside two craters, the near one of which left far more."""
    made = [Composition(modes) if modes else Composition() for modes in (near, far)]
    craters = [
        Crater(name="near", latitude_deg=-45.0, longitude_deg=178.0, diameter_km=20.0, composition=made[0]),
        Crater(name="far", latitude_deg=-43.0, longitude_deg=190.0, diameter_km=5.0, composition=made[1]),
    ]
    settings = MatchSettings(systematic=0.02, prior=PriorSettings(**prior))  # type: ignore[arg-type]
    return match_rocks([Rock("rock", Composition(CLEAR))], craters, CHANG_E_4, settings)[0]


def test_a_crater_is_decided_where_composition_tells_it_from_all_others() -> None:
    match = two_craters(OPPOSITE, CLEAR, kind="uniform")
    assert (match.best, match.remaining) == ("far", ("far",))
    assert match.status == f"likeliest far ({match.craters[1].posterior:.2f}); the composition favours it strongly"


def test_a_rock_as_that_of_the_crater_it_lies_in_is_not_decided() -> None:
    """The rim holds the site, so that its ejecta say nothing, and its floor may."""
    around = Crater(
        name="around", latitude_deg=-45.44, longitude_deg=177.56, diameter_km=40.0, composition=Composition(CLEAR)
    )
    apart = [(-43.0, 190.0, CLEAR), (-45.0, 171.0, OPPOSITE)]
    others = [
        Crater(name=f"crater {k}", latitude_deg=lat, longitude_deg=lon, diameter_km=5.0, composition=Composition(modes))
        for k, (lat, lon, modes) in enumerate(apart)
    ]
    settings = MatchSettings(systematic=0.02, prior=PriorSettings(kind="uniform"))
    rock = Rock("rock", Composition(CLEAR))
    assert match_rocks([rock], others, CHANG_E_4, settings)[0].best == "crater 0"
    match = match_rocks([rock], [*others, around], CHANG_E_4, settings)[0]
    assert match.best is None
    assert "goes as well with around, in which the site lies" in match.status


def test_where_the_prior_alone_leads_no_crater_is_decided() -> None:
    """A prior of any odds: composition knows nothing of either, or the same of both."""
    unknown = two_craters(None, None, other_weight=0.001)
    alike = two_craters(CLEAR, CLEAR, other_weight=0.001)
    for match in (unknown, alike):
        odds = match.craters[0].posterior / match.craters[1].posterior
        assert odds > 20
        assert match.best is None
        assert match.remaining[0] == "near"
    assert "composition decides nothing" in unknown.status
    assert alike.status == f"not decided: near ({alike.craters[0].posterior:.2f}) leads by the prior; " + (
        "composition adds less than 20 : 1 for it"
    )


def test_craters_that_composition_does_not_tell_apart_all_remain() -> None:
    match = two_craters(CLEAR, CLEAR, kind="uniform")
    assert match.best is None
    assert {*match.remaining} == {"near", "far"}
    assert match.status.startswith("not decided: ") and "remain" in match.status


def test_what_the_factors_say_against_the_prior_is_not_decided_below_20_to_1() -> None:
    """With the odds of any source at hand: it is decided where both are 20 : 1 or more, here by their definitions."""
    rng = np.random.default_rng(4)
    seen = set[bool]()
    for _ in range(60):
        near, far = (
            {name: (float(v), 0.05) for name, v in zip(CLEAR, rng.dirichlet(np.full(3, 2.0)), strict=True)}
            for _ in range(2)
        )
        match = two_craters(near, far, kind="uniform", other_weight=float(rng.uniform(0.01, 0.5)))
        sources = [(c.crater.name, c.prior.probability, np.exp(c.ln_bayes_factor)) for c in match.craters]
        sources.append((OTHER, match.other_prior, 1.0))
        name, own, factor = max(sources, key=lambda one: one[1] * one[2])
        rest = [one for one in sources if one[0] != name]
        odds = own * factor / sum(prior * other for _, prior, other in rest)
        bayes = factor / (sum(prior * other for _, prior, other in rest) / sum(prior for _, prior, _ in rest))
        assert match.best == (name if min(odds, bayes) >= np.exp(3.0) else None)
        seen.add(match.decided)
    assert seen == {True, False}


@pytest.mark.slow
def test_of_craters_that_are_called_decided_as_many_are_right_as_said(bench: Any) -> None:
    """20 : 1 or more, of rocks drawn by hand; where rocks come from any crater alike, the assumed prior misleads."""
    settings = MatchSettings(prior=PriorSettings())
    found = bench.decided(*bench.matched(bench.complete_catalogue(), settings, 1500, 7))
    assert found.called > 75
    assert found.right / found.called > 0.95 - 2.5 * np.sqrt(0.95 * 0.05 / found.called)
    wrong = bench.matched(bench.complete_catalogue(), settings, 1500, 7, PriorSettings(kind="uniform"))
    misled = bench.decided(*wrong)
    assert misled.right / misled.called < 0.85


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_300_rocks_of_the_craters_are_as_often_right_as_said(bench: Any, seed: int) -> None:
    settings = MatchSettings(prior=PriorSettings())
    for craters in (bench.complete_catalogue(), embedded_catalogue()):
        table, width, right = bench.reliability(craters, settings, 300, seed)
        assert table.worst < 0.05, table
        assert len(table.count) == 10
        assert (np.abs(width.forecast - width.observed) < 0.05 + 2.5 * width.chance).all(), width
        assert right > 0.4


@pytest.mark.slow
def test_posteriors_hold_with_the_errors_that_unmixed_shares_have(bench: Any) -> None:
    """Residuals of whole suites left out, drawn as they are; bins of equal count, 0.02 off with 1200 rocks."""
    settings = MatchSettings(prior=PriorSettings())
    own, _, _ = bench.reliability(bench.complete_catalogue(), settings, 300, 1, stated="own")
    assert np.all(np.abs(own.forecast - own.observed) < 0.05 + 2.5 * own.chance)


@pytest.mark.slow
def test_a_world_with_larger_errors_is_noticed(bench: Any) -> None:
    """The same forecasts fail where methods disagree by three times what is assumed: the measure can fail."""
    settings = MatchSettings(prior=PriorSettings())
    table, _, _ = bench.reliability(bench.complete_catalogue(), settings, 300, 0, systematic=0.3)
    assert table.worst > 0.1


def test_the_papers_rock_is_not_decided_by_composition() -> None:
    """Finsen's published modes are too uncertain, Zhinyu's are not accessible: ln Bayes factors within 2."""
    match = matched()
    craters = by_name(match)
    assert craters["Zhinyu"].ln_bayes_factor == 0
    assert craters["Zhinyu"].evidence.basis.startswith("nothing: no mineral")
    assert 0 < craters["Finsen"].ln_bayes_factor < 2
    assert craters["Finsen"].evidence.minerals == ("olivine", "orthopyroxene", "clinopyroxene")
    assert "composition speaks for Finsen (odds 2" in match.status
    assert "as by the prior); the others stand as by the prior: nothing of theirs can be compared" in match.status


def test_composition_from_shares_that_are_not_to_be_quoted_says_so() -> None:
    rock = Rock(
        "rock", Composition({"olivine": (0.6, 0.02), "orthopyroxene": (0.2, 0.02), "clinopyroxene": (0.2, 0.02)})
    )
    craters = with_modes("Zhinyu", dict(rock.composition.modes))
    tested, untested = matched(rock, craters), matched(replace(rock, untested=True), craters)
    assert tested.status.partition("; ")[2].startswith("composition speaks for Zhinyu (odds 1")
    assert "not tested" not in tested.status
    assert "do not rely on it: the method was not tested on rocks like this one" in untested.status
    assert not untested.decided


def test_a_crater_of_unknown_composition_is_not_favoured_where_others_are_disfavoured() -> None:
    """Pure clinopyroxene is not what Finsen threw; of Zhinyu and others nobody knows."""
    rock = Rock(
        "rock", Composition({"olivine": (0.01, 0.02), "orthopyroxene": (0.01, 0.02), "clinopyroxene": (0.98, 0.02)})
    )
    status = matched(rock).status
    assert "speaks strongly against Finsen" in status and "place 1 by the prior, " in status


def test_the_papers_conclusion_hangs_on_what_is_assumed_of_re_excavation() -> None:
    def first(craters: Any = None, **prior: object) -> str:
        return max(matched(craters=craters, **prior).craters, key=lambda item: item.posterior).crater.name

    assert first(re_excavation=False) == "Zhinyu"
    assert first(exposure=False, re_excavation=False) == "Finsen"
    assert first() == "Finsen"
    assert first(craters=with_modes("Zhinyu", dict(PAPER_ROCK.composition.modes))) == "Zhinyu"
    zhinyu = [by_name(matched(gardening_m=Range(g, g)))["Zhinyu"].posterior for g in (1e-4, 1e-3, 1e-2, 1e-1)]
    assert zhinyu == sorted(zhinyu, reverse=True)
    assert zhinyu[0] > 10 * zhinyu[-1]


def test_the_page_gives_these_figures() -> None:
    """What it says of the paper's rock, for the errors of the table above."""
    text = " ".join((Path(__file__).parents[3] / "docs/validation/rock.md").read_text(encoding="utf-8").split())
    said = re.search(
        r"ln BF is ([\d.]+) for Finsen.*?Zhinyu has a probability of ([\d.]+), "
        r".*?Finsen has ([\d.]+) and Zhinyu ([\d.]+)\.",
        text,
    )
    assert said
    default, buried = by_name(matched()), by_name(matched(re_excavation=False))
    found = [
        default["Finsen"].ln_bayes_factor,
        buried["Zhinyu"].posterior,
        default["Finsen"].posterior,
        default["Zhinyu"].posterior,
    ]
    assert [float(number) for number in said.groups()] == pytest.approx(found, rel=0.06)


def test_even_if_zhinyus_ejecta_were_just_like_the_rock_composition_would_not_decide() -> None:
    """The most that the paper's argument can give, for it takes the rock's own modes for Zhinyu's."""
    like = dict(PAPER_ROCK.composition.modes)
    craters = by_name(matched(craters=with_modes("Zhinyu", like)))
    assert 0 < craters["Zhinyu"].ln_bayes_factor - craters["Finsen"].ln_bayes_factor < 3


def test_the_other_published_modes_of_finsen_change_little() -> None:
    """Laboratory calibration, Astron. Astrophys. 658, A67 (2022): CPX : OPX : OL = 56 : 29 : 17."""
    modes = {"olivine": (0.167, 0.1), "orthopyroxene": (0.284, 0.1), "clinopyroxene": (0.549, 0.1)}
    other = by_name(matched(craters=with_modes("Finsen", modes)))["Finsen"].ln_bayes_factor
    assert other == pytest.approx(by_name(matched())["Finsen"].ln_bayes_factor, abs=1.0)


def test_a_rock_unlike_every_known_crater_comes_from_elsewhere() -> None:
    rock = Rock(
        "odd", Composition({"olivine": (0.98, 0.01), "orthopyroxene": (0.01, 0.01), "plagioclase": (0.01, 0.01)})
    )
    known = [
        replace(
            c,
            composition=Composition(
                {"olivine": (0.05, 0.02), "orthopyroxene": (0.3, 0.05), "plagioclase": (0.6, 0.05)}
            ),
        )
        for c in embedded_catalogue()
    ]
    match = matched(rock, known)
    assert match.other_posterior > 0.999
    assert "goes with none of the craters" in match.status
    assert match.to_dict()["best"] == OTHER
    assert sum(item.posterior for item in match.craters) + match.other_posterior == pytest.approx(1)


def test_with_no_room_for_other_sources_the_craters_share_everything() -> None:
    match = matched(other_weight=0.0)
    assert match.other_posterior == 0
    assert sum(item.posterior for item in match.craters) == pytest.approx(1)


def test_kinds_of_composition_can_be_switched_off() -> None:
    rock = Rock("r", Composition(PAPER_ROCK.composition.modes, {"bc1000_nm": (930, 5)}))
    crater = Composition(PAPER_ROCK.composition.modes, {"bc1000_nm": (990, 5)})
    craters = [replace(c, composition=crater) if c.name == "Finsen" else c for c in embedded_catalogue()]

    def found(**use: bool) -> Any:
        settings = MatchSettings(prior=PriorSettings(), **use)
        return by_name(match_rocks([rock], craters, CHANG_E_4, settings)[0])["Finsen"].evidence

    both, modes, bands = found(), found(use_bands=False), found(use_modes=False)
    assert (modes.ln_bands, bands.ln_modes) == (None, None)
    assert both.ln_total == pytest.approx(modes.ln_total + bands.ln_total)
    assert bands.ln_total < 0 < modes.ln_total


def test_rocks_without_anything_to_compare_keep_the_prior() -> None:
    match = matched(Rock("dark", Composition()))
    assert [i.posterior for i in match.craters] == pytest.approx([i.prior.probability for i in match.craters])
    assert match.best is None
    assert "; composition decides nothing: no composition of the rock is known" in match.status
    why = "its shares hold the prior lunar-rocks"
    assert f"; composition decides nothing: {why}; the posterior" in matched(Rock("a", Composition(), (why,))).status


@pytest.mark.parametrize("settings", [{"systematic": -0.1}, {"systematic": 2}, {"band_systematic_nm": -1}])
def test_impossible_settings_are_refused(settings: dict) -> None:
    with pytest.raises(ParameterError, match="systematic"):
        MatchSettings(prior=PriorSettings(), **settings)


def test_a_map_of_rocks_is_matched_as_each_of_them() -> None:
    """Rows of arrays, some values unknown, some errors hanging together, beside the rocks one by one."""
    rng = np.random.default_rng(8)
    rocks = []
    for number in range(12):
        known = rng.permutation(4)[: 4 - number % 3]
        shares = rng.dirichlet(np.ones(len(known)))
        modes = {WITH_BANDS[k]: (float(v), float(rng.uniform(0.01, 0.1))) for k, v in zip(known, shares, strict=True)}
        bands = {"bc1000_nm": (float(rng.uniform(900, 1000)), 6.0)} if number % 2 else {}
        factors = rng.normal(size=(len(known), 8))
        spread = np.sqrt((factors**2).sum(axis=1))
        correlation = factors @ factors.T / np.outer(spread, spread) if number % 3 == 1 else None
        rocks.append(Rock(f"rock {number}", Composition(modes, bands, correlation)))
    made_of = Composition({"olivine": (0.2, 0.1), "orthopyroxene": (0.5, 0.1)}, {"bc1000_nm": (930.0, 9.0)})
    craters = [
        replace(crater, composition=made_of) if place % 2 else crater
        for place, crater in enumerate(embedded_catalogue())
    ]
    settings = MatchSettings(prior=PriorSettings())
    rows = match_rocks(rocks, craters, CHANG_E_4, settings)
    for number, rock in enumerate(rocks):
        (alone,) = match_rocks([rock], craters, CHANG_E_4, settings)
        shares = [*(item.posterior for item in alone.craters), alone.other_posterior]
        np.testing.assert_allclose(rows.posterior[number], shares, rtol=1e-10)
        factors = [item.ln_bayes_factor for item in alone.craters]
        np.testing.assert_allclose(rows.evidence.ln_total[number], factors, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(rows.posterior.sum(axis=1), 1, rtol=1e-12)


ROCK = {"olivine": (0.25, 0.05), "orthopyroxene": (0.35, 0.06), "clinopyroxene": (0.40, 0.06)}


def compared(rock: Composition, crater: Composition, *, systematic: float, band_systematic_nm: float) -> Any:
    rows = CompositionRows.of([rock])
    return evidence_rows(rows, [crater], systematic=systematic, band_systematic_nm=band_systematic_nm).at(0, 0)


def evidence(rock: dict, crater: dict, systematic: float = 0.1) -> float:
    found = compared(Composition(rock), Composition(crater), systematic=systematic, band_systematic_nm=10).ln_modes
    assert found is not None
    return found


@pytest.mark.parametrize("share", [0.03, 0.3, 0.7])
def test_two_minerals_against_a_grid(share: float) -> None:
    """One share x in 0..1: a truncated normal law times a normal error, and a uniform law, both by quadrature."""
    sigma, systematic = 0.04, 0.08
    rock = Composition(
        {"orthopyroxene": (share, sigma), "clinopyroxene": (1 - share, sigma)}, {}, np.array([[1.0, -1], [-1, 1]])
    )
    crater = Composition({"orthopyroxene": (0.4, 0.2), "clinopyroxene": (0.6, 0.2)}, {}, np.array([[1.0, -1], [-1, 1]]))
    found = compared(rock, crater, systematic=systematic, band_systematic_nm=10).ln_modes
    x = np.linspace(0, 1, 200_001)
    # A systematic of s in each mineral is s / sqrt(2) in the share: the difference counts, the sum is fixed.
    noise = np.hypot(sigma, systematic / np.sqrt(2))
    prior = norm.pdf(x, 0.4, 0.2)
    likelihood = norm.pdf(share, x, noise)
    expected = np.log((prior * likelihood).sum() / prior.sum()) - np.log(likelihood.mean())
    assert found == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("mean", [(0.25, 0.35, 0.40), (0.05, 0.05, 0.90), (0.6, 0.3, 0.1)])
def test_three_minerals_against_a_sum_over_the_triangle(mean: tuple) -> None:
    """Normal laws in the plane of shares that add up to 1, over 250,000 even triangles; twice as fine moves 1e-4."""
    n = 500
    i, j = np.mgrid[:n, :n]
    first = np.column_stack([i[i + j < n], j[i + j < n]]) + 1 / 3
    second = np.column_stack([i[i + j < n - 1], j[i + j < n - 1]]) + 2 / 3
    pair = np.concatenate([first, second]) / n
    shares = np.column_stack([pair, 1 - pair.sum(axis=1)])
    plane = np.array([[1, -1, 0], [1, 1, -2]]) / np.sqrt([[2], [6]])
    seen, noise, scatter = np.array([0.25, 0.35, 0.40]), 0.1**2 * np.eye(3), 0.08**2 * (np.eye(3) - 1 / 3)
    measured = multivariate_normal(plane @ seen, plane @ noise @ plane.T).pdf(shares @ plane.T)
    crater = multivariate_normal(plane @ mean, plane @ scatter @ plane.T).pdf(shares @ plane.T)
    expected = np.log((measured * crater).sum() / crater.sum()), np.log(measured.mean())
    assert ln_shares_crater(seen, noise, np.array(mean), scatter) == pytest.approx(expected[0], abs=0.01)
    assert ln_shares_broad(seen, noise) == pytest.approx(expected[1], abs=0.001)


def test_axes_that_a_covariance_leaves_open_do_not_matter() -> None:
    """Equal variances have no axes of their own: a last digit, or another processor's eigenvectors, turns them."""
    seen, mean, noise = np.array([0.1, 0.2, 0.3, 0.4]), np.array([0.02, 0.1, 0.08, 0.8]), 0.1**2 * np.eye(4)
    rng = np.random.default_rng(0)
    found = []
    for _ in range(5):
        tilt = rng.standard_normal((4, 4))
        found.append(ln_shares_crater(seen, noise + 1e-16 * (tilt + tilt.T), mean, 0.08**2 * np.eye(4)))
    assert np.ptp(found) < 1e-9


def test_four_minerals_any_composition_against_drawn_rocks() -> None:
    rng = np.random.default_rng(2)
    seen, noise = np.array([0.02, 0.1, 0.08, 0.8]), 0.12**2 * np.eye(4)
    broad = rng.dirichlet(np.ones(4), 600_000)
    basis = np.linalg.svd(np.ones((1, 4)))[2][1:]
    kernel = multivariate_normal(basis @ seen, basis @ noise @ basis.T)
    assert ln_shares_broad(seen, noise) == pytest.approx(np.log(kernel.pdf(broad @ basis.T).mean()), abs=0.03)


def test_a_crater_like_the_rock_is_better_and_an_unlike_one_worse_and_precision_sharpens_both() -> None:
    like, unlike = dict(ROCK), {name: ROCK[other] for name, other in zip(ROCK, reversed(ROCK), strict=True)}
    far = {"olivine": (0.9, 0.03), "orthopyroxene": (0.05, 0.03), "clinopyroxene": (0.05, 0.03)}
    assert evidence(ROCK, like) > evidence(ROCK, unlike) > evidence(ROCK, far)
    assert evidence(ROCK, like) > 0 > evidence(ROCK, far)
    assert evidence(ROCK, like, 0.0) > evidence(ROCK, like, 0.2)
    assert evidence(ROCK, far, 0.0) < evidence(ROCK, far, 0.2) < 0


def test_units_of_the_modes_do_not_matter_only_shares_do() -> None:
    """Half a rock of mafics beside plagioclase that the crater's entry does not know."""
    halved = {name: (value / 2, sigma / 2) for name, (value, sigma) in ROCK.items()}
    with_plagioclase = {**halved, "plagioclase": (0.5, 0.02)}
    crater = {"olivine": (0.2, 0.1), "orthopyroxene": (0.5, 0.1), "clinopyroxene": (0.3, 0.1)}
    found = compared(Composition(with_plagioclase), Composition(crater), systematic=0.1, band_systematic_nm=10)
    assert found.minerals == WITH_BANDS[:3]
    assert found.ln_modes == pytest.approx(evidence(ROCK, crater))


def test_an_unknown_composition_says_neither_for_nor_against_and_says_so() -> None:
    found = compared(Composition(ROCK), Composition(), systematic=0.1, band_systematic_nm=10)
    assert (found.ln_modes, found.ln_bands, found.ln_total) == (None, None, 0.0)
    assert "nothing: no mineral" in found.basis


def test_one_mineral_in_common_is_not_compared() -> None:
    crater = {"olivine": (0.2, 0.1), "plagioclase": (0.5, 0.1)}
    found = compared(Composition(ROCK), Composition(crater), systematic=0.1, band_systematic_nm=10)
    assert found.ln_modes is None


def test_minerals_that_one_of_both_lacks_altogether_are_not_divided_by_nothing() -> None:
    crater = {"olivine": (0.0, 0.0), "orthopyroxene": (0.0, 0.0), "plagioclase": (1.0, 0.0)}
    rock = {"olivine": (0.5, 0.1), "orthopyroxene": (0.5, 0.1)}
    found = compared(Composition(rock), Composition(crater), systematic=0.1, band_systematic_nm=10)
    assert found.ln_modes is None


def test_bands_against_a_grid() -> None:
    rock, crater = Composition({}, {"bc1000_nm": (930, 5)}), Composition({}, {"bc1000_nm": (925, 8)})
    found = compared(rock, crater, systematic=0.1, band_systematic_nm=10)
    x = np.linspace(880, 1070, 50_001)
    broad = norm.pdf(930, x, np.hypot(5, 10)).mean()
    wide = np.linspace(700, 1200, 200_001)
    known = (norm.pdf(wide, 925, 8) * norm.pdf(930, wide, np.hypot(5, 10))).sum() * (wide[1] - wide[0])
    assert found.ln_bands == pytest.approx(np.log(known / broad), abs=1e-3)
    assert found.bands == ("bc1000_nm",)
    assert found.ln_modes is None


@pytest.mark.parametrize("systematic", [0.0, 0.1])
def test_a_rock_that_overlaps_with_nothing_has_a_finite_factor(systematic: float) -> None:
    crater = {"olivine": (1.0, 0.0), "orthopyroxene": (0.0, 0.0), "clinopyroxene": (0.0, 0.0)}
    rock = {"olivine": (0.0, 0.001), "orthopyroxene": (0.0, 0.001), "clinopyroxene": (1.0, 0.001)}
    found = evidence(rock, crater, systematic)
    assert np.isfinite(found)
    assert found < -20
