"""JSON from a file that may be hostile: bounded nesting, finite memory, an error that names file and part."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from lfrig.contracts.errors import BadInput


def parse_json_object(data: memoryview | bytes, path: Path | str, field: str | None, max_depth: int) -> dict[str, Any]:
    """Decode one JSON object (UTF-8, padding of zeros and white space at the end allowed).

    The caller bounds ``len(data)``.

    Raises
    ------
    BadInput
        Codes ``not-json``, ``json-too-deep``; names ``path`` and ``field``.
    """
    try:
        found = json.loads(bytes(data).rstrip(b"\0 \r\n\t").decode("utf-8-sig"))
    except RecursionError:
        raise _too_deep(path, field, max_depth) from None
    except ValueError as error:  # not UTF-8, not JSON, an integer without end
        reason = f"is not valid JSON: {error}"
        raise BadInput(reason, path=path, field=field, code="not-json", remedy="restore the file") from None
    if not isinstance(found, dict):
        raise BadInput("is not a JSON object", path=path, field=field, code="not-json", remedy="restore the file")
    if _deeper_than(found, max_depth):
        raise _too_deep(path, field, max_depth)
    return found


def _too_deep(path: Path | str, field: str | None, max_depth: int) -> BadInput:
    message = f"is nested deeper than {max_depth} levels"
    return BadInput(message, path=path, field=field, code="json-too-deep", remedy="restore the file")


def _deeper_than(value: Any, max_depth: int) -> bool:
    """Whether lists and objects are nested deeper than that; level by level, without recursion."""
    level: list[Any] = [value]
    for _ in range(max_depth):
        level = [child for item in level for child in _children(item) if isinstance(child, dict | list)]
        if not level:
            return False
    return True


def _children(value: Any) -> Iterable[Any]:
    return value.values() if isinstance(value, dict) else value
