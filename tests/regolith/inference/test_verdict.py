"""Fits that refuse: laws that cannot explain the states, wrong signs and units, and files that carry the verdict."""

import math
import sys
from dataclasses import replace

import numpy as np
import pytest

from lunarsci.errors import DataError, ParameterError
from lunarsci.io.inputs import InputFile
from lunarsci.regolith.belief import FitVerdict, doubt, read_belief, read_verdict, verdict_line
from lunarsci.regolith.inference.mode import Mode
from lunarsci.regolith.inference.posterior import SoilPosterior, infer_soil, least_chi_square, suspects
from lunarsci.regolith.inference.prediction import (
    WheelLaw,
    WheelLawScore,
    candidates,
    compare_laws,
    disputed,
    predict_forces,
    predict_states,
)
from lunarsci.regolith.inference.problem import Lesson, forces_of_many, misfit_at, problem_of, shares_at
from lunarsci.regolith.integrals import integrated_forces
from lunarsci.regolith.prior import PARAMETERS, default_prior, values_of
from lunarsci.regolith.soil import read_soil
from lunarsci.regolith.states import COLUMNS, MeasurementErrors, WheelStates
from lunarsci.regolith.wheel import ContactModel, read_wheel

WHEEL, SOIL = read_wheel("yutu2"), read_soil("lunar-typical")
OTHER = replace(WHEEL, max_stress_c1=0.4, max_stress_c2=0.15, exit_c3=-0.1)
"""The same wheel under other contact angles than the closed form takes."""


def states(values: np.ndarray) -> WheelStates:
    errors = MeasurementErrors()
    sigmas = np.column_stack([errors.of(name, values[:, k]) for k, name in enumerate(COLUMNS)])
    return WheelStates(tuple(map(str, range(len(values)))), values, sigmas)


def measured(count: int = 30, model: ContactModel | None = None, seed: int = 0) -> np.ndarray:
    """Synthetic: exact forces under other contact angles, with the errors of the paper drawn on everything measured."""
    rng = np.random.default_rng(seed)
    inputs = np.column_stack(
        [rng.uniform(0.006, 0.018, count), rng.uniform(-0.3, 0.5, count), rng.uniform(-15, 15, count)]
    )
    found = integrated_forces(OTHER, SOIL, *inputs.T, model or ContactModel())
    forces = np.column_stack([found.normal_force_n, found.drawbar_pull_n, found.lateral_force_n])
    values = np.column_stack([inputs, forces])
    return np.asarray(values + states(values).sigmas * rng.standard_normal(values.shape))


@pytest.fixture(scope="module")
def right() -> SoilPosterior:
    return infer_soil(states(measured()), WHEEL)


def test_states_of_a_soil_of_the_model_are_trusted_and_its_error_is_found(right: SoilPosterior) -> None:
    """Closed form against exact forces under other angles: 4-15 % apart in F_N, of which a soil can take most."""
    verdict = right.verdict
    assert verdict.trusted, verdict.reason
    assert verdict.model == "closed"
    assert verdict.model_error_from == "residuals"
    assert 0.5 <= (verdict.reduced_chi_square or 0) <= 2
    assert all(share < 0.1 for share in verdict.model_error)
    assert any("Ding et al." in said for said in verdict.assumed)


@pytest.mark.parametrize("column", ["slip_ratio", "side_slip_deg", "drawbar_pull_n", "lateral_force_n"])
def test_a_wrong_sign_of_one_column_is_refused(column: str) -> None:
    values = measured()
    values[:, COLUMNS.index(column)] *= -1
    verdict = infer_soil(states(values), WHEEL).verdict
    assert not verdict.trusted
    assert column in verdict.reason
    assert "sign" in verdict.reason


@pytest.mark.parametrize(("count", "row"), [(100, 0), (30, -1)])
def test_the_first_and_the_last_state_are_heard(count: int, row: int) -> None:
    """It alone slips to the side, and is pushed the wrong way: also of more states than are tried."""
    values = measured(count)
    values[:, [2, 5]] = 0.0
    values[row, :3] = 0.015, 0.3, 15.0
    forces = integrated_forces(OTHER, SOIL, *values[row, :3], ContactModel())
    for sign, columns in ((1.0, []), (-1.0, ["lateral_force_n"])):
        values[row, 3:] = forces.normal_force_n, forces.drawbar_pull_n, sign * forces.lateral_force_n
        problem = problem_of(states(values), np.ones(count, dtype=bool), WHEEL, default_prior(), None, (0.02,) * 3)
        mode = Mode(np.ones(count, dtype=bool), problem.center, np.eye(len(problem.center)), problem, problem)
        assert [suspect.column for suspect in suspects(mode)] == columns


