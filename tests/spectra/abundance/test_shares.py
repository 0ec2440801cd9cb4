"""The two estimates of shares together: calibration by hand, intervals, verdicts, strangers, and the tables behind.

The prior of returned rocks: what it is where nothing is seen, calibrated where it holds, left where it does not.
"""

from pathlib import Path

import numpy as np
import pytest

import lunarsci
from lunarsci.errors import LunarSciWarning
from lunarsci.io.tables import table_rows
from lunarsci.minerals import WEIGHED
from lunarsci.spectra.abundance.end_members import embedded_end_members
from lunarsci.spectra.abundance.kinds import find_kinds, kinds_of_rows
from lunarsci.spectra.abundance.learned import SHARES, Foretold, foretell
from lunarsci.spectra.abundance.shares import (
    LIKELY,
    CalibratedShares,
    Mixed,
    answer,
    calibration,
    drawn_powders,
    drawn_rocks,
    how_dark,
    posterior,
    rocks,
    shares_of_rows,
    sharpened,
    with_rocks,
)
from lunarsci.spectra.spectrum import Spectrum

NM = np.arange(450.0, 2451.0, 5.0)
ONES = np.ones((1, 4))
LEVELS = {(f"level{name}", "alone"): level for name, level in ((68, 0.68), (95, 0.95))} | {
    (f"level{name}", term): 0.0 for name in (68, 95) for term in ("mixed", "missing")
}
AS_IT_IS = {("logit_present", term): float(term == "ln_odds")
            for term in ("constant", "ln_odds", "missing", "ln_odds_missing")}  # fmt: skip


def at(*chances: dict[int, float]) -> np.ndarray:
    """(1, 4, 21) probabilities of shares in steps of 5 %; what is left out is absent."""
    found = np.zeros((1, 4, 21))
    for row, own in zip(found[0], chances, strict=True):
        for step, chance in own.items():
            row[step] = chance
    return found


def calibrated(probabilities: np.ndarray) -> CalibratedShares:
    return CalibratedShares(probabilities, *np.zeros((3, 1)))


def test_means_chances_and_intervals_are_those_of_triangles() -> None:
    found = calibrated(at({8: 0.5, 12: 0.5}, {8: 0.5, 12: 0.5}, {0: 1.0}, {0: 1.0}))
    assert found.mean[0] == pytest.approx([0.5, 0.5, 0.0, 0.0])
    assert found.present(AS_IT_IS)[0] == pytest.approx([1.0, 1.0, 0.0, 0.0], abs=1e-3)
    even = calibrated(at({20: 0.5, 0: 0.5}, {0: 0.5, 20: 0.5}, {0: 1.0}, {0: 1.0}))
    assert even.present(AS_IT_IS)[0, :2] == pytest.approx([0.5, 0.5])
    assert even.present(AS_IT_IS | {("logit_present", "constant"): np.log(3.0)})[0, 0] == pytest.approx(0.75)
    assert found.near() == pytest.approx([1.0])
    inner, outer = found.intervals(LEVELS)
    assert inner[0, 2].tolist() == pytest.approx([0.0, 0.025], abs=0.006), "half a triangle from 0"
    assert outer[0, 0] == pytest.approx([0.36, 0.64], abs=0.01), "both triangles but for their ends"
    wide = calibrated(at({6: 0.5, 14: 0.5}, {6: 0.5, 14: 0.5}, {0: 1.0}, {0: 1.0}))
    assert wide.near() == pytest.approx([0.0], abs=1e-9), "0.3 or 0.7, never within 0.15 of 0.5"


def test_no_interval_has_what_the_others_leave_no_room_for() -> None:
    """A mineral alone, of which 0.6 are thought possible, beside three that have next to nothing."""
    inner, outer = calibrated(at({12: 0.2, 20: 0.8}, *[{0: 0.98, 1: 0.02}] * 3)).intervals(LEVELS)
    for ends in (inner[0], outer[0]):
        least, most = ends.T
        assert least[0] >= 1.0 - most[1:].sum() - 1e-9 > 0.7
        assert (most <= 1.0 - (least.sum() - least) + 1e-9).all()


