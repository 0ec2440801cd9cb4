"""Unmixing against numerical derivatives, scipy's minimum, dense algebra and mixtures made by other code."""

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from lunarsci.arrays import FloatArray
from lunarsci.errors import DataError, ParameterError
from lunarsci.minerals import WEIGHED
from lunarsci.spectra.abundance.end_members import embedded_end_members
from lunarsci.spectra.abundance.estimate import (
    GAUGE,
    Equations,
    MixtureSeries,
    _posterior,
    _solve,
    estimate_series,
    shares,
    unmix,
)
from lunarsci.spectra.abundance.mixing import (
    SAME_SIEVE,
    UNKNOWN_SIZE,
    Absorbance,
    Albedo,
    GrainSize,
    HapkeSurface,
    MixingLaw,
    Powders,
    Weathering,
    grains,
    iron_absorption,
    loosened,
    population,
)
from lunarsci.spectra.abundance.result import MineralFraction
from lunarsci.spectra.abundance.shares import CalibratedShares, Mixed
from lunarsci.spectra.readers.library import EndMember
from lunarsci.spectra.spectrum import Spectrum

GRID = np.arange(460.0, 2441.0, 20.0)
LAWS: list[MixingLaw] = [Albedo(HapkeSurface()), Absorbance()]
MINERALS = ("olivine", "orthopyroxene", "clinopyroxene")
SHARES = np.array([0.5, 0.3, 0.2])
SEVERAL = np.array([[0.8, 0.2, 0.0], [0.5, 0.3, 0.2], [0.2, 0.3, 0.5], [0.1, 0.8, 0.1]])


NOMINAL = {
    (name, term): level if term != "missing" else 0.0
    for name, level in (("level68", 0.6827), ("level95", 0.95))
    for term in ("alone", "mixed", "series", "missing")
}


def told(found: Mixed, minerals: Sequence[str]) -> list[list[MineralFraction]]:
    """Means and intervals of each spectrum, as drawn."""
    count = len(found.probabilities)
    plain = CalibratedShares(found.probabilities, np.zeros(count), np.ones(count), np.zeros(count))
    ends = np.concatenate(plain.intervals(NOMINAL), axis=-1)
    places = [WEIGHED.index(name) for name in minerals]
    return [[MineralFraction(WEIGHED[k], float(plain.mean[row, k]), *ends[row, k].tolist()) for k in places]
            for row in range(count)]  # fmt: skip


def one(spectrum: Spectrum, minerals: Sequence[str], **options: Any) -> list[MineralFraction]:
    """Fractions of one spectrum."""
    [found] = told(estimate_series([spectrum], minerals, **options), minerals)
    return found


def own() -> dict[str, EndMember]:
    """One end member of each mineral: its first in the table."""
    found: dict[str, EndMember] = {}
    for item in embedded_end_members(np.arange(450.0, 2451.0, 5.0)):
        found.setdefault(str(item.mineral), item)
    return found


def hapke_mixture(end_members: dict[str, EndMember], fractions: FloatArray) -> FloatArray:
    """By bisection for w and the formula written out: incidence 30, emission 0 deg, isotropic."""
    mu0 = np.cos(np.pi / 6)

    def reflectance(w: FloatArray) -> FloatArray:
        g = np.sqrt(1 - w)
        h = [(1 + 2 * x) / (1 + 2 * x * g) for x in (mu0, 1.0)]
        return np.asarray(w / (4 * (mu0 + 1)) * h[0] * h[1])

    mixed = 0.0
    for mineral, share in zip(MINERALS, fractions, strict=True):
        wanted = end_members[mineral].reflectance
        low, high = np.zeros_like(wanted), np.ones_like(wanted)
        for _ in range(60):
            middle = (low + high) / 2
            below = reflectance(middle) < wanted
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        mixed = mixed + share * low
    return reflectance(np.asarray(mixed))


def made(fractions: FloatArray, id: str = "made", noise: float = 0.0) -> Spectrum:
    ends = own()
    reflectance = hapke_mixture(ends, fractions)
    scatter = np.random.default_rng(sum(map(ord, id))).normal(scale=noise, size=reflectance.size)
    return Spectrum(id, ends["olivine"].wavelength_nm, reflectance * np.exp(scatter))


