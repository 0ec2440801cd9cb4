"""Drives on soils that were chosen, and the verdict of the fit they come from."""

import dataclasses
import warnings
from collections.abc import Callable

from lunarsci.errors import LunarSciWarning
from lunarsci.regolith.fit_verdict import FitVerdict, doubt
from lunarsci.twin.jobs.soils import Soils
from lunarsci.twin.simulation.ensemble import Prediction, predict
from lunarsci.twin.simulation.path_discrepancy import with_discrepancy

from ..shared.report import Report

__all__ = ["drive", "with_physics", "with_verdict"]


def with_verdict(report: Report, verdict: FitVerdict | None) -> Report:
    """The report of a drive on soils that carry the verdict of a fit: repeated, and not trusted where that is not."""
    if verdict is None:
        return report
    reason = doubt(verdict)
    if reason:
        warnings.warn(reason, LunarSciWarning, stacklevel=2)
    return dataclasses.replace(
        report,
        result={**report.result, "soil_verdict": verdict.to_dict()},
        untrusted="; ".join(part for part in (report.untrusted, reason) if part),
    )


def drive(soils: Soils, time_step_s: float, sample_m: float, progress: Callable[[int, int], None]) -> Prediction:
    """Drive the plan on these soils."""
    return predict(**soils.of_members(), time_step_s=time_step_s, sample_m=sample_m, progress=progress)


def with_physics(soils: Soils, prediction: Prediction) -> Prediction:
    """With what the twin's physics is off by, where the soils are of a belief or a map of beliefs."""
    law = soils.discrepancy
    return prediction if law is None else with_discrepancy(prediction, law, soils.seed)
