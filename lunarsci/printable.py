"""Text from files, as it may be shown: nothing that a terminal or a spreadsheet takes for a command."""

import re

COMMANDS = re.compile(r"[\x00-\x08\x0a-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")
"""Control characters but tabs (ISO 6429), and those that turn the direction of text (Unicode 15, Bidi_Control)."""
FORMULA = re.compile(r"[=+\-@\t](?![\d.\s]*$)(?![\d.]+(e[+-]?\d+)?$)", re.IGNORECASE)
"""What a spreadsheet runs when a cell begins with it (OWASP, CSV Injection), and no number."""
LONGEST = 600
"""Characters of a message; assumed: a few lines of a terminal."""


def printable(text: str) -> str:
    """The text with its control characters spelt out, such as `\\x1b`."""
    return COMMANDS.sub(lambda sign: f"\\x{ord(sign[0]):02x}", text)


def cell(text: str) -> str:
    """Text for a cell of a CSV table: printable, and with ' before what a spreadsheet would run."""
    shown = printable(text)
    return f"'{shown}" if FORMULA.match(shown) else shown


def shortened(text: str) -> str:
    """A message of at most `LONGEST` characters: what is too long loses its middle, since its end says what to do.

    The end is whole parts between semicolons, where these are not longer than half of it.
    """
    if len(text) <= LONGEST:
        return text
    begin = text.find("; ", len(text) - LONGEST // 2)
    end = text[begin:] if begin >= 0 else f" {text[-LONGEST // 3 :]}"
    return f"{text[: LONGEST - len(end) - 2]} …{end}"
