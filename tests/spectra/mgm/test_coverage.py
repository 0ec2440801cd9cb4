"""Intervals hold the truth as often as they say. The full table is `tests/benchmarks/bench_coverage.py`."""

from collections.abc import Callable
from types import ModuleType

import numpy as np
import pytest

from lunarsci.spectra.mgm.model import mgm_model


@pytest.fixture(scope="module")
def bench(load_benchmark: Callable[[str], ModuleType]) -> ModuleType:
    return load_benchmark("bench_coverage")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "assemblage", "noise", "count", "errors"),
    [
        ("profile", "OPX", 0.005, 10, (0.1, 0.06)),
        ("sample", "OPX", 0.01, 5, (0.1, 0.06)),
        pytest.param("profile", "OPX-CPX", 0.005, 40, (0.035, 0.02), marks=pytest.mark.study),
        pytest.param("sample", "OPX", 0.01, 30, (0.035, 0.02), marks=pytest.mark.study),
    ],
)
@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
def test_shares_that_hold_the_truth(
    bench: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    method: str,
    assemblage: str,
    noise: float,
    count: int,
    errors: tuple[float, float],
) -> None:
    """Pyroxenes drawn from their prior; three standard errors of so few spectra are allowed.

    Every third channel with a noise less by the root of three says as much of bands of 100 nm and more as all of them.
    """
    monkeypatch.setattr(bench, "CHANNELS_NM", bench.CHANNELS_NM[::3])
    truth, _, ends, _ = bench.measure(mgm_model(assemblage), noise / np.sqrt(3), count, 1, [method])
    for hits, nominal, most in zip(bench.inside(truth, ends[method]), (0.6827, 0.95), errors, strict=True):
        found, error = bench.share(hits)
        assert error < most, "or the bounds below say nothing"
        assert abs(found - nominal) < 3 * error + 0.01, (method, nominal, found, error)
    assert np.all(np.diff(ends[method][:, :, [2, 0, 1, 3]], axis=2) >= 0), "68 % lies within 95 %"


def test_the_truth_of_the_simulation_follows_the_prior(bench: ModuleType) -> None:
    """Means and standard deviations of centres and widths; strengths half-normal: mean sigma (2 / pi)^1/2."""
    model = mgm_model("OPX")
    rng = np.random.default_rng(0)
    truth = np.array([bench.draw_truth(model, rng) for _ in range(4000)])
    sigma, m = model.sigma[model.degrees :], model.degrees
    assert np.allclose(truth.mean(axis=0)[::3], model.prior[m::3], atol=0.08 * sigma[::3].max())
    assert np.allclose(truth.std(axis=0)[::3], sigma[::3], rtol=0.06)
    assert np.allclose(truth.std(axis=0)[1::3], sigma[1::3], rtol=0.06)
    assert np.allclose(truth.mean(axis=0)[2::3], -sigma[2::3] * np.sqrt(2 / np.pi), rtol=0.06)
