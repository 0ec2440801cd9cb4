"""Catalogues of candidate craters: the embedded one and a user's, however broken.

Distances and directions on the Moon, against geometry that needs no formula and the published table of the site.
"""

import tomllib
import warnings
from pathlib import Path

import numpy as np
import pytest

from lunarsci.constants import MOON_RADIUS_KM
from lunarsci.errors import DataError, ParameterError
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.origin.catalogue import (
    COLUMNS,
    UNKNOWN_AGE_MA,
    azimuth_deg,
    checked_point,
    destination,
    distance_km,
    embedded_catalogue,
    read_catalogue,
)

HEADER = "name,latitude_deg,longitude_deg,diameter_km"
ROOT = Path(__file__).parents[3]


def read(text: str) -> tuple:
    return read_catalogue(InputFile("craters.csv", text.encode()))


def test_every_fact_of_the_embedded_craters_has_a_known_source() -> None:
    known = tomllib.loads((ROOT / "spectra_data/sources.toml").read_text("utf-8"))
    craters = embedded_catalogue()
    assert {"Zhinyu", "Finsen", "Von Kármán L", "Maksutov", "Alder"} <= {crater.name for crater in craters}
    for crater in craters:
        assert {"position", "age"} <= crater.sources.keys(), crater.name
        assert ("composition" in crater.sources) == crater.composition.comparable, crater.name
        assert all(known[key]["table"] == "source_craters.csv" for key in crater.sources.values()), crater.name


def test_what_was_not_published_is_empty_or_says_assumed() -> None:
    known = tomllib.loads((ROOT / "spectra_data/sources.toml").read_text("utf-8"))
    zhinyu = next(crater for crater in embedded_catalogue() if crater.name == "Zhinyu")
    assert not zhinyu.composition.comparable
    assert "ASSUMED" in known[zhinyu.sources["age"]]["what"]
    assert zhinyu.age_ma[1] / zhinyu.age_ma[0] >= 30


def test_a_table_with_all_columns_and_one_with_few() -> None:
    [crater] = read(f"# remark\n\n{HEADER},source\nAlpha,-10,350,5,me\n")
    assert crater.center == (-10, 350)
    assert crater.age_ma == UNKNOWN_AGE_MA
    assert not crater.composition.comparable
    assert crater.sources == {"source": "me"}
    values = dict.fromkeys(COLUMNS, "") | {
        "name": "Beta", "latitude_deg": "1", "longitude_deg": "-2", "diameter_km": "3", "age_low_ma": "10",
        "age_high_ma": "20", "olivine": "0.2", "olivine_sigma": "0.1", "plagioclase": "0.5", "plagioclase_sigma": "0",
        "bc2000_nm": "1950", "bc2000_sigma_nm": "15",
    }  # fmt: skip
    [crater] = read(",".join(values) + "\n" + ",".join(values.values()) + "\n")
    assert crater.age_ma == (10, 20)
    assert crater.composition.modes == {"olivine": (0.2, 0.1), "plagioclase": (0.5, 0.0)}
    assert crater.composition.bands == {"bc2000_nm": (1950, 15)}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (" ", "holds only blanks"),
        ("# only a remark\n", "holds only comments"),
        (HEADER + "\n", "0 rows below the header"),
        ("name,latitude_deg,longitude_deg\nA,1,2\n", "no column diameter_km"),
        (HEADER + ",colour\nA,1,2,3,red\n", "column 'colour' is unknown"),
        (HEADER + ",diameter_km\nA,1,2,3,4\n", "two columns of one name"),
        (HEADER + "\nA,1,2\n", "the header has 4 names and the rows 3 fields"),
        (HEADER + "\nA,1,2,3\nB,nan,2,3\n", "line 3: latitude_deg is 'nan'"),
        (HEADER + "\nA,1,2,inf\n", "line 2: diameter_km is 'inf'"),
        (HEADER + "\nA,1,,3\n", "line 2: longitude_deg is empty"),
        (HEADER + "\nA,1°N,2,3\n", "latitude_deg is '1°N', not a number"),
        (HEADER + "\nA,95,2,3\n", "line 2: latitude is 95"),
        (HEADER + "\nA,5,400,3\n", "longitude is 400"),
        (HEADER + "\nA,5,40,-3\n", "line 2: diameter_km is -3"),
        (HEADER + "\nA,5,40,0\n", "diameter_km is 0"),
        (HEADER + "\nA,5,40,3\n a ,6,40,3\n", "line 3, column 'name': 'a'; each row has a name of its own"),
        (HEADER + "\n,5,40,3\n", "line 2, column 'name': ''"),
        (HEADER + ",age_low_ma\nA,5,40,3,10\n", "go together"),
        (HEADER + ",age_low_ma,age_high_ma\nA,5,40,3,100,10\n", "oldest age is 10; give 100 to 4560"),
        (HEADER + ",age_low_ma,age_high_ma\nA,5,40,3,100,9000\n", "4560"),
        (HEADER + ",olivine\nA,5,40,3,0.1\n", "olivine and olivine_sigma go together"),
        (HEADER + ",olivine,olivine_sigma\nA,5,40,3,0.1,0.1\n", "olivine alone has no share"),
        (
            HEADER + ",olivine,olivine_sigma,plagioclase,plagioclase_sigma\nA,5,40,3,20,5,60,5\n",
            "line 2: olivine is 20; give 0 to 1",
        ),
        (HEADER + ",bc1000_nm,bc1000_sigma_nm\nA,5,40,3,0.93,0.01\n", "give 700 to 1300"),
    ],
)
def test_a_broken_table_says_where_and_what_to_do(text: str, said: str) -> None:
    with pytest.raises(DataError) as caught:
        read(text)
    assert said in str(caught.value)
    assert "craters.csv" in str(caught.value)


