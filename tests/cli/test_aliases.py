"""Former spellings still do what they did, and say what they stand for."""

import pytest
from lunarsci.cli import command_line, main
from lunarsci.cli.shared.aliases import ALIASES, current, option_now
from typer.main import get_command


@pytest.mark.parametrize(
    ("former", "now"),
    [
        ("spectra fit a.csv --abundance hapke --iron", "spectra unmix a.csv --method hapke --iron"),
        ("spectra fit --abundance=unmix a.csv", "spectra unmix --method both a.csv"),
        ("spectra fit a.csv --abundance nbsr -q", "spectra fit a.csv -q"),
        ("regolith identify - --joint --seed 2", "regolith infer - --seed 2"),
        ("twin predict --samples a.csv --members 3", "twin predict --soil a.csv --members 3"),
        ("twin predict --soil-map=m.json", "twin predict --soil m.json"),
        ("twin forces --motion m.csv --belief b.json", "twin loads --motion m.csv --belief b.json"),
        ("twin predict p.toml --belief b.json", "twin predict p.toml --soil b.json"),
        ("twin plan --risk 0.05 --belief=b.json", "twin plan --risk 0.05 --soil b.json"),
        ("twin forces p.toml --belief b.json", "twin forces p.toml --soil b.json"),
        ("twin update s.csv -- --belief", "twin update s.csv -- --belief"),
        ("regolith infer --joint", "regolith infer --joint"),
    ],
)
def test_a_former_spelling_is_replaced(former: str, now: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert current(former.split()) == now.split()
    said = capsys.readouterr().err
    assert ("is an alias of" in said) == (former != now)
    assert current(former.split(), quiet=True) == now.split()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("alias", ALIASES, ids=str)
def test_an_alias_stands_for_what_there_is(alias: object) -> None:
    command = get_command(command_line())
    for word in alias.to_command:  # type: ignore[attr-defined]
        command = command.commands[word]  # type: ignore[attr-defined]
    known = {name for parameter in command.params for name in parameter.opts}
    assert alias.to_option is None or alias.to_option in known  # type: ignore[attr-defined]
    if alias.command == alias.to_command:  # type: ignore[attr-defined]
        assert alias.option not in known, "it is no alias, but an option of its own"  # type: ignore[attr-defined]


def test_a_config_file_knows_former_names() -> None:
    assert option_now("twin update", "belief") == "soil"
    assert option_now("twin update", "plan") == "plan"
    assert option_now("regolith identify", "joint") == "joint"


@pytest.mark.parametrize("options", ["--belief a.json --map b.json", "--soil a.json --belief=b.json"])
def test_two_beliefs_before_a_drive_are_refused(options: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["twin", "update", "states.csv", *options.split()]) == 2
    assert "are the same; give one" in capfd.readouterr().err


def test_an_alias_runs(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["regolith", "identify", "nowhere.csv", "--joint"]) == 1
    said = capfd.readouterr().err.splitlines()
    assert said[0] == "note: regolith identify --joint is an alias of regolith infer"
    assert "no such file" in said[1]
