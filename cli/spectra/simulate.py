"""`lunarsci spectra simulate`: synthetic VNIS products of a made-up scene."""

from collections.abc import Mapping
from functools import partial
from typing import Any

from lunarsci.spectra.jobs.requests import SimulateVnisRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import option
from ..shared.table import TextTable

SCENE, VIEW, OBSERVATION = "Scene", "Light and view", "Observation"
OPTIONS = {
    "soil": option("--minerals", metavar="MINERALS", panel=SCENE),
    "rock": option(metavar="MINERALS", panel=SCENE),
    "rock_radius": option(panel=SCENE),
    "shadow": option("--shadow-share", panel=SCENE),
    "incidence": option(panel=VIEW),
    "emission": option(panel=VIEW),
    "phase_angle": option(panel=VIEW),
    "photometry": option(panel=VIEW),
    "phase": option(panel=VIEW),
    "noise": option(panel=OBSERVATION),
    "time": option(panel=OBSERVATION),
    "sequence": option(min=1, max=9999, panel=OBSERVATION),
    "seed": option(min=0, panel=OBSERVATION),
}
EXAMPLES = (
    "lunarsci spectra simulate --rock ol=0.1,opx=0.4,cpx=0.2,plg=0.3 -o scene",
    "lunarsci spectra simulate --minerals ol=0.2,opx=0.3,cpx=0.3,plg=0.2 --noise 0",
)


@command("simulate", EXAMPLES, OPTIONS, folder=True)
def simulate(request: SimulateVnisRequest) -> Report:
    """Synthetic VNIS products of a made-up scene: image cube, table, labels, and the truth.

    -o DIR writes them; every name and label says SYNTHETIC.
    """
    from lunarsci.spectra.jobs.simulate import simulate

    result = simulate(request)
    files = {name: partial(bytes, content) for name, content in result.files.items()}
    return Report(result, [_table(result.to_dict())], files=files)


def _table(result: Mapping[str, Any]) -> TextTable:
    shares = ", ".join(f"{name} {100 * share:.0f} %" for name, share in result["composition"].items() if share)
    notes = [
        f"lit ground in the SWIR field of view: {shares}; rock covers {100 * result['rock_fraction']:.0f} % of it, "
        f"{100 * result['shadow_fraction']:.0f} % of the field lies in shadow",
        "Synthetic: made up, not a measurement. Strengths of bands, albedo and texture are assumed.",
    ]
    rows = [[item["name"], str(item["bytes"])] for item in result["files"]]
    return TextTable(["file", "bytes"], rows, title=f"{result['observation']}", notes=notes)