@pytest.mark.parametrize(("count", "factor", "told"), [(3, 0.0174533, 1), (2, 0.0174533, 0), (3, 1.0, 0)])
def test_positions_that_may_be_radians_are_told(count: int, factor: float, told: int) -> None:
    places = [(-45.3, 176.1), (-42.3, 182.3), (-40.7, 191.4)][:count]
    rows = "\n".join(f"crater {k},{factor * lat:.6f},{factor * lon:.6f},70" for k, (lat, lon) in enumerate(places))
    source = InputFile("c.csv", f"name,latitude_deg,longitude_deg,diameter_km\n{rows}\n".encode())
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_catalogue(source)
    assert sum("are they in radians?" in str(item.message) for item in caught) == len(caught) == told


SITE = (-45.44, 177.56)
HALF = np.pi * MOON_RADIUS_KM


@pytest.mark.parametrize(
    ("start", "end", "arc"),
    [
        ((0, 0), (0, 90), 0.5),
        ((90, 12), (-90, -77), 1.0),
        ((0, 10), (0, 10 + 180), 1.0),
        ((30, -170), (30, 190), 0.0),
        ((-45.44, 177.56), (45.44, -2.44), 1.0),
        ((60, 0), (0, 0), 1 / 3),
        ((0, 0), (0, 1e-7 / 1e3), 1e-10 / 180),
    ],
)
def test_arcs_that_are_known_without_a_formula(start: tuple, end: tuple, arc: float) -> None:
    assert distance_km(start, end) == pytest.approx(arc * HALF, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize(
    ("crater", "km", "azimuth"),
    [
        ((-45.34, 176.15), 30.2, 275),
        ((-42.29, 182.28), 140.6, 49),
        ((-47.7, 177.9), 68.9, 174),
        ((-40.73, 191.39), 337, 70),
        ((-48.6, 182.6), 141.5, 134),
        ((-37.93, 185.03), 283, 39),
        ((-38.24, 179.49), 223, 12),
    ],
)
def test_craters_around_the_site(crater: tuple, km: float, azimuth: float) -> None:
    """Research notes on the site, computed independently."""
    assert distance_km(SITE, crater) == pytest.approx(km, abs=0.5)
    assert azimuth_deg(SITE, crater) == pytest.approx(azimuth, abs=0.6)


def test_azimuth_has_no_direction_at_the_same_point_and_the_antipode() -> None:
    assert azimuth_deg(SITE, SITE) is None
    assert azimuth_deg(SITE, (45.44, -2.44)) is None
    assert azimuth_deg((0, 0), (0, 1)) == pytest.approx(90)
    assert azimuth_deg((0, 0), (0, -1)) == pytest.approx(270)
    assert azimuth_deg((10, 350), (50, -10)) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("start", [SITE, (89.9, 10), (-90, 0), (0, 0)])
def test_going_somewhere_and_measuring_back(start: tuple) -> None:
    azimuth = np.linspace(5, 355, 15)
    for km in (0.5, 150.0, 3000.0):
        latitude, longitude = destination(start, azimuth, np.full(azimuth.shape, km))
        back = [distance_km(start, point) for point in zip(latitude, longitude, strict=True)]
        assert back == pytest.approx(np.full(azimuth.shape, km), rel=1e-6)
    if abs(start[0]) < 89:
        seen = [azimuth_deg(start, p) for p in zip(*destination(start, azimuth, 150.0), strict=True)]
        assert seen == pytest.approx(azimuth, abs=1e-5)


@pytest.mark.parametrize("point", [(95, 0), (-90.01, 0), (0, 361), (0, -181), (float("nan"), 0), (0, float("inf"))])
def test_points_off_the_moon_are_refused(point: tuple) -> None:
    with pytest.raises(ParameterError, match="; give "):
        checked_point(*point)