def test_side_slip_in_radians_is_named() -> None:
    values = measured()
    values[:, 2] = np.radians(values[:, 2])
    verdict = infer_soil(states(values), WHEEL).verdict
    assert not verdict.trusted
    assert "side_slip_deg agrees with the others only with degrees in place of radians" in verdict.reason


def test_forces_of_no_soil_are_refused() -> None:
    """Pulls drawn by lot: no law explains them."""
    values, rng = measured(), np.random.default_rng(1)
    values[:, 4] = values[:, 3] * rng.uniform(-0.6, 0.6, len(values))
    verdict = infer_soil(states(values), WHEEL).verdict
    assert not verdict.trusted
    assert "the drawbar pull by 0." in verdict.reason
    assert "slip_ratio, side_slip_deg, drawbar_pull_n and lateral_force_n" in verdict.reason


def test_a_model_error_that_is_given_is_held_to_its_chi_square() -> None:
    values, rng = measured(), np.random.default_rng(1)
    values[:, 4] += values[:, 3] * 0.1 * rng.standard_normal(len(values))
    verdict = infer_soil(states(values), WHEEL, model_error=0.0).verdict
    assert verdict.model_error == (0.0, 0.0, 0.0)
    assert not verdict.trusted
    assert "reduced chi-square" in verdict.reason or "outliers" in verdict.reason


def test_errors_that_are_stated_too_large_are_refused() -> None:
    plain = states(measured())
    verdict = infer_soil(WheelStates(plain.id, plain.values, 8 * plain.sigmas, True), WHEEL).verdict
    assert not verdict.trusted
    assert "too large" in verdict.reason
    # Forces that were computed with drawn soils err alike.
    alike = infer_soil(WheelStates(plain.id, plain.values, 8 * plain.sigmas, True, True), WHEEL).verdict
    assert alike.trusted
    assert any("errors that the states do not show" in said for said in alike.assumed)


def test_right_errors_of_few_forces_and_errors_that_the_file_does_not_state_are_not_called_too_large() -> None:
    """Of 3 degrees of freedom one fit in nine scatters by less than half of its errors, one in a thousand by 0.008."""
    for left, low in ((3.0, 0.0081), (10.0, 0.148), (35.0, 0.42)):
        assert least_chi_square(left) / left == pytest.approx(low, rel=0.02)
    assert least_chi_square(600.0) == 300.0
    plain = states(measured())
    known = WheelStates(plain.id, plain.values, plain.sigmas * [1, 12, 12, 1, 1, 1], True)
    assert "stated errors alone" in infer_soil(known, WHEEL).verdict.reason
    taken = replace(known, unstated=("slip_ratio", "side_slip_deg"))
    assert "too large" not in infer_soil(taken, WHEEL).verdict.reason


def test_a_parameter_that_another_law_disputes_is_not_determined(right: SoilPosterior) -> None:
    law, ends = WheelLaw(None, False), right.intervals()
    soil = [ends[name][0] for name in PARAMETERS]
    soil[0] = 1.01 * ends["stiffness_kpa_m_n"][4]
    near = WheelLawScore(law, -10.0, 0.9, 1.0, (0.0,) * 3, tuple(soil))
    assert disputed(right, [near]) == ("stiffness_kpa_m_n",)
    assert disputed(right, [replace(near, behind=1.1), WheelLawScore(law, *[None] * 5)]) == ()
    open_to = replace(right, disputed=("stiffness_kpa_m_n",))
    assert "stiffness_kpa_m_n" in right.determined and "stiffness_kpa_m_n" not in open_to.determined
    assert open_to.to_dict()["disputed"] == ["stiffness_kpa_m_n"]


