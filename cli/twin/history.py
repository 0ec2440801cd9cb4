"""`lunarsci twin history`: what a belief of the soil rests on, and the way back."""

from pathlib import Path
from typing import Annotated

import typer

from ..shared.command import command
from ..shared.options import Output
from ..shared.report import Report

__all__ = ["add_to"]


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "history")(history)


def history(
    belief: Annotated[str, typer.Argument(metavar="BELIEF.json", help="A belief of `twin update --save`.")],
    output: Output,
    against: Annotated[
        str | None, typer.Option(metavar="FILE", help="Another belief (JSON) to set beside it, parameter by parameter.")
    ] = None,
    rollback: Annotated[
        int | None, typer.Option(min=0, metavar="N", help="Go back to what was believed after N drives; 0: the priors.")
    ] = None,
    save: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Takes the belief of --rollback (JSON), for `twin update`.")
    ] = None,
) -> Report:
    """What drives a belief of the soil rests on, how each moved it, and where it differs from another.

    Each drive is shown with its states file, how many values it had and how well a soil explained them, and how far it
    moved each parameter in standard deviations of what was believed before. --rollback undoes the drives after the
    Nth: mean and covariance come back to the digit, soils drawn at that moment do not, so the belief is a normal law
    from there on.
    """
    from .history_report import history_report, read_beliefs

    if (rollback is None) != (save is None):
        raise typer.BadParameter("--rollback N and --save FILE belong together; give both, or neither")
    output.check_extra("--save", save, (".json",))
    return history_report(read_beliefs(belief, against), rollback, save)
