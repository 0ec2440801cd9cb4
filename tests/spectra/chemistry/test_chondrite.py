"""Ordinary chondrites: the law against draws from it, and against analyses of sample series left out."""

import io
from contextlib import redirect_stdout
from importlib.resources import files
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from lunarsci.spectra_data import make_chondrite_calibration as script

import lunarsci
from lunarsci.spectra.bands import measure_batch
from lunarsci.spectra.chemistry.bands import TABLE, chemistries, embedded_law
from lunarsci.spectra.chemistry.plane import regressions
from lunarsci.spectra.readers import read_spectra

ERRORS = np.array([20.0, 0.3])


@pytest.mark.parametrize("there", [(True, True), (True, False), (False, True)])
def test_composition_is_what_draws_regress_to(there: tuple[bool, bool]) -> None:
    """Least squares on 200,000 draws whose bands were given errors: value and scatter, seed 0."""
    law, rng = embedded_law(), np.random.default_rng(0)
    drawn = rng.multivariate_normal(law.mean, law.covariance, 200_000)
    seen = (drawn[:, :2] + ERRORS * rng.standard_normal((len(drawn), 2)))[:, there]
    design = np.column_stack([np.ones(len(seen)), seen])
    coefficients, *_ = np.linalg.lstsq(design, drawn[:, 2:], rcond=None)
    at = law.mean[:2] + np.array([30.0, -0.5])
    value, sigma = law.composition(np.where(there, at, np.nan)[None], ERRORS[None])
    scatter = np.std(drawn[:, 2:] - design @ coefficients, axis=0)
    assert value[0] == pytest.approx(np.array([1.0, *at[list(there)]]) @ coefficients, rel=5e-3)
    assert sigma[0] == pytest.approx(scatter, rel=1e-2)


def test_bands_that_say_nothing_leave_the_mean_chondrite() -> None:
    law = embedded_law()
    for bands, errors in (([np.nan, np.nan], [np.nan, np.nan]), ([2100.0, 1.0], [1e6, 1e6])):
        value, sigma = law.composition(np.array([bands]), np.array([errors]))
        assert value[0] == pytest.approx(law.mean[2:], rel=1e-3)
        assert sigma[0] == pytest.approx(np.sqrt(np.diag(law.covariance))[2:], rel=1e-3)


@pytest.fixture(scope="module")
def rows(reference_data: Path) -> pd.DataFrame:
    return script.chondrites(reference_data / "spectra")


@pytest.mark.reference
def test_series_left_out_hold_their_analyses(rows: pd.DataFrame, reference_data: Path) -> None:
    """26 spectra of 15 rocks: Fa and Fs nearer than the constant and than Dunn et al. (2010); olivine as near."""
    assert (len(rows), rows["rock"].nunique(), rows["suite"].nunique()) == (26, 15, 6)
    found = script.judged(rows)
    assert (found["within_2_sigma"] >= 0.9).all()
    assert found.loc["fa", "rms_left_out"] < 0.9 * found.loc["fa", "rms_constant"] < found.loc["fa", "rms_dunn"]
    assert found.loc["fs", "rms_left_out"] < 0.85 * found.loc["fs", "rms_constant"] < found.loc["fs", "rms_dunn"]
    assert found.loc["ol_share", "rms_left_out"] < found.loc["ol_share", "rms_constant"] < 0.06


@pytest.mark.reference
def test_the_table_is_what_the_script_makes(reference_data: Path) -> None:
    text = io.StringIO()
    with redirect_stdout(text):
        script.main(reference_data / "spectra")
    kept = io.StringIO((files("lunarsci.spectra_data") / TABLE).read_text("utf-8"))
    text.seek(0)
    pd.testing.assert_frame_equal(pd.read_csv(text), pd.read_csv(kept), rtol=2e-3)


@pytest.mark.reference
def test_chondrites_are_in_domain_and_published_errors_are_those_measured(
    rows: pd.DataFrame, reference_data: Path
) -> None:
    """All 27 chondrites; of 56 other rocks 12: lodranites, acapulcoites, a winonaite, a shergottite, and diogenites."""
    about = pd.read_csv(reference_data / "spectra/meteorites/manifest.csv").set_index("id")
    spectra = list(read_spectra(str(reference_data / "spectra/meteorites/reflectance.csv")))
    found = chemistries(measure_batch(spectra, continuum_name="hull").arrays.bands)
    ordinary = (about.loc[[one.id for one in spectra], "type"] == "Ordinary Chondrite").to_numpy()
    usable = found["fa_chondrite"].in_range & found["fa_chondrite"].present
    assert (usable & ordinary).sum() == 27
    assert (usable & ~ordinary).sum() <= 12
    assert (found["ol_dunn"].in_range & ordinary).sum() == 27
    conic = chemistries(measure_batch(spectra).arrays.bands)
    assert (conic["fa_chondrite"].in_range & ordinary).sum() == 27, "by the 2 µm centre alone"
    assert conic["fa_chondrite"].sigma[ordinary].min() > found["fa_chondrite"].sigma[ordinary].min()
    assert "--continuum" in conic["ol_dunn"].reason[ordinary][0], "it errs by 0.10 under the conic"
    place = [k for k, one in enumerate(spectra) if one.id in rows.index]
    for quantity, key in script.DUNN.items():
        used = found[key].in_range[place]
        miss = (found[key].value[place] - rows[quantity].to_numpy())[used]
        assert regressions()[key].error_relab == pytest.approx(np.sqrt(np.mean(miss**2)), rel=0.03)
        assert np.mean(np.abs(miss) < 2 * found[key].sigma[place][used]) > 0.9


@pytest.mark.reference
def test_unmix_says_what_a_chondrite_is_made_of(reference_data: Path) -> None:
    """OC-TXH-009-C, LL5: Fa 29.9, Fs 24.4; a eucrite is no chondrite, and a powder mixture is not asked."""
    spectra = {one.id: one for one in read_spectra(str(reference_data / "spectra/meteorites/reflectance.csv"))}
    found = lunarsci.unmix([spectra["OC-TXH-009-C"], spectra["MT-HYM-030"]], kind="dark-rock-powder")
    ordinary, other = (record["chondrite"] for record in found.records)
    assert ordinary["in_domain"] and ordinary["status"] == "if an ordinary chondrite"
    assert ordinary["fa"]["low95"] < 29.85 < ordinary["fa"]["high95"]
    assert ordinary["fs"]["low95"] < 24.41 < ordinary["fs"]["high95"]
    assert ordinary["olivine_in_mafic"]["low95"] < 0.621 < ordinary["olivine_in_mafic"]["high95"]
    assert not other["in_domain"] and "not those of" in other["status"]
    assert found.rows()[0]["chondrite_fa_low"] == ordinary["fa"]["low"]
    assert lunarsci.unmix(spectra["OC-TXH-009-C"], kind="powder-mixture").records[0]["chondrite"] is None
