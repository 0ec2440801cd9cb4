"""Whether lunarsci works here: versions, extras, compiled code, threads, and a test of each part, as a job."""

import io
import os
import platform
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import requires
from importlib.util import find_spec
from typing import Any, ClassVar

from lunarsci.provenance import installed_version
from lunarsci.result import Doubt, Result

EXTRAS: Mapping[str, tuple[str, ...]] = {
    "cubes": ("rasterio", "xarray", "h5netcdf", "h5py"),
    "cluster": ("distributed",),
    "images": ("cv2",),
    "excel": ("openpyxl",),
    "report": ("jinja2",),
}
"""Extras of the package, and the modules they bring."""
STIFFNESS_KPA, SINKAGE_M, LOAD_N = 1443.0, 0.008, 32.03
"""Equivalent stiffness at N = 1, sinkage, and load on a wheel: Ding et al. (2024), 10.1038/s41467-024-46233-8, Fig. 4;
the load is that of F_N/b = 213.5 N/m on a wheel 0.15 m wide."""
LOAD_WITHIN = 0.01
"""Share by which the load found may differ from the published one, whose digits allow as much, and the stiffness from
that of its wheels; assumed."""
STEP_NM = 5.0
"""Between channels of made-up spectra, whose bands are to be found to one of them; assumed."""
DRIVE_M, END_WITHIN_M = 0.6, 0.1
"""Length of a drive over nearly level ground, and how near to where it was planned it must end; assumed."""


@dataclass(frozen=True, slots=True)
class HealthCheck:
    """One thing that was looked at.

    Attributes
    ----------
    part : of lunarsci or of what it needs.
    name : what was looked at.
    observed : what it is like, in words.
    trouble : why that is wrong, '' where it is not.
    """

    part: str
    name: str
    observed: str
    trouble: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HealthReport(Result):
    """All that was looked at.

    Attributes
    ----------
    checks : in the order they were made.
    """

    schema: ClassVar[str] = "doctor/1"
    checks: Sequence[HealthCheck]

    @property
    def trouble(self) -> list[str]:
        return [f"{one.name}: {one.trouble}" for one in self.checks if one.trouble]

    @property
    def doubt(self) -> Doubt:
        return Doubt.of(*self.trouble, verdict="not to be trusted here")

    def to_dict(self) -> dict[str, Any]:
        return {"checks": self.rows(), "trouble": len(self.trouble)}

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """One a check."""
        return [
            {"part": one.part, "name": one.name, "found": one.observed, "trouble": one.trouble or None}
            for one in self.checks
        ]


def doctor(*, progress: Callable[[int, int], None] = lambda done, total: None) -> HealthReport:
    """Look at everything. The tests take a few seconds where the code is compiled already, a minute else."""
    tests: Mapping[str, Callable[[], tuple[str, str]]] = {
        "rock": _rock, "minerals": _minerals, "ground": _ground, "soil": _soil, "drive": _drive
    }  # fmt: skip
    checks = [_versions(), *map(_extra, EXTRAS), _cache(), _threads()]
    for number, (name, test) in enumerate(tests.items()):
        progress(number, len(tests))
        checks.append(_tested(name, test))
    return HealthReport(checks=checks)


def _versions() -> HealthCheck:
    needed = [re.split(r"[^\w.-]", text)[0] for text in requires("lunarsci") or () if "extra ==" not in text]
    observed = {name: installed_version(name) for name in ("lunarsci", *needed)}
    missing = [name for name, version in observed.items() if version is None]
    named = ", ".join(f"{name} {version}" for name, version in observed.items() if version)
    trouble = f"not installed: {', '.join(missing)}; pip install lunarsci" if missing else ""
    return HealthCheck("installation", "versions", f"python {platform.python_version()}, {named}", trouble)


def _extra(name: str) -> HealthCheck:
    """An extra that is not there is said, and is no trouble; one that is there is tried."""
    remedy = f"pip install 'lunarsci[{name}]'"
    missing = [module for module in EXTRAS[name] if find_spec(module) is None]
    if missing:
        return HealthCheck("installation", f"extra {name}", f"not there; {remedy}")
    try:
        for module in EXTRAS[name]:
            import_module(module)
        if name == "cubes":
            _written_netcdf()
    except Exception as error:  # whatever a broken package raises
        trouble = f"does not work ({type(error).__name__}: {' '.join(str(error).split())}); {remedy}"
        return HealthCheck("installation", f"extra {name}", "does not work", trouble)
    return HealthCheck("installation", f"extra {name}", "works")


def _written_netcdf() -> None:
    """A NetCDF 4 file, written and read as maps are."""
    import h5netcdf
    import xarray

    content = io.BytesIO()
    with h5netcdf.File(content, "w") as file:
        file.dimensions = {"x": 2}
        file.create_variable("depth", ("x",), data=[1.0, 2.0])
    content.seek(0)
    with xarray.open_dataset(content, engine="h5netcdf") as data:
        data["depth"].load()


