"""Help that teaches: examples that run, completion, manual pages, nearest names, sections of a config file."""

import doctest
import os
import re
import shutil
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import pytest
import typer
from lunarsci.cli import command_line, main
from lunarsci.cli.manual import pages, write

import lunarsci
from lunarsci.errors import LunarSciWarning
from lunarsci.minerals import MINERALS

NEEDS_PICTURES_OF_A_BOARD = "images calibrate"
"""`tests/images/test_calibration.py` runs its examples, with pictures that are made there."""


MAKERS = (
    "template", "spectra simulate", "spectra calibrate", "spectra fit", "spectra unmix", "spectra map",
    "spectra library import", "regolith infer", "images render", "images dem", "twin terrain", "twin plan",
    "twin predict", "twin simulate", "twin states", "twin update",
)  # fmt: skip
"""Commands whose files the examples of others take, in the order in which they can be run."""
UNBROKEN = {"--json", "--csv", "--field", "cite", "template"}
"""What prints for programs."""


def commands(command: object = None, words: str = "") -> Iterator[tuple[str, object]]:
    """Words and command of each command, groups left out."""
    found = typer.main.get_command(command_line()) if command is None else command
    inner = getattr(found, "commands", None)
    if inner is None:
        yield words, found
        return
    for name, one in inner.items():
        yield from commands(one, f"{words} {name}".strip())


def examples(command: object) -> list[str]:
    """What a user may type, as it stands below the help of a command."""
    return re.split(r"\n  (?=lunarsci)", command.epilog.removeprefix("Examples:\n  "))


def test_every_command_has_two_examples_in_its_help() -> None:
    for words, command in commands():
        lines = examples(command)
        assert len(lines) >= 2, words
        assert all(line.startswith(f"lunarsci {words}") for line in lines)
        assert max(len(line.removeprefix("    ")) for text in lines for line in text.split("\n")) <= 77


def test_options_of_a_long_help_are_in_panels() -> None:
    for words, command in commands():
        own = [one for one in command.params if one.param_type_name == "option" and not one.hidden]
        assert len([one for one in own if one.rich_help_panel is None]) <= 6, words


def test_options_of_the_examples_exist() -> None:
    for words, command in commands():
        known = {name for option in command.params for name in option.opts}
        used = {found for line in examples(command) for found in re.findall(r"(?<!\S)(--?[a-z][a-z-]*)", line)}
        assert used <= known, words


