"""The move of a minimum under an error that all channels share: derivatives, and a minimum found by scipy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from lunarsci.arrays import FloatArray
from lunarsci.spectra.mgm.batch import follow_shifts, misfit_curvature
from lunarsci.spectra.mgm.data import MgmData
from lunarsci.spectra.mgm.fit import fit_data
from lunarsci.spectra.mgm.forward import model_and_jacobian
from lunarsci.spectra.mgm.model import MgmModel, mgm_model
from lunarsci.spectra.mgm.result import MgmFit

GRID = np.arange(450.0, 2396.0, 10.0)


def model_at(point: FloatArray, model: MgmModel) -> tuple[FloatArray, FloatArray]:
    found = model_and_jacobian(point, GRID / 1e3, model.basis(GRID), model.logarithmic)
    assert found is not None
    return found


def made(model: MgmModel, shift: FloatArray) -> MgmFit:
    """Bands that the model can follow only in part."""
    point = model.prior.copy()
    point[: model.degrees] = 0.0
    point[0] = -1.5 if model.logarithmic else 0.2
    point[model.degrees + 2 :: 3] = -0.3
    ln = model_at(point, model)[0] + 0.1 * np.sin(GRID / 200)
    weight = np.linspace(0.5, 2, GRID.size) / 0.01**2
    data = MgmData("made", GRID, np.exp(ln), weight, shift[None], 0.0)
    return fit_data([data], model, 4)[0]


@pytest.mark.parametrize("continuum", ["wavelength", "log-quadratic"])
def test_second_derivatives_agree_with_differences_of_the_first(continuum: str) -> None:
    model = mgm_model("OPX-CPX", continuum)  # type: ignore[arg-type]
    fit = made(model, np.zeros(GRID.size))
    pull = np.random.default_rng(0).normal(size=GRID.size)
    jacobian = model_at(fit.parameters, model)[1]
    found = misfit_curvature(fit.data, model, fit.parameters, jacobian, pull)
    for k, row in enumerate(found):
        step = np.zeros(fit.parameters.size)
        step[k] = 1e-5
        difference = [model_at(fit.parameters + sign * step, model)[1] @ pull for sign in (1, -1)]
        expected = (difference[0] - difference[1]) / 2e-5
        assert np.allclose(row, expected, rtol=1e-5, atol=1e-6 * np.abs(found).max()), model.names[k]


def test_the_minimum_moves_as_stated() -> None:
    """scipy's minimum for data a little up and a little down; the misfit is several times the noise."""
    shift = 0.05 * np.cos(GRID / 500)
    model = mgm_model("OPX")
    fit = made(model, shift)
    ln_model, jacobian = model_at(fit.parameters, model)
    [stated] = follow_shifts(fit.data, model, fit.parameters, ln_model, jacobian)
    free = ~((fit.parameters <= model.lower) | (fit.parameters >= model.upper))
    root = np.linalg.cholesky(model.precision + 1e-14 * np.eye(free.size)).T

    def rows(values: FloatArray, ln: FloatArray) -> FloatArray:
        point = fit.parameters.copy()
        point[free] = values
        residual = np.sqrt(fit.data.weight) * (model_at(point, model)[0] - ln)
        return np.concatenate([residual, root @ (point - model.prior)])

    ends = []
    for share in (0.02, -0.02):
        ln = np.log(fit.data.reflectance) + share * shift
        end = least_squares(rows, fit.parameters[free], args=(ln,), x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
        ends.append(end.x)
    found = (ends[0] - ends[1]) / 0.04
    effect = np.sqrt((jacobian[free] ** 2).sum(axis=1))
    assert np.allclose(stated[free] * effect, found * effect, rtol=0.05, atol=0.02 * np.abs(found * effect).max())


def test_parameters_on_a_bound_stay_and_the_others_follow() -> None:
    """Bands that are not there end at strength 0, where the objective may bend down; scipy again, with bounds."""
    model = mgm_model("OL-OPX-CPX")
    point = model.prior.copy()
    point[:3], point[5::3] = (0.2, 0.0, 0.0), 0.0
    for name in ("uv_strength", "opx_1_strength", "opx_2_strength"):
        point[model.index(name)] = -0.4
    ln = model_at(point, model)[0] + 0.05 * np.sin(GRID / 200)
    shift = 0.05 * np.cos(GRID / 500)
    data = MgmData("made", GRID, np.exp(ln), np.full(GRID.size, 0.02**-2), shift[None], 0.02)
    [fit] = fit_data([data], model, 4)
    held = ((fit.parameters <= model.lower) | (fit.parameters >= model.upper)) & ~model.fixed
    assert held.any()
    [stated] = follow_shifts(data, model, fit.parameters, *model_at(fit.parameters, model))
    assert not stated[held].any()
    root = np.linalg.cholesky(model.precision + 1e-14 * np.eye(held.size)).T

    def rows(values: FloatArray, ln: FloatArray) -> FloatArray:
        moved = fit.parameters.copy()
        moved[~held] = values
        residual = np.sqrt(data.weight) * (model_at(moved, model)[0] - ln)
        return np.concatenate([residual, root @ (moved - model.prior)])

    ends = []
    for share in (0.02, -0.02):
        moved_ln = np.log(data.reflectance) + share * shift
        end = least_squares(rows, fit.parameters[~held], args=(moved_ln,), x_scale="jac", xtol=1e-14, ftol=1e-14)
        ends.append(end.x)
    found = (ends[0] - ends[1]) / 0.04
    effect = np.sqrt((model_at(fit.parameters, model)[1][~held] ** 2).sum(axis=1))
    assert np.allclose(stated[~held] * effect, found * effect, rtol=0.05, atol=0.02 * np.abs(found * effect).max())


def test_without_such_errors_nothing_is_said() -> None:
    model = mgm_model("OPX")
    fit = made(model, np.zeros(GRID.size))
    data = replace(fit.data, shifts=np.zeros((0, GRID.size)))
    assert follow_shifts(data, model, fit.parameters, *model_at(fit.parameters, model)).shape == (
        0,
        fit.parameters.size,
    )
