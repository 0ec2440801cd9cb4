"""Shares with and without the prior of returned rocks: `python tests/benchmarks/rock_prior.py FOLDER NETWORKS`.

FOLDER holds `relab`, `minerals`, `meteorites` and `ce4`, NETWORKS the networks of the folds, `fold-K.npz` of
`make_share_networks.py FOLDER NETWORKS 0 1 2 3 4 5 6 7`. Rocks and eucrites of known modes are judged by networks that
knew nothing of their suites; boulders of Chang'E-4, whose modes nobody knows, by those of `share_networks.npz`.
"""

import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
from lunarsci.spectra_data.make_share_calibration import ROCKS, all_spectra
from lunarsci.spectra_data.make_share_networks import fold_of, measured

import lunarsci
from lunarsci.io.inputs import read_input
from lunarsci.spectra.abundance.kinds import find_kinds
from lunarsci.spectra.abundance.learned import Foretold, foretell_each, unpacked
from lunarsci.spectra.abundance.shares import GOOD, answer, calibration, drawn_rocks, how_dark, with_rocks
from lunarsci.spectra.readers.dispatch import read_spectra

PRIORS = ("powders", "lunar-rocks")


def known_modes(folder: Path, networks: Path) -> None:
    """Errors and intervals of rocks, of eucrites taken as rocks, and of mixtures of all four minerals."""
    powders, spectra = measured(folder), all_spectra(folder)
    fold, about = fold_of(powders.suites), powders.manifest.reindex(columns=["texture", "subtype"]).fillna("")
    groups = {
        "chips and slabs": about.texture.map(lambda text: any(word in text for word in ROCKS)),
        "eucrites": about.subtype.str.contains("Eucrite"),
        "mixtures AG-TJM": np.char.startswith(powders.suites.astype(str), "AG-TJM")
        & (powders.shares.max(axis=1) < 0.95),
    }
    for name, chosen in groups.items():
        rows = np.flatnonzero(chosen)
        allowed, truth, parts = np.ones((rows.size, 4)), powders.shares[rows], {}
        for k in sorted(set(fold[rows].tolist())):
            with np.load(networks / f"fold-{k}.npz") as found:
                learned = unpacked(found)
            own = np.flatnonzero(fold[rows] == k)
            parts[k] = own, foretell_each([spectra[row] for row in rows[own]], allowed[own], learned)
        order = np.argsort(np.concatenate([own for own, _ in parts.values()]))
        names = [one.name for one in fields(Foretold)]
        foretold = Foretold(*(np.concatenate([getattr(one, k) for _, one in parts.values()])[order] for k in names))
        dark = how_dark(find_kinds([spectra[row] for row in rows], "solid-rock"))
        alone = answer(foretold, allowed, dark, np.ones(rows.size))
        error = drawn_rocks((True,) * 4).mean(axis=0) - truth
        print(f"{name} ({rows.size}), mean of the prior alone: rms {_percent(np.sqrt((error**2).mean(axis=0)))}")
        for prior, one in zip(PRIORS, (alone, with_rocks(alone)), strict=True):
            error, ends = one.mean - truth, one.intervals(calibration())
            held = [((part[..., 0] <= truth + 1e-6) & (truth <= part[..., 1] + 1e-6)).mean() for part in ends]
            width = [np.median(part[..., 1] - part[..., 0]) for part in ends]
            good = (np.abs(error).max(axis=1) <= GOOD).mean()
            print(f"{name} ({rows.size}), {prior}: rms {_percent(np.sqrt((error**2).mean(axis=0)))}, bias "
                  f"{_percent(error.mean(axis=0))}, good {good:.2f}, held {held[0]:.2f} {held[1]:.2f}, width "
                  f"{width[0]:.2f} {width[1]:.2f}")  # fmt: skip


def boulders(folder: Path) -> None:
    """Medians over the boulders of Chang'E-4."""
    every = read_spectra(read_input(str(folder / "ce4/reflectance_factor.csv")))
    rocks = [one for one in every if one.id.endswith("rock")]
    for prior in PRIORS:
        shares = lunarsci.unmix(rocks, kind="solid-rock", prior=prior).shares
        for items in zip(*((*one.fractions, *one.ratios) for one in shares), strict=True):
            ends = [(item.fraction, item.low, item.high, item.low95, item.high95) for item in items]
            print(f"boulders ({len(rocks)}), {prior}: {items[0].mineral} {_percent(np.median(ends, axis=0))}")


def _percent(values: np.ndarray) -> str:
    return " / ".join(f"{100 * value:.0f}" for value in values)


if __name__ == "__main__":
    known_modes(Path(sys.argv[1]), Path(sys.argv[2]))
    boulders(Path(sys.argv[1]))
