"""Is the next drive safe: each limited quantity over the ensemble, where the wheel model was used outside of what is
known about it, and a verdict.
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.names import counted
from lunarsci.result import Doubt
from lunarsci.twin.ground.finer_ground import Unresolved
from lunarsci.twin.judgement.endpoint import Endpoint, endpoint_spread
from lunarsci.twin.judgement.keeping import (
    NEVER_BROKEN,
    PLAN_HAS_NONE,
    broken,
    keeps_limits,
    not_judged,
    worst_values,
)
from lunarsci.twin.judgement.quantities import Encounter, clearance, encounters, least_of_95, most_of_95
from lunarsci.twin.lanes import HOLE, LEFT, OUTCOMES
from lunarsci.twin.plans.plan import Limit, Plan, check_limits
from lunarsci.twin.plans.risk import USUAL, AcceptedRisk, Chance
from lunarsci.twin.simulation.contact import DEEPEST, SHALLOWEST, VALID_SLIP
from lunarsci.twin.simulation.ensemble import MOST_BEYOND, STATE_COLUMNS, Prediction

CALIBRATED_SINKAGE_M = (0.005, 0.015)
"""Sinkages that the calibration of Ding et al. (2024), 10.1038/s41467-024-46233-8, covers: wheels of Yutu-2. [m]"""
MOST_DRAWS = 0.75
"""Of the draws of unseen ground that must fail for a no-go: a quarter of such plans would have kept. Assumed."""


@dataclass(frozen=True, slots=True)
class Validity:
    """Shares of the wheel states (every member, sample and wheel that was driven) by what is wrong with them.

    Attributes
    ----------
    wheel_states : how many there are.
    slip_share : |s| above 0.6, up to which the source states the wheel model.
    unloaded_share : wheels in the air.
    too_deep_share : sinkage beyond 0.9 radii, where the force no longer grows.
    beyond_share : slip or sinkage beyond the wheel model; a wheel in the air has no force, which is known.
    invalid_share : any of these.
    uncalibrated_share : loaded, but sinkage outside of 5 to 15 mm, which the source's calibration covers; still valid.
    members_off_map, members_in_hole : drives that ended at the edge of the map, or at ground of unknown height.
    """

    wheel_states: int
    slip_share: float
    unloaded_share: float
    too_deep_share: float
    beyond_share: float
    invalid_share: float
    uncalibrated_share: float
    members_off_map: int
    members_in_hole: int


def validity(prediction: Prediction) -> Validity:
    """Count what lies outside of the model; all shares are 0 but `invalid_share`, 1, where nothing was driven."""
    driven = prediction.states[prediction.reached]
    sinkage, slip, valid = (driven[..., STATE_COLUMNS.index(name)] for name in ("sinkage_m", "slip_ratio", "valid"))
    low, high = CALIBRATED_SINKAGE_M
    loaded = sinkage > SHALLOWEST
    slipping = loaded & (np.abs(slip) > VALID_SLIP)
    deep = sinkage > DEEPEST * prediction.rover.wheel.radius_m

    def share(where: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> float:
        return float(where.mean()) if where.size else 0.0

    return Validity(
        wheel_states=int(valid.size),
        slip_share=share(slipping),
        unloaded_share=share(~loaded),
        too_deep_share=share(deep),
        beyond_share=share(slipping | deep),
        invalid_share=float(1.0 - valid.mean()) if valid.size else 1.0,
        uncalibrated_share=share(loaded & ((sinkage < low) | (sinkage > high))),
        members_off_map=int((prediction.outcome == LEFT).sum()),
        members_in_hole=int((prediction.outcome == HOLE).sum()),
    )


def validity_notes(states: Validity) -> list[str]:
    """One sentence for each kind that occurs."""
    low, high = (1e3 * limit for limit in CALIBRATED_SINKAGE_M)
    kinds = (
        (states.slip_share, f"slip more than the wheel model holds for (|s| > {VALID_SLIP})"),
        (states.unloaded_share, "are in the air"),
        (states.too_deep_share, f"sink deeper than the wheel model holds for ({DEEPEST} of the radius)"),
        (
            states.uncalibrated_share,
            f"sink less than {low:g} mm or more than {high:g} mm; only between these were forces calibrated on the "
            "Moon, by Yutu-2 (Ding et al. 2024)",
        ),
    )
    return [f"{percent(share)} of the wheel states {what}" for share, what in kinds if share > 0]


def percent(share: float) -> str:
    """A share in words, never rounded to nothing."""
    return "less than 0.1 %" if share < 0.001 else f"{100 * share:.1f} %"


@dataclass(frozen=True, slots=True)
class Judgement:
    """One limited quantity over the members, each of which counts with the worst value of its drive.

    Attributes
    ----------
    quantity, unit : what is limited.
    sense : `at most` where large values are bad (the largest magnitude of each drive counts), `at least` where small
        ones are (the smallest value counts).
    limit : the largest or smallest safe value. This and the values below are in `unit`.
    p05, p50, p95, min, max : over the members. p95 is the smallest value that at least 95 % of the members do not
        exceed, p05 the largest that at least 95 % reach; with fewer than 20 members these are max and min.
    share, kept : share of the members that must keep the limit, 0.95 or what an accepted risk leaves; and the value
        that at least so many keep, p95 or p05 where it is 0.95.
    margin : from the judged value to the limit, negative beyond it. The judged value is `kept`, and min for those that
        no drive may break (`NEVER_BROKEN`).
    ok : margin >= 0.
    exceeding : number of members beyond the limit.
    worst_member : the member with the worst value.
    source, assumed : where the limit comes from, and whether it is a guess.
    """

    quantity: str
    unit: str
    sense: Literal["at most", "at least"]
    limit: float
    p05: float
    p50: float
    p95: float
    min: float
    max: float
    share: float
    kept: float
    margin: float
    ok: bool
    exceeding: int
    worst_member: int
    source: str
    assumed: bool

    @property
    def worst(self) -> float:
        """The worst value of any member."""
        return self.max if self.sense == "at most" else self.min

    @property
    def judged(self) -> float:
        """The value that is held against the limit; minus infinite where no height is below some drive's body."""
        return self.worst if self.quantity in NEVER_BROKEN or self.worst == -math.inf else self.kept

    @property
    def used(self) -> float:
        """Share of what the limit allows that the worst member uses, above 1 beyond the limit. [-]"""
        if self.sense == "at most":
            return self.worst / self.limit
        if self.worst <= 0 or self.limit == 0:
            return math.inf if self.worst < self.limit else 0.0
        return self.limit / self.worst


