"""The light renderer beside Mitsuba, beside closed forms, and through the command."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from lunarsci.cli import main

from lunarsci.errors import DataError, ParameterError
from lunarsci.images.camera import PARAMETERS, Camera, Pose, StereoRig, covariance_of
from lunarsci.images.render import Landscape, World, _scattered, landscape_on, read_track, render, seen_by, with_track
from lunarsci.images.rig_files import read_pose, read_rig
from lunarsci.io.inputs import InputFile
from lunarsci.pages.drive_answers import rendered

LENS = Camera(name="l", width_px=120, height_px=90, fx_px=130.0, fy_px=130.0, cx_px=60.0, cy_px=44.0, k1=-0.05)
RIG = StereoRig(
    name="small",
    left=LENS,
    right=LENS,
    rotation=np.eye(3),
    translation_m=np.array([-0.27, 0.0, 0.0]),
    covariance=covariance_of({name: 0.5 for name in PARAMETERS if name.endswith("cx_px")}),
)
POSE = Pose.looking([0.0, 0.0, 1.5], 5.0, 28.0, 2.0)


def landscape(**options: float) -> Landscape:
    flat = (0.0, -3.0, 0.5, np.zeros((13, 17)))
    return landscape_on(flat, name="g", seed=8, spacing_m=0.05, **({"rocks_per_m2": 1.0} | options))


def flat_ground(elevation: float = 35.0, rocks: np.ndarray | None = None) -> Landscape:
    level = np.zeros((200, 200))
    none = np.empty((0, 7))
    place = {"x0_m": 0.0, "y0_m": -10.0, "spacing_m": 0.1, "height_m": level, "albedo": np.ones_like(level)}
    return Landscape(
        name="f", rocks=none if rocks is None else rocks, sun_azimuth_deg=0, sun_elevation_deg=elevation, **place
    )


def test_geometry_and_shadows_are_those_of_mitsuba() -> None:
    mi = pytest.importorskip("mitsuba")
    if "llvm_ad_rgb" not in mi.variants():
        pytest.skip("this Mitsuba has no LLVM variant")
    mi.set_variant("llvm_ad_rgb")
    ground = landscape()
    height, s = ground.height_m, ground.spacing_m
    x, y = np.meshgrid(ground.x0_m + s * np.arange(height.shape[1]), ground.y0_m + s * np.arange(height.shape[0]))
    index = np.arange(height.size).reshape(height.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    mesh = mi.Mesh("ground", height.size, len(faces))
    values = mi.traverse(mesh)
    values["vertex_positions"] = mi.Float(np.stack([x, y, height], -1).astype(np.float32).ravel())
    values["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
    values.update()
    scene = {"type": "scene", "ground": mesh}
    to = mi.ScalarTransform4f
    for n, (rx, ry, rz, ra, rb, rc, turn) in enumerate(ground.rocks.tolist()):
        placed = to().translate([rx, ry, rz]).rotate([0, 0, 1], turn).scale([ra, rb, rc])
        scene[f"rock{n}"] = {"type": "sphere", "to_world": placed}
    loaded = mi.load_dict(scene)
    truth = render(ground, RIG, POSE, perturbed=False, samples=1).truth
    pixels = np.stack(np.meshgrid(np.arange(120.0), np.arange(90.0)), -1).reshape(-1, 2)
    ways = LENS.rays(pixels) @ POSE.rotation.T
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)

    def vector(rows: np.ndarray) -> tuple:
        return tuple(mi.Float(np.ascontiguousarray(rows[:, k], dtype=np.float32)) for k in range(3))

    hit = loaded.ray_intersect(mi.Ray3f(mi.Point3f(0, 0, 1.5), mi.Vector3f(*vector(ways))))
    sun = np.broadcast_to(ground.sun, ways.shape)
    blocked = np.array(loaded.ray_test(hit.spawn_ray(mi.Vector3f(*vector(sun)))))
    theirs, valid = np.array(hit.p).T, np.array(hit.is_valid())
    ours = truth.points_m.reshape(-1, 3)
    both = valid & np.isfinite(ours[:, 0])
    assert (valid == np.isfinite(ours[:, 0])).mean() > 0.999
    off = np.linalg.norm(LENS.project(POSE.to_camera(theirs[both])) - LENS.project(POSE.to_camera(ours[both])), axis=1)
    assert np.quantile(off, 0.999) < 0.01  # px
    apart = np.linalg.norm(theirs[both] - ours[both], axis=1)
    assert np.quantile(apart, 0.995) < 1e-4
    lit = truth.lit.ravel()
    assert (blocked[both & (lit == 1)]).mean() < 0.01  # the edge of a shadow, and slopes that turn from the Sun
    assert (blocked[both & (lit == 0)]).mean() > 0.5


def test_a_ray_meets_a_plane_and_an_ellipsoid_where_geometry_says() -> None:
    rock = np.array([[5.0, 0.0, 0.0, 0.4, 0.2, 0.3, 90.0]])
    world = World.of(flat_ground(rocks=rock))
    origin = np.array([1.0, 0.0, 1.5])
    ways = np.array([[1.0, 1.0, -0.5], [1.0, 0.0, -0.375], [1.0, 0.0, 0.1]])
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    seen = seen_by(world, origin, ways, np.broadcast_to(world.sun, ways.shape), False)
    assert seen.kind.tolist() == [1, 2, 0]
    assert seen.far[0] == pytest.approx(1.5 / -ways[0, 2])
    # The second ray aims at the middle: it ends on the ellipsoid, whose half axis along x is 0.2 after the turn.
    point = origin + ways[1] * seen.far[1]
    assert ((point[0] - 5) / 0.2) ** 2 + (point[2] / 0.3) ** 2 == pytest.approx(1)
    assert math.isinf(seen.far[2])


def test_a_shadow_is_as_long_as_its_rock_is_high() -> None:
    rock = np.array([[4.0, 0.0, 0.0, 0.1, 0.1, 0.5, 0.0]])
    world = World.of(flat_ground(elevation=30.0, rocks=rock))
    x = np.linspace(2.0, 3.85, 2000)
    ways = np.tile([[0.0, 0.0, -1.0]], (len(x), 1))
    lit = [bool(seen_by(world, np.array([v, 0.0, 3.0]), ways[:1], world.sun[None], False).lit[0]) for v in x]
    # A ray of elevation e touches the ellipse x^2/a^2 + z^2/c^2 = 1 where it meets z = 0 at sqrt(a^2 + c^2 / tan^2 e).
    assert x[np.argmax(~np.array(lit))] == pytest.approx(4 - math.hypot(0.1, 0.5 / math.tan(math.pi / 6)), abs=0.01)


def test_light_follows_lommel_and_seeliger_and_noise_its_electrons() -> None:
    """Level ground of no mottling: numbers go as mu0 / (mu0 + mu), with cos^4 of the field."""
    plain = render(flat_ground(), RIG, POSE, perturbed=False, noise=False, samples=2)
    noisy = render(flat_ground(), RIG, POSE, perturbed=False, samples=2)
    rays = LENS.rays(np.stack(np.meshgrid(np.arange(120.0), np.arange(90.0)), -1))
    length = np.linalg.norm(rays, axis=-1)
    mu = -(rays @ POSE.rotation.T)[..., 2] / length
    mu0 = math.sin(math.radians(35))
    expected = mu0 / (mu0 + mu) / length**4
    inside = np.s_[45:85, 10:110]
    ratio = (plain.left[inside] - 8.0) / expected[inside]
    assert ratio.std() / ratio.mean() < 0.005
    error = noisy.left[inside].astype(float) - plain.left[inside]
    electrons = (plain.left[inside] - 8.0) * 25000 / 1023
    stated = np.sqrt(electrons + 15**2 + (25000 / 1023) ** 2 / 6) * 1023 / 25000
    assert (error / stated).std() == pytest.approx(1, abs=0.05)


def test_the_rig_of_the_pictures_is_a_draw() -> None:
    drawn = [render(flat_ground(), RIG, POSE, seed=seed, samples=1).rig.left.cx_px - LENS.cx_px for seed in range(3)]
    assert len(set(drawn)) == 3
    assert max(map(abs, drawn)) < 2.5
    with pytest.raises(ParameterError, match="below the ground"):
        render(flat_ground(), RIG, Pose.looking([1.0, 0.0, -0.5]))


def test_the_command_writes_marked_pictures_and_their_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from lunarsci.images.rig_files import rig_text

    (tmp_path / "rig.toml").write_text(rig_text(RIG))
    asked = [
        "--rig",
        str(tmp_path / "rig.toml"),
        "--spacing",
        "0.05",
        "--rays",
        "1",
        "--rock-density",
        "0.2",
        "--no-time",
    ]
    assert main(["images", "render", *asked, "--json", "-o", str(tmp_path / "out")]) == 0
    result = json.loads(capsys.readouterr().out)["result"]
    assert rendered(result).text.startswith(f"Synthetic pictures of {result['rocks']} rock")
    assert result["synthetic"] is True
    assert 0.3 < result["pixels"]["seen_by_both"] < 1
    assert b"SYNTHETIC" in (tmp_path / "out/left.png").read_bytes()[:300]
    with np.load(tmp_path / "out/truth.npz") as truth:
        points, seen = truth["points_m"], truth["seen"]
        assert points.shape == (90, 120, 3)
        # To float32 and 15 micrometres: a thousandth of a pixel and less.
        rig = read_rig(InputFile("rig.toml", str(truth["rig"]).encode()))
        pose = Pose(rotation=truth["left_rotation"], center_m=truth["left_center_m"])
        v, u = np.nonzero(seen)
        np.testing.assert_allclose(rig.left.project(pose.to_camera(points[seen])), np.stack([u, v], -1), atol=2e-3)
        assert truth["synthetic"]
    assert read_rig(str(tmp_path / "out/rig.toml")).name == "small"
    assert read_pose(str(tmp_path / "out/pose.toml")).angles_deg()[1] == pytest.approx(25)
    assert main(["images", "render", "--sun-elevation", "-3"]) == 2


def test_stations_on_level_ground_see_one_ground(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from lunarsci.images.jobs.render import render
    from lunarsci.images.rig_files import rig_text

    (tmp_path / "rig.toml").write_text(rig_text(RIG))
    given = {"rig": str(tmp_path / "rig.toml"), "samples": 1, "spacing": 0.05}
    here, there = (render(x=x, **given).landscape for x in (0.0, 0.5))
    assert (here.x0_m, here.y0_m) == (there.x0_m, there.y0_m)
    np.testing.assert_array_equal(here.height_m, there.height_m)
    np.testing.assert_array_equal(here.rocks, there.rocks)
    assert main(["images", "render", "--rig", given["rig"], "--x", "13"]) == 1
    assert "beside the level ground, 24 m wide about 0, 0" in capsys.readouterr().err


def test_a_track_lowers_the_ground_below_it_by_the_deepest_wheel(tmp_path: Path) -> None:
    table = tmp_path / "truth.csv"
    table.write_text(
        "# made up\nx_m,y_m,sinkage_m\n" + "".join(f"{x / 20},0.5,{0.01 + 0.01 * (x > 20)}\n" for x in range(60))
    )
    places, depths = read_track(str(table))
    before = flat_ground()
    after = with_track(before, places, depths, 0.2)
    lower = before.ground(*np.array([[0.4, 0.5], [1.0, 0.5], [2.0, 0.5], [1.0, 0.7]]).T)
    np.testing.assert_allclose(
        lower - after.ground(*np.array([[0.4, 0.5], [1.0, 0.5], [2.0, 0.5], [1.0, 0.7]]).T),
        [0.01, 0.02, 0.02, 0],
        atol=1e-9,
    )
    with pytest.raises(ParameterError, match="no place of the track is on the ground"):
        with_track(before, places + 1e3, depths, 0.2)
    table.write_text("x_m,y_m\n0,0\n")
    with pytest.raises(DataError, match="rut_m or sinkage_m"):
        read_track(str(table))


@pytest.mark.parametrize("phase_deg", [3.0, 60.0])
def test_ground_scatters_as_the_formulas_say(phase_deg: float) -> None:
    """Hapke (1981) with the phase function and surge of `_scattered`, written out; without, Lommel and Seeliger."""
    mu0, mu, w, g = math.cos(0.6), math.cos(0.3), 0.33 * 1.2, math.radians(phase_deg)
    h0, h = ((1 + 2 * x) / (1 + 2 * x * math.sqrt(1 - w)) for x in (mu0, mu))
    law = 0.91 * (1.09 + 0.6 * math.cos(g)) ** -1.5
    surge = 1.5 * 0.06 / (0.06 + math.tan(g / 2))
    whole = w / 4 * mu0 / (mu0 + mu) * (law * (1 + surge) + h0 * h - 1)
    assert _scattered(mu0, mu, math.cos(g), 1.2, True) == pytest.approx(whole, rel=1e-12)
    assert _scattered(mu0, mu, math.cos(g), 1.2, False) == pytest.approx(w / 2 * mu0 / (mu0 + mu), rel=1e-12)


def test_light_is_scattered_by_the_angle_between_the_sun_and_the_camera() -> None:
    """Level ground without mottling, and the light of what lies about it; the Sun stands aside of the ray."""
    world = World.of(flat_ground())
    for way in np.array([[1.0, 0.5, -1.0], [-1.0, 0.5, -1.0], [0.2, -1.0, -0.7]]):
        way /= np.linalg.norm(way)
        seen = seen_by(world, np.array([5.0, 0.0, 1.5]), way[None], world.sun[None], True)
        wanted = 0.0015 + _scattered(world.sun[2], -way[2], -way @ world.sun, 1.0, True)
        assert seen.light[0] == pytest.approx(wanted, rel=1e-9)
