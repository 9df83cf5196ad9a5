"""Values that several commands parse alike; each raises `UsageError` with what would have been right."""

from __future__ import annotations

from collections.abc import Collection

from lfrig.contracts.errors import NotInThisVersion, UsageError


def one_of(option: str, value: str, present: Collection[str], planned: Collection[str] = ()) -> str:
    """``value`` when this version has it; says so when only a later one will."""
    if value in present:
        return value
    have = ", ".join(present)
    if value in planned:
        raise NotInThisVersion(f"{option} {value}", remedy=f"this version has {have}")
    raise UsageError(f"{option}: unknown {value!r}", remedy=f"choose one of {have}")


def refuse_absent(option: str, value: object) -> None:
    """Raise `NotInThisVersion` when a documented option that is still missing was given."""
    if value not in (None, False):
        raise NotInThisVersion(option, remedy=f"leave {option} out")


def grid(option: str, text: str) -> tuple[int, int]:
    """``7x7`` → (rows, cols), both odd: a synthesized light field has a centre view, the photo."""
    rows, times, cols = text.lower().partition("x")
    if not (times and rows.isdecimal() and cols.isdecimal()):
        raise UsageError(f"{option}: {text!r} is not ROWSxCOLS", remedy="for example 7x7")
    count = int(rows), int(cols)
    if any(n < 1 or n > 99 or n % 2 == 0 for n in count):
        raise UsageError(f"{option}: {text!r}: rows and columns must be odd, 1 to 99", remedy="for example 7x7")
    return count


def number_range(option: str, text: str) -> tuple[float, float] | None:
    """``auto`` → None, ``LO:HI`` → (lo, hi)."""
    if text == "auto":
        return None
    low, _, high = text.partition(":")
    try:
        bounds = float(low), float(high)
    except ValueError:
        raise UsageError(f"{option}: {text!r} is neither auto nor LO:HI", remedy="for example -2:2") from None
    if not bounds[0] < bounds[1] or bounds[1] - bounds[0] == float("inf"):
        raise UsageError(f"{option}: {text!r}: LO must be below HI", remedy="for example -2:2")
    return bounds


def names(option: str, text: str | None) -> list[str] | None:
    """``a,b`` → ["a", "b"]; None stays None."""
    if text is None:
        return None
    parts = [part.strip() for part in text.split(",")]
    if not all(parts):
        raise UsageError(f"{option}: {text!r} has an empty name", remedy="for example 000,001")
    return parts


def positive(option: str, value: float | None) -> float | None:
    """A positive, finite number or None."""
    if value is not None and not 0 < value < float("inf"):
        raise UsageError(f"{option}: {value} is not a positive number", remedy="give a positive number")
    return value
