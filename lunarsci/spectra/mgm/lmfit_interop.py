"""A fit as lmfit sees it: handed over as `lmfit.Parameters`, changed there, and fitted again.

lmfit: Newville et al., 10.5281/zenodo.11813 (zenodo.org).
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from lunarsci.arrays import FloatArray
from lunarsci.errors import ParameterError
from lunarsci.spectra.mgm.batch import describe_rows
from lunarsci.spectra.mgm.data import MgmRows
from lunarsci.spectra.mgm.forward import model_and_jacobian
from lunarsci.spectra.mgm.levenberg_marquardt import CONVERGED, ITERATION_LIMIT
from lunarsci.spectra.mgm.model import MIN_FWHM_UM, MgmModel, unit_of
from lunarsci.spectra.mgm.multistart import KernelFits
from lunarsci.spectra.mgm.result import MgmFit

if TYPE_CHECKING:
    from lmfit import Minimizer, Parameters


FAR = 1e8
"""Residual where the continuum is not above 0: finite, and larger than any other."""
TOLERANCE = 1e-12
STEP = 1e-6


def to_lmfit(fit: MgmFit) -> "Parameters":
    """The parameters of a fit for lmfit, by the names of the model and in the units of the names: nm for wavelengths.

    Values, bounds, `vary` (False where fixed), and, from the covariance of the fit, `stderr` and `correl`. A tie of the
    model is part of its prior, not an expression, and stays with the fit.
    """
    from lmfit import Parameters

    model, names = fit.model, fit.model.names
    sigma = np.sqrt(np.diag(fit.covariance))
    parameters = Parameters()
    for k, name in enumerate(names):
        unit, fixed = unit_of(name), bool(model.fixed[k])
        low, high = (-np.inf, np.inf) if fixed else (model.lower[k] * unit, model.upper[k] * unit)
        parameters.add(name, value=float(fit.parameters[k] * unit), vary=not fixed, min=low, max=high)
        if fixed:
            continue
        parameters[name].stderr = float(sigma[k] * unit)
        parameters[name].correl = {
            other: float(fit.covariance[k, j] / (sigma[k] * sigma[j]))
            for j, other in enumerate(names)
            if j != k and sigma[k] > 0 and sigma[j] > 0
        }
    return parameters


def to_minimizer(fit: MgmFit, parameters: "Parameters | None" = None) -> "Minimizer":
    """lmfit's minimiser of the objective of a fit, for its other methods and `lmfit.conf_interval`.

    Residuals are those of ln R times the root of the weight, then the factor of the prior's precision times the
    distance from its mean: their sum of squares is the objective, chi-square is known and not rescaled. Derivatives are
    analytic unless a parameter is an expression. `parameters` are as `to_lmfit` gives them, changed or not.

    Raises ParameterError where names are missing or unknown.
    """
    from lmfit import Minimizer

    if parameters is None:
        parameters = to_lmfit(fit)
    _check_names(fit.model, parameters)
    objective = _Objective(fit)
    free_of_ties = all(parameter.expr is None for parameter in parameters.values())
    options = {"Dfun": objective.jacobian} if free_of_ties else {}
    return Minimizer(objective.residual, parameters, scale_covar=False, **options)


def refit(fit: MgmFit, parameters: "Parameters") -> MgmFit:
    """Minimise the objective of a fit again, with lmfit, from changed parameters.

    Parameters
    ----------
    parameters : as `to_lmfit` gives them; values, `min`, `max`, `vary` and `expr` may have been changed, in the units
        of the names. Bounds hold as those of `MgmModel.bounded`; what does not vary is fixed. A parameter with an
        expression loses its bounds, save that strengths are 0 or below and widths 50 nm or above. The expression
        becomes, in the model of the result, a prior that leaves no room beside its tangent at the minimum, so errors
        and later fits follow it.

    Returns
    -------
    A fit of its own, with `status` from this minimisation; whether another minimum is as good is not looked for.

    Raises
    ------
    ParameterError for missing or unknown names, positive strengths, widths not above 0, bounds the wrong way round, and
    expressions between a continuum coefficient and a band.
    """
    _check_names(fit.model, parameters)
    parameters = _released(fit.model, parameters)
    minimizer = to_minimizer(fit, parameters)
    changed = _changed_model(fit.model, parameters)
    result = minimizer.minimize(method="least_squares", xtol=TOLERANCE, ftol=TOLERANCE, gtol=TOLERANCE)
    units = np.array([unit_of(name) for name in changed.names])
    point = np.array([result.params[name].value for name in changed.names]) / units
    point = np.where(changed.fixed, changed.lower, _settled(changed, point, fit))
    residual = _Objective(fit).at(point)[0]
    channels = fit.wavelength_nm.size
    status = CONVERGED if result.success else ITERATION_LIMIT
    numbers = ((residual[:channels] ** 2).sum(), residual @ residual, result.nfev, status, np.inf, 0.0)
    solved = KernelFits(point[None], fit.covariance[None], *(np.array([float(number)]) for number in numbers))
    tied = _tied_model(changed, result.params, point)
    return describe_rows(MgmRows.together([fit.data]), tied, solved, point[None]).fit(0, fit.data)


class _Objective:
    """Residuals of a fit and their derivatives, of parameter vectors and of `lmfit.Parameters`.

    The r residuals are those of ln R times the root of the weight, (n,), then `rows`, a factor of the prior's
    precision, times the distance from its mean. Parameters, (p,), are in the order and units of `MgmModel`; `units`
    takes them to those of their names.
    """

    def __init__(self, fit: MgmFit) -> None:
        model = fit.model
        self.names, self.logarithmic, self.prior = model.names, model.logarithmic, model.prior
        self.units = np.array([unit_of(name) for name in model.names])
        self.wavelength_um, self.basis = fit.wavelength_nm / 1e3, model.basis(fit.wavelength_nm)
        self.root_weight, self.data = np.sqrt(fit.data.weight), np.log(fit.reflectance)
        held = np.diag(model.precision) > 0
        self.rows = np.zeros((int(held.sum()), model.prior.size))
        self.rows[:, held] = np.linalg.cholesky(model.precision[np.ix_(held, held)]).T

    def at(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals, (r,), and their derivatives, (r, p), in the kernel's units."""
        prior = self.rows @ (point - self.prior)
        modelled = model_and_jacobian(point, self.wavelength_um, self.basis, self.logarithmic)
        if modelled is None:
            size = self.data.size
            return np.concatenate([np.full(size, FAR), prior]), np.vstack([np.zeros((size, point.size)), self.rows])
        ln_model, slope = modelled
        residual = np.concatenate([(self.data - ln_model) * self.root_weight, prior])
        return residual, np.vstack([-(slope * self.root_weight).T, self.rows])

    def _point(self, parameters: "Parameters") -> FloatArray:
        """Parameters in the units of `MgmModel`, (p,)."""
        values = np.array([parameters[name].value for name in self.names], dtype=np.float64)
        return np.asarray(values / self.units, dtype=np.float64)

    def residual(self, parameters: "Parameters") -> FloatArray:
        """What lmfit squares and sums."""
        return self.at(self._point(parameters))[0]

    def jacobian(self, parameters: "Parameters") -> FloatArray:
        """Derivatives with respect to the parameters that vary, in the units of their names."""
        vary = [k for k, name in enumerate(self.names) if parameters[name].vary]
        return np.asarray((self.at(self._point(parameters))[1] / self.units)[:, vary])


