"""Wrong but plausible tables, grids and documents; `spoilt.py` prints these cases with those of VNIS products.

Of each part there is a sound file, made up, and what is done to it. The error of silence is how far the number that
matters most moves: reflectance, slope of the ground, soil's force, friction angle, rover's weight.
"""

import json
import re
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lunarsci.errors import LunarSciError
from lunarsci.io.inputs import InputFile

Texts = dict[str, Callable[[str], str]]
REFUSED, UNTRUSTED, TOLD, SILENT = "refused", "untrusted", "told", "silent"


@dataclass(frozen=True)
class Outcome:
    """What happened: `refused` (no result), `untrusted` (exit 3), `told` (warning or count), or `silent`; and why."""

    end: str
    said: str
    error_percent: float


def happened(run: Callable[[], tuple[str, list[str]]], error_percent: float, usual: Collection[str] = ()) -> Outcome:
    """Run a job that gives the reason not to trust it and what it says of itself, `usual` apart."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            doubt, notes = run()
        except LunarSciError as error:
            return Outcome(REFUSED, str(error), error_percent)
    said = [text for text in (*notes, *(str(item.message) for item in caught)) if text not in usual]
    if doubt:
        return Outcome(UNTRUSTED, doubt, error_percent)
    return Outcome(TOLD, said[0], error_percent) if said else Outcome(SILENT, "", error_percent)


@dataclass(frozen=True)
class Part:
    """Files of one kind: a sound one, how it is read, and the cases.

    `read` takes a path, and gives the reason not to trust what comes of it, and the number that matters most.
    """

    suffix: str
    sound: Callable[[], str]
    read: Callable[[Path], tuple[str, complex]]
    cases: Mapping[str, Callable[[str], str]]


# -- Changes of text --------------------------------------------------------------------------------------------------


def cells(change: Callable[[list[list[str]]], list[list[str]]]) -> Callable[[str], str]:
    """Change the cells of a CSV table, header included."""

    def new(text: str) -> str:
        remarks = [line for line in text.splitlines() if line.startswith("#")]
        table = change([line.split(",") for line in text.splitlines() if not line.startswith("#")])
        return "\n".join([*remarks, *(",".join(row) for row in table)]) + "\n"

    return new


def column(names: str, change: Callable[[float], float], where: slice = slice(None)) -> Callable[[str], str]:
    """Change all numbers of columns whose name matches."""

    def new(table: list[list[str]]) -> list[list[str]]:
        for k, name in enumerate(table[0]):
            if re.fullmatch(names, name):
                for row in table[1:][where]:
                    row[k] = f"{change(float(row[k])):.10g}" if row[k] else ""
        return table

    return cells(new)


def named(old: str, new: str) -> Callable[[str], str]:
    return lambda text: text.replace(old, new, 1)


def value(key: str, change: Callable[[float], float]) -> Callable[[str], str]:
    """Change the numbers of a key of a TOML file, a list too."""

    def one(match: re.Match[str]) -> str:
        return match[1] + re.sub(r"-?\d+\.?\d*(e-?\d+)?", lambda m: f"{change(float(m[0])):.12g}", match[2])

    return lambda text: re.sub(rf"(?m)^({key} = (?:\{{ value = )?)(\[[^\]]*\]|[-\d.e]+)", one, text)


def then(*changes: Callable[[str], str]) -> Callable[[str], str]:
    def new(text: str) -> str:
        for change in changes:
            text = change(text)
        return text

    return new


# -- Spectra ----------------------------------------------------------------------------------------------------------


def _spectrum() -> str:
    from lunarsci.spectra.vnis.channels import SPLICED_NM
    from lunarsci.spectra.vnis.simulation.scene import Material, SceneComposition, surface_reflectance

    rock = Material(SceneComposition(0.15, 0.35, 0.40, 0.10), albedo=0.12, red_slope=0.25, contrast=1.5)
    clean = surface_reflectance(SPLICED_NM, rock)
    noisy = clean * np.exp(0.005 * np.random.default_rng(0).standard_normal(clean.size))
    rows = (f"{w:g},{r:.6f},{0.005 * r:.6f}" for w, r in zip(SPLICED_NM, noisy, strict=True))
    return "wavelength_nm,rock,rock_sigma\n" + "\n".join(rows) + "\n"


def _read_spectrum(path: Path) -> tuple[str, complex]:
    """Centre of the band at 1000 nm, and the level, as one complex number."""
    from lunarsci.spectra.jobs.bands import bands
    from lunarsci.spectra.readers.dispatch import read_spectra

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        level = np.nanmedian(read_spectra(InputFile(path.name, path.read_bytes()))[0].reflectance)
    found = bands(path)
    center = found.to_dict()["spectra"][0]["bc1000_nm"]
    return found.untrusted, complex(np.nan if center is None else center, level)


def _wide(table: list[list[str]]) -> list[list[str]]:
    return [[*row, row[1]] for row in table]


def _moved_names(table: list[list[str]]) -> list[list[str]]:
    return [["rock", "rock_sigma", "wavelength_nm"], *table[1:]]


def _one(table: list[list[str]], row: int, place: int, new: str) -> list[list[str]]:
    table[row][place] = new
    return table


def _late(table: list[list[str]]) -> list[list[str]]:
    for row in range(len(table) - 1, 1, -1):
        table[row][1] = table[row - 1][1]
    return table


SPECTRA: Texts = {
    "micrometres under nm": column("wavelength_nm", lambda w: w / 1000),
    "nanometres under um": named("wavelength_nm", "wavelength_um"),
    "micrometres, no unit": then(column("wavelength_nm", lambda w: w / 1000), named("wavelength_nm", "wavelength")),
    "nm and um mixed": column("wavelength_nm", lambda w: w / 1000, slice(200, None)),
    "Angstrom under nm": column("wavelength_nm", lambda w: 10 * w),
    "wavenumbers under nm": column("wavelength_nm", lambda w: 1e7 / w),
    "electron volts, named so": then(column("wavelength_nm", lambda w: 1240 / w), named("wavelength_nm", "energy_eV")),
    "descending": cells(lambda t: [t[0], *t[:0:-1]]),
    "a wavelength twice": cells(lambda t: _one(t, 60, 0, t[59][0])),
    "a wavelength ten times too large": cells(lambda t: _one(t, 60, 0, "7450")),
    "a wavelength of another decade at the end": cells(lambda t: _one(t, 390, 0, "23950")),
    "names moved by one column": cells(_moved_names),
    "names moved, unnamed wavelength": cells(lambda t: [["rock", "rock_sigma", "wavelength"], *t[1:]]),
    "percent": column("rock|rock_sigma", lambda r: 100 * r),
    "percent of a dark rock": column("rock|rock_sigma", lambda r: 12 * r),
    "percent, called fraction": then(column("rock", lambda r: 100 * r), named(",rock,", ",rock (fraction),")),
    "fractions, called percent": named(",rock,", ",rock (%),"),
    "sigma alone in percent": column("rock_sigma", lambda s: 100 * s),
    "sigma as percent of the value": column("rock_sigma", lambda s: 0.5),
    "sigma 0": column("rock_sigma", lambda s: 0.0),
    "sigma negative": column("rock_sigma", lambda s: -s),
    "ten thousandths": column("rock", lambda r: round(10000 * r)),
    "absorbance, named so": then(column("rock", lambda r: -np.log10(r)), named(",rock,", ",absorbance,")),
    "absorbance, not named so": column("rock", lambda r: -np.log10(r)),
    "radiance, named so": named(",rock,rock_sigma", ",radiance,radiance_sigma"),
    "continuum removed": column("rock", lambda r: 0.7 + 0.3 * r),
    "-9999 for no data": column("rock", lambda r: -9999, slice(100, 110)),
    "-1.23e34 for no data": column("rock", lambda r: -1.23e34, slice(100, 110)),
    "0 for no data": column("rock", lambda r: 0, slice(100, 110)),
    "reflectance a row late": cells(_late),
    "a name twice": cells(lambda t: _wide(t)),
    "a number of each row first": cells(lambda t: [["", *t[0]], *([str(k), *row] for k, row in enumerate(t[1:]))]),
    "two sensors that overlap": cells(lambda t: [*t[:120], *t[100:]]),
    "decimal commas": lambda text: text.replace(",", ";").replace(".", ","),
    "thousands separated": cells(lambda t: [t[0], *([re.sub(r"(\d)(\d{3})$", r"\1 \2", r[0]), *r[1:]] for r in t[1:])]),
    "a third missing in the middle": cells(lambda t: [*t[:150], *t[280:]]),
    "last number cut": lambda text: text[:-5],
    "negative": column("rock", lambda r: -r),
    "constant": column("rock", lambda r: 0.1),
    "a value a tenth": cells(lambda t: _one(t, 100, 1, f"{float(t[100][1]) / 10:g}")),
    "a value ten times": cells(lambda t: _one(t, 100, 1, f"{float(t[100][1]) * 10:g}")),
    "ten values x 1.5": column("rock", lambda r: 1.5 * r, slice(200, 210)),
}  # fmt: skip


# -- Terrain ----------------------------------------------------------------------------------------------------------

SIDE = 24


def _heights() -> np.ndarray:
    axis = 0.25 * np.arange(SIDE)
    return 0.1 * np.sin(axis[:, None]) + 0.05 * np.cos(2 * axis) + 0.08 * axis


def _ascii() -> str:
    rows = "\n".join(" ".join(f"{value:.4f}" for value in row) for row in _heights())
    return f"ncols {SIDE}\nnrows {SIDE}\nxllcorner 0\nyllcorner 0\ncellsize 0.25\nNODATA_value -9999\n{rows}\n"


def _read_terrain(path: Path) -> tuple[str, float]:
    """Root mean square slope [-]."""
    from lunarsci.regolith.soil import read_soil
    from lunarsci.twin.ground.terrain import read_terrain

    terrain = read_terrain(path, read_soil("lunar-typical"))
    height = np.asarray(terrain.height_m, dtype=float)
    steps = np.gradient(height, terrain.spacing_m)
    return "", float(np.sqrt(np.nanmean(steps[0] ** 2 + steps[1] ** 2)))


def heights(change: Callable[[float], float], where: slice = slice(None)) -> Callable[[str], str]:
    def new(text: str) -> str:
        lines = text.splitlines()
        body = [[float(word) for word in line.split()] for line in lines[6:]]
        for row in body[where]:
            row[:] = [change(value) for value in row]
        return "\n".join([*lines[:6], *(" ".join(f"{value:.10g}" for value in row) for row in body)]) + "\n"

    return new


def a_height(number: float) -> Callable[[str], str]:
    def new(text: str) -> str:
        lines = text.splitlines()
        words = lines[12].split()
        words[5] = f"{number:g}"
        lines[12] = " ".join(words)
        return "\n".join(lines) + "\n"

    return new


TERRAIN: Texts = {
    "heights in cm": heights(lambda h: 100 * h),
    "heights in mm": heights(lambda h: 1000 * h),
    "heights in ft": heights(lambda h: h / 0.3048),
    "heights in km": heights(lambda h: h / 1000),
    "depths for heights": heights(lambda h: -h),
    "one in cm": heights(lambda h: 100 * h, slice(6, 7)),
    "a spike of 5 m": a_height(5.0),
    "another -9999": then(named("-9999", "-32768"), a_height(-9999)),
    "no data as 0 beside heights of -2600 m": then(heights(lambda h: h - 2600), a_height(0.0)),
    "no data as -32768": a_height(-32768),
    "no data as 99999": a_height(99999),
    "no data as 3.4e38": a_height(3.4e38),
    "cells in degrees": named("cellsize 0.25", "cellsize 8.2e-06"),
    "cells in mm": named("cellsize 0.25", "cellsize 250"),
    "a row missing": lambda text: "\n".join(text.splitlines()[:-1]) + "\n",
    "rows and columns not as announced": then(named("ncols 24", "ncols 18"), named("nrows 24", "nrows 32")),
    "last number cut": lambda text: text[:-4],
    "corner and centre": named("yllcorner 0", "yllcenter 0"),
    "decimal commas": (lambda text: re.sub(r"(\d)\.(\d)", r"\1,\2", text)),
}  # fmt: skip


def _swapped(one: str, other: str) -> Callable[[str], str]:
    def new(table: list[list[str]]) -> list[list[str]]:
        names = {one: other, other: one}
        return [[names.get(name, name) for name in table[0]], *table[1:]]

    return cells(new)


_RAD = np.pi / 180


# -- Documents --------------------------------------------------------------------------------------------------------


SOIL = (
    "stiffness_kpa_m_n = 1379\nsinkage_exponent = 1.0\ncohesion_pa = 520\nfriction_angle_deg = 42\n"
    "shear_modulus_mm = 17.8\nexternal_friction_angle_deg = 25\nlateral_modulus_mm = 20\n"
)


def _read_soil(path: Path) -> tuple[str, float]:
    """Drawbar pull of a Yutu-2 wheel under 32 N at a slip of 0.2, side slip 5 deg. [N]"""
    from lunarsci.regolith.jobs.wheel_forces import wheel_forces

    found = wheel_forces(load=32.0, slip=0.2, side_slip=5.0, soil=str(path))
    return found.untrusted, float(found.to_dict()["drawbar_pull_n"])


SOILS: Texts = {
    "stiffness in Pa": value("stiffness_kpa_m_n", lambda k: 1000 * k),
    "stiffness in MPa": value("stiffness_kpa_m_n", lambda k: k / 1000),
    "cohesion in kPa": value("cohesion_pa", lambda c: c / 1000),
    "cohesion in mPa": value("cohesion_pa", lambda c: 1000 * c),
    "friction angle in rad": value("friction_angle_deg", lambda a: a * _RAD),
    "external friction angle in rad": value("external_friction_angle_deg", lambda a: a * _RAD),
    "tangent of the friction angle": value("friction_angle_deg", lambda a: np.tan(a * _RAD)),
    "shear modulus in m": value("shear_modulus_mm", lambda k: k / 1000),
    "lateral modulus in m": value("lateral_modulus_mm", lambda k: k / 1000),
    "shear modulus in um": value("shear_modulus_mm", lambda k: k * 1000),
    "exponent in percent": value("sinkage_exponent", lambda n: 100 * n),
}


def _rover() -> str:
    from importlib.resources import files

    return (files("lunarsci") / "rovers/yutu2.toml").read_text("utf-8")


def _read_rover(path: Path) -> tuple[str, float]:
    """Weight on a wheel per its width [N/m]."""
    from lunarsci.rovers import read_rover
    from lunarsci.twin.rover import build_rover

    rover = build_rover(read_rover(str(path)))
    return "", rover.mass_kg / rover.wheel.width_m


ROVERS: Texts = {
    "mass of the body in g": value("body_kg", lambda m: 1000 * m),
    "mass of a wheel in g": value("wheel_kg", lambda m: 1000 * m),
    "wheel's radius in mm": value("radius_m", lambda r: 1000 * r),
    "wheel's radius in cm": value("radius_m", lambda r: 100 * r),
    "wheel's diameter for its radius": value("radius_m", lambda r: 2 * r),
    "wheel's width in mm": value("width_m", lambda r: 1000 * r),
    "grousers in mm": value("grouser_height_m", lambda r: 1000 * r),
    "centre of mass in mm": value("body_center_m", lambda r: 1000 * r),
    "centre of mass in cm": value("body_center_m", lambda r: 100 * r),
    "wheels in mm": value("front_wheel_m", lambda r: 1000 * r),
    "wheels in cm": value("front_wheel_m", lambda r: 100 * r),
    "inertia in g cm2": value("body_inertia_kg_m2", lambda r: 1e7 * r),
    "inertia of no body": value("body_inertia_kg_m2", lambda r: 17.5 if r < 20 else 1.0),
    "speed in mm/s": value("max_speed_m_s", lambda v: 1000 * v),
    "slope limit in rad": value("max_slope_deg", lambda a: a * _RAD),
    "weight for mass": value("body_kg", lambda m: m * 1.622),
}


def _belief() -> str:
    from lunarsci.regolith.belief import first_belief

    return first_belief().to_json()


def _read_belief(path: Path) -> tuple[str, float]:
    """Median friction angle [deg]."""
    from lunarsci.regolith.belief import read_belief

    return "", read_belief(InputFile(path.name, path.read_bytes())).intervals()["friction_angle_deg"][0]


def belief(change: Callable[[dict[str, Any]], object]) -> Callable[[str], str]:
    def new(text: str) -> str:
        document = json.loads(text)
        change(document)
        return json.dumps(document)

    return new


def _set(document: dict[str, Any], row: int, place: int, share: float, *, both: bool = True) -> None:
    covariance = document["covariance"]
    size = (covariance[row][row] * covariance[place][place]) ** 0.5
    covariance[row][place] = share * size
    if both:
        covariance[place][row] = share * size


BELIEFS: Texts = {
    "a correlation of 1.2": belief(lambda d: _set(d, 1, 2, 1.2)),
    "a covariance that is not symmetric": belief(lambda d: _set(d, 1, 2, 0.5, both=False)),
    "a negative variance": belief(lambda d: _set(d, 2, 2, -1.0)),
    "three correlations that exclude each other": belief(
        lambda d: [_set(d, *which) for which in ((1, 2, 0.9), (2, 3, 0.9), (1, 3, -0.9))]
    ),
    "parameters in another order": belief(lambda d: d["order"].reverse()),
    "friction angle in radians": belief(lambda d: d["mean"].__setitem__(d["order"].index("friction_angle_deg"), 0.6)),
    "covariance 100 times": belief(lambda d: d.update(covariance=[[100 * x for x in r] for r in d["covariance"]])),
    "a mean of 50 widths": belief(lambda d: d["mean"].__setitem__(2, 50 * d["covariance"][2][2] ** 0.5)),
    "a row missing": belief(lambda d: d["covariance"].pop()),
}

CRATERS = (
    "name,latitude_deg,longitude_deg,diameter_km\nZhinyu,-45.34,176.15,3.8\nFinsen,-42.29,182.28,72\n"
    "Maksutov,-40.73,191.39,84\nAlder,-48.6,182.6,77\n"
)


def _read_craters(path: Path) -> tuple[str, float]:
    """Mean distance from the Chang'E-4 site [km]."""
    from lunarsci.spectra.origin.catalogue import distance_km, read_catalogue

    craters = read_catalogue(InputFile(path.name, path.read_bytes()))
    return "", float(np.mean([distance_km((-45.44, 177.56), item.center) for item in craters]))


