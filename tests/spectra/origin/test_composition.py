"""Shares of minerals and their errors, against random draws.

Rocks from JSON results, whole and broken.
"""

import json
from typing import Any

import numpy as np
import pytest

from lunarsci.errors import DataError, ParameterError, RequestError
from lunarsci.io.inputs import InputFile
from lunarsci.spectra.jobs.match import match
from lunarsci.spectra.origin.composition import (
    Composition,
    Rock,
    _scaled,
    closed,
    joined,
    measured_errors,
    read_rocks,
    stated_composition,
)

MODES = {"olivine": (0.14, 0.02), "orthopyroxene": (0.38, 0.02), "plagioclase": (0.48, 0.03)}


def test_shares_are_those_of_draws() -> None:
    composition = Composition(MODES)
    mean, covariance = composition.shares(("olivine", "orthopyroxene"))
    rng = np.random.default_rng(0)
    draws = rng.normal([0.14, 0.38], 0.02, (200_000, 2))
    draws /= draws.sum(axis=1, keepdims=True)
    assert mean == pytest.approx(draws.mean(axis=0), abs=1e-3)
    assert covariance == pytest.approx(np.cov(draws.T), rel=0.02)
    assert mean.sum() == pytest.approx(1)
    assert np.abs(covariance.sum(axis=0)).max() < 1e-12


def test_correlated_modes() -> None:
    """Two modes that err oppositely by s: their share errs by s as well."""
    opposite = np.array([[1.0, -1.0], [-1.0, 1.0]])
    composition = Composition({"orthopyroxene": (0.46, 0.06), "clinopyroxene": (0.54, 0.06)}, {}, opposite)
    mean, covariance = composition.shares(("orthopyroxene", "clinopyroxene"))
    assert mean == pytest.approx([0.46, 0.54])
    assert np.sqrt(covariance[0, 0]) == pytest.approx(0.06)
    swapped = composition.shares(("clinopyroxene", "orthopyroxene"))
    assert swapped[0] == pytest.approx([0.54, 0.46])


@pytest.mark.parametrize(
    ("modes", "said"),
    [
        ({"olivine": (1.3, 0.1), "plagioclase": (0.1, 0.1)}, "olivine is .*; give 0 to 1"),
        ({"olivine": (-0.1, 0.1), "plagioclase": (0.1, 0.1)}, "olivine is .*; give 0 to 1"),
        ({"olivine": (float("nan"), 0.1), "plagioclase": (0.1, 0.1)}, "olivine is nan; give 0 to 1"),
        (
            {"olivine": (0.8, 0.1), "plagioclase": (0.5, 0.1)},
            "sum of the modes is 1.3; give .* at most 1.1",
        ),
        ({"olivine": (0, 0.1), "plagioclase": (0, 0.1)}, "sum of the modes is 0"),
        ({"olivine": (0.8, -0.1), "plagioclase": (0.1, 0.1)}, "error of olivine"),
        ({"olivine": (0.8, 0.1)}, "olivine alone has no share"),
        ({"ilmenite": (0.8, 0.1), "olivine": (0.1, 0.1)}, "'ilmenite' is no mineral"),
    ],
)
def test_impossible_modes_are_refused(modes: dict, said: str) -> None:
    with pytest.raises(ParameterError, match=said):
        Composition(modes)


@pytest.mark.parametrize(
    ("bands", "said"),
    [
        ({"bc1000_nm": (0.93, 0.01)}, "give 700 to 1300"),
        ({"bc1000_nm": (930, 0)}, "error of bc1000_nm is 0; give a number above 0"),
        ({"bc2000_nm": (930, 5)}, "1500 to 2600"),
        ({"bc3000_nm": (3000, 5)}, "'bc3000_nm' is no mineral or band"),
    ],
)
def test_impossible_bands_are_refused(bands: dict, said: str) -> None:
    with pytest.raises(ParameterError, match=said):
        Composition({}, bands)


