"""Shares of spectra taken one by one: what is dark, what is not determined, and libraries without siblings."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lunarsci.spectra_data import make_abundance_calibration as script

from lunarsci.errors import ParameterError
from lunarsci.spectra.abundance.band_depth import depth_at_1um, too_shallow
from lunarsci.spectra.abundance.end_members import embedded_end_members, without_siblings
from lunarsci.spectra.abundance.kinds import find_kind
from lunarsci.spectra.abundance.mixing import HapkeSurface
from lunarsci.spectra.abundance.one_by_one import MAFIC, estimate_each
from lunarsci.spectra.abundance.posterior import (
    CHONDRITE,
    DARK,
    MOST_MISFIT,
    MOST_WIDE,
    POWDER,
    Discrepancy,
    calibrations,
)
from lunarsci.spectra.spectrum import Spectrum

NM = np.arange(450.0, 2451.0, 10.0)
ALL = (*MAFIC, "plagioclase")
SURFACE = HapkeSurface()


def mixed(parts: dict[str, float], opaque: float = 0.0) -> Spectrum:
    """Albedos of end members mixed by a loop over them, with a flat albedo of 0.1 in part of the cross-section."""
    library = {item.id: item.reflectance for item in embedded_end_members(NM)}
    albedo = sum(share * SURFACE.albedo(library[id]) for id, share in parts.items())
    return Spectrum("made", NM, SURFACE.reflectance((1 - opaque) * np.asarray(albedo) + opaque * 0.1))


BRIGHT = {"AG-TJM-008": 0.5, "PE-CMP-030": 0.3, "PP-CMP-021": 0.2}
TRUTH = (0.5, 0.3, 0.2, 0.0)


def test_shares_of_a_made_mixture_lie_in_their_intervals() -> None:
    [found] = estimate_each([mixed(BRIGHT)], ALL, kinds=[find_kind(mixed(BRIGHT), POWDER)])
    for item, share in zip(found.fractions, TRUTH, strict=True):
        assert item.low95 <= share <= item.high95
        assert item.high > item.low
    assert sum(item.low for item in found.fractions) < 1 < sum(item.high for item in found.fractions)


def test_own_powders_count_by_their_grain_size() -> None:
    """A mixture by cross-section of an olivine of 100 um and pyroxenes of 40 um, as the library states or does not."""
    own = [item for item in embedded_end_members(NM) if item.id in BRIGHT]
    coarse = [replace(item, min_um=75.0 if item.id == "AG-TJM-008" else 30.0,
                      max_um=125.0 if item.id == "AG-TJM-008" else 50.0) for item in own]  # fmt: skip
    spectrum, kinds = mixed(BRIGHT), [find_kind(mixed(BRIGHT), POWDER)]
    volume = np.array([0.5 * 100, 0.3 * 40, 0.2 * 40])
    [told] = estimate_each([spectrum], MAFIC, kinds=kinds, end_members=coarse)
    for item, share in zip(told.fractions, volume / volume.sum(), strict=True):
        assert item.fraction == pytest.approx(share, abs=0.05)
    unknown = [replace(item, min_um=None, max_um=None) for item in own]
    [found] = estimate_each([spectrum], MAFIC, kinds=kinds, end_members=unknown)
    assert not found.in_domain
    assert "no grain size (min_um, max_um) of olivine, orthopyroxene, clinopyroxene" in found.status
    assert all(
        item.low95 <= share <= item.high95 for item, share in zip(found.fractions, volume / volume.sum(), strict=True)
    )


def test_a_dark_phase_is_found_and_does_not_become_plagioclase() -> None:
    """A third of opaque cross-section; before, what is dark and flat came out as plagioclase."""
    bright, dark = (
        estimate_each([spectrum], ALL, kinds=[find_kind(spectrum, DARK)])[0]
        for spectrum in (mixed(BRIGHT), mixed(BRIGHT, opaque=0.33))
    )
    assert bright.dark is not None
    assert dark.dark is not None
    assert dark.dark.phases["none"] < 0.2 < bright.dark.phases["none"]
    assert dark.dark.share > 2 * bright.dark.share
    assert dark.fractions[3].low < 0.2
    assert dark.fractions[0].low95 <= TRUTH[0] <= dark.fractions[0].high95


def test_a_solid_rock_has_ratios_and_no_plagioclase() -> None:
    spectrum = mixed(BRIGHT, opaque=0.2)
    [found] = estimate_each([spectrum], ALL, kinds=[find_kind(spectrum, "solid-rock")])
    assert not found.in_domain
    assert "not calibrated on rocks" in found.status
    assert np.isnan(found.fractions[3].fraction)
    assert [item.mineral for item in found.ratios] == ["olivine_in_mafic", "orthopyroxene_in_pyroxene"]
    assert all(0 <= item.low95 <= item.low < item.high <= item.high95 <= 1 for item in found.ratios)


def test_no_powder_of_a_specimen_is_left_beside_its_siblings() -> None:
    library = embedded_end_members(NM)
    kept = without_siblings(library, ["PE-CMP-030"])
    gone = {item.id for item in library} - {item.id for item in kept}
    assert {"PE-CMP-030", "PE-CMP-032", "PE-CMP-034-A", "PE-CMP-006"} <= gone
    assert {item.specimen for item in kept}.isdisjoint(item.specimen for item in library if item.id in gone)


def test_end_members_are_filed_by_their_bands() -> None:
    """Pigeonites of Wo 8-19 whose bands are those of orthopyroxene; bronzites with impossible analyses have none."""
    found = {item.id: item for item in embedded_end_members(NM)}
    assert {found[id].mineral for id in ("PX-EAC-009", "PP-EAC-042")} == {"orthopyroxene"}
    assert found["PE-CMP-040-A"].fs is None
    known = [item.fs for item in found.values() if item.mineral == "orthopyroxene" and item.fs is not None]
    assert min(known) < 0.1
    assert max(known) > 0.6


def test_no_level_is_claimed_beyond_what_suites_support() -> None:
    assert set(calibrations()) == {POWDER, DARK, CHONDRITE}
    for known in calibrations().values():
        assert known.certified == pytest.approx(1 - 1 / (len(known.suites) + 1))
        assert 0.6 <= known.held68 <= 0.8
        assert known.held95 >= 0.89
        assert known.precision >= 0.8
        assert 0 < known.factor68 < known.factor95


@pytest.mark.parametrize("minerals", [("olivine",), ("olivine", "olivine"), ("olivine", "glass")])
def test_impossible_requests_are_refused(minerals: tuple[str, ...]) -> None:
    with pytest.raises(ParameterError):
        estimate_each([mixed(BRIGHT)], minerals, kinds=[find_kind(mixed(BRIGHT), POWDER)])


def test_nothing_of_a_suite_is_in_the_library_that_judges_it() -> None:
    library = embedded_end_members(NM)
    for suite, (minerals, powders) in script.MIXTURES.items():
        kept = without_siblings(library, powders)
        assert set(powders) <= {item.id for item in library}, suite
        assert not [item.id for item in kept if item.id.startswith(suite) or item.id in powders]
        assert {item.mineral for item in kept} >= set(minerals)


@pytest.mark.reference
def test_olivine_and_orthopyroxene_never_become_clinopyroxene(reference_data: Path) -> None:
    """Mixtures of 38-53 um with clinopyroxene named beside them, nothing of their powders in the library."""
    spectra, rows = script.spectra_of(reference_data / "spectra/minerals")
    some = [spectrum for spectrum in spectra if spectrum.id.startswith("pomix2")]
    powders = script.MIXTURES["pomix"][1]
    found = [script.case(item, rows, "pomix", MAFIC, POWDER, powders) for item in some]
    error = 100 * np.sqrt(np.mean([one.error**2 for one in found], axis=0))
    assert error[2] <= 10
    assert error.max() <= 14
    assert MOST_WIDE < 0.15


def test_a_discrepancy_varies_as_its_parts_say() -> None:
    """At 450, 570 and 1450 nm: 1 um and 0.88 um before the middle of the range, and at it; term by term by hand.

    The details at 450 and 570 nm, one length of 120 nm apart, are alike by exp(-1/2); the edge falls by exp(-1.2).
    """
    found = Discrepancy(level=0.1, slope=0.2, bend=0.3, detail=0.04, channel=0.03, edge=0.5).covariance(
        np.array([450.0, 570.0, 1450.0])
    )
    square = (1.0 + 0.88**2) / 3
    bends = 1.0 - square, 0.88**2 - square, -square
    first = 0.01 + 0.04 * 1.0 + 0.09 * bends[0] ** 2 + 0.0016 + 0.25 + 0.0009
    between = 0.01 + 0.04 * 0.88 + 0.09 * bends[0] * bends[1] + (0.0016 + 0.25 * math.exp(-1.2)) * math.exp(-0.5)
    last = 0.01 + 0.09 * bends[2] ** 2 + 0.0016 + 0.25 * math.exp(-20.0) + 0.0009
    assert found[0, 0] == pytest.approx(first, rel=1e-9)
    assert found[0, 1] == found[1, 0] == pytest.approx(between, rel=1e-9)
    assert found[2, 2] == pytest.approx(last, rel=1e-9)
    assert found[0, 2] == pytest.approx(0.01 + 0.09 * bends[0] * bends[2], rel=1e-9)


def test_what_a_mixture_misses_is_told_beside_level_and_slope() -> None:
    """A third as bright and redder: neither is a mineral's, and comparison allows for both."""
    plain, spectrum = mixed(BRIGHT, opaque=0.2), mixed(BRIGHT, opaque=0.2)
    darker = Spectrum("darker", NM, spectrum.reflectance * np.exp(-1.1 + 0.3 * (NM / 1e3 - 1.45)))
    one, other = (
        estimate_each([item], ALL, kinds=[find_kind(item, "solid-rock")])[0].rms_ln for item in (plain, darker)
    )
    assert one is not None and other is not None
    assert one < 0.02
    assert other < 0.12