def _cache() -> HealthCheck:
    """The folder of compiled code."""
    from lunarsci.compiled.kept import cache_folder, safe_folder

    folder, read = cache_folder(), safe_folder() is not None
    sizes = [path.stat().st_size / 1e6 for path in (folder.glob("*-*") if read else ())]
    remedy = "is compiled in every run; set NUMBA_CACHE_DIR to a folder that only you can write"
    trouble = "" if read else f"not to be had, or others can write there: everything {remedy}"
    if read and not os.access(folder, os.W_OK):
        trouble = f"cannot be written to: what is not kept there yet {remedy}"
    return HealthCheck("installation", "compiled code", f"{folder}: {len(sizes)} files, {sum(sizes):.0f} MB", trouble)


def _threads() -> HealthCheck:
    from lunarsci.compiled import threads

    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return HealthCheck("installation", "threads", f"{threads()} of {usable} usable cores")


def _tested(name: str, test: Callable[[], tuple[str, str]]) -> HealthCheck:
    """A test, timed; whatever it raises is trouble, for this is what a doctor is asked for."""
    begin = time.monotonic()
    try:
        observed, trouble = test()
    except Exception as error:
        observed, trouble = "failed", f"{type(error).__name__}: {error}"
    return HealthCheck("test", name, f"{observed}, in {time.monotonic() - begin:.1f} s", trouble)


def _off(what: str, value: float, truth: float, within: float, unit: str) -> tuple[str, str]:
    text = f"{what} {value:.4g} {unit}, and {truth:.4g} {unit} is right"
    return text, "" if abs(value - truth) <= within else f"off by more than {within:.2g} {unit}"


def _made_up(*bands: tuple[float, float, float]) -> Any:
    """Wavelengths every `STEP_NM`, and reflectances with Gaussian absorptions, each of centre, width and depth."""
    import numpy as np

    nm = np.arange(450.0, 2400.0, STEP_NM)
    return nm, 0.1 * np.exp(-sum(d * np.exp(-4 * np.log(2) * ((nm - c) / w) ** 2) for c, w, d in bands))


def _rock() -> tuple[str, str]:
    """The centre of an absorption, to be measured to a channel."""
    from lunarsci.spectra.jobs.bands import bands

    spectrum = _made_up((950.0, 180.0, 0.4), (1950.0, 450.0, 0.2))
    observed = bands(spectrum, continuum="hull").to_dict()["spectra"][0]
    return _off("band at", observed["bc1000_nm"], 950.0, STEP_NM, "nm")


def _minerals() -> tuple[str, str]:
    """The centre of an absorption of orthopyroxene, to be fitted to a channel."""
    from lunarsci.spectra.jobs.fit import fit

    spectrum = _made_up((920.0, 180.0, 0.4), (1900.0, 450.0, 0.2))
    bands = fit(spectrum, assemblage="OPX").to_dict()["spectra"][0]["bands"]
    center_nm = next(band["center_nm"] for band in bands if band["name"] == "OPX 2")
    return _off("band at", center_nm, 1900.0, STEP_NM, "nm")


def _ground() -> tuple[str, str]:
    """The load that a wheel of Yutu-2 carries at a published sinkage and stiffness."""
    from lunarsci.regolith.jobs.wheel_forces import wheel_forces

    observed = wheel_forces(sinkage=SINKAGE_M, stiffness=STIFFNESS_KPA, exponent=1.0, slip=0.0).rows()[0]
    return _off("load of", observed["normal_force_n"], LOAD_N, LOAD_WITHIN * LOAD_N, "N")


def _soil() -> tuple[str, str]:
    """The stiffness of a soil, from what wheels on it carry."""
    from astropy.table import Table

    from lunarsci.regolith.jobs.identify import identify
    from lunarsci.regolith.jobs.wheel_forces import wheel_forces

    states = [
        wheel_forces(sinkage=part * SINKAGE_M, stiffness=STIFFNESS_KPA, exponent=1.0, slip=0.1).rows()[0]
        for part in (0.8, 1.0, 1.2)
    ]
    columns = ("sinkage_m", "slip_ratio", "normal_force_n", "drawbar_pull_n")
    result = identify(Table({name: [state[name] for state in states] for name in columns}), rover="yutu2").to_dict()
    observed = result["bearing"]["stiffness_kpa_m_n"]["value"]
    return _off("stiffness", observed, STIFFNESS_KPA, LOAD_WITHIN * STIFFNESS_KPA, "kPa/m")


def _drive() -> tuple[str, str]:
    """Where a short drive ends."""
    from lunarsci.twin.jobs.predict import predict

    plan = f'name = "doctor"\n[drive]\nspeed_m_s = 0.05\n[[leg]]\nlength_m = {DRIVE_M}\n'
    end = predict(io.StringIO(plan)).to_dict()["endpoint"]
    return _off("ends", end["bias_m"], 0.0, END_WITHIN_M, "m")
