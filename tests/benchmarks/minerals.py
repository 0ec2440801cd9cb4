"""Shares of minerals by several methods, whole suites left out, as one table: `python tests/benchmarks/minerals.py`.

Needs the reference data, found through LUNARSCI_REFERENCE_DATA, and scikit-learn. A method is a function of spectra,
and of the ids of all that it must not have seen: the suite itself, mixtures of the same powders, and other spectra of
its rocks. It answers with shares of olivine, orthopyroxene, clinopyroxene and plagioclase, with intervals, and with its
verdict. Of a soil the truth is its norm, plagioclase alone of which stands for a mineral. Words after the name of this
file choose among the methods.
"""

import os
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
from lunarsci.spectra_data import make_kinds, make_normative
from lunarsci.spectra_data.make_abundance_calibration import COLUMNS

from lunarsci.inputs import read_input
from lunarsci.spectra.abundance.end_members import FAMILY_OF, embedded_end_members, without_siblings
from lunarsci.spectra.abundance.kinds import KindVerdict, find_kinds, learn_kinds
from lunarsci.spectra.abundance.normative import silicate_norm
from lunarsci.spectra.abundance.one_by_one import estimate_each
from lunarsci.spectra.abundance.result import Abundance, refused, without_centres
from lunarsci.spectra.library.end_member import EndMember
from lunarsci.spectra.readers import read_spectra
from lunarsci.spectra.spectrum import Spectrum

__all__ = ["Answer", "Case", "Score", "cases", "methods", "ours", "score", "table"]

