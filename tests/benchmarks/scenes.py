"""Blind scenes of a rover's stereo cameras, rendered by Mitsuba from meshes: the judge of `lunarsci images`.

Fractal regolith, craters, rocks and stamped tracks are meshes of about a pixel (millimetres where tracks are). Mitsuba
(Jakob et al. 2022, mitsuba-renderer.org) finds what each ray hits and what the Sun's disk reaches. Light is
Hapke's (1981, 10.1029/JB086iB04p03039), blurred by a lens and counted in electrons. The rig that took the pictures is
a draw from the covariance of the one in `rig.toml`, which is all that a solver is told. All of it is SYNTHETIC.

This file uses nothing of `lunarsci.images`: lenses are OpenCV's, the rest is here. It takes a minute for a station.

    python tests/benchmarks/scenes.py FOLDER --seeds 0 1 2 --rig navcam --stations 2

writes FOLDER/navcam-0/ with `rig.toml`, and for each station `left.png`, `right.png`, `pose.toml` (what telemetry says)
and `truth.npz`:

    points_m (h, w, 3)     where the ray of each pixel of the left picture ends, in the world; NaN in the sky
    kind (h, w)            0 sky, 1 ground, 2 rock
    lit (h, w)             share of the Sun's disk that reaches that point
    seen (h, w)            whether the right camera sees it
    dem_x_m, dem_y_m, dem_m   height of the ground with its rocks every centimetre, in the world
    ground_m               the same without rocks and tracks
    rocks (n, 5)           x, y, z of the middle, largest width, height over the ground [m]
    tracks (2, n, 4)       x, y and depth of the floor below the ground, and the direction, along two tracks
    left_rotation, left_center_m, right_rotation, right_center_m   where the cameras truly were
    rig (24,)              what was added to the parameters of rig.toml
"""

import argparse
import math
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

WORLD_M, MICRO_M = 64.0, 4.096
WORLD_STEP_M, MICRO_STEP_M = 0.02, 0.002
SUN_RADIUS_RAD = math.radians(0.2666)
SAMPLES = 3
TRACK_WIDTH_M, LUG_PITCH_M = 0.15, 0.025


class Lens(NamedTuple):
    """A camera: size, K (fx, fy, cx, cy) and k1 k2 k3 p1 p2."""

    size: tuple[int, int]
    pinhole: np.ndarray
    terms: np.ndarray


class Material(NamedTuple):
    """What the ground and its light are like; the numbers are assumed.

    `hurst` of its heights, relief of the centimetres over the power law's, rms of its albedo, whose pattern has lengths
    from a few millimetres to `pattern_m`, single scattering albedo `dark`, electrons of the brightest pixel, the
    lowest and highest Sun [deg], the share of the millimetres that wheels press flat, and the height of lugs' prints.
    """

    hurst: float = 0.8
    fine: float = 0.6
    pattern: float = 0.05
    pattern_m: float = 0.4
    dark: float = 0.33
    electrons: float = 25000.0
    sun_deg: tuple[float, float] = (18.0, 45.0)
    pressed: float = 0.7
    lugs_m: float = 0.0015


MATERIALS = {
    "regolith": Material(),
    "dust": Material(hurst=0.95, fine=0.25, pattern=0.02, pattern_m=0.1, sun_deg=(30.0, 60.0)),
    "rubble": Material(hurst=0.6, fine=1.0, pattern=0.15, pattern_m=0.05, sun_deg=(12.0, 30.0)),
    "streaks": Material(hurst=0.8, fine=0.4, pattern=0.2, pattern_m=0.8, dark=0.5),
    "dim": Material(hurst=0.75, fine=0.6, pattern=0.08, dark=0.15, electrons=6000.0, sun_deg=(8.0, 20.0)),
    "pressed": Material(pattern=0.02, pressed=1.0, lugs_m=0.0),
    "plain": Material(hurst=0.85, fine=0.5, pattern=0.0, sun_deg=(15.0, 35.0)),
}


class Rig(NamedTuple):
    name: str
    lenses: tuple[Lens, Lens]
    rotation: np.ndarray
    translation: np.ndarray
    sigmas: np.ndarray
    height_m: float
    down_deg: float
    near_m: float


