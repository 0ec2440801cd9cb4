"""What to ask of wheel states: loads, pulls, slips and sinkages that would be likely in another unit or definition."""

import math
from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.regolith.prior import LOAD_PRESSURE_PA, Law
from lunarsci.regolith.questions import SLIPS as SLIPS_OF_UNITS
from lunarsci.regolith.questions import Question, question
from lunarsci.regolith.wheel import Wheel
from lunarsci.regolith.written_columns import FORCES, LENGTHS, OPTION, OVER_LOAD, SHARES, TRAVEL

LOAD_UNITS = {"kN": FORCES["kn"], "mN": FORCES["mn"]}
"""In newtons, by definition; a kilogram and a pound of force make loads that other wheels of that size have."""
PULL_OVER_LOAD = Law("ln", 0.25, 0.7, "0.1 to 0.5 at slips of 0.2 and more (Wong 2008, ISBN 978-0-470-17038-0)")
"""Largest drawbar pull of a wheel test, as a share of the load; the width is assumed."""
PULLING = 0.2
"""Slip from which a wheel test shows what a wheel pulls; assumed."""
SINKAGE = Law("ln", 0.12, 0.8, "5 to 40 % of wheels' radii; assumed")
"""Median sinkage over the radius; assumed."""
SLIPS: Mapping[str, Law] = {
    "%": Law("ln", 25.0, 1.0, "wheel tests go from 5 to 80 %; assumed"),
    TRAVEL: Law("ln", 0.4, 1.0, "the same as r w / v - 1; assumed"),
}
"""Median of slips that are no ratios from -1 to 1, as they are written; assumed."""
ROUND, OFF, SURELY_ROUND = 0.05, 0.02, 1e4
"""Step of the slips that wheel tests are set to, how far off one a round number is at most, in steps, and the odds from
which they are taken for set ones; assumed."""
USUAL_SLIP = 0.3
"""Middle of what wheel tests try; assumed."""


def likely_sinkage_unit(median: float, wheel: Wheel) -> tuple[str, Question | None]:
    """The unit of a median sinkage whose column names none, and what to ask where another one is nearly as likely."""
    low = {unit: SINKAGE.ln_density(median * LENGTHS[unit] / wheel.radius_m) for unit in ("m", "cm", "mm")}
    likely, other = sorted(low, key=lambda unit: -low[unit])[:2]
    if low[likely] + math.log(SLIPS_OF_UNITS) > low[other]:
        return likely, None
    usual = SINKAGE.median * wheel.radius_m / LENGTHS[likely]
    return likely, Question("median sinkage", median, usual, likely, f"{OPTION} sinkage_m={likely}")


def another_unit(median: float, wheel: Wheel) -> str:
    """The unit of a median sinkage that is named in m, and beyond the wheel; '' where no other one makes it likely."""
    unit, _ = likely_sinkage_unit(median, wheel)
    low = [SINKAGE.ln_density(median * LENGTHS[one] / wheel.radius_m) for one in ("m", unit)]
    fits = median * LENGTHS[unit] < wheel.radius_m
    return unit if fits and low[1] + math.log(SLIPS_OF_UNITS) > low[0] else ""


def likely_slip(slip: FloatArray) -> str:
    """The definition, or unit, of slips (n,) that are no ratios from -1 to 1; '' where they are."""
    known = slip[np.isfinite(slip)]
    if not known.size:
        return ""
    if (np.abs(known) <= 1).all():
        return TRAVEL if _set_by_travel(known) else ""
    if known.max() <= 1:
        return "rim"
    middle = float(np.median(known[known > 0]))
    return max(SLIPS, key=lambda unit: SLIPS[unit].ln_density(middle))


def _set_by_travel(slip: FloatArray) -> bool:
    """Whether slips within 1 were set to round numbers of 1 - v / (r w), and are written as r w / v - 1.

    By the odds of round numbers: one that nobody set is round by chance in a share of 2 `OFF` of cases.
    """
    each = np.unique(slip[slip > 0])
    steps = (each / ROUND, each / (1 + each) / ROUND)
    written, turned = (int((np.abs(one - np.rint(one)) < OFF).sum()) for one in steps)
    return (turned - written) * -math.log(2 * OFF) > math.log(SURELY_ROUND)


