"""A site beside soils of the literature."""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from lunarsci.errors import DataError, LunarSciWarning, ParameterError, RequestError
from lunarsci.io.documents import json_document
from lunarsci.io.inputs import Source, read_input, text
from lunarsci.options import request_of
from lunarsci.provenance import sha256
from lunarsci.regolith.belief import SCHEMA, doubt, read_belief
from lunarsci.regolith.compare import (
    OpenSite,
    Site,
    SoilComparison,
    compare_site,
    open_site,
    reference_hash,
    remarks,
    site_of,
    site_of_belief,
    sources_of,
)
from lunarsci.regolith.jobs.identify import IdentifiedSoil
from lunarsci.regolith.jobs.requests import CompareSoilsRequest
from lunarsci.regolith.wheel import PAPER, read_wheel
from lunarsci.result import MadeFrom, Result, job
from lunarsci.rovers import DEFAULT_ROVER, read_rover

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class _GivenSite(NamedTuple):
    """A site as it was given; None for what the input does not say.

    Attributes
    ----------
    site : parameters that are compared.
    curves : of single states by aspect, as results have them.
    inputs : SHA-256 of each file by its name.
    wheel : the wheel that a result is for: `of` (rover or file), `width_m`, and `name` where it has one.
    left_open : what the result leaves open of the site.
    """

    site: Site
    curves: Mapping[str, Any] | None = None
    inputs: Mapping[str, str] = MappingProxyType({})
    wheel: Mapping[str, Any] | None = None
    left_open: OpenSite | None = None


def _of_result(result: Mapping[str, Any], inputs: Mapping[str, str], wheel: Mapping[str, Any] | None) -> _GivenSite:
    """Of the result of `identify` or `infer`."""
    return _GivenSite(*site_of(result), inputs, wheel, open_site(result) if "joint" in result else None)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ComparedSoils(Result):
    """Soils of the literature beside a site.

    Attributes
    ----------
    site, rover, width_m : what is compared, whose wheel, and its width. [m]
    called : the name of the rover or wheel in its file, '' where a result does not have it.
    soils : with their distances from the site; `lunarsci.regolith.compare.nearest` puts them in order.
    curves : of single states by aspect, for the picture; None where the site was given by numbers.
    undetermined : by aspect, parameters that the result hardly tells, with the share of the prior's width left. [-]
    remarks : what that means for the order of soils.
    origin : files, tables and sources that it was made from.
    """

    schema: ClassVar[str] = "regolith-compare/1"
    site: Site
    rover: str
    called: str
    width_m: float
    soils: Sequence[SoilComparison]
    curves: Mapping[str, Any] | None
    undetermined: Mapping[str, Mapping[str, float]]
    remarks: Sequence[str]
    origin: MadeFrom

    @property
    def made_from(self) -> MadeFrom:
        return self.origin

    def to_dict(self) -> dict[str, Any]:
        return {
            "site": asdict(self.site),
            "rover": self.rover,
            "name": self.called,
            "width_m": self.width_m,
            "undetermined": {
                aspect: [{"parameter": name, "left_of_prior": share} for name, share in parameters.items()]
                for aspect, parameters in self.undetermined.items()
            },
            "remarks": list(self.remarks),
            "soils": self.rows(),
        }

    def rows(self) -> Sequence[Mapping[str, Any]]:
        return [item.to_dict(self.width_m) for item in self.soils]

    def figures(self) -> "Iterator[Figure]":
        from lunarsci.regolith.figure import comparison_figure

        yield comparison_figure(self.site, self.soils, self.width_m, self.curves)


@job
def compare_soils(
    result: "Source | IdentifiedSoil | None" = None, request: CompareSoilsRequest | None = None, **options: Any
) -> ComparedSoils:
    """A site beside terrestrial soils, simulants and lunar sites; `options` replace those of the request.

    Parameters
    ----------
    result : of `identify` or `infer`, or the JSON of one, or a belief, whose medians are taken; else options give the
        site.

    Raises RequestError, ParameterError for half a pair or values out of range, DataError for what is no such result.

    Examples
    --------
    >>> nearest = lunarsci.compare_soils(stiffness=1443.0, exponent=1.0, cohesion=520.0, friction_angle=42.0)
    """
    asked = request_of(CompareSoilsRequest, request, options)
    if (result is None) != asked.stated:
        raise RequestError(
            "give either a result of `regolith infer --json` or `identify`, or a belief; or `stiffness` and its like"
        )
    site, curves, inputs, wheel, left_open = _site(result, asked)
    if asked.rover is None and wheel is not None:
        rover, width, tables = str(wheel["of"]), float(wheel["width_m"]), dict[str, str]()
        name = str(wheel.get("name") or "")
    else:
        description = read_rover(rover := asked.rover or DEFAULT_ROVER)
        name = description.name
        width, tables = read_wheel(description).width_m, {f"{rover} (rover)": sha256(description.text.encode())}
    soils = compare_site(site, width, left_open=left_open)
    compared = [item.soil for item in soils if item.bearing is not None or item.strength is not None]
    return ComparedSoils(
        site=site,
        rover=rover,
        called=name,
        width_m=width,
        soils=soils,
        curves=curves,
        undetermined=left_open.undetermined() if left_open else {},
        remarks=remarks(left_open, soils) if left_open else (),
        origin=MadeFrom(
            inputs=inputs,
            tables=tables | reference_hash(),
            sources=[PAPER, *sources_of(compared)],
            options={"rover": rover},
        ),
    )


def _site(result: "Source | IdentifiedSoil | None", asked: CompareSoilsRequest) -> _GivenSite:
    """The site with what is known beside it, where the result has it."""
    if result is None:
        site = Site(
            stiffness_kpa_m_n=asked.stiffness,
            sinkage_exponent=asked.exponent,
            cohesion_pa=asked.cohesion,
            friction_angle_deg=asked.friction_angle,
        )
        return _GivenSite(site=site)
    if isinstance(result, IdentifiedSoil):
        document_result = result.to_dict()
        return _of_result(document_result, result.made_from.inputs, document_result["wheel"])
    file = read_input(result)
    content = text(file)
    try:
        document = json_document(content)
        if isinstance(document, dict) and document.get("schema") == SCHEMA:
            belief = read_belief(file).soil
            if why := belief.doubt or (doubt(belief.verdict) if belief.verdict else ""):
                warnings.warn(f"{file.name}: a doubtful belief: {why}", LunarSciWarning, stacklevel=3)
            left = OpenSite(belief, belief.sd_ratio)
            return _GivenSite(site=site_of_belief(belief), inputs={file.name: file.sha256}, left_open=left)
        document_result = document["result"]
        return _of_result(document_result, {file.name: file.sha256}, document_result.get("wheel"))
    except (ValueError, KeyError, TypeError) as error:
        if isinstance(error, ParameterError | DataError):
            raise
        message = (
            f"{file.name}: is no result of `regolith infer --json` or `regolith identify --json`, and no belief of "
            "`twin update`; make one, or give `stiffness`"
        )
        raise DataError(message) from error