def _lens(size: tuple[int, int], focal: float, bent: float) -> Lens:
    middle = 0.5 * (np.array(size) - 1)
    return Lens(
        size, np.array([focal, focal, *(middle + np.array([3.2, -2.7]))]), np.array([bent, -0.3 * bent, 0, 2e-4, -1e-4])
    )


def _sigmas(rotation: float) -> np.ndarray:
    own = [0.25, 0.25, 0.1, 0.1, 5e-4, 0, 0, 0, 0]
    return np.array([*own, *own, *[rotation] * 3, *[1e-4] * 3])


def nominal(kind: str) -> Rig:
    """The rig of rig.toml: like Yutu-2's, which are not published as exactly as that."""
    if kind == "pancam":
        lens, sigmas, view = _lens((1176, 864), 3378.4, -0.03), _sigmas(3e-5), (1.5, 25.5, 2.0)
    else:
        lens, sigmas, view = _lens((1024, 1024), 1189.0, -0.06), _sigmas(8e-5), (1.5, 25.0, 1.1)
    other = Lens(lens.size, lens.pinhole + np.array([1.3, 1.1, -4.0, 2.0]), lens.terms * 1.05)
    return Rig(kind, (lens, other), _turn([0.001, -0.004, 0.0015]), np.array([-0.27, 0.0006, -0.0009]), sigmas, *view)


def perturbed(rig: Rig, delta: np.ndarray) -> Rig:
    lenses = tuple(
        Lens(lens.size, lens.pinhole + delta[9 * i : 9 * i + 4], lens.terms + delta[9 * i + 4 : 9 * i + 9])
        for i, lens in enumerate(rig.lenses)
    )
    rotation = _turn(delta[18:21]) @ rig.rotation
    return rig._replace(lenses=lenses, rotation=rotation, translation=rig.translation + delta[21:])


def rig_toml(rig: Rig) -> str:
    names = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "k3", "p1", "p2")
    lines = [f'name = "SYNTHETIC {rig.name}"', "bits = 10"]
    for side, lens in zip(("left", "right"), rig.lenses, strict=True):
        lines += [f"[{side}]", f"width_px = {lens.size[0]}", f"height_px = {lens.size[1]}"]
        lines += [f"{n} = {float(x)!r}" for n, x in zip(names, [*lens.pinhole, *lens.terms], strict=True)]
    import cv2

    lines += ["[relative]", f"rotation_rad = {cv2.Rodrigues(rig.rotation)[0].ravel().tolist()}"]
    lines += [f"translation_m = {rig.translation.tolist()}", "[sigma]"]
    lines += [f"{n} = {float(s)!r}" for n, s in zip(names, rig.sigmas, strict=False)]
    lines += [f"rotation_rad = {float(rig.sigmas[18])!r}", f"translation_m = {float(rig.sigmas[21])!r}", ""]
    return "\n".join(lines)


def _turn(vector: Any) -> np.ndarray:
    import cv2

    return cv2.Rodrigues(np.asarray(vector, dtype=float))[0]


# --- the ground as a function of x and y ---


def _fractal(
    count: int, step: float, lengths: tuple[float, float], hurst: float, random: np.random.Generator
) -> np.ndarray:
    """Periodic ground of wavelengths between two, power k^-(2 H + 2), rms 1."""
    shortest, longest = lengths
    k = np.hypot(np.fft.fftfreq(count, step)[:, None], np.fft.rfftfreq(count, step)[None, :])
    with np.errstate(divide="ignore"):
        weight = np.where((k >= 1 / longest) & (k <= 1 / shortest), k ** -(hurst + 1.0), 0.0)
    noise = np.fft.rfft2(random.standard_normal((count, count)))
    field = np.fft.irfft2(noise * weight, s=(count, count))
    return field / field.std()


def _rms(longest: float, shortest: float, hurst: float) -> float:
    """Rms height of wavelengths between two: 2 cm over a metre, as the power law has it (assumed)."""
    return 0.02 * math.sqrt(longest ** (2 * hurst) - shortest ** (2 * hurst))


def _bowl(u2: np.ndarray) -> np.ndarray:
    """A small crater of unit depth and radius at squared distances: a bowl, a rim, and what was thrown out."""
    return -(1 - u2) * np.exp(-1.3 * u2) + 0.25 * np.exp(-((np.sqrt(u2) - 1.0) ** 2) / 0.06)


