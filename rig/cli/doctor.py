"""``lfrig doctor``: what works on this machine, what does not, and what to do about it."""

from __future__ import annotations

import importlib
import os
import platform
import shutil
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import typer

from lfrig.contracts.errors import CheckFailed
from lfrig.rig.cli.run import Run, text_console
from lfrig.rig.cli.version import version

State = Literal["ok", "missing", "failed"]
MARKS = {"ok": "[green]ok[/]", "missing": "[yellow]missing[/]", "failed": "[red]FAILED[/]"}
LOW_DISK_GB = 2.0
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "firefox")
CPU_FLAGS = ("sse4_2", "avx2", "fma", "avx512f", "avx512bw", "avx512_vnni", "asimd", "sve")


@dataclass(frozen=True)
class Finding:
    """One thing looked at. ``missing`` costs speed or comfort; ``failed`` means that commands will not work."""

    name: str
    state: State
    detail: str
    remedy: str = ""


def register(app: typer.Typer) -> None:
    """Add the command to ``app``."""

    @app.command("doctor")
    def doctor(context: typer.Context) -> None:
        """What works here, what does not, and what to do."""
        run: Run = context.obj
        findings = examine()
        failed = [finding.name for finding in findings if finding.state == "failed"]
        run.emit({"ok": not failed, "findings": [asdict(finding) for finding in findings]}, lambda _: show(findings))
        if failed and not run.json:
            raise CheckFailed(f"does not work: {', '.join(failed)}", remedy="see the table above")
        if failed:
            raise typer.Exit(CheckFailed.exit_code)


def examine() -> list[Finding]:
    """Look at everything; never raises."""
    probes: list[Callable[[], Finding]] = [
        _lfrig, _python, _cpu, _memory, _disk,
        lambda: _extension("native core", "lfrig.processing.kernels._native"),
        lambda: _extension("native renderer", "lfrig.sim._render"),
        lambda: _library("numpy", "numpy"),
        _opencv,
        lambda: _library("pycolmap", "pycolmap", remedy="without it only --poses given works"),
        lambda: _library("rawpy", "rawpy", remedy="without it photos as DNG, CR2, NEF, … cannot be read"),
        _ffmpeg, _browser, _devices,
    ]  # fmt: skip
    return [probe() for probe in probes]


def show(findings: list[Finding]) -> None:
    """Print the findings as a table."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for column in ("what", "state", "found", "what to do"):
        table.add_column(column)
    for finding in findings:
        table.add_row(finding.name, MARKS[finding.state], finding.detail, finding.remedy)
    text_console().print(table)


def _lfrig() -> Finding:
    return Finding("lfrig", "ok", f"{version()} in {Path(__file__).resolve().parents[2]}")


def _python() -> Finding:
    return Finding("python", "ok", f"{platform.python_version()} {sys.executable}")


def _cpu() -> Finding:
    flags = _cpu_flags()
    known = " ".join(flag for flag in CPU_FLAGS if flag in flags) or "features unknown"
    return Finding("cpu", "ok", f"{os.cpu_count()} cores, {platform.machine()}, {known}")


def _cpu_flags() -> set[str]:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return set()
    lines = [line for line in text.splitlines() if line.lower().startswith(("flags", "features"))]
    return set(lines[0].partition(":")[2].split()) if lines else set()


def _memory() -> Finding:
    try:
        total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    except (ValueError, OSError):
        return Finding("memory", "ok", "unknown")
    return Finding("memory", "ok", f"{total:.1f} GiB")


def _disk() -> Finding:
    free = shutil.disk_usage(Path.cwd()).free / 1e9
    if free < LOW_DISK_GB:
        return Finding("disk", "missing", f"{free:.1f} GB free here", "free some space before a capture")
    return Finding("disk", "ok", f"{free:.1f} GB free here")


def _extension(name: str, module: str) -> Finding:
    from lfrig.contracts.native import native_wanted

    if not native_wanted():
        return Finding(name, "missing", "switched off by LFRIG_NATIVE", "unset LFRIG_NATIVE")
    try:
        found = importlib.import_module(module)
    except ModuleNotFoundError:
        return Finding(
            name, "missing", "not built; the NumPy twins run, several times slower",
            "install a C++17 compiler, then install lfrig again",
        )  # fmt: skip
    except ImportError as error:
        return Finding(name, "failed", str(error), "install lfrig again")
    return Finding(name, "ok", str(getattr(found, "__file__", "")))


def _library(name: str, module: str, remedy: str = "install lfrig again") -> Finding:
    try:
        found = importlib.import_module(module)
    except Exception as error:
        return Finding(name, "failed", f"{type(error).__name__}: {error}", remedy)
    return Finding(name, "ok", str(getattr(found, "__version__", "")))


def _opencv() -> Finding:
    finding = _library("opencv", "cv2")
    if finding.state != "ok":
        return finding
    import cv2

    lacking = [name for name in ("ximgproc", "aruco") if not hasattr(cv2, name)]
    if lacking:
        remedy = "uninstall opencv-python, then reinstall opencv-contrib-python-headless"
        return Finding("opencv", "failed", f"{finding.detail} without {', '.join(lacking)}", remedy)
    return finding


def _ffmpeg() -> Finding:
    path = shutil.which("ffmpeg")
    if path is None:
        return Finding("ffmpeg", "missing", "not on PATH; WebM and GIF do not need it", "install ffmpeg for H.264")
    return Finding("ffmpeg", "ok", path)


def _browser() -> Finding:
    for name in BROWSERS:
        path = shutil.which(name)
        if path is not None:
            return Finding("browser", "ok", path)
    return Finding("browser", "missing", "none on PATH", "open report.html on a machine that has one")


def _devices() -> Finding:
    return Finding("rig devices", "missing", "real rigs are not in this version", "use --rig sim")
