"""Uncertain forces along a motion as result keys and tables."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from lunarsci.twin.jobs.drive_inputs import DriveInputs
from lunarsci.twin.loads.alternating import AlternatingEstimate
from lunarsci.twin.loads.load_ensemble import TOTALS, LoadEnsemble, Shares
from lunarsci.twin.loads.prescribed_motion import FORCES
from lunarsci.twin.outcomes import FINISHED, OUTCOMES

from ..shared.table import TextTable

__all__ = ["doubt_of", "motion_result", "motion_tables"]

SYMBOLS = {"normal_force_n": "F_N", "drawbar_pull_n": "F_DP", "lateral_force_n": "F_L"}
UNITS = {"ahead": "N", "left": "N", "moment": "N m"}
SURPRISING, WORST_REDUCED = 4.0, 1.5
"""Reduced chi-square of what is missing beyond which no drawn soil explains the motion, and of the states; assumed."""


def motion_result(
    scene: DriveInputs,
    found: LoadEnsemble,
    turned: AlternatingEstimate | None,
    draws: int,
    options: dict[str, Any],
    basis: str,
    uncertain: bool,
) -> dict[str, Any]:
    """The key `result`."""
    return {
        "of": "uncertain motion",
        "rover": scene.rover.name,
        "made_for": scene.made_for,
        "terrain": {"name": scene.terrain.name, "synthetic": scene.terrain.synthetic},
        "weight_n": scene.rover.mass_kg * scene.rover.gravity_m_s2,
        "assumed_of_rover": list(scene.description.assumed),
        "draws": draws,
        "poses": {"known": int(found.known.sum()), "all": len(found.known)},
        "motion_errors": {"correlation_m": options["correlation_m"], "basis": basis} if uncertain else None,
        "balance_error": options["balance_error"],
        "wheels": _wheels(found),
        "shares": {
            name: {
                "before": asdict(found.shares(k, balanced=False)),
                "after": asdict(found.shares(k, balanced=True)),
            }
            for k, name in enumerate(FORCES)
        }
        if found.known.any()
        else None,
        "totals": _totals(found) if found.known.any() else None,
        "iteration": None if turned is None else _iteration(turned),
    }


def _wheels(found: LoadEnsemble) -> list[dict[str, Any]]:
    known = found.known
    if not known.any():
        return []
    return [
        {"wheel": wheel}
        | {
            name: {
                "mean": float(found.after[known, w, k].mean()),
                "sigma": _rms(found.after_sigma[known, w, k]),
                "mean_before": float(found.before[known, w, k].mean()),
                "sigma_before": _rms(found.before_sigma[known, w, k]),
            }
            for k, name in enumerate(FORCES)
        }
        for w, wheel in enumerate(found.held.rover.wheels)
    ]


def _totals(found: LoadEnsemble) -> dict[str, dict[str, float]]:
    known = found.known
    return {
        name: {
            "missing_before": _rms(found.residual_before[known, k]),
            "missing_after": _rms(found.residual_after[known, k]),
            "sigma_before": _rms(found.total_before[known, k]),
            "sigma_after": _rms(found.total_after[known, k]),
        }
        for k, name in enumerate(TOTALS)
    }


def _iteration(turned: AlternatingEstimate) -> dict[str, Any]:
    belief = turned.posterior.belief
    left = belief.left_of_prior
    return {
        "verdict": turned.verdict,
        "converged": turned.converged,
        "rounds": [
            {
                "soil_moved_sd": each.soil,
                "forces_moved_share": each.forces,
                "reduced_chi_square_sinkages": each.reduced_sinkages,
                "reduced_chi_square_totals": each.reduced_totals,
            }
            for each in turned.rounds
        ],
        "parameters": {
            name: {"median": median, "low": low, "high": high, "left_of_prior": left[name]}
            for name, (median, low, high) in belief.intervals().items()
        },
    }


def motion_tables(
    scene: DriveInputs, found: LoadEnsemble, turned: AlternatingEstimate | None, title: str, notes: Sequence[str]
) -> list[TextTable]:
    """For people: forces of each wheel, where their uncertainty comes from, totals, rounds."""
    if not found.known.any():
        return [TextTable([], [], title=title, notes=[*notes, "no pose has forces"])]
    tables = [_force_table(found, title), _share_table(found), _total_table(found, notes)]
    return tables if turned is None else [*tables, _round_table(turned), _soil_table(turned)]


def _force_table(found: LoadEnsemble, title: str) -> TextTable:
    rows = [
        [
            each["wheel"],
            *(
                f"{each[name][f'mean{end}']:.2f} ± {each[name][f'sigma{end}']:.2f}"
                for name in FORCES
                for end in ("_before", "")
            ),
        ]
        for each in _wheels(found)
    ]
    headers = ["wheel", *(f"{SYMBOLS[name]} {when} [N]" for name in FORCES for when in ("assumed", "balanced"))]
    return TextTable(headers, rows, title=f"{title}; mean along the drive ± standard deviation at a pose")


def _share_table(found: LoadEnsemble) -> TextTable:
    rows = []
    for k, name in enumerate(FORCES):
        for when, balanced in (("assumed", False), ("balanced", True)):
            shares: Shares = found.shares(k, balanced=balanced)
            parts = (shares.soil, shares.motion, shares.balance, shares.together)
            rows.append(
                [SYMBOLS[name], when, *(f"{100 * part:.0f} %" for part in parts), f"{100 * shares.of_force:.1f} %"]
            )
    headers = ["force", "", "soil", "motion", "balance", "only jointly", "soil moves the force by"]
    return TextTable(headers, rows, title="Where the variance of the forces comes from")


def _total_table(found: LoadEnsemble, notes: Sequence[str]) -> TextTable:
    rows = [[f"{name} [{UNITS[name]}]", *(f"{row[key]:.2f}" for key in row)] for name, row in _totals(found).items()]
    headers = ["of all wheels", "missing, assumed soil", "balanced", "± assumed soil", "± balanced"]
    rows_notes = [
        "all wheels together supply what the balance asks for; how it shares out among them stays the assumed soil's",
        *notes,
    ]
    return TextTable(headers, rows, title="What the wheels do not supply, root mean square", notes=rows_notes)


def _round_table(turned: AlternatingEstimate) -> TextTable:
    rows = [
        [
            str(number),
            f"{each.soil:.3g}",
            f"{100 * each.forces:.2g} %",
            f"{each.reduced_sinkages:.2f}",
            f"{each.reduced_totals:.2f}",
        ]
        for number, each in enumerate(turned.rounds, start=1)
    ]
    headers = ["round", "soil moved [sd]", "pulls moved", "chi² sinkages", "chi² totals"]
    rounds = "1 round" if len(rows) == 1 else f"{len(rows)} rounds"
    notes = [
        "the soil is judged by sinkages under the loads and by what all wheels pull together,",
        "never by single pulls, which came from a soil",
    ]
    said = f"converged after {rounds}" if turned.converged else f"{turned.verdict}, {rounds}"
    return TextTable(headers, rows, title=f"Forces and soil in turn: {said}", notes=notes)


def _soil_table(turned: AlternatingEstimate) -> TextTable:
    found = _iteration(turned)["parameters"]
    rows = [
        [name, *(f"{row[key]:.4g}" for key in ("median", "low", "high")), f"{100 * row['left_of_prior']:.0f} %"]
        for name, row in found.items()
    ]
    headers = ["parameter", "median", "68 % from", "to", "left of the prior"]
    return TextTable(headers, rows, title="The soil after the last round")


def doubt_of(found: LoadEnsemble, turned: AlternatingEstimate | None) -> str:
    """Why the result is not to be trusted, or nothing."""
    failed = sorted({OUTCOMES[int(code)] for code in found.held.outcome if code != FINISHED})
    if failed:
        return f"poses without equilibrium: {'; '.join(failed)}"
    if not found.known.any():
        return "no pose has forces: all are at halts, or too few of the drawn soils carry the rover"
    surprise = float(np.median(found.surprise[found.known]))
    if surprise > SURPRISING and turned is None:
        return (
            f"what the wheels do not supply is beyond the drawn soils (reduced chi-square {surprise:.1f}): the soil, "
            "the terrain or the motion is not as given"
        )
    if turned is None:
        return ""
    if not turned.converged:
        return f"forces and soil: {turned.verdict} within {len(turned.rounds)} rounds; give more, or look at the states"
    if max(turned.posterior.reduced) > WORST_REDUCED:
        worst = max(turned.posterior.reduced)
        return f"no soil explains the states (reduced chi-square {worst:.1f}); look at their errors and at the terrain"
    return ""


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
