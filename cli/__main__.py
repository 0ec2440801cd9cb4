"""`python -m lunarsci.cli`, the same as `lunarsci`."""

import sys

from . import main

sys.exit(main())
