"""Sentences for all but spectra: soils and wheels, pictures, the ground, drives from their plan to what they teach."""

from collections.abc import Mapping
from typing import Any

from lunarsci.names import counted
from lunarsci.pages.words import (
    DOUBT,
    GO,
    MOST,
    PLAIN,
    STOP,
    Result,
    ResultAnswer,
    answers,
    each,
    measured,
    number,
    percent,
    quantity,
    sentence,
    unit,
    words,
)
from lunarsci.regolith.columns import short_name


@answers("The predicted drive", "twin-predict")
def predicted(result: Result) -> ResultAnswer:
    go = result["verdict"] == "go"
    members, length = result["members"], number(result.get("path_length_m"), 3)
    ground = (result.get("terrain") or {}).get("name", "")
    drive = f"the drive \u201c{result.get('plan', '')}\u201d of {length} m by {short_name(result['rover'])} on {ground}"
    if result["verdict"] == "not-determined":
        return ResultAnswer(f"Not determined for {drive}: {result['reasons'][0]}.", DOUBT)
    if not go:
        return ResultAnswer(f"No-go for {drive}: {'; '.join(_broken(result)) or 'a limit is broken'}.", STOP)
    broken = max((int(one.get("exceeding") or 0) for one in result["limits"]), default=0)
    some = _those_that_arrived(result)
    of = some or counted(members, "predicted drive")
    limits_text = (
        f"a limit is broken by {broken} of {of}, fewer than one in twenty" if broken else f"all limits are kept in {of}"
    )
    tight = max((one for one in result["limits"] if one.get("limit")), key=_used, default=None)
    near = f"; nearest to its limit comes the {quantity(tight['quantity'])}, {_of_limit(tight)}" if tight else ""
    end = result.get("endpoint")
    who = some.capitalize() or "All drives"
    where = f" {who} end within {number(end['covering_radius_m'], 2)} m of the destination." if end else ""
    return ResultAnswer(f"Go for {drive}: {limits_text}{near}.{where}{_made_up(result, 'verdict')}", GO)


def _those_that_arrived(result: Result) -> str:
    """The drives that limits and ends are of, where others stopped; '' where all arrived."""
    members = result["members"]
    stopped = sum(count for end, count in (result.get("outcomes") or {}).items() if end != "finished")
    return f"the {members - stopped} drives that arrived" if stopped else ""


def _made_up(result: Result, what: str) -> str:
    """What a drive on synthetic terrain, or on soil that nobody named, is worth, in the words of the commands."""
    if (result.get("terrain") or {}).get("synthetic"):
        return f" The terrain is synthetic; the {what} says nothing about a real site."
    soil = result.get("soil") or {}
    if soil.get("of") != "default" or not soil.get("parameters"):
        return ""
    return f" The soil is assumed to be that of {soil['name']}; none was given."


def _broken(result: Result) -> list[str]:
    """Why it is no go: limits that are broken, then reasons that are of no limit, as the command says them."""
    among = _those_that_arrived(result) or "the drives"
    broken = [one for one in result["limits"] if one.get("ok") is False and None not in (one["p05"], one["p95"])]
    names = [str(one["quantity"]) for one in broken]
    lines = [
        f"the {quantity(one['quantity'])} is {_reached(one)} in 95 % of {among}, {_bound(one)} is allowed"
        for one in broken
    ]
    return lines + [str(text) for text in result.get("reasons", ()) if str(text).partition(":")[0] not in names]


def _reached(limit: Result) -> str:
    low = limit.get("sense") == "at least"
    return f"{'down' if low else 'up'} to {_with_unit(limit, limit['p05' if low else 'p95'])}"


def _used(limit: Result) -> float:
    """How much of a limit the worst drive uses; 1 is all of it."""
    bound, least = float(limit["limit"]), limit.get("sense") == "at least"
    worst = limit.get("min" if least else "max")
    if worst is None or bound == 0:
        return 0.0
    return bound / float(worst) if least and worst else abs(float(worst) / bound)


