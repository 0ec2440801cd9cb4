"""What SYNTHETIC pairs of a drawn rig say against other rigs, masts and poses: the true one is not doubted."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from lunarsci.images.camera import Camera, Pose, StereoRig, covariance_of, rotation_of
from lunarsci.images.pictures import Picture
from lunarsci.images.reliability import CommonFeatures, Reliability, reliability, ties_of
from lunarsci.images.render import Landscape, landscape_on, render
from lunarsci.io.inputs import InputFile

POSE = Pose.looking([0.0, 0.0, 1.5], 2.0, 28.0, 1.0)
SIGMAS = {"rotation_x_rad": 1e-4, "rotation_z_rad": 1e-4, "translation_x_m": 1e-4, "left_k1": 1e-3, "right_k1": 1e-3}


def the_rig() -> StereoRig:
    """Of 360 px, with lenses that bend, and cameras that do not look quite alike."""
    lens = {"width_px": 360, "height_px": 360, "fx_px": 400.0, "fy_px": 400.0, "cx_px": 182.0, "cy_px": 178.0}
    return StereoRig(
        name="SYNTHETIC",
        left=Camera(name="left", **lens, k1=-0.15),  # type: ignore[arg-type]
        right=Camera(name="right", **(lens | {"cx_px": 176.0}), k1=-0.18),  # type: ignore[arg-type]
        rotation=rotation_of([0.004, -0.006, 0.003]),
        translation_m=np.array([-0.27, 0.001, -0.002]),
        covariance=covariance_of(SIGMAS),
        mast_height_m=1.5,
    )


def ground(seed: int) -> Landscape:
    return landscape_on(
        (0.2, -2.9, 0.2, np.zeros((30, 30))), name="g", seed=seed, spacing_m=0.01, roughness=0.5, rocks_per_m2=3.0,
        sun_azimuth_deg=110, sun_elevation_deg=20,
    )  # fmt: skip


def seen(seed: int, step_m: float = 0.0) -> CommonFeatures:
    """CommonFeatures of a pair of a rig that is drawn; the rover moves on between left and right picture."""
    drawn = the_rig().drawn(np.random.default_rng(seed))
    pair = render(ground(seed), drawn, POSE, seed=seed)
    right = pair.right
    if step_m:
        moved = Pose(rotation=POSE.rotation, center_m=POSE.center_m + step_m * np.array([1.0, 0.0, 0.0]))
        right = render(ground(seed), drawn, moved, seed=seed).right
    left, right = pair.left.astype(float), right.astype(float)
    return ties_of(
        *(Picture(source=InputFile(name, b""), values=v, bits=10) for name, v in (("l", left), ("r", right)))
    )


@pytest.fixture(scope="module")
def ties() -> CommonFeatures:
    return seen(3)


def said(ties: CommonFeatures, rig: StereoRig, pose: Pose | None = POSE) -> Reliability:
    found = reliability(rig, ties, pose, 0.3)
    assert found is not None
    return found


def test_the_rig_that_took_the_pictures_is_not_doubted(ties: CommonFeatures) -> None:
    for one in (ties, seen(4)):
        for pose in (POSE, None):
            found = said(one, the_rig(), pose)
            assert not found.doubts()
            assert (found.freedom, found.ties > 200) == (9 if pose else 7, True)


def longer(rig: StereoRig) -> StereoRig:
    return replace(rig, translation_m=2 * rig.translation_m)


def wider(rig: StereoRig) -> StereoRig:
    focal = {"fx_px": 480.0, "fy_px": 480.0}
    return replace(rig, left=replace(rig.left, **focal), right=replace(rig.right, **focal))


def rolled(rig: StereoRig) -> StereoRig:
    return replace(rig, rotation=rotation_of([0.0, 0.0, np.radians(0.5)]) @ rig.rotation)


def lower(rig: StereoRig) -> StereoRig:
    return replace(rig, right=replace(rig.right, cy_px=rig.right.cy_px - 2.0))


@pytest.mark.parametrize(
    ("change", "cause", "size"),
    [
        (longer, "the baseline is {} times as long", 0.5),
        (wider, "focal lengths are {} times", 1 / 1.2),
        (rolled, "is turned by {} deg about its axis", -0.5),
        (lower, "the right picture is {} px too low", 2.0),
    ],
)
def test_a_wrong_rig_is_doubted_and_the_right_size_is_among_the_causes(
    ties: CommonFeatures, change: Callable[[StereoRig], StereoRig], cause: str, size: float
) -> None:
    head, *causes = said(ties, change(the_rig())).doubts()
    assert "contradict rig, mast or pose" in head
    before, after = cause.split("{}")
    (mine,) = (one for one in causes if before in one and after in one)
    assert float(mine.split(before)[1].split(after)[0]) == pytest.approx(size, rel=0.12)


def test_a_mast_or_a_pose_that_is_wrong_is_named(ties: CommonFeatures) -> None:
    causes = said(ties, replace(the_rig(), mast_height_m=3.5)).causes
    assert any("m over the ground, not 3.5 m" in one for one in causes)
    assert said(ties, the_rig(), Pose.looking([0.0, 0.0, 1.5], 2.0, 90.0, 1.0)).doubts()
    tilted = Pose.looking([0.0, 0.0, 1.5], 2.0, -28.0, 1.0)
    assert any("down_deg" in one for one in said(ties, the_rig(), tilted).causes)


def test_a_rover_that_moved_by_a_centimetre_is_noticed() -> None:
    """Which makes all distances wrong by 4 % once it is along the baseline."""
    found = said(seen(3, step_m=0.01), the_rig())
    assert any("the rover moved between the pictures" in one for one in found.doubts())


def test_too_few_ties_say_nothing(ties: CommonFeatures) -> None:
    assert reliability(the_rig(), CommonFeatures(ties.left[:20], ties.right[:20]), POSE, 0.3) is None
