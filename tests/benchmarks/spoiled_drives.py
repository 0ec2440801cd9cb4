"""Telemetry whose sensors, clock or rows fail in parts: resets, wraps, hangs, halts, gaps.

What `faulty_drives.py --spoiled` sends of its healthy drives, in ways and by magnitudes that are drawn anew for each.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd

from lunarsci.twin.rover import Rover

Random = np.random.Generator
Spoil = Callable[[pd.DataFrame, Rover, Random], pd.DataFrame]
FORMS = {name: f"{name.split('_')[0]}_{{}}_{name.partition('_')[2]}" for name in
         ("angle_deg", "rate_deg_s", "speed_m_s", "steered_deg", "steering_deg")}  # fmt: skip


def columns(rover: Rover, *names: str) -> list[str]:
    return [FORMS[name].format(wheel) for wheel in rover.wheels for name in names]


def piece(table: pd.DataFrame, random: Random, least: int = 5, most: int = 40) -> slice:
    """Some rows after another."""
    length = int(random.integers(least, min(most, len(table) // 2)))
    first = int(random.integers(2, len(table) - length - 2))
    return slice(first, first + length - 1)


def some(rover: Rover, random: Random) -> list[str]:
    return list(random.choice(rover.wheels, size=int(random.integers(1, 4)), replace=False))


def wraps(table: pd.DataFrame, rover: Rover, random: Random) -> pd.DataFrame:
    """Encoders count within one turn, from an angle of their own; some rovers send nothing else."""
    for name in columns(rover, "angle_deg"):
        table[name] = (table[name] + random.uniform(0.0, 360.0)) % 360.0 - random.choice([0.0, 180.0])
    return table.drop(columns=columns(rover, *[["rate_deg_s"], ["rate_deg_s", "speed_m_s"], []][random.integers(3)]))


def resets(table: pd.DataFrame, rover: Rover, random: Random) -> pd.DataFrame:
    """Encoders begin at 0 again."""
    for wheel in some(rover, random):
        row, name = int(random.integers(3, len(table) - 3)), FORMS["angle_deg"].format(wheel)
        table.loc[row:, name] -= table.loc[row, name]
    return table.drop(columns=columns(rover, *[["rate_deg_s"], ["speed_m_s"], []][random.integers(3)]))


def hangs(table: pd.DataFrame, rover: Rover, random: Random) -> pd.DataFrame:
    """Encoders repeat themselves for a while, then count on, or know how far they came."""
    for wheel in some(rover, random):
        rows, name = piece(table, random), FORMS["angle_deg"].format(wheel)
        missed = table.loc[rows.stop, name] - table.loc[rows.start, name]
        table.loc[rows, name] = table.loc[rows.start, name]
        if random.random() < 0.5:
            table.loc[rows.stop + 1 :, name] -= missed
    return table.drop(columns=columns(rover, *[["rate_deg_s"], ["speed_m_s"], []][random.integers(3)]))


def rates(table: pd.DataFrame, rover: Rover, random: Random) -> pd.DataFrame:
    """Rates that are dead, stay the same, or are wild, for a while."""
    for wheel in some(rover, random):
        rows, name = piece(table, random), FORMS["rate_deg_s"].format(wheel)
        kind = random.integers(3)
        usual = float(table[name].abs().median())
        table.loc[rows, name] = (
            0.0 if kind == 0 else table.loc[rows.start, name] if kind == 1
            else random.normal(0.0, 3.0 * usual, rows.stop - rows.start + 1)
        )  # fmt: skip
    return table


def blanks(table: pd.DataFrame, rover: Rover, random: Random) -> pd.DataFrame:
    """Cells of wheels, steering and headings are blank for a while, others here and there."""
    for wheel in some(rover, random):
        table.loc[piece(table, random), FORMS[str(random.choice(list(FORMS)))].format(wheel)] = np.nan
    table.loc[piece(table, random), "yaw_deg"] = np.nan
    for name in random.choice(columns(rover, *FORMS), size=6, replace=False):
        table.loc[random.random(len(table)) < 0.03, name] = np.nan
    return table


def coarse(table: pd.DataFrame, rover: Rover, random: Random) -> pd.DataFrame:
    """Few digits: encoders of 0.2 to 3 deg, headings and steering of 0.1 to 0.5, rates of 0.05 to 0.5 deg/s."""
    for names, low, high in (
        (columns(rover, "angle_deg"), 0.2, 3.0), (["yaw_deg"], 0.1, 0.5), (columns(rover, "rate_deg_s"), 0.05, 0.5),
        (columns(rover, "steered_deg"), 0.1, 0.5),
    ):  # fmt: skip
        digit = random.uniform(low, high)
        table[names] = digit * np.rint(table[names] / digit)
    return table


def held(table: pd.DataFrame, rover: Rover, random: Random) -> pd.DataFrame:
    """Headings and positions come more seldom than rows, and are sent again in between."""
    kept = np.arange(len(table)) // int(random.integers(2, 8))
    table["yaw_deg"] = table.groupby(kept)["yaw_deg"].transform("first")
    if random.random() < 0.7:
        places = ["x_m", "y_m", "xx_m2", "xy_m2", "yy_m2"]
        table[places] = table[places].ffill(limit=int(random.integers(1, 10)))
    return table


def gaps(table: pd.DataFrame, rover: Rover, random: Random) -> pd.DataFrame:
    """Rows are lost, one by one and in pieces."""
    lost = random.random(len(table)) < 0.05
    for _ in range(int(random.integers(1, 4))):
        lost[piece(table, random, 3, 30)] = True
    lost[[0, -1]] = False
    return table[~lost | table.x_m.notna() & (random.random(len(table)) < 0.5)].reset_index(drop=True)


def clocks(table: pd.DataFrame, rover: Rover, random: Random) -> pd.DataFrame:
    """Another clock: seconds since 1970, since some start, or a few seconds off."""
    offset = [1.8e9 + random.uniform(0.0, 1e6), random.uniform(-30.0, 30.0), random.uniform(0.0, 5e4)][
        random.integers(3)
    ]
    return table.assign(time_s=table.time_s + offset)


def steering(table: pd.DataFrame, rover: Rover, random: Random) -> pd.DataFrame:
    """Sensors of steering with spikes, or that hang."""
    for wheel in some(rover, random):
        name = FORMS["steered_deg"].format(wheel)
        if random.random() < 0.5:
            rows = random.random(len(table)) < 0.05
            table.loc[rows, name] += random.normal(0.0, 25.0, int(rows.sum()))
        else:
            table.loc[piece(table, random, 10, 80), name] = float(table[name].iloc[0])
    return table


def tilted(table: pd.DataFrame, rover: Rover, random: Random) -> pd.DataFrame:
    """The sensor of roll and pitch is turned on its rover by up to 2 degrees."""
    for name in ("roll_deg", "pitch_deg"):
        table[name] += random.uniform(-2.0, 2.0)
    return table


def fewer(table: pd.DataFrame, rover: Rover, random: Random) -> pd.DataFrame:
    """Some columns are not sent at all."""
    ways = (["angle_deg"], ["rate_deg_s"], ["angle_deg", "speed_m_s"], ["rate_deg_s", "speed_m_s"], ["steered_deg"],
            ["steering_deg"])  # fmt: skip
    return table.drop(columns=columns(rover, *ways[random.integers(len(ways))]))


def halts(table: pd.DataFrame, rover: Rover, random: Random) -> pd.DataFrame:
    """The rover stands for a while, which its plan does not have; see `stood`."""
    row, seconds = int(random.integers(5, len(table) - 5)), int(random.integers(10, 200))
    begin, step = float(table.time_s[row]), float(table.time_s[1] - table.time_s[0])
    still = pd.concat([table.iloc[[row]]] * math.ceil(seconds / step), ignore_index=True).assign(x_m=np.nan, y_m=np.nan)
    still["time_s"] = begin + step * (1.0 + still.index)
    still[columns(rover, "speed_m_s", "rate_deg_s")] = 0.0
    noisy = ["yaw_deg", "roll_deg", "pitch_deg", *columns(rover, "angle_deg")]
    still[noisy] += random.normal(0.0, 0.1, (len(still), len(noisy)))
    after = table.iloc[row + 1 :].assign(time_s=lambda rest: rest.time_s + step * len(still))
    table.attrs = {"begin_s": begin, "longer_s": step * len(still)}
    whole = pd.concat([table.iloc[: row + 1], still, after], ignore_index=True)
    whole.attrs = table.attrs
    return whole


def stood(truth: Any, begin_s: float, longer_s: float) -> Any:
    """The true drive with a halt."""
    row = int(np.searchsorted(truth.time_s, begin_s))
    time_s = np.insert(truth.time_s, [row, row], begin_s)
    time_s[row + 1 :] += longer_s
    poses = np.insert(truth.poses, [row, row], truth.pose_at(np.array([begin_s])), axis=0)
    states = np.insert(truth.states, [row, row], truth.states[row], axis=0)
    return dataclasses.replace(truth, time_s=time_s, poses=poses, states=states)


SPOILS: dict[str, Spoil] = {one.__name__: one for one in (
    wraps, resets, hangs, rates, blanks, coarse, held, gaps, clocks, steering, tilted, fewer, halts
)}  # fmt: skip
