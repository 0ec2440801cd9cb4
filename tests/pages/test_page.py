"""The page in a real browser: complete, quiet, legible, reachable without a mouse, and deaf to hostile names."""

import base64
import copy
import inspect
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lunarsci
from lunarsci.errors import OutputError
from lunarsci.figure import picture_bytes
from lunarsci.pages.job import report
from lunarsci.pages.relief import MOST_NODES

HOSTILE = "$\\frac{<script>window.hurt=1</script><img src=x onerror='window.hurt=1'>\u202eevil\"'&amp;"
ROWS = "member,distance_m,x_m,y_m\n" + "".join(
    f"{member},{0.1 * k:.1f},{0.1 * k:.2f},{0.02 * member * k:.2f}\n" for member in range(3) for k in range(20)
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, printed: dict[str, dict[str, Any]]) -> Path:
    """Results of every kind; a predicted drive with its paths and the ground below them; a hostile spectrum."""
    made = tmp_path_factory.mktemp("results")
    known = copy.deepcopy(printed)
    for name, document in known.items():
        (made / f"{name}.json").write_text(json.dumps(document))
    (made / "drive").mkdir()
    (made / "drive/result.json").write_text(json.dumps(known["predict"]))
    (made / "drive/paths.csv").write_text(ROWS)
    x = np.arange(-3.0, 6.0, 0.05)
    height = 0.3 * np.sin(x[:, None]) * np.cos(x[None, :])
    height[10:20, 10:20] = np.nan
    np.savez(made / "drive/terrain.npz", x_m=x, y_m=x, height_m=height, name=HOSTILE, synthetic=True)
    spoiled = known["fit"]
    spoiled["result"]["spectra"][0]["id"] = spoiled["result"]["spectra"][0]["bands"][0]["mineral"] = HOSTILE
    spoiled["provenance"] = spoiled["provenance"] | {"sources": [HOSTILE], "warnings": [HOSTILE], "command": HOSTILE}
    (made / "hostile.json").write_text(json.dumps(spoiled))
    return made


def each_kind(folder: Path) -> list[Path]:
    """The first file of every schema."""
    kinds = {json.loads(file.read_text())["schema"]: file for file in sorted(folder.glob("*.json"), reverse=True)}
    assert len(kinds) > 20
    return list(kinds.values())


@pytest.fixture(scope="module")
def pages(folder: Path) -> dict[Path, bytes]:
    """A page of each kind, and of a drive on its ground."""
    return {file: report(file).html(time=False) for file in [*each_kind(folder), folder / "drive"]}


@pytest.fixture(scope="module")
def everything(folder: Path) -> Path:
    """One page of several of them."""
    few = [folder / f"{name}.json" for name in ("states", "identify", "match modes", "update", "choice", "calibrate")]
    page = folder / "page.html"
    page.write_bytes(report([folder / "drive", folder / "hostile.json", *few], title=HOSTILE).html())
    return page


@pytest.fixture(scope="module")
def opened(browser: Any, everything: Path) -> Any:
    """The page on a narrow screen, with what it said and asked for."""
    page = browser.new_page(viewport={"width": 360, "height": 900})
    page.said, page.asked = [], []
    page.on("console", lambda message: page.said.append(message.text))
    page.on("pageerror", lambda error: page.said.append(str(error)))
    page.on("request", lambda asked: page.asked.append(asked.url))
    page.goto(everything.as_uri())
    return page


def test_a_page_of_every_kind_has_a_section_and_pictures(pages: dict[Path, bytes]) -> None:
    for file, made in pages.items():
        html = made.decode()
        assert html.count('<section id="s') == 1, file
        assert "Command, options, files and versions" in html
        assert not re.search(r"\d\d:\d\d UTC", html), "a page without its time"
    assert html == report(file).html(time=False).decode()


def test_the_page_is_quiet_and_asks_for_nothing(opened: Any) -> None:
    assert opened.said == []
    assert [address for address in opened.asked if not address.startswith(("data:", "file:"))] == []
    assert sum(address.startswith("file:") for address in opened.asked) == 1