@dataclass(frozen=True, slots=True)
class Worst:
    """The member that comes nearest to a limit or furthest beyond it, or the first that did not end.

    Attributes
    ----------
    member : its number, from 0.
    parameters : its swept soil parameters, in the units of their names.
    why : the limit and its value, or how it ended.
    """

    member: int
    parameters: dict[str, float]
    why: str


@dataclass(frozen=True, slots=True)
class Verdict:
    """The judgement of a prediction.

    Attributes
    ----------
    verdict : `go`, `no-go`, or `not-determined` where that hangs on what is not known of the ground.
    reasons : why not, one sentence each; empty for `go`.
    notes : what a reader should know all the same.
    limits : one entry for each limit of the plan that can be judged; empty when no member finished.
    endpoint : spread of the ends of the members that finished, None when none did.
    outcomes : outcome sentence to number of members.
    invalid_share : share of wheel states outside the wheel model's validity (|s| > 0.6, in the air, too deep).
    validity : the same by kind.
    worst : the worst member.
    failed, members : drives that broke a limit or did not end, of so many.
    accepted_risk : chance of failing that was accepted, and the rule of the verdict; None where 95 % must keep each
        limit and all must end. [-]
    keep_outs : circles to keep out of that drives come nearest to, the worst first.
    """

    verdict: Literal["go", "no-go", "not-determined"]
    reasons: tuple[str, ...]
    notes: tuple[str, ...]
    limits: tuple[Judgement, ...]
    endpoint: Endpoint | None
    outcomes: dict[str, int]
    invalid_share: float
    validity: Validity
    worst: Worst
    failed: int
    members: int
    accepted_risk: float | None = None
    keep_outs: tuple[Encounter, ...] = ()

    @property
    def doubt(self) -> Doubt:
        """Why not to drive, begun by the verdict; none for `go`."""
        return Doubt() if self.verdict == "go" else Doubt.of(*self.reasons, verdict=self.verdict)

    @property
    def arrived(self) -> int:
        """Drives that came to the end of the plan, of which limits and ends are."""
        return self.outcomes.get(OUTCOMES[0], 0)

    @property
    def chance(self) -> Chance:
        """Of failing, on soils drawn as these were."""
        return Chance(self.failed, self.members)


