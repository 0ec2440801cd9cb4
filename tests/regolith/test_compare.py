"""A site beside other soils: the table, the distances, the picture."""

import math

import pytest

from lunarsci.errors import ParameterError
from lunarsci.regolith.compare import KINDS, Site, compare_site, nearest, reference_soils
from lunarsci.regolith.figure import comparison_figure

LONGJI = Site(stiffness_kpa_m_n=1443, sinkage_exponent=1.0, cohesion_pa=520, friction_angle_deg=42)


def test_every_row_has_a_source_and_values_in_order() -> None:
    soils = reference_soils()
    assert len({soil.name for soil in soils}) == len(soils) == 45
    assert {soil.kind for soil in soils} == set(KINDS)
    for soil in soils:
        assert soil.source
        assert 0 <= soil.cohesion_pa[0] <= soil.cohesion_pa[1]
        assert 0 < soil.friction_angle_deg[0] <= soil.friction_angle_deg[1] < 90
        assert (soil.k_c is None) == (soil.k_phi is None) == (soil.sinkage_exponent is None)


def test_sandy_loam_of_michigan_is_near_the_longji_site_in_bearing() -> None:
    """As Ding et al. (2024) found; K_s of it is 1478 kPa m^-N at 150 mm."""
    [loam] = [soil for soil in reference_soils() if soil.name.startswith("sandy loam of Michigan, 11 %")]
    assert loam.stiffness(0.15) == pytest.approx(1478, abs=1)
    first = [item.soil.name for item in nearest(compare_site(LONGJI, 0.15), "bearing")[:6]]
    assert loam.name in first


def test_distances_are_those_of_predictions() -> None:
    site = Site(
        stiffness_kpa_m_n=2 * 820 + 2 * 1.4 / 0.15, sinkage_exponent=1.0, cohesion_pa=340, friction_angle_deg=35
    )
    [nominal] = [item for item in compare_site(site, 0.15) if item.soil.name == "lunar soil, nominal"]
    assert nominal.bearing == pytest.approx(math.log(2))
    assert nominal.strength is not None
    assert 0 < nominal.strength < math.log(2)


def test_a_range_holds_what_lies_in_it() -> None:
    [apollo] = [item for item in compare_site(LONGJI, 0.15) if item.soil.name == "Apollo 12, drive tube"]
    assert apollo.strength == 0
    assert apollo.bearing is None


def test_half_a_pair_and_nonsense_are_refused() -> None:
    for values in (
        {}, {"cohesion_pa": 500.0}, {"stiffness_kpa_m_n": 820.0}, {"cohesion_pa": -1.0, "friction_angle_deg": 30.0},
        {"cohesion_pa": 1.0, "friction_angle_deg": 90.0}, {"stiffness_kpa_m_n": 0.0, "sinkage_exponent": 1.0},
    ):  # fmt: skip
        with pytest.raises(ParameterError):
            Site(**values)
    with pytest.raises(ParameterError):
        compare_site(LONGJI, 0.0)


def test_the_picture_has_four_panels_the_curves_of_the_wheel_states_and_names_the_nearest() -> None:
    curve = [{"exponent": n, "stiffness_kpa_m_n": 1000.0, "low": 900.0, "high": 1100.0} for n in (0.9, 1.0)]
    figure = comparison_figure(LONGJI, compare_site(LONGJI, 0.15), 0.15, {"bearing": curve})
    bearing, _, missions, lateral = figure.axes
    assert [len(axes.collections) for axes in figure.axes] == [1, 0, 0, 0]
    assert bearing.collections[0].get_datalim(bearing.transData).extents == pytest.approx([0.9, 900.0, 1.0, 1100.0])
    assert "Apollo 12, drive tube" in {text.get_text() for text in missions.texts}
    assert {"FJS-1 simulant", "Longji at the lowest K$_y$"} <= {text.get_text() for text in lateral.texts}


def test_half_a_lateral_pair_is_refused() -> None:
    with pytest.raises(ParameterError, match="lateral"):
        Site(cohesion_pa=500.0, friction_angle_deg=40.0, lateral_modulus_mm=20.0)