def _check_names(model: MgmModel, parameters: "Parameters") -> None:
    missing = [name for name in model.names if name not in parameters]
    unknown = [name for name in parameters if name not in model.names and parameters[name].vary]
    if missing or unknown:
        raise ParameterError(
            f"the parameters lack {', '.join(missing) or 'none'}, and {', '.join(unknown) or 'no others'} vary beside "
            "the model's; start from those of to_lmfit, fix others or use expressions"
        )


def _released(model: MgmModel, parameters: "Parameters") -> "Parameters":
    """A copy in which expressions are bounded only by what a band can be."""
    parameters = parameters.copy()
    for name in model.names:
        if parameters[name].expr is not None:
            parameters[name].min = MIN_FWHM_UM * unit_of(name) if name.endswith("fwhm_nm") else -np.inf
            parameters[name].max = 0.0 if name.endswith("strength") else np.inf
    return parameters


def _changed_model(model: MgmModel, parameters: "Parameters") -> MgmModel:
    """With the bounds that lmfit's parameters have."""
    for name in model.names:
        parameter = parameters[name]
        free = parameter.vary or parameter.expr is not None
        low, high = (parameter.min, parameter.max) if free else (parameter.value, parameter.value)
        model = model.bounded(name, float(low), float(high))
    return model


def _settled(model: MgmModel, point: FloatArray, fit: MgmFit) -> FloatArray:
    """On the bound what ended within a thousandth of its error from it, where lmfit's barrier stops short."""
    close = 1e-3 * np.sqrt(np.diag(fit.covariance))
    point = np.where(point - model.lower < close, model.lower, point)
    return np.where(model.upper - point < close, model.upper, point)


def _tied_model(model: MgmModel, parameters: "Parameters", point: FloatArray) -> MgmModel:
    """With a prior that leaves no room beside the tangents of all expressions at `point`."""
    m = model.degrees
    for k, name in enumerate(model.names):
        if (expression := parameters[name].expr) is None:
            continue
        row = -_slopes(model, name, parameters)
        if any((j < m) != (k < m) for j in np.flatnonzero(row)):
            raise ParameterError(f"{name} = {expression}: a continuum coefficient cannot be tied to a band")
        row[k] += 1.0
        model = model.on_plane(row, float(row @ point))
    return model


def _slopes(model: MgmModel, name: str, parameters: "Parameters") -> FloatArray:
    """(p,) derivatives of an expression by the parameters that vary, in the kernel's units."""
    slopes = np.zeros(model.prior.size)
    for j, other in enumerate(model.names):
        if not parameters[other].vary:
            continue
        step = STEP * max(1.0, abs(parameters[other].value))
        ends = [_moved(parameters, other, sign * step)[name].value for sign in (-1, 1)]
        slopes[j] = (ends[1] - ends[0]) / (2 * step) * unit_of(other) / unit_of(name)
    return slopes


def _moved(parameters: "Parameters", name: str, step: float) -> Any:
    moved = parameters.copy()
    moved[name].set(value=moved[name].value + step, min=-np.inf, max=np.inf)
    moved.update_constraints()
    return moved
