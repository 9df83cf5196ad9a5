"""journal.jsonl: what happened at the rig, in order; append-only, one JSON object per line, on disk before the next
thing happens. A torn last line (power loss while writing) is cut off when the journal is opened again.
"""

from __future__ import annotations

import contextlib
import json
import os
import time
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from lfrig.contracts.errors import BadInput
from lfrig.contracts.files import disk_errors, sync_folder

JOURNAL_FILE = "journal.jsonl"


class Journal:
    """An open journal; use as a context manager.

    Each record carries ``seq`` (0, 1, 2, ... over all runs), ``time`` (UTC, for people), ``monotonic_s`` (for order and
    durations within a run) and ``event``.

    Raises
    ------
    BadInput
        The file holds something that is not a journal.
    DiskError
        Writing failed.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._next = len(read_journal(path)) if path.exists() else 0
        with disk_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            _cut_torn_line(path)
            self._stream: IO[str] = path.open("a", encoding="utf-8")
            sync_folder(path.parent)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def record(self, event: str, **fields: Any) -> None:
        """Append one record and wait until it is on the disk."""
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        record = {"seq": self._next, "time": now, "monotonic_s": round(time.monotonic(), 6), "event": event, **fields}
        with disk_errors(self.path):
            self._stream.write(json.dumps(record, allow_nan=False) + "\n")
            self._stream.flush()
            os.fsync(self._stream.fileno())
        self._next += 1

    def close(self) -> None:
        """Close the file."""
        with contextlib.suppress(OSError):  # every record is on the disk already
            self._stream.close()


def read_journal(path: Path) -> list[dict[str, Any]]:
    """All whole records; a torn last line is left out.

    Raises
    ------
    BadInput
        The file cannot be read, or a line before the last is no record.
    """
    try:
        lines = path.read_bytes().split(b"\n")
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}", path=path, remedy="check the path") from None
    records = []
    for number, line in enumerate(lines[:-1], 1):
        try:
            record = json.loads(line)
            if not isinstance(record, dict) or "event" not in record:
                raise ValueError("no event")
        except ValueError:
            raise BadInput(
                f"line {number} is no journal record", path=path, code="broken-journal",
                remedy="move the file away; the captures are whole without it",
            ) from None  # fmt: skip
        records.append(record)
    return records


def _cut_torn_line(path: Path) -> None:
    """Drop what follows the last line end."""
    if not path.exists():
        return
    with path.open("r+b") as stream:
        data = stream.read()
        whole = data.rfind(b"\n") + 1
        if whole != len(data):
            stream.truncate(whole)
            stream.flush()
            os.fsync(stream.fileno())
