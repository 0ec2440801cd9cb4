"""Make `end_members.csv` from a reference library: `python make_end_members.py FOLDER > end_members.csv`.

FOLDER holds `relab/reflectance.csv`, `relab/manifest.csv` and `usgs/splib07_aviris95_wide.csv`. Each spectrum of a
single mineral is fitted with the bands of its mineral; the table keeps bands and continuum, not the spectrum.
"""

import csv
import re
import sys
from pathlib import Path

import numpy as np
import pandas as pd

from lunarsci.inputs import read_input
from lunarsci.spectra.abundance.end_members import CHEMISTRY, FAMILY_OF
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.model import mgm_model, unit_of
from lunarsci.spectra.mgm.result import MgmFit
from lunarsci.spectra.readers import read_spectra
from lunarsci.spectra.spectrum import Spectrum

MINERAL_OF_NAME = {
    "Olivine": "olivine",
    **dict.fromkeys(("Hypersthene", "Enstatite", "Bronzite"), "orthopyroxene"),
    **dict.fromkeys(("Augite", "Diopside", "Pigeonite", "Hedenbergite"), "clinopyroxene"),
    **dict.fromkeys(("Anorthite", "Bytownite", "Labradorite"), "plagioclase"),
}
PURE = 0.95
MISNAMED = ("DL-CMP-005",)
"""Filed as orthopyroxene, clinopyroxene by its own name."""
ERROR = 0.003
WORST = 0.03
COLUMNS = ("id", "source", "mineral", *CHEMISTRY, "min_um", "max_um", "lowest_nm", "highest_nm", "rms_ln_percent")


def relab(folder: Path) -> list[tuple[Spectrum, dict[str, object]]]:
    """Single minerals of the RELAB collection with what its manifest says."""
    rows = pd.read_csv(folder / "relab/manifest.csv").set_index("id")
    keys = dict(zip(("vol_ol", "vol_opx", "vol_cpx", "vol_plg"), FAMILY_OF, strict=True))
    found = []
    for spectrum in read_spectra(read_input(str(folder / "relab/reflectance.csv"))):
        row = rows.loc[spectrum.id]
        column = max(keys, key=lambda name: row[name])
        if row[column] < PURE or spectrum.id.startswith(MISNAMED):
            continue
        mineral = keys[column]
        own = {
            "olivine": {"fo": row["fo"]},
            "orthopyroxene": {key: row[f"opx_{key}"] for key in ("fs", "en", "wo")},
            "clinopyroxene": {key: row[f"cpx_{key}"] for key in ("fs", "en", "wo")},
            "plagioclase": {"an": row["an"]},
        }[mineral]
        stated = {key: round(100 * value, 1) for key, value in own.items() if sum(own.values()) > 0}
        found.append((spectrum, {"source": "relab", "mineral": mineral, **stated} | sizes(row)))
    return found


def sizes(row: pd.Series) -> dict[str, object]:
    """Grain size, where there is one. [um]"""
    return {"min_um": row["min_um"], "max_um": row["max_um"]} if row["max_um"] > 0 else {}


def usgs(folder: Path) -> list[tuple[Spectrum, dict[str, object]]]:
    """Minerals of the USGS library whose spectra reach over the whole range; grain sizes as in their names."""
    found = []
    for spectrum in read_spectra(read_input(str(folder / "usgs/splib07_aviris95_wide.csv"))):
        mineral = MINERAL_OF_NAME.get(re.split(r"[_ ]", spectrum.id)[0])
        there = spectrum.wavelength_nm[spectrum.usable]
        if mineral is None or there.size < 80 or there[0] > 460 or there[-1] < 2440:
            continue
        fo = re.match(r"Olivine.*Fo(\d+)", spectrum.id)
        size = re.search(r"_(\d+)um?$", spectrum.id)
        stated = {"fo": float(fo[1])} if fo else {}
        stated |= {"min_um": float(size[1]), "max_um": float(size[1])} if size else {}
        found.append((spectrum, {"source": "usgs", "mineral": mineral, **stated}))
    return found


def described(spectrum: Spectrum, about: dict[str, object]) -> dict[str, object] | None:
    """A row of the table; None for a spectrum that its mineral's bands do not describe."""
    model = mgm_model(FAMILY_OF[str(about["mineral"])])
    [fit] = fit_spectra([spectrum], model, model_error=ERROR)
    if not isinstance(fit, MgmFit) or fit.rms_ln > WORST:
        return None
    numbers = {
        name: round(float(value) * unit_of(name), 5) for name, value in zip(model.names, fit.parameters, strict=True)
    }
    reach = {"lowest_nm": fit.wavelength_nm[0], "highest_nm": fit.wavelength_nm[-1]}
    return {"id": spectrum.id, **about, **reach, "rms_ln_percent": round(100 * fit.rms_ln, 2), **numbers}


def main() -> None:
    """Write the table to stdout."""
    folder = Path(sys.argv[1])
    rows = [row for pair in relab(folder) + usgs(folder) if (row := described(*pair)) is not None]
    names = list(dict.fromkeys(name for family in FAMILY_OF.values() for name in mgm_model(family).names))
    writer = csv.DictWriter(sys.stdout, [*COLUMNS, *names], restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows({key: "" if value is np.nan else value for key, value in row.items()} for row in rows)


if __name__ == "__main__":
    main()
