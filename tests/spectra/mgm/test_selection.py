"""The evidence against its definition by simulation, the orthant by its closed form, and choices on made spectra."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from lunarsci.errors import ParameterError
from lunarsci.parallel.blocks import computing
from lunarsci.spectra.mgm import selection
from lunarsci.spectra.mgm.assemblages import BandPrior
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.model import mgm_model
from lunarsci.spectra.mgm.result import MgmFailure
from lunarsci.spectra.mgm.selection import (
    CREDIBLE,
    MOST_TOGETHER,
    PENALTY,
    TEMPER,
    Choice,
    EvidencePlace,
    choose,
    ln_all_negative,
)
from lunarsci.spectra.spectrum import Spectrum

GRID = np.arange(450.0, 2396.0, 5.0)
OLIVINE = ((864, 212, 0.25), (1044, 176, 0.30), (1239, 445, 0.45))
ORTHOPYROXENE = ((914, 206, 0.9), (1167, 262, 0.12), (1878, 570, 0.55))
PLAGIOCLASE = ((1245, 445, 0.3),)
FEW = ("OL", "OPX", "CPX", "OL-OPX", "PLG")


def made(*minerals: tuple[tuple[float, float, float], ...], factor: float = 1.0) -> Spectrum:
    ln = np.log(0.25 * factor) + 5e-5 * (GRID - 1500)
    for centre, fwhm, strength in (band for mineral in minerals for band in mineral):
        ln = ln - strength * np.exp(-4 * np.log(2) * ((GRID - centre) / fwhm) ** 2)
    return Spectrum("made", GRID, np.exp(ln), 0.002 * np.exp(ln))


def chosen(spectrum: Spectrum) -> Choice:
    [choice] = choose([spectrum], families=FEW)
    assert isinstance(choice, Choice)
    return choice


def band(mineral: str, loading: float) -> BandPrior:
    return BandPrior(f"{mineral} {loading}", mineral, "um1", "", 1000, 0, 10, 200, 20, 1, "x", strength_loading=loading)


def test_two_strengths_that_go_together() -> None:
    """P(both negative) = 1/4 + arcsin(rho) / (2 pi) (Sheppard 1899), rho the product of the loadings; alone 1/2."""
    assert ln_all_negative([band("a", 0.0)]) == pytest.approx(math.log(0.5))
    rho = 0.9 * 0.8
    both = math.log(0.25 + math.asin(rho) / (2 * math.pi))
    assert ln_all_negative([band("a", 0.9), band("a", 0.8)]) == pytest.approx(both, abs=1e-4)
    assert ln_all_negative([band("a", 0.9), band("a", 0.8), band("b", 0.5)]) == pytest.approx(
        both - math.log(2), abs=1e-4
    )


def test_three_strengths_of_the_table() -> None:
    bands = [b for b in mgm_model("OPX").assemblage.bands if b.mineral == "orthopyroxene"]
    load = np.array([b.strength_loading for b in bands])
    correlation = np.outer(load, load)
    np.fill_diagonal(correlation, 1.0)
    expected = multivariate_normal(cov=correlation).cdf(np.zeros(3))
    assert ln_all_negative(bands) == pytest.approx(math.log(expected), abs=2e-3)


def evidence_and_simulation(depth: float) -> tuple[float, float]:
    """ln evidence of the plagioclase model without a continuum (nothing flat) for four bands times `depth`, at an error
    of 0.3, and ln of the mean likelihood of 400,000 draws from the prior, whose own error is below 0.02."""
    model = mgm_model("PLG", "none")
    grid = np.arange(500.0, 2000.0, 25.0)
    bands = ((1240, 440, 0.35), (640, 175, 0.2), (480, 150, 0.15), (340, 250, 0.3))
    ln = -depth * sum(s * np.exp(-4 * np.log(2) * ((grid - centre) / fwhm) ** 2) for centre, fwhm, s in bands)
    [fit] = fit_spectra([Spectrum("made", grid, np.exp(ln), 1e-6 * np.exp(ln))], model, model_error=0.3)
    normal, likelihood = np.random.default_rng(0).standard_normal((400_000, model.prior.size)), 0.0
    for draws in np.split(model.prior + normal * model.sigma, 100):
        curves = np.zeros((len(draws), grid.size))
        for k in range(0, model.prior.size, 3):
            x = (grid / 1e3 - draws[:, k, None]) / draws[:, k + 1, None]
            curves -= np.abs(draws[:, k + 2, None]) * np.exp(-4 * np.log(2) * x**2)
        chi2 = (fit.data.weight * (ln - curves) ** 2).sum(axis=1)
        likelihood += np.exp(-0.5 * chi2).mean() / 100
    place = EvidencePlace.at(fit.parameters, fit.model, fit.data, np.diag(np.sqrt(fit.data.weight)))
    return place.ln_evidence(), float(np.log(likelihood))


def test_evidence_is_the_mean_of_the_likelihood_over_the_prior() -> None:
    """With bands that the data tell, where Laplace's approximation holds."""
    laplace, simulated = evidence_and_simulation(3.0)
    assert laplace == pytest.approx(simulated, abs=0.06)


def test_evidence_of_bands_within_their_errors_of_zero_is_a_little_off() -> None:
    """What the documentation says of strengths at their bound: 0.1-0.4."""
    laplace, simulated = evidence_and_simulation(1.0)
    assert 0.1 < abs(laplace - simulated) < 0.4


