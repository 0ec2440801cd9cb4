"""The sentence that stands for a result: it may not say more than the result does."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from former import former_answers

from lunarsci.errors import DataError, ParameterError
from lunarsci.figure import FIRST_PAGE
from lunarsci.pages.answers import answer, answered, namesakes
from lunarsci.pages.documents import Document, _first_pages, document_of, read_results
from lunarsci.pages.page import Page
from lunarsci.pages.parts import apart, assumed, budget, quantities, tables, unknown
from lunarsci.pages.words import DOUBT, GO, STOP, counted, measured, number, percent, words
from lunarsci.regolith.belief import first_belief
from lunarsci.spectra.band_status import DEPENDS
from lunarsci.spectra.jobs.verdicts import bands_meaning, centre_texts, fit_verdict, shares_verdict
from lunarsci.twin.ground.soil_map import SoilMap, Zone, soil_map_bytes

KNOWN: dict[str, dict[str, Any]] = {}
"""What every command printed, by its name in the table of former answers."""


@pytest.fixture(scope="module", autouse=True)
def known(printed: dict[str, dict[str, Any]]) -> None:
    KNOWN.update(printed)


def of(name: str, **changes: Any) -> Document:
    found = KNOWN[name]
    return document_of(found["schema"].removeprefix("lunarsci/"), found["result"] | changes, found["provenance"])


def test_every_kind_of_the_former_answers_is_answered() -> None:
    kinds = {one["schema"].split("/")[1] for one in KNOWN.values()}
    assert [kind for kind in kinds if answered(kind) is None] == []
    for name in KNOWN:
        assert answer(of(name)).text.endswith(".")


def test_a_drive_is_a_go_only_where_the_verdict_says_so() -> None:
    assert answer(of("predict")).tone == GO
    refused = answer(of("predict", verdict="no-go", reasons=["the slope is too steep"]))
    assert refused.tone == STOP
    assert not refused.text.startswith("Go ")
    assert refused.text.startswith("No-go ")
    assert "the slope is too steep" in refused.text


def test_a_limit_that_some_drives_break_is_not_called_kept() -> None:
    """The verdict allows one drive in twenty beyond a limit; the sentence may not hide it."""
    limits = [KNOWN["predict"]["result"]["limits"][0] | {"exceeding": 3}]
    said = answer(of("predict", limits=limits, members=100)).text
    assert "broken by 3 of 100 predicted drives" in said
    assert "all limits are kept" not in said


def test_trust_is_the_exit_code_of_the_command() -> None:
    for name, former in former_answers().items():
        assert (answer(of(name)).tone in (DOUBT, STOP)) == (former["exit"] == 3), name


def test_a_go_of_a_soil_that_is_not_trusted_does_not_begin_with_go() -> None:
    drive = of("predict")
    said = answer(replace(drive, provenance={"untrusted": "the soil of belief.json is not to be trusted"}))
    assert said.tone == DOUBT
    assert said.text.startswith("The soil of belief.json is not to be trusted. ")
    failed = answer(replace(drive, provenance={"untrusted": "", "failures": ["a.csv: no spectrum", "b.csv: none"]}))
    assert (failed.tone, failed.trust) == (GO, "2 inputs gave no result: a.csv: no spectrum (and 1 more).")
    older = answer(replace(drive, provenance={}))
    assert (older.tone, "older version" in older.trust) == (GO, True)


def test_verdicts_are_told_in_the_words_of_the_command() -> None:
    """Of each kind of open question: which minerals, which crater, shares out of the domain, a soil that is assumed."""
    for name, keys in {
        "match modes": ("rocks", 0, "status"),
        "match bands": ("rocks", 0, "status"),
        "compare drives": ("reasons", 0),
    }.items():
        status: Any = KNOWN[name]["result"]
        for key in keys:
            status = status[key]
        assert str(status) in answer(of(name)).text
        assert "most likely came from" not in answer(of(name)).text
    own = KNOWN["bands"]["result"]["spectra"][0]
    assert bands_meaning(own)[1:] in answer(of("bands")).text
    assert all(f"at {centre}" in answer(of("bands")).text for centre in centre_texts(own).values())
    open_one = own | {"band2000_status": DEPENDS}
    said = answer(replace(of("bands"), result={"spectra": [open_one]})).trust
    assert said == f"Centre depends on the method more than on the noise: {own['id']} at 2 µm."
    assert shares_verdict(KNOWN["unmix"]["result"]["spectra"][0]) in answer(of("unmix")).text
    for name in ("fit", "fit auto"):
        assert fit_verdict(KNOWN[name]["result"]["spectra"][0]) in answer(of(name)).text
    assert "Not determined: external friction angle" in answer(of("identify solved")).text
    assert "synthetic; the verdict says nothing about a real site" in answer(of("predict")).text


def test_what_is_open_of_several_spectra_is_told_with_their_names() -> None:
    """Up to six by name, of more how many have which answer; as the CSV says it, never by the bare assemblage."""
    one = KNOWN["fit auto"]["result"]["spectra"][0]

    def many(count: int) -> list[dict[str, Any]]:
        choices = [one["choice"] | {"strong": False, "sure": ["pyroxene"], "open": ["olivine"]}] * count
        choices[0] = choices[0] | {"open": []}
        return [one | {"id": f"R{k}", "choice": choice} for k, choice in enumerate(choices)]

    few, more = (of("fit auto", spectra=many(count)) for count in (3, 12))
    said = [line for line in unknown(few) if "weak evidence" in line]
    assert said == [
        "R0: by weak evidence, sure: pyroxene",
        "R1; R2: by weak evidence, sure: pyroxene; open: olivine",
    ]
    assert [line for line in unknown(more) if "weak evidence" in line] == [
        "11 spectra: by weak evidence, sure: pyroxene; open: olivine",
        "1 spectrum: by weak evidence, sure: pyroxene",
    ]
    assert "11 of them: sure: pyroxene; open: olivine" in answer(more).text
    assert one["assemblage"] not in answer(more).text


def test_what_a_command_refuses_is_neither_in_the_budget_nor_in_the_tables() -> None:
    """Fo of the 1 um centre, beside a 2 um band; Wo beyond its trend; a ratio with an error of 300."""
    refused = KNOWN["bands"]["result"]["spectra"][0]["chemistry"]["fo_bc1000"]
    assert not refused["in_range"]
    made = of("bands")
    cells = [cell for table in (budget(made), *tables(made)) if table for row in table.rows for cell in row]
    assert not any(f"{refused['value']:.4g}"[:4] in cell for cell in cells)
    assert any(cell == f"not to be used: {refused['reason']}" for cell in cells)
    assert any("Fs by Gaffey 2002 [mol %]" in cell for cell in cells)
    fitted = KNOWN["fit"]["result"]
    beyond = fitted["spectra"][0]["compositions"]["fs"] | {"mean": 104.8, "in_range": False}
    spoiled = of("fit", spectra=[fitted["spectra"][0] | {"compositions": {"fs": beyond}}])
    [line] = [text for text in unknown(spoiled) if "Fs of orthopyroxene" in text or "fs of orthopyroxene" in text]
    assert line.endswith("not to be used: beyond 0-100, where the trend was measured")
    assert not any("104.8" in cell for row in budget(spoiled).rows for cell in row)
    assert budget(of("fit damping")) is None
    assert any("share of orthopyroxene in the strength" in row[0] for row in budget(of("fit")).rows)


def test_caveats_below_the_tables_of_a_command_are_told() -> None:
    for name, said in {
        "bands": "2 µm band: conic not used",
        "states": "of the others the track says nothing",
        "loads of states": "each wheel supplies still depends on the assumed soil",
        "identify joint": "priors that come with lunarsci where none are given",
        "cameras": "of Yutu-2 Navcam: ",
    }.items():
        told = [*unknown(of(name)), *assumed(of(name))]
        assert any(said in line for line in told), (name, told)
    assert any(line.endswith("only if an ordinary chondrite") for line in unknown(of("bands")))


def test_single_values_are_one_table_and_names_have_units() -> None:
    for name in KNOWN:
        titles = [table.title for table in tables(of(name))]
        assert titles.count("Single values") <= 1
        assert all(len(table.rows) > 1 for table in tables(of(name)) if table.title != "Single values")
    names = [row[0] for row in budget(of("identify")).rows]
    assert any(text.endswith("internal friction angle φ [°]") for text in names), names


def test_what_drives_keep_is_the_end_of_the_command_and_ends_have_their_time() -> None:
    """Of a lower limit, such as ground clearance, the lower end; of a drive that was not measured to its end when."""
    drive = of("predict")
    table = next(one for one in tables(drive) if one.title == "limits")
    kept = {one["quantity"]: one["kept"] for one in drive.result["limits"]}
    shown = {row[0]: row[table.headers.index("95 % of drives")] for row in table.rows}
    assert shown["ground clearance [m]"] == number(kept["clearance_m"]) and len(shown) == len(kept)
    low = next(one for one in drive.result["limits"] if one["quantity"] == "clearance_m")
    assert number(low["p05"]) == shown["ground clearance [m]"] != number(low["p95"])
    assert "95 %" not in table.headers and "5 %" not in table.headers
    held = of("compare drives")
    early = replace(held, result={**held.result, "end": {"error_m": 0.041, "time_s": 110.0, "at_end": False}})
    assert "At 110 s, its last position, before the end of the plan, the rover was 0.041 m" in answer(early).text
    at_end = replace(held, result={**held.result, "end": {"error_m": 0.041, "time_s": 120.0, "at_end": True}})
    assert "The drive ended 0.041 m from where it was predicted to." in answer(at_end).text


def test_pages_of_a_picture_are_no_warning_about_a_result() -> None:
    drive = of("predict")
    pages = [
        "a.png: holds the first page only; a .pdf holds all",
        f"b.png: {FIRST_PAGE}; left out: page 2; --plot b.pdf draws all",
    ]
    record = {"untrusted": "", "warnings": pages}
    made = replace(drive, provenance=record)
    assert answer(made).trust == "No check speaks against this result."
    assert not any(".png" in line for line in unknown(made))
    pages.append("plan.toml has no [limits]")
    assert "read its 1 warning" in answer(made).trust and "plan.toml has no [limits]" in unknown(made)


def test_a_share_of_no_determined_value_is_not_told() -> None:
    """Pyroxene's bands of the damped fit have an error of 300: no number is read aloud."""
    assert "orthopyroxene makes" not in answer(of("fit damping")).text
    assert "orthopyroxene makes 0.74 ± 0.11" in answer(of("fit")).text