class Ground:
    """Heights and albedo anywhere, and rocks and tracks on it."""

    def __init__(self, seed: int, material: Material = MATERIALS["regolith"]) -> None:
        from scipy.ndimage import spline_filter

        self.material, hurst, self.driven = material, material.hurst, True
        random = np.random.default_rng((seed, 11))
        count, fine = round(WORLD_M / WORLD_STEP_M), round(MICRO_M / MICRO_STEP_M)
        world = _rms(8.0, 0.15, hurst) * _fractal(count, WORLD_STEP_M, (0.15, 8.0), hurst, random)
        micro = _rms(0.15, 0.005, hurst) * _fractal(fine, MICRO_STEP_M, (0.005, 0.15), hurst, random)
        micro *= material.fine
        self._craters(world, WORLD_STEP_M, random, random.poisson(500), (0.3, 5.0), 0.09)
        self._craters(micro, MICRO_STEP_M, random, random.poisson(160), (0.03, 0.25), 0.12)
        self.slope = np.array([math.tan(math.radians(a)) for a in random.uniform(-3, 3, 2)])
        self.world, self.micro = (spline_filter(f, 3, mode="grid-wrap") for f in (world, micro))
        self.tint = spline_filter(
            _fractal(fine, MICRO_STEP_M, (0.006, material.pattern_m), 0.8, random), 3, mode="grid-wrap"
        )
        self.bends = random.uniform([-0.03, -0.01, 0.5], [0.03, 0.01, 1.0])
        self.depth = 0.008 + 0.002 * random.standard_normal(), random.uniform(0.001, 0.003), random.uniform(0.5, 1.5)
        self.rocks = self._rocks(random)

    @staticmethod
    def _craters(
        field: np.ndarray, step: float, random: np.random.Generator, count: int, sizes: tuple[float, float], deep: float
    ) -> None:
        total = len(field)
        for _ in range(count):
            diameter = sizes[0] / max(random.random(), (sizes[0] / sizes[1]) ** 2) ** 0.5
            depth = deep * diameter * random.uniform(0.3, 1.0)
            reach = int(1.25 * diameter / step)
            row, column = random.integers(0, total, 2)
            offset = np.arange(-reach, reach + 1)
            u2 = ((offset[:, None] ** 2 + offset[None, :] ** 2) * step**2) / (0.5 * diameter) ** 2
            field[np.ix_((row + offset) % total, (column + offset) % total)] += depth * _bowl(u2)

    @staticmethod
    def _at(field: np.ndarray, x: np.ndarray, y: np.ndarray, step: float) -> np.ndarray:
        from scipy.ndimage import map_coordinates

        return map_coordinates(field, [y / step, x / step], order=3, mode="grid-wrap", prefilter=False)

    def bare(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Ground without tracks and rocks. [m]"""
        coarse = self._at(self.world, x, y, WORLD_STEP_M) + x * self.slope[0] + y * self.slope[1]
        return coarse + self._at(self.micro, x, y, MICRO_STEP_M)

    def height(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Ground with tracks, without rocks. [m]"""
        found = self.bare(x, y)
        near = np.abs(np.abs(y - self.middle(x)) - 0.45) < 0.2
        if near.any() and self.driven:
            found[near] = self._tracked(x[near], y[near], found[near])
        return found

    def middle(self, x: np.ndarray) -> np.ndarray:
        """Where the rover's middle went. [m]"""
        return 0.1 + self.bends[0] * x + self.bends[1] * x**2 * 0.5

    def floor(self, x: np.ndarray) -> np.ndarray:
        """Depth of the mean floor of tracks below the ground. [m]"""
        mean, swing, pace = self.depth
        return mean + swing * np.sin(pace * x)

    def _tracked(self, x: np.ndarray, y: np.ndarray, bare: np.ndarray) -> np.ndarray:
        """Pressed flat between soft edges, with lugs and small berms."""
        off = np.abs(np.abs(y - self.middle(x)) - 0.45)
        inside = 0.5 * (1 - np.tanh((off - 0.5 * TRACK_WIDTH_M) / 0.004))
        berm = 0.003 * np.exp(-(((off - 0.5 * TRACK_WIDTH_M - 0.012) / 0.008) ** 2))
        lugs = self.material.lugs_m * np.sin(2 * np.pi * x / LUG_PITCH_M)
        smooth = bare - self.material.pressed * inside * self._at(self.micro, x, y, MICRO_STEP_M)
        return smooth - inside * (self.floor(x) - lugs) + berm

    def albedo(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 1 + self.material.pattern * np.clip(self._at(self.tint, x, y, MICRO_STEP_M), -3, 3)

    def _rocks(self, random: np.random.Generator) -> list[dict[str, Any]]:
        """Rocks of 3 to 50 cm between 1.5 and 25 m ahead, none on the tracks."""
        rocks: list[dict[str, Any]] = []
        while len(rocks) < 130:
            x, bearing = 1.5 + 23.5 * random.random() ** 1.6, random.uniform(-0.5, 0.5)
            place = np.array([x, x * bearing])
            width = min(0.03 / random.random() ** 0.55, 0.5)
            off = abs(abs(place[1] - self.middle(place[0])) - 0.45)
            if off < 0.12 + 0.6 * width or any(
                np.hypot(*(place - r["place"])) < 0.7 * (width + r["width"]) for r in rocks
            ):
                continue
            rocks.append({"place": place, "width": width, "buried": random.uniform(0.15, 0.45), "seed": len(rocks)})
        return rocks


# --- meshes ---


def fan(ground: Ground, rig: Rig, center: np.ndarray, heading: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces and normals of the ground about a station: finer than a pixel where a picture sees it."""
    lens = rig.lenses[0]
    pixel, half = 1 / lens.pinhole[0], math.atan(0.55 * lens.size[0] / lens.pinhole[0])
    share = 0.4 if rig.name == "navcam" else 0.6
    radii = [0.8]
    while radii[-1] < 45.0:
        radii.append(radii[-1] + min(max(share * radii[-1] ** 2 / rig.height_m * pixel, 0.0012), 0.05))
    middle = np.arange(-half - 0.17, half + 0.17, 0.85 * pixel)
    wide = np.arange(0.01, 0.9, 0.01)
    angles = np.concatenate([middle[0] - wide[::-1], middle, middle[-1] + wide])
    radius, angle = np.meshgrid(radii, heading + angles, indexing="ij")
    x, y = center[0] + radius * np.cos(angle), center[1] + radius * np.sin(angle)
    points = np.stack([x, y, ground.height(x.ravel(), y.ravel()).reshape(x.shape)], axis=-1)
    out, aside = (np.gradient(points, axis=axis).astype(np.float32) for axis in (0, 1))
    normals = np.cross(out, aside).reshape(-1, 3)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    index = np.arange(x.size, dtype=np.uint32).reshape(x.shape)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return points.reshape(-1, 3), faces, normals


def rock_mesh(ground: Ground, rock: dict[str, Any], seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A stone with facets and knobs: its vertices and faces, and its row of `rocks`."""
    random = np.random.default_rng((seed, 13, rock["seed"]))
    polar, around = np.meshgrid(
        np.linspace(0, np.pi, 60), np.linspace(0, 2 * np.pi, 120, endpoint=False), indexing="ij"
    )
    way = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1)
    planes = random.standard_normal((14, 3))
    planes /= np.linalg.norm(planes, axis=1, keepdims=True)
    reach = random.uniform(0.62, 1.0, 14) / np.maximum(way @ planes.T, 1e-3)
    radius = np.minimum((reach**-14).sum(-1) ** (-1 / 14), 1.1)
    for knobs in random.standard_normal((40, 3)) * 6:
        radius += 0.006 * np.sin(way @ knobs + knobs[0])
    shape = way * radius[..., None] * random.uniform([0.8, 0.8, 0.55], [1.0, 1.0, 0.9])
    spread = np.ptp(shape[..., :2].reshape(-1, 2), axis=0).max()
    shape *= rock["width"] / spread
    x, y = rock["place"]
    base = float(ground.height(np.array([x]), np.array([y]))[0])
    low, high = shape[..., 2].min(), shape[..., 2].max()
    lift = -low - rock["buried"] * (high - low)
    vertices = shape.reshape(-1, 3) + np.array([x, y, base + lift])
    i = np.arange(60 * 120, dtype=np.uint32).reshape(60, 120)
    a, b, c, d = i[:-1], i[1:], np.roll(i[1:], -1, 1), np.roll(i[:-1], -1, 1)
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    above = vertices[vertices[:, 2] > base]
    width = float(np.ptp(above[:, :2], axis=0).max())
    return vertices, faces, np.array([x, y, base + lift, width, float(vertices[:, 2].max() - base)])


def together(bodies: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All rocks as one mesh: vertices, faces, normals."""
    starts = np.cumsum([0, *(len(b[0]) for b in bodies[:-1])])
    faces = [b[1] + np.uint32(start) for b, start in zip(bodies, starts, strict=True)]
    vertices, corners = np.concatenate([b[0] for b in bodies]), np.concatenate(faces)
    return vertices, corners, _normals(vertices, corners)


def load(meshes: list[tuple[np.ndarray, np.ndarray, np.ndarray]], origin: np.ndarray) -> Any:
    """A Mitsuba scene, with `origin` moved to zero since it counts in single precision."""
    import mitsuba as mi

    scene: dict[str, Any] = {"type": "scene"}
    for number, (vertices, faces, normals) in enumerate(meshes):
        local = (vertices - origin).astype(np.float32)
        mesh = mi.Mesh(f"m{number}", len(local), len(faces), has_vertex_normals=True)
        values = mi.traverse(mesh)
        values["vertex_positions"] = mi.Float(local.ravel())
        values["faces"] = mi.UInt32(faces.ravel())
        values["vertex_normals"] = mi.Float(normals.astype(np.float32).ravel())
        values.update()
        scene[f"m{number}"] = mesh
    return mi.load_dict(scene)


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    p, q, r = (vertices[faces[:, i]] for i in range(3))
    across = np.cross(q - p, r - p)
    total = np.stack(
        [sum(np.bincount(faces[:, i], across[:, k], len(vertices)) for i in range(3)) for k in range(3)], axis=1
    )
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)


# --- light ---


class Hits(NamedTuple):
    """What rays (n,) meet, in local coordinates; `lit` is whether a point of the Sun's disk reaches it."""

    found: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    shape: np.ndarray
    lit: np.ndarray


def trace(scene: Any, origin: np.ndarray, ways: np.ndarray, suns: np.ndarray) -> Hits:
    import drjit as dr
    import mitsuba as mi

    def vectors(rows: np.ndarray) -> Any:
        return mi.Vector3f(*(mi.Float(np.ascontiguousarray(rows[:, i], dtype=np.float32)) for i in range(3)))

    rays = mi.Ray3f(mi.Point3f(*map(float, origin)), vectors(ways))
    hit = scene.ray_intersect(rays)
    valid = hit.is_valid()
    blocked = scene.ray_test(hit.spawn_ray(vectors(suns)), active=valid)
    first, way, flat, place = hit.shape == scene.shapes()[0], hit.sh_frame.n, hit.n, hit.p
    dr.eval(valid, blocked, first, way, flat, place)
    found, normals, geometric = np.array(valid), np.array(way).T, np.array(flat).T
    facing = (geometric * suns).sum(1) > 0
    shape = np.where(found, np.where(np.array(first), 1, 2), 0).astype(np.uint8)
    return Hits(found, np.array(place).T, normals, shape, found & facing & ~np.array(blocked))


def hapke(incidence: np.ndarray, emission: np.ndarray, phase: np.ndarray, albedo: np.ndarray) -> np.ndarray:
    """Radiance factor over pi of Hapke (1981), from cosines, the phase angle [rad] and single scattering albedo."""
    w = np.minimum(albedo, 0.99)
    scatter = (1 - 0.09) / (1 + 0.6 * np.cos(phase) + 0.09) ** 1.5
    surge = 1.5 / (1 + np.tan(0.5 * phase) / 0.06)
    gamma = np.sqrt(1 - w)
    h0, h = ((1 + 2 * mu) / (1 + 2 * mu * gamma) for mu in (incidence, emission))
    return w / 4 * incidence / (incidence + emission + 1e-9) * ((1 + surge) * scatter + h0 * h - 1)


def ways_of(lens: Lens, pixels: np.ndarray) -> np.ndarray:
    """Unit directions of pixels (n, 2) in the camera's frame, by OpenCV."""
    import cv2

    fx, fy, cx, cy = lens.pinhole
    k1, k2, k3, p1, p2 = lens.terms
    matrix, terms = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), np.array([k1, k2, p1, p2, k3])
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 15, 1e-13)
    flat = cv2.undistortPoints(pixels.reshape(-1, 1, 2), matrix, terms, criteria=stop).reshape(-1, 2)
    rays = np.column_stack([flat, np.ones(len(flat))])
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def picture(
    scene: Any,
    ground: Ground,
    lens: Lens,
    pose: tuple[np.ndarray, np.ndarray],
    sun: np.ndarray,
    world: np.ndarray,
    random: np.random.Generator,
) -> np.ndarray:
    """Radiance factor of a picture with its lens's blur, without noise."""  # fmt: skip
    from scipy.ndimage import gaussian_filter

    width, height = lens.size
    fine = np.empty((height * SAMPLES, width * SAMPLES), dtype=np.float32)
    across = (np.arange(width * SAMPLES) + 0.5) / SAMPLES - 0.5
    side = np.cross(sun, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    for start in range(0, len(fine), 384):
        rows = (np.arange(start, min(start + 384, len(fine))) + 0.5) / SAMPLES - 0.5
        u, v = np.meshgrid(across, rows)
        ways = ways_of(lens, np.stack([u, v], -1).reshape(-1, 2)) @ pose[0].T
        turn, reach = random.random((2, len(ways)))
        disk = SUN_RADIUS_RAD * np.sqrt(reach)[:, None]
        suns = sun + disk * (
            np.cos(2 * np.pi * turn)[:, None] * side + np.sin(2 * np.pi * turn)[:, None] * np.cross(side, sun)
        )
        hits = trace(scene, pose[1], ways, suns / np.linalg.norm(suns, axis=1, keepdims=True))
        place = hits.points + world
        albedo = np.where(hits.shape == 1, ground.albedo(place[:, 0], place[:, 1]), 1.15)
        mu0, mu = np.maximum(hits.normals @ sun, 0.0), np.maximum(-(hits.normals * ways).sum(1), 1e-3)
        phase = np.arccos(np.clip(-(ways @ sun), -1, 1))
        light = hits.lit * hapke(mu0, mu, phase, ground.material.dark * albedo) + 0.0015 * albedo
        fine[start : start + len(rows)] = np.where(hits.found, light, 0.0).reshape(len(rows), -1)
    fine = gaussian_filter(fine, 0.365 * SAMPLES, mode="nearest")
    return fine.reshape(height, SAMPLES, width, SAMPLES).mean(axis=(1, 3))


def counted(light: np.ndarray, lens: Lens, full: float, random: np.random.Generator) -> np.ndarray:
    """Ten-bit numbers of `full` electrons at most: vignetting, shot noise, reading noise of 15. `light` is a share."""
    width, height = lens.size
    u, v = np.meshgrid(np.arange(width) - lens.pinhole[2], np.arange(height) - lens.pinhole[3])
    cosine = 1 / np.sqrt(1 + (u / lens.pinhole[0]) ** 2 + (v / lens.pinhole[1]) ** 2)
    electrons = random.poisson(np.maximum(light * full * cosine**4, 0.0)) + 15.0 * random.standard_normal(light.shape)
    return np.clip(np.rint(electrons / full * 1023 + 8), 0, 1023).astype(np.uint16)


# --- a station ---


def look(heading: float, down: float, roll: float) -> np.ndarray:
    """Axes of a camera (right, down, ahead) as columns."""
    ahead = np.array([math.cos(down) * math.cos(heading), math.cos(down) * math.sin(heading), -math.sin(down)])
    right = np.array([math.sin(heading), -math.cos(heading), 0.0])
    below = np.cross(ahead, right)
    across = math.cos(roll) * right + math.sin(roll) * below
    return np.stack([across, np.cross(ahead, across), ahead], axis=1)


def sun_at(azimuth: float, height: float) -> np.ndarray:
    """The way to it, from its azimuth and its height over the horizon. [rad]"""
    return np.array([math.cos(height) * math.cos(azimuth), math.cos(height) * math.sin(azimuth), math.sin(height)])


def take(
    folder: Path, ground: Ground, told: Rig, delta: np.ndarray, seed: int, view: tuple[Any, ...], random: Any
) -> None:
    """Pictures and truth of a `view`: centre of the left camera [m], its heading, down and roll [rad], the way to the
    Sun, and x from and to, y from and to, of the heights, from the centre [m]."""
    import cv2

    center, angles, sun, box = view
    rig, spot, left = perturbed(told, delta), center[:2], look(*angles)
    right = left @ rig.rotation.T, center - left @ (rig.rotation.T @ rig.translation)
    bodies = [rock_mesh(ground, rock, seed) for rock in ground.rocks]
    near = [b for b in bodies if np.hypot(*(b[2][:2] - spot)) > 0.8]
    between = 0.5 * (center + right[1])
    scene = load([fan(ground, rig, between, angles[0]), together(near)], center)
    zero = np.zeros(3)
    poses = (left, zero), (right[0], right[1] - center)
    lights = [
        picture(scene, ground, lens, pose, sun, center, random) for lens, pose in zip(rig.lenses, poses, strict=True)
    ]
    gain = 0.8 / np.percentile(lights[0], 99.5)
    folder.mkdir(parents=True, exist_ok=True)
    for name, light, lens in zip(("left", "right"), lights, rig.lenses, strict=True):
        cv2.imwrite(str(folder / f"{name}.png"), counted(gain * light, lens, ground.material.electrons, random))
    truth = _truth(scene, ground, rig, poses, sun, center, box)
    rows = np.array([b[2] for b in near])
    np.savez_compressed(
        folder / "truth.npz", **truth, rocks=rows, tracks=_tracks(ground), rig=delta, left_rotation=left,
        left_center_m=center, right_rotation=right[0], right_center_m=right[1], sun=sun,
    )  # fmt: skip


def station(folder: Path, ground: Ground, told: Rig, delta: np.ndarray, seed: int, number: int) -> None:
    random = np.random.default_rng((seed, 17, number))
    rig = perturbed(told, delta)
    spot = np.array([(0.0, 0.0), (7.0 * math.cos(0.05), 7.0 * math.sin(0.05))][number % 2]) * max(1, number)
    if not ground.driven:
        spot = spot + random.uniform([-0.5, -0.3], [0.1, 0.3])
    angles = [
        _heading(ground, told, spot, seed) + random.uniform(-0.05, 0.05),
        math.radians(told.down_deg + random.uniform(-1, 1)),
        random.normal(0, 0.02),
    ]
    center = np.array([*spot, float(ground.bare(spot[:1], spot[1:])[0]) + rig.height_m])
    azimuth = random.uniform(0, 2 * np.pi) if number == 0 else random.uniform(0.3, 0.6) + _first_azimuth(seed)
    sun = sun_at(azimuth, math.radians(random.uniform(*ground.material.sun_deg)))
    reach = 12.0 if rig.name == "navcam" else 8.0
    box = rig.near_m, reach, -0.45 * reach, 0.45 * reach
    take(folder, ground, told, delta, seed, (center, angles, sun, box), random)
    degrees = [math.degrees(a) for a in angles]
    wrong = np.zeros(3) if number == 0 else random.normal(0, [0.12, 0.12, 0.03])
    turned = 0.0 if number == 0 else random.normal(0, 0.5)
    told_toml = f"position_m = {(center + wrong).tolist()}\nheading_deg = {degrees[0] + turned!r}\n"
    (folder / "pose.toml").write_text(told_toml + f"down_deg = {degrees[1]!r}\nroll_deg = {degrees[2]!r}\n")


def _heading(ground: Ground, told: Rig, spot: np.ndarray, seed: int) -> float:
    """Straight on, and of the narrower camera to one of the tracks, 2.6 m ahead. [rad]"""
    if told.name != "pancam":
        return 0.0
    side = (-0.45, 0.45)[seed % 2] + float(ground.middle(spot[0] + 2.6))
    return math.atan2(side - float(spot[1]), 2.6)


def _first_azimuth(seed: int) -> float:
    random = np.random.default_rng((seed, 17, 0))
    random.uniform(-0.05, 0.05), random.uniform(-1, 1), random.normal(0, 0.02)
    return float(random.uniform(0, 2 * np.pi))


def _tracks(ground: Ground) -> np.ndarray:
    x = np.arange(0.5, 20.0, 0.01)
    turn = np.arctan2(np.gradient(ground.middle(x), x), 1.0)
    return np.array([np.stack([x, ground.middle(x) + side, ground.floor(x), turn], 1) for side in (0.45, -0.45)])


def _truth(
    scene: Any, ground: Ground, rig: Rig, poses: Any, sun: np.ndarray, center: np.ndarray, box: tuple[float, ...]
) -> dict[str, np.ndarray]:
    lens = rig.lenses[0]
    width, height = lens.size
    u, v = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    ways = ways_of(lens, np.stack([u, v], -1).reshape(-1, 2)) @ poses[0][0].T
    side = np.cross(sun, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    lit = np.zeros(len(ways), dtype=np.float32)
    for turn in np.arange(6) * np.pi / 3:
        way = sun + 0.8 * SUN_RADIUS_RAD * (math.cos(turn) * side + math.sin(turn) * np.cross(side, sun))
        hits = trace(scene, poses[0][1], ways, np.broadcast_to(way / np.linalg.norm(way), ways.shape))
        lit += hits.lit / 6
    back = poses[1][1] - hits.points
    far = np.linalg.norm(back, axis=1, keepdims=True)
    seen = hits.found & _visible(scene, hits.points, back / np.maximum(far, 1e-9), far[:, 0])
    points = np.where(hits.found[:, None], hits.points + center, np.nan)
    own = {"points_m": points.reshape(height, width, 3), "kind": hits.shape.reshape(height, width)}
    own |= {"lit": lit.reshape(height, width), "seen": seen.reshape(height, width)}
    x, y = np.arange(box[0], box[1], 0.01), np.arange(box[2], box[3], 0.01)
    gx, gy = np.meshgrid(x + center[0], y + center[1])
    top = np.column_stack([gx.ravel(), gy.ravel(), np.full(gx.size, center[2] + 3.0)]) - center
    down = trace_down(scene, top) + center[2]
    return own | {
        "dem_x_m": gx[0], "dem_y_m": gy[:, 0], "dem_m": down.reshape(gx.shape),
        "ground_m": ground.bare(gx.ravel(), gy.ravel()).reshape(gx.shape),
    }  # fmt: skip


def _visible(scene: Any, points: np.ndarray, ways: np.ndarray, far: np.ndarray) -> np.ndarray:
    import mitsuba as mi

    start = points + 1e-4 * ways
    columns = [mi.Float(np.ascontiguousarray(a[:, i], dtype=np.float32)) for a in (start, ways) for i in range(3)]
    rays = mi.Ray3f(mi.Point3f(*columns[:3]), mi.Vector3f(*columns[3:]))
    rays.maxt = mi.Float((far - 2e-3).astype(np.float32))
    return ~np.array(scene.ray_test(rays))


def trace_down(scene: Any, top: np.ndarray) -> np.ndarray:
    import mitsuba as mi

    columns = [mi.Float(np.ascontiguousarray(top[:, i], dtype=np.float32)) for i in range(3)]
    hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(*columns), mi.Vector3f(0.0, 0.0, -1.0)))
    return np.where(np.array(hit.is_valid()), np.array(hit.p).T[:, 2], np.nan)


def make(
    folder: Path, kind: str, seed: int, stations: int = 1, material: str = "regolith", before: bool = False
) -> Path:
    """Render a scene into `folder`/KIND-SEED, unless it is there; gives that folder.

    Of another material than regolith it is `folder`/KIND-MATERIAL-SEED. With `before` each station has a `beforeN`
    from close by, without tracks.
    """
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    target = folder / (f"{kind}-{seed}" if material == "regolith" else f"{kind}-{material}-{seed}")
    told = nominal(kind)
    random = np.random.default_rng((seed, 19))
    delta = random.standard_normal(24) * told.sigmas
    missing = [n for n in range(stations) if not (target / f"station{n}" / "pose.toml").exists()]
    ground = Ground(seed, MATERIALS[material]) if missing else None
    for number in missing:
        station(target / f"station{number}", ground, told, delta, seed, number)
        if before:
            ground.driven = False
            station(target / f"before{number}", ground, told, delta, seed, number)
            ground.driven = True
    (target / "rig.toml").write_text(rig_toml(told))
    return target


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--rig", choices=("navcam", "pancam"), default="navcam")
    parser.add_argument("--stations", type=int, default=1)
    parser.add_argument("--material", choices=tuple(MATERIALS), default="regolith")
    parser.add_argument("--before", action="store_true", help="each station's ground before the wheels came, too")
    asked = parser.parse_args()
    for seed in asked.seeds:
        print(make(asked.folder, asked.rig, seed, asked.stations, asked.material, asked.before))
        sys.stdout.flush()


if __name__ == "__main__":
    main()
