"""What the arguments of commands are, and what is refused as one."""

import argparse
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Final

DATA: Final = Path("..", "shared", "data")
_MAX_SEEDS: Final = 10_000

AddParser = Callable[..., argparse.ArgumentParser]


def sigma(text: str) -> float:
    """Metres above zero."""
    sigma_m = float(text)
    if not 0.0 < sigma_m <= 100.0:
        raise argparse.ArgumentTypeError(f"expected 0 to 100 m, got {text}")
    return sigma_m


def positive(text: str) -> float:
    """A number above zero, infinity too."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not number > 0.0:
        raise argparse.ArgumentTypeError(f"expected a positive number, got {text!r}")
    return number


def seeds(text: str) -> range:
    """A-B, or A alone."""
    match = re.fullmatch(r"([0-9]{1,9})(?:-([0-9]{1,9}))?", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"expected seeds as in 101-124, got {text!r}")
    found = range(int(match[1]), int(match[2] or match[1]) + 1)
    if not found:
        raise argparse.ArgumentTypeError(f"expected the smaller seed first, got {text}")
    if len(found) > _MAX_SEEDS:
        raise argparse.ArgumentTypeError(f"expected 1 to {_MAX_SEEDS} seeds, got {text}")
    return found


def num_workers(text: str) -> int:
    """Zero or more."""
    if not re.fullmatch("[0-9]{1,4}", text):
        raise argparse.ArgumentTypeError(f"expected 0 to 9999 workers, got {text!r}")
    return int(text)


def gibibytes(text: str) -> float:
    """Zero, for all there are, or more."""
    number = float(text)
    if not 0.0 <= number <= 2**20:
        raise argparse.ArgumentTypeError(f"expected gibibytes of 0 or more, got {text}")
    return number
