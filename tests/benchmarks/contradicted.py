"""How often shares are wrong and confident, and right ones refused: `python tests/benchmarks/contradicted.py`.

Needs the reference data, found through LUNARSCI_REFERENCE_DATA. Three sorts of powders of known modes, by end members
that hold nothing of them: laboratory mixtures (`make_abundance_calibration`), minerals measured alone, with olivine and
both pyroxenes named, and made-up spectra. Sample series, and seeds of made-up spectra, are halved: on the first half
the most allowed misfit was chosen, the second one judges it. Made-up spectra are of another physics than unmixing:
slabs with Gaussian absorption (Shkuratov et al. 1999, 10.1006/icar.1998.6035), or a continuum with Gaussians in ln R,
flat or tilted, with an edge in the ultraviolet of any depth, cut and noisy.
"""

import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lunarsci.spectra_data import make_abundance_calibration as calibration
from lunarsci.spectra_data.make_kinds import suite_of

from lunarsci.spectra.abundance.end_members import embedded_end_members, without_siblings
from lunarsci.spectra.abundance.kinds import find_kind
from lunarsci.spectra.abundance.one_by_one import MAFIC, raw_shares
from lunarsci.spectra.abundance.posterior import MOST_MISFIT, MOST_WIDE, POWDER, calibrations
from lunarsci.spectra.spectrum import Spectrum

__all__ = ["Judged", "judged", "made_up", "measured", "row"]

GOOD, PURE = 0.15, 0.99
COUNT, SEEDS = 150, (11, 12)
LIMITS = (1.5, 1.75, 2.0, 2.25, 2.5, 3.0, np.inf)
FIRST_MIXTURES = ("AG-TJM", "MIX03", "MIX23", "XP-CMP")
REFRACTION = 1.7


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """One powder: sort and half, true and found shares, standard deviations, distance, misfit, whether an outlier."""

    sort: str
    first: bool
    id: str
    truth: np.ndarray
    mean: np.ndarray
    sigma: np.ndarray
    unlike: float
    misfit: float
    stranger: bool

    @property
    def wrong(self) -> bool:
        return bool(np.abs(self.mean - self.truth).max() > GOOD)

    @property
    def confident(self) -> bool:
        """In domain, misfit apart."""
        known = calibrations()[POWDER]
        sharp = known.factor68 * self.sigma.max() <= MOST_WIDE
        return bool(not self.stranger and self.unlike <= known.most_unlike and sharp)

    @property
    def held(self) -> float:
        """Share of the truths in intervals of 95 %."""
        return float(np.mean(np.abs(self.mean - self.truth) <= calibrations()[POWDER].factor95 * self.sigma + 1e-9))


def judged(
    sort: str, first: bool, spectrum: Spectrum, truth: Sequence[float], minerals: Sequence[str], out: Sequence[str]
) -> Judged:
    """By a library without the powders named in `out` and their siblings."""
    kept = without_siblings(embedded_end_members(np.arange(450.0, 2451.0, 5.0)), out) if out else None
    _, mean, sigma, unlike, misfit = raw_shares(spectrum, minerals, POWDER, kept)
    stranger = find_kind(spectrum, POWDER).stranger
    return Judged(sort, first, spectrum.id, np.array(truth), mean, sigma, unlike, misfit * MOST_MISFIT, stranger)


def measured(folder: Path) -> Iterator[Judged]:
    """Mixtures, and minerals alone."""
    for part in ("relab", "minerals"):
        spectra, rows = calibration.spectra_of(folder / part)
        modes = rows[[*calibration.COLUMNS.values()]]
        for suite, (minerals, powders) in calibration.MIXTURES.items():
            for spectrum in spectra:
                own = modes.loc[spectrum.id]
                if spectrum.id.startswith(suite) and own.max() < PURE:
                    truth = [own[calibration.COLUMNS[mineral]] for mineral in minerals]
                    yield judged("mixtures", suite in FIRST_MIXTURES, spectrum, truth, minerals, powders)
        for spectrum in spectra:
            truth = list(modes.loc[spectrum.id].iloc[: len(MAFIC)])
            if max(truth) >= PURE:
                first = sum(map(ord, suite_of(spectrum.id))) % 2 == 1
                yield judged("one mineral", first, spectrum, truth, MAFIC, (spectrum.id,))


def made_up(seed: int) -> Iterator[tuple[Spectrum, np.ndarray]]:
    """Orthopyroxene, clinopyroxene, olivine and pairs of them in turn, with their shares."""
    rng = np.random.default_rng(seed)
    for number in range(COUNT):
        kind = ("orthopyroxene", "clinopyroxene", "olivine", "pair")[number % 4]
        shares = np.array([float(mineral == kind) for mineral in MAFIC])
        if kind == "pair":
            one, other = rng.choice(3, 2, replace=False)
            shares[one] = rng.uniform(0.1, 0.9)
            shares[other] = 1.0 - shares[one]
        nm = np.arange((450.0, 450.0, 500.0, 700.0)[rng.integers(4)], (2451.0, 2351.0)[rng.integers(2)], 5.0)
        tilt = rng.normal(0.0, 0.1) * (nm / 1e3 - 1.45)
        if kind != "pair" and rng.random() < 0.4:
            ln_level = np.log(rng.uniform(0.25, 0.7))
            edge = rng.uniform(0.2, 4.0) * _gaussian(nm, rng.uniform(300.0, 370.0), rng.uniform(140.0, 300.0))
            reflectance = np.exp(ln_level + tilt - edge - rng.uniform(0.3, 1.2) * _bands(kind, nm, rng))
        else:
            reflectance = _slabs(shares, nm, rng) * np.exp(tilt)
        noise = rng.normal(0.0, (0.0, 0.003, 0.01)[rng.integers(3)], nm.size)
        yield Spectrum(f"{kind}-{seed}-{number}", nm, reflectance * (1.0 + noise)), shares


