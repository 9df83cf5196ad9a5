"""Real work for every kernel: the pipeline on a tuning scene, the decode of a raw file, the fields of the 49 views."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from lfrig.bench.cases import NEAR_DEG, Case, shoot_case
from lfrig.bench.decode_files import CALIBRATION, SHOT, write_files
from lfrig.bench.decode_scene import PlaneScene, SensorModel, shoot
from lfrig.bench.kernels_registry import Kernel
from lfrig.bench.kernels_replay import Call, recording
from lfrig.contracts.progress import Monitor, Muted
from lfrig.processing.lenslet.decode import decode
from lfrig.processing.lenslet.raw import read_raw
from lfrig.processing.model import LightFieldRequest
from lfrig.processing.options import PRESETS, ProcessOptions
from lfrig.processing.pipeline import ProcessResult, process
from lfrig.processing.skipping import Skips
from lfrig.processing.synthesis.field import view_field, view_offsets
from lfrig.processing.synthesis.settings import DEFAULT_SYNTHESIS

SCENE = "tabletop"
DECODED = ("lenslet", "unpack")
"""Files of kernels that run on raw sensor values."""


def record_calls(
    kernels: Sequence[Kernel],
    size: tuple[int, int],
    folder: Path,
    *,
    threads: int = 0,
    cache_dir: Path | None = None,
    monitor: Monitor | None = None,
) -> None:
    """Keep a call of every kernel as ``folder/<name>.pkl``; a kernel that the pipeline did not call has none."""
    monitor = monitor or Monitor()
    spots = [kernel.spot for kernel in kernels if kernel.source not in DECODED]
    if spots:
        case = shoot_case(
            SCENE, size, poses="prior", angles_deg=NEAR_DEG, truth_views=False, threads=threads, cache_dir=cache_dir,
            monitor=Muted(monitor),
        )  # fmt: skip
        with recording(spots, folder):
            # As shipped first: of equally large calls the first is kept. Without skipping for what it leaves out.
            result, _ = (
                process(case.sources, case.target, case.prior, _options(case, skips, threads), Muted(monitor))
                for skips in (Skips(), Skips.nothing())
            )
        if any(kernel.name == "warp" for kernel in kernels):
            warp_call(result).save(folder / "warp.pkl")
    monitor.advance(0)
    raw = [kernel.spot for kernel in kernels if kernel.source in DECODED]
    if raw:
        with tempfile.TemporaryDirectory(prefix="lfrig-") as name, recording(raw, folder):
            decode_capture(size, Path(name), threads, monitor)


def _options(case: Case, skips: Skips, threads: int) -> ProcessOptions:
    return case.options(settings=replace(PRESETS["fast"].settings, skips=skips), threads=threads)


def warp_call(result: ProcessResult) -> Call:
    """The photo and the fields of all views but its own, as one call."""
    disparity, request = result.light_field.disparity, result.light_field.request
    offsets = [offset for offset in _offsets(request) if offset != (0.0, 0.0)]
    fields = np.stack([view_field(disparity, *offset, "z_buffer", DEFAULT_SYNTHESIS)[0] for offset in offsets])
    return Call((result.target.image8, fields.astype(np.float32), np.array(offsets, np.float32)), {})


def _offsets(request: LightFieldRequest) -> list[tuple[float, float]]:
    return [(float(dr), float(dc)) for dr, dc in view_offsets(request.rows, request.cols)]


def decode_capture(size: tuple[int, int], folder: Path, threads: int, monitor: Monitor) -> None:
    """Write a raw file whose views have about ``size``, read and decode it."""
    pitch = SensorModel(1, 1).pitch
    # The Bayer cell and the packing want even numbers and multiples of four.
    width, height = (4 * round(pitch * side / 4) for side in size)
    sensor = SensorModel(width, height)
    flat = PlaneScene(sensor.view_size)
    write_files(folder, sensor, shoot(sensor, flat, 1, subpixels=1), shoot(sensor, None, 2, subpixels=1))
    decode(
        read_raw(folder / SHOT, calibration=folder / CALIBRATION, monitor=Muted(monitor)), threads=threads,
        monitor=Muted(monitor),
    )  # fmt: skip