@pytest.mark.parametrize(
    ("minerals", "expected"),
    [((OLIVINE,), "OL"), ((ORTHOPYROXENE,), "OPX"), ((OLIVINE, ORTHOPYROXENE), "OL-OPX"), ((PLAGIOCLASE,), "PLG")],
)
def test_made_minerals_are_recognised(
    minerals: tuple[tuple[tuple[float, float, float], ...], ...], expected: str
) -> None:
    assert chosen(made(*minerals)).assemblage == expected


def test_margins_are_those_of_the_candidates() -> None:
    choice = chosen(made(OLIVINE))
    best, second = choice.candidates[:2]
    assert [c.score for c in choice.candidates] == sorted((c.score for c in choice.candidates), reverse=True)
    for candidate in choice.candidates:
        minerals = candidate.assemblage.count("-") + 1
        assert candidate.score == pytest.approx(TEMPER * candidate.ln_evidence - PENALTY * minerals)
    assert choice.margin == pytest.approx(best.score - second.score)
    assert choice.margin_ln_evidence == pytest.approx(best.ln_evidence - second.ln_evidence)
    assert choice.margin_bic == pytest.approx(second.bic - best.bic)
    assert choice.status == choice.to_dict()["status"], "one verdict only"


def test_a_family_holds_the_probability_and_no_more() -> None:
    choice = chosen(made(OLIVINE))
    each = [c.probability for c in choice.candidates]
    assert sum(each) == pytest.approx(1)
    assert each[1] / each[0] == pytest.approx(math.exp(-choice.margin))
    size = len(choice.family)
    assert choice.family == tuple(c.assemblage for c in choice.candidates[:size])
    assert sum(each[: size - 1]) < CREDIBLE <= sum(each[:size])
    shared = set.intersection(*(set(name.split("-")) for name in choice.family))
    assert choice.strong == (bool(shared) and size <= MOST_TOGETHER)
    assert choice.minerals["olivine"] == pytest.approx(
        sum(c.probability for c in choice.candidates if "OL" in c.assemblage)
    )


def test_errors_that_hang_together_count_as_few() -> None:
    """A smooth ripple of 1 % that lasts over 100 nm is no mineral."""
    clean = made(ORTHOPYROXENE)
    ripple = 0.01 * np.sin(2 * np.pi * GRID / 200)
    bent = Spectrum("bent", GRID, clean.reflectance * np.exp(ripple), 0.002 * clean.reflectance)
    assert chosen(bent).assemblage == chosen(clean).assemblage == "OPX"


def test_a_factor_of_the_reflectance_does_not_matter() -> None:
    first, second = chosen(made(ORTHOPYROXENE)), chosen(made(ORTHOPYROXENE, factor=0.3))
    assert first.assemblage == second.assemblage
    assert first.margin == pytest.approx(second.margin, abs=0.02)


def test_a_flat_spectrum_decides_nothing() -> None:
    flat = Spectrum("flat", GRID, np.full(GRID.size, 0.1), np.full(GRID.size, 1e-3))
    choice = chosen(flat)
    assert not choice.strong
    assert choice.status.startswith("no mineral is sure")


def test_order_failures_and_plain_output() -> None:
    few = Spectrum("few", GRID[:20], np.full(20, 0.1))
    done: list[tuple[int, int]] = []
    results = choose([few, made(OLIVINE)], families=("OL", "OPX"), progress=lambda *now: done.append(now))
    assert isinstance(results[0], MgmFailure)
    assert "20 usable channels" in results[0].status
    assert results[1].to_dict()["assemblage"] == "OL"
    assert done == [(0, 2), (2, 2)]


def test_a_choice_that_was_stopped_goes_on_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 40 spectra, far fewer than a block of fits, those done before a stop are not compared again."""
    spectra = [made(OLIVINE, factor=1.0 + 0.01 * k) for k in range(40)]
    whole = choose(spectra, families=("OL", "OPX"))
    counted: list[int] = []

    def counting(*arguments: Any, **options: Any) -> Any:
        counted.append(1)
        if len(counted) == 33:
            raise KeyboardInterrupt
        return scores(*arguments, **options)

    scores = selection._scores
    monkeypatch.setattr(selection, "_scores", counting)
    with pytest.raises(KeyboardInterrupt), computing(keep=tmp_path / "a.csv", workers=1):
        choose(spectra, families=("OL", "OPX"))
    before, counted[:] = len(counted), [0] * 100
    with computing(keep=tmp_path / "a.csv", workers=1):
        again = choose(spectra, families=("OL", "OPX"))
    # Two blocks of 16 were done; the second may not have reached the disk.
    assert before == 33 and len(counted) - 100 in (40 - 32, 40 - 16)
    plain = [[one.to_dict() if isinstance(one, Choice) else one for one in some] for some in (whole, again)]
    assert plain[0] == plain[1] and not (tmp_path / "a.csv.partial").exists()


@pytest.mark.parametrize(
    "options", [{"families": ("OL",)}, {"families": ("OL", "ol")}, {"model_error": 0.0}, {"starts": -1}]
)
def test_impossible_options_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(ParameterError):
        choose([made(OLIVINE)], **options)
