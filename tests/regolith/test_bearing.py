"""Gravity-aware stiffness and slip sinkage against their formulas and limits."""

import numpy as np
import pytest

from lunarsci.errors import ParameterError
from lunarsci.regolith.inversion import reece_stiffness, slip_sinkage

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
            slip_sinkage(*arguments)  # type: ignore[arg-type]
    with pytest.raises(ParameterError):
        slip_sinkage(0.01, 0.1, rate=np.nan)
