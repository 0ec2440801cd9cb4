"""What files are, files to begin with, what to cite, and whether lunarsci works here."""

import ast
import inspect
import io
import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from lunarsci.cli.info import info as command_info

import lunarsci
from lunarsci.errors import DataError, ParameterError, RequestError
from lunarsci.guide import doctor
from lunarsci.guide.cite import REFERENCE, SEVERAL, CitedSources, cite, reference_of, reference_to, works
from lunarsci.guide.cite import _cited as cite_of
from lunarsci.guide.info import CONTENTS, CSV_COLUMNS, MAGIC_BYTES, SUFFIXES, TOML_KEYS, info, named_here
from lunarsci.guide.template import KINDS as TEMPLATES
from lunarsci.guide.template import described, template
from lunarsci.io.inputs import InputFile
from lunarsci.provenance import Provenance, document, to_json
from lunarsci.registry import KINDS
from lunarsci.regolith.compare import reference_soils
from lunarsci.regolith.prior import default_prior, read_prior
from lunarsci.regolith.soil import read_soil
from lunarsci.rovers import read_rover
from lunarsci.twin.rover import build_rover


def written(folder: Path, name: str, text: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize("kind", TEMPLATES)
def test_a_template_is_known_on_standard_input(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = written(tmp_path, template(kind).name, template(kind).text)
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(file.read_bytes())))
    piped, named = info("-"), info(file)
    assert (piped.file, piped.kind, piped.trouble) == ("<stdin>", named.kind, "") and piped.contents == named.contents


def test_what_is_wrong_on_standard_input_is_named_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"[wheel]\nradius_m = -1\nwidth_m = 0.1\n")))
    assert info("-").trouble.startswith("<stdin>: [wheel]: wheel radius_m is -1")


