"""Numbers and outcomes as people say them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

POSES = {
    "given": "poses as given",
    "lf": "poses refined on the light fields",
    "colmap-turntable": "poses from structure from motion that started at the turntable's angles",
    "colmap": "poses from structure from motion alone",
}
_NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")


def number(value: float | None, digits: int = 3) -> str:
    """``value`` with ``digits`` significant digits and a true minus sign; – for None, NaN and infinities."""
    if value is None or not math.isfinite(value):
        return "–"
    if value != 0 and not 1e-4 <= abs(value) < 1e5:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        return f"{mantissa}·10{_superscript(int(exponent))}".replace("-", "−")
    decimals = 0 if value == 0 else max(0, digits - 1 - math.floor(math.log10(abs(value))))
    return f"{value:.{decimals}f}".replace("-", "−")


def fixed(value: float | None, decimals: int) -> str:
    """``value`` with a fixed number of decimals; – for None or NaN."""
    return "–" if value is None or not math.isfinite(value) else f"{value:.{decimals}f}".replace("-", "−")


def length(value_m: float, *, metric: bool) -> str:
    """A length in mm below 1 cm, in cm below 10 cm, else in m; in gauge units when the scale is not known."""
    if not metric:
        return f"{number(value_m)} units"
    if abs(value_m) < 0.01:
        return f"{number(value_m * 1e3)} mm"
    return f"{number(value_m * 1e2)} cm" if abs(value_m) < 0.1 else f"{number(value_m)} m"


def seconds(value: float) -> str:
    """A duration: ms below a tenth of a second, minutes above two."""
    if value < 0.0995:
        return f"{value * 1e3:.0f} ms"
    if value < 119.5:
        return f"{value:.1f} s"
    return f"{int(round(value) // 60)} min {round(value) % 60:02d} s"


def memory(megabytes: float) -> str:
    """Memory in MB or GB."""
    return f"{megabytes:.0f} MB" if megabytes < 1000 else f"{megabytes / 1000:.1f} GB"


def count(amount: int, noun: str) -> str:
    """``three sources``, ``one source``, ``12 sources``."""
    word = _NUMBERS[amount] if amount < len(_NUMBERS) else str(amount)
    return f"{word} {noun}" if amount == 1 else f"{word} {noun}s"


def percent(fraction: float, decimals: int = 0) -> str:
    """A fraction as a percentage."""
    return f"{100 * fraction:.{decimals}f} %"


def poses(method: str) -> str:
    """How the poses came about."""
    return POSES.get(method, f"poses: {method}")


def listing(items: Sequence[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return " and ".join([", ".join(items[:-1]), items[-1]] if len(items) > 1 else items)


def nice_ticks(low: float, high: float, wanted: int) -> list[float]:
    """About ``wanted`` round values within [low, high], steps of 1, 2 or 5 times a power of ten."""
    span = high - low
    if not (span > 0 and math.isfinite(span)):
        return [low]
    raw = span / max(1, wanted)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= raw * 0.999)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [float(np.round(index * step, 12)) for index in range(first, last + 1)]


def tick_labels(values: Sequence[float]) -> list[str]:
    """The ticks of `nice_ticks`, all with as many decimals as their step needs, a lone one with those of its own."""
    if len(values) > 1:
        decimals = max(0, -math.floor(math.log10(abs(values[1] - values[0])) + 1e-9))
    else:
        decimals = next((n for n in range(12) if all(round(value, n) == value for value in values)), 12)
    return [fixed(value, decimals) for value in values]


def _superscript(value: int) -> str:
    return str(value).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