def test_nothing_scrolls_sideways_and_text_is_large_enough(opened: Any) -> None:
    width, seen = opened.evaluate("[document.documentElement.scrollWidth, innerWidth]")
    assert width <= seen
    sizes = opened.evaluate(
        "[...document.querySelectorAll('p, li, td, th, figcaption, summary')]"
        ".map(one => parseFloat(getComputedStyle(one).fontSize))"
    )
    assert min(sizes) >= 14


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing(browser: Any, everything: Path, scheme: str) -> None:
    """Contrast, alternative texts, headings, names of buttons and regions, by the rules of WCAG 2 AA."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    page = browser.new_page(viewport={"width": 360, "height": 900}, color_scheme=scheme)
    page.goto(everything.as_uri())
    page.evaluate("document.querySelectorAll('details').forEach((one, k) => { one.open = k < 4 })")
    found = axe.Axe().run(page, options={"resultTypes": ["violations"]}).response["violations"]
    page.close()
    assert [(one["id"], [node["html"][:80] for node in one["nodes"][:3]]) for one in found] == []


CONTRAST = """() => {
  const light = (text) => {
    const own = text.match(/[0-9.]+/g).slice(0, 3).map(v => v / 255);
    const [red, green, blue] = own.map(v => v <= .04045 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4);
    return .2126 * red + .7152 * green + .0722 * blue;
  };
  const below = (one) => {
    for (let up = one; up; up = up.parentElement) {
      const paper = getComputedStyle(up).backgroundColor;
      if (!/^rgba.*, 0\\)$/.test(paper)) return paper;
    }
    return "rgb(255, 255, 255)";
  };
  let worst = [99, ""];
  for (const one of document.querySelectorAll("body *")) {
    if (![...one.childNodes].some(n => n.nodeType === 3 && n.textContent.trim()) || !one.checkVisibility()) continue;
    const [a, b] = [light(getComputedStyle(one).color), light(below(one))].sort((x, y) => y - x);
    const ratio = (a + .05) / (b + .05);
    if (ratio < worst[0]) worst = [ratio, one.outerHTML.slice(0, 80)];
  }
  return worst;
}"""
"""The lowest contrast of a text with what is behind it, by WCAG 2, and where it is."""


def test_a_page_of_every_kind_is_quiet_narrow_told_and_legible(
    browser: Any, folder: Path, pages: dict[Path, bytes]
) -> None:
    """One window for all: no message of the browser, no sideways scroll at 360 px, words for pictures, contrast."""
    page = browser.new_page(viewport={"width": 360, "height": 780})
    said: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    for file, content in pages.items():
        made = folder / "kind.html"
        made.write_bytes(content)
        page.goto(made.as_uri())
        page.evaluate("document.querySelectorAll('details').forEach(one => { one.open = true })")
        assert said == [], file
        width, seen = page.evaluate("[document.documentElement.scrollWidth, innerWidth]")
        assert width <= seen, file
        alone = (
            "[...document.querySelectorAll('img')].filter(one => one.checkVisibility() && one.alt.length < 20).length"
        )
        assert page.evaluate(alone) == 0, file
        ratio, where = page.evaluate(CONTRAST)
        assert ratio >= 4.5, (file, where)
    page.close()


@pytest.mark.parametrize(("width", "height"), [(360, 780), (1440, 900)])
def test_answer_trust_and_a_picture_are_on_the_first_screen(
    browser: Any, folder: Path, width: int, height: int
) -> None:
    page = browser.new_page(viewport={"width": width, "height": height})
    made = folder / "first.html"
    made.write_bytes(report(folder / "drive").html())
    page.goto(made.as_uri())
    for part in (".answer", ".trust", ".first"):
        assert page.locator(part).first.bounding_box()["y"] < 0.75 * height, part
    assert page.locator(".answer").first.text_content().startswith("Go for the drive")
    assert page.locator(".trust").first.text_content() == "Trust: No check speaks against this result."
    page.close()


def test_paper_has_what_is_folded_away(opened: Any) -> None:
    folded = "document.querySelectorAll('details:not([open])').length"
    before = opened.evaluate(folded)
    opened.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert (before > 0, opened.evaluate(folded)) == (True, 0)
    opened.evaluate("dispatchEvent(new Event('afterprint'))")
    assert opened.evaluate(folded) == before


def test_hostile_names_are_shown_and_never_run(opened: Any) -> None:
    assert opened.evaluate("window.hurt") is None
    assert "<script>window.hurt=1</script>" in opened.evaluate("document.querySelector('h1').textContent")
    assert "\u202e" not in opened.evaluate("document.documentElement.outerHTML")


def pixels(page: Any) -> str:
    return str(page.evaluate("document.querySelector('canvas').toDataURL()"))


def test_the_ground_turns_by_mouse_keys_and_buttons(opened: Any) -> None:
    canvas = opened.locator("canvas").first
    canvas.scroll_into_view_if_needed()
    before = pixels(opened)
    box = canvas.bounding_box()
    opened.mouse.move(box["x"] + 100, box["y"] + 60)
    opened.mouse.down()
    opened.mouse.move(box["x"] + 190, box["y"] + 80, steps=3)
    opened.mouse.up()
    dragged = pixels(opened)
    canvas.focus()
    opened.keyboard.press("ArrowLeft")
    keyed = pixels(opened)
    opened.get_by_role("button", name="Heights × 2").click()
    taller = pixels(opened)
    assert len({before, dragged, keyed, taller}) == 4
    opened.get_by_role("button", name="Begin again").click()
    assert pixels(opened) == before


def test_a_picture_grows_when_it_is_chosen(opened: Any) -> None:
    first = opened.locator("button.zoom").first
    first.scroll_into_view_if_needed()
    first.click()
    large = opened.locator("dialog img")
    before = large.bounding_box()["width"]
    opened.get_by_role("button", name="Larger").click()
    assert large.bounding_box()["width"] == pytest.approx(1.5 * before, rel=0.01)
    assert large.get_attribute("alt")
    opened.keyboard.press("Escape")
    assert not large.is_visible()


def test_paper_has_the_still_picture_and_no_buttons(opened: Any) -> None:
    opened.emulate_media(media="print")
    assert not opened.get_by_role("button", name="Turn left").is_visible()
    assert opened.locator("#ground img").is_visible()
    opened.emulate_media(media="screen")


def test_the_ground_is_thinned_and_says_so(folder: Path) -> None:
    html = report(folder / "drive").html().decode()
    assert "a node every 0.1 m; the terrain&#39;s own are 0.05 m apart" in html
    data = re.search(r'data-relief="([^"]+)"', html)
    assert len(data[1]) < 4 * (2 * MOST_NODES**2 + 40 * 60 * 25)


def test_without_a_terrain_there_is_no_ground(folder: Path) -> None:
    assert "data-relief=" not in report(folder / "fit.json").html().decode()


def test_results_in_memory_have_the_page_of_their_files(tmp_path: Path) -> None:
    """The function of notebooks gives what the command gives of the file, and the picture of its --plot."""
    found = lunarsci.wheel_forces(sinkage=0.01)
    file, page, plain = tmp_path / "forces.json", tmp_path / "page.html", tmp_path / "plain.html"
    file.write_text(found.to_json())
    made = lunarsci.report([found, file], page, title="Forces")
    assert page.read_bytes().startswith(b"<!DOCTYPE html>") and made.page.title == "Forces"
    in_memory, read = ({key: text for key, text in row.items() if key not in ("file", "title")} for row in made.rows())
    assert in_memory == read and read["answer"]
    assert made.rows()[0]["file"] == "regolith-forces (1)"
    plotted = picture_bytes([found.plot()], Path("forces.png"))
    lunarsci.report([file], plain)
    shown = base64.b64encode(plotted).decode()
    assert page.read_text().count(shown) == 1 and shown not in plain.read_text()


def test_a_page_is_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As -o: a file that exists is left as it is unless it may be replaced, and stays where writing fails."""
    found, page = lunarsci.wheel_forces(sinkage=0.01), tmp_path / "page.html"
    page.write_text("mine")
    with pytest.raises(OutputError, match=r"page\.html: exists already"):
        lunarsci.report(found, page)
    with pytest.raises(OutputError, match="there is no folder"):
        lunarsci.report(found, tmp_path / "none" / "page.html")
    with monkeypatch.context() as broken, pytest.raises(OutputError, match="nothing was written"):
        broken.setattr("os.fsync", lambda handle: (_ for _ in ()).throw(OSError(28, "No space left on device")))
        lunarsci.report(found, page, force=True)
    assert [path.read_text() for path in tmp_path.iterdir()] == ["mine"]
    lunarsci.report(found, page, force=True)
    assert page.read_bytes().startswith(b"<!DOCTYPE html>")


def test_a_result_without_pictures_has_a_section_without(tmp_path: Path) -> None:
    """A result whose picture cannot be drawn still is on the page."""
    cited = lunarsci.cite(lunarsci.wheel_forces(sinkage=0.01))
    html = lunarsci.report(cited).html().decode()
    assert html.count('<section id="s') == 1 and "data:image" not in html


def test_the_function_is_one_of_the_others() -> None:
    """No package of its name stands in its way, and its help names its options."""
    assert inspect.isfunction(lunarsci.report) and lunarsci.report is report
    told = inspect.getdoc(lunarsci.report) or ""
    assert "terrain : Ground to turn in the page" in told and "force : whether" in told
    assert str(inspect.signature(lunarsci.report)).startswith("(results")