def suite(law: MixingLaw, count: int, *, iron: bool = False, known: FloatArray | None = None) -> MixtureSeries:
    """Of the first mixtures of `SEVERAL`, on `GRID`."""
    library = embedded_end_members(GRID)
    minerals = [loosened(population(name, library, GRID, law), GRID) for name in MINERALS]
    spectra = [made(row) for row in SEVERAL[:count]]
    ln_reflectance = np.array([np.interp(GRID, item.wavelength_nm, np.log(item.reflectance)) for item in spectra])
    fractions = np.full((count, 3), np.nan) if known is None else known
    weathering = Weathering(iron_absorption(GRID)) if iron else None
    held = np.ones((count, 3))
    held[0, 2] = 0
    sigma = np.full_like(ln_reflectance, 0.02)
    return MixtureSeries(Powders(law, minerals), GRID, ln_reflectance, sigma, held, fractions, weathering)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_a_law_undoes_itself_and_has_its_derivatives(law: MixingLaw) -> None:
    reflectance = np.linspace(0.03, 0.85, 40)
    element = law.element(reflectance)
    mixed, slope = law.mixing(element)
    ln_reflectance, by_mixed = law.ln_reflectance(mixed)
    assert np.exp(ln_reflectance) == pytest.approx(reflectance, rel=1e-4)
    ends = [law.ln_reflectance(law.mixing(element + step)[0])[0] for step in (-1e-3, 1e-3)]
    assert by_mixed * slope == pytest.approx((ends[1] - ends[0]) / 2e-3, rel=2e-2)


@pytest.mark.parametrize(
    ("law", "iron", "sizes"),
    [(LAWS[0], False, False), (LAWS[1], False, False), (LAWS[0], True, False), (LAWS[0], False, True)],
)
def test_slopes_and_curvature_are_those_of_the_objective(law: MixingLaw, iron: bool, sizes: bool) -> None:
    """Slopes by differences; the curvature, Gauss-Newton, of the model by differences; grain `sizes` among them."""
    one = suite(law, 3, iron=iron)
    if sizes:
        library = sieved(SIEVES)
        one = replace(one, powders=Powders(law, [loosened(population(n, library, GRID, law), GRID) for n in MINERALS]))
    rng = np.random.default_rng(0)
    shared = rng.normal(scale=0.3, size=one.powders.size)
    start = one.start()
    point = start + rng.normal(scale=0.05, size=start.shape) * np.concatenate(
        [one.sought, np.ones((3, start.shape[1] - 3))], axis=1
    )
    equations = one.equations(shared, point)
    assert equations.value == pytest.approx(one.value(shared, point))
    for k in {*range(0, one.powders.size, 3), *range(one.powders.size - 7, one.powders.size)}:
        step = np.zeros(one.powders.size)
        step[k] = 1e-4
        slope = (one.value(shared + step, point) - one.value(shared - step, point)) / 2e-4
        assert -2 * equations.shared_slope[k] == pytest.approx(slope, rel=0.02, abs=0.3), k
        column = (one.ln_model(shared + step, point) - one.ln_model(shared - step, point)) / 2e-4 / one.sigma_ln
        assert equations.shared[k, k] == pytest.approx(float(np.sum(column**2)) + 1, rel=0.03)
    for j, k in np.ndindex(point.shape):
        step = np.zeros_like(point)
        step[j, k] = 1e-5
        slope = (one.value(shared, point + step) - one.value(shared, point - step)) / 2e-5
        if k >= 3 or one.sought[j, k]:
            assert -2 * equations.local_slope[j, k] == pytest.approx(slope, rel=0.02, abs=0.3), (j, k)


