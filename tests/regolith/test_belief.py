"""Beliefs of a soil: files, draws, forgetting; restored states, moves, and two beliefs beside each other."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError, ParameterError
from lunarsci.io.inputs import read_input
from lunarsci.regolith.belief import (
    SoilBelief,
    belief_of,
    compare_beliefs,
    first_belief,
    ground_moments,
    moved_sd,
    past_beliefs,
    read_belief,
    rolled_back,
    shared_drives,
    with_drive,
)
from lunarsci.regolith.figure import belief_history_figure
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


def test_beyond_the_loads_that_taught_it_a_belief_goes_over_to_the_ground_itself(belief: SoilBelief) -> None:
    """Half the load is half of the way; in widths of the prior no parameter is known better than under its loads."""
    taught = dataclasses.replace(belief, history=({"loads_n": [20.0, 24.0]}, {"loads_n": [22.0, 28.0]}))
    mean, sd = ground_moments(taught)
    assert taught.loads_n == (20.0, 28.0) and taught.under(25.0) is taught and belief.under(1.0) is belief
    half = taught.under(10.0)
    assert half.mean == pytest.approx(0.5 * (mean + taught.mean))
    assert half.sd**2 == pytest.approx(0.5 * (np.maximum(sd, taught.sd) ** 2 + taught.sd**2))
    assert (taught.beyond_loads(10.0), taught.beyond_loads(56.0)) == (0.5, 0.5)
    drawn = dataclasses.replace(taught, population=np.tile(taught.mean, (4000, 1))).under(2.0)
    assert drawn.population is not None and drawn.population.mean(axis=0) == pytest.approx(drawn.mean, abs=0.1)
    forgot = dataclasses.replace(taught, history=(*taught.history, {"forgotten": 1.0, "loads_n": [2.0, 3.0]}))
    assert forgot.loads_n == (2.0, 3.0)


def test_soils_are_driven_with_ruts_as_they_were_learned_with_them(belief: SoilBelief) -> None:
    """Draws keep their case, from memory and from the file; a normal law has as many as are probable."""
    normal = dataclasses.replace(belief, history=({"ruts": True, "ruts_probability": 0.75},), population=None)
    assert normal.draws_with_ruts(64).sum() == 48 and normal.ruts == 0.75
    points = belief.mean + np.linspace(-1.0, 1.0, 40)[:, None] * belief.sd
    kept = dataclasses.replace(normal, population=points, meets_ruts=points[:, 0] > belief.mean[0])
    for one in (kept, belief_of(json.loads(kept.to_json()))):
        drawn, met = one.draws(100, seed=3), one.draws_with_ruts(100, seed=3)
        middle = belief.samples(belief.mean[None])[belief.names[0]][0]
        assert np.array_equal(met, drawn[belief.names[0]] > middle) and 0 < met.sum() < 100
    assert kept.forgotten(0.5).meets_ruts is None


def test_forgetting_goes_from_the_belief_to_the_first_laws(belief: SoilBelief) -> None:
    first = first_belief()
    assert np.array_equal(belief.forgotten(0.0).mean, belief.mean)
    all_gone = belief.forgotten(1.0)
    assert all_gone.mean == pytest.approx(first.mean) and all_gone.covariance == pytest.approx(first.covariance)
    # Half forgotten is the even mixture of both: its mean and covariance, from draws.
    half, random = belief.forgotten(0.5), np.random.default_rng(0)
    parts = [
        one.mean + random.standard_normal((200_000, 8)) @ np.linalg.cholesky(one.covariance).T
        for one in (belief, first)
    ]
    mixture = np.concatenate(parts)
    assert half.mean == pytest.approx(mixture.mean(axis=0), abs=0.01)
    assert half.covariance == pytest.approx(np.cov(mixture.T), abs=0.02)
    with pytest.raises(ParameterError, match="give 0 to 1"):
        belief.forgotten(1.5)


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
        json.dumps(good | {"mean": [90.0, *good["mean"][1:]]}): "standard deviations from its law",
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


def next_belief(before: SoilBelief, seed: int, **drive: object) -> SoilBelief:
    """A made-up update: a mean nearby, a covariance half as wide, and a population."""
    random = np.random.default_rng(seed)
    sd = np.sqrt(np.diag(before.covariance))
    mean = before.mean + 0.3 * sd * random.normal(size=8)
    after = SoilBelief(
        before.laws, mean, 0.5 * before.covariance, before.history, mean + sd * random.normal(size=(40, 8))
    )
    return with_drive(after, before, {"states": f"{seed}.csv", "refused": "", **drive}, parent_sha256="0" * 64)


@pytest.fixture
def chain() -> list[SoilBelief]:
    """The priors and three beliefs, each from the one before."""
    beliefs = [first_belief()]
    for seed in (1, 2, 3):
        beliefs.append(next_belief(beliefs[-1], seed))
    return beliefs


def test_every_state_comes_back_from_the_newest_file_alone(chain: list[SoilBelief]) -> None:
    newest = belief_of(json.loads(chain[-1].to_json()))
    for drives, state in enumerate(chain):
        back = rolled_back(newest, drives)
        assert np.array_equal(back.mean, state.mean) and np.array_equal(back.covariance, state.covariance)
        assert len(back.history) == drives and list(back.history) == list(state.history)
        assert (back.population is None) == (drives < 3)
        # A restored belief is one to go on from: its own file reads, and the next update extends it.
        again = next_belief(belief_of(json.loads(back.to_json())), 9)
        assert [entry["states"] for entry in again.history[:-1]] == [f"{k}.csv" for k in range(1, drives + 1)]
    for wrong in (-1, 4):
        with pytest.raises(ParameterError, match="rests on 3"):
            rolled_back(newest, wrong)


def test_an_older_file_reads_and_says_what_it_did_not_keep(chain: list[SoilBelief]) -> None:
    old = [{key: entry[key] for key in ("states", "refused")} for entry in chain[2].history]
    belief = dataclasses.replace(chain[2], history=tuple(old))
    assert [state is None for state in past_beliefs(belief_of(json.loads(belief.to_json())))] == [False, True, False]
    assert moved_sd(belief) == [None, None]
    with pytest.raises(ParameterError, match="kept no states"):
        rolled_back(belief, 1)
    mixed = next_belief(belief, 3)
    assert [row is None for row in moved_sd(mixed)] == [True, True, True]
    assert np.array_equal(rolled_back(next_belief(mixed, 4), 3).mean, mixed.mean)


def test_a_history_grows_by_the_same_for_every_drive_and_brings_back_what_each_rested_on() -> None:
    beliefs = [first_belief()]
    for number in range(60):
        law = beliefs[-1].discrepancy.with_source(states=f"{number}.csv", sha256=f"{number:064x}")
        after = dataclasses.replace(beliefs[-1], discrepancy=law)
        beliefs.append(with_drive(after, beliefs[-1], {"states": f"{number}.csv"}, parent_sha256="0" * 64))
    sizes = np.diff([len(belief.to_json()) for belief in beliefs[1:]])
    assert np.ptp(sizes) < 0.02 * sizes[0]
    newest = belief_of(json.loads(beliefs[-1].to_json()))
    assert [len(rolled_back(newest, k).discrepancy.scored) for k in (0, 1, 30, 60)] == [0, 1, 30, 60]
    assert rolled_back(newest, 30).discrepancy == beliefs[30].discrepancy
    # Files of older versions repeat the lines in every entry.
    old = [{**entry, "discrepancy": state.discrepancy.to_dict()} for entry, state in zip(
        newest.history, beliefs[1:], strict=True)]  # fmt: skip
    assert rolled_back(dataclasses.replace(newest, history=tuple(old)), 30).discrepancy == beliefs[30].discrepancy
    spoilt = [{**entry, "discrepancy": {**entry["discrepancy"], "scored": 61}} for entry in newest.history]
    with pytest.raises(ParameterError, match="history, drive 1: its discrepancy rests on 61 drives"):
        rolled_back(dataclasses.replace(newest, history=tuple(spoilt)), 1)


def test_a_broken_state_in_the_history_is_named(chain: list[SoilBelief]) -> None:
    broken = [dict(entry) for entry in chain[2].history]
    broken[0]["mean"] = [1.0, 2.0]
    with pytest.raises(ParameterError, match="history, drive 1"):
        rolled_back(dataclasses.replace(chain[2], history=tuple(broken)), 1)


def test_moves_are_in_standard_deviations_of_the_state_before(chain: list[SoilBelief]) -> None:
    moves = moved_sd(chain[-1])
    for before, after, moved in zip(chain[:-1], chain[1:], moves, strict=True):
        expected = (after.mean - before.mean) / np.sqrt(np.diag(before.covariance))
        assert list(moved.values()) == pytest.approx(expected)


def test_distances_of_normal_laws_are_those_of_samples(chain: list[SoilBelief]) -> None:
    """Bhattacharyya: -ln of the integral of sqrt(p q); Kullback-Leibler: mean of ln(p/q) over p; both by draws of p."""
    from scipy.stats import multivariate_normal

    one, other = chain[1], chain[3]
    p, q = (multivariate_normal(b.mean, b.covariance) for b in (one, other))
    found = compare_beliefs(one, other)
    drawn = q.rvs(200_000, random_state=np.random.default_rng(0))
    ratio = q.logpdf(drawn) - p.logpdf(drawn)
    assert found.kullback_leibler[0] == pytest.approx(ratio.mean(), abs=0.03)
    assert found.bhattacharyya == pytest.approx(-np.log(np.exp(-0.5 * ratio).mean()), abs=0.03)
    assert compare_beliefs(other, one).kullback_leibler == pytest.approx(found.kullback_leibler[::-1])
    same = compare_beliefs(one, one)
    assert same.bhattacharyya == pytest.approx(0.0, abs=1e-12) and same.difference_sd == 0.0
    assert same.kullback_leibler == pytest.approx((0.0, 0.0), abs=1e-12)


def test_the_difference_is_one_for_independent_estimates_of_one_truth() -> None:
    """Root mean square over many pairs of beliefs about the same soil with their stated errors."""
    random, first = np.random.default_rng(3), first_belief()
    squares = []
    for _ in range(200):
        pair = [
            SoilBelief(first.laws, random.multivariate_normal(first.mean, share * first.covariance), c)
            for share, c in ((0.1, 0.1 * first.covariance), (0.4, 0.4 * first.covariance))
        ]
        squares.append(compare_beliefs(*pair).difference_sd ** 2)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.1)


def test_beliefs_with_other_transforms_do_not_compare(chain: list[SoilBelief]) -> None:
    laws = dict(chain[1].laws)
    laws["cohesion_pa"] = dataclasses.replace(laws["cohesion_pa"], of="value")
    with pytest.raises(ParameterError, match="cohesion_pa"):
        compare_beliefs(chain[1], SoilBelief(laws, chain[1].mean, chain[1].covariance))


def test_shared_drives_are_the_first_that_are_the_same(chain: list[SoilBelief]) -> None:
    branch = next_belief(chain[2], 8)
    assert shared_drives(chain[3], branch) == 2 and shared_drives(chain[3], chain[3]) == 3
    assert shared_drives(chain[0], chain[3]) == 0
    # The same states file, learned from with another result, is not the same drive.
    assert shared_drives(next_belief(chain[1], 8), next_belief(chain[2], 8)) == 1


def test_the_picture_has_a_panel_for_each_parameter(chain: list[SoilBelief]) -> None:
    refused = next_belief(chain[2], 5, refused="no soil explains it")
    figure = belief_history_figure(refused, "belief", chain[3], ("one", "other"))
    assert len(figure.axes) == len(PARAMETERS)
    labels = {text.get_text() for text in figure.legends[0].get_texts()}
    assert {"the priors", "one", "other", "nothing was learned"} <= labels
