"""Networks of shares: what they see against other code, samplings, parts that are missing, strangers."""

from pathlib import Path

import numpy as np
import pytest

from lunarsci.minerals import WEIGHED
from lunarsci.spectra.abundance.end_members import embedded_end_members
from lunarsci.spectra.abundance.learned import (
    GRID_NM,
    SHARES,
    Background,
    Network,
    below_hull,
    embedded_networks,
    features,
    foretell,
    foretell_each,
    on_grid,
)
from lunarsci.spectra.spectrum import Spectrum

ALL = np.ones((1, 4))
NM = np.arange(450.0, 2451.0, 5.0)
M3_NM = np.concatenate([np.arange(460.0, 700.0, 40.0), np.arange(730.0, 1550.0, 20.0), np.arange(1580.0, 2450.0, 40.0)])


def powder(id: str, wavelength_nm: np.ndarray = NM) -> np.ndarray:
    """An end member on any channels."""
    [own] = [item for item in embedded_end_members(NM) if item.id == id]
    return np.interp(wavelength_nm, own.wavelength_nm, own.reflectance)


def shares(wavelength_nm: np.ndarray, reflectance: np.ndarray, **how: object) -> np.ndarray:
    """(4,) means of one spectrum."""
    found = foretell(wavelength_nm, reflectance[None], ALL, **how)  # type: ignore[arg-type]
    return np.asarray(found.probabilities[0] @ SHARES)


def spread(wavelength_nm: np.ndarray, reflectance: np.ndarray) -> float:
    """Largest standard deviation of a share."""
    found = foretell(wavelength_nm, reflectance[None], ALL).probabilities[0]
    return float(np.sqrt((found @ SHARES**2 - (found @ SHARES) ** 2).max()))


def test_shapes_below_the_hull_are_those_of_a_monotone_chain() -> None:
    ln_reflectance = np.random.default_rng(0).normal(-1.0, 0.3, (6, 40)).cumsum(axis=1) / 10
    for row, found in zip(ln_reflectance, below_hull(ln_reflectance), strict=True):
        nodes: list[int] = []
        values = np.exp(row)
        for k in range(values.size):
            while len(nodes) > 1 and (values[nodes[-1]] - values[nodes[-2]]) * (k - nodes[-2]) <= (
                values[k] - values[nodes[-2]]
            ) * (nodes[-1] - nodes[-2]):
                nodes.pop()
            nodes.append(k)
        assert found == pytest.approx(row - np.log(np.interp(np.arange(40), nodes, values[nodes])), abs=1e-12)


def test_any_sampling_gives_the_channels_of_a_straight_spectrum() -> None:
    wavelength = np.array([448.0, 470.0, 483.0, 540.0, 600.0, 700.0, 730.0])
    weights, there = on_grid(wavelength)
    assert weights[there] @ (2.0 + 3e-3 * wavelength) == pytest.approx(2.0 + 3e-3 * GRID_NM[there], abs=0.031)
    assert set(GRID_NM[there]) == {450, 470, 490, 510, 530, 550, 570, 590, 610, 690, 710, 730}, "not 600 to 700 nm"
    assert weights[~there].sum() == 0


def test_a_network_is_its_layers_written_out() -> None:
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(101 + 101 + 4, 5)), rng.normal(size=(5, 84))
    network = Network(((first[:106], np.ones(5)), (second, np.zeros(84))), np.full(102, 0.1), np.full(102, 2.0), False)
    ln_reflectance, allowed = rng.normal(-1, 0.2, (3, 101)), np.array([[1.0, 1, 0, 1]] * 3)
    found = network.probabilities(features(ln_reflectance, False), allowed)
    x = np.hstack([(features(ln_reflectance, False) - 0.1) / 2.0, allowed])
    power = np.exp((np.maximum(x @ first[:106] + 1, 0) @ second).reshape(3, 4, 21))
    assert found[:, 0] == pytest.approx(power[:, 0] / power[:, 0].sum(axis=-1, keepdims=True), rel=1e-4)
    assert found[:, 2, 0] == pytest.approx(1.0) and found[:, 2, 1:].sum() == pytest.approx(0.0)


