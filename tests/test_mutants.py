"""Faults that are planted to try the tests: each changes one place of a formula, and nothing else."""

import ast
from pathlib import Path

import mutants
import pytest


@pytest.mark.parametrize(
    ("formula", "wrong"),
    [
        ("a + b", {"a - b"}),
        ("a * (b - c)", {"a / (b - c)", "a * (b + c)"}),
        ("-a", {"a"}),
        ("2 * a", {"3 * a", "2 / a"}),
        ("a ** 2", {"a ** 3"}),
        ("1e3 * a", {"0.001 * a", "1e3 / a"}),
        ("np.sin(a)", {"np.cos(a)"}),
        ("np.deg2rad(a)", {"np.rad2deg(a)"}),
        ("np.sqrt(a)", {"(a)"}),
        ("np.std(a, axis=0, ddof=1)", {"np.std(a, axis=1, ddof=1)", "np.std(a, axis=0, ddof=0)"}),
        ("a[0]", {"a[1]"}),
        ("n - 1", {"n + 1", "n - 2"}),
        ("a < b", {"a > b"}),
        ("np.quantile(a, 0.5)", {"np.quantile(a, 0.45)"}),
        ("-(a)", {"(a)"}),
        ('f"{a + b} m"', set()),
        ("'a' + b", set()),
    ],
)
def test_a_formula_goes_wrong_in_one_place(formula: str, wrong: set[str]) -> None:
    text = f"x = 1\ny = {formula}\n"
    assert {fault.planted(text) for fault in mutants.faults_of("x.py", text)} == {
        f"x = 1\ny = {one}\n" for one in wrong
    }


def test_what_leads_to_an_error_and_what_is_said_stays() -> None:
    text = 'def f(a: \'int | None\') -> int:\n    """Twice 2 * a."""\n    if a > 3:\n        raise E(2 * a)\n'
    assert mutants.faults_of("x.py", text) == []


def test_the_same_seed_draws_the_same_faults_and_each_is_python() -> None:
    """Another seed draws others."""
    one, same, other = (mutants.drawn(mutants.ROOT, 50, seed, "regolith|spectra/mgm") for seed in (3, 3, 4))
    assert one == same != other
    for fault in one:
        sound = (mutants.ROOT / fault.path).read_text("utf-8")
        ast.parse(fault.planted(sound))
        changed = zip(sound.splitlines(), fault.planted(sound).splitlines(), strict=True)
        assert [one for one, other in changed if one != other] == [sound.splitlines()[fault.line - 1]]


def test_a_module_has_its_own_tests_first() -> None:
    ranked = mutants.tests_for(mutants.ROOT, "lunarsci/regolith/integrals.py")
    assert (0, "tests/regolith/test_integrals.py") in ranked[:3]
    assert not [name for _, name in ranked if Path(name).stem in mutants.OWN_OUTPUT]


def test_a_fault_lies_in_the_copy_while_tests_run_and_is_gone_after(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "lunarsci").mkdir()
    file = tmp_path / "lunarsci/f.py"
    file.write_text("y = a + b\n")
    [fault] = mutants.faults_of("lunarsci/f.py", file.read_text())
    seen: list[str] = []
    broken = ["tests/test_f.py::broken"]

    def fails(copy: Path, files: list[str], limit_s: float, without: list[str]) -> str:
        """One test fails always, the other with the fault."""
        seen.append((copy / "lunarsci/f.py").read_text())
        if broken != without and files != ["tests/test_f.py::test_f"]:
            return broken[0]
        return "tests/test_f.py::test_f" if "-" in seen[-1] else ""

    monkeypatch.setattr(mutants, "fails", fails)
    monkeypatch.setattr(mutants, "tests_for", lambda root, path: [(0, "tests/test_f.py")])
    options = mutants.argparse.Namespace(near=1, nearest_only=False, timeout=9.0)
    assert mutants.killer(tmp_path, fault, options) == "tests/test_f.py::test_f"
    assert (seen, file.read_text()) == (["y = a - b\n", "y = a + b\n"] * 2, "y = a + b\n")
    broken.clear()
    monkeypatch.setattr(mutants, "fails", lambda *_: "")
    assert mutants.killer(tmp_path, fault, options) == ""
    lines = mutants.report([(fault, "a test"), (fault, "")])
    assert "sign                 1 of 2" in lines and "survived: lunarsci/f.py:1: '+' -> '-' (sign)" in lines