def _of_limit(limit: Result) -> str:
    worst = limit.get("min" if limit.get("sense") == "at least" else "max") or 0.0
    return f"at worst {_with_unit(limit, worst)} of {_bound(limit)}"


def _bound(limit: Result) -> str:
    return f"{limit.get('sense', 'at most')} {_with_unit(limit, limit['limit'], 3)}"


def _with_unit(limit: Result, value: float, digits: int = 2) -> str:
    """A value of a limit's quantity, lengths of less than a metre in mm."""
    symbol, factor = {"-": ("", 1), None: ("", 1), "deg": ("°", 1)}.get(limit.get("unit"), (f" {limit.get('unit')}", 1))
    if symbol == " m" and limit["limit"] < 1:
        symbol, factor = " mm", 1000
    return f"{number(float(factor * value), digits)}{symbol}"


@answers("The ground", "twin-terrain")
def surveyed(result: Result) -> ResultAnswer:
    return planned(result) if result.get("path") else ground(result)


def ground(result: Result) -> ResultAnswer:
    """Where one may drive, without a path."""
    free, hazard = percent(result["traversable_share"]), percent(result["hazard_share"])
    shares = f"{free} of the ground may be driven on, {hazard} is a hazard"
    unknown = f", {percent(result['unknown_share'])} is not known"
    made_up = "Synthetic ground: " if result["terrain"].get("synthetic") else ""
    return ResultAnswer(f"{made_up}{shares}{unknown}, for the limits of {result.get('rover', 'the rover')}.")


@answers("The way", "twin-plan")
def planned(result: Result) -> ResultAnswer:
    choice, path = result.get("choice"), result.get("path")
    if choice and not choice.get("feasible"):
        return ResultAnswer(f"No drive is found: {choice.get('why_none') or 'none keeps the limits'}.", STOP)
    if not path:
        return ResultAnswer(f"No path was asked for or found. {ground(result).text}", PLAIN)
    place = (
        f"a path of {number(path['length_m'], 3)} m leads to x {path['target']['x_m']:g}, y {path['target']['y_m']:g} m"
    )
    room = (
        f", never nearer than {number(path['min_hazard_distance_m'], 2)} m to a hazard"
        if path.get("min_hazard_distance_m")
        else ""
    )
    risk = _chosen(choice) if choice else ""
    return ResultAnswer(
        f"There is a way: {place}{room}, on slopes of up to {number(path['max_slope_deg'], 2)}°.{risk}"
        f"{_made_up(result, 'way')}",
        GO,
    )


def _chosen(choice: Result) -> str:
    best = next((one for one in choice["candidates"] if one["number"] == choice["best"]), None)
    if best is None or not best.get("promised"):
        return ""
    promised = best["promised"]
    return (
        f" Of {counted(len(choice['candidates']), 'candidate')} it is \u201c{best['name']}\u201d: "
        f"{percent(promised['risk'])} of its drives fail, {percent(promised['risk_high'])} at most, by "
        f"{counted(promised['drives'], 'drive')} on fresh soils."
    )


@answers("A mission", "twin-mission")
def mission(result: Result) -> ResultAnswer:
    mission = result["mission"]
    total, reached = len(mission["targets"]), mission["reached"]
    time, legs = number(mission["end_s"] / 3600, 2), counted(len(mission["legs"]), "leg")
    text = f"Reached: {reached} of {counted(total, 'target')}, in {time} h and {legs}."
    return ResultAnswer(text, GO if reached == total else STOP)


@answers("A simulated drive", "twin-simulate")
def simulated(result: Result) -> ResultAnswer:
    end = f"The simulated drive {result['outcome']}" if result.get("outcome") else "A simulated drive"
    return ResultAnswer(f"{end} after {number(result['duration_s'], 3)} s. All of it is synthetic.")