def test_smooth_shapes_stand_beside_all_of_the_end_members() -> None:
    """And are those of the covariance 0.05^2 exp(-d^2 / 2) of places d times 150 nm apart, but for 0.1 % of it."""
    found = population("clinopyroxene", embedded_end_members(GRID), GRID, LAWS[0])
    count, more = len(found.shapes), loosened(found, GRID).shapes
    assert count > 2
    assert more[: count - 1] == pytest.approx(found.shapes[:-1]) and more[-1] == pytest.approx(found.shapes[-1])
    smooth = more[count - 1 : -1]
    wanted = 0.05**2 * np.exp(-0.5 * ((GRID[:, None] - GRID) / 150.0) ** 2)
    left = np.trace(wanted - smooth.T @ smooth) / np.trace(wanted)
    assert 0.0 < left < 1e-3 and np.linalg.eigvalsh(wanted - smooth.T @ smooth).min() > -1e-9


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_the_minimum_is_that_of_scipy(law: MixingLaw) -> None:
    one = suite(law, 2)
    found = unmix(one)
    size, shape = one.powders.size, one.start().shape

    def rows(values: FloatArray) -> FloatArray:
        shared, point = values[:size], values[size:].reshape(shape)
        misfit = (one.ln_reflectance - one.ln_model(shared, point * held)) / one.sigma_ln
        length = np.sum((point * held)[:, :3] ** 2, axis=1) - 1
        return np.concatenate([misfit.ravel(), shared, (point / one.scale).ravel(), length / GAUGE])

    held = np.concatenate([one.present, np.ones((2, shape[1] - 3))], axis=1)
    best = least_squares(rows, np.concatenate([np.zeros(size), one.start().ravel()]))
    assert found.objective == pytest.approx(2 * best.cost, rel=2e-3)
    roots = best.x[size:].reshape(shape)[:, :3] * one.present
    assert found.shares == pytest.approx(shares(roots), abs=0.01)


def test_the_covariance_is_that_of_the_whole_matrix() -> None:
    """Eliminating the spectra's own parameters gives what inverting everything at once gives."""
    one = suite(LAWS[0], 3)
    rng = np.random.default_rng(3)
    shared, point = rng.normal(scale=0.2, size=one.powders.size), one.start(1)
    equations = one.equations(shared, point)
    found = _posterior(one, shared, point, equations)
    size, (count, own_size) = one.powders.size, point.shape
    dense = np.zeros((size + count * own_size,) * 2)
    dense[:size, :size] = equations.shared
    places = [slice(size + j * own_size, size + (j + 1) * own_size) for j in range(count)]
    for j, at in enumerate(places):
        dense[:size, at], dense[at, :size] = equations.across[j], equations.across[j].T
        dense[at, at] = equations.local[j]
    inverse = np.linalg.inv(dense)
    for j, at in enumerate(places):
        free = np.outer(one.sought[j], one.sought[j])
        assert found.covariance[j] == pytest.approx(inverse[at, at][:3, :3] * free)
    scale = np.concatenate([np.ones(size), np.tile(one.scale, count)])
    volume = np.linalg.slogdet(dense * np.outer(scale, scale))[1]
    assert found.ln_evidence == pytest.approx(-0.5 * (equations.value + volume))


@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_a_damped_step_is_that_of_the_whole_matrix(damping: float) -> None:
    """Three spectra of four own parameters and five shared ones; the diagonal is 1 + damping times its own."""
    random = np.random.default_rng(2)
    root, slope = random.normal(size=(17, 40)), random.normal(size=17)
    dense = root @ root.T
    places = [slice(5 + 4 * j, 9 + 4 * j) for j in range(3)]
    for at in places:
        for other in places:
            dense[at, other] *= at == other
    dense += 20.0 * np.eye(17)
    equations = Equations(
        value=0.0,
        shared_slope=slope[:5],
        local_slope=slope[5:].reshape(3, 4),
        shared=dense[:5, :5],
        across=np.array([dense[:5, at] for at in places]),
        local=np.array([dense[at, at] for at in places]),
    )
    shared, own_step = _solve(equations, damping)
    expected = np.linalg.solve(dense + damping * np.diag(np.diag(dense)), slope)
    assert np.concatenate([shared, own_step.ravel()]) == pytest.approx(expected)