def test_numbers_are_rounded_to_their_errors() -> None:
    assert measured(943.8386, 2.7208, "nm") == "943.8 ± 2.7 nm"
    assert measured(1443.0, 96.9, "N") == "1443 ± 97 N"
    assert measured(12345.0, 678.0) == "12340 ± 680"
    assert measured(None, 1.0) == "not determined"
    assert percent(0.0039) == "0.4 %"
    assert counted(1, "spectrum") == "1 spectrum"
    assert counted(2, "spectrum") == "2 spectra"
    assert words("center_nm") == "centre [nm]"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ('{"a": 1}', "no result of a lunarsci command"),
        ('{"schema": "lunarsci/soil-belief/3", "mean": []}', "its schema must be"),
        ('{"schema": "lunarsci/soil-map/1", "zones": []}', "no 'laws' in it"),
        ('{"schema": "lunarsci/twin-prediction/1"}', "but lunarsci/twin-prediction/1"),
        ("TRUSTED: drive, 64 drives", "text, no JSON result"),
        ('{"schema": "other/1", "result": {}, "provenance": {}}', "does not name a lunarsci result"),
        ('{"schema": "lunarsci/twin-predict/1", "result": {}, "provenance": {}}', "lacks 'verdict'"),
        ("[1, 2]", "no result of a lunarsci command"),
        ("{", "not valid JSON"),
    ],
)
def test_what_is_no_result_is_one_clear_error(tmp_path: Path, content: str, said: str) -> None:
    file = tmp_path / "thing.json"
    file.write_text(content)
    with pytest.raises(DataError, match=r"thing\.json") as error:
        [answer(one) for one in read_results([file])[0]]
    assert said in str(error.value)
    assert len(str(error.value)) <= 300


