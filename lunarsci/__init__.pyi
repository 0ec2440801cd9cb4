from lunarsci import errors as errors
from lunarsci.guide.cite import cite as cite
from lunarsci.images.jobs.calibrate_cameras import calibrate_cameras as calibrate_cameras
from lunarsci.images.jobs.cameras import cameras as cameras
from lunarsci.images.jobs.dem import dem as dem
from lunarsci.images.jobs.locate import locate as locate
from lunarsci.images.jobs.merge import merge as merge
from lunarsci.images.jobs.render import render as render
from lunarsci.images.jobs.rocks import rocks as rocks
from lunarsci.images.jobs.track import track as track
from lunarsci.pages.job import report as report
from lunarsci.parallel.blocks import computing as computing
from lunarsci.regolith.jobs.compare_soils import compare_soils as compare_soils
from lunarsci.regolith.jobs.identify import identify as identify
from lunarsci.regolith.jobs.infer import infer as infer
from lunarsci.regolith.jobs.wheel_forces import wheel_forces as wheel_forces
from lunarsci.spectra.jobs.bands import bands as bands
from lunarsci.spectra.jobs.calibrate import calibrate as calibrate
from lunarsci.spectra.jobs.fit import fit as fit
from lunarsci.spectra.jobs.indices import indices as indices
from lunarsci.spectra.jobs.map_cube import map_cube as map_cube
from lunarsci.spectra.jobs.match import match as match
from lunarsci.spectra.jobs.unmix import unmix as unmix
from lunarsci.twin.jobs.compare import compare as compare
from lunarsci.twin.jobs.compare_trials import compare_trials as compare_trials
from lunarsci.twin.jobs.loads import loads as loads
from lunarsci.twin.jobs.plan import plan as plan
from lunarsci.twin.jobs.predict import predict as predict
from lunarsci.twin.jobs.states import states as states
from lunarsci.twin.jobs.sweep import sweep as sweep
from lunarsci.twin.jobs.update import update as update

JOBS: dict[str, tuple[str, ...]]
__version__: str
