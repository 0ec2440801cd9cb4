"""Telemetry of any length: what a rover at rest sends is left out, and moves no state. All of it is synthetic."""

import io
import re
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from lunarsci.errors import DataError, LunarSciWarning
from lunarsci.io.inputs import InputFile, InputStream, open_input
from lunarsci.twin.ground.synthetic import synthetic_longji
from lunarsci.twin.plans.plan import Leg, Plan
from lunarsci.twin.rover import Rover
from lunarsci.twin.simulation.ensemble import predict
from lunarsci.twin.telemetry import nodes, reading
from lunarsci.twin.telemetry.reading import Findings, Telemetry, read_telemetry
from lunarsci.twin.telemetry.simulated import SensorErrors, simulate_telemetry
from lunarsci.twin.telemetry.states import DriveStates, motion_table, states_of, wheel_table
from lunarsci.twin.telemetry.wheel_motion import sway_m

GROUND = synthetic_longji()
PLAN = Plan(name="two", legs=(Leg(2.0, 0.15), Leg(stop_s=20.0), Leg(2.0, -0.13)), speed_m_s=0.05)
STOOD = 2000


def csv(table: pd.DataFrame) -> bytes:
    return table.to_csv(index=False).encode()


def read(data: bytes, rover: Rover, name: str = "sent.csv", **options: object) -> Telemetry:
    return read_telemetry(InputFile(name, data), rover, Findings(name), **options)  # type: ignore[arg-type]


def found(data: bytes, rover: Rover, name: str = "sent.csv", **options: object) -> DriveStates:
    return states_of(read(data, rover, name, **options), rover, GROUND, Findings(name))


@pytest.fixture(scope="module")
def drive(yutu2: Rover) -> pd.DataFrame:
    """Two drives with a halt between them."""
    prediction = predict(yutu2, GROUND, PLAN, sweep=(), time_step_s=0.05, sample_m=0.05)
    return simulate_telemetry(prediction, SensorErrors(), 3).telemetry