@pytest.mark.parametrize("fractions", [SHARES, np.array([0.6, 0.4, 0.0])])
def test_a_mixture_of_the_end_members_themselves_is_found_in_full(fractions: FloatArray) -> None:
    """Made by the same physics written out; the level and the neutral part are free, so a little is lost to them."""
    found = one(made(fractions), MINERALS, method="hapke", end_members=list(own().values()), model_error=0.002)
    assert [item.fraction for item in found] == pytest.approx(fractions, abs=0.03)
    for item, share in zip(found, fractions, strict=True):
        assert item.low95 <= share <= item.high95
        assert share > 0 or (item.low == 0 and item.fraction < 0.02)


def test_known_mixtures_teach_the_powders_of_the_others() -> None:
    """End members of the library are others than those the mixtures were made of."""
    ends = own()
    library = [item for item in embedded_end_members(np.arange(450.0, 2451.0, 5.0)) if item.id != ends["olivine"].id]
    library = [item for item in library if item.id not in {ends[name].id for name in MINERALS}]
    spectra = [made(row, f"mix {number}", noise=0.002) for number, row in enumerate(SEVERAL)]
    known = [
        None if number == 1 else dict(zip(MINERALS, map(float, SEVERAL[number]), strict=True)) for number in range(4)
    ]
    alone = one(spectra[1], MINERALS, end_members=library, method="hapke")
    taught = told(estimate_series(spectra, MINERALS, end_members=library, method="hapke", given=known), MINERALS)
    error = [abs(item.fraction - share) for item, share in zip(taught[1], SEVERAL[1], strict=True)]
    before = [abs(item.fraction - share) for item, share in zip(alone, SEVERAL[1], strict=True)]
    assert max(error) < 0.04 < max(before)
    assert [item.fraction for item in taught[0]] == pytest.approx(SEVERAL[0])


def test_minerals_that_a_spectrum_cannot_hold_are_left_out() -> None:
    spectra = [made(row, f"mix {number}") for number, row in enumerate(SEVERAL)]
    held = [None, ("olivine", "orthopyroxene"), None, None]
    found = told(estimate_series(spectra, MINERALS, present=held), MINERALS)
    assert found[1][2].fraction == 0 and found[1][2].high95 < 0.05, "half a step of the shares that are weighed"
    assert found[0][2].fraction > 0


def test_absorbance_mixes_as_written() -> None:
    ends = own()
    ln_reflectance = sum(share * np.log(ends[name].reflectance) for name, share in zip(MINERALS, SHARES, strict=True))
    spectrum = Spectrum("made", ends["olivine"].wavelength_nm, np.exp(ln_reflectance))
    library = list(ends.values())
    how = {"end_members": library, "model_error": 0.002}
    right, wrong, both = (
        estimate_series([spectrum], MINERALS, method=method, **how) for method in ("absorbance", "hapke", "unmix")
    )
    shares_of = [[item.fraction for item in told(found, MINERALS)[0]] for found in (right, both)]
    assert shares_of[0] == pytest.approx(SHARES, abs=0.03)
    assert wrong.rms_ln[0] > 3 * right.rms_ln[0]
    assert shares_of[1] == pytest.approx(shares_of[0], abs=0.01)


def test_one_end_member_varies_in_level_only() -> None:
    law = LAWS[0]
    single = population("olivine", [own()["olivine"]], GRID, law)
    assert single.shapes.shape == (1, GRID.size)
    assert np.ptp(single.shapes) == 0
    assert single.mean == pytest.approx(
        law.element(np.interp(GRID, own()["olivine"].wavelength_nm, own()["olivine"].reflectance))
    )


