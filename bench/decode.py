"""What the decode of raw light fields costs and loses: views against analytic ones, lattice, disparity, CPU and memory.

The scene is defined in `decode_scene`: a plane textured with noise blurred to σ 2.5 view px, 4000 + 3 electrons of
noise, 10 bits, Bayer, white image as noisy. Only the geometry and radiometry of docs/lenslet.md are shared with it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lfrig.bench.decode_files import capture_of, measure_decode, write_files
from lfrig.bench.decode_scene import PlaneScene, SensorModel, shoot, true_view
from lfrig.bench.document import Column, Table, write
from lfrig.bench.measure import in_fresh_process, stopwatch
from lfrig.contracts.bench import BenchDocument, Check
from lfrig.contracts.errors import UsageError
from lfrig.contracts.progress import Monitor, Muted
from lfrig.processing.dpv import light_field_evidence
from lfrig.processing.export.png import write_png
from lfrig.processing.lenslet.decode import Decoded, decode
from lfrig.processing.lenslet.lattice import HexLattice
from lfrig.processing.model import F32, U8

SIZES = {"tiny": (420, 320), "crop": (1500, 1100), "full": (7728, 5368)}
"""Sensor width and height [px]; the full one is an Illum's."""
PITCHES = {"Illum": 20 / 1.4, "F01": 10.004, "small": 9.15}
BOUNDED = "Illum"
DISPARITIES = (-0.8, -0.35, 0.0, 0.4, 0.9)
LATTICE_SEEDS = (0, 1, 2)
BORDER_PX = 8
"""Views are not judged nearer to their border: there the lenses end."""
PICTURE = "decode_views.png"


def run(
    out: Path,
    *,
    monitor: Monitor | None = None,
    threads: int = 0,
    size: str = "crop",
    pitches: Sequence[str] | None = None,
) -> BenchDocument:
    """Run the benchmark; writes decode.json, decode.md and a picture into ``out``.

    Parameters
    ----------
    size : {"crop", "full", "tiny"}
        How much of the Illum's sensor there is. The bounds on pitch, time and memory are those of the full one: a
        small sensor has fewer lenses, and its shading is steeper.
    pitches : sequence of str, optional
        Of `PITCHES`; all by default.

    Raises
    ------
    UsageError
        No such size.
    """
    if size not in SIZES:
        raise UsageError(f"--size: unknown {size!r}", remedy=f"choose one of {', '.join(SIZES)}")
    monitor = monitor or Monitor()
    names = list(pitches or PITCHES)
    rows: list[dict[str, Any]] = []
    with monitor.task("bench decode", 2 * len(names) + len(LATTICE_SEEDS) + len(DISPARITIES) + 1):
        for name in names:
            for noise in (True, False):
                rows.append(quality(name, SIZES[size if name == BOUNDED else "crop"], noise, threads, monitor, out))
        rows += [lattice_error(SIZES[size], seed, monitor) for seed in LATTICE_SEEDS]
        small = SIZES["tiny" if size == "tiny" else "crop"]
        rows += [disparity_error(small, delta, threads, monitor) for delta in DISPARITIES]
        rows += cost(SIZES[size], threads, monitor)
    return write(
        out, "decode", rows=rows, checks=acceptance(rows, full=size == "full"), tables=tables(rows), text=_text(size),
        pictures=[PICTURE],
    )  # fmt: skip


def quality(name: str, size: tuple[int, int], noise: bool, threads: int, monitor: Monitor, out: Path) -> dict[str, Any]:
    """PSNR of decoded views against the analytic ones, on a slanted plane of disparity −1 to 1."""
    sensor = SensorModel(*size, pitch=PITCHES[name])
    scene = slanted(sensor)
    found = decoded(sensor, scene, noise=noise, threads=threads, monitor=monitor)
    values = {(r, c): psnr(found.views[r, c], true_view(sensor, scene, c - 3, r - 3)) for r, c in np.ndindex(7, 7)}
    if name == BOUNDED and noise:
        out.mkdir(parents=True, exist_ok=True)
        write_png(out / PICTURE, picture(found.views, sensor, scene))
    monitor.advance()
    return {
        "kind": "quality", "sensor": name, "pitch_px": sensor.pitch, "noise": noise, "psnr_centre": values[3, 3],
        "psnr_corner": values[0, 0], "psnr_mean": float(np.mean(list(values.values()))),
        "psnr_worst": min(values.values()),
    }  # fmt: skip


def slanted(sensor: SensorModel) -> PlaneScene:
    """The plane whose disparity runs from −1 at the left to 1 at the right."""
    width = sensor.view_size[0]
    return PlaneScene(sensor.view_size, (-1.0, 2.0 / (width - 1), 0.0))