@answers("Wheel states of the drive", "twin-states")
def states(result: Result) -> ResultAnswer:
    wheels = result["wheels"].values()
    slips = [one["slip_ratio"]["median"] for one in wheels if one["slip_ratio"]["median"] is not None]
    depths = [one["sinkage_m"]["median"] for one in wheels if one["sinkage_m"]["median"] is not None]
    slip = f" Median slip of the wheels is {number(min(slips), 2)} to {number(max(slips), 2)}." if slips else ""
    sink = (
        f" Median sinkage is {1e3 * min(depths):.1f} to {1e3 * max(depths):.1f} mm."
        if depths
        else " Sinkage was not measured."
    )
    made_up = " The telemetry is synthetic." if result.get("synthetic") else ""
    rolled = result.get("wheel_distance_m")
    # Older files have only the way of the wheels, as `distance_m`.
    who, more = (
        ("The wheels rolled", "")
        if rolled is None
        else ("The rover drove", f"; its wheels rolled {number(rolled, 3)} m")
    )
    way = f"{who} {number(result['distance_m'], 3)} m in {number(result['duration_s'], 3)} s{more}."
    return ResultAnswer(f"{way}{slip}{sink}{made_up}")


@answers("Forces of the wheels", "twin-forces")
def loads(result: Result) -> ResultAnswer:
    intervals = [interval for one in result["wheels"] if (interval := interval_of(one["normal_force_n"]))]
    if not intervals:
        return ResultAnswer("Forces of the wheels are not determined.")
    low, high = min(low for _, low, _ in intervals), max(high for *_, high in intervals)
    return ResultAnswer(
        f"The wheels carry {number(low, 3)} to {number(high, 3)} N each; "
        f"the rover weighs {number(result['weight_n'], 3)} N."
    )


def interval_of(item: Result) -> tuple[float, float, float] | None:
    """Middle, low and high end of a quantity: median with 5 % and 95 %, or mean and one standard error."""
    if item.get("p50") is not None:
        return item["p50"], item["p05"], item["p95"]
    mean, sigma = item.get("mean"), item.get("sigma")
    return None if mean is None or sigma is None else (mean, mean - sigma, mean + sigma)


@answers("What the drive teaches of the soil", "twin-update")
def learned(result: Result) -> ResultAnswer:
    if result.get("refused"):
        return ResultAnswer(sentence(f"nothing was learned from this drive: {result['refused']}"))
    changes = len(result.get("changes", ()))
    changed = (
        f" The soil changes in {counted(changes, 'place')}."
        if changes
        else " No change of the soil along the way was found."
    )
    return ResultAnswer(
        f"The soil was learned from {counted(result['values'], 'value')} of the drive. {like(result['parameters'])}"
        f"{changed}"
    )


@answers("The soil by place", "soil-map")
def soil_by_place(result: Result) -> ResultAnswer:
    zones = result["zones"]
    if not zones:
        return ResultAnswer("The map has no zone yet: everywhere the priors hold, as before any drive.")
    drives = counted(result["drives"], "drive")
    zone_lines = [f"{one['name']} ({one['stretch']}): {like(one['parameters'])}" for one in zones[:MOST]]
    rest = f" {counted(len(zones) - MOST, 'more zone')} below." if len(zones) > MOST else ""
    made_up = " The drives are synthetic." if result["synthetic"] else ""
    of_each = " ".join(map(sentence, zone_lines))
    return ResultAnswer(
        f"The map knows the soil of {counted(len(zones), 'zone')}, from {drives}. {of_each}{rest}{made_up}"
    )


def like(parameters: Mapping[str, Any]) -> str:
    """What the ground is like: the parameters that drives tell most of, with 68 %, and what they tell of the others."""
    left = {name: float(one["left_of_prior"]) ** 2 for name, one in parameters.items() if one.get("left_of_prior")}
    return f"The soil for predictions, median and 68 %: {_best_determined(parameters, left)}"