def test_a_soil_map_is_told_by_its_zones(tmp_path: Path) -> None:
    first = first_belief()
    known = replace(first, covariance=0.04 * first.covariance, history=({"sha256": "a", "states": "s.csv"},))
    doubted = replace(known, history=({"sha256": "b", "doubt": "the wheels leaned"},))
    way = np.column_stack([np.linspace(0.0, 4.0, 9), np.zeros(9)])
    zones = (
        Zone(name="out, 0.0 to 4.0 m", place_m=way, belief=known),
        Zone(name="back", place_m=way + 4.0, belief=doubted),
    )
    file = tmp_path / "map.json"
    for kept, drives, said in (
        (zones, "2 zones, from 2 drives.", "Zone 2: a drive: the wheels leaned"),
        ((), "", ""),
    ):
        file.write_bytes(soil_map_bytes(SoilMap(zones=kept)))
        (document,), _ = read_results([file])
        told = answer(document)
        assert drives in told.text and (told.tone == DOUBT) == bool(said) and said in told.trust
        assert len(document.pictures) == (2 if kept else 0)
        assert any("alike over 5 m, which is assumed" in line for line in unknown(document))
        if kept:
            table = tables(document)[-1]
    assert "no zone yet" in told.text
    assert table.title == "zones" and [row[0] for row in table.rows] == ["zone 1", "zone 2"]
    assert any(header.startswith("cohesion") for header in table.headers)