def decoded(
    sensor: SensorModel, scene: PlaneScene, *, noise: bool, threads: int, monitor: Monitor, seed: int = 1
) -> Decoded:
    """The scene, shot and decoded."""
    values, white = shoot(sensor, scene, seed, noise=noise), shoot(sensor, None, seed + 100, noise=noise)
    monitor.advance(0)
    return decode(capture_of(sensor, values, white), threads=threads, monitor=Muted(monitor))


def psnr(view: U8, truth: F32) -> float:
    """PSNR [dB] of an 8-bit view against sRGB-encoded values 0..1, without the border."""
    inner = np.s_[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX]
    error = view[inner].astype(np.float64) / 255 - truth[inner]
    return float(-10 * np.log10(np.mean(error**2)))


def lattice_error(size: tuple[int, int], seed: int, monitor: Monitor) -> dict[str, Any]:
    """The lattice that the decoder finds in a noisy white image, against the true one."""
    rng = np.random.default_rng(seed)
    sensor = SensorModel(
        *size, pitch=PITCHES[BOUNDED] * (1 + rng.uniform(-1e-3, 1e-3)), rotation=rng.uniform(-2.5e-3, 2.5e-3),
        origin=(float(rng.uniform(0, 14)), float(rng.uniform(0, 14))), vertical=1 + rng.uniform(-3e-4, 3e-4),
    )  # fmt: skip
    white = shoot(sensor, None, seed, subpixels=2)
    monitor.advance(0)
    told = replace(sensor, pitch=PITCHES[BOUNDED], rotation=0.0, vertical=1.0)  # what the metadata would say
    with stopwatch() as watch:
        found = decode(capture_of(told, white, white), monitor=Muted(monitor)).lattice
    monitor.advance()
    assert watch.cost is not None
    return {
        "kind": "lattice", "seed": seed, "rms_px": rms_miss(sensor, found),
        "pitch_error_px": abs(found.pitch_px - sensor.pitch), "residual_rms_px": found.residual_rms_px,
        "lenses": found.lenses,
    }  # fmt: skip


def rms_miss(sensor: SensorModel, found: HexLattice) -> float:
    """RMS distance of the found lens centres on the sensor from the true ones [px]."""
    reach = int(max(sensor.width, sensor.height) / sensor.pitch) + 2
    steps = np.arange(-reach, reach + 1)
    x, y = np.moveaxis(found.centres(steps[None], steps[:, None]), -1, 0)
    on = (x >= 0) & (x < sensor.width) & (y >= 0) & (y < sensor.height)
    _, _, du, dv = sensor.lens_of(x[on], y[on])
    return float(np.sqrt(np.mean(du**2 + dv**2)))


def disparity_error(size: tuple[int, int], delta: float, threads: int, monitor: Monitor) -> dict[str, Any]:
    """Median signed error of the disparity that `processing.dpv` finds in decoded views, and in the true ones."""
    sensor = SensorModel(*size)
    scene = PlaneScene(sensor.view_size, (delta, 0.0, 0.0))
    found = decoded(sensor, scene, noise=True, threads=threads, monitor=monitor)
    truth = np.stack([np.stack([true_view(sensor, scene, c - 3, r - 3) for c in range(7)]) for r in range(7)])
    exact = replace(found, views=np.rint(255 * truth).astype(np.uint8))
    errors = []
    for field in (found, exact):
        evidence = light_field_evidence(
            field.light_field("plane"), (-1.3, 1.3), threads=threads, monitor=Muted(monitor)
        )
        inner = evidence.disparity[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] - delta
        errors.append((float(np.median(inner)), float(np.sqrt(np.mean(inner**2)))))
    monitor.advance()
    return {
        "kind": "disparity", "disparity_px": delta, "bias_px": errors[0][0], "rmse_px": errors[0][1],
        "bias_true_views_px": errors[1][0], "rmse_true_views_px": errors[1][1],
    }  # fmt: skip


def cost(size: tuple[int, int], threads: int, monitor: Monitor) -> list[dict[str, Any]]:
    """CPU and memory of a file on disk, by stage, in a process of its own."""
    sensor = SensorModel(*size)
    flat = PlaneScene(sensor.view_size)
    with tempfile.TemporaryDirectory() as folder:
        write_files(Path(folder), sensor, shoot(sensor, flat, 1, subpixels=1), shoot(sensor, None, 2, subpixels=1))
        monitor.advance(0)
        stages, whole = in_fresh_process(measure_decode, Path(folder), threads, monitor=monitor)
    monitor.advance()
    rows = [{"kind": "cost", "stage": stage, **figures} for stage, figures in stages.items()]
    return [*rows, {"kind": "cost", "stage": PEAK, "peak_rss_mb": whole.peak_rss_mb}]


PEAK = "all of it"
FILE_STAGES = ("read", "views")
LATTICE_STAGE = "lattice"


