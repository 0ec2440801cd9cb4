"""Scenes full of rocks, by Mitsuba (SYNTHETIC), and the network of `lunarsci.images.rock_network` taught on them.

    python tests/benchmarks/rock_scenes.py render FOLDER 200 201 ...     minutes each; seeds of `PLAN`
    python tests/benchmarks/rock_scenes.py judge FOLDER 400 401 ...      what is found, and what of that is no rock
    python tests/benchmarks/rock_scenes.py teach FOLDER OUT.npz 200 201 ...   with jax, which lunarsci does not need

Rocks are faceted (those of `scenes.py`), boulders, slabs, or craggy; 200 to 311 taught the network that lunarsci has,
each a second time with textured polyhedra put in (`lunarsci.images.stones`), and 400 to 405 were kept back
(the first 2000 rounds were on twelve of the scenes, without stones). A rock
counts that lies within 5 m, half in view, lit, and seen by both cameras; a find is it within 0.6 widths, or 3 cm.
"""

import argparse
import math
import pickle
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import blind_scenes
import numpy as np
import scenes

from lunarsci.images import stones
from lunarsci.images.rock_network import (
    DILATIONS,
    KNEE,
    RATIO,
    SEEN_PX,
    WIDTH_PX,
    RockNetwork,
    levels,
    looked_at,
    rock_candidates,
    scores,
)
from lunarsci.images.rocks import _ground, _parallax, _scene, find_rocks

PLAN = {
    200: ("faceted", 170, 0, "regolith"), 201: ("boulder", 170, 6, "plain"), 202: ("faceted", 60, 6, "rubble"),
    203: ("slab", 170, 0, "dim"), 204: ("faceted", 170, 0, "dust"), 300: ("faceted", 170, 8, "regolith"),
    301: ("slab", 170, 8, "plain"), 302: ("boulder", 170, 8, "streaks"), 303: ("faceted", 170, 8, "dim"),
    304: ("slab", 170, 5, "rubble"), 305: ("boulder", 170, 5, "dust"), 306: ("faceted", 60, 8, "regolith"),
    307: ("slab", 170, 4, "regolith"), 308: ("boulder", 60, 5, "plain"), 309: ("faceted", 170, 0, "streaks"),
    310: ("boulder", 170, 6, "regolith"), 311: ("faceted", 60, 0, "rubble"), 400: ("craggy", 170, 6, "regolith"),
    401: ("faceted", 170, 6, "mixed"), 402: ("craggy", 170, 4, "rubble"), 403: ("boulder", 170, 6, "regolith"),
    404: ("slab", 170, 8, "soft"), 405: ("craggy", 170, 0, "dim"),
}  # fmt: skip
"""Shape of the rocks, how many, the steepest slope [deg] and the material of each seed."""
scenes.MATERIALS["mixed"] = scenes.Material(hurst=0.75, fine=0.8, pattern=0.1, pattern_m=0.15)
scenes.MATERIALS["soft"] = scenes.Material(hurst=0.9, fine=0.4, pattern=0.03, pattern_m=0.3, sun_deg=(20.0, 50.0))
FACETED, SHAPE = scenes.rock_mesh, {"now": "faceted"}


