"""Shares of variance by measured quantity."""

import numpy as np
import pytest

from lunarsci.errors import ParameterError
from lunarsci.io.inputs import InputFile
from lunarsci.regolith.identify import Assumptions, sensitivities
from lunarsci.regolith.states import MeasurementErrors, WheelStates, read_states
from lunarsci.regolith.wheel import read_wheel

WHEEL = read_wheel("yutu2")
STATE = b"sinkage_m,slip_ratio,normal_force_n,drawbar_pull_n\n0.005,-0.075,32.03,-1.30\n"


def states(errors: MeasurementErrors | None = None) -> WheelStates:
    return read_states(InputFile("s.csv", STATE), WHEEL, errors)


def test_the_exponent_owes_its_error_to_the_sinkage_as_published() -> None:
    """Ding et al. (2024): sd 0.017 by sinkage, 0.006 by forces, 0.017 by both."""
    found = {
        (share.parameter, share.quantity): share
        for share in sensitivities(states(), WHEEL, Assumptions(stiffness_kpa_m_n=1443), draws=20_000)
    }
    sinkage = found["exponent", "sinkage_m"]
    assert sinkage.alone is not None
    assert sinkage.saved is not None
    assert sinkage.alone == pytest.approx(0.88, abs=0.03)
    assert sinkage.saved == pytest.approx(sinkage.alone, abs=0.04)
    total = sum(share.alone or 0 for (name, _), share in found.items() if name == "exponent")
    assert total == pytest.approx(1, abs=0.05)


def test_exact_measurements_have_nothing_to_divide() -> None:
    exact = states(MeasurementErrors(sinkage_m=0, force_relative=0, travel_relative=0, side_slip_relative=0))
    with pytest.raises(ParameterError, match="nothing to divide"):
        sensitivities(exact, WHEEL)


def test_quantities_not_measured_have_no_row() -> None:
    assert {share.quantity for share in sensitivities(states(), WHEEL)}.isdisjoint({"side_slip_deg", "lateral_force_n"})


def test_long_files_are_thinned() -> None:
    one = states()
    many = WheelStates(tuple(map(str, range(400))), np.repeat(one.values, 400, 0), np.repeat(one.sigmas, 400, 0))
    short, long = (sensitivities(given, WHEEL, draws=4000)[0] for given in (one, many))
    assert long.alone == pytest.approx(short.alone, abs=0.05)
