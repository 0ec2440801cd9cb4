"""What conda and Zenodo are told is what pyproject.toml says."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
RECIPE = (ROOT / "conda/meta.yaml").read_text("utf-8")
CITATION = (ROOT / "CITATION.cff").read_text("utf-8")


def listed(section: str) -> list[str]:
    """Entries of a list of the recipe."""
    found = re.search(rf"^  {section}:\n((?:    - .+\n)+)", RECIPE, re.MULTILINE)
    assert found is not None
    return re.findall(r"    - (.+)", found[1])


def test_the_recipe_needs_what_the_project_needs() -> None:
    assert listed("run") == [f"python {PROJECT['requires-python']}", *PROJECT["dependencies"]]
    assert f'version: "{PROJECT["version"]}"\n' in RECIPE
    assert f"license: {PROJECT['license']}\n" in RECIPE
    assert listed("entry_points") == [f"{name} = {place}" for name, place in PROJECT["scripts"].items()]


def test_the_citation_is_of_this_version_and_licence() -> None:
    """Zenodo reads CITATION.cff."""
    assert f"version: {PROJECT['version']}\n" in CITATION
    assert f"license: {PROJECT['license']}\n" in CITATION
    assert CITATION.count("family-names:") == 28