def _radius(shape: str, way: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Of a rock along directions (…, 3). (…,)"""
    if shape == "slab":
        planes = random.standard_normal((9, 3)) * [1, 1, 0.6]
        planes /= np.linalg.norm(planes, axis=1, keepdims=True)
        planes = np.concatenate([planes, np.eye(3)[[2]], -np.eye(3)[[2]], np.eye(3)[:2], -np.eye(3)[:2]])
        off = random.uniform([0.6] * 9 + [0.35] * 2 + [0.7] * 4, [1.0] * 9 + [0.6] * 2 + [1.0] * 4)
        return np.minimum((off / np.maximum(way @ planes.T, 1e-3)).min(-1), 1.4)
    low, high = ([0.7, 0.7, 0.45], [1.0, 1.0, 0.85]) if shape == "boulder" else ([0.6, 0.6, 0.4], [1.0, 1.0, 0.9])
    power = random.uniform(2.0, 3.5) if shape == "boulder" else 2.0
    radius = (np.abs(way / random.uniform(low, high)) ** power).sum(-1) ** (-1 / power)
    for _ in range(25 if shape == "boulder" else 60):
        wave = random.standard_normal(3)
        length = random.uniform(2, 9 if shape == "boulder" else 14)
        size = 0.02 if shape == "boulder" else 0.1 / length
        radius *= 1 + size * np.sin(way @ wave * length / np.linalg.norm(wave) + random.uniform(0, 6.28))
    for _ in range(0 if shape == "boulder" else 4):
        plane = random.standard_normal(3)
        radius = np.minimum(radius, random.uniform(0.45, 0.7) / np.maximum(way @ plane / np.linalg.norm(plane), 1e-3))
    return radius


def rock_mesh(ground: Any, rock: dict[str, Any], seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As that of `scenes.py`, of the shape that is asked for now."""
    if SHAPE["now"] == "faceted":
        return FACETED(ground, rock, seed)
    random = np.random.default_rng((seed, 23, rock["seed"]))
    polar, around = np.meshgrid(np.linspace(0, np.pi, 60), np.arange(120) * np.pi / 60, indexing="ij")
    way = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1)
    shape = way * _radius(SHAPE["now"], way, random)[..., None]
    shape *= rock["width"] / np.ptp(shape[..., :2].reshape(-1, 2), axis=0).max()
    x, y = rock["place"]
    base, low, high = float(ground.height(np.array([x]), np.array([y]))[0]), shape[..., 2].min(), shape[..., 2].max()
    lift = -low - rock["buried"] * (high - low)
    vertices = shape.reshape(-1, 3) + np.array([x, y, base + lift])
    index = np.arange(60 * 120, dtype=np.uint32).reshape(60, 120)
    a, b, c, d = index[:-1], index[1:], np.roll(index[1:], -1, 1), np.roll(index[:-1], -1, 1)
    faces = np.concatenate([np.stack(corner, -1).reshape(-1, 3) for corner in ((a, b, c), (a, c, d))])
    width = float(np.ptp(vertices[vertices[:, 2] > base][:, :2], axis=0).max())
    return vertices, faces, np.array([x, y, base + lift, width, float(vertices[:, 2].max() - base)])


class RockyGround(scenes.Ground):
    """Ground with many rocks between 1.7 and 6.5 m, and a slope."""

    def __init__(self, seed: int, material: Any) -> None:
        SHAPE["now"], self.count, steepest, _ = PLAN[seed]
        super().__init__(seed, material)
        if steepest:
            turn = np.random.default_rng((seed, 77)).uniform(-steepest, steepest, 2)
            self.slope = np.tan(np.radians(turn))

    def _rocks(self, random: np.random.Generator) -> list[dict[str, Any]]:
        rocks: list[dict[str, Any]] = []
        for _ in range(20000):
            away, bearing = math.sqrt(random.uniform(1.7**2, 6.5**2)), random.uniform(-0.42, 0.42)
            place = away * np.array([math.cos(bearing), math.sin(bearing)])
            width = min(0.042 / random.random() ** 0.5, 0.3)
            off = abs(abs(place[1] - self.middle(place[0])) - 0.45)
            apart = [np.hypot(*(place - r["place"])) - 0.9 * (width + r["width"]) for r in rocks]
            if off > 0.1 + 0.6 * width and min(apart, default=1.0) > 0:
                rocks.append({"place": place, "width": width, "buried": random.uniform(0.1, 0.5), "seed": len(rocks)})
            if len(rocks) == self.count:
                break
        return rocks


scenes.rock_mesh, scenes.Ground = rock_mesh, RockyGround


def folder_of(folder: Path, seed: int) -> Path:
    material = PLAN[seed][3]
    return folder / (f"navcam-{seed}" if material == "regolith" else f"navcam-{material}-{seed}") / "station0"


