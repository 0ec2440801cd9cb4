"""Catalogues of candidate craters: the embedded one and a user's, however broken."""

import tomllib
import warnings
from pathlib import Path

import pytest

from lunarsci.errors import DataError
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.origin.catalogue import COLUMNS, UNKNOWN_AGE_MA, embedded_catalogue, read_catalogue

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
        assert ("composition" in crater.sources) == crater.composition.known, crater.name
        assert all(known[key]["table"] == "source_craters.csv" for key in crater.sources.values()), crater.name


def test_what_was_not_published_is_empty_or_says_assumed() -> None:
    known = tomllib.loads((ROOT / "spectra_data/sources.toml").read_text("utf-8"))
    zhinyu = next(crater for crater in embedded_catalogue() if crater.name == "Zhinyu")
    assert not zhinyu.composition.known
    assert "ASSUMED" in known[zhinyu.sources["age"]]["what"]
    assert zhinyu.age_ma[1] / zhinyu.age_ma[0] >= 30


def test_a_table_with_all_columns_and_one_with_few() -> None:
    [crater] = read(f"# remark\n\n{HEADER},source\nAlpha,-10,350,5,me\n")
    assert crater.center == (-10, 350)
    assert crater.age_ma == UNKNOWN_AGE_MA
    assert not crater.composition.known
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
        ("# only a remark\n", "holds no craters"),
        (HEADER + "\n", "holds no craters below its header"),
        ("name,latitude_deg,longitude_deg\nA,1,2\n", "has no column diameter_km"),
        (HEADER + ",colour\nA,1,2,3,red\n", "column 'colour' is unknown"),
        (HEADER + ",diameter_km\nA,1,2,3,4\n", "diameter_km is there twice"),
        (HEADER + "\nA,1,2\n", "line 2: has 3 cells, the header 4"),
        (HEADER + "\nA,1,2,3\nB,nan,2,3\n", "line 3: latitude_deg is 'nan'"),
        (HEADER + "\nA,1,2,inf\n", "line 2: diameter_km is 'inf'"),
        (HEADER + "\nA,1,,3\n", "line 2: longitude_deg is empty"),
        (HEADER + "\nA,1°N,2,3\n", "latitude_deg is '1°N', not a number"),
        (HEADER + "\nA,95,2,3\n", "line 2: latitude is 95 deg"),
        (HEADER + "\nA,5,400,3\n", "longitude is 400 deg"),
        (HEADER + "\nA,5,40,-3\n", "line 2: diameter is -3 km"),
        (HEADER + "\nA,5,40,0\n", "diameter is 0 km"),
        (HEADER + "\nA,5,40,3\n a ,6,40,3\n", "line 3: a second 'a'"),
        (HEADER + "\n,5,40,3\n", "has no name"),
        (HEADER + ",age_low_ma\nA,5,40,3,10\n", "go together"),
        (HEADER + ",age_low_ma,age_high_ma\nA,5,40,3,100,10\n", "it must rise"),
        (HEADER + ",age_low_ma,age_high_ma\nA,5,40,3,100,9000\n", "4560"),
        (HEADER + ",olivine\nA,5,40,3,0.1\n", "olivine and olivine_sigma go together"),
        (HEADER + ",olivine,olivine_sigma\nA,5,40,3,0.1,0.1\n", "olivine alone is no share"),
        (
            HEADER + ",olivine,olivine_sigma,plagioclase,plagioclase_sigma\nA,5,40,3,20,5,60,5\n",
            "line 2: olivine is 20; a mode is a fraction",
        ),
        (HEADER + ",bc1000_nm,bc1000_sigma_nm\nA,5,40,3,0.93,0.01\n", "it must be 700 to 1300 nm"),
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