def orthopyroxene(edge: float, bend: float = 0.0) -> Spectrum:
    """Gaussians in ln R of an orthopyroxene alone, and an edge in the ultraviolet; `bend`: a band of no mineral."""
    parts = ((920, 75, 0.7), (1850, 190, 0.5), (350, 70, edge), (1500, 60, bend))
    ln_reflectance = sum(-depth * np.exp(-0.5 * ((NM - center) / width) ** 2) for center, width, depth in parts)
    return Spectrum("opx", NM, 0.5 * np.exp(ln_reflectance))


@pytest.mark.parametrize("edge", [0.5, 1.5, 2.5])
def test_an_edge_in_the_ultraviolet_makes_no_other_mineral(edge: float) -> None:
    """Of a pure orthopyroxene without the band at 1160 nm an edge of 2.5 had made a third other minerals, in domain."""
    pure, plain = orthopyroxene(edge), mixed({"PE-CMP-030": 0.8, "AG-TJM-008": 0.2})
    [found] = estimate_each([pure], MAFIC, kinds=[find_kind(pure, POWDER)])
    assert not found.determined or found.fractions[1].high95 == 1.0
    bent = Spectrum("bent", NM, plain.reflectance * np.exp(-edge * np.exp(-0.5 * ((NM - 350) / 70) ** 2)))
    one, other = (estimate_each([item], MAFIC, kinds=[find_kind(item, POWDER)])[0].fractions for item in (plain, bent))
    for first, second, share in zip(one, other, (0.2, 0.8, 0.0), strict=True):
        assert second.low95 <= share <= second.high95
        assert second.fraction == pytest.approx(first.fraction, abs=0.1)


