"""Landmark SLAM: world model, localization and graph."""

import os

# All matrices here are small: on a busy machine a second BLAS thread makes the solution of 160
# equations take 150 ms instead of 0.2. Whoever has chosen, or has imported numpy before, is heard.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