def _best_determined(parameters: Mapping[str, Any], left: Mapping[str, float]) -> str:
    """Parameters of which least of the prior's variance is left, each with that share, and what is left of the others.

    The share is one measure of learning with no bound between much and little.
    """
    order = sorted(left, key=lambda name: left[name])
    lines = []
    for name, share in ((name, left[name]) for name in order[:MOST]):
        one = parameters[name]
        interval = f"{number(one['low'], 3)} to {number(one['high'], 3)}{_of_ground(one)}"
        lines.append(f"{quantity(name)} {number(one['median'], 3)}{_after(name)} ({interval}; {percent(share)})")
    others = [left[name] for name in order[MOST:]]
    rest = f", of the others {percent(others[0])} to {percent(others[-1])}" if others else ""
    return f"{', '.join(lines)}. The share in brackets is left of the variance before{rest}."


def _of_ground(parameter: Mapping[str, Any]) -> str:
    """The interval of 68 % of the ground's own parameter, which is another than that of the one for predictions."""
    low, high = (parameter.get(f"ground_{side}_68") for side in ("low", "high"))
    return "" if low is None or high is None else f"; the ground's own {number(low, 3)} to {number(high, 3)}"


def _after(name: str) -> str:
    symbol = "kPa/m^N" if name == "stiffness_kpa_m_n" else unit(name)
    return f"\u202f{symbol}" if symbol == "°" else f" {symbol}" if symbol else ""


@answers("Was the prediction right?", "twin-compare")
def compared(result: Result) -> ResultAnswer:
    end, verdict = result.get("end"), str(result["verdict"])
    where = "" if not end or end.get("error_m") is None else f" {_ended(end)}"
    reasons = result.get("reasons") or result.get("near")
    reason = f": {'; '.join(map(str, reasons))}" if reasons else ""
    return ResultAnswer(f"The prediction is {verdict}{reason}.{where}")


def _ended(end: Result) -> str:
    """How far off the last position was, and when where that is not the end of the plan."""
    error = number(end["error_m"], 2)
    if end.get("at_end", True) or end.get("time_s") is None:
        return f"The drive ended {error} m from where it was predicted to."
    at = f"At {end['time_s']:.0f} s, its last position, before the end of the plan,"
    return f"{at} the rover was {error} m from where it was predicted to be."


@answers("The drives behind the belief of the soil", "twin-history")
def believed(result: Result) -> ResultAnswer:
    drives = result["drives"]
    learned = [one for one in drives if not one.get("refused")]
    of = f" of {len(drives)}" if len(learned) < len(drives) else ""
    made_up = " Its ground is synthetic." if result.get("synthetic") else ""
    return ResultAnswer(
        f"What is believed of the soil rests on {counted(len(learned), 'drive')}{of}. {like(result['parameters'])}"
        f"{made_up}"
    )


@answers("Designs of the rover", "twin-sweep")
def designs(result: Result) -> ResultAnswer:
    designs, keys = result["designs"], [str(one["name"]) for one in result.get("vary") or ()]
    best = [_design(designs[k], keys) for k in result["front"] if k < len(designs)]
    impossible = sum(bool(one.get("impossible")) for one in designs)
    lost = f" {counted(impossible, 'design')} cannot be built." if impossible else ""
    front = (
        f"no other keeps more drives with less work than {', or '.join(best[:3])}" if best else "none could be driven"
    )
    return ResultAnswer(f"Of {counted(len(designs), 'design')} {front}.{lost}{_made_up(result, 'trade')}")


def _design(design: Result, keys: list[str]) -> str:
    made = ", ".join(f"{words(key)} {number(design[key], 3)}" for key in keys if key in design)
    share = f" ({percent(design['kept_share'])} of its drives kept)" if design.get("kept_share") is not None else ""
    return f"that of {made}{share}"