def test_a_spectrum_that_no_mixture_has_gets_no_shares() -> None:
    spectrum = orthopyroxene(1.0, bend=0.6)
    [found] = estimate_each([spectrum], MAFIC, kinds=[find_kind(spectrum, POWDER)])
    assert not found.in_domain
    assert not found.determined
    assert all((item.low95, item.high95) == (0.0, 1.0) for item in found.fractions)
    assert found.status.startswith("not determined: contradicted by the spectrum")
    near = float(found.status.partition("most near ")[2].partition(" nm")[0])
    assert near == pytest.approx(1500, abs=60)
    assert "darker" in found.status
    assert "spectra fit --assemblage auto" in found.status
    assert found.rms_ln is not None


def test_ratios_of_which_a_rock_says_little_are_not_named() -> None:
    """Bands of 3 %, as those of norite 78235, against bands of half the light."""
    shallow, deep = (
        Spectrum("rock", NM, 0.3 * (orthopyroxene(0.5).reflectance / 0.5) ** power) for power in (0.05, 1.0)
    )
    one, other = (
        estimate_each([item], ALL, kinds=[find_kind(item, "solid-rock")])[0].ratios[0] for item in (shallow, deep)
    )
    assert np.isnan(one.fraction)
    assert (one.low95, one.high95) == (0.0, 1.0)
    assert other.fraction < 0.1
    assert other.high95 < 0.3


