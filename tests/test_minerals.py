"""The table of minerals: what the texts name, and a newcomer who adds one by rows of data alone."""

import dataclasses
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import get_type_hints

import pytest

from lunarsci.io.tables import table_rows
from lunarsci.minerals import ABBREVIATIONS, COMPONENTS, CONSTITUENTS, MINERALS, WEIGHED
from lunarsci.options import choices_of, meanings
from lunarsci.spectra.jobs.requests import FitRequest, ImportRequest, MapRequest, MatchRequest, UnmixRequest
from lunarsci.spectra.readers.library import EndMember, mineral_named

ROOT = Path(__file__).parents[1]
ROW = '    Mineral("spinel", "SPL"),\n'
BAND = "SPL 2,spinel,,um2,,2000,0,,0,40,600,60,0.3,0,mgm-start\n"
CRATERS = (
    "name,latitude_deg,longitude_deg,diameter_km,olivine,olivine_sigma,orthopyroxene,orthopyroxene_sigma,spinel,"
    "spinel_sigma\nA,-44,176,20,0.2,0.05,0.4,0.05,0.4,0.05\nB,-47,179,20,0.5,0.05,0.4,0.05,0.1,0.05\n"
)
NEWCOMER = """
import json, sys
from importlib.abc import MetaPathFinder
from importlib.util import spec_from_file_location
from pathlib import Path
folder = Path(sys.argv[1])
PLACES = {"lunarsci.minerals": folder / "minerals.py", "lunarsci.spectra_data": folder / "spectra_data/__init__.py"}
class Finder(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        place = PLACES.get(name)
        return place and spec_from_file_location(name, place, submodule_search_locations=
                                                 [str(place.parent)] if place.name == "__init__.py" else None)
sys.meta_path.insert(0, Finder())
import numpy as np
import lunarsci
from lunarsci.errors import LunarSciError
from lunarsci.spectra.jobs.simulate import simulate
nm = np.arange(500.0, 2500.0, 10.0)
ln = -1.0 + 2e-4 * (nm - 1500) - 0.4 * np.exp(-0.5 * ((nm - 2010) / 250) ** 2)
def refused(job, *given, **options):
    try:
        job(*given, **options)
    except LunarSciError as error:
        return str(error)
fitted = json.loads(lunarsci.fit((nm, np.exp(ln)), assemblage="OL-SPL").to_json())["result"]["spectra"][0]
def matched(craters=None):
    site = {} if craters is None else {"site": "-45.44,177.56"}
    return lunarsci.match(modes="ol=0.2:0.05,opx=0.4:0.05,spl=0.4:0.05", craters=craters, **site)
shares = folder / "shares.json"
shares.write_text(lunarsci.unmix((nm, np.exp(ln))).to_json())
print(json.dumps({
    "of_shares": len(lunarsci.match(str(shares)).rows()),
    "bands": {band["mineral"]: band["strength"] for band in fitted["bands"]},
    "assumptions": list(matched().assumptions),
    "compared": {row["name"]: row["posterior"] for row in matched(str(folder / "craters.csv")).rows()},
    "unmix": refused(lunarsci.unmix, (nm, np.exp(ln)), assemblage="OL-SPL"),
    "not_weighed": lunarsci.unmix((nm, np.exp(ln))).to_dict()["spectra"][0]["abundance"]["not_weighed"],
    "simulate": refused(simulate, rock="ol=0.5,spl=0.5"),
}))
"""


def test_a_mineral_is_rows_of_data(tmp_path: Path) -> None:
    """Fits and matches use it; shares and made-up scenes, which need more than rows, say that they have none of it."""
    shutil.copytree(ROOT / "spectra_data", tmp_path / "spectra_data", ignore=shutil.ignore_patterns("make_*"))
    text = (ROOT / "lunarsci/minerals.py").read_text("utf-8")
    (tmp_path / "minerals.py").write_text(text.replace('    Mineral("opaque"', f'{ROW}    Mineral("opaque"'), "utf-8")
    with (tmp_path / "spectra_data/mgm_bands.csv").open("a", encoding="utf-8") as bands:
        bands.write(BAND)
    (tmp_path / "craters.csv").write_text(CRATERS, "utf-8")
    done = subprocess.run([sys.executable, "-c", NEWCOMER, str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["bands"]["spinel"] == pytest.approx(-0.4, abs=0.05)
    assert "no crater states its spinel: shares of the rocks are compared without" in result["assumptions"]
    assert result["compared"]["A"] > 3 * result["compared"]["B"], "only spinel and olivine tell A from B"
    assert "'SPL' is no mineral that is weighed; join some of OL, OPX, CPX, PLG" in result["unmix"]
    assert result["not_weighed"] == ["spinel"]
    assert result["of_shares"] > 1, "shares without the newcomer are matched as before"
    assert "'spl=0.5' is none of ol, opx, cpx, plg = fraction" in result["simulate"]


def test_texts_name_the_minerals_of_the_table() -> None:
    listed, weighed = ", ".join(MINERALS), ", ".join(ABBREVIATIONS[name] for name in WEIGHED)
    for request, option in ((FitRequest, "assemblage"), (MapRequest, "assemblage"), (MatchRequest, "modes")):
        assert listed in meanings(request)[option], request
    assert weighed in meanings(UnmixRequest)["assemblage"]
    assert ", ".join(f"vol_{key.lower()}" for key in MINERALS) in meanings(ImportRequest)["metadata"]
    assert (*choices_of(get_type_hints(ImportRequest)["mineral"]),) == CONSTITUENTS
    assert listed in (ROOT / "docs/reference/commands/spectra-fit.md").read_text("utf-8")


def test_rows_of_the_table_have_what_they_name() -> None:
    assert len({*CONSTITUENTS}) == len(CONSTITUENTS), "a mineral has one row"
    rows = [(row["band"], row["beside"]) for row in table_rows("mgm_bands.csv")]
    assert len({*rows}) == len(rows), "a band has one row"
    bands = {row["mineral"] for row in table_rows("mgm_bands.csv")}
    assert bands - {"any"} == {*MINERALS.values()}, "an abbreviation is of a mineral with bands"
    assert {row["mineral"] for row in table_rows("end_members.csv")} <= {*MINERALS.values()}
    assert {*COMPONENTS} <= {field.name for field in dataclasses.fields(EndMember)}
    assert all(re.fullmatch("[A-Z]+", key) for key in MINERALS)
    assert [mineral_named(word) for word in (" Hcp", "ilm", "OL", "")] == ["clinopyroxene", "opaque", "olivine", None]
