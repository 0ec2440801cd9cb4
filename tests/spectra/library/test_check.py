"""Every fault that can be put into an end member is found, and a good one is left in peace."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lunarsci.spectra.readers.library import EndMember, check_library

GRID = np.arange(450.0, 2451.0, 5.0)
GOOD = EndMember(
    "good", "orthopyroxene", GRID, np.full(GRID.size, 0.4), fs=0.20, en=0.77, wo=0.03, min_um=0.0, max_um=45.0
)


def texts(member: EndMember, *, must_mend: bool) -> list[str]:
    return [finding.text for finding in check_library([member])[0] if finding.must_mend == must_mend]


def changed(place: int, value: float) -> EndMember:
    values = GOOD.reflectance.copy()
    values[place] = value
    return replace(GOOD, reflectance=values)


def test_nothing_is_said_of_a_good_one() -> None:
    assert check_library([GOOD]) == [()]


@pytest.mark.parametrize(
    ("member", "word"),
    [
        (changed(10, 0.0), "1 channels not between 0 and 1.2, first 0 at 500 nm"),
        (changed(0, -0.1), "first -0.1 at 450 nm"),
        (changed(400, 1.2), "first 1.2 at 2450 nm"),
        (replace(GOOD, mineral=None), "no mineral"),
        (replace(GOOD, fs=0.5), "fs + en + wo = 1.300, not 1"),
        (replace(GOOD, en=None, fs=0.9, wo=0.2), "add up to 1.100, more than 1"),
        (replace(GOOD, fo=0.9), "fo = 0.9 in a mineral without it (orthopyroxene)"),
        (replace(GOOD, mineral="opaque"), "fs = 0.2 in a mineral without it (opaque)"),
        (replace(GOOD, wavelength_nm=GRID[:19], reflectance=np.full(19, 0.4)), "19 channels; 20 are needed"),
    ],
)
def test_what_must_be_mended(member: EndMember, word: str) -> None:
    assert any(word in text for text in texts(member, must_mend=True))


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"max_um": None}, "grain size unknown"),
        ({"fs": None, "en": None, "wo": None}, "no fs, no en, no wo: composition unknown"),
        ({"wavelength_nm": GRID + 300}, "covers 750-2750 nm"),
        ({"wavelength_nm": np.where(GRID > 1000, GRID + 100, GRID)}, "gap of 105 nm after 1000 nm"),
    ],
)
def test_what_one_should_know(change: dict[str, Any], word: str) -> None:
    member = replace(GOOD, **change)
    assert texts(member, must_mend=True) == []
    assert [word in text for text in texts(member, must_mend=False)] == [True]


def test_coarse_sampling_is_no_gap() -> None:
    coarse = np.arange(400.0, 2500.0, 70.0)
    assert texts(replace(GOOD, wavelength_nm=coarse, reflectance=np.full(coarse.size, 0.3)), must_mend=False) == []


def test_analyses_may_lack_two_per_cent() -> None:
    assert texts(replace(GOOD, en=0.751), must_mend=True) == []
    assert texts(replace(GOOD, en=0.749), must_mend=True) != []


def test_every_one_of_two_equal_ids_is_named() -> None:
    *twins, other = check_library([GOOD, replace(GOOD, reflectance=GOOD.reflectance / 2), replace(GOOD, id="other")])
    assert [[finding.must_mend for finding in findings] for findings in twins] == [[True], [True]]
    assert "2 end members have this id" in twins[1][0].text
    assert other == ()
