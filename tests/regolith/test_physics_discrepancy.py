"""The law of what the twin's physics is off by: tails, learning, forgetting, files, and the way back."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import t

from lunarsci.errors import DataError, ParameterError
from lunarsci.io.inputs import read_input
from lunarsci.regolith.belief import (
    OTHER_PHYSICS,
    SoilBelief,
    first_belief,
    ground_moments,
    parameter_rows,
    past_beliefs,
    read_belief,
    rolled_back,
    with_drive,
)
from lunarsci.regolith.physics_discrepancy import FIRST, PhysicsDiscrepancy, VarianceLaw
from lunarsci.regolith.prior import PARAMETERS

WAY_M2 = np.array([[4.0, 0.0], [0.0, 0.0]])


def test_draws_have_the_tails_of_student() -> None:
    law, random = VarianceLaw(4.0, 0.05), np.random.default_rng(0)
    draws = law.sizes(200_000, random) * random.standard_normal(200_000)
    for share in (0.5, 0.9, 0.99):
        assert np.quantile(np.abs(draws), share) == pytest.approx(0.05 * t.ppf(0.5 + share / 2, 4.0), rel=0.03)
        assert law.half_width(share) == pytest.approx(0.05 * t.ppf(0.5 + share / 2, 4.0))
    # Few drives, heavier tails: 99 % beside 68 %.
    few, many = VarianceLaw(3.0, 0.05), VarianceLaw(30.0, 0.05)
    assert few.half_width(0.99) / few.half_width(0.68) > 1.8 * many.half_width(0.99) / many.half_width(0.68)


def test_a_known_share_is_learned_as_the_conjugate_law_has_it() -> None:
    """With nothing else uncertain: degrees + 1, and a scale whose square is the mean of both, by degrees."""
    law = VarianceLaw(5.0, 0.03).after_error(0.2, 0.0, 2.0)
    assert law.degrees == pytest.approx(6.0, rel=0.02)
    assert law.scale**2 == pytest.approx((5.0 * 0.03**2 + 0.1**2) / 6.0, rel=0.02)


def test_a_miss_teaches_its_own_axis_and_noise_teaches_nothing() -> None:
    known = 1e-8 * np.eye(2)
    wide = FIRST.after_end(np.array([0.8, 0.0]), known, WAY_M2)
    assert wide.along.scale > 1.5 * FIRST.along.scale and wide.across.scale < FIRST.across.scale
    narrow = FIRST.after_end(np.array([0.0, 0.0]), known, WAY_M2)
    assert narrow.along.scale < FIRST.along.scale and narrow.along.degrees > FIRST.along.degrees
    blind = FIRST.after_end(np.array([0.8, 0.0]), 1e4 * np.eye(2), WAY_M2)
    assert blind.along.scale == pytest.approx(FIRST.along.scale, rel=0.02)
    assert blind.along.degrees == pytest.approx(FIRST.along.degrees, rel=0.05)
    # The track turned by 90 degrees: the same lesson.
    turned = FIRST.after_end(np.array([0.0, 0.8]), known, WAY_M2[::-1, ::-1])
    assert turned.along.scale == pytest.approx(wide.along.scale)


def test_many_returns_find_the_true_size() -> None:
    law, random = FIRST, np.random.default_rng(3)
    for _ in range(60):
        miss = 2.0 * np.array([0.15, 0.01]) * random.standard_normal(2)
        law = law.after_end(miss, 1e-6 * np.eye(2), WAY_M2)
    assert law.along.scale == pytest.approx(0.15, rel=0.25) and law.across.scale == pytest.approx(0.01, rel=0.25)
    assert law.along.degrees > 30


def test_it_is_forgotten_with_the_ground_but_not_what_taught_it() -> None:
    law = dataclasses.replace(FIRST, along=VarianceLaw(20.0, 0.3)).with_source(states="a.csv", sha256="a")
    belief = dataclasses.replace(first_belief(), discrepancy=law)
    kept, half, gone = (belief.forgotten(share).discrepancy for share in (0.0, 0.5, 1.0))
    assert kept.along.scale == pytest.approx(0.3) and gone.along.scale == pytest.approx(FIRST.along.scale)
    assert FIRST.along.scale < half.along.scale < 0.3 and FIRST.along.degrees < half.along.degrees < 20.0
    assert gone.has_scored("a") and not gone.has_scored("b")


def test_it_goes_with_the_belief_through_its_file_and_history(tmp_path: Path) -> None:
    def read(text: str) -> SoilBelief:
        path = tmp_path / "belief.json"
        path.write_text(text)
        return read_belief(read_input(str(path)))

    first = first_belief()
    law = FIRST.after_end(np.array([0.5, 0.1]), 0.01 * np.eye(2), WAY_M2).with_source(states="a.csv", sha256="a" * 64)
    learned = with_drive(dataclasses.replace(first, discrepancy=law), first, {"states": "a.csv"})
    other = with_drive(dataclasses.replace(learned, discrepancy=FIRST), learned, {"states": "b.csv"})
    back = read(other.to_json())
    assert back.discrepancy == FIRST and past_beliefs(back)[1].discrepancy == law
    assert rolled_back(back, 1).discrepancy == law and rolled_back(back, 0).discrepancy == FIRST
    # A file of an older version has none, and is read.
    document = json.loads(learned.to_json())
    assert read(json.dumps(document)).discrepancy == law
    older = {key: value for key, value in document.items() if key != "discrepancy"}
    older["history"] = [{k: v for k, v in entry.items() if k != "discrepancy"} for entry in older["history"]]
    assert read(json.dumps(older)).discrepancy == FIRST
    for broken in ({"along": {"degrees": 1.0, "scale": 0.1}}, {"along": {"degrees": 5.0, "scale": -1.0}}, {"along": 3}):
        with pytest.raises(DataError, match=str(tmp_path)):
            read(json.dumps(document | {"discrepancy": document["discrepancy"] | broken}))


def test_other_quantities_are_refused() -> None:
    with pytest.raises(ParameterError, match="needs laws of"):
        PhysicsDiscrepancy(FIRST.along, FIRST.across, {"slip_ratio": FIRST.along})


def test_the_grounds_own_values_are_known_less_well_and_never_worse_than_before() -> None:
    first = first_belief()
    mean, spread = ground_moments(first)
    widths = np.sqrt(np.diag(first.covariance))
    assert mean == pytest.approx(first.mean) and spread == pytest.approx(widths)
    belief = SoilBelief(first.laws, first.mean + 0.5 * widths, 0.04 * first.covariance)
    mean, spread = ground_moments(belief)
    assert (spread > 0.2 * widths).all() and (spread < widths).all()
    # Drives told them to 0.2 / sqrt(0.96) widths about 0.5 / 0.96; joined with a law of width 1 about 0.
    for k, name in enumerate(PARAMETERS):
        weight = 1.0 / (0.04 / 0.96 + OTHER_PHYSICS[name] ** 2)
        assert spread[k] / widths[k] == pytest.approx(1.0 / np.sqrt(1.0 + weight))
        assert (mean - first.mean)[k] / widths[k] == pytest.approx(0.5 / 0.96 * weight / (1.0 + weight))
    row = parameter_rows(belief)["cohesion_pa"]
    ends = [row[f"ground_{key}"] for key in ("low_95", "low_68", "median", "high_68", "high_95")]
    assert ends == sorted(ends) and len({*ends}) == 5