MINERALS = tuple(FAMILY_OF)
NORM = ("olivine", "hypersthene", "diopside", "plagioclase")
GROUPS = ("powder mixtures", "chondrites", "achondrites", "soils")
CHANNELS = np.arange(460.0, 2381.0, 20.0)
PURE, GOOD = 0.97, 15.0
"""Share of one mineral from which a powder is no mixture; worst error of a good answer. [-, vol %]"""
CHIP = r"Chip|Slab|Natural"
KIN = {
    "olivine-pyroxene": r"pomix|OOCMIX|MIX|PYX0|PP-EAC-087|PP-EAC-016|PP-EAC-001",
    "XP-CMP": r"XP-CMP|PE-CMP-03|PP-CMP-02",
    "AG-TJM": r"AG-TJM",
}
"""Mixtures of the same powders, with these powders."""
AGREE = 0.08
"""Standard deviation of a share over several methods up to which they agree: chosen on these cases, so that precision
and recall of that verdict are too good."""
PUBLISHED = (
    ("Hapke and Shkuratov, HED meteorites", "Li & Milliken (2015), 10.1111/maps.12513", "5-10"),
    ("network on RELAB, without plagioclase", "Korda et al. (2023), arXiv:2305.05700", "6-10"),
    ("bands of olivine and orthopyroxene, their mixtures", "arXiv:2101.04275", "15"),
    ("band area ratio, ol / (ol + px) of chondrites", "Dunn et al. (2010), 10.1016/j.icarus.2010.02.016", "3"),
)
"""Errors as their authors give them, on data of their own; none leaves whole suites out."""


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A spectrum whose modes (4,) are known; group is empty for single minerals, which only methods that learn use."""

    spectrum: Spectrum
    modes: np.ndarray
    group: str
    fold: str
    rock: str


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """Shares (n, 4), NaN where not determined; intervals (n, 4, 4): low, high, low95, high95; verdict (n,) or None."""

    shares: np.ndarray
    intervals: np.ndarray
    in_domain: np.ndarray | None = None


Method = Callable[[Sequence[Spectrum], frozenset[str]], Answer]
Judged = tuple[Case, np.ndarray, np.ndarray, bool | None]
"""A case, its shares, intervals and verdict."""


@dataclass(frozen=True, slots=True)
class Score:
    """Errors over what is determined [vol %], and shares of truths within intervals."""

    count: int
    determined: int
    rms: tuple[float, ...]
    pyroxene: float
    held68: float
    held95: float
    correlation: float
    good: int
    taken: int
    taken_good: int


@cache
def cases(data: Path) -> tuple[Case, ...]:
    """All spectra with known modes, chips and slabs left out."""
    found = [case for name in ("relab", "minerals", "meteorites") for case in _laboratory(data / "spectra", name)]
    spectra, known = make_normative.soils(data / "spectra")
    for spectrum, (_, row) in zip(spectra, known.iterrows(), strict=True):
        oxides = {name: row[f"{name}_wt"] for name in ("feo", "tio2", "mgo", "cao", "al2o3")}
        norm = silicate_norm(oxides, row["na2o_wt"])
        modes = np.array([norm[name] for name in NORM])
        found.append(Case(spectrum, modes, "soils", row["mission"], spectrum.id))
    return tuple(found)


def _laboratory(folder: Path, name: str) -> list[Case]:
    rows = pd.read_csv(folder / name / "manifest.csv").drop_duplicates("id").set_index("id")
    found = []
    for spectrum in read_spectra(read_input(str(folder / name / "reflectance.csv"))):
        row = rows.loc[spectrum.id]
        modes = row[list(COLUMNS.values())].to_numpy(float)
        if re.search(CHIP, str(row.get("texture", ""))) or not abs(modes.sum() - 1) < 0.01:
            continue
        rock = re.split(r"[ ,]", str(row["name"]))[0].lower() if name == "meteorites" else spectrum.id
        found.append(Case(spectrum, modes / modes.sum(), _group(name, row, modes), fold_of(spectrum.id), rock))
    return found


def _group(name: str, row: pd.Series, modes: np.ndarray) -> str:
    if name != "meteorites" or str(row.name).startswith("MS-CMP"):
        return "powder mixtures" if modes.max() < PURE else ""
    return "chondrites" if "Chondrite" in str(row["type"]) else "achondrites"


def fold_of(id: str) -> str:
    """Suite, or family of mixtures of the same powders."""
    family = next((name for name, pattern in KIN.items() if re.match(pattern, id)), "")
    return family or make_kinds.suite_of(id)


def folds(data: Path) -> list[tuple[list[Case], frozenset[str]]]:
    """Cases that are judged together, and what may not have been seen by then."""
    every, found = cases(data), []
    for name in sorted({case.fold for case in every if case.group}):
        own = [case for case in every if case.fold == name and case.group]
        rocks = {case.rock for case in own}
        found.append((own, frozenset(case.spectrum.id for case in every if case.fold == name or case.rock in rocks)))
    return found


def channels(spectra: Sequence[Spectrum]) -> np.ndarray:
    """Level, and ln R in steps of 20 nm less its mean, (n, 98)."""
    rows = []
    for spectrum in spectra:
        own = spectrum.usable
        ln = np.interp(CHANNELS, spectrum.wavelength_nm[own], np.log(spectrum.reflectance[own]))
        rows.append([ln.mean(), *(ln - ln.mean())])
    return np.array(rows)


def ours(data: Path, minerals: Sequence[str] = MINERALS) -> Method:
    """`spectra unmix` with all four minerals, one spectrum at a time, its library and its kinds without what is out."""
    known = make_kinds.examples(data / "spectra")
    features = make_kinds.features(known)
    library = embedded_end_members(np.arange(450.0, 2451.0, 5.0))

    def answer(spectra: Sequence[Spectrum], left_out: frozenset[str]) -> Answer:
        kept = np.array([item.spectrum.id not in left_out for item in known])
        names, suites = (
            [getattr(item, key) for item, ok in zip(known, kept, strict=True) if ok] for key in ("component", "suite")
        )
        kinds = find_kinds(spectra, model=learn_kinds(features[kept], names, suites, make_kinds.COMPONENTS))
        end_members = without_siblings(library, sorted(left_out))
        found = [_one(spectrum, kind, minerals, end_members) for spectrum, kind in zip(spectra, kinds, strict=True)]
        return as_answer(found)

    return answer


def _one(spectrum: Spectrum, kind: KindVerdict, minerals: Sequence[str], end_members: Sequence[EndMember]) -> Abundance:
    if kind.is_weathered:
        return refused(spectrum.id, "unmix", minerals, "weathered")
    [found] = estimate_each([spectrum], minerals, kinds=[kind], end_members=end_members)
    return without_centres(found, "stranger") if kind.stranger else found


def as_answer(found: Sequence[Abundance]) -> Answer:
    """Shares of results in the order of `MINERALS`; a mineral that is not named is absent."""
    shares, intervals = np.zeros((len(found), 4)), np.zeros((len(found), 4, 4))
    for row, one in enumerate(found):
        for item in one.fractions:
            if item.mineral in MINERALS:
                place = MINERALS.index(item.mineral)
                shares[row, place] = item.fraction
                intervals[row, place] = (item.low, item.high, item.low95, item.high95)
    return Answer(shares, intervals, np.array([one.in_domain for one in found]))


def constant(data: Path) -> Method:
    """Mean of the class, which is told, over the other suites."""
    every = cases(data)
    group_of = {case.spectrum.id: case.group for case in every}

    def answer(spectra: Sequence[Spectrum], left_out: frozenset[str]) -> Answer:
        shares, intervals = np.zeros((len(spectra), 4)), np.zeros((len(spectra), 4, 4))
        for row, spectrum in enumerate(spectra):
            own = [case for case in every if case.group == group_of[spectrum.id] and case.spectrum.id not in left_out]
            modes = np.array([case.modes for case in own])
            shares[row] = modes.mean(axis=0)
            intervals[row] = np.quantile(modes, (0.16, 0.84, 0.025, 0.975), axis=0).T
        return Answer(shares, intervals)

    return answer


def learned(data: Path, make: Callable[[], list[object]]) -> Method:
    """Of scikit-learn: of all candidates the one with the least error over suites left out within what may be seen;
    the quantiles of these errors are its intervals."""
    every = cases(data)
    rows = channels([case.spectrum for case in every])
    modes = np.array([case.modes for case in every])
    folds_of = np.array([case.fold for case in every])
    ids = [case.spectrum.id for case in every]
    place = {id: row for row, id in enumerate(ids)}

    @cache
    def known(asked_of: tuple[Spectrum, ...], left_out: frozenset[str]) -> Answer:
        from sklearn.base import clone
        from sklearn.model_selection import GroupKFold, cross_val_predict

        kept = np.array([id not in left_out for id in ids])
        guesses = [
            _shares(cross_val_predict(model, rows[kept], modes[kept], groups=folds_of[kept], cv=GroupKFold(5)))
            for model in make()
        ]
        best = int(np.argmin([np.mean((guess - modes[kept]) ** 2) for guess in guesses]))
        model = clone(make()[best]).fit(rows[kept], modes[kept])
        asked = rows[[place[spectrum.id] for spectrum in asked_of]]
        shares = _shares(model.predict(asked))
        wide = np.quantile(np.abs(guesses[best] - modes[kept]), (0.6827, 0.95), axis=0)
        ends = [shares - wide[0], shares + wide[0], shares - wide[1], shares + wide[1]]
        return Answer(shares, np.clip(np.stack(ends, axis=-1), 0.0, 1.0))

    return lambda spectra, left_out: known(tuple(spectra), left_out)


def agreeing(parts: Sequence[Method]) -> Method:
    """Mean of several methods and of their intervals; in domain where they agree."""

    def answer(spectra: Sequence[Spectrum], left_out: frozenset[str]) -> Answer:
        found = [part(spectra, left_out) for part in parts]
        shares = np.array([one.shares for one in found])
        intervals = np.mean([one.intervals for one in found], axis=0)
        return Answer(shares.mean(axis=0), intervals, shares.std(axis=0).max(axis=1) < AGREE)

    return answer


def _shares(found: np.ndarray) -> np.ndarray:
    """Not below 0, and of sum 1."""
    kept = np.clip(found, 1e-6, None)
    return np.asarray(kept / kept.sum(axis=1, keepdims=True))


def least_squares() -> list[object]:
    """Partial least squares of 4, 8 or 14 components."""
    from sklearn.cross_decomposition import PLSRegression
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    return [make_pipeline(StandardScaler(), PLSRegression(count, scale=False)) for count in (4, 8, 14)]


def kernel() -> list[object]:
    """Ridge regression with a Gaussian kernel."""
    from sklearn.kernel_ridge import KernelRidge
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    grid = [(alpha, gamma) for alpha in (0.03, 0.3) for gamma in (3e-4, 3e-3)]
    return [make_pipeline(StandardScaler(), KernelRidge(alpha=a, kernel="rbf", gamma=g)) for a, g in grid]


def network() -> list[object]:
    """Three networks of one hidden layer of 24, averaged."""
    from sklearn.ensemble import BaggingRegressor
    from sklearn.neural_network import MLPRegressor
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    layer = MLPRegressor(hidden_layer_sizes=(24,), alpha=0.3, solver="lbfgs", max_iter=300)
    every = BaggingRegressor(layer, n_estimators=3, bootstrap=False, random_state=0)
    return [make_pipeline(StandardScaler(), every)]


def methods(data: Path) -> dict[str, Method]:
    """All of the table."""
    parts = {
        "partial least squares": learned(data, least_squares),
        "kernel regression": learned(data, kernel),
        "network": learned(data, network),
    }
    return {
        "constant of the class": constant(data),
        **parts,
        "mean of the three": agreeing(list(parts.values())),
        "lunarsci, four minerals named": ours(data),
    }


def answers(data: Path, method: Method, groups: Sequence[str] = GROUPS) -> list[Judged]:
    """Case, shares, intervals and verdict of each."""
    found: list[Judged] = []
    for own, left_out in folds(data):
        asked = [case for case in own if case.group in groups]
        if asked:
            one = method([case.spectrum for case in asked], left_out)
            verdict = one.in_domain if one.in_domain is not None else [None] * len(asked)
            found += list(zip(asked, one.shares, one.intervals, verdict, strict=True))
    return found


def score(found: Sequence[Judged]) -> Score:
    """Of the answers of one group, or of several."""
    truth = np.array([case.modes for case, *_ in found])
    shares, ends = np.array([item[1] for item in found]), np.array([item[2] for item in found])
    told = np.isfinite(shares).all(axis=1)
    errors = 100 * (shares - truth)
    own = errors[told]
    inside = [(ends[..., k] <= truth + 1e-9) & (truth <= ends[..., k + 1] + 1e-9) for k in (0, 2)]
    good = told & (np.abs(np.where(told[:, None], errors, 0.0)).max(axis=1) <= GOOD)
    taken = np.array([bool(item[3]) for item in found])
    varies = told.sum() > 3 and np.ptp(truth[told, 0]) > 0.05 and np.ptp(shares[told, 0]) > 1e-6
    return Score(
        len(found),
        int(told.sum()),
        tuple(float(value) for value in np.sqrt(np.mean(own**2, axis=0))) if told.any() else (np.nan,) * 4,
        float(np.sqrt(np.mean((own[:, 1] + own[:, 2]) ** 2))) if told.any() else np.nan,
        float(inside[0].mean()),
        float(inside[1].mean()),
        float(np.corrcoef(truth[told, 0], shares[told, 0])[0, 1]) if varies else np.nan,
        int(good.sum()),
        int(taken.sum()),
        int((good & taken).sum()),
    )


def table(data: Path, chosen: dict[str, Method], groups: Sequence[str] = GROUPS) -> list[str]:
    """As Markdown: a row for each method and group, and one over all groups."""
    head = ["method", "spectra", "determined", "olivine", "orthopyroxene", "clinopyroxene", "plagioclase", "pyroxenes"]
    head += ["r of olivine", "68 % hold", "95 % hold", "in domain", "precision", "recall"]
    lines = [f"| {' | '.join(head)} |", f"|{' --- |' * len(head)}"]
    for name, method in chosen.items():
        found = answers(data, method, groups)
        parts = [(group, [item for item in found if item[0].group == group]) for group in groups]
        for group, part in [*parts, ("all", found)] if len(groups) > 1 else parts:
            judged = found and found[0][3] is not None
            lines.append(f"| {name}: {group} | {' | '.join(_cells(score(part), bool(judged)))} |")
    return lines


def _cells(one: Score, judged: bool) -> list[str]:
    numbers = [*one.rms, one.pyroxene]
    cells = [str(one.count), str(one.determined), *("-" if np.isnan(value) else f"{value:.0f}" for value in numbers)]
    cells += ["-" if np.isnan(one.correlation) else f"{one.correlation:.2f}", f"{one.held68:.2f}", f"{one.held95:.2f}"]
    if not judged:
        return [*cells, "-", "-", "-"]
    ratios = [(one.taken_good, one.taken), (one.taken_good, one.good)]
    return [*cells, str(one.taken), *(f"{part / whole:.2f}" if whole else "-" for part, whole in ratios)]


def main() -> None:
    """Print the table, or the rows of methods whose names hold the words given."""
    data = Path(os.environ["LUNARSCI_REFERENCE_DATA"])
    chosen = {name: item for name, item in methods(data).items() if all(word in name for word in sys.argv[1:])}
    print("\n".join(table(data, chosen)))
    print("\n| published, on data of the authors | source | error [vol %] |\n| --- | --- | --- |")
    for what, source, error in PUBLISHED:
        print(f"| {what} | {source} | {error} |")


if __name__ == "__main__":
    main()