def arrivals(arrived: int, members: int) -> str:
    """The drives that limits and ends are of, after a number of them: all, or those that did not stop.

    >>> arrivals(3, 3), arrivals(1, 3)
    ('3 drives', 'the 1 that arrived')
    """
    return counted(members, "drive") if arrived == members else f"the {arrived} that arrived"


def headword(verdict: Verdict) -> str:
    """The verdict as a title has it: GO, NO-GO or NOT DETERMINED."""
    return verdict.verdict.upper().replace("NOT-", "NOT ")


def judge(prediction: Prediction, plan: Plan | None = None) -> Verdict:
    """Hold a prediction against the limits of its plan.

    It is `go` when every member finished, at least 95 % of them keep each limit, and none enters a circle that the plan
    keeps out of, draws more than the battery may give, or has unknown ground below its body; and when at most 5 % of
    the wheel states are beyond the wheel model. Limits that the plan leaves out are the rover's own. Members count
    alike: on a grid of soils that is a share of the grid, not a probability. Per member the worst value over wheels and
    distance counts, at the recorded samples. Percentiles are over the members that finished. `plan` replaces the plan
    that was driven, to try other limits and circles. Raises ParameterError for limits that this rover cannot have.

    With an `accepted_risk` of the plan it is `go` when the chance to break any limit or not to end, the mean of
    Jeffreys' law as `twin plan` counts it, is at most that, and no circle is entered and no battery empty. Fewer
    members than can promise the risk are held against the first rule.
    """
    if plan is not None and plan is not prediction.plan:
        prediction = dataclasses.replace(prediction, plan=plan)
    check_limits(prediction.plan.limits, prediction.rover, prediction.plan.origin)
    finished = prediction.finished
    worst = worst_values(prediction)
    risk = prediction.plan.accepted_risk
    risk = None if risk is None or prediction.members < risk.least_drives else risk
    share = (risk or USUAL).keeping
    limits = worst.items() if finished.any() else ()
    judged = tuple(j for one in limits if (j := _judge_limit(prediction, *one, share)) is not None)
    outcomes = {
        OUTCOMES[int(k)]: int(n) for k, n in zip(*np.unique(prediction.outcome, return_counts=True), strict=True)
    }
    chance = Chance(int((~keeps_limits(prediction, worst)).sum()), prediction.members)
    early = [
        f"{n} of {counted(prediction.members, 'drive')} {'ends' if n == 1 else 'end'} early: {text}"
        f"{_at_the_start(prediction, text)}"
        for text, n in outcomes.items()
        if text != OUTCOMES[0]
    ]
    reasons = early if risk is None else _beyond(risk, chance)
    accepted = [] if risk is None else [_within(risk, chance), *early]
    among = arrivals(int(finished.sum()), prediction.members)
    reasons += [_reason(j, among) for j in judged if not j.ok and math.isfinite(j.judged)]
    near = tuple(encounters(prediction))
    reasons += [_crossed(one, prediction.members) for one in near if one.margin_m < 0]
    states = validity(prediction)
    touches = False
    if any(one.quantity == "clearance_m" for one in judged):
        least, unknown = clearance(prediction)
        touches, reasons = bool((least[prediction.reached] < 0).any()), reasons + _over_unknown(prediction, unknown)
    reasons += _beyond_model(states)
    return Verdict(
        verdict="no-go" if reasons else "go",
        reasons=tuple(reasons),
        notes=(*accepted, *_notes(prediction, judged, states, touches)),
        limits=judged,
        endpoint=endpoint_spread(prediction) if finished.any() else None,
        outcomes=outcomes,
        invalid_share=states.invalid_share,
        validity=states,
        worst=_worst(prediction, judged),
        failed=chance.failed,
        members=chance.drives,
        accepted_risk=None if risk is None else risk.share,
        keep_outs=near,
    )


