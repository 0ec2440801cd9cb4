"""One picture of every kind, from inputs that are made in seconds; all of them are SYNTHETIC."""

import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import lunarsci

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from lunarsci.spectra.spectrum import Spectrum

PLAN = """name = "short"
[drive]
speed_m_s = 0.05
[[leg]]
length_m = 1.0
[[leg]]
length_m = 0.8
curvature_per_m = 0.2
"""
MISSION = """leg_m = 1.5
localisation_s = 60
[fixes]
position_sigma_m = 0.02
heading_sigma_deg = 0.5
[[target]]
name = "near"
x_m = 3.0
y_m = 0.2
[[window]]
begin_s = 0
end_s = 70
[[window]]
begin_s = 300
end_s = 900
"""


@cache
def _kept() -> Any:
    return tempfile.TemporaryDirectory()


def folder() -> Path:
    """Where inputs lie that are files; it goes when the process ends."""
    return Path(_kept().name)


def written(name: str, content: str | bytes) -> str:
    path = folder() / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return str(path)


def saved(name: str, result: Any) -> str:
    """The files of a result in a folder."""
    for file, content in result.files().items():
        written(f"{name}/{file}", content() if callable(content) else content)
    return str(folder() / name)


def spectrum(name: str = "SYNTHETIC rock", depth: float = 0.3, center_nm: float = 930.0) -> "Spectrum":
    """A red slope with bands at 930 and 1950 nm, and noise of 0.5 %."""
    from lunarsci.spectra.spectrum import Spectrum

    x = np.arange(500.0, 2400.0, 5.0)
    noise = 1 + 0.005 * np.random.default_rng(1).standard_normal(x.size)
    first = depth * np.exp(-0.5 * ((x - center_nm) / 90) ** 2)
    bands = first + 0.5 * depth * np.exp(-0.5 * ((x - 1020 - center_nm) / 200) ** 2)
    return Spectrum(id=name, wavelength_nm=x, reflectance=(0.05 + 4e-5 * x) * np.exp(-bands) * noise)


@cache
def measured(job: str, **options: Any) -> Any:
    return getattr(lunarsci, job)(spectrum(), **options)


@cache
def matched() -> Any:
    return lunarsci.match(modes="ol=0.25:0.05,opx=0.345:0.05,cpx=0.405:0.05", name="SYNTHETIC rock")


@cache
def seen() -> Any:
    """A rock as the spectrometer sees it."""
    from lunarsci.spectra.jobs.simulate import simulate

    return simulate(rock="ol=0.1,opx=0.4,cpx=0.2,plg=0.3", seed=3, shadow=0.05)


@cache
def calibrated() -> Any:
    scene = folder() / "scene"
    for name, content in seen().files.items():
        written(f"scene/{name}", content() if callable(content) else content)
    return lunarsci.calibrate(str(scene))


@cache
def pair() -> Any:
    """A stereo pair of level ground with rocks, from cameras of few pixels."""
    from lunarsci.images.rig_files import read_rig, rig_text

    rig = written("rig.toml", rig_text(read_rig("yutu2-navcam").with_pixels(320)))
    return lunarsci.render(rig=rig, rocks=0.6, samples=1, seed=2, spacing=0.02)


@cache
def heights() -> Any:
    pytest.importorskip("cv2", reason="needs the extra images")
    made = pair().files()
    for name in ("left.png", "right.png", "rig.toml", "pose.toml"):
        written(f"pair/{name}", made[name]())
    at = folder() / "pair"
    return lunarsci.dem(at / "left.png", at / "right.png", rig=str(at / "rig.toml"), pose=str(at / "pose.toml"))


@cache
def stones() -> Any:
    heights()
    at = folder() / "pair"
    return lunarsci.rocks(at / "left.png", at / "right.png", rig=str(at / "rig.toml"), pose=str(at / "pose.toml"))


@cache
def ground() -> Any:
    """What a PanCam makes of stamped ground: heights with a track along y = 1.2 m."""
    from stamped_ground import PANCAM, with_track

    rng = np.random.default_rng(3)
    track = with_track(rng, 0.008).seen(rng, PANCAM, (-1.8, 1.2, 1.5))
    return track


def elevation(name: str, model: Any) -> str:
    from lunarsci.images.elevation import elevation_bytes

    return written(name, elevation_bytes(model))


