"""The history of a belief: restored states, moves, and two beliefs beside each other."""

import dataclasses
import json

import numpy as np
import pytest

from lunarsci.errors import ParameterError
from lunarsci.regolith.belief import (
    SoilBelief,
    belief_of,
    compare_beliefs,
    first_belief,
    moved_sd,
    past_beliefs,
    rolled_back,
    shared_drives,
    with_drive,
)
from lunarsci.regolith.figure import belief_history_figure
from lunarsci.regolith.prior import PARAMETERS


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
        law = beliefs[-1].discrepancy.with_score(states=f"{number}.csv", sha256=f"{number:064x}")
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
        assert moved is not None
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