def acceptance(rows: Sequence[dict[str, Any]], *, full: bool) -> list[Check]:
    """The bounds; those that only the full sensor can be held to when it was decoded."""
    checks = []
    for row in rows:
        if row["kind"] == "quality" and row["sensor"] == BOUNDED and row["noise"]:
            why = "the noise of one lens is 40 dB; what the decode adds must not be seen beside it"
            checks.append(Check.of("PSNR of the centre view [dB]", row["psnr_centre"], ">=", 43.0, why))
            checks.append(Check.of("PSNR of view (0, 0) [dB]", row["psnr_corner"], ">=", 41.0, why))
        elif row["kind"] == "disparity":
            name = f"disparity bias at {row['disparity_px']:+.2f} [px]"
            checks.append(Check.of(name, abs(row["bias_px"]), "<=", 0.01, "a tenth of what depth is judged by"))
    lattices = [row for row in rows if row["kind"] == "lattice"]
    worst = max(row["rms_px"] for row in lattices)
    checks.append(Check.of("lattice RMS [px]", worst, "<=", 0.05, "less than the aperture moves between views"))
    if full:
        worst = max(row["pitch_error_px"] for row in lattices)
        checks.append(Check.of("pitch error [px]", worst, "<=", 5e-5, "0.014 px from the middle to the border"))
        checks += _cost_checks({row["stage"]: row for row in rows if row["kind"] == "cost"})
    return checks


def _cost_checks(stages: dict[str, dict[str, Any]]) -> list[Check]:
    seconds = sum(stages[name]["cpu_s"] for name in FILE_STAGES)
    return [
        Check.of("file to 7×7 views [CPU s]", seconds, "<=", 3.0, "an operator waits for it"),
        Check.of("lattice [CPU s]", stages[LATTICE_STAGE]["cpu_s"], "<=", 2.0, "once per white image"),
        Check.of("peak memory [MiB]", stages[PEAK]["peak_rss_mb"], "<=", 700.0, "several run side by side"),
    ]


def picture(views: U8, sensor: SensorModel, scene: PlaneScene) -> U8:
    """Centre view and view (0, 0): decoded, true, and 16 times their difference; uint8 [H, W, 3]."""
    lines = []
    for r, c in ((3, 3), (0, 0)):
        truth = true_view(sensor, scene, c - 3, r - 3)
        difference = 128 + 16 * (views[r, c].astype(np.float64) - 255 * truth)
        lines.append(np.hstack([views[r, c], 255 * truth, np.clip(difference, 0, 255)]))
    return np.asarray(np.rint(np.vstack(lines)), np.uint8)


def tables(rows: Sequence[dict[str, Any]]) -> list[Table]:
    """One table per kind of row."""
    columns = {
        "quality": ("Views against analytic views, PSNR [dB]", (
            Column("sensor", "sensor"), Column("pitch_px", "pitch px", ".3f"), Column("noise", "noise"),
            Column("psnr_centre", "centre", ".2f"), Column("psnr_corner", "(0, 0)", ".2f"),
            Column("psnr_mean", "mean of 49", ".2f"), Column("psnr_worst", "worst", ".2f"),
        )),
        "lattice": ("Lattice of noisy white images", (
            Column("seed", "seed"), Column("rms_px", "RMS px", ".5f"),
            Column("pitch_error_px", "pitch error px", ".2e"), Column("residual_rms_px", "residual px", ".4f"),
            Column("lenses", "lenses"),
        )),
        "disparity": ("Disparity of decoded planes", (
            Column("disparity_px", "true px", "+.2f"), Column("bias_px", "median error px", "+.5f"),
            Column("rmse_px", "RMSE px", ".4f"), Column("bias_true_views_px", "of true views", "+.5f"),
            Column("rmse_true_views_px", "RMSE of true views", ".4f"),
        )),
        "cost": ("Cost of one file", (
            Column("stage", "stage"), Column("cpu_s", "CPU s", ".2f"), Column("wall_s", "wall s", ".2f"),
            Column("peak_rss_mb", "peak MiB", ".0f"),
        )),
    }  # fmt: skip
    return [Table(title, [row for row in rows if row["kind"] == kind], c) for kind, (title, c) in columns.items()]


def _text(size: str) -> str:
    width, height = SIZES[size]
    return (
        f"A plane textured with noise blurred to σ 2.5 view px (sRGB values, standard deviation 0.16), disparity −1 to "
        f"1 px across the view, {width}×{height} sensor px at Illum pitch and 1500×1100 at the others; 4000 electrons "
        "at the white level, 3 of read noise, 10 bits, Bayer, and a white image with the same noise. PSNR on sRGB "
        f"values against exact views of a point aperture, {BORDER_PX} px at the border left out. Lattices have random "
        "pitch, rotation, origin and aspect; metadata say the nominal ones. CPU s of a file on disk, in a process of "
        "its own: reading shot and white image, fitting the lattice once per white image, and the views."
    )