def test_a_slice_without_a_band_decides_on_no_mineral() -> None:
    """Noise of 5 % that no error states, from 450 to 510 nm, as in spectra of Chang'E-4."""
    few, rng = NM[NM <= 510], np.random.default_rng(0)
    slices = [Spectrum(f"{k}", few, 0.06 * np.exp(0.05 * rng.standard_normal(few.size))) for k in range(20)]
    for one in lunarsci.unmix(slices, kind="solid-rock").shares:
        assert all(0.1 < item.present < 0.9 and item.high95 - item.low95 > 0.95 for item in one.fractions), one.id


def test_sharpness_and_doubt_are_as_written() -> None:
    pooled = at({8: 0.6, 12: 0.4}, {8: 0.4, 12: 0.6}, {0: 1.0}, {0: 1.0})
    terms = {"constant": np.ones(1), "dark": np.full(1, 0.5)}
    known = {("ln_sharpness", "constant"): np.log(2.0), ("ln_sharpness", "dark"): 0.0,
             ("logit_doubt", "constant"): 0.0, ("logit_doubt", "dark"): -2.0 * np.log(3.0)}  # fmt: skip
    found, doubt = sharpened(pooled, np.array([[1.0, 1, 1, 0]]), terms, known)
    assert doubt == pytest.approx([0.25])
    assert found[0, 0, 8] == pytest.approx(0.75 * 0.36 / 0.52 + 0.25 / 21, rel=1e-6)
    assert found[0, 3, 0] == 1.0


def test_end_members_of_the_user_count_alone_and_others_by_their_fit() -> None:
    foretold = Foretold(
        at({20: 1.0}, {0: 1.0}, {0: 1.0}, {0: 1.0}),
        np.array([calibration()["ln_distance", "usual"]]),
        np.zeros(1),
        np.zeros(1),
    )
    other = at({0: 1.0}, {20: 1.0}, {0: 1.0}, {0: 1.0})
    found = {}
    for name, mixed in {
        "fits": Mixed(other, np.full(1, 0.04), np.full(1, 0.005)),
        "misses": Mixed(other, np.full(1, 4.0), np.full(1, 0.06)),
        "own": Mixed(other, np.full(1, 4.0), np.full(1, 0.06), trusted=True),
    }.items():
        found[name] = answer(foretold, ONES, np.full(1, 0.1), np.zeros(1), mixed).weight[0]
    assert found["own"] == 1.0 and found["misses"] < found["fits"] < 1.0
    dark = answer(foretold, ONES, np.full(1, 0.99), np.zeros(1), Mixed(other, np.full(1, 0.04), np.full(1, 0.005)))
    assert dark.weight[0] < 0.02, "mixtures without a dark phase say nothing of a dark rock"


def strangers() -> list[Spectrum]:
    """What holds none of the four minerals, or shows none."""
    x = NM / 1e3
    return [
        *(Spectrum(f"flat {level}", NM, np.full(NM.size, level)) for level in (0.1, 0.3, 0.7)),
        Spectrum("ramp", NM, 0.1 + 0.3 * (NM - 450) / 2000),
        Spectrum("noise", NM, 0.3 * np.exp(0.2 * np.random.default_rng(0).standard_normal(NM.size))),
        Spectrum("ice", NM, 0.9 * np.exp(-2 * np.exp(-50 * (x - 1.5) ** 2) - 3 * np.exp(-50 * (x - 2.0) ** 2))),
        Spectrum("leaf", NM, np.where(NM < 700, 0.05, 0.5)),
        Spectrum("spinel", NM, 0.4 * np.exp(-1.5 * np.exp(-8 * (x - 2.1) ** 2))),
    ]


def test_no_stranger_is_in_domain() -> None:
    for found in lunarsci.unmix(strangers()).shares:
        assert not found.in_domain, found.id
        assert max(item.high95 - item.low95 for item in found.fractions) > 0.4, found.id


