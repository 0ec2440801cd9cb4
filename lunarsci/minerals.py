"""The minerals that the package knows: their names, and what each of them is in.

A new mineral is a row of `TABLE`. Its bands are rows of `spectra_data/mgm_bands.csv`, its end members of
`spectra_data/end_members.csv`. Shares of `spectra unmix` come from networks, which learned of those that are `weighed`.
"""

import re
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Mineral:
    """One mineral, or another constituent of spectra.

    Attributes
    ----------
    name : in full, as in JSON and tables.
    abbreviation : as in assemblages; empty for one without bands of its own.
    aliases : other words for it in libraries.
    components : of its chemistry, in mole fractions.
    weighed : whether the networks of shares know it; these are in their order.
    """

    name: str
    abbreviation: str = ""
    aliases: tuple[str, ...] = ()
    components: tuple[str, ...] = ()
    weighed: bool = False


TABLE = (
    Mineral("olivine", "OL", (), ("fo",), weighed=True),
    Mineral("orthopyroxene", "OPX", ("lcp",), ("fs", "en", "wo"), weighed=True),
    Mineral("clinopyroxene", "CPX", ("hcp",), ("fs", "en", "wo"), weighed=True),
    Mineral("plagioclase", "PLG", ("plag",), ("an",), weighed=True),
    Mineral("opaque", aliases=("ilmenite", "ilm")),
    Mineral("glass"),
    Mineral("other"),
)
CONSTITUENTS = tuple(one.name for one in TABLE)
"""All of them, as end members may be."""
MINERALS = {one.abbreviation: one.name for one in TABLE if one.abbreviation}
"""Those with bands, by abbreviation; rocks and craters are made of these."""
WITH_BANDS = tuple(MINERALS.values())
ABBREVIATIONS = {name: key for key, name in MINERALS.items()}
WEIGHED = tuple(one.name for one in TABLE if one.weighed)
"""Those that `spectra unmix` gives shares of."""
CHEMISTRY = {one.name: one.components for one in TABLE if one.components}
COMPONENTS = tuple(dict.fromkeys(key for one in TABLE for key in one.components))
"""Of the chemistry of all."""
WORDS = {word.lower(): one.name for one in TABLE for word in (one.name, one.abbreviation, *one.aliases) if word}
"""Names by every word for them, in lower case."""


def abbreviated(names: str) -> list[str]:
    """Abbreviations of minerals joined by hyphens, commas or plus signs, which may be names too; of others capitals.

    >>> abbreviated("olivine-opx"), abbreviated("OL, glass")
    (['OL', 'OPX'], ['OL', 'GLASS'])
    """
    parts = re.split(r"\s*[-,+]\s*", names.strip())
    return [ABBREVIATIONS.get(WORDS.get(part.lower(), ""), "") or part.upper() for part in parts]
