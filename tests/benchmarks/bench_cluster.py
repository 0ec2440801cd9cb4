"""Rate of two workers of a dask cluster here against one: `python tests/benchmarks/bench_cluster.py [N]`.

N spectra of a SYNTHETIC strip, 85 channels; the machine should do nothing else, and have two cores at least. A worker
is one core: left alone, numba would take all of them for the first worker.
"""

import os

os.environ |= dict.fromkeys(("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")

import sys
import time

import numpy as np
from distributed import LocalCluster
from strips import EIGHTY_FIVE_NM, mixtures

from lunarsci.parallel.blocks import computing
from lunarsci.spectra.mgm.fit import fit_spectra
from lunarsci.spectra.mgm.model import mgm_model
from lunarsci.spectra.spectrum import Spectrum


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
    values = mixtures(EIGHTY_FIVE_NM, (-(-count // 100), 100), seed=1).reflectance.reshape(-1, len(EIGHTY_FIVE_NM))
    spectra = [Spectrum(str(k), EIGHTY_FIVE_NM, row) for k, row in enumerate(values[:count])]
    seconds, found = {}, {}
    for workers in (1, 2):
        with (
            LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster,
            computing(scheduler=cluster.scheduler_address),
        ):
            for part in (spectra[:2048], spectra):  # the first compiles
                before = time.perf_counter()
                fits = fit_spectra(part, mgm_model())
                seconds[workers] = time.perf_counter() - before
            found[workers] = fits.parts[0][2].values
            print(f"{workers} workers: {count / seconds[workers]:,.0f} fits a second")
    print(f"two against one: {seconds[1] / seconds[2]:.2f}; the same bytes: {np.array_equal(*found.values())}")


if __name__ == "__main__":
    main()
