"""A description for people."""

from __future__ import annotations

from typing import Any

Description = dict[str, Any]
_SHOWN_APART = {"path", "type", "summary", "unknown", "problems"}


def text_lines(description: Description) -> list[str]:
    """The description, a line per fact; what is empty is left out, what is unknown or wrong comes last."""
    lines = [f"{description['path']}: {description['summary']}"]
    for key, value in description.items():
        if key not in _SHOWN_APART and value not in (None, [], {}):
            lines += _lines(key.replace("_", " "), value, "  ")
    if description["unknown"]:
        lines.append(f"  not known: {', '.join(description['unknown'])}")
    return [*lines, *(f"  problem: {problem}" for problem in description["problems"])]


def inline(value: Any) -> str:
    """A value on one line; what is empty in it is left out."""
    if isinstance(value, dict):
        return ", ".join(f"{key} {inline(item)}" for key, item in value.items() if item not in (None, [], {}))
    if isinstance(value, list | tuple):
        return ", ".join(map(inline, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def count(number: int, what: str) -> str:
    """``1 photo``, ``2 photos``."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def _lines(name: str, value: Any, indent: str) -> list[str]:
    if isinstance(value, dict):
        inner = [line for key, item in value.items() for line in _lines(str(key), item, indent + "  ")]
        return [f"{indent}{name}:", *inner]
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return [f"{indent}{name}:", *(f"{indent}  {inline(item)}" for item in value)]
    return [f"{indent}{name}: {inline(value)}"]
