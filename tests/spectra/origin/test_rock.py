"""Rocks from JSON results, whole and broken."""

import json
from typing import Any

import numpy as np
import pytest

from lunarsci.errors import DataError
from lunarsci.inputs import InputFile
from lunarsci.spectra.origin.composition import Composition, Rock, joined, read_rocks


def read(kind: str, *records: Any) -> list[Rock]:
    document = {"schema": f"lunarsci/spectra-{kind}/1", "result": {"spectra": list(records)}}
    return read_rocks(InputFile("rock.json", json.dumps(document).encode()))


def test_nbsr_is_a_ratio_of_two_minerals_with_all_its_errors() -> None:
    ratio = {"opx": 0.46, "cpx": 0.54, "sigma": 0.03, "calibration": 0.04, "continuum": None}
    [rock] = read("fit", {"id": "a", "nbsr": {"um1": None, "um2": ratio}})
    mean, covariance = rock.composition.shares(("orthopyroxene", "clinopyroxene"))
    assert mean == pytest.approx([0.46, 0.54])
    assert np.sqrt(np.diag(covariance)) == pytest.approx([0.05, 0.05])
    assert "uncalibrated" in rock.remarks[0]


def test_abundances_come_before_ratios() -> None:
    modes = {"olivine": (0.1, 0.05, 0.2), "orthopyroxene": (0.3, 0.2, 0.4), "plagioclase": (0.6, 0.5, 0.7)}
    abundance: dict[str, Any] = {
        name: dict(zip(("fraction", "low", "high"), values, strict=True)) for name, values in modes.items()
    }
    abundance |= {"clinopyroxene": None, "method": "unmixing", "in_domain": False}
    ratio = {"opx": 0.9, "sigma": 0.03}
    [rock] = read("fit", {"id": "a", "nbsr": {"um2": ratio}, "abundance": abundance})
    assert rock.composition.modes["olivine"] == pytest.approx((0.1, 0.075))
    assert set(rock.composition.modes) == set(modes)
    assert "outside the domain" in " ".join(rock.remarks)


def test_band_centres_with_all_their_errors() -> None:
    record = {
        "id": "a", "bc1000_nm": 930.0, "bc1000_sigma_nm": 3.0, "bc1000_systematic_nm": 4.0,
        "bc1000_calibration_nm": 12.0, "bc2000_nm": None, "bc2000_sigma_nm": None,
    }  # fmt: skip
    [rock] = read("bands", record)
    assert rock.composition.bands == {"bc1000_nm": pytest.approx((930.0, 13.0))}


def test_spectra_without_a_result_are_left_out() -> None:
    ratio = {"opx": 0.4, "sigma": 0.03}
    rocks = read("fit", {"id": "no", "nbsr": None}, {"id": "yes", "nbsr": {"um2": ratio}}, {"id": "none", "nbsr": {}})
    assert [rock.id for rock in rocks] == ["yes"]


def test_two_results_of_one_rock_are_one_rock() -> None:
    modes = Rock("a", Composition({"olivine": (0.5, 0.1), "plagioclase": (0.5, 0.1)}))
    bands = Rock("a", Composition({}, {"bc1000_nm": (930, 5)}))
    [rock] = joined([modes, bands])
    assert rock.composition.modes and rock.composition.bands
    assert len(joined([modes, Rock("b", modes.composition)])) == 2
    with pytest.raises(DataError, match="a: is in the inputs twice"):
        joined([modes, modes])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "is no JSON"),
        ("[1]", "is no result of lunarsci"),
        ('{"schema": "lunarsci/forces/1", "result": {}}', "schema is 'lunarsci/forces/1'"),
        ('{"schema": "lunarsci/spectra-fit/1"}', "has no result.spectra"),
        ('{"schema": "lunarsci/spectra-fit/1", "result": {"spectra": []}}', "no spectrum has modes"),
        ('{"schema": "lunarsci/spectra-fit/1", "result": {"spectra": [{"nbsr": {"um2": {"opx": 1.4, "sigma": 0.1}}}]}}',
         "a mode is a fraction"),
        ('{"schema": "lunarsci/spectra-fit/1", "result": {"spectra": [{"nbsr": {"um2": {"opx": 0.4}}}]}}',
         "NBSR has no error"),
        ('{"schema": "lunarsci/spectra-fit/1", "result": {"spectra": [{"nbsr": 5}]}}', "was the file edited"),
        ('{"schema": "lunarsci/spectra-bands/1", "result": {"spectra": [{"bc1000_nm": "x", "bc1000_sigma_nm": 1}]}}',
         "was the file edited"),
        ('{"schema": "lunarsci/spectra-bands/1", "result": {"spectra": [{"bc1000_nm": 0.93, "bc1000_sigma_nm": 1}]}}',
         "700 to 1300"),
    ],
)  # fmt: skip
def test_broken_results_say_where_and_what_to_do(text: str, said: str) -> None:
    with pytest.raises(DataError) as caught:
        read_rocks(InputFile("rock.json", text.encode()))
    assert said in str(caught.value)
    assert str(caught.value).startswith("rock.json: ")
