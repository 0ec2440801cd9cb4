"""Shares from the ratio of band strengths: the published powders, and mixtures that the line was not made for."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from lunarsci.errors import ParameterError
from lunarsci.inputs import read_input
from lunarsci.spectra.abundance.nbsr import calibrations, nbsr_abundance
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.model import mgm_model
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.readers import read_spectra

pytestmark = pytest.mark.reference


@pytest.fixture(scope="module")
def measured(reference_data: Path) -> tuple[list[MgmFit], pd.DataFrame]:
    """Pyroxene mixtures of both suites."""
    rows = pd.read_csv(reference_data / "spectra/relab/manifest.csv").set_index("id")
    spectra = {s.id: s for s in read_spectra(read_input(str(reference_data / "spectra/relab/reflectance.csv")))}
    names = rows.index[rows.index.str.match("(XP|PE|PP)-CMP-|AG-TJM-(012|028|030|036|042|044|046)")]
    fits = fit_spectra([spectra[name] for name in names], mgm_model("OPX-CPX", compositions={"wo": (44.6, 2.0)}))
    return [fit for fit in fits if isinstance(fit, MgmFit)], rows.loc[names]


def test_the_line_gives_its_own_powders(measured: tuple[list[MgmFit], pd.DataFrame]) -> None:
    fits, rows = measured
    own = [(fit, row) for fit, row in zip(fits, rows.itertuples(), strict=True) if "CMP" in fit.id]
    assert len(own) == 20
    errors, inside = [], []
    for fit, row in own:
        found = nbsr_abundance(fit)
        assert found is not None
        opx, cpx = found.fractions
        assert opx.fraction + cpx.fraction == pytest.approx(1)
        errors.append(opx.fraction - row.vol_opx)
        inside.append(opx.low95 <= row.vol_opx <= opx.high95)
    assert np.sqrt(np.mean(np.square(errors))) < 0.06
    assert np.mean(inside) >= 0.85


def test_other_pyroxenes_err_by_tens_of_per_cent(measured: tuple[list[MgmFit], pd.DataFrame]) -> None:
    """Iron-rich orthopyroxene hides augite: this is why a line has a domain."""
    fits, rows = measured
    errors = []
    for fit, row in zip(fits, rows.itertuples(), strict=True):
        found = nbsr_abundance(fit) if fit.id.startswith("AG-TJM") else None
        if found is not None:
            errors.append(found.fractions[0].fraction - row.vol_opx / (row.vol_opx + row.vol_cpx))
    assert np.sqrt(np.mean(np.square(errors))) > 0.1


def test_an_unknown_line_is_refused(measured: tuple[list[MgmFit], pd.DataFrame]) -> None:
    with pytest.raises(ParameterError, match=calibrations()[0]):
        nbsr_abundance(measured[0][0], "guess")
