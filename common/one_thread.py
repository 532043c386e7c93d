"""One thread for the linear algebra below numpy: processes are the unit of parallelism here.

``common.first`` imports this before anything that imports numpy, which reads it once. OpenBLAS otherwise
starts a thread a core in each process and wakes them for matrices of 6x6: they then compete with the cameras'
processes, and what takes 0.1 ms takes 1. Who wants threads sets the variables.
"""

from __future__ import annotations

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
