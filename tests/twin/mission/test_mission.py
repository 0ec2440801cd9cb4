"""Missions: legs between localisations, on soils and ground where the outcome is known."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from lunarsci.errors import DataError, ParameterError
from lunarsci.twin.judgement.keeping import keeps_limits
from lunarsci.twin.mission.mission import (
    CommWindow,
    DrivenMission,
    Mission,
    MissionStart,
    MissionTarget,
    drive_mission,
    first_leg,
    read_mission,
)
from lunarsci.twin.plans.path import make_schedule
from lunarsci.twin.plans.plan import Fixes, Leg, Plan
from lunarsci.twin.rover import Motors, PowerSupply, Rover
from lunarsci.twin.simulation.ensemble import PowerState, Prediction

MEMBERS = 400
SPEED_M_S = 0.05
FAR = MissionTarget(name="far", x_m=20.0, y_m=0.0)
MISSION = Mission(name="one way", start=MissionStart(x_m=0.0, y_m=0.0), targets=(FAR,), fixes=Fixes(0.0, 0.0))


def straight(pose: tuple[float, float, float], place: tuple[float, float]) -> Plan:
    """A spot turn and a line."""
    way = np.subtract(place, pose[:2])
    turn = (math.degrees(math.atan2(way[1], way[0])) - pose[2] + 180.0) % 360.0 - 180.0
    legs = (Leg(float(np.hypot(*way))),)
    return Plan(name="way", legs=(Leg(turn_deg=turn), *legs) if abs(turn) > 0.01 else legs, speed_m_s=SPEED_M_S,
                x_m=pose[0], y_m=pose[1], heading_deg=pose[2])  # fmt: skip


@dataclasses.dataclass
class Slides:
    """SYNTHETIC drives: every member falls short by its own share of the way, whatever the ground."""

    rover: Rover
    short: np.ndarray

    def drive(self, plan: Plan) -> Prediction:
        schedule = make_schedule(plan, self.rover)
        times = np.linspace(0.0, schedule.duration_s, 5)
        planned = schedule.pose_at(times)
        count = len(self.short)
        paths = np.zeros((count, len(times), 6))
        start = planned[0, :2]
        paths[..., :2] = start + (1.0 - self.short)[:, None, None] * (planned[:, :2] - start)
        paths[..., 5] = np.degrees(planned[:, 2])
        rover = dataclasses.replace(self.rover, body=None)
        return Prediction(
            ruts=np.zeros(count, dtype=bool),
            rover=rover, terrain=None, plan=plan, seed=0, time_step_s=0.1, parameters={}, time_s=times,  # type: ignore[arg-type]
            distance_m=schedule.distance_at(times), planned=planned, paths=paths,
            states=np.zeros((count, len(times), 6, 10)), halted=np.zeros(len(times), dtype=bool),
            recorded=np.full(count, len(times)), outcome=np.zeros(count, dtype=np.int64),
        )  # fmt: skip


def driven(rover: Rover, mission: Mission = MISSION, short: float | np.ndarray = 0.0, seed: int = 0) -> DrivenMission:
    world = Slides(rover, np.broadcast_to(np.asarray(short, dtype=float), (MEMBERS,)))
    return drive_mission(mission, rover, straight, world.drive, lambda p: p.finished, seed=seed)


def test_legs_are_as_long_as_asked_and_add_up(yutu2: Rover) -> None:
    found = driven(yutu2)
    assert [leg.plan.length_m for leg in found.legs] == pytest.approx([5.0] * 4)
    assert found.reached == 1 and found.safe.all()
    assert found.end_s == pytest.approx(sum(leg.drive_s for leg in found.legs))
    assert found.end_s == pytest.approx(20.0 / SPEED_M_S, rel=0.05)


def test_a_short_rest_is_driven_with_the_leg_before() -> None:
    plan = straight((0.0, 0.0, 0.0), (6.0, 0.0))
    assert first_leg(plan, 5.0) == (plan, True)
    begin, last = first_leg(straight((0.0, 0.0, 0.0), (7.0, 0.0)), 5.0)
    assert not last and begin.length_m == pytest.approx(5.0)


def test_slip_costs_further_legs_and_localisation_takes_its_loss_back(yutu2: Rover) -> None:
    """A rover that falls short by a fifth of every leg comes 4 m far with each of 5 m: 20 m take more legs than 4."""
    found = driven(yutu2, short=0.2)
    places = np.array([leg.fixed[0] for leg in found.legs])
    assert places[:3] == pytest.approx([4.0, 8.0, 12.0])
    assert len(found.legs) > 4
    assert found.reached == 1
    assert 20.0 - places[-1] <= FAR.tolerance_m


def test_the_spread_grows_with_the_leg_not_with_the_way(yutu2: Rover) -> None:
    """Shares of the way of 2 % are 10 cm after each leg of 5 m; without localisation they were 40 cm after 20 m."""
    random = np.random.default_rng(1)
    found = driven(yutu2, short=0.02 * random.standard_normal(MEMBERS))
    spreads = [math.sqrt(leg.covariance_m2[0, 0]) for leg in found.legs]
    assert spreads == pytest.approx([0.1] * len(spreads), rel=0.15)


def test_errors_of_localisation_are_in_the_next_ends(yutu2: Rover) -> None:
    """0.3 m in x and y, and 2 deg of heading over 5 m across the way: 17 cm more to the side."""
    mission = dataclasses.replace(MISSION, fixes=Fixes(0.3, 2.0))
    legs = driven(yutu2, mission).legs
    assert np.allclose(legs[0].covariance_m2, 0.0)
    along = np.sqrt(np.mean([leg.covariance_m2[0, 0] for leg in legs[1:3]]))
    across = np.sqrt(np.mean([leg.covariance_m2[1, 1] for leg in legs[1:3]]))
    assert along == pytest.approx(0.3, rel=0.12)
    assert across == pytest.approx(math.hypot(0.3, 5.0 * math.radians(2.0)), rel=0.12)


def test_a_member_that_broke_a_limit_once_has_failed(yutu2: Rover) -> None:
    """A tenth fails on each of four legs, always others: six tenths are left; always the same: nine tenths."""
    world = Slides(yutu2, np.zeros(MEMBERS))
    leg = iter(range(100))

    def others(prediction: Prediction) -> np.ndarray:
        return np.arange(MEMBERS) % 10 != next(leg)

    found = drive_mission(MISSION, yutu2, straight, world.drive, others)
    assert found.safe.mean() == pytest.approx(0.6)
    found = drive_mission(MISSION, yutu2, straight, world.drive, lambda p: np.arange(MEMBERS) % 10 != 3)
    assert found.safe.mean() == pytest.approx(0.9)


def test_the_last_target_that_fits_the_time(yutu2: Rover) -> None:
    targets = tuple(MissionTarget(name=f"x {x}", x_m=float(x), y_m=0.0) for x in (5, 10, 15, 20))
    mission = dataclasses.replace(MISSION, targets=targets, time_budget_s=350.0, localisation_s=10.0)
    found = driven(yutu2, mission)
    fates = [one.fate for one in found.targets]
    assert fates == ["reached", "reached", "reached", "no time"]
    assert found.end_s <= 350.0 < found.end_s + 5.0 / SPEED_M_S + 10.0
    assert not found.safe.any()
    assert "350 s are given" in found.targets[-1].why


def test_legs_wait_for_windows(yutu2: Rover) -> None:
    """Each window has room for one leg of 100 s and more, so that every leg waits for its own."""
    windows = tuple(CommWindow(begin_s=1000.0 * k, end_s=1000.0 * k + 150.0) for k in range(4))
    found = driven(yutu2, dataclasses.replace(MISSION, windows=windows))
    assert [leg.begin_s for leg in found.legs] == [0.0, 1000.0, 2000.0, 3000.0]
    assert found.waited_s == pytest.approx(3000.0 - 3 * found.legs[0].drive_s)
    found = driven(yutu2, dataclasses.replace(MISSION, windows=windows[:2]))
    assert found.targets[0].fate == "no window" and len(found.legs) == 2


def powered(rover: Rover, battery_wh: float, least: float = 0.0, **mission: float) -> DrivenMission:
    """SYNTHETIC drives that take 60 W of electronics and 1 W of each of six motors, and 40 W while the rover stands."""
    supply = PowerSupply(battery_wh=battery_wh, electronics_w=60.0, standby_w=40.0, least_charge=least)
    motors = Motors(stall_torque_nm=30.0, continuous_torque_nm=20.0, no_load_rate_rad_s=1.0, efficiency=0.5, idle_w=1.0)
    equipped = dataclasses.replace(rover, power=supply, motors=motors)
    world = Slides(equipped, np.zeros(MEMBERS))
    given = dataclasses.replace(MISSION, localisation_s=600.0, **mission)
    return drive_mission(given, equipped, straight, world.drive, keeps_limits, power=PowerState(charge=1.0))


def test_the_battery_goes_on_from_leg_to_leg(yutu2: Rover) -> None:
    """Four legs of 100 s at 66 W, between them 600 s at 40 W: what is left by hand. And a window to wait for."""
    found = powered(yutu2, 100.0)
    legs = [leg.drive_s for leg in found.legs]
    drawn = np.cumsum(66.0 * np.array(legs) + 600.0 * 40.0 * (np.arange(4) > 0)) / 3600.0
    assert [float(leg.charge[0]) for leg in found.legs] == pytest.approx(1.0 - drawn / 100.0, abs=1e-9)
    assert found.safe.all()
    windows = (CommWindow(begin_s=0.0, end_s=710.0), CommWindow(begin_s=2000.0, end_s=9000.0))
    later = powered(yutu2, 100.0, windows=windows)
    more = 40.0 * later.waited_s / 3600.0 / 100.0
    assert found.legs[-1].charge[0] - later.legs[-1].charge[0] == pytest.approx(more, abs=1e-9) and more > 0.1


def test_a_battery_that_gets_too_low_ends_the_mission(yutu2: Rover) -> None:
    """What is taken after the last leg: 4 x 100 s at 66 W, 3 x 600 s at 40 W: 27.3 Wh, with its localisation 34."""
    assert powered(yutu2, 35.0).safe.all()
    low = powered(yutu2, 30.0)
    assert low.targets[0].fate == "no drive" and len(low.legs) == 3
    assert "up to leg 4: the battery gets too low while the rover stands" in low.targets[0].why
    assert f"leg 3: battery_charge ({MEMBERS} of {MEMBERS} drives)" in powered(yutu2, 18.0).targets[0].why
    assert powered(yutu2, 50.0, least=0.3).safe.all() and not powered(yutu2, 50.0, least=0.34).safe.any()
    stays = dataclasses.replace(FAR, stay_s=1000.0)
    assert not powered(yutu2, 35.0, targets=(stays,)).safe.any() and powered(yutu2, 46.0, targets=(stays,)).safe.all()


def test_what_no_way_leads_to_is_said(yutu2: Rover) -> None:
    def blocked(pose: tuple[float, float, float], place: tuple[float, float]) -> Plan:
        raise ParameterError("a wall is in the way")

    world = Slides(yutu2, np.zeros(4))
    targets = (FAR, dataclasses.replace(FAR, name="farther", x_m=30.0))
    found = drive_mission(
        dataclasses.replace(MISSION, targets=targets), yutu2, blocked, world.drive, lambda p: p.finished
    )
    assert [(one.fate, one.why) for one in found.targets] == [
        ("no way", "a wall is in the way"),
        ("not tried", "the one before is not reached"),
    ]


def test_a_target_beyond_the_horizon_is_come_near_to(yutu2: Rover) -> None:
    world = Slides(yutu2, np.zeros(4))
    found = drive_mission(
        MISSION, yutu2, straight, world.drive, lambda p: p.finished, goal_of=lambda target: (12.0, 0.0)
    )
    assert found.targets[0].fate == "horizon"
    assert found.legs[-1].fixed[0] == pytest.approx(12.0, abs=0.5)
    assert not found.safe.any()


GOOD = """
name = "two rocks"
leg_m = 4
localisation_s = 300
time_budget_s = 7200
[start]
x_m = 1
y_m = 2.5
[fixes]
position_sigma_m = 0.1
heading_sigma_deg = 0.5
[[target]]
name = "rock"
x_m = 5
y_m = 1
stay_s = 600
[[keep_out]]
name = "pit"
x_m = 3
y_m = 3
radius_m = 0.5
[[window]]
begin_s = 0
end_s = 3000
"""


def test_a_mission_is_read(tmp_path: Path) -> None:
    file = tmp_path / "mission.toml"
    file.write_text(GOOD)
    mission = read_mission(str(file))
    assert mission.name == "two rocks" and mission.leg_m == 4.0
    assert mission.start == MissionStart(x_m=1.0, y_m=2.5)
    assert mission.targets == (MissionTarget(name="rock", x_m=5.0, y_m=1.0, stay_s=600.0),)
    assert mission.keep_outs[0].radius_m == 0.5
    assert mission.windows == (CommWindow(begin_s=0.0, end_s=3000.0),)
    assert mission.fixes == Fixes(0.1, 0.5)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[[target]]", "[target]", "double brackets"),
        ("[[target]]", '[[target]]\nname = "rock"\nx_m = 1\ny_m = 1\n[[target]]', "name each of them differently"),
        ("heading_sigma_deg = 0.5", "heading_sigma_deg = 0.5\nhalt_s = 9", "halt_s has no use"),
        ("x_m = 5", 'x_m = "5"', "give a number"),
        ("x_m = 5", "x_m = nan", "finite"),
        ("x_m = 5", "", "has no x_m"),
        ("stay_s = 600", "stay_s = -1", "0 or more"),
        ("stay_s = 600", "stays = 600", "not a key"),
        ("leg_m = 4", "leg_m = 0", "a number above 0"),
        ("leg_m = 4", "leg_m = true", "give a number"),
        ("end_s = 3000", "end_s = 0", "begin_s < end_s"),
        ("end_s = 3000", "end_s = 3000\n[[window]]\nbegin_s = 10\nend_s = 20", "before the one before it ends"),
        ("radius_m = 0.5", "radius_m = 0", "radius_m is 0; give a number above 0"),
        ("heading_sigma_deg = 0.5", "", "has no heading_sigma_deg"),
        ("position_sigma_m = 0.1", "position_sigma_m = -1", "give 0 or more"),
        ("time_budget_s = 7200", "time_budget_s = 0", "time_budget_s is 0; give a number above 0"),
        ("[start]", "[start", "not valid TOML"),
        ("[[keep_out]]", "[[keepout]]", "not a key of a mission"),
    ],
)  # fmt: skip
def test_every_hostile_file_gets_one_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    file = tmp_path / "mission.toml"
    file.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(DataError) as caught:
        read_mission(str(file))
    assert said in str(caught.value) and "mission.toml" in str(caught.value)
    assert "\n" not in str(caught.value)