def test_nothing_cannot_be_shared() -> None:
    with pytest.raises(ParameterError, match="nothing to compare"):
        closed(np.zeros(3), np.eye(3))


def test_modes_are_scaled_only_where_they_add_up_to_too_much() -> None:
    few = {"olivine": (0.3, 0.1), "plagioclase": (0.4, 0.1)}
    assert _scaled(few) == few
    many = {"olivine": (0.9, 0.1), "plagioclase": (0.6, 0.1)}
    assert _scaled(many) == {"olivine": pytest.approx((0.6, 0.1)), "plagioclase": pytest.approx((0.4, 0.1))}


def read_result(kind: str, *records: Any) -> list[Rock]:
    document = {"schema": f"lunarsci/spectra-{kind}/1", "result": {"spectra": list(records)}}
    return read_rocks(InputFile("rock.json", json.dumps(document).encode()))


def test_nbsr_is_a_ratio_of_two_minerals_with_all_its_errors() -> None:
    ratio = {"opx": 0.46, "cpx": 0.54, "sigma": 0.03, "calibration": 0.04, "continuum": None}
    [rock] = read_result("fit", {"id": "a", "nbsr": {"um1": None, "um2": ratio}})
    mean, covariance = rock.composition.shares(("orthopyroxene", "clinopyroxene"))
    assert mean == pytest.approx([0.46, 0.54])
    assert np.sqrt(np.diag(covariance)) == pytest.approx([0.05, 0.05])
    assert "uncalibrated" in rock.remarks[0]


SHARES = {
    "olivine": {"fraction": None, "low": 0.1, "high": 0.5},
    "orthopyroxene": {"fraction": 0.3, "low": 0.28, "high": 0.32},
    "plagioclase": {"fraction": 0.5, "low": 0.4, "high": 0.6},
}


def test_a_share_that_is_not_determined_counts_with_its_interval() -> None:
    [rock] = read_result("fit", {"id": "a", "abundance": SHARES | {"in_domain": True}})
    assert rock.composition.modes["olivine"] == pytest.approx((0.3, 0.2))
    assert rock.composition.modes["orthopyroxene"] == pytest.approx((0.3, 0.02))
    assert "not determined, known by their intervals alone: olivine" in rock.remarks
    assert rock.tables == ()


def test_shares_of_which_none_is_determined_decide_nothing() -> None:
    nothing: dict[str, Any] = {mineral: {"fraction": None, "low": 0.0, "high": 1.0} for mineral in SHARES}
    [rock] = read_result(
        "fit", {"id": "a", "abundance": nothing | {"in_domain": False, "status": "not determined: weathered"}}
    )
    assert not rock.composition.comparable
    assert rock.remarks == ("its shares decide nothing: not determined: weathered",)


@pytest.mark.parametrize("kind", ["dark-rock-powder", "solid-rock"])
def test_out_of_domain_errors_are_at_least_those_measured_of_the_kind(kind: str) -> None:
    [rock] = read_result("fit", {"id": "a", "kind": {"name": kind}, "abundance": SHARES | {"in_domain": False}})
    least = measured_errors(kind)
    assert 0.05 < min(least.values()) < max(least.values()) < 0.25
    assert rock.composition.modes["orthopyroxene"] == pytest.approx((0.3, least["orthopyroxene"]))
    assert rock.composition.modes["olivine"][1] == pytest.approx(0.2)
    assert any(f"errors at least those measured of unmixed spectra of {kind}" in text for text in rock.remarks)
    assert rock.tables == ("share_errors.csv",)


def test_quoted_errors_are_widened_where_the_kind_is_stated() -> None:
    quoted, none = stated_composition("ol=0.2:0.02,plg=0.8:0.5", None)
    assert quoted.modes["olivine"] == (0.2, 0.02)
    assert none == ()
    wide, [remark] = stated_composition("ol=0.2:0.02,plg=0.8:0.5", None, "powder-mixture")
    assert wide.modes["olivine"][1] == measured_errors("powder-mixture")["olivine"]
    assert wide.modes["plagioclase"] == (0.8, 0.5)
    assert remark.startswith("errors at least those measured of unmixed spectra of powder-mixture: olivine")
    with pytest.raises(RequestError, match="`kind` is of `modes`"):
        match(bands="bc1000=930:5", kind="solid-rock")