def _gaussian(nm: np.ndarray, center: float, fwhm: float) -> np.ndarray:
    return np.asarray(np.exp(-0.5 * ((nm - center) / (fwhm / 2.3548)) ** 2))


def _bands(mineral: str, nm: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Absorption of one mineral, about 1 at its deepest; centres shift together with its iron."""
    iron = rng.uniform()
    parts = {
        "orthopyroxene": ((905 + 25 * iron, 185, 1), (1810 + 110 * iron, 500, rng.uniform(0.55, 0.9)),
                          (1160, 260, rng.uniform(0.03, 0.12))),
        "clinopyroxene": ((985 + 50 * iron, 205, 1), (2130 + 180 * iron, 600, rng.uniform(0.5, 0.8)),
                          (1200, 260, rng.uniform(0.1, 0.35))),
        "olivine": ((850 + 15 * iron, 210, 0.45), (1040 + 25 * iron, 180, 0.9), (1215 + 55 * iron, 430, 1)),
    }  # fmt: skip
    return np.asarray(sum(depth * _gaussian(nm, center, fwhm) for center, fwhm, depth in parts[mineral]))


def _slabs(shares: np.ndarray, nm: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Reflectance of a powder of slabs of all minerals, their reflectances forward and back averaged by volume."""
    back, forward, size_nm = np.zeros_like(nm), np.zeros_like(nm), 1e3 * np.exp(rng.normal(np.log(60.0), 0.5))
    fresnel = ((REFRACTION - 1) / (REFRACTION + 1)) ** 2
    outer, inner = fresnel + 0.05, 1.04 - REFRACTION**-2
    outer_back = (0.28 * REFRACTION - 0.20) * outer
    for mineral, share in zip(MAFIC, shares, strict=True):
        if share > 0:
            edge = 10 ** rng.uniform(-1.5, 0.2) * np.exp((400.0 - nm) / rng.uniform(40.0, 110.0))
            strength = rng.uniform(0.25, 0.7) if mineral == "olivine" else rng.uniform(0.4, 1.5)
            absorbing = 2.5e-4 * (strength * _bands(mineral, nm, rng) + edge + 10 ** rng.uniform(-2.3, -1.2))
            depth = np.exp(-4 * np.pi * absorbing * size_nm * np.exp(rng.normal(0.0, 0.2)) / nm)
            through = (1 - outer) * (1 - inner)
            inside = 0.5 * through * inner * depth**2 / (1 - inner * depth)
            back += share * (outer_back + inside)
            forward += share * (outer - outer_back + through * depth + inside)
    filled = rng.uniform(0.5, 0.8)
    back, forward = filled * back, filled * forward + 1 - filled
    ratio = (1 + back**2 - forward**2) / (2 * back)
    return np.asarray(ratio - np.sqrt(ratio**2 - 1))


def row(found: Sequence[Judged], most: float) -> str:
    """Of a table: what is answered with this limit, how well, and what is refused."""
    told = [one for one in found if not one.stranger and one.misfit <= most]
    sure = [one for one in told if one.confident]
    right = [one for one in found if not one.stranger and not one.wrong]
    refused = sum(one.misfit > most for one in right)
    held = f"{100 * np.mean([one.held for one in told]):.0f} %" if told else "-"
    return (f"{len(found)} | {len(told)} | {held} | {len(sure)} | {sum(one.wrong for one in sure)} | "
            f"{refused} of {len(right)}")  # fmt: skip


def main() -> None:
    """Print the table, for each sort, half and limit; `made-up` behind the name leaves out what was measured."""
    found = [
        judged("made-up", seed == SEEDS[0], spectrum, truth, MAFIC, ())
        for seed in SEEDS
        for spectrum, truth in made_up(seed)
    ]
    if sys.argv[1:] != ["made-up"]:
        found += measured(Path(os.environ["LUNARSCI_REFERENCE_DATA"]) / "spectra")
    print("| powders | half | most misfit | spectra | told | 95 % hold | in domain | of these wrong | right, refused |")
    print("|" + " --- |" * 9)
    for sort in dict.fromkeys(one.sort for one in found):
        for first in (True, False):
            own = [one for one in found if one.sort == sort and one.first == first]
            for most in LIMITS:
                print(f"| {sort} | {'first' if first else 'second'} | {most:g} | {row(own, most)} |")


if __name__ == "__main__":
    main()