def halted_row(drive: pd.DataFrame) -> int:
    """A row amid the halt."""
    still = np.flatnonzero((drive[[name for name in drive if name.startswith("speed_")]] == 0).all(axis=1))
    inner = still[(still > 5) & (still < len(drive) - 5)]
    return int(inner[len(inner) // 2])


def stood(drive: pd.DataFrame, rows: int, fixes: int = 0) -> pd.DataFrame:
    """The same with so many rows of a rover at rest amid its halt, as noisy as the others, some with a position."""
    rng, at = np.random.default_rng(5), halted_row(drive)
    rest = pd.concat([drive.iloc[[at]]] * rows, ignore_index=True)
    step = float(np.median(np.diff(drive["time_s"])))
    rest["time_s"] = drive["time_s"][at] + step * np.arange(1, rows + 1)
    for name in rest:
        if name.startswith(("angle_", "rate_", "yaw_deg", "roll", "pitch", "steered")) and name != "yaw_deg_sigma":
            rest[name] += 0.1 * rng.standard_normal(rows)
    place = drive.loc[drive["x_m"].notna() & (drive.index < at)].iloc[-1]
    for row in np.linspace(0, rows - 1, fixes + 2)[1:-1].astype(int):
        for name in ("x_m", "y_m"):
            rest.loc[row, name] = place[name] + 0.005 * rng.standard_normal()
        for name in ("xx_m2", "xy_m2", "yy_m2"):
            rest.loc[row, name] = place[name]
    after = drive.iloc[at + 1 :].assign(time_s=drive["time_s"] + step * rows)
    return pd.concat([drive.iloc[: at + 1], rest, after], ignore_index=True)


@pytest.fixture
def in_one_piece(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is left out."""
    monkeypatch.setattr(reading.RowsWithoutRests, "_leave_out", lambda self, before, rows, after: self._retain(rows))


@pytest.mark.parametrize("fixes", [0, 3])
def test_states_are_those_of_all_rows(
    drive: pd.DataFrame, yutu2: Rover, fixes: int, request: pytest.FixtureRequest
) -> None:
    """All of them to the last digit; the rows that are left out hold noise alone."""
    data = csv(stood(drive, STOOD, fixes))
    short = found(data, yutu2)
    request.getfixturevalue("in_one_piece")
    long = found(data, yutu2)
    assert len(short.telemetry.time_s) < 0.6 * STOOD < STOOD < len(long.telemetry.time_s)
    assert short.findings.entries == long.findings.entries == []
    pd.testing.assert_frame_equal(*(wheel_table(one).drop(columns="rim_m_s") for one in (short, long)), rtol=1e-12)
    rims = [wheel_table(one)["rim_m_s"] for one in (short, long)]
    assert rims[0].to_numpy() == pytest.approx(rims[1].to_numpy(), abs=1e-6, nan_ok=True)  # at rest noise


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(
    ("column", "share", "stands"),
    [("angle", 0.9, True), ("angle", 1.1, False), ("rate", 0.9, True), ("rate", 1.1, False), ("speed", 1e-6, False)],
)
def test_a_wheel_that_turns_to_either_side_is_no_rest(
    yutu2: Rover, column: str, share: float, stands: bool, sign: float
) -> None:
    """Nine blocks, in the fifth of which one wheel turns by a share of 3 deg, or of 5 % of the highest rate.

    The first has none before it, and a block is left out between two that rest: of an even rest 2 and the last stay,
    of one that is broken the block that breaks it and its neighbours, too.
    """
    count = 9 * reading.BLOCK
    inside = np.clip((np.arange(count) - 4 * reading.BLOCK) / reading.BLOCK, 0.0, 1.0)
    rate = 0.05 * np.degrees(yutu2.max_speed_m_s / yutu2.wheel.shearing_radius_m)
    turning = sign * share * {"angle": 3.0 * inside, "rate": rate * (inside % 1 > 0), "speed": inside % 1}[column]
    form = {"angle": "angle_{}_deg", "rate": "rate_{}_deg_s", "speed": "speed_{}_m_s"}[column]
    rows = {form.format(wheel): np.zeros(count) for wheel in yutu2.wheels}
    rows[form.format("ML")] = turning
    kept = reading.RowsWithoutRests("sent.csv", yutu2)
    kept.add({"time_s": 0.1 * np.arange(count), **rows})
    blocks = np.unique(np.rint(10.0 * kept.joined()["time_s"]).astype(int) // reading.BLOCK)
    assert blocks.tolist() == ([0, 1, 8] if stands else [0, 1, 3, 4, 5, 8])


def test_a_wheel_that_creeps_on_through_all_blocks_is_no_rest(yutu2: Rover) -> None:
    """By half of what a wheel that stands may turn, and a little more, in each of nine blocks."""
    count = 9 * reading.BLOCK
    rows = {f"angle_{wheel}_deg": 0.53 * 3.0 * np.arange(count) / reading.BLOCK for wheel in yutu2.wheels}
    kept = reading.RowsWithoutRests("sent.csv", yutu2)
    kept.add({"time_s": 0.1 * np.arange(count), **rows})
    assert len(kept.joined()["time_s"]) == count and kept.rests_s == []


def test_how_long_a_rover_stands_moves_no_state(drive: pd.DataFrame, yutu2: Rover) -> None:
    """Half an hour of noise between two drives, and none: headings may drift in it, and tell a little less."""
    long, short = (found(csv(table), yutu2).rows for table in (stood(drive, STOOD), drive))
    for name in ("slip_ratio", "side_slip_deg"):
        a, b = (getattr(rows, name)[rows.valid] for rows in (long, short))
        assert a == pytest.approx(b, abs=0.05 * np.median(getattr(long, f"{name}_sigma")[long.valid]))


def test_a_part_is_that_of_its_rows_alone(drive: pd.DataFrame, yutu2: Rover) -> None:
    table = stood(drive, STOOD)
    begin, end = 0.0, float(table["time_s"][halted_row(drive) + STOOD // 2])
    rows = table[table["time_s"].between(begin, end)]
    part, alone = found(csv(table), yutu2, span_s=(begin, end)), found(csv(rows), yutu2)
    pd.testing.assert_frame_equal(wheel_table(part), wheel_table(alone), check_exact=True)
    pd.testing.assert_frame_equal(motion_table(part), motion_table(alone), check_exact=True)
    with pytest.raises(DataError, match="no rows between time_s 9000000000 and inf; give others"):
        read(csv(rows), yutu2, span_s=(9e9, np.inf))


def fields(telemetry: Telemetry) -> list[object]:
    return [getattr(telemetry, name) for name in telemetry.__slots__ if name != "file"]


@pytest.mark.parametrize("suffix", ["csv", "ecsv", "parquet"])
def test_pieces_say_what_the_whole_says(
    drive: pd.DataFrame, yutu2: Rover, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cut anywhere, amid lines and numbers too; and one format what the other says."""
    table, buffer, text = stood(drive, 1500, fixes=2), io.BytesIO(), io.StringIO()
    if suffix == "parquet":
        pytest.importorskip("pyarrow")
        table.to_parquet(buffer)
    elif suffix == "ecsv":
        from astropy.table import Table

        Table.from_pandas(table).write(text, format="ascii.ecsv")
    else:
        text.write("# a remark, of which there may be some\n\n")
        table.to_csv(text, index=False)
    data = buffer.getvalue() or text.getvalue().encode()
    whole, plain = read(data, yutu2, f"sent.{suffix}"), read(csv(table), yutu2)
    for name in ("time_s", "fix_m", "fix_covariance_m2", "yaw_deg", "angle_deg", "steered_deg", "synthetic"):
        np.testing.assert_allclose(getattr(whole, name), getattr(plain, name), rtol=1e-12)
    pieces = InputStream.pieces
    monkeypatch.setattr(InputStream, "pieces", lambda self: pieces(self, 40_009))
    monkeypatch.setattr("lunarsci.io.tables.PIECE_ROWS", 97)
    cut = read(data, yutu2, f"sent.{suffix}")
    assert whole.rows == cut.rows == len(table) > len(cut.time_s)
    for one, other in zip(fields(whole), fields(cut), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_digest_is_that_of_the_file(drive: pd.DataFrame, yutu2: Rover, tmp_path: Path) -> None:
    path = tmp_path / "sent.csv"
    path.write_bytes(csv(stood(drive, 1500)))
    with open_input(path) as stream:
        read_telemetry(stream, yutu2, Findings("sent.csv"))
    assert stream.sha256 == InputFile("sent.csv", path.read_bytes()).sha256


Spoil = Callable[[list[bytes]], bytes]


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda lines: b"\n".join([*lines[:1200], lines[1200] + b",7", *lines[1201:]]), "line 1201: 4. fields"),
        (
            lambda lines: b"\n".join([*lines[:1200], lines[1200].replace(b".", b"x", 1), *lines[1201:]]),
            "row 1200, time_s",
        ),
        (
            lambda lines: b"\n".join([*lines[:1200], b"1.5," + lines[1200].partition(b",")[2], *lines[1201:]]),
            "time runs backwards 1 times",
        ),
    ],
)
def test_what_is_wrong_in_a_later_piece_has_its_line(
    drive: pd.DataFrame, yutu2: Rover, spoil: Spoil, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pieces = InputStream.pieces
    monkeypatch.setattr(InputStream, "pieces", lambda self: pieces(self, 40_009))
    data = spoil(csv(stood(drive, 1500)).splitlines()) + b"\n"
    with pytest.raises(DataError, match=message):
        found(data, yutu2)


def test_a_position_that_is_sent_again_while_the_rover_stands_counts_once(drive: pd.DataFrame, yutu2: Rover) -> None:
    """The last position in every row of the halt is one measurement, not thousands of them."""
    once = stood(drive, STOOD, fixes=1)
    again = once.copy()
    at = once.index[once["x_m"].notna() & once.index.isin(range(halted_row(drive), halted_row(drive) + STOOD))][0]
    places = ["x_m", "y_m", "xx_m2", "xy_m2", "yy_m2"]
    again.loc[at : halted_row(drive) + STOOD, places] = once.loc[at, places].to_numpy(float)
    one = found(csv(once), yutu2)
    with pytest.warns(LunarSciWarning, match="repeated position"):
        other = found(csv(again), yutu2)
    assert len(other.telemetry.time_s) < 0.6 * STOOD
    pd.testing.assert_frame_equal(wheel_table(one), wheel_table(other), rtol=1e-9)


def test_rows_of_a_rover_that_does_not_rest_are_limited(
    drive: pd.DataFrame, yutu2: Rover, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half a million by default; here 1,200, of which the rests of a long file are none, and its drives are."""
    monkeypatch.setattr(reading, "MOST_ROWS", 1200)
    assert read(csv(stood(drive, STOOD)), yutu2).rows > 1.5 * 1200
    creeping = stood(drive, STOOD)
    creeping["angle_FL_deg"] += 0.05 * np.arange(len(creeping))
    with pytest.raises(DataError, match="more than 1,200 rows of a rover that does not stand for long, to time_s"):
        read(csv(creeping), yutu2)
    monkeypatch.setattr(nodes, "MOST_NODES", 40)
    with pytest.raises(DataError, match=r"45 moments, of 4\.0\d+ m and 9 positions; 40 are smoothed at once"):
        found(csv(drive), yutu2)


@pytest.mark.parametrize(
    "change",
    [
        {"speed_ML_m_s": 0.01},
        {"rate_ML_deg_s": 9.0},
        {"time_s": 0.0},
        {"time_s": 7.0},
    ],
)
def test_rows_in_which_something_happens_are_kept(drive: pd.DataFrame, yutu2: Rover, change: dict[str, float]) -> None:
    table = stood(drive, STOOD)
    row = halted_row(drive) + STOOD // 2
    for name, value in change.items():
        table.loc[row, name] = table.loc[row - 1, name] + value
    time = float(table["time_s"][row])
    assert time in read(csv(table), yutu2).time_s
    assert time not in read(csv(stood(drive, STOOD)), yutu2).time_s


def test_memory_does_not_grow_with_the_rows(
    drive: pd.DataFrame, yutu2: Rover, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a rest three times as long, read piece by piece."""
    pieces, peaks = InputStream.pieces, []
    monkeypatch.setattr(InputStream, "pieces", lambda self: pieces(self, 1 << 17))
    for rows in (1_500, 1_500 + 12 * reading.BLOCK):
        path = tmp_path / "sent.csv"
        path.write_bytes(csv(stood(drive, rows)))
        tracemalloc.start()
        with open_input(path) as stream:
            sent = read_telemetry(stream, yutu2, Findings("sent.csv"))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert sent.rows == len(drive) + rows
    assert peaks[1] < 1.05 * peaks[0], peaks


def test_beside_a_long_halt_the_origin_sways_as_about_it(yutu2: Rover) -> None:
    """How a rover stands is not known there; upright it would jump by millimetres, within centimetres of way."""
    paths = np.tile([0.0, 0.0, 0.0, 2.0, -3.0, 20.0], (5, 1))
    told = sway_m(yutu2, paths)
    paths[[0, 2], :5] = np.nan
    assert sway_m(yutu2, paths) == pytest.approx(told) and np.hypot(*told.T).min() > 0.01
    paths[:, :5] = np.nan
    assert (sway_m(yutu2, paths) == 0).all()


def slid(table: pd.DataFrame, way_m: tuple[float, float]) -> pd.DataFrame:
    """With all positions from amid the halt on moved."""
    table = table.copy()
    after = table.index >= halted_row(table)
    table.loc[after, ["x_m", "y_m"]] += np.array(way_m)
    return table


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
@pytest.mark.parametrize(
    ("fixes", "way_m"), [(0, (0.5, 0.1)), (0, (-0.05, 0.2)), (3, (0.5, 0.1)), (3, (0.02, -0.1)), (3, (0.04, 0.04))]
)
def test_a_rover_that_slides_while_it_stands_is_said_and_followed(
    drive: pd.DataFrame, yutu2: Rover, fixes: int, way_m: tuple[float, float]
) -> None:
    """No position is left out, the way ends where it did, and slips are what they are without, but for the ground."""
    table = stood(drive, 60, fixes) if fixes else drive
    sound, one = found(csv(table), yutu2), found(csv(slid(table, way_m)), yutu2)
    assert not sound.findings.entries
    (said,) = one.findings.entries
    assert said.kind == "slide at a halt" and not said.doubt
    told = re.search(
        r"moves (-?[\d.]+) \+- [\d.]+ m ahead and (-?[\d.]+) .* between ([\d.]+) and ([\d.]+) s", said.what
    )
    assert told is not None and np.hypot(float(told[1]), float(told[2])) == pytest.approx(np.hypot(*way_m), abs=0.04)
    assert float(told[3]) < float(table["time_s"][halted_row(table)]) < float(told[4]) + 0.01
    assert not len(one.left_out)
    ends = [np.array([drive.motion.x_m[-1], drive.motion.y_m[-1]]) for drive in (sound, one)]
    assert ends[1] - ends[0] == pytest.approx(way_m, abs=0.02)
    slips = [wheel_table(drive).query("valid") for drive in (sound, one)]
    off = (slips[1]["slip_ratio"] - slips[0]["slip_ratio"]) / slips[1]["slip_ratio_sigma"]
    assert off.abs().max() < 3.0


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
def test_one_wrong_position_beside_a_halt_is_no_slide(drive: pd.DataFrame, yutu2: Rover) -> None:
    table = drive.copy()
    at = table.index[table["x_m"].notna() & (table.index > halted_row(table))][0]
    table.loc[at, "y_m"] += 0.3
    one = found(csv(table), yutu2)
    (said,) = one.findings.entries
    assert said.kind == "position jump" and said.count == 1 and not said.doubt and "none beyond" not in said.done


@pytest.mark.filterwarnings("ignore::lunarsci.errors.LunarSciWarning")
@pytest.mark.parametrize(("at", "which"), [(0, "first"), (-1, "last")])
def test_a_wrong_position_with_none_beyond_it_is_in_doubt_at_the_end(
    drive: pd.DataFrame, yutu2: Rover, at: int, which: str
) -> None:
    """It may be right, and the rover there."""
    table = drive.copy()
    table.loc[table.index[table["x_m"].notna()][at], "y_m"] += 0.4
    (said,) = found(csv(table), yutu2).findings.entries
    assert said.kind == "position jump" and f"the {which} one too" in said.what
    assert said.doubt == (which == "last")
