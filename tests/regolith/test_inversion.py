"""Gravity-aware stiffness, slip sinkage and sinkage under a load against their formulas and limits."""

import math

import numpy as np
import pytest

from lunarsci.errors import ParameterError
from lunarsci.regolith.forces import closed_form_forces
from lunarsci.regolith.inversion import reece_stiffness, slip_sinkage
from lunarsci.regolith.soil import read_soil
from lunarsci.regolith.traction import sinkage_under_load, stiffness_under_load
from lunarsci.regolith.wheel import read_wheel

WHEEL, SOIL = read_wheel("yutu2"), read_soil("lunar-typical")
MARS_LIKE = {"k_c": 212.2, "k_phi": 677.5, "exponent": 1.4, "width_m": 0.15}


def test_pressure_is_that_of_reece() -> None:
    """At z = b the law reads p = c k_c' + rho g b k_phi'."""
    stiffness = reece_stiffness(**MARS_LIKE, cohesion_pa=500.0, density_kg_m3=1500.0, gravity_m_s2=1.622)
    assert stiffness * 1e3 * 0.15**1.4 == pytest.approx(500 * 212.2 + 1500 * 1.622 * 0.15 * 677.5)


def test_a_frictional_soil_is_softer_on_the_moon_in_proportion() -> None:
    moon, earth = (
        reece_stiffness(**MARS_LIKE, cohesion_pa=0.0, density_kg_m3=1500.0, gravity_m_s2=g) for g in (1.622, 9.81)
    )
    assert moon / earth == pytest.approx(1.622 / 9.81)


def test_slip_digs() -> None:
    assert slip_sinkage(0.01, [0.0, 0.5]) == pytest.approx([0.01, 0.02])
    assert slip_sinkage([0.01, 0.02], 0.5, "linear", rate=2.0) == pytest.approx([0.02, 0.04])


def test_values_out_of_range_are_refused() -> None:
    for changes in ({"width_m": 0.0}, {"exponent": -1.0}, {"k_c": -1.0}, {"k_c": 0.0, "k_phi": 0.0}):
        with pytest.raises(ParameterError):
            reece_stiffness(**(MARS_LIKE | changes), cohesion_pa=1.0, density_kg_m3=1500.0, gravity_m_s2=1.6)
    for arguments in ((-0.01, 0.1), (0.01, -0.1), (0.01, 1.0), (0.01, 0.1, "mine")):
        with pytest.raises(ParameterError):
            slip_sinkage(*arguments)
    with pytest.raises(ParameterError):
        slip_sinkage(0.01, 0.1, rate=np.nan)


def test_the_stiffness_under_a_load_is_the_one_that_carries_it() -> None:
    stiffness = stiffness_under_load(WHEEL, SOIL, 36.0, 0.012, 0.2)
    found = closed_form_forces(WHEEL, SOIL.replace(stiffness_kpa_m_n=stiffness), 0.012, 0.2)
    assert float(found.normal_force_n) == pytest.approx(36.0, rel=1e-9)


def test_sinkage_under_load_carries_the_load_and_grows_with_it() -> None:
    depths = [sinkage_under_load(WHEEL, SOIL, load) for load in (5, 20, 36.5, 80)]
    assert depths == sorted(depths)
    assert float(closed_form_forces(WHEEL, SOIL, depths[2], 0.0).normal_force_n) == pytest.approx(36.5, abs=1e-6)


@pytest.mark.parametrize("load", [-5, 0, math.nan, 1e9, 1e-12])
def test_impossible_loads_are_refused(load: float) -> None:
    with pytest.raises(ParameterError, match=r"load|carries|press"):
        sinkage_under_load(WHEEL, SOIL, load)