def test_locked_wheels_and_any_side_slip_are_states_to_learn_from() -> None:
    values = measured()
    model = ContactModel(shear="combined")
    values[:4, 1], values[4:8, 2] = -1.0, 90.0
    found = integrated_forces(OTHER, SOIL, *values[:, :3].T, model)
    values[:, 3:] = np.column_stack([found.normal_force_n, found.drawbar_pull_n, found.lateral_force_n])
    posterior = infer_soil(states(values), WHEEL, model=model, contact=True)
    assert np.isfinite(posterior.residuals).all()
    assert posterior.verdict.trusted, posterior.verdict.reason
    assert posterior.names[len(PARAMETERS) :] == ("skid_exponent_slip", "max_stress_c1", "max_stress_c2", "exit_c3")
    _, _, _, low, high = posterior.intervals()["max_stress_c1"]
    assert low <= 0.4 <= high
    assert max(posterior.verdict.model_error) < 0.03


def test_the_law_that_made_the_states_predicts_best() -> None:
    values = measured(60, ContactModel(shear="combined"))
    values[:, 2] *= 3
    found = integrated_forces(OTHER, SOIL, *values[:, :3].T, ContactModel(shear="combined"))
    values[:, 3:] = np.column_stack([found.normal_force_n, found.drawbar_pull_n, found.lateral_force_n])
    given = states(values)
    laws = [law for law in candidates(given) if law.model is None or (law.contact and law.model.bulldozing == "none")]
    best, scores = compare_laws(given, WHEEL, laws)
    assert best.name == "combined + contact angles"
    behind = {score.law.name: score.behind for score in scores}
    assert behind[best.name] == 0
    assert all(value is not None and value > 20 for name, value in behind.items() if name != best.name)


def test_without_side_slip_laws_of_side_slip_are_not_compared() -> None:
    values = measured()
    values[:, 2] = 0.0
    assert [law.name for law in candidates(states(values))] == ["closed", "separate", "separate + contact angles"]


def test_forces_are_predicted_with_the_error_of_the_model(right: SoilPosterior) -> None:
    """States not fitted: 90 % intervals hold 82-98 % of 120 forces."""
    values = measured(60, seed=5)
    text = "slip_ratio,side_slip_deg,normal_force_n,sinkage_m,drawbar_pull_n,lateral_force_n\n"
    text += "\n".join(",".join(f"{row[k]:.8g}" for k in (1, 2, 3, 0, 4, 5)) for row in values)
    compared = predict_states(right, WHEEL, InputFile("s.csv", text.encode())).compared()
    held = [found["held90"] for found in compared.values() if found]
    assert 0.82 <= np.mean(held) <= 0.99
    assert compared["drawbar_pull_n"]["rms_of_load"] < 0.06
    drawn = predict_forces(right, WHEEL, 0.2, 0.0, [36.0], [0.01])
    alone = predict_states(right, WHEEL, InputFile("s.csv", b"slip_ratio,normal_force_n,sinkage_m\n0.2,36,0.01\n"))
    ends = np.quantile(drawn.draws[:, 0], [0.05, 0.95, 0.16, 0.84], axis=0)
    assert alone.quantiles[:, 0] == pytest.approx(np.vstack([drawn.value, ends]))
    under = predict_states(right, WHEEL, InputFile("s.csv", b"slip_ratio,normal_force_n\n0.2,36\n"))
    assert under.records[0]["normal_force_n"]["value"] == pytest.approx(36)
    assert 0.005 < under.sinkage_m[0] < 0.03
    with pytest.raises(DataError, match="row 1, slip_ratio"):
        predict_states(right, WHEEL, InputFile("s.csv", b"slip_ratio,normal_force_n\n1.2,36\n"))


def test_a_belief_and_a_table_carry_the_verdict(right: SoilPosterior) -> None:
    bad = replace(right.verdict, trusted=False, reason="column x")
    belief = replace(right.belief(), verdict=bad)
    source = InputFile("b.json", belief.to_json().encode())
    assert read_verdict(source) == read_belief(source).verdict == bad
    assert "column x" in doubt(bad)
    table = InputFile("s.csv", (verdict_line(bad) + "cohesion_pa\n500\n").encode())
    assert read_verdict(table) == bad
    assert read_verdict(InputFile("s.csv", b"cohesion_pa\n500\n")) is None
    with pytest.raises(DataError, match=r"s\.csv"):
        read_verdict(InputFile("s.csv", b'# verdict of the fit: {"trusted": 1}\ncohesion_pa\n500\n'))


