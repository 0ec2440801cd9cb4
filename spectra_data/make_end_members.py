"""Make `end_members.csv` from a reference library: `python make_end_members.py FOLDER > end_members.csv`.

FOLDER holds `reflectance.csv` and `manifest.csv` in `relab` and `minerals`, and `usgs/splib07_aviris95_wide.csv`. Each
spectrum of a single mineral is fitted with the bands of its mineral; the table keeps bands and continuum, not the
spectrum. Pyroxenes are filed by their bands: low-calcium ones, pigeonite poor in calcium among them, absorb up to
`LOW_CALCIUM_NM`, whatever their label says. Powders of one `specimen` share its name.
"""

import csv
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from lunarsci.io.inputs import read_input
from lunarsci.minerals import ABBREVIATIONS, COMPONENTS
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.model import MgmModel, mgm_model, prior_covariance, unit_of
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
NO_POWDERS = ("Slab", "Pellet", "Chip")
NO_PLAGIOCLASE = ("SR-JFM",)
"""Potassium feldspars that the manifest counts as plagioclase."""
MISSTATED = ("PE-CMP-040", "PE-CMP-041")
"""Bronzites by name and by their bands (914, 1870 nm: Fs near 20; Adams 1974), whose analyses say Fs 60 and 41."""
LOW_CALCIUM_NM, SECOND_NM = 935.0, (1780.0, 2100.0)
"""Up to which 1 um band, with a 2 um band in this range, a pyroxene counts as orthopyroxene: natural ones end there at
Fs 60 (Adams 1974, 10.1029/JB079i032p04829), and pigeonite of Wo 10 or less is unlike augite."""
ERROR = 0.003
WORST = 0.03
COLUMNS = (
    "id",
    "source",
    "specimen",
    "mineral",
    *COMPONENTS,
    "min_um",
    "max_um",
    "lowest_nm",
    "highest_nm",
    "rms_ln_percent",
)


def relab(folder: Path) -> list[tuple[Spectrum, dict[str, object]]]:
    """Powders of single minerals of a RELAB collection with what its manifest says."""
    rows = pd.read_csv(folder / "manifest.csv").set_index("id")
    keys = dict(zip(("vol_ol", "vol_opx", "vol_cpx", "vol_plg"), ABBREVIATIONS, strict=True))
    found = []
    for spectrum in read_spectra(read_input(str(folder / "reflectance.csv"))):
        row = rows.loc[spectrum.id]
        column = max(keys, key=lambda name: row[name])
        other = spectrum.id.startswith(MISNAMED + NO_PLAGIOCLASE)
        if row[column] < PURE or other or str(row.get("texture", "")).endswith(NO_POWDERS):
            continue
        mineral = keys[column]
        own = {
            "olivine": {"fo": row["fo"]},
            "orthopyroxene": {key: row[f"opx_{key}"] for key in ("fs", "en", "wo")},
            "clinopyroxene": {key: row[f"cpx_{key}"] for key in ("fs", "en", "wo")},
            "plagioclase": {"an": row["an"]},
        }[mineral]
        told = sum(own.values()) > 0 and not spectrum.id.startswith(MISSTATED)
        specimen = "-".join([ABBREVIATIONS[mineral], *(f"{1000 * value:.0f}" for value in own.values())])
        stated = {key: round(100 * value, 1) for key, value in own.items() if told}
        about = {"source": "relab", "specimen": specimen, "mineral": mineral}
        found.append((spectrum, about | stated | sizes(row)))
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
        specimen = "_".join(re.split(r"[_ ]", spectrum.id)[:2])
        found.append((spectrum, {"source": "usgs", "specimen": specimen, "mineral": mineral, **stated}))
    return found


def describing(family: str) -> MgmModel:
    """The model of a mineral with strengths free of each other: to describe a spectrum, not to tell minerals apart."""
    model = mgm_model(family)
    bands = tuple(replace(band, strength_loading=0.0) for band in model.assemblage.bands)
    precision, m = model.precision.copy(), model.degrees
    precision[m:, m:] = np.linalg.inv(prior_covariance(replace(model.assemblage, bands=bands)))
    return replace(model, precision=precision)


def filed(spectrum: Spectrum, mineral: str) -> str:
    """The mineral by its bands: orthopyroxene where both are those of a low-calcium pyroxene."""
    if mineral != "clinopyroxene":
        return mineral
    [fit] = fit_spectra([spectrum], describing("CPX"), model_error=ERROR)
    if not isinstance(fit, MgmFit):
        return mineral
    first, second = (next(band.center_nm for band in fit.bands if band.name == name) for name in ("CPX 1", "CPX 2"))
    low_calcium = first <= LOW_CALCIUM_NM and SECOND_NM[0] <= second <= SECOND_NM[1]
    return "orthopyroxene" if low_calcium else mineral


def described(spectrum: Spectrum, about: dict[str, object]) -> dict[str, object] | None:
    """A row of the table; None for a spectrum that its mineral's bands do not describe."""
    about = about | {"mineral": filed(spectrum, str(about["mineral"]))}
    model = describing(ABBREVIATIONS[str(about["mineral"])])
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
    rows = [
        row
        for pair in relab(folder / "relab") + relab(folder / "minerals") + usgs(folder)
        if (row := described(*pair)) is not None
    ]
    names = list(dict.fromkeys(name for family in ABBREVIATIONS.values() for name in mgm_model(family).names))
    writer = csv.DictWriter(sys.stdout, [*COLUMNS, *names], restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows({key: "" if value is np.nan else value for key, value in row.items()} for row in rows)


if __name__ == "__main__":
    main()