@pytest.mark.parametrize("kind", TEMPLATES)
def test_a_template_is_what_its_reader_takes(kind: str, tmp_path: Path) -> None:
    made = template(kind)
    found = info(written(tmp_path, made.name, made.text))
    assert (found.kind, found.trouble, found.remarks) == ("rover" if kind == "small-four" else kind, "", [])
    assert found.contents
    assert max(map(len, (line for line in made.text.splitlines() if line.startswith("#")))) < 200


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_long_telemetry_is_read_in_pieces_and_is_the_same(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = template("telemetry")
    path = written(tmp_path, "sent.csv", made.text)
    if suffix == "parquet":
        pd.read_csv(path, comment="#").to_parquet(path := tmp_path / "sent.parquet")
    whole = info(path)
    monkeypatch.setattr("lunarsci.guide.info.LONG_TELEMETRY_BYTES", 0)
    monkeypatch.setattr("lunarsci.guide.info.read_input", None)
    assert info(path).to_dict() == whole.to_dict() and whole.contents["rows"] > 0
    assert info(path).sha256 == whole.sha256


@pytest.mark.parametrize("kind", ["plan", "mission", "soil"])
def test_the_comments_of_a_template_are_keys_that_the_reader_knows(kind: str, tmp_path: Path) -> None:
    """Keys after # that belong to what stands above them, taken in; one that is misspelt is refused."""
    made = template(kind)
    optional = [line for line in made.text.splitlines() if re.match(r"# \w+ = ", line)]
    assert optional
    known = {"plan": "sweep", "mission": "time_budget_s", "soil": "sinkage_exponent_slip"}[kind]
    assert any(known in line for line in made.text.splitlines())
    if kind != "plan":
        text = made.text.replace(f"# {known} = ", f"{known} = ")
        assert info(written(tmp_path, made.name, text)).trouble == ""
        wrong = info(written(tmp_path, made.name, text.replace(f"\n{known} = ", f"\n{known[:-1]} = ")))
        assert f"did you mean '{known}'" in wrong.trouble
        assert wrong.untrusted


def test_a_template_of_another_kind_names_the_nearest() -> None:
    with pytest.raises(ParameterError, match="did you mean 'mission'"):
        template("misson")
    with pytest.raises(RequestError, match="a plan has no wheels"):
        template("plan", "small-four")


def test_telemetry_to_begin_with_has_the_wheels_of_a_rover(tmp_path: Path) -> None:
    """Made up without slip on level ground, of the rolling radius without grousers: s is what the grousers add."""
    rover = build_rover("small-four")
    path = written(tmp_path, "sent.csv", template("telemetry", "small-four").text)
    found = lunarsci.states(
        path, rover="small-four", terrain=(np.arange(-9.0, 9.0), np.arange(-9.0, 9.0), np.zeros((18, 18)))
    )
    assert {row["wheel"] for row in found.rows()} == {"FL", "FR", "RL", "RR"}
    slip = 1.0 - rover.wheel.radius_m / rover.wheel.shearing_radius_m
    assert np.median([row["slip_ratio"] for row in found.rows()]) == pytest.approx(slip, abs=0.005)
    assert "small-four's wheel" in template("states", "small-four").text


def test_a_rover_that_comes_along_is_a_file_to_begin_with(tmp_path: Path) -> None:
    """With its numbers, and which of a lighter rover's are left as Yutu-2's is said."""
    path, known = tmp_path / "rover.toml", read_rover("small-four")
    path.write_text(template("small-four").text)
    assert read_rover(str(path)).tables == known.tables
    assert info("small-four").contents["wheels"] == "FL, FR, RL, RR" and info("small-four").kind == "rover"
    own = template("rover").text
    assert not any("as of yutu2" in key for key in info_of(own, path))
    body = next(line for line in own.splitlines() if line.startswith("body_kg"))
    torque = next(line for line in own.splitlines() if line.startswith("continuous_torque_nm"))
    told = info_of(own.replace(body, "body_kg = 20.0").replace(torque, "continuous_torque_nm = 2.0"), path)
    assert told["[power] still as in yutu2"].startswith("all;")
    assert (
        "stall_torque_nm, no_load" in told["[motors] still as in yutu2"]
        and "body_kg" not in told["[mass] still as in yutu2"]
    )
    meant = [line for line in own.splitlines() if line.startswith(("wheel_kg", "body_center_m"))]
    for line in meant:  # the same numbers, but written by the user
        own = own.replace(line, re.sub(r"\{ value = (.*), source = .*\}", r"\1", line))
    told = info_of(own.replace(body, "body_kg = { value = 20.0, source = 'weighed' }"), path)
    assert told["[mass] still as in yutu2"] == "body_inertia_kg_m2; check that they are this rover's"
    changed = own.replace(body, body.replace("105.0", "20.0"))  # another number, the template's source left
    same = info_of(changed, path)["[mass] still as in yutu2"]
    assert changed != own and same == "body_inertia_kg_m2; check that they are this rover's"


def info_of(text: str, path: Path) -> Mapping[str, Any]:
    path.write_text(text)
    return info(path).contents


def test_minerals_of_an_assemblage_are_named() -> None:
    from lunarsci.spectra.mgm.assemblages import assemblage

    with pytest.raises(ParameterError, match="did you mean 'OPX'"):
        assemblage("OL-OPXX")


def test_every_attribute_of_the_classes_behind_a_rover_is_described() -> None:
    from lunarsci.twin.rover import Motors, PowerSupply, Rover

    for one in (Motors, PowerSupply, Rover):
        assert set(one.__annotations__) - set(described(one)) == set()


def test_every_kind_is_told_somehow_and_says_what_is_in_it() -> None:
    told = {*TOML_KEYS, *(kind.strip() for kind in CSV_COLUMNS), *MAGIC_BYTES.values(), *SUFFIXES.values()}
    told |= {
        "prior",
        "spectra",
        "library",
        "mgm",
        "config",
        "belief",
        "soil map",
        "telemetry",
        "result",
        "table",
        "camera",
        "map",
    }
    assert told == KINDS.keys() - {"folder"}
    assert KINDS.keys() - CONTENTS.keys() == {"mgm", "config", "zones", "folder"}


def test_commands_that_info_names_exist() -> None:
    import typer
    from lunarsci.cli import command_line

    program = typer.main.get_command(command_line())
    for kind in KINDS.values():
        for line in kind.commands:
            words, _, option = line.partition(" --")
            if words == "any command":
                continue
            command = program
            for word in words.split():
                command = command.commands[word]
            assert not option or f"--{option}" in {name for one in command.params for name in one.opts}


@pytest.mark.parametrize(
    ("name", "text", "kind"),
    [
        (
            "a.csv",
            "wavelength_nm,rock\n" + "".join(f"{n},{0.1 + n * 1e-5:.5f}\n" for n in range(450, 2400, 5)),
            "spectra",
        ),
        ("a.csv", "x_m,y_m,rut_m\n0,0,0.01\n", "track"),
        ("a.csv", "time_s,x_m,y_m,yaw_deg\n0,0,0,0\n1,0.1,0,0\n", "motion"),
        ("a.csv", "time_s,x_m,y_m,sigma_m\n0,0,0,0.1\n", "positions"),
        ("a.csv", "sinkage_m,slip_ratio,normal_force_n,drawbar_pull_n\n0.008,0.05,32.03,-1.3\n", "states"),
        ("a.csv", "time_s,wheel,sinkage_m,slip_ratio\n0,FL,0.008,0.05\n", "slips"),
        ("a.csv", "x,rock\n" + "".join(f"{n},0.1\n" for n in range(450, 2400, 50)), "spectra"),
        ("a.csv", "x;rock\n" + "".join(f"0,{n};0,1\n" for n in range(450, 950, 50)), "spectra"),
        ("a.csv", "450,0.1\n500,0.2\n", "spectra"),
        ("a.toml", "[spectra.bands]\nsmooth = 3\n", "config"),
        ("a.toml", "position_m = [0.0, 0.0, 1.5]\nheading_deg = 0.0\ndown_deg = 20.0\nroll_deg = 0.0\n", "pose"),
        ("a.png", b"\x89PNG\r\n\x1a\n", "picture"),
        ("a.json", '{"type": "FeatureCollection", "features": []}', "zones"),
    ],
)
def test_a_file_is_known_by_its_content(name: str, text: str | bytes, kind: str, tmp_path: Path) -> None:
    found = info(written(tmp_path, name, text))
    assert (found.kind, found.trouble) == (kind, "")
    assert found.commands


@pytest.mark.parametrize(
    ("header", "rows", "told"),
    [
        (
            "trial_num,beta,slip,avg_Fx,avg_Fz",
            [[1 + k // 9, 0, 0.1, 5, -20] for k in range(27)],
            "could be wheel states",
        ),
        ("t,X,Y,heading,rpm", [[5 + k, k, 0, 0, 9] for k in range(20)], "could be telemetry"),
        ("id,feo_wt", [[k, 9.8] for k in range(1, 31)], ""),
    ],
)
def test_a_table_of_something_else_is_no_spectrum(
    header: str, rows: list[list[float]], told: str, tmp_path: Path
) -> None:
    text = "\n".join([header, *(",".join(map(str, row)) for row in rows)])
    found = info(written(tmp_path, "a.csv", text))
    assert (found.kind, found.commands, len(found.remarks)) == ("table", [], 1 if told else 0)
    assert told in " ".join(found.remarks)


def test_templates_of_states_and_priors_say_the_same_as_their_readers() -> None:
    """States of lunar-typical soil, 820 kPa/m at N = 1 assumed; the priors are those that hold without a file."""
    prior = template("prior").text
    assert read_prior(InputFile("prior.toml", prior.encode())) == default_prior()
    states = io.StringIO(template("states").text)
    found = lunarsci.identify(states, rover="yutu2", draws=2).identification.site["stiffness_kpa_m_n"].value
    soil = read_soil("lunar-typical")
    assert soil.sinkage_exponent == 1.0 and found == pytest.approx(soil.stiffness_kpa_m_n, rel=0.01)


def test_a_table_of_an_exporter_is_known_by_any_column_and_below_lines_of_text(tmp_path: Path) -> None:
    rows = "".join(f"{k};{400 + 10 * k};0,{k + 1}\n" for k in range(9))
    table = f"Kanal;Wellenlänge [nm];Refl\n{rows}"
    found = info(written(tmp_path, "one.csv", table))
    assert (found.kind, found.trouble, found.contents["channels"]) == ("spectra", "", 9)
    found = info(written(tmp_path, "two.csv", f"Labor Nord\nGerät: X\n{table}"))
    assert (found.kind, found.trouble, found.contents["channels"]) == ("spectra", "", 9)


def test_a_terrain_says_its_size(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", x_m=np.arange(3) * 0.5, y_m=np.arange(4) * 0.5, height_m=np.zeros((4, 3)))
    found = info(tmp_path / "a.npz")
    assert found.contents["nodes"] == "3 x 4" and found.contents["y_m"] == "0 to 1.5"


def test_what_commands_would_refuse_is_said(tmp_path: Path) -> None:
    found = info(written(tmp_path, "plan.toml", "[drive]\nspeed_m_s = 0.05\n[[leg]]\nlenght_m = 3\n"))
    assert found.kind == "plan" and "did you mean 'length_m'" in found.untrusted
    with pytest.raises(DataError, match="without a schema"):
        info(written(tmp_path, "a.json", "{}"))
    with pytest.raises(DataError, match="no such file"):
        info(tmp_path / "nowhere.csv")
    assert info(tmp_path).contents == {"plan": "1: plan.toml", "unknown": "1: a.json"}


SOURCES = (
    "Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8",
    "Ding et al. (2024), Nat. Commun. 15, 2098, 10.1038/s41467-024-46233-8: sinkage from the depth of tracks",
    "Lucey, Blewett & Jolliff (2000), J. Geophys. Res. 105, 20297, 10.1029/1999JE001117",
    "Lucey, Blewett, Taylor & Hawke (2000), J. Geophys. Res. 105, 20377, 10.1029/1999JE001110",
    "Pike (1974), Earth Planet. Sci. Lett. 23, 265, 10.1016/0012-821X(74)90114-9",
    "ASTM E490-00a, air mass zero (doi 10.1520/E0490-00AR06)",
)


def test_sources_become_entries(tmp_path: Path) -> None:
    record = Provenance(command="lunarsci spectra fit", sources=SOURCES).to_dict(time=False)
    found = cite(written(tmp_path, "fit.json", to_json(document("spectra-fit/1", {"spectra": []}, record))))
    assert list(found.keyed) == ["ding2024", "lucey2000", "lucey2000b", "pike1974", "astm-e490"]
    entries = dict(re.findall(r"@\w+\{([\w-]+),\n(.*?)\n\}", found.bibtex(), re.DOTALL))
    assert list(entries) == ["lunarsci", *found.keyed]
    assert "author = {Lucey, P. G. and Blewett, D. T. and Jolliff, B. L.}" in entries["lucey2000"]
    assert "author = {Lucey, P. G. and Blewett, D. T. and Taylor, G. J. and Hawke, B. R.}" in entries["lucey2000b"]
    assert "pages = {20297--20305}" in entries["lucey2000"] and "volume = {105}" in entries["lucey2000"]
    assert "title = {{Lunar rock investigation" in entries["ding2024"] and "Zhao, Y.-Y. S." in entries["ding2024"]
    assert "note" not in entries["pike1974"] + entries["ding2024"]
    assert "doi = {10.1016/0012-821X(74)90114-9}" in entries["pike1974"]
    assert "year = {2000}" in entries["astm-e490"] and "note = {reapproved 2006}" in entries["astm-e490"]
    assert f"note = {{version {lunarsci.__version__}}}" in entries["lunarsci"] and "year = {20" in entries["lunarsci"]
    assert found.bibtex().count("{") == found.bibtex().count("}")
    assert json.loads(found.to_json())["result"]["sources"][0]["key"] == "ding2024"


def test_works_behind_tables_are_cited(tmp_path: Path) -> None:
    """Laboratory libraries, craters and priors: by the tables that a result was made with, each work once."""
    tables = dict.fromkeys(("end_members.csv", "source_craters.csv", "priors.toml"), "0" * 64)
    record = Provenance(command="lunarsci spectra unmix", sources=SOURCES[:1], tables=tables).to_dict(time=False)
    found = cite(written(tmp_path, "unmix.json", to_json(document("spectra-unmix/1", {"spectra": []}, record))))
    assert {"kokaly2017", "korda2023", "iau-gazetteer", "hu2019", "ishigami2007", "ding2024"} <= set(found.keyed)
    assert found.keyed["pavlov2019"].text.endswith("(2019), Proc. of the ISTVS 15th European-African Conference")
    assert [one.doi for one in found.references].count("10.1038/s41467-024-46233-8") == 1
    chosen = Provenance(command="lunarsci twin predict", tables={"soils.toml": "0" * 64}).to_dict(time=False)
    driven = cite(written(tmp_path, "drive.json", to_json(document("twin-predict/1", {}, chosen))))
    assert list(driven.keyed) == ["ding2024"], "a soil by its name"
    assert "Data Series 1035" in found.bibtex() and r"Meteoritics \& Planetary Science" not in found.bibtex()


def test_only_soils_that_were_compared_are_cited() -> None:
    """A site without strength is compared with soils of known bearing; two references in one source are two works."""
    bearing = lunarsci.compare_soils(stiffness=1000.0, exponent=1.0)
    keys = set(cite(bearing).keyed)
    assert {"wong2008", "ding2011", "wang2016", "lim2021", "ishigami2007"} < keys
    assert not keys & {"zheng2009", "alshibli2009", "heiken1991", "surveyor1", "apollo15"}
    both = lunarsci.compare_soils(stiffness=1000.0, exponent=1.0, cohesion=500.0, friction_angle=40.0)
    assert {"zheng2009", "alshibli2009", "heiken1991", "surveyor1", "surveyor3", "surveyor7", "apollo15"} <= (
        set(cite(both).keyed) - keys
    )


def test_regressions_that_no_spectrum_can_use_are_not_cited() -> None:
    """Bands of augite, which those for howardites and chondrites refuse, against bands of orthopyroxene."""
    grid = np.arange(450.0, 2400.0, 5.0)

    def keys(*centres: float) -> set[str]:
        depths = sum(0.3 * np.exp(-(((grid - c) / w) ** 2)) for c, w in zip(centres, (80.0, 180.0), strict=True))
        return set(cite(lunarsci.bands(pd.DataFrame({"wavelength_nm": grid, "rock": 0.2 * np.exp(-depths)}))).keyed)

    augite, bronzite = keys(1030.0, 2290.0), keys(920.0, 1900.0)
    assert {"gaffey2002", "sanchez2012", "adams1974", "klima2011"} <= augite
    assert not augite & {"burbine2009", "dunn2010", "cloutis1986", "klima2007", "king1987", "sunshine1998"}
    assert bronzite - augite == {"burbine2009", "klima2007"} and augite <= bronzite


def cited_in_the_code() -> list[str]:
    """References that results can name: texts of modules that are no docstrings, and sources of reference soils."""
    found = [text for soil in reference_soils() for text in SEVERAL.split(soil.source)]
    for path in (Path(lunarsci.__file__).parent).rglob("*.py"):
        tree = ast.parse(path.read_text("utf-8"))
        told = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        texts = [node for node in ast.walk(tree) if isinstance(node, ast.Constant) and id(node) not in told]
        found += [one.value for one in texts if isinstance(one.value, str) and REFERENCE.match(one.value)]
    return sorted({text for text in found if text[0].isupper()})


NO_YEAR = {"zhao-ga-plsr", "iau-gazetteer"}
"""A repository without a date, and a list that grows; their notes say so."""


UNTITLED = {"anbazhagan2021", "cherkasov1977", "dnizhininskaya1971", "pavlov2019", "wang2016", "yin2023"}
"""Works that were seen in public collections and code only, all of soils: author, year and place, but no title."""


NAME = re.compile(r"[A-Z](?:[\w'-]|\{\\\"[aou]\})+(?:, [A-Z]\.(?:[ -][A-Z]\.)*)|\{[\w .]+\}")
"""A surname with initials, or an institution."""


def test_every_entry_that_can_be_printed_is_whole() -> None:
    """Works of the table and whatever results name: what every style needs, braces that close, one key each."""
    texts = cited_in_the_code()
    assert len(texts) > 50 and SOURCES[0] in texts
    named = {one.same: one for one in map(cite_of, texts)}
    rest = [reference_to(name) for name in works() if name not in {"lunarsci", *named}]
    found = CitedSources(references=[*named.values(), *rest], documents=[])
    assert found.bibtex().isascii() and 'F{\\"o}rstner, W.' in found.bibtex()
    printed = re.findall(r"@(\w+)\{([\w-]+),\n(.*?)\n\}\n", found.bibtex(), re.DOTALL)
    assert [name for _, name, _ in printed] == ["lunarsci", *found.keyed]
    assert len(printed) == found.bibtex().count("\n@") + 1 == len({name for _, name, _ in printed})
    wanted = {"article": ("journal", "title"), "book": ("title", "publisher"), "techreport": ("title", "institution"),
              "incollection": ("title", "booktitle"), "inproceedings": ("title", "booktitle"), "misc": ()}  # fmt: skip
    for kind, name, body in printed:
        fields = dict(re.findall(r"^  (\w+) = \{(.*)\},$", body, re.MULTILINE))
        assert len(fields) == body.count("\n") + 1 and body.count("{") == body.count("}"), name
        assert {*wanted[kind]} <= fields.keys() and fields.keys() & {"author", "editor"}, name
        assert ("year" in fields) is (name not in NO_YEAR) and ("year" in fields or "note" in fields), name
        assert not any(re.search(r"(?<!\\)[&%$#_]", said) for key, said in fields.items() if key != "doi"), name
        assert name not in UNTITLED or fields.keys() & {"howpublished", "doi"}, name
        names = (fields.get("author") or fields["editor"]).split(" and ")
        assert name not in works() or all(NAME.fullmatch(one) for one in names[:-1]), name
        assert name not in works() or NAME.fullmatch(names[-1]) or (names[-1] == "others" and len(names) > 1), name
        author = re.sub(r'\{\\"(.)\}', r"\1e", names[0].lower()).split(",")[0]
        assert name in works() or re.fullmatch(rf"\w+{fields['year']}[a-z]?", name), name
        assert name in NO_YEAR or name not in works() or name.startswith(f"{author}{fields['year']}") or "{" in author
    assert {name for name, one in found.keyed.items() if not one.title} == UNTITLED


def test_a_year_and_a_doi_are_found_where_they_are() -> None:
    lowe = reference_of("Lowe (2004), Int. J. Comput. Vis. 60, 91, 10.1023/B:VISI.0000029664.99615.94: features")
    assert lowe.doi == "10.1023/B:VISI.0000029664.99615.94"
    assert reference_of("Gennery (2006), Int. J. 68, 239, 10.1007/s11263-006-5168-1: CAHV").doi.endswith("5168-1")
    book = reference_of("Cressie (1993), Statistics for Spatial Data, 10.1002/9781119115151: universal kriging")
    assert book.fields == {"author": "Cressie", "howpublished": "Statistics for Spatial Data", "year": "1993",
                           "doi": "10.1002/9781119115151"}  # fmt: skip
    one, other = (reference_of(f"Brown (1971), Photogramm. Eng. 37, 855: {what}") for what in ("lenses", "cameras"))
    assert one.same == other.same and cite_of("Rahimi & Recht (2007), NIPS 20, 1177").title.startswith("Random")
    found = reference_of(
        "ASTM G173-03, extraterrestrial (Gueymard 2004, Solar Energy, doi 10.1016/j.solener.2003.08.039)"
    )
    assert (found.authors, found.year, found.doi) == ("", "2004", "10.1016/j.solener.2003.08.039")


@pytest.mark.study
def test_after_a_doctor_the_main_commands_compile_nothing(tmp_path: Path) -> None:
    grid = np.linspace(450.0, 2400.0, 120)
    rock = 0.2 * np.exp(-0.3 * np.exp(-(((grid - 950.0) / 90.0) ** 2)))
    lines = [f"{wavelength:.1f},{value:.5f},0.001" for wavelength, value in zip(grid, rock, strict=True)]
    (tmp_path / "rock.csv").write_text("\n".join(["wavelength_nm,rock,rock_sigma", *lines]))
    commands = ("doctor", "spectra bands rock.csv", "spectra fit rock.csv", "regolith forces --sinkage 0.01",
                "regolith identify lunarsci-demo/wheel_states.csv", "twin predict --members 16")  # fmt: skip
    (tmp_path / "lunarsci-demo").mkdir()
    (tmp_path / "lunarsci-demo" / "wheel_states.csv").write_text(template("states").text)
    kept = []
    for command in commands:
        program = [sys.executable, "-m", "lunarsci", *command.split(), "-q"]
        environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "code")}
        done = subprocess.run(program, cwd=tmp_path, env=environment, check=False)
        assert done.returncode in (0, 3)
        kept.append({path.name for path in (tmp_path / "code").rglob("*-*")})
    assert len(kept[0]) > 10 and all(names == kept[0] for names in kept)


def test_a_doctor_says_what_is_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tests pass on this code; one that is off, one that fails and a folder without rights are said."""
    assert doctor._ground()[1] == "" and "32.0" in doctor._ground()[0]
    monkeypatch.setattr(doctor, "LOAD_N", 35.0)
    monkeypatch.setattr(doctor, "_rock", lambda: ("fine", ""))

    def broken() -> tuple[str, str]:
        raise OSError("no disk")

    monkeypatch.setattr(doctor, "_drive", broken)
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/proc/1/nowhere")
    found = doctor.doctor()
    assert [line.partition(":")[0] for line in found.trouble] == ["compiled code", "ground", "drive"][
        -len(found.trouble) :
    ]
    assert "off by more than" in found.untrusted and "OSError: no disk" in found.untrusted


def test_a_doctor_knows_the_extras_of_the_project() -> None:
    """Those for users: what development needs asks for the package itself."""
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text("utf-8"))["project"]
    extras = project["optional-dependencies"]
    assert set(doctor.EXTRAS) == {name for name, needs in extras.items() if not needs[0].startswith("lunarsci[")}
    assert all(len(doctor.EXTRAS[name]) == len(extras[name]) for name in doctor.EXTRAS)
    assert all(re.split(r"[<>=]", need)[0] in doctor._versions().observed for need in project["dependencies"])


@pytest.mark.slow
def test_all_is_well_here() -> None:
    assert [one for one in doctor.doctor().checks if one.trouble] == []


def test_results_in_memory_are_cited_as_their_files_are(tmp_path: Path) -> None:
    found = lunarsci.wheel_forces(sinkage=0.01)
    file = tmp_path / "forces.json"
    file.write_text(found.to_json())
    cited = lunarsci.cite(found)
    assert [one.text for one in cited.references] == [one.text for one in lunarsci.cite(file).references] != []
    assert "@article{ding2024" in str(cited) and "10.1038/s41467-024-46233-8" in str(lunarsci.cite([found, file]))
    assert lunarsci.cite(found, file).bibtex() == lunarsci.cite([found, file]).bibtex()
    assert [one.name for one in lunarsci.cite(found, [file]).documents] == ["regolith-forces (1)", str(file)]


def test_a_wheel_alone_is_taken_by_what_is_listed_and_what_it_lacks_is_counted(tmp_path: Path) -> None:
    found = info(
        written(tmp_path, "wheel.toml", "name = 'Rig'\n[wheel]\nradius_m = 0.15\nwidth_m = 0.1\nexit_c3 = -0.1\n")
    )
    usual = "grouser_height_m 0, grouser_shear_coefficient 0.5, max_stress_c1 0.5, max_stress_c2 0"
    assert str(found.contents["assumed numbers"]).startswith("4: ") and usual in found.contents.values()
    assert found.commands[0] == "lunarsci regolith infer --rover"
    assert all(one.startswith("lunarsci regolith ") for one in found.commands)
    words = inspect.getdoc(command_info) or ""
    assert [name for names in named_here().values() for name in names if name not in words] == []
    assert info("rashid-1").commands == found.commands and info("priors").contents["cohesion_pa"].startswith("600 Pa")
    assert {"cohesion_pa": 520.0, "assumed": "external_friction_angle_deg, lateral_modulus_mm"}.items() <= dict(
        info("lunar-typical").contents
    ).items()
    own = info("yutu2")
    assert usual not in own.contents.values() and "lunarsci twin predict --rover" in own.commands