def test_folders_pictures_and_nothing(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"without result\.json"):
        read_results([tmp_path])
    (tmp_path / "result.json").write_text(json.dumps(KNOWN["states"]))
    (tmp_path / "drawn.png").write_bytes(b"\x89PNG\r\n")
    [found], pictures = read_results([tmp_path, tmp_path / "drawn.png"])
    assert found.kind == "twin-states"
    assert list(found.pictures) == ["drawn.png"]
    assert [one.name for one in pictures] == ["drawn.png"]
    with pytest.raises(ParameterError, match="no result is given"):
        read_results([tmp_path / "drawn.png"])
    (tmp_path / "false.png").write_bytes(b"GIF89a")
    with pytest.raises(DataError, match="no PNG picture"):
        read_results([tmp_path, tmp_path / "false.png"])


def test_a_match_that_decides_nothing_is_not_approved() -> None:
    rock = KNOWN["match modes"]["result"]["rocks"][0]
    undecided = rock | {"best": None, "status": "not decided: Finsen (0.59), Zhinyu (0.11) remain; composition says"}
    clear = rock | {"best": "Finsen", "status": "likeliest Finsen (0.97); the composition favours it strongly"}
    nothing = {"untrusted": "", "warnings": []}

    def trust(*rocks: object) -> str:
        return answer(replace(of("match modes", rocks=list(rocks)), provenance=nothing)).trust

    assert trust(undecided) == "The source is not decided."
    assert trust(undecided, clear) == "The source is not decided for 1 of 2 rocks."
    assert trust(clear).startswith("No check speaks against")