def test_pure_powders_are_in_domain_and_shares_hold_together() -> None:
    own = [item for item in embedded_end_members(NM) if item.mineral in WEIGHED][::9]
    found = lunarsci.unmix([Spectrum(item.id, NM, item.reflectance) for item in own])
    right = [one.fractions[WEIGHED.index(str(item.mineral))].fraction > 0.7
             for one, item in zip(found.shares, own, strict=True)]  # fmt: skip
    assert np.mean(right) > 0.8
    for one in found.shares:
        if one.determined:
            assert sum(item.fraction for item in one.fractions) == pytest.approx(1.0)
            for item in one.fractions:
                assert 0 <= item.low95 <= item.low <= item.fraction <= item.high <= item.high95 <= 1
                assert item.low <= item.median <= item.high
                assert item.low < item.fraction < item.high, "no mismatch of a value and its interval"


def test_many_at_once_are_found_as_each_alone() -> None:
    own = [item for item in embedded_end_members(NM) if item.mineral in WEIGHED][::40]
    spectra = [Spectrum(item.id, NM, item.reflectance) for item in own]
    rows = np.array([item.reflectance for item in own])
    allowed = np.ones((len(own), 4))
    _, dark, weathered = kinds_of_rows(NM, rows)
    mean, ends, inside = shares_of_rows(foretell(NM, rows, allowed), allowed, dark, np.zeros(len(own)), weathered)
    for row, one in enumerate(lunarsci.unmix(spectra).shares):
        assert [item.fraction for item in one.fractions] == pytest.approx(mean[row].tolist(), abs=1e-9, nan_ok=True)
        held = [[item.low, item.high, item.low95, item.high95] for item in one.fractions]
        np.testing.assert_allclose(held, ends[row], atol=1e-9)
        assert one.in_domain == inside[row]


def test_shares_of_two_minerals_mirror_each_other_and_one_alone_is_all() -> None:
    item = next(one for one in embedded_end_members(NM) if one.mineral == "orthopyroxene")
    spectrum = Spectrum("a", NM, item.reflectance)
    [two] = lunarsci.unmix(spectrum, assemblage="OL-OPX").shares
    first, second = two.fractions
    assert first.fraction + second.fraction == pytest.approx(1.0)
    assert [first.low, first.high] == pytest.approx([1 - second.high, 1 - second.low], abs=0.011)
    assert [first.low95, first.high95] == pytest.approx([1 - second.high95, 1 - second.low95], abs=0.011)
    [alone] = lunarsci.unmix(spectrum, assemblage="OL").shares
    assert [(one.fraction, one.high95) for one in alone.fractions] == [(1.0, 1.0)]
    assert alone.fractions[0].low95 > 0.94
    assert "only mineral" in alone.status


def test_what_has_no_channel_here_is_not_determined_and_leaves_the_others() -> None:
    whole = Spectrum("whole", NM, next(item.reflectance for item in embedded_end_members(NM)))
    empty, far = Spectrum("empty", NM, np.full(NM.size, np.nan)), Spectrum("far", NM + 4000, np.full(NM.size, 0.3))
    for options in ({}, {"assemblage": "OL-OPX"}, {"assemblage": "OL-OPX", "together": True}):
        found = lunarsci.unmix([whole, empty, far], **options)
        assert [one.determined for one in found.shares] == [True, False, False], options
        assert "empty" in found.untrusted and "far" in found.untrusted


def test_series_without_named_minerals_are_answered_one_by_one() -> None:
    own = [Spectrum(item.id, NM, item.reflectance) for item in embedded_end_members(NM)[:3]]
    with pytest.warns(LunarSciWarning, match="needs the minerals by name"):
        together = lunarsci.unmix(own, together=True)
    alone = lunarsci.unmix(own)
    assert [one.fractions for one in together.shares] == [one.fractions for one in alone.shares]


def test_the_kind_weighs_by_its_probability_and_a_stated_one_is_certain() -> None:
    spectrum = Spectrum("a", NM, next(item.reflectance for item in embedded_end_members(NM)))
    open_one, powder, rock = (
        how_dark(find_kinds([spectrum], kind))[0] for kind in (None, "powder-mixture", "solid-rock")
    )
    assert powder == 0.0 < open_one < rock == 1.0