def truth_of(station: Any, seed: int) -> list[dict[str, Any]]:
    """Rocks that show: place, width and height [m], and their box in the rectified left picture [px]."""
    from scipy.spatial import ConvexHull, cKDTree

    matches, truth = station.found.matches, station.truth
    true = station.found.rig.moved(truth["rig"])
    ground = RockyGround(seed, scenes.MATERIALS[PLAN[seed][3]])
    bodies = [b for b in (rock_mesh(ground, r, seed) for r in ground.rocks) if np.hypot(*b[2][:2]) > 0.8]
    vertices = [b[0][::5] for b in bodies]
    number = np.repeat(np.arange(len(bodies)), [len(v) for v in vertices])
    owner = np.full(truth["kind"].shape, -1)
    on = truth["kind"] == 2
    owner[on] = number[cKDTree(np.concatenate(vertices)).query(truth["points_m"][on])[1]]
    where = np.rint(np.nan_to_num(matches.rectified.maps[0], nan=-9)).astype(int)
    inside = ((where >= 0) & (where < owner.shape[::-1])).all(axis=-1)
    shown = np.full(inside.shape, -1)
    shown[inside] = owner[where[inside][:, 1], where[inside][:, 0]]
    smooth, rows = _ground(matches.disparity), []
    for k, (mesh, _, row) in enumerate(bodies):
        v, u = np.nonzero(shown == k)
        if len(v) < 3:
            continue
        base = float(ground.height(row[:1], row[1:2])[0])
        outline = true.left.project(station.found.pose.to_camera(mesh[mesh[:, 2] > base]))
        whole = ConvexHull(outline).volume if np.isfinite(outline).all() else math.inf
        both = u.min() - smooth[int(v.mean()), int(u.mean())] > 2
        rows.append({
            "x": row[0], "y": row[1], "width": row[3], "height": row[4], "u0": u.min(), "u1": u.max(), "v0": v.min(),
            "v1": v.max(), "range": float(np.linalg.norm(row[:3] - station.found.pose.center_m)), "both": both,
            "share": ((owner == k) & truth["seen"]).sum() / whole, "lit": float(truth["lit"][owner == k].mean()),
        })  # fmt: skip
    return rows


def seen(folder: Path, seed: int) -> tuple[Any, list[dict[str, Any]], tuple[float, float]]:
    """Matches and pose of a scene, its rocks and the Sun; kept beside it."""
    path = folder_of(folder, seed)
    cache = path / "seen.pickle"
    if not cache.exists():
        with tempfile.TemporaryDirectory() as free:
            station = blind_scenes.seen(path, Path(free))
        cache.write_bytes(pickle.dumps((station.found.matches, station.found.pose, truth_of(station, seed))))
    matches, pose, rocks = pickle.loads(cache.read_bytes())
    sun = np.load(path / "truth.npz")["sun"]
    return (matches, pose), rocks, (math.degrees(math.atan2(sun[1], sun[0])), math.degrees(math.asin(sun[2])))


def judge(folder: Path, seeds: list[int]) -> Iterator[str]:
    """Per scene and in all: rocks found of those of 5 cm within 3.5 m, and of 7 and 10 cm within 5 m; false finds."""
    total = np.zeros((4, 2), dtype=int)
    for seed in seeds:
        (matches, pose), rocks, sun = seen(folder, seed)
        survey = find_rocks(matches, pose, sun_deg=sun)
        near = [r for r in survey.rocks if r.range_m < 5.0]
        places = np.array([(r.x_m, r.y_m) for r in near]).reshape(-1, 2)
        true = np.array([(r["x"], r["y"], r["width"]) for r in rocks])
        hit = np.hypot(*(places[:, None] - true[:, :2]).transpose(2, 0, 1)) < np.maximum(0.6 * true[:, 2], 0.03)
        good = np.array([r["share"] >= 0.5 and r["both"] and r["lit"] > 0.05 for r in rocks])
        away = np.array([r["range"] for r in rocks])
        asked = [good & (away < far) & (true[:, 2] >= size) for size, far in ((0.05, 3.5), (0.07, 5.0), (0.1, 5.0))]
        counts = [(int(hit.any(axis=0)[a].sum()), int(a.sum())) for a in asked]
        rows = np.array([*counts, (int((~hit.any(axis=1)).sum()), len(near))])
        total += rows
        yield f"{seed}: found, of: {rows[:3].tolist()}, false, of finds: {rows[3].tolist()}"
    yield f"all: {total.tolist()}"