def slip_question(slip: FloatArray, unit: str) -> Question:
    """What to ask of slips that are read in another unit or definition than their name says."""
    worst = float(slip[np.nanargmax(np.abs(slip))])
    told = {"%": "%", TRAVEL: "r w / v - 1", "rim": "1 - v / (r w), in skid too"}[unit]
    return Question("slip_ratio", worst, USUAL_SLIP, told, f"{OPTION} slip_ratio={unit}")


def force_questions(
    values: FloatArray, wheel: Wheel, unitless: Collection[str] = (), answered: Collection[str] = ()
) -> tuple[Question, ...]:
    """What to ask of loads by what wheels of that size carry, and of pulls by the balance with the loads.

    `values` (n, 6) are in the order of `COLUMNS` of wheel states; `unitless` are columns that name no unit, `answered`
    those whose unit the user has said.
    """
    slip, load, pull = values[:, 1], values[:, 3], values[:, 4]
    carried = load[np.isfinite(load) & (load > 0)]
    if not carried.size:
        return ()
    middle = float(np.median(carried))
    law = replace(LOAD_PRESSURE_PA, median=LOAD_PRESSURE_PA.median * wheel.radius_m * wheel.width_m)
    asked = None if "normal_force_n" in answered else _of_load(middle, law, unitless)
    pulls = None if "drawbar_pull_n" in answered else _of_pull(slip, pull, middle)
    if asked and pulls is None and asked.likely_unit not in ("", "N") and "drawbar_pull_n" not in answered:
        # The balance holds as it is written, so that both are in the same unit.
        asked = replace(asked, option=f"{asked.option},drawbar_pull_n={asked.likely_unit}")
    return tuple(one for one in (asked, pulls) if one is not None)


def questions_by_name(values: FloatArray, wheel: Wheel, unitless: Collection[str] = ()) -> tuple[Question, ...]:
    """The same where no option has units, so that names of columns answer."""
    return tuple(
        replace(one, option=f"name columns {', '.join(map(_name_of, one.option.removeprefix(OPTION).split(',')))}")
        for one in force_questions(values, wheel, unitless)
    )


def _name_of(answer: str) -> str:
    """The name of a column that says the unit of an answer of the option.

    >>> _name_of("normal_force_n=kN"), _name_of(" drawbar_pull_n=load")
    ('normal_force_kN', 'drawbar_pull_over_load')
    """
    column, _, unit = answer.strip().partition("=")
    return f"{column.rpartition('_')[0]}_{'over_load' if unit == OVER_LOAD else unit}"


def _of_pull(slip: FloatArray, pull: FloatArray, load: float) -> Question | None:
    most, share = float(np.nanmax(np.abs(pull), initial=0.0)), "a share of the load"
    if np.nanmax(np.abs(slip), initial=0.0) < PULLING:
        return None
    of_load = {f"{unit} (the load)": 1.0 / FORCES[unit.lower()] for unit in ("kN", "kgf", "lbf")}
    found = question(
        "largest drawbar_pull_n over the load", most / load, PULL_OVER_LOAD, LOAD_UNITS | {share: load} | of_load
    )
    if found is None:
        return None
    unit = OVER_LOAD if found.likely_unit == share else found.likely_unit.partition(" ")[0] or "N"
    column = "normal_force_n" if found.likely_unit in of_load else "drawbar_pull_n"
    return replace(found, option=f"{OPTION} {column}={unit}")


def _of_load(middle: float, law: Law, unitless: Collection[str]) -> Question | None:
    named = "normal_force_n" not in unitless
    units = LOAD_UNITS | ({} if named else {"kgf": FORCES["kgf"], "lbf": FORCES["lbf"]})
    found = question("median normal_force_n", middle, law, units)
    if found is None and not named:
        found = Question("median normal_force_n", middle, law.median, "N", OPTION)
    return found and replace(found, option=f"{OPTION} normal_force_n={found.likely_unit or 'N'}")


def converted_slip(slip: FloatArray, unit: str) -> FloatArray:
    """lunarsci's slip ratio from slips of a unit or definition."""
    from lunarsci.regolith.written_columns import by_rim, by_travel

    return by_travel(slip) if unit == TRAVEL else by_rim(slip) if unit == "rim" else SHARES[unit] * slip