def test_the_table_of_what_shares_are_worth_keeps_its_promises() -> None:
    """As measured with whole suites left out: precision, and how often intervals hold the minerals that are there."""
    rows = {(row["way"], row["spectra"]): row for row in table_rows("share_validation.csv")}
    both = rows["named", "mixture or meteorite"]
    assert float(both["in_domain_and_good"]) >= 0.55 and float(both["precision"]) >= 0.9
    alone = rows["all", "mixture or meteorite"]
    assert float(alone["in_domain_and_good"]) >= 0.45 and float(alone["precision"]) >= 0.85
    for row in rows.values():
        assert float(row["there95"]) >= 0.9
    assert 0.65 <= float(alone["there68"]) <= 0.75 and float(alone["there95"]) >= 0.93, "of minerals that are there"
    assert 0.5 < LIKELY < 1.0
    assert SHARES[1] == pytest.approx(0.05)


ALL = (True,) * 4


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
    own = CalibratedShares(seen(truth + rng.normal(0, 0.15, truth.shape), 0.15), *np.zeros((3, 120)))
    found = with_rocks(own)
    inner, outer = found.intervals(LEVELS)
    held = [((ends[..., 0] <= truth) & (truth <= ends[..., 1])).mean() for ends in (inner, outer)]
    assert 0.66 < held[0] < 0.85 and 0.93 < held[1] <= 1.0
    before, after = (float(((one.mean - truth) ** 2).mean()) for one in (own, found))
    assert after < 0.8 * before
    assert found.returned is not None and np.median(found.returned) > 0.9


def test_a_rock_unlike_all_that_were_returned_keeps_its_shares() -> None:
    """Clinopyroxene alone, well seen; no rock of the table is one."""
    own = CalibratedShares(seen(np.array([[0.0, 0.0, 1.0, 0.0]]), 0.03), *np.zeros((3, 1)))
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
    from lunarsci.spectra.readers.dispatch import read_spectra

    every = read_spectra(read_input(str(reference_data / "spectra/ce4/reflectance_factor.csv")))
    boulders = [one for one in every if one.id.endswith("rock")]
    width, plagioclase = {}, {}
    for prior in ("powders", "lunar-rocks"):
        shares = lunarsci.unmix(boulders, kind="solid-rock", prior=prior).shares
        each = np.array([[(item.fraction, item.low95, item.high95) for item in one.fractions] for one in shares])
        width[prior] = float(np.median(each[..., 2] - each[..., 1]))
        plagioclase[prior] = float(np.median(each[:, WEIGHED.index("plagioclase"), 0]))
        for mineral, share in {"olivine": (0.14, 0.2, 0.3), "plagioclase": (0.48,), "orthopyroxene": (0.38,)}.items():
            ends = each[:, WEIGHED.index(mineral), 1:]
            assert all(((ends[:, 0] <= own) & (own <= ends[:, 1])).mean() > 0.85 for own in share), (prior, mineral)
        ratio = [next(item for item in one.ratios if item.mineral == "orthopyroxene_in_pyroxene") for one in shares]
        assert all(item.low95 <= 0.46 <= item.high95 for item in ratio)
    assert width["lunar-rocks"] < 0.8 * width["powders"]
    assert abs(plagioclase["lunar-rocks"] - 0.48) < 0.15 < abs(plagioclase["powders"] - 0.48)


def test_minerals_that_the_spectrum_does_not_bear_out_are_not_in_domain() -> None:
    """A mixture of olivine and orthopyroxene is none of plagioclase and clinopyroxene, however sure the answer to these
    two is; a powder of the minerals that are named is in domain."""
    mineral = {item.id: item.reflectance for item in embedded_end_members(NM)}
    spectrum = Spectrum("a", NM, np.sqrt(mineral["AG-TJM-008"] * mineral["PE-CMP-030"]))
    [wrong] = lunarsci.unmix(spectrum, assemblage="CPX-PLG", kind="powder-mixture").shares
    assert not wrong.in_domain and wrong.status.startswith("out of domain: each share is within 15 %")
    pure = Spectrum("b", NM, mineral["PE-CMP-030"])
    [right] = lunarsci.unmix(pure, assemblage="OPX-PLG", kind="powder-mixture").shares
    assert right.in_domain
