"""What every benchmark writes: JSON, Markdown, and where and with what it was run."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lfrig.contracts.bench import BenchDocument, Check
from lfrig.contracts.files import atomic_write_text
from lfrig.contracts.native import load_native


@dataclass(frozen=True)
class Column:
    """A column of a Markdown table: the row's field, the title, and how a number is written."""

    field: str
    title: str
    form: str = ""


@dataclass(frozen=True)
class Table:
    """Some of the rows under a title."""

    title: str
    rows: Sequence[dict[str, Any]]
    columns: Sequence[Column]


def write(
    out: Path,
    name: str,
    *,
    rows: list[dict[str, Any]],
    checks: list[Check],
    tables: Sequence[Table],
    text: str,
    pictures: Sequence[str] = (),
) -> BenchDocument:
    """Write ``OUT/<name>.json`` and ``OUT/<name>.md`` and return the document.

    Parameters
    ----------
    tables : sequence of Table
        What the Markdown shows of the rows.
    text : str
        What was measured, and under which conditions: the paragraph under the title.
    pictures : sequence of str
        File names of plots in ``out``.
    """
    document = BenchDocument(name=name, machine=machine(), commit=commit(), rows=rows, checks=checks)
    parts = [f"# {name}", text]
    for table in tables:
        parts += [f"## {table.title}", markdown_table(table.rows, table.columns)]
    parts += [f"![{picture}]({picture})" for picture in pictures]
    if checks:
        parts += ["## Checks", markdown_checks(checks)]
    parts.append(f"Commit {document.commit or 'unknown'}; {describe(document.machine)}.")
    document.save(out / f"{name}.json")
    atomic_write_text(out / f"{name}.md", "\n\n".join(parts) + "\n")
    return document


def markdown_table(rows: Sequence[dict[str, Any]], columns: Sequence[Column]) -> str:
    """A table; a field that a row lacks is left empty."""
    lines = ["| " + " | ".join(column.title for column in columns) + " |", "|---" * len(columns) + "|"]
    lines += ["| " + " | ".join(_cell(row.get(c.field), c.form) for c in columns) + " |" for row in rows]
    return "\n".join(lines)


def markdown_checks(checks: Sequence[Check]) -> str:
    """The checks as a table."""
    rows = [check.model_dump() | {"verdict": "ok" if check.ok else "**failed**"} for check in checks]
    return markdown_table(
        rows,
        [Column("name", "check"), Column("value", "value", ".5g"), Column("direction", ""),
         Column("bound", "bound", ".5g"), Column("verdict", ""), Column("why", "why")],
    )  # fmt: skip


def machine() -> dict[str, Any]:
    """Processor, memory, versions, and whether the native core is in use."""
    import cv2
    import numpy as np

    return {
        "processor": _processor(),
        "cpus": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "memory_gb": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "native": load_native("lfrig.processing.kernels._native") is not None,
        "load_at_start": round(os.getloadavg()[0], 2),
    }


def describe(found: dict[str, Any]) -> str:
    """One line about the machine."""
    native = "native core" if found["native"] else "NumPy twins"
    return (
        f"{found['processor']}, {found['cpus']} CPUs, {found['memory_gb']} GB, Python {found['python']}, "
        f"NumPy {found['numpy']}, OpenCV {found['opencv']}, {native}, load {found['load_at_start']}"
    )


def commit() -> str | None:
    """The commit of the checkout that runs, with ``+`` when it has changes; None outside a checkout."""
    folder = Path(__file__).resolve().parent
    try:
        head = _git(folder, "rev-parse", "--short=12", "HEAD")
        inside = _git(folder, "ls-files", Path(__file__).name)
        changed = _git(folder, "status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.SubprocessError):
        return None
    # An installed copy can lie inside somebody else's repository, whose commit says nothing about it.
    return (head + ("+" if changed else "")) if inside else None


def _git(folder: Path, *arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=folder, capture_output=True, text=True, check=True, timeout=20)
    return done.stdout.strip()


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _cell(value: object, form: str) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "**no**"
    if isinstance(value, (list, tuple)):
        return ", ".join(str(item) for item in value)
    if form and isinstance(value, (int, float)):
        return format(value, form)
    return str(value).replace("|", "\\|").replace("\n", " ")