def test_a_population_has_the_covariance_of_its_shapes() -> None:
    """Without the level, the leading shapes give back most of the scatter of the end members."""
    law = LAWS[1]
    library = [replace(item, fo=None, fs=None, specimen="") for item in embedded_end_members(GRID)]
    found = population("clinopyroxene", library, GRID, law)
    element = law.element(np.array([item.reflectance for item in library if item.mineral == "clinopyroxene"]))
    apart = element - element.mean(axis=1, keepdims=True)
    shapes = found.shapes[:-1] - found.shapes[:-1].mean(axis=1, keepdims=True)
    explained = (shapes**2).sum() / apart.var(axis=0).sum()
    assert 0.9 < explained <= 1.0 + 1e-9


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
@pytest.mark.parametrize("powder", ["PE-CMP-03[0-2]$", "PP-CMP-02[1-3]$", "Hypersthene_PYX02"])
def test_levels_of_sieved_powders_follow_the_grain_size(law: MixingLaw, powder: str) -> None:
    series = [item for item in embedded_end_members(GRID) if re.match(powder, item.id)]
    level = np.array([law.element(item.reflectance).mean() for item in series])
    size = np.log([(item.min_um + item.max_um) / 2 for item in series if item.max_um and item.min_um is not None])
    assert len(size) == len(series) >= 3
    assert np.polyfit(size, level, 1)[0] == pytest.approx(law.size_exponent, rel=0.3)


@pytest.mark.parametrize("method", ["unmix", "hapke", "absorbance"])
def test_shares_sum_to_one_and_lie_in_their_intervals(method: str) -> None:
    spectrum = made(SHARES, noise=0.005)
    found = one(spectrum, MINERALS, method=method)
    assert sum(item.fraction for item in found) == pytest.approx(1.0)
    for item in found:
        assert 0 <= item.low95 <= item.low <= item.fraction <= item.high <= item.high95 <= 1
    assert one(spectrum, MINERALS, method=method) == found


def test_units_order_and_a_mask_do_not_matter() -> None:
    spectrum = made(SHARES)
    wavelength, reflectance = spectrum.wavelength_nm, spectrum.reflectance
    mask = np.arange(wavelength.size) % 40 == 7
    spoiled = np.where(mask, 3.0, reflectance)
    first = one(Spectrum("a", wavelength[~mask], reflectance[~mask]), MINERALS)
    second = one(Spectrum("a", wavelength, spoiled, mask=mask), MINERALS)
    assert first == second


def test_the_order_of_a_suite_does_not_matter() -> None:
    spectra = [made(row, f"mix {number}") for number, row in enumerate(SEVERAL)]
    forward = told(estimate_series(spectra, MINERALS), MINERALS)
    backward = told(estimate_series(spectra[::-1], MINERALS), MINERALS)[::-1]
    for one, two in zip(forward, backward, strict=True):
        assert [i.fraction for i in one] == pytest.approx([i.fraction for i in two], abs=0.01)


def test_a_spectrum_of_something_else_is_strange() -> None:
    wavelength = own()["olivine"].wavelength_nm
    strange = 0.2 + 0.1 * np.sin(wavelength / 60)
    spectra = [Spectrum("strange", wavelength, strange), made(SHARES)]
    found = [estimate_series([spectrum], MINERALS).strange[0] for spectrum in spectra]
    assert found[0] > 10 * found[1]


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"minerals": ("olivine",)}, ParameterError),
        ({"minerals": ("olivine", "olivine")}, ParameterError),
        ({"minerals": ("olivine", "cheese")}, ParameterError),
        ({"method": "magic"}, ParameterError),
        ({"method": "absorbance", "iron": True}, ParameterError),
        ({"model_error": 0.0}, ParameterError),
        ({"spectra": []}, ParameterError),
        ({"present": [("plagioclase",)]}, ParameterError),
        ({"given": [{"olivine": 0.5, "orthopyroxene": 0.2}]}, DataError),
        ({"given": [{"olivine": 0.5, "plagioclase": 0.5}]}, DataError),
        ({"given": [{"olivine": 1.5, "orthopyroxene": -0.5}]}, DataError),
        ({"spectra": [Spectrum("short", np.arange(800.0, 1200.0, 5), np.full(80, 0.2))]}, DataError),
    ],
)
def test_impossible_requests_are_refused(options: dict[str, object], error: type[Exception]) -> None:
    wavelength = own()["olivine"].wavelength_nm
    arguments: dict[str, object] = {"spectra": [Spectrum("flat", wavelength, np.full(wavelength.size, 0.2))]}
    arguments |= {"minerals": MINERALS} | options
    with pytest.raises(error):
        estimate_series(**arguments)  # type: ignore[arg-type]


