"""Make the other tables of shares: `python make_share_calibration.py FOLDER NETWORKS OUT`.

FOLDER holds `reflectance.csv` and `manifest.csv` in `relab`, `minerals` and `meteorites`; NETWORKS the networks of the
folds, `fold-K.npz` of `make_share_networks.py`. Each spectrum of known modes is judged by networks and end members that
knew nothing of its suite, and no other powder of its specimens: with all four minerals, with its minerals named,
together with its series, and cut. Then the coefficients of `lunarsci.spectra.abundance.shares` are learned: the weight
of the end members by the continuous ranked probability score, sharpness and doubt by the logarithmic score, the levels
of intervals by what they hold of the minerals that are there, in spectra of more than one mineral of suites left out. A
suite of m spectra counts as the square root of m, but for the levels.

`share_calibration.csv` has the coefficients; `share_validation.csv` and `share_errors.csv` what comes out, each fold by
the coefficients of the others. OUT keeps what networks and end members said, `cases.pkl`, which is read where it is
there.
"""

import csv
import pickle
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from lunarsci.spectra_data.make_share_networks import FOLDS, PARTS, PURE, LabSpectra, fold_of, measured
from scipy.optimize import minimize

from lunarsci.io.inputs import read_input
from lunarsci.minerals import WEIGHED
from lunarsci.spectra.abundance.end_members import embedded_end_members, on_common_channels
from lunarsci.spectra.abundance.estimate import estimate_series
from lunarsci.spectra.abundance.kinds import find_kinds
from lunarsci.spectra.abundance.learned import Foretold, foretell_each, shared_out, unpacked
from lunarsci.spectra.abundance.shares import (
    GOOD,
    LIKELY,
    SOME,
    CalibratedShares,
    Mixed,
    answer,
    how_dark,
    pooled,
    present_terms,
    sharpened,
    terms_of,
    weight_terms,
)
from lunarsci.spectra.readers import read_spectra
from lunarsci.spectra.spectrum import Spectrum

ROCKS = ("Chip", "Slab", "Natural")
"""In the texture of what is no powder."""
LEAST_SPECTRA = 3
CUTS_NM = ((0, 1000), (0, 1300), (0, 1700), (700, 2500), (1000, 2500), (800, 1700))
"""Ranges that spectra are cut to, one after the other, so that what is missing weighs as it should."""
SLICES_NM = ((0, 510), (0, 600), (0, 800), (900, 1000), (1500, 1600), (2000, 2400))
"""The same of slices without a whole band, which say little: of the probability that a mineral is there alone."""
Known = dict[tuple[str, str], float]
WEIGHT_TERMS = ("constant", "ln_strange", "plagioclase", "ln_odds_dark")
TERMS = ("constant", "dark", "strange", "rock", "mixed", "missing", "shallow")
CENTRE = {("logit_doubt", "constant"): -3.0, ("logit_doubt", "strange"): 1.0, ("logit_doubt", "shallow"): 4.0}
"""Where coefficients are drawn to, others to 0: few spectra of known modes are outliers, and nine have bands less than
0.03 deep, three of them pyroxenes without iron that look like plagioclase. Assumed."""
DRAWN_TO = 0.003
"""How strongly; assumed."""
LEVELS = (("alone", "all"), ("mixed", "named"), ("series", "together"), ("missing", "cut"))
"""Terms of the levels of intervals, and the way of asking that each is learned from."""


@dataclass(frozen=True, eq=False)
class Cases:
    """Spectra in one way of asking: which, what was foretold and mixed, what there may be, and the truth."""

    way: str
    rows: np.ndarray
    foretold: Foretold
    mixed: Mixed | None
    allowed: np.ndarray
    truth: np.ndarray
    dark: np.ndarray
    rock: np.ndarray
    suite: np.ndarray
    fold: np.ndarray
    group: np.ndarray

    def part(self, chosen: np.ndarray) -> "Cases":
        """Some of them."""
        own = Foretold(*(getattr(self.foretold, one.name)[chosen] for one in fields(Foretold)))
        mixed = self.mixed and replace(
            self.mixed, **{name: getattr(self.mixed, name)[chosen] for name in ("probabilities", "strange", "rms_ln")}
        )
        rest = (getattr(self, f.name)[chosen] for f in fields(self)[4:])
        return Cases(self.way, self.rows[chosen], own, mixed, *rest)

    @property
    def weight(self) -> np.ndarray:
        """Of each spectrum, by its suite."""
        _, place, count = np.unique(self.suite, return_inverse=True, return_counts=True)
        return np.asarray(count[place] ** -0.5)


