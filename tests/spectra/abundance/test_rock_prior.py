"""The prior of returned rocks: what it is where nothing is seen, calibrated where it holds, left where it does not."""

from pathlib import Path

import numpy as np
import pytest

import lunarsci
from lunarsci.io.tables import table_rows
from lunarsci.spectra.abundance.learned import MINERALS, SHARES
from lunarsci.spectra.abundance.shares import CalibratedShares, drawn_powders, drawn_rocks, posterior, rocks, with_rocks
from lunarsci.spectra.spectrum import Spectrum

ALL = (True,) * 4
LEVELS = {(f"level{level}", "alone"): level / 100 for level in (68, 95)}
LEVELS |= {(f"level{level}", "mixed"): level / 100 for level in (68, 95)}


def seen(shares: np.ndarray, sigma: float) -> np.ndarray:
    """(n, 4, 21) probabilities of spectra that know each share of (n, 4) to within sigma, under the usual shares."""
    power = np.exp(-0.5 * ((SHARES - shares[..., None]) / sigma) ** 2) * drawn_powders(ALL)[1]
    return np.asarray(power / power.sum(axis=-1, keepdims=True))


def test_modes_are_whole_and_classes_count_alike() -> None:
    modes, undivided, weight = rocks()
    assert modes.sum(axis=1) + undivided == pytest.approx(1.0)
    classes = np.array([row["class"] for row in table_rows("lunar_rock_modes.csv")])
    assert {round(float(weight[classes == name].sum()), 9) for name in classes} == {0.2}
    assert len({row["sample"] for row in table_rows("lunar_rock_modes.csv")}) == len(classes) > 100


def test_a_spectrum_that_says_nothing_leaves_the_mean_of_the_classes() -> None:
    modes, undivided, weight = rocks()
    wanted = weight @ np.column_stack([modes[:, 0], modes[:, 1:3].sum(axis=1) + undivided, modes[:, 3]])
    drawn, returned = posterior(np.full((4, 21), 1 / 21), 1.0, ALL)
    found = np.array([drawn[:, 0].mean(), drawn[:, 1:3].sum(axis=1).mean(), drawn[:, 3].mean()])
    assert found == pytest.approx(wanted, abs=0.04)
    assert returned == pytest.approx(0.9), "it stays as assumed"


def test_intervals_of_rocks_from_the_prior_hold_and_are_narrower() -> None:
    """Shares are drawn from the prior and seen with errors of 15 %; then intervals hold what they say, or more."""
    rng = np.random.default_rng(7)
    truth = drawn_rocks(ALL)[rng.choice(len(drawn_rocks(ALL)), 120)]
    own = CalibratedShares(seen(truth + rng.normal(0, 0.15, truth.shape), 0.15), np.zeros(120), np.zeros(120))
    found = with_rocks(own)
    inner, outer = found.intervals(LEVELS)
    held = [((ends[..., 0] <= truth) & (truth <= ends[..., 1])).mean() for ends in (inner, outer)]
    assert 0.66 < held[0] < 0.85 and 0.93 < held[1] <= 1.0
    before, after = (float(((one.mean - truth) ** 2).mean()) for one in (own, found))
    assert after < 0.8 * before
    assert found.returned is not None and np.median(found.returned) > 0.9


def test_a_rock_unlike_all_that_were_returned_keeps_its_shares() -> None:
    """Clinopyroxene alone, well seen; no rock of the table is one."""
    own = CalibratedShares(seen(np.array([[0.0, 0.0, 1.0, 0.0]]), 0.03), np.zeros(1), np.zeros(1))
    found = with_rocks(own)
    assert found.returned is not None and found.returned[0] < 0.1
    assert found.mean[0] == pytest.approx(own.mean[0], abs=0.05)


def test_minerals_that_may_not_be_there_are_not() -> None:
    drawn, _ = posterior(np.full((4, 21), 1 / 21), 1.0, (True, True, False, False))
    assert drawn[:, 2:].max() == 0.0 and drawn.sum(axis=1) == pytest.approx(1.0)


def test_noise_has_the_mean_of_the_prior_out_of_domain() -> None:
    nm = np.arange(450.0, 2451.0, 5.0)
    noise = Spectrum("noise", nm, 0.3 * np.exp(np.random.default_rng(0).standard_normal(nm.size)))
    [found] = lunarsci.unmix(noise, kind="solid-rock", prior="lunar-rocks").shares
    assert found.determined and not found.in_domain and "returned rocks" in found.status
    assert all(item.high95 - item.low95 > 0.3 for item in found.fractions)


@pytest.mark.reference
def test_boulders_of_change_4_come_near_what_others_found_of_one(reference_data: Path) -> None:
    """Lin et al. (2020), 10.1093/nsr/nwz183: plagioclase 48, olivine 14, low-calcium pyroxene 38 %; the paper: OPX 46 %
    of pyroxene, olivine 20-30 %."""
    from lunarsci.io.inputs import read_input
    from lunarsci.spectra.readers import read_spectra

    every = read_spectra(read_input(str(reference_data / "spectra/ce4/reflectance_factor.csv")))
    boulders = [one for one in every if one.id.endswith("rock")]
    width, plagioclase = {}, {}
    for prior in ("powders", "lunar-rocks"):
        shares = lunarsci.unmix(boulders, kind="solid-rock", prior=prior).shares
        each = np.array([[(item.fraction, item.low95, item.high95) for item in one.fractions] for one in shares])
        width[prior] = float(np.median(each[..., 2] - each[..., 1]))
        plagioclase[prior] = float(np.median(each[:, MINERALS.index("plagioclase"), 0]))
        for mineral, share in {"olivine": (0.14, 0.2, 0.3), "plagioclase": (0.48,), "orthopyroxene": (0.38,)}.items():
            ends = each[:, MINERALS.index(mineral), 1:]
            assert all(((ends[:, 0] <= own) & (own <= ends[:, 1])).mean() > 0.85 for own in share), (prior, mineral)
        ratio = [next(item for item in one.ratios if item.mineral == "orthopyroxene_in_pyroxene") for one in shares]
        assert all(item.low95 <= 0.46 <= item.high95 for item in ratio)
    assert width["lunar-rocks"] < 0.8 * width["powders"]
    assert abs(plagioclase["lunar-rocks"] - 0.48) < 0.15 < abs(plagioclase["powders"] - 0.48)
