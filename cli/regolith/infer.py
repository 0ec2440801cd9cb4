"""`lunarsci regolith infer`: all soil parameters from all wheel states at once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lunarsci.regolith.jobs.requests import InferRequest

from ..shared.command import command
from ..shared.emit import Report
from ..shared.options import Output, option
from ..shared.table import TextTable, significant
from .identify import OPTIONS as SINGLE
from .identify import States, read_as, single_tables, wheel_text

if TYPE_CHECKING:
    from lunarsci.regolith.inference.posterior import SoilPosterior
    from lunarsci.regolith.jobs.infer import InferredSoil

LAW, INTERVALS, OTHER = "Wheel-soil law", "Intervals", "Forces of other states"
LABELS = {
    "stiffness_kpa_m_n": ("stiffness K_s", "kPa/m^N"),
    "sinkage_exponent": ("sinkage exponent n0", "-"),
    "sinkage_exponent_slip": ("its rise with slip n1", "-"),
    "cohesion_pa": ("cohesion c", "Pa"),
    "friction_angle_deg": ("internal friction angle φ", "deg"),
    "shear_modulus_mm": ("shear modulus K_x", "mm"),
    "external_friction_angle_deg": ("external friction angle φ_y", "deg"),
    "lateral_modulus_mm": ("lateral shear modulus K_y", "mm"),
    "skid_exponent_slip": ("its fall with skid n2", "-"),
    "max_stress_c1": ("angle of largest stress c1", "-"),
    "max_stress_c2": ("its rise with slip c2", "-"),
    "exit_c3": ("exit angle c3", "-"),
}
"""Words and unit of each parameter in tables."""
HOW = {"normal": "of a normal law", "sample": "of draws from the posterior", "profile": "by profile"}
"""How intervals were made, in words."""
SHOWN_SHARE, SHOWN_WEIGHT, MOST_SHOWN, MOST_STATES = 0.5, 0.3, 3, 30
"""Of combinations of parameters: width left of the prior's below which one is shown, weight of a parameter from which
on it is named, and how many are shown; and predicted states in the table."""
OPTIONS = {name: SINGLE[name] for name in SINGLE if name != "reading"} | {
    "prior": option("--prior-file", metavar="FILE.toml"),
    "model_error": option(panel=LAW),
    "law": option(panel=LAW),
    "exact": option(panel=LAW),
    "shear": option(panel=LAW),
    "bulldozing": option(panel=LAW),
    "density": option(panel=LAW),
    "gravity": option(kind=str, metavar="G", panel=LAW),
    "contact": option(panel=LAW),
    "sample": option("--draw-posterior", panel=INTERVALS),
    "profile": option(panel=INTERVALS),
    "predict": option(metavar="FILE.csv", panel=OTHER),
    "predict_rover": option(panel=OTHER),
}
Posterior = Annotated[
    Path | None,
    typer.Option(
        "--posterior",
        help="Soils for `twin predict --soil`: draws as CSV, a belief as JSON; both carry the verdict.",
    ),
]

OTHERS = "values are those of this wheel with this law: a plate or a shear box may find others"
EXAMPLES = (
    "lunarsci regolith infer lunarsci-demo/wheel_states.csv -o soil.json",
    "lunarsci regolith infer lunarsci-demo/wheel_states.csv --model-error 0.05",
)


@command("infer", EXAMPLES, OPTIONS)
def infer(states: States, request: InferRequest, output: Output, posterior: Posterior = None) -> Report:
    """All soil parameters from all wheel states at once, as a posterior; below it what each state gives by itself.

    The options that assume a parameter are for these single states alone. Exit code 3: no soil of the law explains the
    states. An option of the integrals, such as --shear, stands for --exact, too.
    """
    from lunarsci.regolith.jobs.infer import infer as infer_soil

    output.check_extra("--posterior", posterior, (".csv", ".json"))
    soil = infer_soil(states, request, progress=output.progress("the posterior"))
    extras = {posterior: lambda: soil.soils(posterior.suffix.lower())} if posterior else {}
    return Report(soil, result_tables(soil), extras=extras)


def result_tables(soil: InferredSoil) -> list[TextTable]:
    """All states together, then what each gives by itself."""
    from lunarsci.regolith.jobs.identify import alone_title

    return [*_joint_tables(soil), *single_tables(soil, alone_title(soil.held))]


def _joint_tables(soil: InferredSoil) -> list[TextTable]:
    """Parameters with their intervals, what is known of combinations, laws compared, forces predicted."""
    from lunarsci.pages.words import percent

    posterior = soil.posterior
    ends = posterior.intervals()
    rows = []
    for name in posterior.names:
        label, unit = LABELS[name]
        median, low, high, low95, high95 = ends[name]
        how = percent((1 - posterior.shrinkage[name]) ** 2) + (", laws differ" if name in posterior.disputed else "")
        ranges = [f"{significant(one)} to {significant(other)}" for one, other in ((low, high), (low95, high95))]
        rows.append([label, significant(median), *ranges, unit, how])
    notes = [*_fit(posterior), *_combinations(posterior), OTHERS, *read_as(soil)]
    if posterior.outliers:
        notes.append(f"left out as outliers: {', '.join(posterior.outliers)}")
    title = f"The soil of all {wheel_text(soil)}, intervals {HOW[posterior.how]}"
    headers = ["parameter", "median", "68 %", "95 %", "unit", "variance left"]
    table = TextTable(headers, rows, title=title, notes=notes)
    return [table, *_laws(soil), *_predicted(soil)]


def _fit(posterior: SoilPosterior) -> list[str]:
    """How well the law explains the states, in words."""
    verdict = posterior.verdict
    reduced = "-" if verdict.reduced_chi_square is None else f"{verdict.reduced_chi_square:.2f}"
    source = "given" if verdict.model_error_from == "given" else "found from the residuals"
    shares = ", ".join(
        f"{name} {share:.3f}" for name, share in zip(("F_N", "F_DP", "F_L"), verdict.model_error, strict=True)
    )
    return [
        f"law: {verdict.model}; chi-square {posterior.chi_square:.1f} of {posterior.degrees} forces, reduced {reduced}",
        f"model error as a share of the load, {source}: {shares}",
        f"assumed: {'; '.join(verdict.assumed)}",
    ]


def _laws(soil: InferredSoil) -> list[TextTable]:
    if not soil.scores:
        return []
    rows = [
        [s.law.name, *("-" if v is None else f"{v:.1f}" for v in (s.score, s.behind, s.behind_sigma)),
         "-" if s.model_error is None else ", ".join(f"{share:.3f}" for share in s.model_error)]
        for s in soil.scores
    ]  # fmt: skip
    notes = [
        "score: ln density of groups of states left out. Of the laws less than one ± behind the best, the simplest is "
        "used; a law that fits the contact angles comes first, if one is less than two ± behind"
    ]
    headers = ["law", "score", "behind", "±", "model error F_N, F_DP, F_L"]
    return [TextTable(headers, rows, title="Laws compared", notes=notes)]


def _predicted(soil: InferredSoil) -> list[TextTable]:
    predicted = soil.predicted
    if predicted is None:
        return []
    rows = [
        [record["id"], *(f"{record[name]['value']:.1f} [{record[name]['low90']:.1f}, {record[name]['high90']:.1f}]"
                         for name in ("drawbar_pull_n", "lateral_force_n"))]
        for record in predicted.records[:MOST_STATES]
    ]  # fmt: skip
    return [TextTable(["state", "F_DP [N], 90 %", "F_L [N], 90 %"], rows, title="Predicted", notes=predicted.notes())]


def _combinations(posterior: SoilPosterior) -> Sequence[str]:
    """The best known directions, in words."""
    from lunarsci.pages.words import percent

    lines = []
    for left, weights in posterior.combinations()[:MOST_SHOWN]:
        if left < SHOWN_SHARE:
            terms = [f"{value:+.1f} {name}" for name, value in weights.items() if abs(value) > SHOWN_WEIGHT]
            lines.append(
                f"well-known combination: {' '.join(terms)}, each in units of its prior's error; "
                f"it is known to {percent(left)} of the prior's width"
            )
    return lines
