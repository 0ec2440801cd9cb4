"""The ground that wheels leave: by hand, and beside an independent simulation of it."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import brentq

from lunarsci.errors import ParameterError
from lunarsci.regolith.soil import Soil
from lunarsci.regolith.wheel import Wheel
from lunarsci.twin.lanes import GROUP, WHEEL, new_work
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.contact import (
    RISE_N_M4,
    SPACING_M,
    depth_at,
    press,
    press_ruts,
    read_ruts,
    rut_grid,
    still_deep,
    with_ruts,
)
from lunarsci.twin.simulation.ensemble import STATE_COLUMNS, Prediction, predict

STRAIGHT = Plan(name="straight", speed_m_s=0.05, legs=(Leg(3.0),), sweep=())


def sinkage(prediction: Prediction) -> np.ndarray:
    """Mean sinkage of front, middle and rear wheels, in the second half of the way. [m]"""
    half = prediction.states[0, len(prediction.time_s) // 2 :, :, 2]
    return np.asarray(half.reshape(len(half), 3, 2).mean(axis=(0, 2)))


def test_what_springs_back_is_wongs_line() -> None:
    """p_u / (k_0 + A_u z_u) with k_0 = p_u / z_u."""
    stiffness, exponent, pressed = 1.4e6, 1.0, 0.008
    load = stiffness * pressed**exponent
    risen = load / (load / pressed + RISE_N_M4 * pressed)
    assert still_deep(pressed, stiffness, exponent) == pytest.approx(pressed - risen, rel=1e-12)
    assert still_deep(0.0, stiffness, exponent) == 0.0
    assert 0.0 <= still_deep(1e-17, stiffness, 2.0) <= 1e-17


def test_a_strip_counts_as_far_as_a_wheel_is_on_it_and_stays_deepest() -> None:
    grid = np.zeros((1, 40, 60, 2))
    nodes = grid[0]
    press(grid, 0, 30.0, 20.0, 0.0, 1.0, 4.0, 0.01, 0.008)
    pressed = nodes[..., 0]
    assert pressed[20, 29:32] == pytest.approx(0.01) and nodes[20, 30, 1] == pytest.approx(0.008)
    # Half its width aside a wheel has half of it in common, a whole width aside nothing.
    assert pressed[[18, 22], 30] == pytest.approx(0.005) and pressed[[16, 24], 30] == pytest.approx(0.0)
    assert pressed[20, 32] == 0.0 and depth_at(grid, 0, 30.0, 22.5) == pytest.approx((0.00375, 0.003))
    press(grid, 0, 30.0, 20.0, 0.0, 1.0, 4.0, 0.004, 0.003)
    assert pressed[20, 30] == pytest.approx(0.01)
    assert depth_at(grid, 0, -1.0, 5.0) == (0.0, 0.0)


def test_a_grid_that_would_be_too_large_is_refused() -> None:
    far = np.array([[0.0, 0.0], [3e3, 3e3]])
    with pytest.raises(ParameterError, match="too long for ruts"):
        rut_grid(np.zeros(3), far, 2.0)
    near = with_ruts(new_work(6), rut_grid(np.zeros(3), far / 1e3, 2.0))
    assert near.ruts.shape[0] == GROUP and not near.ruts.any()


@pytest.mark.parametrize("begun", [0.0, 0.9, 4.0])
@pytest.mark.parametrize("heading", np.arange(0.0, 6.3, 0.7))
def test_a_wheel_does_not_meet_the_rut_that_it_leaves(heading: float, begun: float) -> None:
    """What a wheel at the origin presses lies behind it; one that follows meets it whole, half its width aside half.

    The same wherever the drive began and headed to, along which the nodes lie. Across the corners of their cells a
    wheel sees nodes sqrt 2 spacings off, where its own rut begins: e^2 (sqrt 2 (1 - e) - 1) of it, 0.0053 at most.
    """
    start = np.array([0.31, -0.23, begun])
    work = with_ruts(new_work(1), rut_grid(start, np.zeros((1, 2)), 2.0))
    rows = work.wheels.reshape(1, -1, GROUP)
    axle, center, rim, rut, sinkage, soil = (
        WHEEL.first[name] for name in ("axle", "center", "rim", "rut", "sinkage", "soil")
    )
    rows[0, [axle, axle + 1, rim, sinkage, soil, soil + 1]] = np.array(
        [-np.sin(heading), np.cos(heading), 0.05, 0.01, 1.4e6, 1.0]
    )[:, None]
    press_ruts(work, 0.15)
    read_ruts(work, 0)
    assert (rows[0, [rut, rut + 1]] <= 0.0053 * 0.01).all()
    behind = 3.0 * SPACING_M
    rows[0, [center, center + 1]] = np.array([-behind * np.cos(heading), -behind * np.sin(heading)])[:, None]
    read_ruts(work, 0)
    # Between nodes the top of the strip's cross section, a triangle of 4.2 spacings a side, is cut.
    assert rows[0, rut, 0] == pytest.approx(0.01, rel=0.2)
    for side in (-1.0, 1.0):
        aside = side * 0.075 * np.array([-np.sin(heading), np.cos(heading)])
        rows[0, [center, center + 1]] = (aside - behind * np.array([np.cos(heading), np.sin(heading)]))[:, None]
        read_ruts(work, 0)
        assert rows[0, rut, 0] == pytest.approx(0.005, rel=0.1)


def test_ground_with_a_rut_lies_lower_along_its_normal() -> None:
    """6 mm are left of 10 mm: along the vertical of a slope of 0.3 by 0.6 that is sqrt(1 + 0.09 + 0.36) as much."""
    work = with_ruts(new_work(1), rut_grid(np.zeros(3), np.zeros((1, 2)), 2.0))
    work.ruts[..., 0], work.ruts[..., 1] = 0.010, 0.006
    rows = work.wheels.reshape(1, -1, GROUP)
    ground, rut = WHEEL.first["ground"], WHEEL.first["rut"]
    rows[0, [ground, ground + 1, ground + 2]] = np.array([1.5, 0.3, -0.6])[:, None]
    read_ruts(work, 0)
    assert rows[0, ground] == pytest.approx(1.5 - 0.006 * np.sqrt(1.45))
    assert rows[0, rut] == pytest.approx(0.010) and rows[0, rut + 1] == pytest.approx(0.006)


def test_a_drive_whose_drive_before_did_not_end_does_not_end(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    lost = dataclasses.replace(STRAIGHT, legs=(Leg(20.0),))
    result = predict(yutu2, slope(), STRAIGHT, ruts=True, before=lost)
    assert result.outcome_text(0).startswith("left the terrain")


def test_wheels_that_follow_go_deeper_and_a_way_back_deeper_still(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    """Each wheel carries about the same; the first one finds undisturbed ground and sinks as without ruts."""
    fresh = sinkage(predict(yutu2, slope(), STRAIGHT, ruts=False))
    ruts = sinkage(predict(yutu2, slope(), STRAIGHT, ruts=True))
    back = dataclasses.replace(STRAIGHT, x_m=3.0, legs=(Leg(3.0, 0.0, 180.0),))
    alone, again = (sinkage(predict(yutu2, slope(), back, ruts=True, before=plan)) for plan in (None, STRAIGHT))
    assert ruts[0] == pytest.approx(fresh[0], rel=0.02)
    assert ruts[1] > 1.08 * fresh[1] and ruts[2] > ruts[1]
    # Backwards the rear wheels lead: on undisturbed ground they sink least, in the ruts of three they do not.
    assert alone[2] < alone[0] and again[2] > 1.2 * alone[2]
    with pytest.raises(ParameterError, match="leaves nothing but ruts"):
        predict(yutu2, slope(), back, before=STRAIGHT)


def carried(wheel: Wheel, z: float, slip: float, rut: tuple[float, float]) -> float:
    """F_N of a wheel z below the bottom of a rut: triangles of stress on 1443 kPa/m, 520 Pa, 42 deg, 17.8 mm. [N]

    A rut that was pressed to the first depth has risen to the second; in between stress is in proportion. [m]
    """
    r, b, h, r_s = wheel.radius_m, wheel.width_m, wheel.grouser_height_m, wheel.shearing_radius_m
    theta_1, theta_1e = np.arccos(1 - z / r), np.arccos((r - z) / (r + h))
    middle = theta_1 / 2
    depth, (pressed, left) = r * (np.cos(middle) - np.cos(theta_1)), rut
    again = 1443e3 * pressed * depth / (pressed - left)
    peak = again if left + depth < pressed else 1443e3 * (left + depth)
    j = r_s * ((theta_1e - middle) - (1 - slip) * (np.sin(theta_1e) - np.sin(middle)))
    shear = (520 + peak * np.tan(np.radians(42))) * np.copysign(1 - np.exp(-abs(j) / 17.8e-3), j)
    theta = np.linspace(0.0, theta_1, 2001)
    along = np.interp(theta, [0.0, middle, theta_1], [0.0, 1.0, 0.0])
    of = along * (r * peak * np.cos(theta) + r_s * shear * np.sin(theta))
    return float(b * 0.5 * (of[1:] + of[:-1]).sum() * theta[1])


def test_wheels_in_ruts_are_as_deep_as_carries_their_load(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    """On 1443 kPa/m the first wheel of 35 N is 8.5 mm deep. What it pressed has risen along Wong's line, and the next
    one sinks from there until it carries its own load, 10 and 12 mm below the undisturbed ground.

    Ruts that are kept on a grid are some per cents less deep than those of a line of wheels.
    """
    drive = predict(yutu2, slope(), STRAIGHT, ruts=True)
    half = drive.states[0, len(drive.time_s) // 2 :]
    columns = [STATE_COLUMNS.index(name) for name in ("normal_force_n", "slip_ratio")]
    loads, slips = half[..., columns].reshape(len(half), 3, 2, 2).mean(axis=(0, 2)).T
    pressed, expected = 1e-6, []
    for load, slip in zip(loads, slips, strict=True):
        left = pressed - 1443e3 * pressed / (1443e3 + 503e6 * pressed)

        def surplus(z: float, wanted: float, slip: float, rut: tuple[float, float]) -> float:
            return carried(yutu2.wheel, z, slip, rut) - wanted

        pressed = left + brentq(surplus, 1e-5, 0.05, args=(load, slip, (pressed, left)))
        expected.append(pressed)
    assert 2.0 * loads.sum() == pytest.approx(135.0 * 1.622, rel=1e-3)
    assert sinkage(drive) == pytest.approx(expected, rel=0.05)
    assert sinkage(drive)[0] == pytest.approx(expected[0], rel=1e-3)


def test_a_rut_beside_the_way_is_not_met(yutu2: Rover, slope, longji_soil: Soil) -> None:  # type: ignore[no-untyped-def]
    aside = dataclasses.replace(STRAIGHT, y_m=0.45)
    one = predict(yutu2, slope(), STRAIGHT, ruts=True)
    two = predict(yutu2, slope(), STRAIGHT, ruts=True, before=aside)
    assert two.paths == pytest.approx(one.paths, abs=1e-12)


def test_members_meet_ruts_as_each_of_them_is_asked(yutu2: Rover, slope) -> None:  # type: ignore[no-untyped-def]
    """Those with ruts and those without, side by side, drive as where all are alike."""
    soils = {"friction_angle_deg": np.linspace(25.0, 45.0, 7)}
    ruts = np.arange(7) % 3 == 0
    alike = {met: predict(yutu2, slope(), STRAIGHT, samples=soils, ruts=met) for met in (False, True)}
    mixed = predict(yutu2, slope(), STRAIGHT, samples=soils, ruts=ruts)
    assert np.array_equal(mixed.ruts, ruts)
    for member, met in enumerate(ruts):
        assert np.array_equal(mixed.states[member], alike[bool(met)].states[member])