@pytest.mark.slow
def test_examples_run_one_after_the_other(
    tmp_path: Path, program: Path, demo: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a user types them, in an empty folder; exit code 3 says that a result is not to be trusted.

    `lunarsci demo` was run before.

    No line is wider than a terminal of 80 columns. Examples of Python's functions take the files that are there then.
    """
    environment = os.environ | {"PATH": f"{program}{os.pathsep}{os.environ['PATH']}", "COLUMNS": "80"}
    (tmp_path / "lunarsci-demo").symlink_to(demo / "lunarsci-demo")
    failed, wide = [], []
    every = {words: examples(command) for words, command in commands()}
    for words, lines in ({words: every[words] for words in MAKERS} | every).items():
        for line in lines if words != NEEDS_PICTURES_OF_A_BOARD else ():
            if line.startswith("lunarsci demo"):
                continue
            done = subprocess.run(["bash", "-c", line], cwd=tmp_path, env=environment, capture_output=True, text=True)
            if done.returncode not in (0, 3):
                failed.append((line, done.stderr.splitlines()[-1:]))
            printed = [] if UNBROKEN & set(line.split()) else done.stdout.splitlines()
            wide += [(line, one) for one in printed if len(one) > 80]
    assert failed == []
    assert wide == [], "\n".join(map(str, wide))
    monkeypatch.chdir(tmp_path)
    assert [name for name in lunarsci.__all__[1:] if not python_example_runs(name)] == []


def python_example_runs(name: str) -> bool:
    """Whether there is one in the docstring, and it shows what it says."""
    example = doctest.DocTestParser().get_doctest(
        getattr(lunarsci, name).__doc__, {"lunarsci": lunarsci}, name, None, None
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LunarSciWarning)
        return bool(example.examples) and doctest.DocTestRunner().run(example).failed == 0


def test_a_template_is_the_same_in_a_file(run, tmp_path: Path) -> None:
    """Whose ending is its own: no table of its lines."""
    path = tmp_path / "telemetry.csv"
    assert run("template", "telemetry", "-o", str(path)).code == 0
    assert path.read_text("utf-8") == run("template", "telemetry").out


@pytest.mark.parametrize("words", [[], ["spectra"], ["spectra", "bands"]])
def test_h_is_help(run, words: list[str]) -> None:
    assert run(*words, "-h").out == run(*words, "--help").out != ""


def completed(*words: str) -> list[str]:
    environment = os.environ | {"_LUNARSCI_COMPLETE": "complete_bash", "COMP_WORDS": " ".join(["lunarsci", *words])}
    line = [
        sys.executable,
        "-c",
        "import sys; sys.argv = ['lunarsci']; from lunarsci.cli import main; sys.exit(main())",
    ]
    done = subprocess.run(line, env=environment | {"COMP_CWORD": str(len(words))}, capture_output=True, text=True)
    return done.stdout.split()


def test_a_shell_completes_commands_and_options() -> None:
    assert completed("spec") == ["spectra"]
    assert completed("spectra", "ma") == ["match", "map"]
    assert completed("spectra", "fit", "--assem") == ["--assemblage"]
    assert "doctor" in completed("")
    assert completed("twin", "predict", "--rover", "") == ["husky", "rosey", "small-four", "yutu2"]
    assert completed("regolith", "forces", "--soil", "lunar-t") == ["lunar-typical"]
    later = [*MINERALS][2:]
    assert completed("spectra", "fit", "--assemblage", "OL-O") == [
        "-".join(("OL", "OPX", *some)) for count in range(len(later) + 1) for some in combinations(later, count)
    ]


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (["twn"], "twin"),
        (["spectra", "fitt"], "fit"),
        (["spectra", "bands", "x.csv", "--continum", "hull"], "--continuum"),
        (["spectra", "bands", "x.csv", "--continuum", "hul"], "hull"),
        (["regolith", "forces", "--sinkage", "0.01", "--soil", "lunar-typicl"], "lunar-typical"),
        (["regolith", "forces", "--sinkage", "0.01", "--rover", "cmu-grousr"], "cmu-grouser"),
        (["regolith", "forces", "--sinkage", "0.01", "--field", "slip_ration"], "slip_ratio"),
        (["twin", "predict", "--sweep", "friction_angle=30:50:3"], "friction_angle_deg"),
        (["template", "rver"], "rover"),
    ],
)
def test_an_error_names_the_nearest(run, arguments: list[str], meant: str) -> None:
    wrong = run(*arguments)
    assert wrong.code in (1, 2) and len(wrong.err) == 1
    assert re.search(
        rf"(did you mean '|Did you mean '|Did you mean |Possible options: [^)]*){meant}\b", wrong.err[0]
    ), wrong.err


def test_a_config_file_has_a_section_a_command(run, states: Path, tmp_path: Path) -> None:
    config = tmp_path / "run.toml"
    config.write_text("[regolith.forces]\nsinkage = 0.01\n[regolith.identify]\nseed = 3\n[spectra.bands]\nsmooth = 5\n")
    forces = ("regolith", "forces", "--config", config, "--field", "sinkage_m")
    assert float(run(*forces).out) == 0.01
    assert float(run(*forces, "--sinkage", "0.02").out) == 0.02
    assert run("regolith", "identify", states, "--config", config).code == 0
    for text, meant in (
        ("[regolit.forces]\n", "regolith"),
        ("[regolith.force]\n", "forces"),
        ("sinkge = 1\n", "sinkage"),
    ):
        config.write_text(text)
        wrong = run(*forces)
        assert (wrong.code, wrong.out, len(wrong.err)) == (2, "", 1)
        assert f"did you mean '{meant}'" in wrong.err[0]


def test_a_manual_page_has_every_option_of_its_command(tmp_path: Path) -> None:
    made = pages()
    known = dict(commands())
    assert {f"lunarsci-{words.replace(' ', '-')}.1" for words in known} < made.keys()
    for words, command in known.items():
        text = made[f"lunarsci-{words.replace(' ', '-')}.1"].replace(r"\-", "-")
        assert all(name in text for option in command.params for name in option.opts if name.startswith("--"))
        assert all(line.split(" \\\n")[0] in text for line in examples(command))
    write(str(tmp_path))
    if shutil.which("groff"):
        for path in (tmp_path / "lunarsci.1", tmp_path / "lunarsci-spectra-fit.1"):
            done = subprocess.run(["groff", "-k", "-man", "-Tutf8", "-ww", path], capture_output=True, text=True)
            assert (done.returncode, done.stderr) == (0, "")
            assert "EXIT STATUS" in re.sub("\x1b\\[[0-9;]*m|.\x08", "", done.stdout)


def test_a_template_and_a_citation_are_printed_as_they_are(
    run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    monkeypatch.chdir(tmp_path)
    text = run("template", "plan").out
    assert text.startswith("# A plan") and "[[leg]]" in text and max(map(len, text.splitlines())) > 60
    assert run("template", "plan", "-o", "plan.toml").code == 0
    assert Path("plan.toml").read_text("utf-8") == text
    assert run("info", "plan.toml", "--field", "kind").out == "plan\n"
    run("regolith", "forces", "--sinkage", "0.008", "-o", "forces.json")
    assert run("cite", "forces.json").out.startswith("@misc{lunarsci,")
    assert "ding2024" in run("cite", "forces.json", "--columns", "key").out


def test_info_of_what_would_be_refused_ends_with_3(run, tmp_path: Path) -> None:
    wrong = tmp_path / "plan.toml"
    wrong.write_text("[drive]\nspeed_m_s = 0.05\n[[leg]]\nlenght_m = 3\n")
    done = run("info", wrong)
    assert done.code == 3 and "plan of a drive" in done.out
    assert done.err[-1].startswith("not to be used as it is: ")


def test_python_runs_the_command(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    done = subprocess.run([sys.executable, "-m", "lunarsci", "--version"], capture_output=True, text=True)
    assert done.stdout == capfd.readouterr().out


def test_a_value_of_another_command_and_a_part_of_a_value_are_understood(run: Callable[..., Any]) -> None:
    [other] = run("spectra", "fit", "x.csv", "--continuum", "hull").err
    assert "'log-quadratic'" in other and "'hull' is one of `lunarsci spectra bands --continuum`" in other
    assert "Did you mean 'solid-rock'?" in run("spectra", "unmix", "x.csv", "--kind", "rock").err[0]


def test_info_names_options_as_they_are_typed_and_lists_all_names(run: Callable[..., Any], tmp_path: Path) -> None:
    names = [f"rock{k}" for k in range(9)]
    rows = [",".join(["wavelength", *names]), *(f"{w},{','.join(['0.2'] * 9)}" for w in range(500, 2500, 10))]
    file = tmp_path / "many.csv"
    file.write_text("\n".join(rows))
    short = run("info", file).out
    assert "give --wavelength-unit nm" in short and "and 3 more: --verbose" in short
    assert ", ".join(names) in run("info", file, "--verbose").out
    assert "give --wavelength-unit nm" in run("info", file, "--json").out
