"""Shares of minerals and their errors, against random draws."""

import numpy as np
import pytest

from lunarsci.errors import ParameterError
from lunarsci.spectra.origin.composition import Composition, _scaled, closed

MODES = {"olivine": (0.14, 0.02), "orthopyroxene": (0.38, 0.02), "plagioclase": (0.48, 0.03)}


def test_shares_are_those_of_draws() -> None:
    composition = Composition(MODES)
    mean, covariance = composition.shares(("olivine", "orthopyroxene"))
    rng = np.random.default_rng(0)
    draws = rng.normal([0.14, 0.38], 0.02, (200_000, 2))
    draws /= draws.sum(axis=1, keepdims=True)
    assert mean == pytest.approx(draws.mean(axis=0), abs=1e-3)
    assert covariance == pytest.approx(np.cov(draws.T), rel=0.02)
    assert mean.sum() == pytest.approx(1)
    assert np.abs(covariance.sum(axis=0)).max() < 1e-12


def test_correlated_modes() -> None:
    """Two modes that err oppositely by s: their share errs by s as well."""
    opposite = np.array([[1.0, -1.0], [-1.0, 1.0]])
    composition = Composition({"orthopyroxene": (0.46, 0.06), "clinopyroxene": (0.54, 0.06)}, {}, opposite)
    mean, covariance = composition.shares(("orthopyroxene", "clinopyroxene"))
    assert mean == pytest.approx([0.46, 0.54])
    assert np.sqrt(covariance[0, 0]) == pytest.approx(0.06)
    swapped = composition.shares(("clinopyroxene", "orthopyroxene"))
    assert swapped[0] == pytest.approx([0.54, 0.46])


@pytest.mark.parametrize(
    ("modes", "said"),
    [
        ({"olivine": (1.3, 0.1), "plagioclase": (0.1, 0.1)}, "a mode is a fraction from 0 to 1"),
        ({"olivine": (-0.1, 0.1), "plagioclase": (0.1, 0.1)}, "a mode is a fraction from 0 to 1"),
        ({"olivine": (float("nan"), 0.1), "plagioclase": (0.1, 0.1)}, "a mode is a fraction"),
        ({"olivine": (0.8, 0.1), "plagioclase": (0.5, 0.1)}, "modes add up to 1.3"),
        ({"olivine": (0, 0.1), "plagioclase": (0, 0.1)}, "more than 0"),
        ({"olivine": (0.8, -0.1), "plagioclase": (0.1, 0.1)}, "error of olivine"),
        ({"olivine": (0.8, 0.1)}, "olivine alone is no share"),
        ({"ilmenite": (0.8, 0.1), "olivine": (0.1, 0.1)}, "'ilmenite' is no mineral here"),
    ],
)
def test_impossible_modes_are_refused(modes: dict, said: str) -> None:
    with pytest.raises(ParameterError, match=said):
        Composition(modes)


@pytest.mark.parametrize(
    ("bands", "said"),
    [
        ({"bc1000_nm": (0.93, 0.01)}, "it must be 700 to 1300 nm"),
        ({"bc1000_nm": (930, 0)}, "must be above 0"),
        ({"bc2000_nm": (930, 5)}, "1500 to 2600"),
        ({"bc3000_nm": (3000, 5)}, "is no band here"),
    ],
)
def test_impossible_bands_are_refused(bands: dict, said: str) -> None:
    with pytest.raises(ParameterError, match=said):
        Composition({}, bands)


@pytest.mark.parametrize("matrix", [np.eye(2), np.full((3, 3), np.nan), 2 * np.eye(3), np.array(3 * [[1, 2, 2]])])
def test_impossible_correlations_are_refused(matrix: np.ndarray) -> None:
    with pytest.raises(ParameterError, match="correlation"):
        Composition(MODES, {}, matrix)


def test_nothing_cannot_be_shared() -> None:
    with pytest.raises(ParameterError, match="nothing to compare"):
        closed(np.zeros(3), np.eye(3))


def test_modes_are_scaled_only_where_they_add_up_to_too_much() -> None:
    few = {"olivine": (0.3, 0.1), "plagioclase": (0.4, 0.1)}
    assert _scaled(few) == few
    many = {"olivine": (0.9, 0.1), "plagioclase": (0.6, 0.1)}
    assert _scaled(many) == {"olivine": pytest.approx((0.6, 0.1)), "plagioclase": pytest.approx((0.4, 0.1))}
