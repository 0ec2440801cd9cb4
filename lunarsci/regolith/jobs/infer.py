"""All soil parameters from all wheel states at once, as a posterior."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import TYPE_CHECKING, Any

from lunarsci.io.inputs import Source, read_input
from lunarsci.options import request_of
from lunarsci.regolith.columns import written_for
from lunarsci.regolith.inference.posterior import SoilPosterior, infer_soil
from lunarsci.regolith.inference.prediction import (
    PredictedStates,
    WheelLaw,
    WheelLawScore,
    candidates,
    compare_laws,
    disputed,
    predict_states,
)
from lunarsci.regolith.jobs.identify import IdentifiedSoil, StatesOfWheel, assumptions_of, identified, read_wheel_states
from lunarsci.regolith.jobs.requests import InferRequest
from lunarsci.regolith.prior import prior_hash, read_prior
from lunarsci.regolith.states import COLUMNS
from lunarsci.regolith.wheel import ContactModel, read_wheel
from lunarsci.result import NOT_TO_BE_TRUSTED, Doubt, job

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def wheel_law_of(request: InferRequest) -> WheelLaw:
    """The law that the options name."""
    model = ContactModel(
        shear=request.shear,
        bulldozing=request.bulldozing,
        density_kg_m3=request.density,
        gravity_m_s2=float(request.gravity),
    )
    return WheelLaw(model if request.exact or request.beyond else None, request.contact)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InferredSoil(IdentifiedSoil):
    """The soil of all states together, beside what each state gives by itself.

    Attributes
    ----------
    posterior : of all parameters, with its verdict.
    scores : of the laws compared, where the law was chosen.
    predicted : forces of other states, None where they were not asked for.
    """

    posterior: SoilPosterior
    scores: Sequence[WheelLawScore]
    predicted: PredictedStates | None

    @property
    def held(self) -> Mapping[str, float]:
        """What single states are solved with, which the posterior does not assume."""
        site = self.identification.site
        taken = {name: one.value for name, one in site.items() if one.assumed and one.value is not None}
        return taken | {"shear_modulus_mm": self.identification.assumptions.shear_modulus_mm}

    @property
    def doubt(self) -> Doubt:
        verdict = self.posterior.verdict
        return Doubt.of("" if verdict.trusted else verdict.reason, verdict=NOT_TO_BE_TRUSTED)

    def to_dict(self) -> dict[str, Any]:
        joint = self.posterior.to_dict() | {
            "laws": [asdict(score) | {"law": score.law.name} for score in self.scores],
            "predicted": self.predicted.to_dict() if self.predicted else None,
        }
        return IdentifiedSoil.to_dict(self) | {"joint": joint}

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """The posterior, one row a parameter, beside the prior; single states are `identify`'s."""
        return self.posterior.rows()

    def answers(self) -> Sequence[Mapping[str, Any]]:
        """The same."""
        return self.rows()

    def figures(self) -> "Iterator[Figure]":
        """Prior and posterior of each parameter, then what each state allows by itself."""
        from lunarsci.regolith.figure import posterior_figure

        posterior = self.posterior
        title = f"all states together: {posterior.verdict.model} law, {len(posterior.residuals)} states"
        yield posterior_figure(posterior.rows(), posterior.prior, posterior.draws, title)
        yield from IdentifiedSoil.figures(self)

    def soils(self, kind: str = ".csv") -> bytes:
        """Soils for `predict` with the verdict: draws from the posterior as `.csv`, or a belief as `.json`."""
        made = self.posterior.belief().to_json() if kind == ".json" else self.posterior.draws_csv()
        return made.encode()

    def as_input(self, role: str) -> dict[str, Callable[[], bytes]]:
        return {"soil.json": lambda: self.soils(".json")} if role in ("soil", "belief") else {}


@job
def infer(
    states: Source,
    request: InferRequest | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> InferredSoil:
    """The posterior of all eight soil parameters from all wheel states at once; `options` replace those of the request.

    Parameters
    ----------
    states : table of wheel states, see `lunarsci.regolith.states.read_states`.
    progress : called with (done, total).

    Raises RequestError, ParameterError for values out of range, DataError for tables that cannot be used.

    Examples
    --------
    >>> soil = lunarsci.infer("lunarsci-demo/wheel_states.csv", rover="yutu2")
    >>> posterior = soil.to_table()
    """
    asked = request_of(InferRequest, request, options)
    assumptions = assumptions_of(asked)
    given = read_wheel_states(states, asked.rover, asked)
    alone = identified(given, asked, assumptions, progress)
    posterior, scores, inputs = _posterior(asked, given, progress)
    predicted = None
    if asked.predict is not None:
        other = read_input(asked.predict)
        wheel = given.wheel if asked.predict_rover is None else read_wheel(asked.predict_rover)
        predicted = predict_states(posterior, wheel, other, seed=asked.seed)
        inputs |= {other.name: other.sha256}
    made = alone.made_from
    origin = replace(made, inputs={**made.inputs, **inputs}, tables={**made.tables, **prior_hash()})
    same = {item.name: getattr(alone, item.name) for item in fields(alone)} | {"origin": origin}
    return InferredSoil(**same, posterior=posterior, scores=scores, predicted=predicted)


def _posterior(
    asked: InferRequest, given: StatesOfWheel, progress: Callable[[int, int], None] | None
) -> tuple[SoilPosterior, Sequence[WheelLawScore], dict[str, str]]:
    """The posterior, scores of the laws where one was chosen, and the file of priors."""
    chooses = asked.chooses(given.states.alike)
    source = read_input(asked.prior) if asked.prior else None
    prior = read_prior(source, contact=asked.contact or chooses) if source else None
    law, scores = wheel_law_of(asked), list[Any]()
    if chooses:
        laws = candidates(given.states, asked.density, float(asked.gravity))
        law, scores = compare_laws(
            given.states, given.wheel, laws, prior, model_error=asked.model_error, progress=progress
        )
    posterior = infer_soil(
        given.states,
        given.wheel,
        prior,
        model=law.model,
        contact=law.contact,
        model_error=asked.model_error,
        sample=asked.sample,
        profile=asked.profile,
        seed=asked.seed,
        progress=progress,
    )
    whose = written_for(given.called or given.rover, given.wheel)
    load = given.states.values[:, COLUMNS.index("normal_force_n")]
    loads = (float(load.min()), float(load.max()))
    verdict = replace(posterior.verdict, wheel=whose, gravity_m_s2=float(asked.gravity), loads_n=loads)
    posterior = replace(posterior, disputed=disputed(posterior, scores), verdict=verdict)
    return posterior, scores, {source.name: source.sha256} if source else {}
