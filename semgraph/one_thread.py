"""The linear algebra kept to one thread, by what its libraries read when they are loaded."""

import os
from typing import Final

ONE_THREAD: Final = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def use_one_thread() -> None:
    """For this process and those it starts, if numpy is not imported yet.

    Sums depend on how many threads share them, and so would the last digits of results.
    """
    os.environ.update(ONE_THREAD)
