"""The defined scene as the decoder gets it: in memory, or as a file and a calibration archive on disk."""

from __future__ import annotations

import tempfile
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from lfrig.bench.decode_scene import U16, SensorModel
from lfrig.bench.measure import stopwatch
from lfrig.contracts.lytro import ILLUM, BayerPattern
from lfrig.processing.lenslet.calibration import WhiteImage
from lfrig.processing.lenslet.metadata import RawMetadata
from lfrig.processing.lenslet.raw import RawCapture

PIXEL_M = 1.4e-6
SHOT, CALIBRATION = "shot.lfr", "caldata.tar"
FOCAL_M, F_NUMBER, INFINITY_LAMBDA = 0.02, 2.0, 10.0


def metadata_of(sensor: SensorModel) -> RawMetadata:
    """What a file of this sensor would say."""
    red, green, blue = sensor.response
    level = (float(sensor.black),) * 4, (float(sensor.white),) * 4
    return RawMetadata(
        "ILLUM", sensor.width, sensor.height, 10, "little", cast(BayerPattern, sensor.colours), *level, PIXEL_M,
        sensor.pitch * PIXEL_M, (1.0, sensor.vertical), -sensor.rotation,
        white_balance=(green / red, 1.0, 1.0, green / blue), focal_length_m=FOCAL_M, f_number=F_NUMBER,
        infinity_lambda=INFINITY_LAMBDA,
    )  # fmt: skip


def capture_of(sensor: SensorModel, values: U16, white: U16) -> RawCapture:
    """Shot and white image as `read_raw` gives them."""
    metadata = metadata_of(sensor)
    image = WhiteImage(white, "0" * 40, metadata, "white")
    return RawCapture(Path(SHOT), metadata, values, image, "exact", np.empty((0, 2), np.int32))


def write_files(folder: Path, sensor: SensorModel, values: U16, white: U16) -> None:
    """SHOT and CALIBRATION of an Illum with this sensor, as the simulated camera writes them."""
    from lfrig.sim.plenoptic.body import Body
    from lfrig.sim.plenoptic.files import WhiteShot, reference, shot_file, write_calibration
    from lfrig.sim.plenoptic.lattice import Lattice
    from lfrig.sim.plenoptic.metadata import LensSetting, shot_metadata, white_metadata

    figures = replace(ILLUM, width=sensor.width, height=sensor.height, lens_pitch_m=sensor.pitch * PIXEL_M)
    none = np.empty((0, 2), np.int32), np.empty(0, np.float32)
    body = Body("ILLUM", "B5140000000", figures, sensor.rotation, sensor.vertical, sensor.origin, *none)
    lattice = Lattice(sensor.pitch, sensor.rotation, sensor.origin, sensor.vertical)
    lens = LensSetting(FOCAL_M, F_NUMBER, INFINITY_LAMBDA, 600, 900)
    red, green, blue = sensor.response
    metadata = shot_metadata(
        body, lattice, lens, gains=(green / red, 1.0, green / blue), exposure_s=0.01, iso=80.0,
        time="2026-01-01T12:00:00.000Z", gravity=(0.0, 1.0, 0.0),
    )  # fmt: skip
    geometry = b"geometry"
    (folder / SHOT).write_bytes(shot_file(body, values, metadata, geometry_ref=reference(geometry)))
    with (folder / CALIBRATION).open("wb") as stream:
        write_calibration(stream, body, [WhiteShot(white, white_metadata(body, lattice, lens), geometry)])


def measure_decode(folder: Path, threads: int) -> dict[str, dict[str, Any]]:
    """What a process of its own runs: read and decode twice, with the lattice to be fitted and known. Cost by stage."""
    from lfrig.processing.lenslet.decode import decode
    from lfrig.processing.lenslet.raw import read_raw

    with stopwatch() as reading:
        raw = read_raw(folder / SHOT, calibration=folder / CALIBRATION)
    with tempfile.TemporaryDirectory() as cache:
        with stopwatch() as first:
            decode(raw, lattice_cache=Path(cache), threads=threads)
        with stopwatch() as again:
            decode(raw, lattice_cache=Path(cache), threads=threads)
    assert reading.cost and first.cost and again.cost
    views, fitted = asdict(again.cost), asdict(first.cost)
    lattice = {name: fitted[name] - views[name] for name in ("wall_s", "cpu_s")}
    keep = ("wall_s", "cpu_s")
    read = asdict(reading.cost)
    return {"read": {k: read[k] for k in keep}, "lattice": lattice, "views": {k: views[k] for k in keep}}