def test_abundances_come_before_ratios() -> None:
    modes = {"olivine": (0.1, 0.05, 0.2), "orthopyroxene": (0.3, 0.2, 0.4), "plagioclase": (0.6, 0.5, 0.7)}
    abundance: dict[str, Any] = {
        name: dict(zip(("fraction", "low", "high"), values, strict=True)) for name, values in modes.items()
    }
    abundance |= {"clinopyroxene": None, "method": "unmixing", "in_domain": False}
    ratio = {"opx": 0.9, "sigma": 0.03}
    [rock] = read_result("fit", {"id": "a", "nbsr": {"um2": ratio}, "abundance": abundance})
    assert rock.composition.modes["olivine"] == pytest.approx((0.1, 0.075))
    assert set(rock.composition.modes) == set(modes)
    assert "out of domain" in " ".join(rock.remarks)


def test_band_centres_with_all_their_errors() -> None:
    record = {
        "id": "a", "bc1000_nm": 930.0, "bc1000_sigma_nm": 3.0, "bc1000_systematic_nm": 4.0,
        "bc1000_calibration_nm": 12.0, "bc2000_nm": None, "bc2000_sigma_nm": None,
    }  # fmt: skip
    [rock] = read_result("bands", record)
    assert rock.composition.bands == {"bc1000_nm": pytest.approx((930.0, 13.0))}


def test_of_a_spectrum_without_a_result_nothing_is_known_and_a_reason_says_why() -> None:
    ratio, both = {"opx": 0.4, "sigma": 0.03}, ("orthopyroxene", "clinopyroxene")
    bands = [{"mineral": mineral, "region": "um2"} for mineral in both]
    rocks = read_result(
        "fit",
        {"id": "failed", "nbsr": None, "bands": [], "status": "too few channels"},
        {"id": "yes", "nbsr": {"um2": ratio}, "bands": bands},
        {"id": "open", "nbsr": {"um2": None}, "bands": bands},
        {"id": "one", "nbsr": {"um2": None}, "bands": bands[:1], "assemblage": "OL-OPX"},
        {"id": "pure", "abundance": {"olivine": {"fraction": 1, "low": 1, "high": 1}}},
    )
    [centres] = read_result("bands", {"id": "flat"})
    assert [rock.composition.comparable for rock in rocks] == [False, True, False, False, False]
    reasons = {rock.id: rock.remarks[0] for rock in (*rocks, centres)}
    assert reasons["failed"].startswith("there is no fit of it: too few channels; make shares by")
    assert "leave the ratio of pyroxenes at 2 µm (NBSR) open" in reasons["open"]
    assert "without bands of both pyroxenes at 2 µm (OL-OPX)" in reasons["one"]
    assert reasons["pure"] == "it has shares of fewer than two minerals"
    assert reasons["flat"] == "it has no band centre with an error"


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
        ("[1]", "it has no result.spectra"),
        ('{"schema": "lunarsci/forces/1", "result": {}}', "schema is 'lunarsci/forces/1'"),
        ('{"schema": "lunarsci/spectra-fit/1"}', "has no result.spectra"),
        ('{"schema": "lunarsci/spectra-fit/1", "result": {"spectra": []}}',
         "has no spectrum; make shares by `lunarsci spectra unmix FILE -o shares.json`"),
        ('{"schema": "lunarsci/spectra-fit/1", "result": {"spectra": [{"nbsr": {"um2": {"opx": 1.4, "sigma": 0.1}}}]}}',
         "orthopyroxene is 1.4; give 0 to 1"),
        ('{"schema": "lunarsci/spectra-fit/1", "result": {"spectra": [{"nbsr": {"um2": {"opx": 0.4}}}]}}',
         "error of NBSR is 0"),
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
