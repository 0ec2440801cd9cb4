"""The path of the RELAB MGM program, restated from the published equations in plain numpy: the oracle of damping mode.

Stochastic inversion after Tarantola & Valette (1982), 10.1029/RG020i002p00219, eq. 21, with unit covariance of ln R and
the prior's mean put where the fit stands, so that the prior only damps, as Sunshine, Pieters & Pratt (1990),
10.1029/JB095iB05p06955, use it. What is known of the program beside that was measured on its runs: centres step in
wavenumber; the prior's 1.96 standard deviations of a centre are the full width in wavenumber between the centre less
and plus its uncertainty; coefficients of 0 are held; rules of ending are looked at after an iteration; errors of
centres are written as full widths. Nothing here is the library's: least squares of stacked rows, no normal equations.
"""

from dataclasses import dataclass

import numpy as np

LN_2 = np.log(2.0)
HALVINGS = 15


@dataclass(frozen=True)
class Restated:
    """Where the path ends: four coefficients; (k, 3) centres [nm], FWHM [nm], strengths; errors as it writes them."""

    iterations: int
    rms: float
    coefficients: np.ndarray
    bands: np.ndarray
    coefficient_errors: np.ndarray
    band_errors: np.ndarray


class Path:
    """A start in the program's own parameters: coefficients that are not 0, then wavenumber, FWHM, strength a band."""

    def __init__(
        self, wavelength_nm: np.ndarray, reflectance: np.ndarray, letter: str, coefficients: tuple[float, ...],
        coefficients_95: tuple[float, ...], bands: np.ndarray, bands_95: np.ndarray,
    ) -> None:  # fmt: skip
        self.wavelength, self.data = wavelength_nm, np.log(reflectance)
        self.powers = [] if letter == "N" else [k for k in range(4) if coefficients[k] != 0]
        self.variable = 1e7 / wavelength_nm if letter in "QT" else wavelength_nm
        centre, around = bands[:, 0], bands_95[:, 0]
        with np.errstate(divide="ignore"):
            width = 1e7 / (centre - around) - 1e7 / (centre + around)
        rows = np.column_stack([1e7 / centre, bands[:, 1], bands[:, 2]])
        sigma = np.column_stack([width, bands_95[:, 1], bands_95[:, 2]])
        self.start = np.concatenate([[coefficients[k] for k in self.powers], rows.ravel()])
        self.sigma = np.abs(np.concatenate([[coefficients_95[k] for k in self.powers], sigma.ravel()])) / 1.96

    def model(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """ln R and its derivatives, (n, p)."""
        m = len(self.powers)
        columns = [self.variable**k for k in self.powers]
        level = sum(c * column for c, column in zip(point[:m], columns, strict=True)) if m else 1.0
        total = np.log(level * np.ones(self.wavelength.size))
        slopes = [column / level for column in columns]
        for wavenumber, fwhm, strength in point[m:].reshape(-1, 3):
            x = (self.wavelength - 1e7 / wavenumber) / fwhm
            bell = np.exp(-4 * LN_2 * x**2)
            total = total + strength * bell
            by_centre = strength * bell * 8 * LN_2 * x / fwhm
            slopes += [by_centre * -1e7 / wavenumber**2, strength * bell * 8 * LN_2 * x**2 / fwhm, bell]
        return total, np.array(slopes).T

    def rms(self, point: np.ndarray) -> float:
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            value = np.sqrt(np.mean((self.data - self.model(point)[0]) ** 2))
        return float(value) if np.isfinite(value) else np.inf

    def step(self, point: np.ndarray) -> np.ndarray:
        """Least squares of the residuals, and of the step over the prior's standard deviations."""
        ln, slopes = self.model(point)
        damped = np.isfinite(self.sigma)
        scale = np.where(damped, self.sigma, np.abs(point))
        stacked = np.vstack([slopes * scale, np.diag(damped * 1.0)])
        right = np.concatenate([self.data - ln, np.zeros(point.size)])
        return np.asarray(np.linalg.lstsq(stacked, right, rcond=None)[0] * scale)

    def follow(self, rms_limit: float, improvement_limit: float, most: int = 20_000) -> Restated:
        """Iterate, then ask whether that was enough."""
        point, rms = self.start, self.rms(self.start)
        for iteration in range(1, most + 1):
            step = self.step(point)
            for halving in range(HALVINGS + 1):
                trial = point + step / 2**halving
                reached = self.rms(trial)
                if reached < rms:
                    break
            else:
                return self.end(iteration, point)
            improvement, point, rms = rms - reached, trial, reached
            if improvement <= improvement_limit or rms <= rms_limit:
                break
        return self.end(iteration, point)

    def end(self, iterations: int, point: np.ndarray) -> Restated:
        """1.96 sqrt(diag((G'G)^-1 rms^2)); that of a wavenumber as the width of its interval in wavelength."""
        slopes, m, rms = self.model(point)[1], len(self.powers), self.rms(point)
        scale = np.linalg.norm(slopes, axis=0)
        inverse = np.linalg.pinv(slopes / scale, rcond=1e-14)
        errors = 1.96 * rms * np.linalg.norm(inverse, axis=1) / scale
        coefficients, own_errors = np.zeros(4), np.zeros(4)
        coefficients[self.powers], own_errors[self.powers] = point[:m], errors[:m]
        bands, band_errors = point[m:].reshape(-1, 3).copy(), errors[m:].reshape(-1, 3)
        v, e = bands[:, 0].copy(), band_errors[:, 0].copy()
        bands[:, 0], band_errors[:, 0] = 1e7 / v, 1e7 / (v - e) - 1e7 / (v + e)
        bands[:, 1] = np.abs(bands[:, 1])
        return Restated(iterations, rms, coefficients, bands, own_errors, band_errors)
