"""What lunarsci offers, by name: its commands, which functions of `import lunarsci` they are, and who takes which file.

A new command is a word in `COMMANDS`; its help, its function, its place in the documentation and its page of
`lunarsci report` follow from the word.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lunarsci.result import Result

COMMANDS: dict[str, dict[str, str]] = {
    "spectra": {
        "calibrate": "calibrate",
        "simulate": "",
        "bands": "bands",
        "indices": "indices",
        "fit": "fit",
        "unmix": "unmix",
        "match": "match",
        "map": "map_cube",
        "library": "",
    },
    "regolith": {"forces": "wheel_forces", "identify": "identify", "infer": "infer", "compare": "compare_soils"},
    "images": {
        "cameras": "cameras",
        "calibrate": "calibrate_cameras",
        "render": "render",
        "dem": "dem",
        "locate": "locate",
        "merge": "merge",
        "track": "track",
        "rocks": "rocks",
    },
    "twin": {
        "terrain": "",
        "plan": "plan",
        "predict": "predict",
        "simulate": "",
        "states": "states",
        "forces": "",
        "loads": "loads",
        "update": "update",
        "compare": "compare",
        "history": "",
        "sweep": "sweep",
    },
}
"""Of each part the commands, in the order of their help, and the function of `import lunarsci` that is the same job; ''
where there is none. A command is the module `cli/PART/COMMAND.py`; its job is the module of the function's name in
`lunarsci/PART/jobs`, or of the command's."""
SINGLE: dict[str, str] = {
    "info": "What a file is, what is in it, and which commands take it.",
    "template": "A file to begin with: rover, soil, plan, mission, craters, telemetry, rig or pose.",
    "report": "Results of other commands as one HTML page: answers, pictures, errors, assumptions, what to cite.",
    "cite": "What to cite for results, as BibTeX.",
    "doctor": "Whether lunarsci works here: versions, extras, compiled code, and a small test of each part.",
    "reproduce": "Numbers of Ding et al. (2024) beside what lunarsci makes of what they publish, with a verdict each.",
    "demo": "Run the whole chain on embedded synthetic data: rock, drive, ground. Under a minute on two cores.",
}
"""Commands of no part, modules `cli/COMMAND.py`, and what stands of them in the help."""


@dataclass(frozen=True, slots=True)
class FormatOfSpectra:
    """A format of reflectance spectra; functions are `module:name` in `lunarsci/spectra/readers`.

    Attributes
    ----------
    title : in the help of commands.
    read : from an `InputFile` to a `SpectrumTable`.
    recognises : from an `InputFile` and its beginning as text, '' where it is none, to whether the file is of this
        format; '' for the one that takes what no other does.
    spectra_alone : whether such files hold nothing but spectra, so that `lunarsci info` need not look at columns.
    """

    title: str
    read: str
    recognises: str = ""
    spectra_alone: bool = False


FORMATS: dict[str, FormatOfSpectra] = {
    "fits": FormatOfSpectra("FITS table", "astropy_tables:read_fits", "astropy_tables:is_fits"),
    "excel": FormatOfSpectra("Excel", "text:read_excel", "text:is_excel"),
    "envi": FormatOfSpectra("ENVI library (.sli, .hdr)", "envi:read_envi", "envi:is_envi", spectra_alone=True),
    "pds": FormatOfSpectra("PDS", "pds:read_pds", "pds:is_pds_label"),
    "ecsv": FormatOfSpectra("ECSV", "astropy_tables:read_ecsv", "astropy_tables:is_ecsv"),
    "jcamp": FormatOfSpectra("JCAMP-DX", "libraries:read_jcamp", "libraries:is_jcamp", spectra_alone=True),
    "json": FormatOfSpectra("JSON", "libraries:read_json", "libraries:is_json"),
    "votable": FormatOfSpectra("VOTable", "libraries:read_votable", "libraries:is_votable"),
    "mrt": FormatOfSpectra("tables of the AAS", "libraries:read_mrt", "libraries:is_mrt"),
    "splib": FormatOfSpectra("USGS splib07 text", "libraries:read_splib", "libraries:is_splib", spectra_alone=True),
    "relab": FormatOfSpectra("RELAB .tab/.asc", "libraries:read_relab", "libraries:is_relab", spectra_alone=True),
    "text": FormatOfSpectra("CSV or text (first column wavelength, then spectra)", "text:read_text"),
}
"""In the order in which a file is tried; the help has them the other way round."""


def functions_of(part: str) -> tuple[str, ...]:
    """The functions of `import lunarsci` for a part, in the order of its commands."""
    return tuple(filter(None, COMMANDS[part].values()))