def all_spectra(folder: Path) -> list[Spectrum]:
    """In the order of `measured`."""
    return [one for part in PARTS for one in read_spectra(read_input(str(folder / part / "reflectance.csv")))]


def series_of(powders: LabSpectra) -> np.ndarray:
    """Name of the series that a mixture belongs to: its suite and its sieve; '' of what is no mixture."""
    mixed = (powders.shares.max(axis=1) < PURE) & (powders.manifest["part"].to_numpy() != "meteorites")
    sieves = powders.manifest["min_um"].astype(str) + "-" + (powders.manifest["max_um"].astype(float) // 10).astype(str)
    heads = ["".join(c for c in id[:5] if not id.startswith("pomix")) or id[:6] for id in powders.ids]
    return np.array([f"{head} {sieve}" if own else "" for head, sieve, own in zip(heads, sieves, mixed, strict=True)])


def cases(folder: Path, networks: Path) -> list[Cases]:
    """All ways of asking."""
    powders, spectra = measured(folder), all_spectra(folder)
    fold, count = fold_of(powders.suites), len(spectra)
    texture = powders.manifest["texture"].fillna("").astype(str)
    rock = np.array([any(name in text for name in ROCKS) for text in texture], dtype=float)
    group = np.where(rock > 0, "rock", np.where(powders.manifest["part"] == "meteorites", "meteorite", np.where(
        (powders.shares > 0.05).sum(axis=1) > 1, "mixture", "mineral")))  # fmt: skip
    dark = np.maximum(how_dark(find_kinds(spectra)), rock)
    everything, named = np.ones((count, 4)), (powders.shares > 0).astype(float)
    shorter = {
        way: [cut(spectrum, ranges[row % len(ranges)]) for row, spectrum in enumerate(spectra)]
        for way, ranges in {"cut": CUTS_NM, "sliced": SLICES_NM}.items()
    }
    seen = {"all": (spectra, everything), "named": (spectra, named)}
    seen |= {way: (some, everything) for way, some in shorter.items()}
    foretold = {way: Foretold.of_nothing(count) for way in seen}
    for k in range(FOLDS):
        with np.load(networks / f"fold-{k}.npz") as found:
            learned = unpacked(found)
        rows = np.flatnonzero(fold == k)
        for way, (some, allowed) in seen.items():
            one = foretell_each([some[row] for row in rows], allowed[rows], learned)
            foretold[way].put(rows, one)
    library = embedded_end_members(on_common_channels(spectra[:1]).wavelength_nm)
    alone = mixtures_of(
        powders, spectra, fold, library, [[row] for row in np.flatnonzero(named.sum(axis=1) > 1)], named
    )
    names = series_of(powders)
    groups = [np.flatnonzero(names == name).tolist() for name in dict.fromkeys(names) if name]
    together_named = np.array(
        [named[names == name].max(axis=0) if name else own for name, own in zip(names, named, strict=True)]
    )
    several = [group for group in groups if len(group) > 2]
    series = mixtures_of(powders, spectra, fold, library, several, together_named)
    base = (dark, rock, powders.suites, fold, group)
    whole = Cases("all", np.arange(count), foretold["all"], None, everything, powders.shares, *base)
    less = [
        Cases(way, np.arange(count), foretold[way], None, everything, powders.shares,
              np.maximum(how_dark(find_kinds(some)), rock), *base[1:])
        for way, some in shorter.items()
    ]  # fmt: skip
    own = Cases("named", np.arange(count), foretold["named"], alone[0], named, powders.shares, *base).part(alone[1])
    both = Cases("together", np.arange(count), foretold["named"], series[0], together_named, powders.shares, *base)
    return [whole, own, both.part(series[1]), *less]


def cut(spectrum: Spectrum, ends_nm: tuple[int, int]) -> Spectrum:
    """Only what lies in a range."""
    there = (spectrum.wavelength_nm >= ends_nm[0]) & (spectrum.wavelength_nm <= ends_nm[1])
    return Spectrum(spectrum.id, spectrum.wavelength_nm[there], spectrum.reflectance[there])


def mixtures_of(
    powders: LabSpectra, spectra: Sequence[Spectrum], fold: np.ndarray, library: Sequence, groups: Sequence[list[int]],
    allowed: np.ndarray,
) -> tuple[Mixed, np.ndarray]:  # fmt: skip
    """What end members say of groups of spectra, without any of the suites of the fold and of their specimens."""
    count = len(spectra)
    found = Mixed(
        np.zeros((count, 4, 21)), np.ones(count), np.full(count, np.nan), any(len(group) > 1 for group in groups)
    )
    there = np.zeros(count, dtype=bool)
    for group in groups:
        ids = {powders.ids[row] for row in np.flatnonzero(fold == fold[group[0]])}
        specimens = {item.specimen for item in library if item.id in ids} - {""}
        rest = [item for item in library if item.id not in ids and item.specimen not in specimens]
        minerals = [name for name, own in zip(WEIGHED, allowed[group[0]], strict=True) if own]
        one = estimate_series([spectra[row] for row in group], minerals, end_members=rest)
        found.probabilities[group], found.strange[group], found.rms_ln[group] = (
            one.probabilities,
            one.strange,
            one.rms_ln,
        )
        there[group] = True
    return found, there


def learn(every: Sequence[Cases], without: int | None = None) -> Known:
    """Coefficients from all spectra but those of a fold."""
    parts_of_all = [one.part(one.fold != without) for one in every]
    some = [one for one in parts_of_all if one.way != "sliced"]
    usual = np.quantile(some[0].foretold.ln_distance, [0.16, 0.5, 0.84])
    known: Known = {("ln_distance", "usual"): usual[1], ("ln_distance", "spread"): (usual[2] - usual[0]) / 2}
    for one in some:
        if one.mixed is not None:
            name = one.mixed.weight_name
            known |= {(name, term): value for term, value in zip(WEIGHT_TERMS, _weights(one), strict=True)}
    keys = [(quantity, term) for quantity in ("ln_sharpness", "logit_doubt") for term in TERMS]
    centre = np.array([CENTRE.get(key, 0.0) for key in keys])
    parts = [(pooled(one.foretold, one.mixed, one.dark, known), one) for one in some]
    ready = [
        (one, shares, terms_of(one.foretold, one.dark, one.rock, weight, known)) for (shares, weight), one in parts
    ]

    def loss(values: np.ndarray) -> float:
        own, total, size = dict(zip(keys, values, strict=True)), 0.0, 0.0
        for one, shares, terms in ready:
            found, _ = sharpened(shares, one.allowed, terms, own)
            each = -np.log((found * shared_out(one.truth)).sum(axis=-1) + 1e-9) * one.allowed
            total += float((one.weight * each.sum(axis=1)).sum())
            size += float((one.weight * one.allowed.sum(axis=1)).sum())
        return total / size + DRAWN_TO * float(((values - centre) ** 2).sum())

    known |= dict(zip(keys, minimize(loss, centre, method="BFGS").x.tolist(), strict=True))
    return known | _present(parts_of_all, known)


def _present(parts: Sequence[Cases], known: Known) -> Known:
    """Of the probability that a mineral is there: of whole spectra, then what missing channels add to that."""
    whole = [one for one in parts if not one.foretold.missing.all()]
    learned = _logistic_regression(whole, known, {"constant": 0.0, "ln_odds": 1.0}, {})
    return learned | _logistic_regression(parts, known, {"missing": 0.0, "ln_odds_missing": 0.0}, learned)


def _logistic_regression(parts: Sequence[Cases], known: Known, centre: Mapping[str, float], given: Known) -> Known:
    """Coefficients of some of `present_terms`, by name drawn to a `centre`, beside those `given`; ways count alike."""
    key, terms, true, weight = "logit_present", [], [], []
    for one in parts:
        there, result = one.allowed > 0, answered(one, known)
        every = present_terms(result.ln_odds_of_some(), result.missing[:, None])
        terms.append({name: term[there] for name, term in every.items()})
        true.append((one.truth > SOME)[there])
        weight.append((one.weight[:, None] * there / (one.weight[:, None] * there).sum())[there])
    x = {name: np.concatenate([one[name] for one in terms]) for name in terms[0]}
    y, w, start = np.concatenate(true), np.concatenate(weight), np.array(list(centre.values()))
    before = sum((value * x[name] for (_, name), value in given.items()), np.zeros(y.size))

    def loss(values: np.ndarray) -> float:
        line = before + values @ np.array([x[name] for name in centre])
        drawn = DRAWN_TO * float(((values - start) ** 2).sum())
        return float((w * (np.logaddexp(0.0, line) - y * line)).sum()) + drawn

    best = minimize(loss, start, method="BFGS").x.tolist()
    return {(key, name): value for name, value in zip(centre, best, strict=True)}


def _weights(one: Cases) -> list[float]:
    terms = weight_terms(one.foretold, one.mixed, one.dark)
    design = np.column_stack([terms[name] for name in WEIGHT_TERMS])
    below = [
        np.cumsum(part, axis=-1)
        for part in (one.foretold.probabilities, one.mixed.probabilities, shared_out(one.truth))
    ]

    def loss(values: np.ndarray) -> float:
        weight = (1 / (1 + np.exp(-design @ values)))[:, None, None]
        apart = (1 - weight) * below[0] + weight * below[1] - below[2]
        return float(
            (one.weight * (apart**2).sum(axis=(1, 2))).sum() / one.weight.sum() + 0.002 * (values[1:] ** 2).sum()
        )

    starts = (np.zeros(4), np.array([-2.0, 0, 0, 0]), np.array([2.0, 0, 0, 0]))
    return min((minimize(loss, start, method="BFGS") for start in starts), key=lambda found: found.fun).x.tolist()


def levels(every: Sequence[Cases], answers: Sequence[CalibratedShares], without: int | None = None) -> Known:
    """At which intervals hold 68 and 95 % of shares above 0, in spectra of more than one mineral but for a fold.

    `answers` are by coefficients that knew nothing of the spectra's fold. A mineral that is absent is nearly always
    within its interval, which begins at 0: with these counted as well, those that are there would be held too seldom.
    Spectra taken together have the level of each alone at least: few series are known.
    """
    known: Known = {(f"level{level}", term): 0.0 for level in (68, 95) for term, _ in LEVELS}
    for level in (68, 95):
        for term, way in LEVELS:
            one, shares = next(both for both in zip(every, answers, strict=True) if both[0].way == way)
            rows = (one.group != "mineral") & (one.fold != without)
            counted = rows[:, None] & (one.allowed > 0) & (one.truth > 0.0)
            low, high = known[f"level{level}", "mixed"] if term == "series" else 0.0, 0.999
            for _ in range(12):
                known[f"level{level}", term] = (low + high) / 2
                inside = holds(one, shares, known)[level == 95]
                low, high = (
                    ((low + high) / 2, high) if inside[counted].mean() < level / 100 else (low, (low + high) / 2)
                )
    return known


def answered(one: Cases, known: Mapping) -> CalibratedShares:
    """The answer of `shares`."""
    return answer(one.foretold, one.allowed, one.dark, one.rock, one.mixed, known)


def holds(one: Cases, found: CalibratedShares, known: Mapping) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whether intervals of 68 and 95 % hold the truth, (n, 4) each, and their widths (2, n, 4)."""
    ends = found.intervals(known)
    inside = [(part[..., 0] - 1e-6 <= one.truth) & (one.truth <= part[..., 1] + 1e-6) for part in ends]
    return inside[0], inside[1], np.array([part[..., 1] - part[..., 0] for part in ends])


@dataclass(frozen=True, eq=False)
class Nested:
    """Of one way of asking, each fold by what the others taught: arrays by spectrum, (n,), and by mineral, (n, 4)."""

    mean: np.ndarray
    near: np.ndarray
    present: np.ndarray
    held: np.ndarray
    width: np.ndarray


def nested(every: Sequence[Cases]) -> tuple[list[Nested], Known]:
    """Of each way; and the levels of intervals, learned on these answers."""
    laws = {fold: learn(every, fold) for fold in range(FOLDS)}
    answers = [left_out(one, laws) for one in every]
    laws = {fold: known | levels(every, answers, fold) for fold, known in laws.items()}
    found = []
    for one, shares in zip(every, answers, strict=True):
        count = len(one.rows)
        own = Nested(
            shares.mean, shares.near(), *(np.zeros(shape) for shape in ((count, 4), (2, count, 4), (2, count, 4)))
        )
        for fold, known in laws.items():
            rows = one.fold == fold
            own.present[rows] = shares.present(known)[rows]
            inside68, inside95, width = holds(one, shares, known)
            own.held[0, rows], own.held[1, rows], own.width[:, rows] = inside68[rows], inside95[rows], width[:, rows]
        found.append(own)
    return found, levels(every, answers)


def left_out(one: Cases, laws: Mapping[int, Known]) -> CalibratedShares:
    """Answers to all spectra of a way, each fold by what the others taught."""
    parts = [(np.flatnonzero(one.fold == fold), known) for fold, known in laws.items()]
    each = [answered(one.part(rows), known) for rows, known in parts]
    order = np.argsort(np.concatenate([rows for rows, _ in parts]))
    names = ("probabilities", "doubt", "weight", "missing")
    arrays = {name: np.concatenate([getattr(part, name) for part in each])[order] for name in names}
    return CalibratedShares(**arrays, series=each[0].series)


def judged(every: Sequence[Cases], found: Sequence[Nested]) -> list[dict[str, str]]:
    """A row for each way of asking and sort of spectra."""
    rows = []
    for one, own in zip(every, found, strict=True):
        if one.way == "sliced":
            continue
        error = np.abs(own.mean - one.truth)
        good, inside = error.max(axis=1) <= GOOD, own.near >= LIKELY
        sorts = {name: one.group == name for name in ("mixture", "mineral", "meteorite", "rock")}
        sorts["mixture or meteorite"] = sorts["mixture"] | sorts["meteorite"]
        for name, m in sorts.items():
            if m.sum() < LEAST_SPECTRA:
                continue
            there, some = one.allowed[m] > 0, one.truth[m] > 0.0
            numbers = {
                "within_15": good[m].mean(),
                "in_domain": inside[m].mean(),
                "in_domain_and_good": (good & inside)[m].mean(),
                "precision": good[m & inside].mean(),
                **{f"held{level}": own.held[k][m][there].mean() for k, level in enumerate((68, 95))},
                **{f"there{level}": own.held[k][m][there & some].mean() for k, level in enumerate((68, 95))},
                **{f"width{level}": np.median(own.width[k][m][there]) for k, level in enumerate((68, 95))},
                "present_error": calibration_error(own.present[m][there], one.truth[m][there] > SOME),
            }
            rms = zip(WEIGHED, np.sqrt((error[m] ** 2).mean(axis=0)), strict=True)
            rows.append({"way": one.way, "spectra": name, "count": str(m.sum())}
                        | {f"rms_{mineral}": f"{value:.3f}" for mineral, value in rms}
                        | {key: f"{value:.2f}" for key, value in numbers.items()})  # fmt: skip
    return rows


def calibration_error(chance: np.ndarray, true: np.ndarray) -> float:
    """Over five bins of probability."""
    bins = np.minimum((chance * 5).astype(int), 4)
    return float(
        sum(
            abs(chance[bins == k].mean() - true[bins == k].mean()) * (bins == k).mean()
            for k in range(5)
            if (bins == k).any()
        )
    )


def write(out: Path, known: Known, every: Sequence[Cases], found: Sequence[Nested], ids: Sequence[str]) -> None:
    """All tables."""
    with (out / "share_validation.csv").open("w", newline="") as file:
        rows = judged(every, found)
        table = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
    with (out / "share_calibration.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["quantity", "term", "value"])
        writer.writerows([*key, f"{value:.4f}"] for key, value in known.items())
    with (out / "share_errors.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(
            ["class", "suite", "id", "in_domain", *(f"error_{m}" for m in WEIGHED), *(f"sigma_{m}" for m in WEIGHED)]
        )
        names = {"mixture": "powder-mixture", "meteorite": "dark-rock-powder", "rock": "solid-rock"}
        one, own = every[0], found[0]
        sigma = np.maximum(own.width[0] / 2, own.width[1] / 4)
        for row in np.flatnonzero(one.group != "mineral"):
            numbers = [f"{x:.3f}" for x in [*(own.mean - one.truth)[row], *sigma[row]]]
            inside = str(bool(own.near[row] >= LIKELY)).lower()
            writer.writerow([names[one.group[row]], one.suite[row].rstrip("-"), ids[row], inside, *numbers])


def main() -> None:
    """Write the tables."""
    folder, networks, out = map(Path, sys.argv[1:4])
    out.mkdir(parents=True, exist_ok=True)
    kept = out / "cases.pkl"
    if not kept.exists():
        kept.write_bytes(pickle.dumps(cases(folder, networks)))
    every = pickle.loads(kept.read_bytes())
    found, heights = nested(every)
    write(out, learn(every) | heights, every, found, measured(folder).ids)


if __name__ == "__main__":
    main()
