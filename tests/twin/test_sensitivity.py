"""What moves the end of a drive: soil parameters one by one, and the time step."""

import dataclasses

import numpy as np
import pytest

from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.judgement.endpoint import endpoint_sensitivity, step_error_m
from lunarsci.twin.plans.plan import Fixes, parse_sweep, read_plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import predict

SWEEP = (parse_sweep("friction_angle_deg=25:55:5"), parse_sweep("lateral_modulus_mm=15:45:5"))


def test_one_parameter_at_a_time_moves_the_end_as_the_fit_says(yutu2: Rover) -> None:
    """Against two drives at the ends of each range, the other parameter at its middle."""
    terrain, plan = synthetic_longji(rms_m=0.0), read_plan()
    found = {share.parameter: share for share in endpoint_sensitivity(predict(yutu2, terrain, plan, sweep=SWEEP))}
    for name, own, other in (
        ("friction_angle_deg", "friction_angle_deg=25:55:2", "lateral_modulus_mm=30:30:1"),
        ("lateral_modulus_mm", "lateral_modulus_mm=15:45:2", "friction_angle_deg=40:40:1"),
    ):
        pair = predict(yutu2, terrain, plan, sweep=(parse_sweep(own), parse_sweep(other)))
        order = np.argsort(pair.parameters[name])
        shift = pair.endpoints_m[order[1]] - pair.endpoints_m[order[0]]
        assert np.hypot(*(shift - (found[name].x_m, found[name].y_m))) < 0.25 * np.hypot(*shift)
    assert 0.9 < sum(share.share for share in found.values()) < 1.05


def test_few_members_and_no_sweep_have_no_sensitivity(yutu2: Rover, slope, straight) -> None:  # type: ignore[no-untyped-def]
    assert endpoint_sensitivity(predict(yutu2, slope(), straight(0.5), sweep=())) == []


@pytest.mark.parametrize("dt", [0.2, 0.1])
def test_the_stated_step_error_is_the_one_against_a_fine_step(yutu2: Rover, dt: float) -> None:
    terrain, plan = synthetic_longji(rms_m=0.0), read_plan()
    coarse, fine = (predict(yutu2, terrain, plan, sweep=(), time_step_s=step) for step in (dt, 0.002))
    error = float(np.hypot(*(coarse.endpoints_m[0] - fine.endpoints_m[0])))
    assert step_error_m(coarse) == pytest.approx(error, rel=0.3)


@pytest.mark.parametrize("fixes", [None, Fixes(0.005, 0.1)])
def test_the_step_error_is_that_of_the_member_that_misses_most(yutu2: Rover, fixes: Fixes | None) -> None:
    """Of two soils the second; where it is fixed on the way, that fix counts as exact at every step."""
    terrain, plan = synthetic_longji(rms_m=0.0), dataclasses.replace(read_plan(), fixes=fixes)
    exact = dataclasses.replace(plan, fixes=fixes and Fixes(0.0, 0.0))
    soils = {"friction_angle_deg": np.array([40.0, 25.0])}
    driven = predict(yutu2, terrain, plan, samples=soils, time_step_s=0.1)
    coarse, fine = (predict(yutu2, terrain, exact, samples=soils, time_step_s=step) for step in (0.1, 0.005))
    error = np.hypot(*(coarse.endpoints_m - fine.endpoints_m).T)
    assert driven.miss_m.argmax() == 1
    assert step_error_m(driven) == pytest.approx(error[1], rel=0.2)


def test_steps_too_fine_to_matter_are_not_halved(yutu2: Rover, slope, straight) -> None:  # type: ignore[no-untyped-def]
    assert step_error_m(predict(yutu2, slope(), straight(0.2), sweep=(), time_step_s=0.005)) is None


def test_a_drive_that_did_not_finish_has_no_step_error(yutu2: Rover, slope, straight) -> None:  # type: ignore[no-untyped-def]
    lost = predict(yutu2, slope(), straight(15.0), sweep=())
    assert step_error_m(lost) is None
    assert endpoint_sensitivity(dataclasses.replace(lost, parameters={"cohesion_pa": np.array([1.0])})) == []