def merged(count: int = 2) -> "Figure":
    """Parts of one ground, each a little off."""
    from lunarsci.images.elevation import ElevationModel, merge
    from lunarsci.images.figures import merge_page

    track, models = ground(), []
    random = np.random.default_rng(1)
    for k in range(count):
        height = track.height_m[::4, ::4] + random.normal(0.0, 0.003, track.height_m[::4, ::4].shape) + 0.004 * k
        height[:, : 6 * k] = np.nan
        height[:, 24 + 6 * k :] = np.nan
        models.append(
            ElevationModel(
                name=f"station {k + 1}", x0_m=0.0, y0_m=0.0, spacing_m=0.04, height_m=height, synthetic=True,
                height_m_sigma=np.array(0.003), height_m_common_sigma=np.array(0.005),
            )
        )  # fmt: skip
    return merge_page(merge(models))


def ties(count: int = 2, name: str = "stop") -> "Figure":
    """Points that two stations share, as if they had been found: on a grid, with residuals of 0.3 px."""
    from lunarsci.images.adjustment import Adjusted, PairTies, TiePoints
    from lunarsci.images.figures import ties_figure
    from lunarsci.images.localisation import Localised, Station

    matches, random = heights().matches, np.random.default_rng(4)
    u, v = (grid.ravel().astype(float) for grid in np.meshgrid(np.arange(30, 300, 30), np.arange(120, 290, 30)))
    far, ones = np.stack([u, v], axis=1), np.ones(len(u))
    found = TiePoints(
        far + np.array([3.0, 9.0]), 30 * ones, ones, far, 28 * ones, ones, np.zeros((len(u), 2, 2)), 0.9 * ones
    )
    poses = tuple(replace(heights().pose, center_m=np.array([2.0 * k, 0.1 * k, 1.5])) for k in range(count))
    told = [replace(pose, center_m=pose.center_m + 0.12 * k) for k, pose in enumerate(poses)]
    stations = tuple(
        Station(
            name=f"{name}{k}", matches=matches, rig=heights().rig, pose=told[k], covariance=1e-4 * min(k, 1) * np.eye(6)
        )
        for k in range(count)
    )
    covariance = 1e-4 * np.diag([0.0] * 6 + [1.0] * 6 * (count - 1) + [0.0] * 24)
    off = 0.3 * random.standard_normal(far.shape)
    weights = (random.uniform(0.2, 1.0, len(u)),)
    fitted = Adjusted(
        poses=poses, joint=covariance, rigs=(heights().rig,) * count, rig_of=(0,) * count,
        inflation=(1.0,), residual_px=(off,), weights=weights,
    )  # fmt: skip
    shown = Localised(
        stations=stations, pairs=(PairTies(0, 1, found),), adjusted=fitted, reports=(), tied=(True,) * count
    )
    return ties_figure(shown, 0, synthetic=True)


@cache
def boards() -> Any:
    """Corners of a board straight from OpenCV's projection, with white noise, in both cameras of a rig."""
    cv2 = pytest.importorskip("cv2", reason="needs the extra images")
    import boards as seen_boards

    from lunarsci.images.calibration import BoardTarget, Sighting, calibrate

    lenses = [seen_boards.lens(520, 243, 196, (-0.12, 0.05, 5e-4, -8e-4, 0.01)),
              seen_boards.lens(518, 236, 203, (-0.11, 0.04, -5e-4, 4e-4, 0.0))]  # fmt: skip
    turn, way = cv2.Rodrigues(np.array([0.004, -0.012, 0.006]))[0], np.array([-0.12, 0.001, -0.002])
    random, target, views = np.random.default_rng(1), BoardTarget(), []
    numbers = np.arange(len(target.points_m))
    for rotation, place in seen_boards.poses(8, (0.1, 0.0625), 0.45, random):
        there = target.points_m @ rotation.T + place
        sides = zip(lenses, (there, there @ turn.T + way), strict=True)
        pixels = [cv2.projectPoints(p, np.zeros(3), np.zeros(3), of.matrix, of.terms)[0][:, 0] for of, p in sides]
        seen = (Sighting(numbers, p + random.normal(0, 0.05, p.shape)) for p in pixels)
        views.append(tuple(seen))
    return calibrate(views, target, [(480, 400)] * 2)


@cache
def predicted(**options: Any) -> Any:
    plan = written("short.toml", PLAN)
    return lunarsci.predict(plan, **(options or {"sweep": ("friction_angle_deg=30:50:3",)}))