def undecided(verdict: Verdict, plain: Verdict, unresolved: Unresolved) -> Verdict:
    """A no-go of drives on drawn ground, beside the verdict of drives on what the terrain's nodes show.

    It stays where these are no-go, too, or where three quarters of the draws fail. Between, the ground that nobody has
    seen decides, and the verdict is `not-determined`.
    """
    share = verdict.failed / verdict.members
    if plain.verdict == "no-go" or share >= MOST_DRAWS:
        return verdict
    why = (
        f"the ground between nodes {unresolved.spacing_m:g} m apart decides, and nobody has seen it: if it is smooth, "
        f"the plan keeps its limits; if it is as rough as elsewhere on the Moon, {percent(share)} of the drives fail; "
        f"heights every {unresolved.deciding_m:.2g} m, a wheel's radius, would decide"
    )
    return dataclasses.replace(verdict, verdict="not-determined", reasons=(why, *verdict.reasons))


def _over_unknown(prediction: Prediction, share: FloatArray) -> list[str]:
    """Where some of the body is over ground whose height nobody knows; `share` is of `clearance`."""
    unknown = (share > 0) & prediction.reached
    if not unknown.any():
        return []
    member, sample = np.unravel_index(int(unknown.argmax()), unknown.shape)
    x, y = prediction.places_m[member, sample]
    return [
        f"the height of the ground below the body is not known in {int(unknown.any(axis=1).sum())} of "
        f"{prediction.members} drives, first at x {x:.2f} m, y {y:.2f} m"
    ]


def _beyond_model(states: Validity) -> list[str]:
    if states.beyond_share <= MOST_BEYOND:
        return []
    return [
        f"the wheel model does not hold for {percent(states.beyond_share)} of the wheel states; at most "
        f"{percent(MOST_BEYOND)} are allowed"
    ]


def _beyond(risk: AcceptedRisk, chance: Chance) -> list[str]:
    """Why the chance of failing is too large, where it is."""
    if risk.accepts(chance):
        return []
    return [
        f"{chance.failed} of {chance.drives} drives break a limit or do not end: a risk of {percent(chance.risk)}, "
        f"{percent(risk.share)} is accepted"
    ]


def _within(risk: AcceptedRisk, chance: Chance) -> str:
    """A note that the accepted risk decides, and what the chance of failing is."""
    return (
        f"{chance.failed} of {chance.drives} drives break a limit or do not end: a risk of {percent(chance.risk)}, at "
        f"most {percent(chance.high)}; {percent(risk.share)} is accepted, and decides"
    )


def _judge_limit(prediction: Prediction, limit: Limit, values: FloatArray, share: float) -> Judgement | None:
    """A limit that a share of the members must keep, of whose worst `values` (members,); None where no member that
    finished has a value.
    """
    members = np.flatnonzero(prediction.finished & ~np.isnan(values))
    if not members.size:
        return None
    values = values[members]
    sign = 1.0 if limit.sense == "at most" else -1.0
    level = float(sign * np.quantile(sign * values, share, method="inverted_cdf"))
    judgement = Judgement(
        quantity=limit.quantity,
        unit=limit.unit,
        sense=limit.sense,
        limit=limit.limit,
        p05=least_of_95(values),
        p50=float(np.median(values)),
        p95=most_of_95(values),
        min=float(values.min()),
        max=float(values.max()),
        share=share,
        kept=level,
        margin=math.nan,
        ok=False,
        exceeding=int(broken(limit, values).sum()),
        worst_member=int(members[(sign * values).argmax()]),
        source=limit.source,
        assumed=limit.assumed,
    )
    margin = sign * (limit.limit - judgement.judged)
    return dataclasses.replace(judgement, margin=margin, ok=margin >= 0)