CATALOGUES: Texts = {
    "latitude and longitude swapped": _swapped("latitude_deg", "longitude_deg"),
    "northern hemisphere": column("latitude_deg", lambda a: -a),
    "one in the northern hemisphere": column("latitude_deg", lambda a: -a, slice(1, 2)),
    "one of west longitude, same point": column("longitude_deg", lambda a: a - 360, slice(1, 2)),
    "one of west longitude without its sign": column("longitude_deg", lambda a: 360 - a, slice(1, 2)),
    "in radians": column("l.*_deg", lambda a: a * _RAD),
    "diameter in m": column("diameter_km", lambda d: 1000 * d),
    "one diameter in m": column("diameter_km", lambda d: 1000 * d, slice(0, 1)),
    "a crater twice": lambda text: text + text.splitlines()[-1] + "\n",
    "last number cut": lambda text: text[:-2] + "\n",
}


PARTS = {
    "spectrum": Part(".csv", _spectrum, _read_spectrum, SPECTRA),
    "terrain": Part(".asc", _ascii, _read_terrain, TERRAIN),
    "rover": Part(".toml", _rover, _read_rover, ROVERS),
    "soil": Part(".toml", lambda: SOIL, _read_soil, SOILS),
    "belief": Part(".json", _belief, _read_belief, BELIEFS),
    "craters": Part(".csv", lambda: CRATERS, _read_craters, CATALOGUES),
}


