"""Whole files of real spectra through the command line: a result or a stated reason for each, and no silent NaN."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

FILES = [("ce4/reflectance_factor.csv", 88), ("relab/reflectance.csv", 172)]

pytestmark = [pytest.mark.reference, pytest.mark.slow]


def numbers(value: object) -> list[float]:
    if isinstance(value, dict):
        return [n for item in value.values() for n in numbers(item)]
    if isinstance(value, list):
        return [n for item in value for n in numbers(item)]
    return [value] if isinstance(value, float) else []


@pytest.mark.parametrize(("file", "count"), FILES)
@pytest.mark.parametrize("continuum", ["conic", "hull"])
def test_bands(run: Callable[..., object], reference_data: Path, file: str, count: int, continuum: str) -> None:
    done = run("spectra", "bands", reference_data / "spectra" / file, "--continuum", continuum, "--json")
    # Among those of RELAB are olivines and plagioclases with water, as `test_band_status.py` counts them.
    doubt = ["a narrow absorption is what there is at 2 µm in "] if file.startswith("relab") else []
    assert done.code == (3 if doubt else 0) and len(done.err) == len(doubt)
    assert all(line.startswith(said) for line, said in zip(done.err, doubt, strict=True))
    spectra = json.loads(done.out)["result"]["spectra"]
    assert len({spectrum["id"] for spectrum in spectra}) == count
    for spectrum in spectra:
        for band, (low, high) in (("1000", (760, 1500)), ("2000", (1620, 2450))):
            centre, status = spectrum[f"bc{band}_nm"], spectrum[f"band{band}_status"]
            measured = status.startswith(("ok", "centre depends on the method", "in it a narrow absorption"))
            assert measured == (centre is not None)
            if centre is None:
                assert status.startswith(("no ", "its "))
            else:
                assert low <= centre <= high
                assert spectrum[f"bc{band}_sigma_nm"] > 0
                assert 0 < spectrum[f"bd{band}"] < 1


@pytest.mark.parametrize(("file", "count"), FILES)
def test_fit(run: Callable[..., object], reference_data: Path, file: str, count: int) -> None:
    done = run("spectra", "fit", reference_data / "spectra" / file, "--json")
    spectra = json.loads(done.out)["result"]["spectra"]
    doubtful = any(spectrum["status"] != "converged" for spectrum in spectra)
    assert (done.code, [line.partition(":")[0] for line in done.err]) == (
        3 * doubtful,
        ["not to be trusted"] * doubtful,
    )
    assert len({spectrum["id"] for spectrum in spectra}) == count
    for spectrum in spectra:
        assert spectrum["status"]
        assert spectrum["converged"]
        assert all(band["strength"] <= 0 for band in spectrum["bands"])
        assert len(numbers(spectrum["bands"])) == 9 * len(spectrum["bands"])