def test_what_is_said_against_shares_hangs_on_them_and_errors_are_named() -> None:
    share = {"fraction": 0.4, "low": 0.3, "high": 0.5, "low95": 0.1, "high95": 0.7}
    own = {"in_domain": False, "status": "out of domain: too dark", "rms_ln": 0.05, "olivine": share}
    found = {one.name: one.remark for one in quantities({"abundance": own})}
    assert found == {"residual, root mean square [ln R]": "", "share of olivine": "out of domain: too dark"}
    [band] = quantities({"bc1000_nm": 950.0, "bc1000_sigma_nm": 4.0, "bc1000_systematic_nm": 3.0})
    assert band.parts == {"standard error": "4", "choice of continuum": "3"}
    assert "another than that of the fit" in " ".join(unknown(of("fit auto")))


def test_the_page_of_a_joint_soil_keeps_single_states_under_their_heading() -> None:
    """What they assume, N = 1 and c = 520 Pa, is assumed by nothing else, and their site is in no budget."""
    main, alone = apart(of("identify joint"))
    assert alone is not None and alone.title.startswith("Each state by itself (assumes N = 1, c = 520 Pa")
    names = [row[0] for row in budget(main).rows]
    assert names and not any(name.startswith(("bearing", "shear:", "shear,", "1:")) for name in names)
    assert not any("520" in line or "exponent" in line for line in assumed(main))
    titles = [table.title for table in tables(main)]
    assert not {"agreement", "observations", "bearing, curve"} & set(titles)
    told = {table.title for table in alone.tables}
    assert {"observations", "bearing, curve"} <= told and "agreement" not in told
    same, nothing = apart(of("identify"))
    assert nothing is None and same.result == KNOWN["identify"]["result"]


def test_spectra_of_one_name_and_other_data_are_said() -> None:
    """Beside the answer of both results; not where the data are the same, nor where a file is not known."""

    def held(name: str, digest: str, **more: Any) -> Document:
        one = KNOWN["bands"]["result"]["spectra"][0] | {"source": "rock.ecsv"}
        known = of("bands", spectra=[one | {"id": "rock"}])
        inputs = [{"path": "rock.ecsv", "sha256": digest}]
        return replace(known, name=name, provenance={"untrusted": "", "inputs": inputs}, **more)

    first, same, other = held("a.json", "1" * 64), held("b.json", "1" * 64), held("c.json", "2" * 64)
    assert namesakes([first, same]) == {}
    assert namesakes([first, replace(other, provenance={})]) == {}
    told = namesakes([first, same, other])
    assert told["a.json"] == "This result has the name of a spectrum of other data here: rock (of c.json)."
    assert told["c.json"].endswith("rock (of a.json, b.json).") and len(told) == 3
    page = Page("page", [first, other])
    assert all("has the name of a spectrum of other data here" in one.trust for one in page.answers)
    assert page.html().decode().count("rock (of a.json)") == 1


def test_notes_of_bands_of_many_spectra_name_them() -> None:
    one = KNOWN["bands"]["result"]["spectra"][0] | {"band2000_note": "conic not used"}
    two = [one | {"id": name} for name in ("rock", "stone")]
    assert "2 µm band of rock; 2 µm band of stone: conic not used" in unknown(of("bands", spectra=two))
    assert "2 µm band: conic not used" in unknown(of("bands", spectra=two[:1]))


@pytest.mark.parametrize(("drawn", "shown"), [(1, 1), (6, 6), (8, 6)])
def test_the_pages_of_a_plot_are_shown_and_more_are_said(drawn: int, shown: int) -> None:
    from matplotlib.figure import Figure

    pictures, cut = _first_pages((Figure((1, 1)) for _ in range(drawn)), "bands.png")
    names = ["bands.png", *(f"bands-{number}.png" for number in range(2, shown + 1))]
    assert list(pictures) == names and cut == (drawn > shown)
    page = Page("page", [replace(of("bands"), pictures=pictures, cut=cut)]).html().decode()
    assert ("the first 6 pages are shown; its command with --plot FILE.pdf has all" in page) == cut