@cache
def driven() -> Any:
    from lunarsci.twin.jobs.simulate import simulate_drive

    return saved("drive", simulate_drive(written("short.toml", PLAN), seed=5))


@cache
def states() -> Any:
    return lunarsci.states(f"{driven()}/telemetry.csv", written("short.toml", PLAN), track=f"{driven()}/track.csv")


@cache
def wheel_table() -> str:
    """Forces and states of the wheels, as `identify` takes them."""
    import pandas as pd

    return written("forces.csv", pd.DataFrame(turned().rows()).to_csv(index=False))


@cache
def turned() -> Any:
    from lunarsci.twin.jobs.forces import forces

    return forces(written("short.toml", PLAN))


@cache
def learned() -> Any:
    saved("states", states())
    at = folder() / "states"
    return lunarsci.update(
        at / "states.csv", plan=written("short.toml", PLAN), positions=at / "positions.csv", seed=1, particles=32,
        ruts=False, by_place=True,
    )  # fmt: skip


@cache
def history() -> Any:
    from lunarsci.twin.jobs.history import history as told

    return told(written("SYNTHETIC belief.json", learned().belief.to_json()))


@cache
def chosen() -> Any:
    return lunarsci.plan(target="3,0.5", risk=0.3, members=4, candidates=6, fixes="0.05,0.5")


@cache
def mission() -> Any:
    return lunarsci.plan(mission=written("mission.toml", MISSION), risk=0.3, members=4)


@cache
def traded() -> Any:
    return lunarsci.sweep(
        written("short.toml", PLAN), vary=("wheel.radius_m=0.13:0.29:2", "mass.body_kg=90:120:2"),
        sweep=("friction_angle_deg=30:50:2",), sample=0.2,
    )  # fmt: skip


@cache
def compared() -> Any:
    saved("states", states())
    at = folder() / "states"
    return lunarsci.compare(saved("predicted", predicted()), at / "states.csv", positions=at / "positions.csv")


@cache
def trials() -> Any:
    from made_trials import ROSEY, made_drive, write_captured

    from lunarsci.twin.jobs.compare_trials import compare_trials

    for k, slip in enumerate((0.05, 0.1, 0.2)):
        drive = made_drive(speed_m_s=0.1, seconds=20.0, rate_hz=5.0, slip=slip, seed=k, **ROSEY)
        write_captured(folder() / f"trials/Trial_{k}", drive)
    return compare_trials([str(folder() / "trials")], soil=("longji",))


@cache
def mapped() -> Any:
    """A cube of few pixels, some of them without data, that lies on the Moon."""
    rasterio = pytest.importorskip("rasterio")
    pytest.importorskip("h5netcdf")
    from rasterio.transform import from_origin

    from lunarsci.spectra.jobs.map_cube import map_cube

    x, random = np.linspace(461.0, 2976.0, 84), np.random.default_rng(2)
    depth = random.uniform(0.05, 0.3, (14, 12, 1))
    bands = depth * np.exp(-0.5 * ((x - 950) / 90) ** 2) + 0.2 * np.exp(-0.5 * ((x - 1950) / 200) ** 2)
    cube = ((0.08 + 3e-5 * x) * np.exp(-bands) * (1 + 0.002 * random.standard_normal(bands.shape))).astype("f4")
    cube[:3, :4] = np.nan
    path = folder() / "SYNTHETIC cube.tif"
    moon = "+proj=longlat +R=1737400 +no_defs"
    with rasterio.open(
        path, "w", driver="GTiff", width=12, height=14, count=84, dtype="float32", crs=moon,
        transform=from_origin(30, 20, 0.01, 0.01), nodata=np.nan,
    ) as file:  # fmt: skip
        file.write(cube.transpose(2, 0, 1))
        for band, value in enumerate(x, 1):
            file.set_band_description(band, f"{value:.2f} nm")
    return map_cube(str(path), folder() / "map.nc", products="bands")


@cache
def dull() -> "Spectrum":
    """Dark and red with a shallow band, as mature soil is."""
    from lunarsci.spectra.spectrum import Spectrum

    x = np.arange(450.0, 2500.0, 10.0)
    band = 1 - 0.08 * np.exp(-0.5 * ((x - 960.0) / 90.0) ** 2)
    return Spectrum(id="SYNTHETIC soil", wavelength_nm=x, reflectance=(0.055 + 0.09 * (x - 450.0) / 1000.0) * band)


