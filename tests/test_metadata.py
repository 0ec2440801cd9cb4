"""What conda and Zenodo are told is what pyproject.toml says."""

import re
import tomllib
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path

import pytest

import lunarsci
from lunarsci.provenance import installed_version

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
RECIPE = (ROOT / "conda/meta.yaml").read_text("utf-8")
CITATION = (ROOT / "CITATION.cff").read_text("utf-8")
ROW = re.compile(r"^\| ([\w-]+) \| ([\w.-]+) \| (.*lunarsci.*) \|$", re.MULTILINE)
LICENCES = ROW.findall((ROOT / "SECURITY.md").read_text("utf-8"))
"""Package, licence, and what it comes with."""
FOR_DEVELOPERS = {"quick", "test", "docs", "dev"}


def listed(section: str) -> list[str]:
    """Entries of a list of the recipe."""
    found = re.search(rf"^  {section}:\n((?:    - .+\n)+)", RECIPE, re.MULTILINE)
    return re.findall(r"    - (.+)", found[1])


def test_the_version_is_that_of_the_project() -> None:
    assert lunarsci.__version__ == installed_version("lunarsci") == PROJECT["version"]


def test_the_recipe_needs_what_the_project_needs() -> None:
    assert listed("run") == [f"python {PROJECT['requires-python']}", *PROJECT["dependencies"]]
    assert f'version: "{PROJECT["version"]}"\n' in RECIPE
    assert f"license: {PROJECT['license']}\n" in RECIPE
    assert listed("entry_points") == [f"{name} = {place}" for name, place in PROJECT["scripts"].items()]


def test_the_citation_is_of_this_version_and_licence() -> None:
    """Zenodo reads CITATION.cff."""
    assert f"version: {PROJECT['version']}\n" in CITATION
    assert f"license: {PROJECT['license']}\n" in CITATION
    own = tomllib.loads((ROOT / "spectra_data/references.toml").read_text("utf-8"))["lunarsci"]
    assert CITATION.count(f'title: "{own["title"]}"\n') == 2 and CITATION.count(f'name: "{own["author"][1:-1]}"\n') == 2
    assert f"  year: {own['year']}\n" in CITATION and CITATION.count(f"version: {PROJECT['version']}\n") == 2
    doi = "10.1038/s41467-024-46233-8"
    assert f"doi: {doi}\n" in CITATION and doi in (ROOT / "README.md").read_text("utf-8")


def test_every_package_that_users_get_has_its_licence_listed() -> None:
    needed = {"lunarsci": PROJECT["dependencies"]} | {
        f"`lunarsci[{extra}]`": packages
        for extra, packages in PROJECT["optional-dependencies"].items()
        if extra not in FOR_DEVELOPERS
    }
    expected = {(re.split(r"[<>=]", package)[0], where) for where, packages in needed.items() for package in packages}
    assert {(name, where) for name, _, where in LICENCES} == expected
    assert len(LICENCES) == len(expected)


@pytest.mark.parametrize(("name", "licence"), [row[:2] for row in LICENCES])
def test_a_licence_is_the_one_that_the_package_states(name: str, licence: str) -> None:
    """By its family: the older fields of a package's metadata say no more than "BSD"."""
    try:
        found = metadata(name)
    except PackageNotFoundError:
        pytest.skip(f"{name} is not installed")
    expression = found.get("License-Expression")
    older = [found.get("License") or "", *(line for line in found.get_all("Classifier", []) if line[:7] == "License")]
    stated = expression or " ".join(line.partition("\n")[0] for line in older)
    family = {"PSF-2.0": "Python Software Foundation|PSF"}.get(licence, licence.partition("-")[0])
    assert re.search(rf"\b({family})\b", stated), stated
    if expression and family in licence:
        assert licence in expression