@pytest.mark.parametrize(("depth", "told"), [(0.0, False), (0.02, False), (0.5, True)])
def test_without_an_absorption_there_are_no_shares(depth: float, told: bool) -> None:
    """A straight line had 57 % olivine, in domain."""
    noise = 0.001 * np.random.default_rng(3).standard_normal(NM.size)
    line = (0.1 + 0.00001 * NM) * np.exp(-depth * np.exp(-0.5 * ((NM - 1000) / 100) ** 2)) + noise
    assert (too_shallow(Spectrum("line", NM, line)) == "") is told
    if not told:
        [found] = estimate_each([Spectrum("line", NM, line)], MAFIC)
        assert not found.determined and not found.in_domain
        assert found.status.startswith("not determined: no absorption near 1 um deep enough")


def test_the_depth_near_1_um_and_its_error_by_hand() -> None:
    """ln R on a line at 750 and 1060 nm, 0.25 below it at 940 nm, and 0.05 below it from 1180 nm on.

    The line between the first two lies highest. At 940 nm, 190 of 310 nm on, the error is that of the dip and 19/31 of
    that at 1060 nm; each holds that of the level, as features are relative to it. Errors of windows of 11 and 12
    channels.
    """
    nm = NM[NM != 1000.0]
    middle = np.select(
        [nm < 850, nm < 1000, nm < 1150, nm < 1400, nm < 1700, nm < 2100], [750, 940, 1060, 1250, 1525, 1955], 2300
    )
    ln = -1.5 + 2e-4 * (middle - 750.0) - 0.25 * (middle == 940) - 0.05 * (middle > 1060)
    found = depth_at_1um(Spectrum("steps", nm, np.exp(ln), np.full(nm.size, 0.003)))
    level, dip, right = (
        0.003 / np.exp(own) / np.sqrt(count) for own, count in ((-1.5, 11), (-1.5 + 0.038 - 0.25, 12), (-1.438, 12))
    )
    sigma = np.sqrt(dip**2 + level**2 + (19 / 31) ** 2 * (right**2 + level**2))
    assert found == pytest.approx((0.25, sigma))
    # Tops of 0.1 at 1060 and 1525 nm, between which 0.2 are missing at 1250 nm, 190 of 465 nm on.
    ln = -1.5 + 0.1 * np.isin(middle, [1060, 1525]) - 0.2 * (middle == 1250)
    found = depth_at_1um(Spectrum("tops", nm, np.exp(ln), np.full(nm.size, 0.003)))
    left, dip, right = (0.003 / np.exp(own) / np.sqrt(n) for own, n in ((-1.4, 12), (-1.7, 15), (-1.4, 16)))
    parts = np.hypot([dip, left, right], level) * [1.0, 275 / 465, 190 / 465]
    assert found == pytest.approx((0.3, np.sqrt((parts**2).sum())))