def _reason(judgement: Judgement, among: str) -> str:
    up = judgement.sense == "at most"
    if judgement.quantity == "keep_out_m":
        return (
            f"keep_out_m: the nearest drive leaves {judgement.min:.3g} m, less than the limit of {judgement.limit:g} m"
        )
    if judgement.quantity == "battery_charge":
        share = f"charge falls below {judgement.limit:g}" if judgement.limit else "battery runs empty"
        return f"battery_charge: the {share} in {judgement.exceeding} of {among}"
    if judgement.quantity == "motor_load":
        share = f"{100 * judgement.share:g} %"
        return (
            f"motor_load: in {judgement.exceeding} of {among} a wheel needs more torque than its motor gives "
            f"for long at its rate; {share} of the drives need at most {judgement.kept:.3g} times as much"
        )
    side = "below" if up else "above"
    most = f"; {100 * judgement.share:g} % stay {side} {judgement.kept:.3g}" if math.isfinite(judgement.kept) else ""
    stuck = judgement.quantity == "slip_ratio" and f"{judgement.kept:.2g}" == "1"
    meaning = " (slip 1: the wheels turn, but the rover stands or slides back)" if stuck else ""
    return f"{_broken_by(judgement, among)} {judgement.limit:g}{most}{meaning}"


def _broken_by(judgement: Judgement, among: str) -> str:
    one = judgement.exceeding == 1
    return f"{judgement.quantity}: {judgement.exceeding} of {among} {'breaks' if one else 'break'} the limit"


def _crossed(one: Encounter, members: int) -> str:
    place = f"x {one.x_m:.2f} m, y {one.y_m:.2f} m"
    return (
        f"'{one.name}' at x {one.zone_x_m:.2f} m, y {one.zone_y_m:.2f} m is entered by {one.entered_by} of {members} "
        f"drives, by {-one.margin_m:.3f} m after {one.distance_m:.1f} m of the way ({place})"
    )


def _worst(prediction: Prediction, judged: tuple[Judgement, ...]) -> Worst:
    stopped = np.flatnonzero(~prediction.finished)
    if stopped.size:
        member, why = int(stopped[0]), prediction.outcome_text(int(stopped[0]))
    else:
        tightest = max(judged, key=lambda j: j.used)
        member, why = tightest.worst_member, _nearness(tightest)
    return Worst(member, {name: float(values[member]) for name, values in prediction.parameters.items()}, why)


def _at_the_start(prediction: Prediction, outcome: str) -> str:
    """That drives with this outcome ended where they began, as on a rock; '' where one went on."""
    ended = prediction.outcome == OUTCOMES.index(outcome)
    return ", where it starts; start elsewhere" if (prediction.recorded[ended] <= 1).all() else ""


def _nearness(judgement: Judgement) -> str:
    unit = "" if judgement.unit == "-" else f" {judgement.unit}"
    how = "is farthest beyond its" if judgement.exceeding else "comes nearest to its"
    return f"{judgement.quantity} of {judgement.worst:.3g}{unit} {how} limit, {judgement.limit:g}{unit}"


def _notes(prediction: Prediction, judged: tuple[Judgement, ...], states: Validity, touches: bool) -> tuple[str, ...]:
    notes = []
    if prediction.terrain.synthetic:
        notes.append("the terrain is synthetic; the verdict says nothing about a real site")
    if assumed := [j.quantity for j in judged if j.assumed]:
        notes.append(f"assumed limits: {', '.join(assumed)}")
    if implied := [f"{j.quantity} {j.limit:.3g}" for j in judged if j.source.startswith(PLAN_HAS_NONE)]:
        notes.append(f"limits that the plan leaves out are the rover's own: {', '.join(implied)}")
    given, lacking = [limit.quantity for limit in prediction.plan.limits], not_judged(prediction)
    notes += [f"{name} was not judged: {lacking[name]}" for name in given if name in lacking]
    slip = prediction.states[prediction.reached][..., STATE_COLUMNS.index("slip_ratio")]
    if slip.size and -slip.min() > slip.max():
        notes.append(f"limits count the size of slip_ratio; the largest, {slip.min():.3g}, is that of a braking wheel")
    if touches:
        notes.append("the chassis would touch the ground; the drives go on as if it did not")
    among = arrivals(int(prediction.finished.sum()), prediction.members)
    few = [_broken_by(j, among) for j in judged if j.exceeding and j.ok]
    return (*notes, *validity_notes(states), *few)