def _change(new: complex, old: complex) -> list[float]:
    """Change of real and imaginary part [%], of those that are known and not 0."""
    pairs = ((new.real, old.real), (complex(new).imag, complex(old).imag))
    return [100 * abs(one / other - 1) for one, other in pairs if other and np.isfinite(one)]


def outcomes(folder: Path, wanted: Callable[[str], bool]) -> Iterator[tuple[str, str, Outcome]]:
    """Part, name and outcome of every case."""
    for name, part in PARTS.items():
        cases = {case: change for case, change in part.cases.items() if wanted(f"{name} {case}")}
        if not cases:
            continue
        sound = part.sound()
        path = folder / f"{name}{part.suffix}"
        path.write_text(sound)
        with warnings.catch_warnings(record=True) as usual:
            warnings.simplefilter("always")
            doubt, expected = part.read(path)
        assert not doubt, doubt
        said = {str(item.message) for item in usual}
        for case, change in cases.items():
            spoilt = change(sound)
            assert spoilt != sound, case
            path.write_text(spoilt)
            found: list[complex] = []

            def run(part: Part = part, path: Path = path, found: list[complex] = found) -> tuple[str, list[str]]:
                doubt, number = part.read(path)
                found.append(number)
                return doubt, []

            outcome = happened(run, float("nan"), said)
            error = max(_change(found[0], expected), default=float("nan")) if found else float("nan")
            yield name, case, replace(outcome, error_percent=error)