def _mm(value: float | None, digits: int = 2) -> str:
    return "not known" if value is None else f"{number(1e3 * value, digits)} mm"


def _baseline(one: Result) -> str:
    return f"baseline {measured(1e3 * one['baseline_m'], 1e3 * one['baseline_m_sigma'], 'mm')}"


@answers("Cameras", "images-cameras")
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


@answers("Cameras, calibrated", "images-calibrate")
def calibrated_cameras(result: Result) -> ResultAnswer:
    used = sum(bool(one["used"]) for one in result["pictures"])
    base = f", {_baseline(result)}" if "baseline_m" in result else ""
    left_open = result["not_determined"]
    lost = f" Not determined: {'; '.join(map(str, left_open))}." if left_open else ""
    return ResultAnswer(
        f"The cameras are calibrated from {counted(used, 'picture')}: points of the board are met within "
        f"{number(result['residual_px'], 2)} px{base}.{lost}"
    )


@answers("Heights from pictures", "images-dem")
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
        f"{_synthetic(terrain)}Heights of {number(east - west, 2)} by {number(north - south, 2)} m of ground, "
        f"{percent(terrain['hole_share'])} of it unseen.{error}"
    )


def _synthetic(terrain: Result) -> str:
    return "Synthetic ground. " if terrain.get("synthetic") else ""


@answers("Where the pictures were taken", "images-locate")
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


@answers("Heights of several stations", "images-merge")
def merged(result: Result) -> ResultAnswer:
    worst = max((float(one["rms_z"]) for one in result["overlaps"]), default=None)
    agree = f" Where two overlap they differ by {number(worst, 2)} times their errors at most." if worst else ""
    terrain = result["terrain"]
    return ResultAnswer(
        f"{_synthetic(terrain)}Heights of {counted(len(result['stations']), 'station')} are one grid now, a node every "
        f"{number(terrain['spacing_m'], 3)} m.{agree}"
    )


@answers("Synthetic pictures", "images-render")
def rendered(result: Result) -> ResultAnswer:
    pixels = result["pixels"]
    return ResultAnswer(
        f"Synthetic pictures of {counted(result['rocks'], 'rock')}: {percent(pixels['shadow'])} of the pixels lie in "
        f"shadow, and both cameras see {percent(pixels['seen_by_both'])}."
    )


@answers("Depth of the ruts", "images-track")
def ruts(result: Result) -> ResultAnswer:
    depth, terrain = result["sinkage_m"], result.get("terrain") or {}
    if depth.get("mean") is None:
        return ResultAnswer("The depth of the ruts is not determined.")
    return ResultAnswer(
        f"{_synthetic(terrain)}The wheels sank {measured(1e3 * depth['mean'], 1e3 * depth['sigma'], 'mm')}, "
        f"the mean of {result['determined']} of {result['places']} places."
    )


@answers("Rocks", "images-rocks")
def rocks(result: Result) -> ResultAnswer:
    listed = result["rocks"]
    largest = max(listed, key=lambda one: float(one["diameter_m"]), default=None)
    tall = (
        f" The largest is {measured(largest['diameter_m'], largest.get('diameter_m_sigma'), 'm')} across."
        if largest
        else ""
    )
    false = result.get("expected_false_share")
    doubt = f"; {percent(false)} of them are probably bumps of the ground" if listed and false else ""
    shares = [
        f"{percent(one['share'])} of {100 * one['diameter_m']:g} cm at "
        f"{one['range_from_m']:g} to {one['range_to_m']:g} m"
        for one in result.get("completeness") or ()
        if one.get("range_from_m") is not None
    ]
    missed = f" Found are, of rocks in view: {', '.join(shares)}." if shares else ""
    count = f"{counted(len(listed), 'rock')} found{doubt}.{tall}{missed}"
    return ResultAnswer(f"{_synthetic(result.get('terrain') or {})}{count}")


