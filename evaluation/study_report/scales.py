"""Where values lie on an axis, and at which of them it has ticks."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from semgraph.arrays import FloatArray

MINUS: Final = "\N{MINUS SIGN}"
UNKNOWN: Final = "\N{EN DASH}"
_STEPS = (1.0, 2.0, 5.0, 10.0)
_MAX_TICKS = 6
_SMALLEST_SHARE = 1e-9
# Nearer to 0 is 0: powers of ten and ratios of what is larger are finite.
_SMALLEST: Final = 1e-100


@dataclass(frozen=True, slots=True)
class Scale:
    """From `low` to `high`, evenly or by powers of ten.

    Attributes:
        label: what is shown, with its unit.
    """

    low: float
    high: float
    label: str = ""
    logarithmic: bool = False

    def share(self, values: FloatArray | float) -> FloatArray:
        """Where values lie, 0 at the low and 1 at the high end; what lies outside, at the end."""
        at, low, high = np.asarray(values, dtype=float), self.low, self.high
        if self.logarithmic:
            at, low, high = np.log10(np.maximum(at, low)), math.log10(low), math.log10(high)
        return np.clip((at - low) / (high - low), 0.0, 1.0)

    @property
    def ticks(self) -> tuple[float, ...]:
        """Round values, two to seven of them."""
        return _log_ticks(self.low, self.high) if self.logarithmic else _even_ticks(self)


def scale_of(
    values: FloatArray, label: str, *, logarithmic: bool = False, from_zero: bool = False
) -> Scale:
    """A scale that holds all finite values with some room; 0 to 1 if there are none.

    A logarithmic one needs values above zero, and is even where it holds none.
    """
    kept = values[np.isfinite(values) & ((values > _SMALLEST) | (not logarithmic))]
    if not len(kept):
        return Scale(0.0, 1.0, label)
    low, high = float(kept.min()), float(kept.max())
    if logarithmic:
        room = max((high / low) ** 0.06, 1.15)
        return Scale(low / room, high * room, label, logarithmic=True)
    room = 0.05 * (high - low) or 0.5 * abs(high) or 1.0
    return Scale(min(low, 0.0) if from_zero else low - room, high + room, label)


def figure_text(value: float) -> str:
    """A value with three significant digits, never as a power of ten below a million."""
    if not math.isfinite(value):
        return UNKNOWN if math.isnan(value) else ("∞" if value > 0.0 else f"{MINUS}∞")
    if value == 0.0:
        return "0"
    if abs(value) >= 1e6 or abs(value) < 1e-5:
        return f"{value:.2e}".replace("-", MINUS)
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:.{digits}f}".replace("-", MINUS)


def figure_texts(*values: float) -> tuple[str, ...]:
    """Values that belong together, with as many decimals as the largest needs for three digits."""
    largest = max((abs(value) for value in values if math.isfinite(value)), default=0.0)
    if not 1e-7 <= largest < 1e6:
        return tuple(map(figure_text, values))
    digits = max(0, 2 - math.floor(math.log10(largest)))
    return tuple(
        f"{value:.{digits}f}".replace("-", MINUS) if math.isfinite(value) else figure_text(value)
        for value in values
    )


def tick_text(value: float) -> str:
    """A tick's value, as short as it is."""
    return f"{value:g}".replace("-", MINUS)


def _even_ticks(scale: Scale) -> tuple[float, ...]:
    raw = (scale.high - scale.low) / _MAX_TICKS
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(each * power for each in _STEPS if each * power >= raw * (1.0 - _SMALLEST_SHARE))
    first, last = math.ceil(scale.low / step), math.floor(scale.high / step)
    return tuple(round(step * number, 12) for number in range(first, last + 1))


def _log_ticks(low: float, high: float) -> tuple[float, ...]:
    """Of 1, 2 and 5 times powers of ten, or whole powers where these would be too many."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for factors in ((1, 2, 3, 5, 7), (1, 2, 5), (1, 3), (1,)):
        ticks = tuple(
            float(f"{factor}e{power}")
            for power in powers
            for factor in factors
            if low <= factor * 10.0**power <= high
        )
        if len(ticks) <= _MAX_TICKS:
            return ticks
    return ticks[:: math.ceil(len(ticks) / _MAX_TICKS)]
