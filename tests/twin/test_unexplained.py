"""What the best soil of a drive leaves unexplained: when that is a reason to refuse, and what it teaches."""

import dataclasses

import numpy as np
import pytest

from lunarsci.regolith.belief import first_belief
from lunarsci.regolith.physics_discrepancy import FIRST
from lunarsci.twin.assimilation.residuals import OBSERVED, DriveRecord, DriveResiduals
from lunarsci.twin.assimilation.update import _refusal, _taught, unexplained_share
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction

SIGMA = np.array([0.00033, 0.01, 0.1, 1.0, 0.05, 0.1])


@pytest.fixture(scope="module")
def best(driven: Prediction) -> Prediction:
    """One of the 20 drives, on level ground with a push from the side so that no quantity is 0."""
    parts = {name: getattr(driven, name)[:1] for name in ("paths", "states", "recorded", "outcome")}
    states = parts.pop("states").copy()
    states[..., STATE_COLUMNS.index("side_slip_deg")] = 3.0
    states[..., STATE_COLUMNS.index("drawbar_pull_n")] = 2.0
    parameters = {name: values[:1] for name, values in driven.parameters.items()}
    return dataclasses.replace(driven, states=states, parameters=parameters, **parts)


def expected_of(best: Prediction) -> np.ndarray:
    return best.states[0, ::2][..., [STATE_COLUMNS.index(name) for name in OBSERVED]].reshape(-1, 6)


def drive(
    best: Prediction, factor: dict[str, float], inflation: dict[str, float], off_m: float = 0.0
) -> DriveResiduals:
    """The drive with quantities multiplied, its errors widened, and its end `off_m` to the left."""
    values = expected_of(best) * np.array([factor.get(name, 1.0) for name in OBSERVED])
    record = DriveRecord(
        time_s=np.repeat(best.time_s[::2], 6),
        wheel=best.rover.wheels * len(best.time_s[::2]),
        values=values,
        sigmas=np.tile(SIGMA, (len(values), 1)),
        fix_time_s=best.time_s[-1:],
        fix_m=best.paths[0, -1:, :2] + (0.0, off_m),
        fix_covariance_m2=1e-6 * np.eye(2)[None],
    )
    return DriveResiduals(best.rover, best.terrain, best.plan, record, first_belief(), inflation=inflation)


@pytest.mark.parametrize(
    ("factor", "inflation", "off_m", "says"),
    [
        # A law that is off by a third of a force or of the sinkage is no fault of the drive, however good the sensors.
        ({"drawbar_pull_n": 1.4}, {"drawbar_pull_n": 14.0}, 0.0, ""),
        ({"sinkage_m": 1.5}, {"sinkage_m": 20.0}, 0.0, ""),
        ({}, {"position": 30.0}, 0.05, ""),
        # A wrong sign, a wrong unit, and an end that is elsewhere are.
        ({"drawbar_pull_n": -1.0}, {"drawbar_pull_n": 60.0}, 0.0, "misses drawbar_pull_n by 60.0 times"),
        ({"sinkage_m": 10.0}, {"sinkage_m": 200.0}, 0.0, "misses sinkage_m"),
        ({"side_slip_deg": 0.01745}, {"side_slip_deg": 30.0}, 0.0, "misses side_slip_deg"),
        ({}, {"position": 90.0}, 0.3, "misses position by 90.0 times its errors; look at its sign and unit"),
    ],
)
def test_refused_is_what_no_physics_explains(
    best: Prediction, factor: dict[str, float], inflation: dict[str, float], off_m: float, says: str
) -> None:
    found = _refusal(drive(best, factor, inflation, off_m), 0, {}, expected_of(best), best)
    assert says in found if says else found == ""


def test_outliers_and_single_wheels_are_refused_as_before(best: Prediction) -> None:
    plain, expected = drive(best, {}, {}), expected_of(best)
    assert "values are explained by no soil" in _refusal(plain, int(0.1 * plain.known.sum()), {}, expected, best)
    assert "are wheels exchanged" in _refusal(plain, 0, {"sinkage_m": 0.02}, expected, best)


def test_what_states_leave_unexplained_widens_the_discrepancy(best: Prediction) -> None:
    expected = expected_of(best)
    none, some = drive(best, {}, {}), drive(best, {}, {"sinkage_m": 10.0})
    assert unexplained_share(none, expected, best) == 0.0
    sinkage = np.abs(expected[some.known[:, 0], 0]).mean()
    own = np.hypot(0.00033, 5e-5) * np.sqrt(99.0) / sinkage
    assert unexplained_share(some, expected, best) == pytest.approx(own, rel=0.01)
    clear, off = (_taught(FIRST, one, expected, best) for one in (none, some))
    assert clear.along.degrees > FIRST.along.degrees and clear.along.scale < 1.2 * FIRST.along.scale
    assert off.along.scale > 2.0 * clear.along.scale and off.across.scale > 2.0 * clear.across.scale


def test_an_end_that_the_best_soil_misses_widens_it(best: Prediction) -> None:
    expected = expected_of(best)
    near, far = (_taught(FIRST, drive(best, {}, {}, off_m), expected, best) for off_m in (0.0, 0.05))
    assert far.across.scale > 1.5 * near.across.scale
    assert far.along.scale == pytest.approx(near.along.scale, rel=0.2)
