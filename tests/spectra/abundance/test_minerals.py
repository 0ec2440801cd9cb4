"""The comparison of `tests/benchmarks/minerals.py`: nothing is judged by what has seen it, and scores are right."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lunarsci.spectra.spectrum import Spectrum

NM = np.array([500.0, 1000.0, 2000.0])


@pytest.fixture(scope="module")
def bench(load_benchmark: Callable[[str], Any]) -> Any:
    return load_benchmark("minerals")


def test_a_score_by_hand(bench: Any) -> None:
    """Two determined, one in domain of each, and one that is not determined but whose interval holds the truth."""
    truth = ([0.5, 0.5, 0.0, 0.0], [0.2, 0.3, 0.1, 0.4], [1.0, 0.0, 0.0, 0.0])
    shares = ([0.6, 0.4, 0.0, 0.0], [0.2, 0.0, 0.4, 0.4], [np.nan] * 4)
    narrow, wide = np.tile([0.0, 0.1, 0.0, 0.45], (4, 1)), np.tile([0.0, 1.0, 0.0, 1.0], (4, 1))
    told = zip(truth, shares, (narrow, narrow, wide), (True, True, False), strict=True)
    items = [
        (
            bench.Case(Spectrum(str(k), NM, 0.1 * NM), np.array(own), "chondrites", "a", "a"),
            np.array(found),
            ends,
            taken,
        )
        for k, (own, found, ends, taken) in enumerate(told)
    ]
    found = bench.score(items)
    assert (found.count, found.determined, found.good, found.taken, found.taken_good) == (3, 2, 1, 2, 1)
    assert found.rms == pytest.approx([10 / 2**0.5, (500.0) ** 0.5, 30 / 2**0.5, 0.0])
    assert found.pyroxene == pytest.approx(10 / 2**0.5)
    assert found.held68 == pytest.approx((2 + 1 + 4) / 12)
    assert found.held95 == pytest.approx((2 + 4 + 4) / 12)


@pytest.mark.reference
def test_nothing_is_judged_by_what_has_seen_it(bench: Any, reference_data: Path) -> None:
    every = bench.cases(reference_data)
    judged = bench.folds(reference_data)
    assert sum(len(own) for own, _ in judged) == sum(bool(case.group) for case in every) == 149
    for own, left_out in judged:
        assert {case.spectrum.id for case in own} <= left_out
        seen = [case for case in every if case.spectrum.id not in left_out]
        assert {case.rock for case in own}.isdisjoint(case.rock for case in seen)
        assert {case.fold for case in own}.isdisjoint(case.fold for case in seen)
        mixed = " ".join(case.spectrum.id for case in own)
        if "pomix" in mixed:
            assert not [case for case in seen if re.match("pomix|MIX|OOC|PP-EAC-087", case.spectrum.id)]


@pytest.mark.reference
def test_no_soil_is_unmixed_and_the_constant_is_hard_to_beat_on_chondrites(bench: Any, reference_data: Path) -> None:
    chosen = bench.methods(reference_data)
    soils = bench.score(bench.answers(reference_data, chosen["lunarsci, four minerals named"], ["soils"]))
    assert (soils.count, soils.determined, soils.taken) == (11, 0, 0)
    constant = bench.score(bench.answers(reference_data, chosen["constant of the class"], ["chondrites"]))
    assert constant.rms == pytest.approx([8.3, 7.1, 5.0, 9.7], abs=0.5)


@pytest.mark.reference
def test_partial_least_squares_learns_without_the_suite(bench: Any, reference_data: Path) -> None:
    pytest.importorskip("sklearn")
    method = bench.learned(reference_data, bench.least_squares)
    found = bench.score(bench.answers(reference_data, method, ["achondrites"]))
    assert found.rms[0] < 18
    assert found.correlation > 0.7
