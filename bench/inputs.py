"""The same scenes seen through worse eyes: clean views, views with noise, views decoded from raw files.

What a result loses from one to the next is the share of noise and of the decode. The photo is the same in all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

from lfrig.bench.accuracy_table import SCORES, SHIPPED, Bounds, Setup, bound_checks, means_and_worst
from lfrig.bench.cases import NEAR_DEG, Case, shoot_case
from lfrig.bench.document import Column, Table
from lfrig.contracts.bench import Check
from lfrig.contracts.progress import Monitor
from lfrig.processing.lenslet.decode import decode
from lfrig.processing.lenslet.raw import read_raw
from lfrig.processing.model import LightField
from lfrig.rig.session.convert import to_light_field
from lfrig.sim.cache import default_cache_dir
from lfrig.sim.plenoptic.camera import DECODED_NOISE_LEVELS, PlenopticCamera
from lfrig.sim.rig import SimulatedRig

Input = Literal["views", "noisy", "raw"]
INPUTS: tuple[Input, ...] = ("views", "noisy", "raw")
TITLES = {
    "views": "clean views",
    "noisy": f"views with noise of {DECODED_NOISE_LEVELS:g} grey levels",
    "raw": "decoded from raw files with sensor noise",
}
SETUPS = (Setup(2, "given"), Setup(2, "prior"))
BOUNDS: Bounds = (
    ("mse", 0.008, "<=", "twice that of clean views: noise and decode may cost as much again"),
    ("ppe_005", 75.0, ">=", "provisional: noise and decode move the median"),
    ("ppe_010", 90.0, ">=", "provisional: four points below clean views"),
)


def seen_sources(
    kind: Input,
    scene: str,
    size: tuple[int, int],
    angles_deg: Sequence[float] = NEAR_DEG,
    *,
    threads: int = 0,
    cache_dir: Path | None = None,
) -> list[LightField]:
    """The sources of a scene as ``kind`` says."""
    if kind == "raw":
        rig = SimulatedRig(scene, *size, threads=threads, cache_dir=cache_dir or default_cache_dir())
        return decoded_sources(rig, angles_deg, threads=threads)
    noise = DECODED_NOISE_LEVELS if kind == "noisy" else 0.0
    case = shoot_case(
        scene, size, angles_deg=angles_deg, noise_sigma=noise, truth_views=False, threads=threads, cache_dir=cache_dir
    )
    return case.sources


def with_views_of(case: Case, sources: Sequence[LightField]) -> Case:
    """The case with other pixels: poses and optics are known as well as before, the photo is the same."""
    pairs = zip(case.sources, sources, strict=True)
    return replace(case, sources=[replace(own, views=seen.views) for own, seen in pairs])


def decoded_sources(
    rig: SimulatedRig, angles_deg: Sequence[float], *, threads: int = 0, monitor: Monitor | None = None
) -> list[LightField]:
    """Shots of the plenoptic camera, written as raw files with their calibration, read back and decoded."""
    monitor, camera, sources = monitor or Monitor(), PlenopticCamera(rig), []
    with TemporaryDirectory(prefix="lfrig-") as name:
        calibration = Path(name) / f"{camera.calibration_name}.tar"
        with calibration.open("wb") as stream:
            camera.write_calibration(stream, len(angles_deg))
        for index, angle in enumerate(angles_deg):
            shot = camera.shoot(index, angle, truth_views=False)
            path = Path(name) / "capture.lfr"
            path.write_bytes(shot.raw)
            raw = read_raw(path, calibration=calibration, monitor=monitor)
            found = decode(raw, threads=threads, monitor=monitor)
            sources.append(to_light_field(f"{index:03d}", found.views, shot.document))
            del raw  # it maps the file that the next shot writes
    return sources


def clean_rows(scenes: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """What the benchmark's own runs say of the shipped preset on clean views."""
    names = {setup.name for setup in SETUPS}
    return [row | {"input": "views"} for row in scenes if row["stage"] == SHIPPED and row["setup"] in names]


def input_rows(scenes: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Means over the scenes per setup and input, the worst scene named, and what each input adds to the error."""
    rows = []
    for setup in SETUPS:
        before: float | None = None
        for kind in INPUTS:
            mine = [row for row in scenes if row["setup"] == setup.name and row["input"] == kind]
            row: dict[str, Any] = {
                "kind": "input", "setup": setup.name, "input": kind, "title": TITLES[kind], **means_and_worst(mine)
            }  # fmt: skip
            rows.append(row)
            if not row["scenes"]:
                continue
            row["mse_added"] = None if before is None else row["mse"] - before
            before = row["mse"]
    return rows


def input_checks(rows: Sequence[dict[str, Any]]) -> list[Check]:
    """The bounds that results from raw files keep."""
    checks = []
    for row in rows:
        if row["input"] != "raw" or "mse" not in row:
            continue
        checks += bound_checks(row, f"from raw, {row['setup']}", BOUNDS)
    return checks


COLUMNS = (
    Column("setup", "setup"), Column("title", "sources"), *SCORES, Column("mse_added", "MSE added", "+.5f"),
    Column("worst", "worst scene"), Column("worst_mse", "its MSE", ".5f"), Column("refused", "refused"),
)  # fmt: skip


SCENE_COLUMNS = (
    Column("scene", "scene"), Column("setup", "setup"), Column("input", "sources"), *SCORES,
    Column("pose_error_deg", "pose °", ".3f"), Column("refused", "refused"), Column("warnings", "warnings"),
)  # fmt: skip


def input_tables(rows: Sequence[dict[str, Any]], scenes: Sequence[dict[str, Any]]) -> list[Table]:
    """The means in the order of the inputs, and every scene; none when only clean views were run."""
    if not scenes:
        return []
    return [
        Table("From views to raw files: preset fast, means over the scenes", rows, COLUMNS),
        Table("From noisy views and raw files, scene by scene", scenes, SCENE_COLUMNS),
    ]
