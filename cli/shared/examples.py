"""Examples in the help of every command, in an order in which they can be run, each after those above it."""

from collections.abc import Mapping

DEMO = "lunarsci-demo"
EXAMPLES: Mapping[str, tuple[str, ...]] = {
    "demo": ("lunarsci demo", "lunarsci demo --seed 1 -o other-demo"),
    "doctor": ("lunarsci doctor", "lunarsci doctor --field trouble"),
    "template": ("lunarsci template plan > plan.toml", "lunarsci template rover > rover.toml"),
    "spectra simulate": (
        "lunarsci spectra simulate --rock ol=0.1,opx=0.4,cpx=0.2,plg=0.3 -o scene",
        "lunarsci spectra simulate --minerals ol=0.2,opx=0.3,cpx=0.3,plg=0.2 --noise 0",
    ),
    "spectra calibrate": (
        f"lunarsci spectra calibrate {DEMO}/*.2BL -o rock.ecsv",
        "lunarsci spectra calibrate scene --photometry akimov --csv",
    ),
    "spectra bands": (
        f"lunarsci spectra bands {DEMO}/rock.ecsv",
        f"lunarsci spectra bands {DEMO}/rock.ecsv --continuum hull \\\n  --plot bands.png",
    ),
    "spectra indices": (
        f"lunarsci spectra indices {DEMO}/rock.ecsv",
        f"lunarsci spectra indices {DEMO}/rock.ecsv --index ibd1000 --csv",
    ),
    "spectra fit": (
        f"lunarsci spectra fit {DEMO}/rock.ecsv",
        f"lunarsci spectra fit {DEMO}/rock.ecsv --assemblage OPX-CPX -o fit.json",
    ),
    "spectra unmix": (
        f"lunarsci spectra unmix {DEMO}/rock.ecsv --kind solid-rock",
        f"lunarsci spectra unmix {DEMO}/rock.ecsv --kind solid-rock \\\n  -o shares.json",
    ),
    "spectra match": (
        "lunarsci spectra match --modes ol=0.25:0.05,opx=0.35:0.05,cpx=0.4:0.05",
        "lunarsci spectra match shares.json --site=-45.44,177.56",
    ),
    "spectra map": (
        f"lunarsci spectra map {DEMO}/*VD_SCI*.2B --spectrum 128,128",
        f"lunarsci spectra map {DEMO}/*VD_SCI*.2B --products indices \\\n  --every 16 -o map.nc",
    ),
    "spectra library import": (
        f"lunarsci spectra library import {DEMO}/rock.ecsv --mineral other \\\n  -o library.ecsv",
        f"lunarsci spectra library import {DEMO}/rock.ecsv --source here --csv",
    ),
    "spectra library list": (
        "lunarsci spectra library list library.ecsv",
        "lunarsci spectra library list library.ecsv --columns id,mineral",
    ),
    "spectra library check": (
        "lunarsci spectra library check library.ecsv",
        "lunarsci spectra library check library.ecsv --json",
    ),
    "spectra library plot": (
        "lunarsci spectra library plot library.ecsv -o library.png",
        "lunarsci spectra library plot library.ecsv -o library.pdf",
    ),
    "regolith forces": (
        "lunarsci regolith forces --sinkage 0.008 --slip 0.1",
        "lunarsci regolith forces --load 36.5 --slip 0:0.6:13 --plot pull.png",
    ),
    "regolith identify": (
        f"lunarsci regolith identify {DEMO}/wheel_states.csv --exponent 1",
        f"lunarsci regolith identify {DEMO}/wheel_states.csv \\\n  --lateral-modulus 13,40 --csv",
    ),
    "regolith infer": (
        f"lunarsci regolith infer {DEMO}/wheel_states.csv -o soil.json",
        f"lunarsci regolith infer {DEMO}/wheel_states.csv --model-error 0.05",
    ),
    "regolith compare": (
        "lunarsci regolith compare soil.json",
        "lunarsci regolith compare --stiffness 1443 --exponent 1 \\\n  --cohesion 520 --friction-angle 42",
    ),
    "images cameras": (
        "lunarsci images cameras yutu2-pancam",
        f"lunarsci images cameras {DEMO}/rig.toml --disparity-error 0.2",
    ),
    "images render": (
        f"lunarsci images render --rig {DEMO}/rig.toml --rays 1 -o pair",
        f"lunarsci images render --rig {DEMO}/rig.toml --rays 1 \\\n  --x 0.5 -o station-2",
    ),
    "images dem": (
        f"lunarsci images dem {DEMO}/left.png {DEMO}/right.png \\\n"
        f"  --rig {DEMO}/rig.toml --pose {DEMO}/pose.toml \\\n  --save-terrain dem.npz",
        f"lunarsci images dem {DEMO}/left.png {DEMO}/right.png \\\n"
        f"  --rig {DEMO}/rig.toml --spacing 0.05 --save-terrain coarse.npz",
    ),
    "twin terrain": (
        "lunarsci twin terrain",
        "lunarsci twin terrain synthetic --extent 4 --spacing 0.02 --rocks 0.03 \\\n  --seed 2 -o ground",
    ),
    "images track": (
        "lunarsci images track ground/terrain.npz --line 0,1,2.5,1.2",
        "lunarsci images track ground/terrain.npz --line 0,1,2.5,1.2 --step 0.5",
    ),
    "images rocks": (
        "lunarsci images rocks ground/terrain.npz",
        "lunarsci images rocks ground/terrain.npz -o rocks.geojson",
    ),
    "twin plan": (
        "lunarsci twin plan --target 8.5,2.5 -o site",
        "lunarsci twin plan --target 2,0.3 --risk 0.3 --members 4 --candidates 3",
    ),
    "twin predict": (
        "lunarsci twin predict plan.toml --soil lunar-typical",
        "lunarsci twin predict plan.toml --sweep friction_angle_deg=30:50:3 \\\n  -o predicted",
    ),
    "twin simulate": (
        "lunarsci twin simulate plan.toml --seed 5 -o drive",
        "lunarsci twin simulate plan.toml --soil lunar-typical --fix-distance 1",
    ),
    "twin states": (
        "lunarsci twin states drive/telemetry.csv plan.toml \\\n  --track drive/track.csv -o states",
        "lunarsci twin states drive/telemetry.csv --csv",
    ),
    "twin forces": (
        "lunarsci twin forces plan.toml",
        "lunarsci twin forces plan.toml --soil lunar-typical --csv",
    ),
    "twin loads": (
        "lunarsci twin loads --motion states/motion.csv",
        "lunarsci twin loads --motion states/motion.csv --states states/states.csv",
    ),
    "twin update": (
        "lunarsci twin update states/states.csv --plan plan.toml --particles 32 \\\n"
        "  --positions states/positions.csv --save belief.json",
        "lunarsci twin update states/states.csv --plan plan.toml --particles 32 \\\n"
        "  --positions states/positions.csv --seed 2 --save second.json",
    ),
    "twin compare": (
        "lunarsci twin compare predicted states/states.csv --plan plan.toml",
        "lunarsci twin compare predicted states/states.csv \\\n  --positions states/positions.csv --json",
    ),
    "twin history": (
        "lunarsci twin history belief.json",
        "lunarsci twin history second.json --against belief.json",
    ),
    "twin sweep": (
        "lunarsci twin sweep plan.toml --vary wheel.radius_m=0.13:0.17:2",
        "lunarsci twin sweep plan.toml --vary mass.body_kg=90:120:2 --csv",
    ),
    "info": ("lunarsci info belief.json", f"lunarsci info {DEMO}/rock.ecsv"),
    "cite": ("lunarsci cite fit.json", "lunarsci cite fit.json predicted > references.bib"),
    "report": ("lunarsci report fit.json predicted -o report.html", "lunarsci report soil.json"),
    "reproduce": ("lunarsci reproduce --part soil", "lunarsci reproduce --part soil -v"),
    "images merge": (
        "lunarsci images merge dem.npz coarse.npz",
        "lunarsci images merge dem.npz coarse.npz --spacing 0.1 -o map.npz",
    ),
    "images locate": (
        f"lunarsci images locate {DEMO} station-2 --rig {DEMO}/rig.toml",
        f"lunarsci images locate {DEMO} station-2 --rig {DEMO}/rig.toml \\\n  --drift 0.1 --csv",
    ),
    "images calibrate": (
        "lunarsci images calibrate left*.png --board 9x6 --square 0.03",
        "lunarsci images calibrate left*.png --right 'right*.png' --board 9x6 \\\n  --square 0.03 -o rig.toml",
    ),
}
"""By the words of a command; a line that ends in a backslash goes on in the next one, as in a shell."""


def epilog(module: str, name: str) -> str:
    """The examples of a command below its help; none for a command that has none.

    Parameters
    ----------
    module, name : of the function that answers the command, and the command's.
    """
    words = module.split(".")[2:]
    found = EXAMPLES.get(" ".join(words if words[-1:] == [name] else [*words, name]), ())
    return "\n  ".join(["Examples:", *found]).replace("\n  --", "\n      --") if found else ""
