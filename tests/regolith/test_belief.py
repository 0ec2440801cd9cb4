"""Beliefs of a soil: files, draws, and forgetting."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError, ParameterError
from lunarsci.io.inputs import read_input
from lunarsci.regolith.belief import SoilBelief, first_belief, read_belief
from lunarsci.regolith.prior import PARAMETERS, default_prior, values_of


@pytest.fixture
def belief() -> SoilBelief:
    random = np.random.default_rng(2)
    first = first_belief()
    factor = 0.1 * random.normal(size=(8, 8)) + 0.3 * np.eye(8)
    return SoilBelief(first.laws, first.mean + 0.2, factor @ factor.T, ({"states": "a.csv"},))


def test_the_first_belief_is_the_priors() -> None:
    first, laws = first_belief(), default_prior()
    for name, (median, _, _) in first.intervals().items():
        assert median == pytest.approx(laws[name].median)
    assert set(first.sd_ratio.values()) == {1.0}


def test_a_belief_comes_back_from_its_file(belief: SoilBelief, tmp_path: Path) -> None:
    drawn = np.random.default_rng(1).normal(size=(40, 8))
    for one in (belief, dataclasses.replace(belief, population=drawn)):
        path = tmp_path / "belief.json"
        path.write_text(one.to_json())
        back = read_belief(read_input(str(path)))
        assert np.array_equal(back.mean, one.mean) and np.array_equal(back.covariance, one.covariance)
        assert back.history == one.history and back.laws == one.laws
        for name, values in one.draws(100, 3).items():
            assert np.array_equal(back.draws(100, 3)[name], values)


def test_draws_have_the_mean_and_covariance_of_the_belief(belief: SoilBelief) -> None:
    drawn = belief.draws(20000, 1)
    points = np.column_stack([belief.laws[name].transformed(drawn[name]) for name in PARAMETERS])
    assert points.mean(axis=0) == pytest.approx(belief.mean, abs=0.02)
    assert np.cov(points.T) == pytest.approx(belief.covariance, abs=0.02)


def test_a_population_is_drawn_from_without_loss(belief: SoilBelief) -> None:
    points = np.random.default_rng(1).normal(size=(40, 8)) * 0.1 + belief.mean
    drawn = dataclasses.replace(belief, population=points).draws(40, 5)
    expected = values_of(belief.laws, points)
    assert sorted(drawn["cohesion_pa"]) == pytest.approx(sorted(expected[:, PARAMETERS.index("cohesion_pa")]))


def test_forgetting_goes_from_the_belief_to_the_first_laws(belief: SoilBelief) -> None:
    first = first_belief()
    assert np.array_equal(belief.inflated(0.0).mean, belief.mean)
    all_gone = belief.inflated(1.0)
    assert all_gone.mean == pytest.approx(first.mean) and all_gone.covariance == pytest.approx(first.covariance)
    # Half forgotten is the even mixture of both: its mean and covariance, from draws.
    half, random = belief.inflated(0.5), np.random.default_rng(0)
    parts = [
        one.mean + random.standard_normal((200_000, 8)) @ np.linalg.cholesky(one.covariance).T
        for one in (belief, first)
    ]
    mixture = np.concatenate(parts)
    assert half.mean == pytest.approx(mixture.mean(axis=0), abs=0.01)
    assert half.covariance == pytest.approx(np.cov(mixture.T), abs=0.02)
    with pytest.raises(ParameterError, match="a share from 0 to 1"):
        belief.inflated(1.5)


def test_a_bad_file_is_one_line_that_names_it(belief: SoilBelief, tmp_path: Path) -> None:
    good = json.loads(belief.to_json())
    crooked = belief.covariance.copy()
    crooked[0, 1] += 1.0
    cases = {
        belief.to_json()[:300]: "is the file complete",
        "{}": "schema",
        json.dumps(good | {"order": good["order"][::-1]}): "a belief needs laws",
        json.dumps(good | {"mean": [1.0]}): "mean",
        json.dumps(good | {"mean": [float("nan")] * 8}): "NaN",
        json.dumps(good | {"covariance": (-belief.covariance).tolist()}): "positive definite",
        json.dumps(good | {"covariance": crooked.tolist()}): "symmetric",
        json.dumps(good | {"population": [[1.0, 2.0]]}): "population",
        json.dumps({key: value for key, value in good.items() if key != "laws"}): "laws",
    }
    for number, (text, says) in enumerate(cases.items()):
        path = tmp_path / f"{number}.json"
        path.write_text(text)
        with pytest.raises(DataError) as caught:
            read_belief(read_input(str(path)))
        assert says in str(caught.value) and str(path) in str(caught.value) and "\n" not in str(caught.value)