def test_spectra_on_other_channels_are_not_taken_together() -> None:
    first = made(SHARES)
    moved = Spectrum("moved", first.wavelength_nm[::8], first.reflectance[::8])
    with pytest.raises(DataError, match="resample"):
        estimate_series([first, moved], MINERALS)


SIEVES = {"olivine": (75.0, 125.0), "orthopyroxene": (30.0, 50.0), "clinopyroxene": (30.0, 50.0)}


def sieved(sieves: dict[str, tuple[float, float]]) -> list[EndMember]:
    """The powders of `made`, with the grain sizes that are stated of them."""
    return [
        replace(item, min_um=sieves[name][0], max_um=sieves[name][1]) if name in sieves else replace(item, max_um=None)
        for name, item in own().items()
        if name in MINERALS
    ]


def of_grains(fractions: FloatArray, sieves: dict[str, tuple[float, float]], id: str) -> Spectrum:
    """A mixture by volume of the sieved powders: a grain of diameter D has the cross-section 1 / D of its volume."""
    weight = fractions / np.array([sum(sieves[name]) / 2 for name in MINERALS])
    return made(weight / weight.sum(), id)


@pytest.mark.parametrize("law", ["hapke", "unmix"])
def test_own_powders_of_unlike_grains_are_found_by_volume(law: str) -> None:
    spectra = [of_grains(row, SIEVES, f"mixture {k}") for k, row in enumerate(SEVERAL)]
    found = told(estimate_series(spectra, MINERALS, method=law, end_members=sieved(SIEVES)), MINERALS)
    for row, item in zip(SEVERAL, found, strict=True):
        for truth, share in zip(row, item, strict=True):
            assert share.fraction == pytest.approx(truth, abs=0.04)
            assert share.low95 <= truth <= share.high95
    library = sieved(dict.fromkeys(SIEVES, (30.0, 50.0)))
    wrong = told(estimate_series(spectra, MINERALS, method=law, end_members=library), MINERALS)
    assert wrong[1][0].high95 < SEVERAL[1, 0], "what the library states must count"


def test_grains_of_which_nobody_stated_the_size_may_be_of_any_usual_one() -> None:
    spectra = [of_grains(row, SIEVES, f"mixture {k}") for k, row in enumerate(SEVERAL)]
    found = told(estimate_series(spectra, MINERALS, end_members=sieved({})), MINERALS)
    for row, item in zip(SEVERAL, found, strict=True):
        for truth, share in zip(row, item, strict=True):
            assert share.low95 <= truth <= share.high95
    assert max(share.high - share.low for share in found[1]) > 0.2
    known = [None, dict(zip(MINERALS, SEVERAL[1], strict=True)), None, None]
    taught = told(estimate_series(spectra, MINERALS, end_members=sieved({}), given=known), MINERALS)
    for row, item in zip(SEVERAL, taught, strict=True):
        assert max(share.high - share.low for share in item) < 0.2, "a mixture of known mode tells the ratio"
        assert [share.fraction for share in item] == pytest.approx(row, abs=0.04)


def test_powders_of_one_sieve_share_what_the_sieve_leaves_open() -> None:
    sieve = GrainSize(0.2, SAME_SIEVE, (0.0, 45.0))
    size, apart = grains([sieve, GrainSize(), sieve, GrainSize(0.4, UNKNOWN_SIZE)])
    covariance = apart @ apart.T
    assert size == pytest.approx([0.2, 0.0, 0.2, 0.4])
    assert np.diag(covariance) == pytest.approx([SAME_SIEVE**2 + 1 / 3, 0, SAME_SIEVE**2 + 1 / 3, UNKNOWN_SIZE**2])
    between = covariance[0, 0] + covariance[2, 2] - 2 * covariance[0, 2]
    assert between == pytest.approx(2 * SAME_SIEVE**2)