@answers("The soil from wheel states", "regolith-identify")
def soil(result: Result) -> ResultAnswer:
    if isinstance(result.get("joint"), Mapping):
        return _inferred(result["joint"])
    values = [
        (name, aspect[name]) for aspect in _aspects(result) for name in aspect if isinstance(aspect[name], Mapping)
    ]
    determined = [(k, v) for k, v in values if v.get("value") is not None and not v.get("assumed")]
    lines = [f"{quantity(name)} {measured(item['value'], item.get('sigma'), _unit(name))}" for name, item in determined]
    lost = [
        quantity(name)
        for name, item in values
        if item.get("reason") and not item.get("assumed") and item.get("value") is None
    ]
    taken = [quantity(name) for name, item in values if item.get("assumed")]
    if not lines:
        return ResultAnswer("These wheel states do not determine the soil.")
    states = len(result.get("observations", ())) or result.get("states")
    of = f"From {counted(states, 'wheel state')}: " if isinstance(states, int) and states else "The soil: "
    rest = [f" Not determined: {', '.join(lost)}." if lost else "", f" Assumed: {', '.join(taken)}." if taken else ""]
    return ResultAnswer(f"{of}{'; '.join(lines)}.{''.join(rest)}")


def _inferred(joint: Result) -> ResultAnswer:
    left = {name: (1.0 - float(one["shrinkage"])) ** 2 for name, one in joint["parameters"].items()}
    return ResultAnswer(f"These wheel states tell, median and 68 %: {_best_determined(joint['parameters'], left)}")


def _aspects(result: Result) -> list[Mapping[str, Any]]:
    return [result[name] for name in ("bearing", "shear", "lateral") if isinstance(result.get(name), Mapping)]


def _unit(name: str) -> str:
    return "kPa/m^N" if name == "stiffness_kpa_m_n" else unit(name)


@answers("Forces of a wheel", "regolith-forces")
def wheel_forces(result: Result) -> ResultAnswer:
    if not isinstance(result.get("normal_force_n"), int | float):
        return ResultAnswer("Forces of a wheel over slip; the table has them.")
    return ResultAnswer(
        f"At {number(1e3 * result['sinkage_m'], 3)} mm sinkage and a slip of {number(result['slip_ratio'], 2)} a wheel "
        f"carries {number(result['normal_force_n'], 3)} N, pulls with {number(result['drawbar_pull_n'], 3)} N "
        f"and needs a torque of {number(result['resistance_torque_nm'], 3)} N m."
    )


@answers("The soil beside others", "regolith-compare")
def compared_soils(result: Result) -> ResultAnswer:
    near = [one for one in result["soils"] if one.get("strength_distance") is not None]
    best = min(near, key=lambda one: float(one["strength_distance"]), default=None)
    nearest = f"; nearest in strength is {best['name']}" if best else ""
    return ResultAnswer(f"The site is compared with {counted(len(result['soils']), 'soil')}{nearest}.")


@answers("Published numbers", "reproduce")
def reproduced(result: Result) -> ResultAnswer:
    verdicts = "; ".join(f"{count} {verdict}" for verdict, count in result["verdicts"].items())
    return ResultAnswer(f"Of {counted(len(result['numbers']), 'published number')}: {verdicts}.")


SYMBOLS = {"-": "", "deg": "°"}
"""Units that are written otherwise in a sentence."""


@answers("The demonstration", "demo")
def shown(result: Result) -> ResultAnswer:
    firsts = {str(one["quantity"]).partition(":")[0]: one for one in reversed(result["findings"])}
    listed = [
        f"{one['quantity']}, {measured(one['value'], one.get('sigma'), SYMBOLS.get(one['unit'], one['unit']))}"
        for one in reversed(firsts.values())
    ]
    more = len(result["findings"]) - len(listed)
    rest = f" {more} more findings are below." if more else ""
    return ResultAnswer(f"Everything here is synthetic. Found, among others: {'; '.join(listed)}.{rest}")
