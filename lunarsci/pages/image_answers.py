"""Sentences for pictures: cameras, heights, stations, ruts and rocks."""

from lunarsci.pages.sentences import Result, ResultAnswer, each
from lunarsci.pages.words import counted, measured, number, percent


def _mm(value: float | None, digits: int = 2) -> str:
    return "not known" if value is None else f"{number(1e3 * value, digits)} mm"


def _baseline(one: Result) -> str:
    return f"baseline {measured(1e3 * one['baseline_m'], 1e3 * one['baseline_m_sigma'], 'mm')}"


def cameras(result: Result) -> ResultAnswer:
    rigs = each(result["rigs"], _one_rig, "stereo pair") if result["rigs"] else ""
    names = ", ".join(str(one["name"]) for one in result["cameras"])
    return ResultAnswer(" ".join(filter(None, [rigs, f"Single cameras: {names}." if names else ""])))


def _one_rig(rig: Result) -> str:
    seen = [row for row in rig["ranges"] if row["seen_by_both"]]
    row = min(seen, key=lambda one: abs(float(one["range_m"]) - 5.0), default=None)
    error = (
        f"; {number(float(row['range_m']), 2)} m away, a distance is wrong by {_mm(row['range_random_m_sigma'])} from "
        f"point to point and by {_mm(row['range_common_m_sigma'])} for all points alike"
        if row
        else ""
    )
    return f"Stereo cameras {rig['name']}: {_baseline(rig)}{error}."


def calibrated_cameras(result: Result) -> ResultAnswer:
    used = sum(bool(one["used"]) for one in result["pictures"])
    base = f", {_baseline(result)}" if "baseline_m" in result else ""
    left_open = result["not_determined"]
    lost = f" Not determined: {'; '.join(map(str, left_open))}." if left_open else ""
    return ResultAnswer(
        f"The cameras are calibrated from {counted(used, 'picture')}: points of the board are met within "
        f"{number(result['residual_px'], 2)} px{base}.{lost}"
    )


def heights(result: Result) -> ResultAnswer:
    terrain, ranges = result["terrain"], result["ranges"]
    (west, east), (south, north) = terrain["x_m"], terrain["y_m"]
    near = ranges[0] if ranges else None
    error = (
        f" From {number(float(near['range_from_m']), 2)} to {number(float(near['range_to_m']), 2)} m away a height is "
        f"wrong by {_mm(near['median_height_m_sigma'])} from node to node and by "
        f"{_mm(near['median_height_m_common_sigma'])} for all alike."
        if near
        else ""
    )
    return ResultAnswer(
        f"{_made_up(terrain)}Heights of {number(east - west, 2)} by {number(north - south, 2)} m of ground, "
        f"{percent(terrain['hole_share'])} of it unseen.{error}"
    )


def _made_up(terrain: Result) -> str:
    return "Synthetic ground. " if terrain.get("synthetic") else ""


def located(result: Result) -> ResultAnswer:
    stations = result["stations"]
    tied = sum(bool(one["tied"]) for one in stations)
    last = stations[-1]
    place = " and ".join(
        f"{axis} {measured(last[f'{axis}_m'], float(last[f'{axis}{axis}_m2']) ** 0.5, 'm')}" for axis in "xy"
    )
    return ResultAnswer(
        f"Pictures tie {tied} of {counted(len(stations), 'station')} together. The {result['positions_of']} at the "
        f"last, {last['station']}, was at {place}, {number(last['from_dead_reckoning_m'], 2)} m from dead reckoning."
    )


def merged(result: Result) -> ResultAnswer:
    worst = max((float(one["rms_z"]) for one in result["overlaps"]), default=None)
    agree = f" Where two overlap they differ by {number(worst, 2)} times their errors at most." if worst else ""
    terrain = result["terrain"]
    return ResultAnswer(
        f"{_made_up(terrain)}Heights of {counted(len(result['stations']), 'station')} are one grid now, a node every "
        f"{number(terrain['spacing_m'], 3)} m.{agree}"
    )


def rendered(result: Result) -> ResultAnswer:
    pixels = result["pixels"]
    return ResultAnswer(
        f"Synthetic pictures of {counted(result['rocks'], 'rock')}: {percent(pixels['shadow'])} of the pixels lie in "
        f"shadow, and both cameras see {percent(pixels['seen_by_both'])}."
    )


def ruts(result: Result) -> ResultAnswer:
    depth, terrain = result["sinkage_m"], result.get("terrain") or {}
    if depth.get("mean") is None:
        return ResultAnswer("The depth of the ruts is not determined.")
    return ResultAnswer(
        f"{_made_up(terrain)}The wheels sank {measured(1e3 * depth['mean'], 1e3 * depth['sigma'], 'mm')}, "
        f"the mean of {result['determined']} of {result['places']} places."
    )


def rocks(result: Result) -> ResultAnswer:
    found = result["rocks"]
    largest = max(found, key=lambda one: float(one["diameter_m"]), default=None)
    tall = (
        f" The largest is {measured(largest['diameter_m'], largest.get('diameter_m_sigma'), 'm')} across."
        if largest
        else ""
    )
    false = result.get("expected_false_share")
    doubt = f", of which {percent(false)} are expected to be none" if found and false else ""
    return ResultAnswer(f"{_made_up(result.get('terrain') or {})}{counted(len(found), 'rock')} found{doubt}.{tall}")