def plane() -> "Figure":
    return next(iter(measured("bands").plane()))


@cache
def unmixed() -> Any:
    from lunarsci.spectra.abundance.end_members import embedded_end_members
    from lunarsci.spectra.spectrum import Spectrum

    channels = np.arange(450.0, 2451.0, 10.0)
    ends = {item.id: item.reflectance for item in embedded_end_members(channels)}
    powder = Spectrum("SYNTHETIC powder", channels, 0.5 * ends["AG-TJM-008"] + 0.5 * ends["PE-CMP-030"])
    return lunarsci.unmix([powder, dull()])


def library(count: int = 3) -> "Figure":
    """End members of two minerals, some of unknown chemistry."""
    from lunarsci.spectra.readers.library import EndMember, library_pages

    members = []
    for k in range(2 * count):
        made = spectrum(f"SYNTHETIC {k + 1}", 0.2 + 0.02 * k, 910.0 + 10 * k)
        share = None if k == 2 * count - 1 else 0.1 + 0.4 * k / count
        members.append(
            EndMember(
                id=made.id, mineral=("orthopyroxene", "clinopyroxene")[k % 2], wavelength_nm=made.wavelength_nm,
                reflectance=made.reflectance, fs=share if k % 2 == 0 else None, wo=share if k % 2 else None,
            )
        )  # fmt: skip
    return next(iter(library_pages(members)))


def soils() -> "Figure":
    """Made-up wheel states beside the soils of the literature, with the curves that they allow."""
    from lunarsci.regolith.jobs.compare_soils import compare_soils

    return compare_soils(lunarsci.identify(wheel_table(), lateral_modulus="20")).plot()


@cache
def loads() -> Any:
    return lunarsci.loads(f"{saved('predicted', predicted())}/paths.csv", plan=written("short.toml", PLAN), member=1)


@cache
def loads_of_states() -> Any:
    at = saved("states", states())
    return lunarsci.loads(f"{at}/motion.csv", states=f"{at}/states.csv", seed=1)