def test_what_is_missing_is_drawn_from_the_normal_law() -> None:
    """Mean and covariance of the channels that are not seen, by the inverse of the whole covariance."""
    rng = np.random.default_rng(1)
    law = Background(rng.normal(size=101), rng.normal(size=(4, 101)), np.full(101, 0.3))
    there, noise = np.arange(101) < 60, np.full(60, 0.2)
    seen = rng.normal(size=(2, 60))
    mean, root = law.behind(seen, there, noise)
    whole = law.factors.T @ law.factors + 0.09 * np.eye(101)
    precision = np.linalg.inv(whole)
    precision[np.ix_(there, there)] += np.eye(60) / 0.04
    covariance = np.linalg.inv(precision)
    assert root @ root.T == pytest.approx(covariance, abs=1e-8)
    slope = np.zeros((2, 101))
    slope[:, there] = (seen - law.mean[there]) / 0.04
    assert mean == pytest.approx(law.mean + slope @ covariance, abs=1e-8)


@pytest.mark.parametrize("id", ["AG-TJM-008", "PE-CMP-030", "PP-CMP-021", "AG-TJM-011"])
def test_instruments_with_other_channels_see_the_same_powder(id: str) -> None:
    whole = shares(NM, powder(id))
    assert whole.max() > 0.8
    vnis = np.concatenate([np.arange(450.0, 945.0, 5.0), np.arange(900.0, 2396.0, 5.0) + 1.0])
    for wavelength in (M3_NM, np.sort(vnis), NM[::8], NM[2::10]):
        assert shares(wavelength, powder(id, wavelength)) == pytest.approx(whole, abs=0.15)


def test_what_is_missing_or_noisy_makes_shares_uncertain() -> None:
    reflectance = powder("PE-CMP-030")
    short = NM <= 1000.0
    noisy = foretell(NM, reflectance[None], ALL, np.full((1, NM.size), 0.5)).probabilities[0]
    blurred = float(np.sqrt((noisy @ SHARES**2 - (noisy @ SHARES) ** 2).max()))
    assert spread(NM, reflectance) < min(spread(NM[short], reflectance[short]), blurred)
    nothing = foretell(np.array([300.0, 310.0]), np.full((1, 2), 0.2), ALL)
    assert np.ptp(nothing.probabilities) == 0 and nothing.missing[0] == 1.0


def test_spectra_of_all_kinds_of_channels_are_seen_as_each_alone() -> None:
    masked = np.arange(NM.size) % 50 == 3
    spectra = [
        Spectrum("a", NM, powder("AG-TJM-008")),
        Spectrum("b", M3_NM, powder("PE-CMP-030", M3_NM)),
        Spectrum("c", NM, np.where(masked, 3.0, powder("PP-CMP-021")), mask=masked),
        Spectrum("d", NM, powder("AG-TJM-011"), np.full(NM.size, 0.005)),
    ]
    allowed = np.array([[1.0, 1, 1, 1], [1, 1, 0, 0], [1, 1, 1, 1], [1, 0, 0, 1]])
    together = foretell_each(spectra, allowed)
    for row, spectrum in enumerate(spectra):
        own = foretell_each([spectrum], allowed[row : row + 1])
        assert together.probabilities[row] == pytest.approx(own.probabilities[0], abs=1e-12)
    assert together.probabilities.sum(axis=-1) == pytest.approx(1.0)
    assert together.probabilities[1, 2:, 0] == pytest.approx(1.0)


def test_the_weights_hold_no_spectrum(reference_data: Path) -> None:
    """No row or column of any array, scaled as it may be, is a measured spectrum: none correlates with one above .9."""
    rows = np.loadtxt(reference_data / "spectra/relab/reflectance.csv", delimiter=",", skiprows=1)
    measured = np.log(np.array([np.interp(GRID_NM, rows[:, 0], row) for row in rows[:, 1:].T]))
    measured -= measured.mean(axis=1, keepdims=True)
    measured /= np.linalg.norm(measured, axis=1, keepdims=True)
    networks, law = embedded_networks()
    kept = [network.layers[0][0][:101].T for network in networks]
    for arrays in kept:
        part = arrays - arrays.mean(axis=1, keepdims=True)
        part /= np.linalg.norm(part, axis=1, keepdims=True)
        assert np.abs(part @ measured.T).max() < 0.9
    assert len(law.factors) == 24 < len(measured)
    outputs = {network.layers[-1][1].size for network in networks}
    assert outputs == {len(WEIGHED) * SHARES.size}, "a share of each mineral that is weighed"