# --- teaching ---


class Taught(NamedTuple):
    """A level of a scene: what the network sees (6, y, x), and 0 ground, 1 middle of a rock of its size, 2 neither."""

    images: np.ndarray
    label: np.ndarray


def labelled(scene: Any, rocks: list[dict[str, Any]]) -> Iterator[Taught]:
    """Levels of a scene. What is much smaller or larger than a rock that is there is ground."""
    for width, images in levels(scene):
        label = np.where(looked_at(scene, width, images.shape[1:], 0.3), 0, 2).astype(np.uint8)
        y, x = np.mgrid[: label.shape[0], : label.shape[1]]
        boxes = [(r["u0"], r["u1"] + 1, r["v0"], r["v1"] + 1) for r in rocks]
        for kind in (2, 1):
            for rock, (left, right, top, low) in zip(rocks, boxes, strict=True):
                off = abs(math.log((right - left) / width))
                scale = WIDTH_PX / width
                u, v = 0.5 * (left + right) * scale - 0.5, 0.5 * (top + low) * scale - 0.5
                wide, high = 0.65 * (right - left) * scale + 1.5, 0.65 * (low - top) * scale + 1.5
                if kind == 1:
                    wide = high = 1.6
                part = (
                    slice(max(int(v - high), 0), int(v + high) + 2),
                    slice(max(int(u - wide), 0), int(u + wide) + 2),
                )
                on = ((x[part] - u) / wide) ** 2 + ((y[part] - v) / high) ** 2 < 1
                good = rock["share"] > 0.4 and rock["lit"] > 0.05 and rock["both"] and off < 0.65 * math.log(RATIO)
                if (kind == 2 and off <= math.log(1.9)) or (kind == 1 and good):
                    label[part] = np.where(on & ((kind == 2) | (label[part] != 2) | on), kind, label[part])
        yield Taught(images[:-1].astype(np.float16), label)


def with_stones(scene: Any, random: np.random.Generator) -> tuple[Any, list[dict[str, Any]]]:
    """The scene with polyhedra put in, and the boxes of these."""
    pictures, noise = (scene.left.copy(), scene.right.copy()), 0.004 * float(np.percentile(scene.left, 90))
    spots = stones.spots(scene, 0.3, random)
    shown = np.array([stones.put_stone(scene, pictures, spot, noise, random) for spot in spots])
    rocks = [
        {"u0": u - w / 2, "u1": u + w / 2 - 1, "v0": v - h / 2, "v1": v + h / 2 - 1, "share": 1, "lit": 1, "both": True}
        for u, v, w, h in shown[np.isfinite(shown).all(axis=1)]
    ]
    return scene._replace(left=pictures[0], right=pictures[1], above=_parallax(scene.ground, *pictures)), rocks