def test_a_verdict_that_is_not_trusted_says_why() -> None:
    with pytest.raises(ParameterError, match="why not"):
        FitVerdict(
            trusted=False, reason="", model="closed", model_error=(0, 0, 0), model_error_from="given",
            reduced_chi_square=1.0,
        )  # fmt: skip


def test_the_model_errs_more_where_nothing_taught_it(right: SoilPosterior) -> None:
    """At a taught state its own error; 0.6 of slip away 1 - 1/e of the variance elsewhere comes to it; far off all."""
    own = np.array(right.verdict.model_error)
    elsewhere = np.maximum(own.max(), [0.4, 0.1, 0.1])
    places = np.array([[0.1, 0.0], [0.4, 0.0]])
    found = shares_at(own, places, np.array([[0.4, 0.0], [1.0, 0.0], [0.1, 30.0], [0.1, 150.0]]))
    part = 1.0 - math.exp(-1.0)
    assert found == pytest.approx(np.sqrt(own**2 + np.array([0.0, part, part, 1.0])[:, None] * elsewhere**2), rel=1e-9)
    straight = Lesson(WHEEL, right.lesson.inputs * [1.0, 1.0, 0.0], right.lesson.forces)
    taught = replace(right, lesson=straight)
    drawn = predict_forces(taught, WHEEL, [0.1], [90.0], [36.0], [0.01], draws=2000)
    low, high = drawn.interval()
    assert (high - low)[0, 2] > 2.0 * 1.6 * elsewhere[2] * 36.0 * 0.9


def test_what_a_law_misses_is_found_beside_the_states_that_taught_it(right: SoilPosterior) -> None:
    """Forces are off by a smooth share of the load and by 3 % of their own at 60 states: 60 others are predicted."""
    random, best = np.random.default_rng(3), values_of(right.prior, right.mode)
    inputs = np.column_stack([np.full(120, 0.01), random.uniform(0.0, 0.6, 120), random.uniform(-30.0, 30.0, 120)])
    own = 0.3 * np.sin(4.0 * inputs[:, 1]) * np.cos(np.radians(3.0 * inputs[:, 2]))
    shares = np.column_stack([own, -own, 0.5 * own]) + 0.03 * random.standard_normal((120, 3))
    plain = forces_of_many(best[None], inputs, WHEEL, right.model)[0].T
    # Loads are those that the wheel then carries.
    load = plain[:, 0] / (1.0 - shares[:, 0])
    forces = plain + shares * load[:, None]
    lesson = Lesson(WHEEL, inputs[::2], forces[::2])
    assert lesson.missed(best, right.model) == pytest.approx(shares[::2])
    error = tuple(map(float, shares.std(axis=0)))
    found = misfit_at(error, lesson, best, right.model, inputs[1::2, 1:])
    off = (shares[1::2] - found.mean(best)) / found.sigma
    assert np.sqrt(np.mean((shares[1::2] - found.mean(best)) ** 2)) < 0.04 < 0.5 * max(error)
    assert 0.8 < off.std() < 1.25
    nothing = misfit_at(error, None, best, right.model, inputs[:2, 1:])
    assert (nothing.mean(best) == 0.0).all() and nothing.sigma[0] == pytest.approx(error)


def test_a_parameter_that_no_soil_has_is_not_trusted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wheels on a soil of 20 kPa, four standard deviations of the prior off; on that of 600 Pa nothing is said."""
    assert default_prior()["cohesion_pa"].widths_off(20_000.0) == pytest.approx(math.log(20_000 / 600) / 0.9)
    monkeypatch.setattr(sys.modules[__name__], "SOIL", SOIL.replace(cohesion_pa=20_000.0))
    found = infer_soil(states(measured(60)), OTHER, model=ContactModel())
    assert not found.verdict.trusted and "cohesion_pa is" in found.verdict.reason, found.verdict.reason
    monkeypatch.undo()
    plain = infer_soil(states(measured(60)), OTHER, model=ContactModel())
    assert plain.verdict.trusted, plain.verdict.reason