def film() -> "Figure":
    """What stands still in a film."""
    from matplotlib.figure import Figure

    from lunarsci.twin.figures import animation

    found = predicted()
    stage = animation._Stage(found.prediction, found.verdict)
    stage.show(len(found.prediction.time_s) // 2)
    assert isinstance(stage.figure, Figure)
    return stage.figure


def still() -> "Figure":
    from lunarsci.pages.relief import drives, still_figure

    found = predicted().prediction
    at = found.terrain
    return still_figure(at.x_m, at.y_m, at.height_m, drives("predicted: short", list(found.paths)))


def rig() -> "Figure":
    from lunarsci.images.figures import calibration_page

    return calibration_page(boards(), "SYNTHETIC")


def reproduced(part: str, page: int) -> "Figure":
    return _reproduced(part).plot(page)


@cache
def _reproduced(part: str) -> Any:
    from lunarsci.reproduce.job import reproduce

    return reproduce(part=part)


def chart(result: Any, number: int = 0, tables: str | None = None, **changes: Any) -> "Figure":
    """A picture of a report's page."""
    from lunarsci.pages.charts import CHARTS
    from lunarsci.pages.documents import document_of

    found = result.to_dict() | changes
    document = document_of(result.schema, found, {}, folder=None if tables is None else Path(tables))
    return CHARTS[document.kind][number](document)[2]


SHARES = {
    "olivine": {"fraction": 0.2, "low": 0.1, "high": 0.35},
    "orthopyroxene": {"fraction": 0.5, "low": 0.4, "high": 0.6},
}
PICTURES: dict[str, Callable[[], "Figure"]] = {
    "bands": lambda: measured("bands").plot(),
    "plane": plane,
    "indices": lambda: measured("indices").plot(),
    "fit": lambda: measured("fit").plot(),
    "shares": lambda: unmixed().plot(),
    "norm": lambda: unmixed().plot(1),
    "match": lambda: matched().plot(),
    "calibration": lambda: calibrated().plot(),
    "simulation": lambda: seen().plot(),
    "library": library,
    "map": lambda: mapped().plot(),
    "cameras": lambda: lunarsci.cameras().plot(),
    "boards": rig,
    "render": lambda: pair().plot(),
    "dem": lambda: heights().plot(),
    "locate": ties,
    "track": lambda: lunarsci.track(elevation("track.npz", ground()), line="0.3,1.2,1.4,1.2", step=0.1).plot(),
    "rocks": lambda: stones().plot(),
    "merge": merged,
    "forces": lambda: lunarsci.wheel_forces(load=36.5, side_slip=2, slip=0.1).plot(),
    "traction": lambda: lunarsci.wheel_forces(load=36.5, side_slip=2, slip="0:0.6:13").plot(),
    "identify": lambda: lunarsci.identify(wheel_table(), lateral_modulus="20").plot(),
    "posterior": lambda: lunarsci.infer(wheel_table()).plot(),
    "soils": soils,
    "belief": lambda: history().plot(),
    "history": lambda: history().plot(1),
    "terrain": lambda: lunarsci.plan(max_slope=11, target="8.5,2.5").plot(),
    "candidates": lambda: chosen().plot(),
    "front": lambda: chosen().plot(1),
    "mission": lambda: mission().plot(),
    "timetable": lambda: mission().plot(1),
    "paths": lambda: predicted().plot(),
    "profiles": lambda: predicted().plot(1),
    "boxes": lambda: predicted().plot(2),
    "states": lambda: states().plot(),
    "wheels": lambda: turned().plot(),
    "loads": lambda: loads().plot(),
    "force bands": lambda: loads_of_states().plot(),
    "compare": lambda: compared().plot(),
    "compare trials": lambda: trials().plot(),
    "learned soil": lambda: learned().plot(),
    "residuals": lambda: learned().plot(1),
    "soil map": lambda: learned().plot(2),
    "designs": lambda: traded().plot(),
    "design curves": lambda: traded().plot(1),
    "film": film,
    "report spectra": lambda: chart(calibrated()),
    "report bands": lambda: chart(measured("fit")),
    "report shares": lambda: chart(measured("fit"), 1, spectra=[{"id": "rock", "abundance": SHARES}]),
    "report craters": lambda: chart(matched()),
    "report soil": lambda: chart(lunarsci.identify(wheel_table(), lateral_modulus="20"), 1),
    "report learned": lambda: chart(history()),
    "report limits": lambda: chart(predicted()),
    "report states": lambda: chart(states(), tables=saved("states", states())),
    "report loads": lambda: chart(turned()),
    "report ground": still,
    "reproduce rock": lambda: reproduced("spectra", 0),
    "reproduce soil": lambda: reproduced("soil", 0),
    "reproduce missions": lambda: reproduced("soil", 1),
    "reproduce errors": lambda: reproduced("soil", 2),
    "reproduce paths": lambda: reproduced("drive", 0),
    "reproduce slips": lambda: reproduced("drive", 1),
}

MEASURED = {
    *(
        "cameras",
        "forces",
        "traction",
        "soils",
        "identify",
        "posterior",
        "reproduce rock",
        "reproduce soil",
        "reproduce missions",
    ),
    *("film", "reproduce errors", *(name for name in PICTURES if name.startswith("report"))),
}
"""Kinds whose example is made of numbers of the literature, or of models alone, pictures of a page that says it, and
films, whose title is a part of an image."""


LONG = "a name of a measurement that is much longer than names should be"


def many_bands(count: int) -> "Figure":
    """The first page of spectra with long names, one of them without the second band."""
    own = [spectrum(f"SYNTHETIC {k}, {LONG}", 0.1 + 0.02 * k, 915.0 + 7.0 * k) for k in range(count)]
    return lunarsci.bands(own).plot()


def plane_of(count: int) -> "Figure":
    own = [spectrum(f"SYNTHETIC {k}, {LONG}", 0.1 + 0.02 * k, 922.0 + 2.0 * k) for k in range(count)]
    return next(iter(lunarsci.bands(own).plane()))


def shares(count: int) -> "Figure":
    from lunarsci.spectra.abundance.result import share_pages

    own = unmixed().shares[0]
    return next(iter(share_pages([replace(own, id=f"{k} {LONG}") for k in range(count)])))


def norms(count: int) -> "Figure":
    from lunarsci.spectra.abundance.normative import normative_pages

    own = list(unmixed().normatives.values())[-1]
    return next(iter(normative_pages([f"{k} {LONG}" for k in range(count)], [own] * count)))


def craters(count: int) -> "Figure":
    """Craters with long names, crowded about the site."""
    from lunarsci.spectra.origin.catalogue import distance_km
    from lunarsci.spectra.origin.figure import match_pages

    [one] = matched().matches
    random, own = np.random.default_rng(3), next(item for item in one.craters if not item.contains_site)
    latitude, longitude = matched().site
    crowd = []
    for k in range(count):
        crater = replace(
            own.crater, name=f"{k} {LONG}", latitude_deg=latitude + float(random.normal(0, 1.2)),
            longitude_deg=longitude + float(random.normal(0, 1.2)), diameter_km=float(random.uniform(3, 40)),
        )  # fmt: skip
        prior = replace(own.prior, distance_km=distance_km(matched().site, crater.center))
        crowd.append(replace(own, crater=crater, prior=prior, posterior=0.9 / count))
    rock = replace(one.rock, id=f"SYNTHETIC {LONG}")
    return next(iter(match_pages([replace(one, rock=rock, craters=tuple(crowd))], matched().site)))


def histories(count: int) -> "Figure":
    """Many drives, of which one taught nothing, beside another belief with a long name."""
    from lunarsci.regolith.figure import belief_history_figure

    belief = learned().belief
    entries = [{**belief.history[0], "refused": "too far off" if k == 3 else None} for k in range(count)]
    crowd = replace(belief, history=tuple(entries))
    other = replace(belief, history=({**belief.history[0], "sha256": "0"},))
    return belief_history_figure(crowd, LONG, other, (LONG, f"another {LONG}"), synthetic=True)


def candidates(count: int, page: int) -> "Figure":
    """Drives of long names about the chosen one, a dozen of them not beaten."""
    from lunarsci.twin.figures.choice import candidate_map, front_page

    found = chosen()
    crowd = []
    for k in range(count):
        own = found.choice.candidates[k % len(found.choice.candidates)]
        crowd.append(replace(own, number=k + 1, plan=replace(own.plan, name=f"{k} {LONG}"), pareto=k % 4 == 0))
    choice = replace(found.choice, candidates=tuple(crowd))
    return front_page(choice) if page else candidate_map(found.surface, choice)


def long_mission(count: int, page: int) -> "Figure":
    """Targets of long names close together, some of them not reached."""
    from lunarsci.twin.figures.choice import mission_map, timetable

    found, random = mission(), np.random.default_rng(2)
    [own] = found.driven.targets
    crowd = []
    for k in range(count):
        x, y = 3.0 + random.uniform(-1, 1), random.uniform(-1, 1)
        target = replace(own.target, name=f"{k} {LONG}", x_m=float(x), y_m=float(y))
        fate = "reached" if k % 3 else "out of reach"
        crowd.append(replace(own, target=target, fate=fate, arrival_s=300.0 + 15 * k))
    driven = replace(found.driven, targets=tuple(crowd))
    return timetable(driven, synthetic=True) if page else mission_map(found.surface, driven)


def trade(count: int, page: int) -> "Figure":
    """Designs of three numbers, many of them on the front."""
    from lunarsci.twin.figures.choice import curve_page, design_front_page

    random, own = np.random.default_rng(1), next(one for one in traded().designs if one.outcome)
    names = ("wheel.radius_m", "mass.body_kg", "wheel.lug_height_m", "drive.speed_m_s")
    crowd = []
    for k in range(count):
        outcome = replace(own.outcome, energy_p50_j=50.0 + k, kept_share=1 - 0.015 * (count - k) / count)
        values = {name: float(value) for name, value in zip(names, random.uniform(0.1, 0.2, 4), strict=True)}
        crowd.append(replace(own, values=values, outcome=outcome))
    return curve_page(crowd, names, synthetic=True) if page else design_front_page(crowd, range(count), synthetic=True)


CROWDED: dict[str, Callable[[], "Figure"]] = {
    "many bands": lambda: many_bands(20),
    "many centres": lambda: plane_of(12),
    "many shares": lambda: shares(40),
    "many norms": lambda: norms(40),
    "30 craters": lambda: craters(30),
    "12 end members": lambda: library(12),
    "many stations": lambda: ties(9, f"station of {LONG}"),
    "many drives": lambda: histories(30),
    "50 candidates": lambda: candidates(50, 0),
    "50 risks": lambda: candidates(50, 1),
    "12 targets": lambda: long_mission(12, 0),
    "12 arrivals": lambda: long_mission(12, 1),
    "50 designs": lambda: trade(50, 0),
    "50 design curves": lambda: trade(50, 1),
}
"""The same with many items and with long names."""