class Crops:
    """Pieces of taught levels: half about rocks, the rest where ground scored high, or anywhere."""

    INNER, OUTER = 16, 16 + 2 * SEEN_PX

    def __init__(self, taught: list[Taught], random: np.random.Generator) -> None:
        self.taught, self.random = taught, random
        self.rocks = [(k, *at) for k, t in enumerate(taught) for at in np.argwhere(t.label == 1)]
        self.hard: dict[int, np.ndarray] = {}
        areas = np.array([(t.label == 0).sum() for t in taught]) ** 0.6
        self.shares = areas / areas.sum()

    def place(self, number: int) -> tuple[int, int, int]:
        """Level, y and x."""
        random = self.random
        if number % 2 == 0:
            k, y, x = self.rocks[random.integers(len(self.rocks))]
        elif self.hard and (number % 4 == 1 or random.random() < 0.7):
            k = list(self.hard)[random.integers(len(self.hard))]
            y, x = self.hard[k][random.integers(len(self.hard[k]))]
        else:
            k = int(random.choice(len(self.taught), p=self.shares))
            shape = self.taught[k].label.shape
            y, x = random.integers(shape[0]), random.integers(shape[1])
        return k, *(np.array([y, x]) + random.integers(-5, 6, 2)).tolist()

    def batch(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Images (n, 6, 44, 44) and labels (n, 8, 8); half of them mirrored, brighter, with other contrasts."""
        images, labels = np.empty((count, 6, self.OUTER, self.OUTER), np.float32), np.full((count, 8, 8), 2, np.uint8)
        for n in range(count):
            k, y, x = self.place(n)
            taught, step = self.taught[k], 2
            y, x = (
                min(max(at - 8, 0), max(size - 16, 0)) // step * step
                for at, size in zip((y, x), taught.label.shape, strict=True)
            )
            about = np.pad(taught.images[:, max(y - SEEN_PX, 0) : y + 30, max(x - SEEN_PX, 0) : x + 30].astype(float), (
                (0, 0), (max(SEEN_PX - y, 0), 44), (max(SEEN_PX - x, 0), 44)), mode="edge")[:, :44, :44]  # fmt: skip
            label = taught.label[y : y + 16 : step, x : x + 16 : step]
            if self.random.random() < 0.5 and label.shape == (8, 8):
                about, label = np.concatenate([about[:, :, -2::-1], about[:, :, :1]], axis=2), label[:, ::-1]
            gain = self.random.uniform(0.7, 1.35, 6)
            gain[1:4] = gain[1]
            images[n] = about * gain[:, None, None]
            labels[n, : label.shape[0], : label.shape[1]] = label
        return images, labels

    def look_again(self, network: RockNetwork, count: int) -> None:
        """Ground of some levels that scores high is hard from now on."""
        for k in self.random.choice(len(self.taught), size=count, replace=False):
            images, label = self.taught[k]
            score = scores(network, np.concatenate([images, images[:1]]).astype(np.float32), label != 9)
            score = np.where(label[::2, ::2] == 0, score, -99.0)
            order = np.argsort(-score, axis=None)[:4000]
            order = order[score.ravel()[order] > -4]
            if len(order):
                self.hard[int(k)] = 2 * np.column_stack(
                    np.unravel_index(self.random.permutation(order)[:150], score.shape)
                )


def teach(crops: Crops, rounds: int, channels: int = 24) -> RockNetwork:
    """By Adam (Kingma & Ba 2015, arXiv 1412.6980) on the logarithm of the chances, rocks three times."""
    import jax
    import jax.numpy as jnp

    random, sides = crops.random, (5, 3, 3, 3, 1, 1)
    into = (6, *[channels] * 5)
    layers = [
        [
            (random.standard_normal((o, i, s, s)) * math.sqrt(2 / (i * s * s))).astype(np.float32),
            np.zeros(o, np.float32),
        ]
        for o, i, s in zip((*into[1:], 1), into, sides, strict=True)
    ]

    def loss(layers: Any, images: Any, labels: Any) -> Any:
        values = images
        for k, ((weights, offsets), dilation) in enumerate(zip(layers, DILATIONS, strict=True)):
            step = (2, 2) if k == 0 else (1, 1)
            values = jax.lax.conv_general_dilated(values, weights, step, "VALID", rhs_dilation=(dilation, dilation))
            values = values + offsets[None, :, None, None]
            values = values if k == len(layers) - 1 else jnp.maximum(values, 0.1 * values)
        true, use = labels == 1, jnp.where(labels == 2, 0.0, jnp.where(labels == 1, 3.0, 1.0))
        wrong = jnp.logaddexp(0.0, values[:, 0]) - true * values[:, 0]
        return (wrong * use).sum() / use.sum() + 1e-5 * sum((w**2).sum() for w, _ in layers)

    @jax.jit
    def better(layers: Any, mean: Any, square: Any, rate: Any, number: Any, images: Any, labels: Any) -> Any:
        slope = jax.grad(loss)(layers, images, labels)
        mean = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, mean, slope)
        square = jax.tree.map(lambda s, g: 0.99 * s + 0.01 * g * g, square, slope)

        def step(layer: Any, m: Any, s: Any) -> Any:
            return layer - rate * m / (1 - 0.9**number) / (jnp.sqrt(s / (1 - 0.99**number)) + 1e-7)

        return jax.tree.map(step, layers, mean, square), mean, square

    mean = square = jax.tree.map(jnp.zeros_like, layers)
    for number in range(1, rounds + 1):
        rate = 3e-3 * min(1, number / 100) * (0.5 * (1 + math.cos(math.pi * number / rounds)) + 0.01)
        layers, mean, square = better(layers, mean, square, rate, number, *crops.batch(64))
        if number % 300 == 0:
            crops.look_again(RockNetwork(tuple((np.asarray(w), np.asarray(b)) for w, b in layers), np.zeros(3)), 60)
    return RockNetwork(tuple((np.asarray(w), np.asarray(b)) for w, b in layers), np.zeros(3))


def odds_of(folder: Path, seeds: list[int], network: RockNetwork) -> np.ndarray:
    """`RockNetwork.odds`: a logistic regression on scores of ground, and the highest of each rock, weighed alike."""
    from sklearn.linear_model import LogisticRegression

    high, true = [], []
    for seed in seeds:
        (matches, pose), rocks, sun = seen(folder, seed)
        detected = rock_candidates(_scene(matches, pose, sun)[0], 0.3, network)
        boxes = np.array([(r["u0"] - 3, r["u1"] + 4, r["v0"] - 3, r["v1"] + 4) for r in rocks])
        u, v = detected.places[:, 0, None], detected.places[:, 1, None]
        on = (u > boxes[:, 0]) & (u < boxes[:, 1]) & (v > boxes[:, 2]) & (v < boxes[:, 3])
        good = np.array([r["share"] > 0.4 and r["lit"] > 0.05 and r["both"] for r in rocks]) & on.any(axis=0)
        best = np.where(on, detected.scores[:, None], -np.inf).max(axis=0)[good]
        high += [*best, *detected.scores[~on.any(axis=1)]]
        true += [1] * len(best) + [0] * int((~on.any(axis=1)).sum())
    rows = np.column_stack([high, np.logaddexp(0.0, np.array(high) - KNEE)])
    fit = LogisticRegression(class_weight="balanced", C=100.0).fit(rows, true)
    return np.array([*fit.intercept_, *fit.coef_[0]])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("render", "judge", "teach"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("seeds", type=int, nargs="+")
    parser.add_argument("--out", type=Path, default=Path("rock_network.npz"))
    parser.add_argument("--rounds", type=int, default=4500)
    parser.add_argument("--odds", type=int, nargs="+", default=[400, 401, 402], help="seeds that odds are learned from")
    asked = parser.parse_args()
    if asked.what == "judge":
        for line in judge(asked.folder, asked.seeds):
            print(line, flush=True)
        return
    if asked.what == "render":
        for seed in asked.seeds:
            print(scenes.make(asked.folder, "navcam", seed, 1, PLAN[seed][3]), flush=True)
        return
    random, taught = np.random.default_rng(0), []
    for seed in asked.seeds:
        (matches, pose), rocks, sun = seen(asked.folder, seed)
        scene, _ = _scene(matches, pose, sun)
        changed, put = with_stones(scene, random)
        taught += [*labelled(scene, rocks), *labelled(changed, rocks + put)]
    network = teach(Crops([t for t in taught if (t.label != 2).any()], random), asked.rounds)
    network = network._replace(odds=odds_of(asked.folder, asked.odds, network))
    pairs = [(f"{name}{k}", v) for k, layer in enumerate(network.layers) for name, v in zip("wb", layer, strict=True)]
    layers = {name: values.astype(np.float16) for name, values in pairs}
    np.savez_compressed(asked.out, odds=network.odds, **layers)


if __name__ == "__main__":
    main()
