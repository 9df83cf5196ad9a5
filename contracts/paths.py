"""Relative file names inside a capture's folder, and the pattern that names its views.

A pattern holds ``{row}`` and ``{col}`` once or more each, optionally zero-padded (``{row:02d}``); it is a
small language of its own and not `str.format`, so that a file from elsewhere can neither reach attributes nor
ask for a width of a billion digits.
"""

from __future__ import annotations

import re
from pathlib import PurePosixPath, PureWindowsPath
from typing import Annotated

from pydantic import AfterValidator

_FIELD = re.compile(r"\{(row|col)(?::(?:0([1-9]))?d)?\}")


def check_inside(value: str) -> str:
    """Return ``value`` when it names something inside the folder it is relative to; else `ValueError`."""
    if not value or "\0" in value:
        raise ValueError("must name a file")
    for kind in (PurePosixPath, PureWindowsPath):
        name = kind(value)
        if name.anchor or ".." in name.parts:
            raise ValueError(f"{value!r} must stay inside the capture's folder (relative, no '..')")
    return value


def check_pattern(value: str) -> str:
    """Return ``value`` when it has ``{row}`` and ``{col}`` and no other field; else `ValueError`."""
    fields = {match[1] for match in _FIELD.finditer(value)}
    rest = _FIELD.sub("", value)
    if fields != {"row", "col"} or "{" in rest or "}" in rest:
        raise ValueError(f"{value!r} must hold {{row}} and {{col}}, such as {{row:02d}}, and no other braces")
    return value


def expand(pattern: str, row: int, col: int) -> str:
    """The name of view (row, col), zero-based."""
    numbers = {"row": row, "col": col}
    return _FIELD.sub(lambda match: str(numbers[match[1]]).zfill(int(match[2] or 1)), pattern)


def pattern_regex(pattern: str) -> re.Pattern[str]:
    """For whole names, with groups ``row`` and ``col``; later repeats must agree with the first."""
    parts, at, seen = [], 0, set()
    for match in _FIELD.finditer(pattern):
        parts.append(re.escape(pattern[at : match.start()]))
        parts.append(f"(?P={match[1]})" if match[1] in seen else rf"(?P<{match[1]}>\d{{{match[2] or 1},}}?)")
        seen.add(match[1])
        at = match.end()
    return re.compile("".join([*parts, re.escape(pattern[at:])]))


InsidePath = Annotated[str, AfterValidator(check_inside)]
ViewPattern = Annotated[str, AfterValidator(check_inside), AfterValidator(check_pattern)]