def test_a_rock_like_a_chondrite_gets_no_ratio_of_that_class() -> None:
    """Orthopyroxene and something flat and dark, without olivine: it had 45-57 % of it."""
    library = {item.id: item.reflectance for item in embedded_end_members(NM)}
    albedo = 0.12 * SURFACE.albedo(library["PE-CMP-030"]) + 0.88 * 0.1
    rock = Spectrum("rock", NM, SURFACE.reflectance(albedo))
    [found] = estimate_each([rock], MAFIC, kinds=[find_kind(rock, "solid-rock")])
    olivine = found.ratios[0]
    assert np.isnan(olivine.fraction) or olivine.low95 == 0.0
    assert (olivine.low95, olivine.high95) == (0.0, 1.0)


@pytest.mark.parametrize("plagioclase", [0.3, 0.5])
def test_a_dark_powder_like_a_chondrite_gets_no_olivine_to_be_quoted(plagioclase: float) -> None:
    """Orthopyroxene, plagioclase and something flat and dark, without olivine: it had 20-80 % of it, in domain."""
    library = {item.id: SURFACE.albedo(item.reflectance) for item in embedded_end_members(NM)}
    bright = (1 - plagioclase) * library["PE-CMP-030"] + plagioclase * library["AG-TJM-011"]
    powder = Spectrum("norite", NM, SURFACE.reflectance(0.7 * bright + 0.3 * 0.15))
    [found] = estimate_each([powder], MAFIC)
    assert "it looks like an ordinary chondrite" in found.status
    assert not found.in_domain


@pytest.mark.reference
def test_olivine_of_chips_of_known_modes_lies_in_its_interval_or_is_open(reference_data: Path) -> None:
    """Chips and slabs of meteorites, and norite 78235, which holds no olivine and shows bands of 3 %."""
    folder, told, inside = reference_data / "spectra", 0, 0
    for part, chosen in (("relab", "LS-CMP-098"), ("meteorites", r"Chip|Slab")):
        spectra, rows = script.spectra_of(folder / part)
        texture = rows["texture"].fillna("") if "texture" in rows else rows.index.to_series()
        for spectrum in spectra:
            if texture.filter([spectrum.id]).str.contains(chosen).any():
                kind = find_kind(spectrum, "solid-rock")
                ratio = estimate_each([spectrum], ALL, kinds=[kind])[0].ratios[0]
                mafic = rows.loc[spectrum.id, ["vol_ol", "vol_opx", "vol_cpx"]].to_numpy(float)
                truth = mafic[0] / mafic.sum()
                assert spectrum.id != "LS-CMP-098" or np.isnan(ratio.fraction)
                if np.isfinite(ratio.fraction):
                    told, inside = told + 1, inside + (ratio.low95 <= truth <= ratio.high95)
    assert told >= 12
    assert inside >= 0.95 * told


def test_made_up_powders_are_seldom_wrong_and_confident(load_benchmark: Callable[[str], Any]) -> None:
    """Of the half on which nothing was chosen; before, 43 of the 150 were."""
    bench = load_benchmark("contradicted")
    found = [
        bench.judged("made-up", False, spectrum, truth, MAFIC, ()) for spectrum, truth in list(bench.made_up(12))[:60]
    ]
    told = [one for one in found if one.misfit <= MOST_MISFIT and one.confident]
    assert len(told) >= 3
    assert sum(one.wrong for one in told) <= 0.1 * len(found)
    assert sum(one.wrong and one.confident for one in found) > sum(one.wrong for one in told)
