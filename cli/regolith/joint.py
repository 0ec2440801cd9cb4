"""The joint posterior of `lunarsci regolith identify --joint`: asked for, as result keys, tables and files."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import typer

from lunarsci.inputs import read_input
from lunarsci.provenance import sha256
from lunarsci.regolith.contact import Bulldozing, ContactModel, ShearLaw
from lunarsci.regolith.fit_verdict import verdict_line
from lunarsci.regolith.joint import SoilPosterior, infer_soil
from lunarsci.regolith.joint_forecast import PredictedStates, belief_after, predict_states
from lunarsci.regolith.joint_laws import WheelLaw, WheelLawScore, candidates, compare_laws
from lunarsci.regolith.prior import CONTACT, PARAMETERS, read_prior
from lunarsci.regolith.states import MeasurementErrors, WheelStates, read_states
from lunarsci.regolith.wheel import Wheel, read_wheel
from lunarsci.rovers.description import read_rover

from ..shared.table import TextTable, to_csv

__all__ = [
    "IdentifyInputs",
    "IntervalRequest",
    "JointRequest",
    "Together",
    "infer",
    "joint_record",
    "joint_tables",
    "read_inputs",
    "soil_file",
]

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
HOW = {"normal": "of a normal law", "sample": "of draws from the posterior", "profile": "by profile"}
SHOWN_SHARE, SHOWN_WEIGHT, MOST_SHOWN, MOST_STATES = 0.5, 0.3, 3, 30


@dataclass(frozen=True, slots=True)
class IdentifyInputs:
    """What `regolith identify` starts from."""

    states: WheelStates
    wheel: Wheel
    inputs: dict[str, str]
    tables: dict[str, str]
    assumed: tuple[str, ...]


def read_inputs(states: str, rover: str, errors: MeasurementErrors) -> IdentifyInputs:
    """Read the wheel states and the wheel."""
    description = read_rover(rover)
    wheel = read_wheel(description)
    source = read_input(states)
    tables = {f"{rover} (rover)": sha256(description.text.encode())}
    assumed = tuple(name for name in description.assumed if name.startswith("wheel."))
    return IdentifyInputs(read_states(source, wheel, errors), wheel, {source.name: source.sha256}, tables, assumed)


@dataclass(frozen=True, slots=True)
class IntervalRequest:
    """How the intervals of the joint posterior are made; a normal law where neither is set."""

    sample: bool
    profile: bool


@dataclass(frozen=True, slots=True)
class JointRequest:
    """What `--joint` is asked for: priors, law and its choices, model error, seed, intervals."""

    prior: str | None
    law: str
    exact: bool
    shear: ShearLaw
    bulldozing: Bulldozing
    density_kg_m3: float
    gravity_m_s2: float
    contact: bool
    model_error: float | None
    seed: int
    intervals: IntervalRequest

    def given(self) -> WheelLaw:
        """The law that the options name. Raises a usage error for choices of integrals without --exact."""
        beyond = self.shear != "separate" or self.bulldozing != "none" or self.contact
        if self.law == "auto" and (beyond or self.exact):
            raise typer.BadParameter(
                "--law auto chooses itself; leave out --exact, --shear, --bulldozing and --contact"
            )
        if beyond and not self.exact:
            raise typer.BadParameter("--shear, --bulldozing and --contact belong to --exact; add it")
        model = ContactModel(
            shear=self.shear,
            bulldozing=self.bulldozing,
            density_kg_m3=self.density_kg_m3,
            gravity_m_s2=self.gravity_m_s2,
        )
        return WheelLaw(model if self.exact else None, self.contact)


@dataclass(frozen=True, slots=True)
class Together:
    """The joint posterior, further files that it rests on, scores of the laws compared, and forces predicted."""

    posterior: SoilPosterior
    inputs: dict[str, str]
    scores: Sequence[WheelLawScore] = ()
    predicted: PredictedStates | None = None


def infer(
    given: "IdentifyInputs",
    asked: JointRequest,
    predict: str | None,
    predict_rover: str | None,
    progress: Callable[[int, int], None],
) -> Together:
    """The joint posterior of the states."""
    law, scores = asked.given(), list[WheelLawScore]()
    source = read_input(asked.prior) if asked.prior else None
    prior = read_prior(source, contact=asked.contact or asked.law == "auto") if source else None
    states, wheel = given.states, given.wheel
    if asked.law == "auto":
        laws = candidates(states, asked.density_kg_m3, asked.gravity_m_s2)
        law, scores = compare_laws(states, wheel, laws, prior, model_error=asked.model_error, progress=progress)
    found = infer_soil(
        states,
        wheel,
        prior,
        model=law.model,
        contact=law.contact,
        model_error=asked.model_error,
        sample=asked.intervals.sample,
        profile=asked.intervals.profile,
        seed=asked.seed,
        progress=progress,
    )
    told = read_input(predict) if predict else None
    other = wheel if predict_rover is None else read_wheel(predict_rover)
    forces = predict_states(found, other, told, seed=asked.seed) if told else None
    inputs = {item.name: item.sha256 for item in (source, told) if item}
    return Together(found, inputs, scores, forces)


def soil_file(found: SoilPosterior, path: Path) -> bytes:
    """Soils for `twin predict`, with the verdict: draws as CSV, or a belief as JSON."""
    if path.suffix.lower() == ".json":
        return belief_after(found).to_json().encode()
    rows = [dict(zip(PARAMETERS, map(float, row[: len(PARAMETERS)]), strict=True)) for row in found.draws]
    return (verdict_line(found.verdict) + to_csv(rows)).encode()


def joint_record(together: Together) -> dict[str, Any]:
    """The key `joint`."""
    found = together.posterior
    ends = found.intervals()
    spread = found.sd
    correlation = found.covariance / spread[:, None] / spread
    records = {
        name: dict(zip(("median", "low", "high", "low95", "high95"), ends[name], strict=True))
        | {
            "prior": {"of": found.prior[name].of, "median": found.prior[name].median, "sd": found.prior[name].sd},
            "shrinkage": found.shrinkage[name],
            "determined": name in found.determined,
        }
        for name in found.names
    }
    return {
        "parameters": {name: records[name] for name in PARAMETERS},
        "contact": {name: records[name] for name in CONTACT} if len(records) > len(PARAMETERS) else None,
        "order": list(found.names),
        "correlation": correlation.tolist(),
        "combinations": [{"left_of_prior": left, "weights": weights} for left, weights in found.combinations()],
        "outliers": list(found.outliers),
        "chi_square": found.chi_square,
        "degrees": found.degrees,
        "persistence": found.persistence,
        "intervals": found.how,
        "verdict": found.verdict.to_dict(),
        "tail": found.tail,
        "stretch": list(found.stretch),
        "laws": [asdict(score) | {"law": score.law.name} for score in together.scores],
        "predicted": together.predicted.to_dict() if together.predicted else None,
    }


def joint_tables(together: Together) -> list[TextTable]:
    """Parameters with their intervals, what is known of combinations, laws compared, forces predicted."""
    found = together.posterior
    ends = found.intervals()
    rows = []
    for name in found.names:
        label, unit = LABELS[name]
        median, low, high, low95, high95 = ends[name]
        known = "determined" if name in found.determined else f"{100 * (1 - found.shrinkage[name]):.0f} % of the prior"
        rows.append([label, _digits(median), f"{_digits(low)} to {_digits(high)}", f"{_digits(low95)} to "
                     f"{_digits(high95)}", unit, known])  # fmt: skip
    notes = [*_fit(found), *_combinations(found)]
    if found.outliers:
        notes.append(f"left out as outliers: {', '.join(found.outliers)}")
    headers = ["parameter", "median", "68 %", "95 %", "unit", "from the states"]
    table = TextTable(headers, rows, title=f"All states together, intervals {HOW[found.how]}", notes=notes)
    return [table, *_laws(together), *_predicted(together)]


def _fit(found: SoilPosterior) -> list[str]:
    """How well the law explains the states, in words."""
    verdict = found.verdict
    reduced = "-" if verdict.reduced_chi_square is None else f"{verdict.reduced_chi_square:.2f}"
    source = "given" if verdict.model_error_from == "given" else "found from the residuals"
    shares = ", ".join(
        f"{name} {share:.3f}" for name, share in zip(("F_N", "F_DP", "F_L"), verdict.model_error, strict=True)
    )
    return [
        f"law: {verdict.model}; chi-square {found.chi_square:.1f} of {found.degrees} forces, reduced {reduced}",
        f"model error as a share of the load, {source}: {shares}",
        f"assumed: {'; '.join(verdict.assumed)}",
    ]


def _laws(together: Together) -> list[TextTable]:
    if not together.scores:
        return []
    rows = [
        [s.law.name, *("-" if v is None else f"{v:.1f}" for v in (s.score, s.behind, s.behind_sigma)),
         "-" if s.model_error is None else ", ".join(f"{share:.3f}" for share in s.model_error)]
        for s in together.scores
    ]  # fmt: skip
    notes = ["score: ln density of groups of states left out; taken is the simplest law within one ± of the best"]
    headers = ["law", "score", "behind", "±", "model error F_N, F_DP, F_L"]
    return [TextTable(headers, rows, title="Laws compared", notes=notes)]


def _predicted(together: Together) -> list[TextTable]:
    found = together.predicted
    if found is None:
        return []
    rows = [
        [record["id"], *(f"{record[name]['value']:.1f} [{record[name]['low90']:.1f}, {record[name]['high90']:.1f}]"
                         for name in ("drawbar_pull_n", "lateral_force_n"))]
        for record in found.records[:MOST_STATES]
    ]  # fmt: skip
    return [TextTable(["state", "F_DP [N], 90 %", "F_L [N], 90 %"], rows, title="Predicted", notes=found.notes())]


def _combinations(found: SoilPosterior) -> Sequence[str]:
    """The best known directions, in words."""
    lines = []
    for left, weights in found.combinations()[:MOST_SHOWN]:
        if left < SHOWN_SHARE:
            terms = [f"{value:+.1f} {name}" for name, value in weights.items() if abs(value) > SHOWN_WEIGHT]
            lines.append(f"known to {100 * left:.0f} % of the prior: {' '.join(terms)} (in units of the prior's sd)")
    return lines


def _digits(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
