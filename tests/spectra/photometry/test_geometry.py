"""Angles that can occur, and those that cannot."""

import math

import pytest

from lunarsci.errors import ParameterError
from lunarsci.spectra.photometry import STANDARD, Geometry


def test_the_standard_is_30_0_30() -> None:
    assert (STANDARD.incidence_deg, STANDARD.emission_deg, STANDARD.phase_deg) == (30, 0, 30)


@pytest.mark.parametrize(
    "angles", [(0, 0, 0), (60, 45, 90), (60, 45, 15), (60, 45, 105), (89.9, 89.9, 179), (45, 45, 0)]
)
def test_triangles_are_taken(angles: tuple[float, float, float]) -> None:
    assert Geometry(*angles).phase_deg == angles[2]


@pytest.mark.parametrize("phase", [14.6, 105.4])
def test_half_a_degree_of_rounding_is_let_pass(phase: float) -> None:
    assert Geometry(60, 45, phase).phase_deg == phase


@pytest.mark.parametrize("phase", [14.4, 105.6])
def test_what_is_no_triangle_says_which_phases_are(phase: float) -> None:
    with pytest.raises(ParameterError, match=rf"phase angle {phase} deg .* incidence 60 and emission 45 .*15 to 105"):
        Geometry(60, 45, phase)


@pytest.mark.parametrize(
    ("angles", "message"),
    [
        ((90, 0, 90), "incidence angle 90 deg.*not lit"),
        ((-1, 0, 1), "incidence angle -1"),
        ((30, 90, 80), "emission angle 90"),
        ((30, 0, -0.2), "phase angle -0.2"),
        ((89, 89, 180), "phase angle 180"),
        ((math.nan, 0, 30), "incidence angle nan"),
        ((30, math.inf, 30), "emission angle inf"),
        ((30, 0, math.nan), "phase angle nan"),
    ],
)
def test_an_angle_out_of_range_is_named(angles: tuple[float, float, float], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        Geometry(*angles)


def test_cosines() -> None:
    geometry = Geometry(60, 45, 90)
    assert geometry.cos_incidence == pytest.approx(0.5)
    assert geometry.cos_emission == pytest.approx(math.sqrt(0.5))
