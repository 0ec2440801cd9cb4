"""Soils by name and file, and measured ones against what is asked of a file: one in twenty lunar ones, clays, loam."""

import math
import warnings
from pathlib import Path

import pytest

import lunarsci
from lunarsci.errors import DataError, LunarSciWarning, ParameterError
from lunarsci.io.tables import table_rows
from lunarsci.regolith.soil import Soil, read_soil, soil_tables, unusual
from lunarsci.regolith.wheel import read_wheel

PACKAGE = "lunarsci.regolith"
WIDTH_M = 0.15
CLAYS = {"heavy clay, 25 % water", "lean clay, 22 % water", "sandy loam of Michigan, 23 % water"}
LEAST = "Apollo 14, trench"
"""Of the lunar soils the one of least cohesion, 30 Pa, which would be likelier with a digit more."""


def measured(row: dict[str, str]) -> list[Soil]:
    """Both ends of a row, with the typical lunar soil where it says nothing."""
    typical, soils = read_soil("lunar-typical"), []
    for end in ("low", "high"):
        known = {"cohesion_pa": f"cohesion_{end}_pa", "friction_angle_deg": f"friction_angle_{end}_deg"}
        known["sinkage_exponent"] = "sinkage_exponent"
        changes = {name: float(row[key]) for name, key in known.items() if row[key]}
        if row["k_phi_kn_m_n_plus_2"]:
            changes["stiffness_kpa_m_n"] = float(row["k_c_kn_m_n_plus_1"]) / WIDTH_M + float(row["k_phi_kn_m_n_plus_2"])
        soils.append(typical.replace(**changes))
    return soils


def test_no_lunar_soil_is_told_and_two_clays_are() -> None:
    rows = table_rows("reference_soils.csv", package=PACKAGE)
    told = {row["name"]: row["kind"] for row in rows if any(unusual(soil) for soil in measured(row))}
    assert len(rows) > 30 and set(told) == CLAYS | {LEAST} and {told[name] for name in CLAYS} == {"terrestrial"}
    typical = read_soil("lunar-typical")
    for row in table_rows("lateral_soils.csv", package=PACKAGE):
        names = ("lateral_modulus_mm", "external_friction_angle_deg")
        assert not unusual(typical.replace(**{name: float(row[name]) for name in names}))
    assert not any(unusual(read_soil(name)) for name in soil_tables())


def test_a_file_of_other_units_is_told_once(tmp_path: Path) -> None:
    file = tmp_path / "soil.toml"
    text = "\n".join(f"{k} = {v}" for k, v in soil_tables()["longji"].items() if k not in ("source", "assumed"))
    file.write_text(text.replace("friction_angle_deg = 42.0", "friction_angle_deg = 0.733"))
    with pytest.warns(LunarSciWarning, match=r"friction_angle_deg is 0\.733, where .* usual; is it in rad\?$") as told:
        read_soil(str(file))
    assert len(told) == 1
    file.write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_soil(str(file))


@pytest.mark.parametrize("given", [{"stiffness": 1.4e6}, {"cohesion": 5.2e5}, {"friction_angle": 0.6}])
def test_an_option_of_other_units_is_told(given: dict[str, float]) -> None:
    with pytest.warns(LunarSciWarning, match=r"the soil: .* usual; is it in"):
        lunarsci.wheel_forces(load=36.5, slip=0.2, **given)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        lunarsci.wheel_forces(load=36.5, slip=0.2, **{name: value / 1000 for name, value in given.items() if value > 1})


@pytest.mark.parametrize(
    "change",
    [
        {"stiffness_kpa_m_n": 0},
        {"friction_angle_deg": 90},
        {"cohesion_pa": -1},
        {"lateral_modulus_mm": math.nan},
        {"sinkage_exponent_slip": math.nan},
        {"colour": 1},
    ],
)
def test_impossible_soils_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(ParameterError):
        read_soil("lunar-typical").replace(**change)


def test_known_soils_can_be_read_and_have_a_source() -> None:
    for name, table in soil_tables().items():
        assert read_soil(name).stiffness_kpa_m_n > 0
        assert table["source"]


def test_unknown_soils_and_rovers_list_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="lunar-typical"):
        read_soil("mars")
    with pytest.raises(DataError, match="yutu2"):
        read_wheel("lunokhod")
    broken = tmp_path / "soil.toml"
    broken.write_text("stiffness_kpa_m_n = 'soft'\n")
    with pytest.raises(DataError, match=r"soil\.toml"):
        read_soil(str(broken))
