"""The regolith from Python: tables in, results with units out, the same as the commands give."""

import json

import numpy as np
import pandas as pd
import pytest
from astropy import units

from lunarsci.errors import ParameterError, RequestError
from lunarsci.regolith.jobs.compare_soils import compare_soils
from lunarsci.regolith.jobs.identify import IdentifiedSoil, identify
from lunarsci.regolith.jobs.infer import InferredSoil, infer
from lunarsci.regolith.jobs.wheel_forces import WheelForcesRequest, wheel_forces


@pytest.fixture(scope="module")
def states() -> pd.DataFrame:
    """Synthetic: what the closed form of lunar-typical soil gives at eight states."""
    rows = [wheel_forces(sinkage=0.008 + 0.001 * k, slip=0.05 * k, side_slip=1.0 + k).rows()[0] for k in range(8)]
    return pd.DataFrame(rows)


@pytest.fixture(scope="module")
def identified(states: pd.DataFrame) -> IdentifiedSoil:
    return identify(states, lateral_modulus=20, draws=64, sensitivity=True)


@pytest.fixture(scope="module")
def inferred(states: pd.DataFrame) -> InferredSoil:
    return infer(states, draws=16)


def test_forces_have_units_and_a_request_can_be_changed() -> None:
    asked = WheelForcesRequest(load=36.5, slip=0.2)
    found = wheel_forces(asked)
    table = found.to_table()
    assert table["normal_force_n"].unit == units.N and table["resistance_torque_nm"].unit == units.N * units.m
    assert found.forces.normal_force_n == pytest.approx(36.5)
    assert found.untrusted == "" and "drawbar_pull_n" in found._repr_html_()
    softer = wheel_forces(asked, stiffness=500.0)
    assert softer.sinkage_m > found.sinkage_m and softer.soil.stiffness_kpa_m_n == 500.0


def test_shares_of_grip_need_the_integrals_and_have_them_without_being_asked() -> None:
    assert WheelForcesRequest(load=36.5).model is None
    for choice in ({"exact": True}, {"shear": "ellipse"}, {"bulldozing": "wong"}, {"rebound": 0.0}):
        assert WheelForcesRequest(load=36.5, **choice).model is not None  # type: ignore[arg-type]


def test_a_soil_is_found_again_in_its_forces(identified: IdentifiedSoil) -> None:
    """K_s of lunar-typical soil at its exponent of 1."""
    from lunarsci.regolith.soil import read_soil

    site = identified.found.site
    assert site["stiffness_kpa_m_n"].value == pytest.approx(read_soil("lunar-typical").stiffness_kpa_m_n, rel=0.25)
    assert len(identified.to_table()) == 8 and identified.to_table()["sigma_m_pa"].unit == units.Pa
    assert {"alone", "saved"} <= set(identified.to_dict()["sensitivity"][0])
    assert json.loads(identified.to_json(time=False))["schema"] == "lunarsci/regolith-identify/1"


def test_all_states_together_keep_what_each_says(inferred: InferredSoil) -> None:
    made = inferred.to_dict()
    assert {"bearing", "shear", "lateral", "observations", "joint"} <= set(made)
    assert made["joint"]["laws"] == [] and made["joint"]["predicted"] is None
    rows = inferred.soils(".csv").decode().splitlines()
    assert rows[0].startswith("# verdict of the fit: ") and len(rows) == 2 + len(inferred.posterior.draws)
    values = np.array([float(cell) for cell in rows[2].split(",")])
    assert np.array_equal(values, inferred.posterior.draws[0][:8])
    assert json.loads(inferred.soils(".json"))["schema"] == "lunarsci/soil-belief/1"


def test_a_site_is_compared_as_an_object_or_as_numbers(identified: IdentifiedSoil) -> None:
    by_result = compare_soils(identified)
    assert len(by_result.rows()) == len(by_result.soils) > 30
    assert by_result.plot() is not None
    numbers = compare_soils(stiffness=by_result.site.stiffness_kpa_m_n, exponent=1.0)
    assert [soil.bearing for soil in numbers.soils] == [soil.bearing for soil in by_result.soils]


@pytest.mark.parametrize(
    ("job", "options"),
    [
        (wheel_forces, {}),
        (wheel_forces, {"load": 30.0, "sinkage": 0.01}),
        (wheel_forces, {"sinkage": 0.01, "slip_sinkage": "linear"}),
        (wheel_forces, {"load": 30.0, "lode": 1}),
        (compare_soils, {}),
    ],
)
def test_what_makes_no_sense_is_refused(job, options) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(RequestError):
        job(**options)


def test_options_of_the_inference_that_exclude_each_other(states: pd.DataFrame) -> None:
    for options in ({"sample": True, "profile": True}, {"law": "auto", "contact": True}, {"reading": "printed"}):
        with pytest.raises(RequestError):
            infer(states, **options)
    with pytest.raises(RequestError, match="`lateral_modulus` a,b"):
        identify(states, lateral_modulus="a,b")
    with pytest.raises(ParameterError, match="go together"):
        compare_soils(cohesion=500.0)
