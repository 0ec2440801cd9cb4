"""`lunarsci spectra match`: the crater a rock came from."""

from typing import Annotated, Literal

import typer

from ..shared.command import command
from ..shared.options import Output
from ..shared.report import Report

__all__ = ["add_to"]

ROCK, CRATERS, PRIOR, EXPOSURE = "Rock", "Craters", "Prior", "Survival and re-excavation"

Rocks = Annotated[
    list[str] | None,
    typer.Argument(
        help="JSON results of `lunarsci spectra fit` (modes, or NBSR at 2 µm) and `lunarsci spectra bands`; the same "
        "id in both is one rock; - is stdin. None with --modes or --bands.",
        metavar="[ROCK]...",
    ),
]
Modes = Annotated[
    str | None,
    typer.Option(
        metavar="MINERAL=FRACTION:ERROR,…",
        help="Modes of a rock without a file: olivine, orthopyroxene, clinopyroxene, plagioclase (or ol, opx, cpx, "
        "plg); two or more, compared as shares of those given.",
        rich_help_panel=ROCK,
    ),
]
Bands = Annotated[
    str | None,
    typer.Option(metavar="bc1000=NM:ERROR,…", help="Its band centres, bc1000 and bc2000, in nm.", rich_help_panel=ROCK),
]
Name = Annotated[str, typer.Option(help="Name of that rock.", rich_help_panel=ROCK)]
Site = Annotated[
    str,
    typer.Option(metavar="LAT,LON", help="Where the rock was found, in degrees, east positive.", rich_help_panel=ROCK),
]
Use = Annotated[
    Literal["both", "modes", "bands"],
    typer.Option(help="Which kind of composition is compared, where a crater has it.", rich_help_panel=ROCK),
]
Systematic = Annotated[
    float,
    typer.Option(
        help="What two methods disagree by in the share of a mineral, one standard deviation.", rich_help_panel=ROCK
    ),
]
BandSystematic = Annotated[float, typer.Option(help="The same for band centres, in nm.", rich_help_panel=ROCK)]
Craters = Annotated[
    str | None,
    typer.Option(
        metavar="FILE",
        help="Candidates as CSV: name, latitude_deg, longitude_deg, diameter_km; also age_low_ma, age_high_ma, "
        "olivine, olivine_sigma, …, bc1000_nm, bc1000_sigma_nm, …, source. Left out: the craters around Chang'E-4.",
        rich_help_panel=CRATERS,
    ),
]
Map = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="MINERAL=FILE.tif",
        help="GeoTIFF of a mineral's mode: its values in the ring of ejecta replace a crater's modes. May be repeated.",
        rich_help_panel=CRATERS,
    ),
]
Annulus = Annotated[str, typer.Option(metavar="IN:OUT", help="That ring, in rim radii.", rich_help_panel=CRATERS)]
Prior = Annotated[
    Literal["ejecta", "uniform"],
    typer.Option(help="ejecta: by what each crater left at the site; uniform: all alike.", rich_help_panel=PRIOR),
]
Law = Annotated[
    Literal["mcgetchin", "pike", "housen", "xie"],
    typer.Option(help="Law of the ejecta's thickness, from the transient crater.", rich_help_panel=PRIOR),
]
ThicknessFactor = Annotated[
    float,
    typer.Option(
        help="Spread of the thickness about the law, one standard deviation, as a factor; 1 for none.",
        rich_help_panel=PRIOR,
    ),
]
SurfaceAge = Annotated[
    float | None,
    typer.Option(
        help="Age of the site's surface in Ma: ejecta of older craters lie below it. Left out: 3600 at Chang'E-4, none "
        "elsewhere.",
        rich_help_panel=PRIOR,
    ),
]
Other = Annotated[
    float,
    typer.Option(help="Prior probability that the rock is from none of the craters.", rich_help_panel=PRIOR),
]
Exposure = Annotated[
    bool,
    typer.Option("--exposure/--no-exposure", help="Rocks are destroyed at the surface.", rich_help_panel=EXPOSURE),
]
RockLife = Annotated[
    str,
    typer.Option(metavar="LOW:HIGH", help="Median life of a 2 m boulder, in Ma.", rich_help_panel=EXPOSURE),
]
RockSize = Annotated[float, typer.Option(help="Size of the rock, in m.", rich_help_panel=EXPOSURE)]
LifeExponent = Annotated[
    float, typer.Option(help="Its life goes with this power of its size; assumed.", rich_help_panel=EXPOSURE)
]
ReExcavation = Annotated[
    bool,
    typer.Option(
        "--re-excavation/--no-re-excavation", help="Buried ejecta are brought up again.", rich_help_panel=EXPOSURE
    ),
]
Stirring = Annotated[
    float,
    typer.Option(help="Factor on the local ground that falling ejecta stir up (Oberbeck).", rich_help_panel=EXPOSURE),
]
Gardening = Annotated[
    str,
    typer.Option(
        metavar="LOW:HIGH",
        help="Buried rock that small local craters keep at the surface, as a thickness in m; assumed.",
        rich_help_panel=EXPOSURE,
    ),
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the draws for the prior.", rich_help_panel=PRIOR)]


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    command(app, "match")(match)


def match(
    output: Output,
    rocks: Rocks = None,
    modes: Modes = None,
    bands: Bands = None,
    name: Name = "rock",
    site: Site = "-45.44,177.56",
    use: Use = "both",
    systematic: Systematic = 0.10,
    band_systematic: BandSystematic = 10.0,
    craters: Craters = None,
    mineral_map: Map = None,
    annulus: Annulus = "1:2",
    prior: Prior = "ejecta",
    ejecta_law: Law = "pike",
    thickness_factor: ThicknessFactor = 3.0,
    surface_age: SurfaceAge = None,
    other: Other = 0.1,
    exposure: Exposure = True,
    rock_life: RockLife = "40:80",
    rock_size: RockSize = 2.0,
    life_exponent: LifeExponent = 0.5,
    re_excavation: ReExcavation = True,
    stirring: Stirring = 1.0,
    gardening: Gardening = "0.001:0.1",
    seed: Seed = 0,
) -> Report:
    """The crater a rock came from: composition (ln Bayes factor), prior and posterior, each apart.

    ln Bayes factors compare with a rock of any composition; a crater of unknown composition has 0.
    """
    from lunarsci.spectra.origin.match import MatchSettings, match_rocks
    from lunarsci.spectra.origin.prior import PriorSettings

    from .match_report import match_report
    from .match_run import candidates, rocks_from, span, stated_site

    settings = MatchSettings(
        systematic=systematic,
        band_systematic_nm=band_systematic,
        use_modes=use != "bands",
        use_bands=use != "modes",
        prior=PriorSettings(
            kind=prior,
            law=ejecta_law,
            thickness_factor=thickness_factor,
            exposure=exposure,
            rock_life_ma=span(rock_life, "--rock-life"),
            rock_size_m=rock_size,
            life_exponent=life_exponent,
            re_excavation=re_excavation,
            stirring=stirring,
            gardening_m=span(gardening, "--gardening"),
            surface_age_ma=surface_age,
            other_weight=other,
            seed=seed,
        ),
    )
    where = stated_site(site)
    given = rocks_from(rocks or (), modes, bands, name)
    found = candidates(craters, mineral_map or (), annulus)
    return match_report(given, found, match_rocks(given.rocks, found.craters, where, settings), where, settings)