def result_of(kind: str) -> "type[Result] | None":
    """The class of results of a kind, such as `twin-history`; None where no command of a part makes such results.

    A schema begins with part and command: `spectra library` makes `spectra-library` and `spectra-library-check`.
    """
    part, _, rest = kind.partition("-")
    named = [one for one in COMMANDS.get(part, ()) if f"{rest}-".startswith(f"{one}-")]
    if not named:
        return None
    module = import_module(f"lunarsci.{part}.jobs.{COMMANDS[part][named[0]] or named[0]}")
    return next((one for one in vars(module).values() if getattr(one, "schema", "").rpartition("/")[0] == kind), None)


@dataclass(frozen=True, slots=True)
class KindOfFile:
    """What files of a kind are called, and the commands that take them, with the option where it is no argument."""

    title: str
    commands: tuple[str, ...]


SPECTRUM = (
    "spectra bands",
    "spectra indices",
    "spectra fit",
    "spectra unmix",
    "spectra match",
    "spectra library import",
)
GROUND = ("twin terrain", "twin plan", "twin predict --terrain")
WHEEL = ("regolith infer --rover", "regolith identify --rover", "regolith forces --rover", "regolith compare --rover")
KINDS: Mapping[str, KindOfFile] = {
    "spectra": KindOfFile("reflectance spectra", SPECTRUM),
    "library": KindOfFile("library of end members", ("spectra library list", "spectra unmix --library", *SPECTRUM)),
    "vnis": KindOfFile("product of Chang'E-4 VNIS", ("spectra calibrate", *SPECTRUM)),
    "cube": KindOfFile("image cube", ("spectra map",)),
    "map": KindOfFile("maps of an image cube", ("spectra match --mineral-map",)),
    "mgm": KindOfFile("start or result file of the RELAB MGM program", ("spectra fit --start-file",)),
    "craters": KindOfFile("catalogue of craters", ("spectra match --craters", "spectra map --craters")),
    "plan": KindOfFile("plan of a drive", ("twin predict", "twin simulate", "twin forces", "twin states")),
    "mission": KindOfFile("mission of several targets", ("twin plan --mission",)),
    "rover": KindOfFile("rover", ("twin predict --rover", "twin plan --rover", *WHEEL)),
    "prior": KindOfFile(
        "priors of a soil", ("regolith infer --prior-file", "twin predict --soil", "twin update --soil")
    ),
    "soil": KindOfFile("soil", ("twin predict --soil", "regolith forces --soil")),
    "pose": KindOfFile("pose of a camera", ("images dem --pose", "images locate")),
    "camera": KindOfFile("camera", ("images cameras",)),
    "rig": KindOfFile("stereo rig of two cameras", ("images cameras", "images dem --rig", "images locate --rig")),
    "config": KindOfFile("options of commands", ("any command --config",)),
    "terrain": KindOfFile("heights on a grid", (*GROUND, "images track", "images merge")),
    "zones": KindOfFile("ground to keep out of, or a line", ("twin predict --keep-out", "images track --line")),
    "belief": KindOfFile("belief of a soil", ("twin predict --soil", "twin update --soil", "twin history")),
    "soil map": KindOfFile("soil by place", ("twin predict --soil", "twin update --soil")),
    "telemetry": KindOfFile("telemetry of a drive", ("twin states",)),
    "states": KindOfFile("states of wheels", ("regolith identify", "regolith infer", "twin update", "twin compare")),
    "slips": KindOfFile("states of wheels without forces", ("twin update", "twin compare", "twin loads --states")),
    "motion": KindOfFile("motion of a rover", ("twin loads --motion",)),
    "positions": KindOfFile("localised positions", ("twin states --positions", "twin update --positions")),
    "track": KindOfFile("depth of a track", ("twin states --track", "images render --track")),
    "soils": KindOfFile("soils, a row each", ("twin predict --soil",)),
    "picture": KindOfFile("picture", ("images dem", "images rocks", "images calibrate", "report")),
    "result": KindOfFile("result of a command", ("report", "cite")),
    "table": KindOfFile("table of another kind", ()),
    "folder": KindOfFile("folder of files", ()),
}
TAKEN_BY = {
    "spectra fit": ("spectra match",),
    "spectra bands": ("spectra match",),
    "spectra unmix": ("spectra match",),
    "regolith identify": ("regolith compare",),
    "regolith infer": ("twin predict --soil", "regolith compare"),
    "twin predict": ("twin compare",),
    "twin update": ("twin predict --soil", "twin update --soil", "twin history"),
}
"""Commands that take the result of another, by that one's name."""
