"""The light-field camera of the simulated rig as a plenoptic one: it leaves raw files and has a calibration."""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from lfrig.contracts.capture import CaptureDocument, RawSpec
from lfrig.contracts.progress import Monitor
from lfrig.sim.optics import SimCamera
from lfrig.sim.plenoptic import render
from lfrig.sim.plenoptic.body import Body, Model, make_body
from lfrig.sim.plenoptic.files import WhiteShot, reference, shot_file, write_calibration
from lfrig.sim.plenoptic.lattice import Lattice
from lfrig.sim.plenoptic.metadata import LensSetting, lens_setting, shot_metadata, white_metadata
from lfrig.sim.plenoptic.sensor import exposed, modulation, read_out, recorded_gains, white_signal
from lfrig.sim.scene import F32

if TYPE_CHECKING:
    from lfrig.sim.rig import CaptureTruth, SimulatedRig

SAMPLES = 4
TRUE_VIEWS = 49
DECODED_NOISE_LEVELS = 2.0
"""About what the sensor's noise is in a decoded view [grey levels]; truth.json says it."""
RAW_FILE = "capture.lfr"
NEIGHBOUR = "neighbour"
"""A zoom and focus that no shot has: its white image is in the archive so that choosing one means something."""


@dataclass(frozen=True, eq=False)
class RawShot:
    """One shot: the file's bytes, what is recorded of it, what really was; ``lattice`` is where the lenses were."""

    raw: bytes
    document: CaptureDocument
    truth: CaptureTruth
    lattice: Lattice


class PlenopticCamera:
    """The rig's light-field camera.

    Parameters
    ----------
    rig : SimulatedRig
        Optics, exposures, scene and seed; the views have its size. Shots are those of its ``shoot_light_field``.
    model : {"ILLUM", "F01"}
        Whose sensor and files. The real sensor has 541×376 views, the F01's 328×328; other sizes have a smaller sensor.
    noise : bool
        False is a sensor without noise and hot pixels.
    embed_white : bool
        Put the white image into each shot too.
    """

    def __init__(
        self, rig: SimulatedRig, *, model: Model = "ILLUM", noise: bool = True, embed_white: bool = False
    ) -> None:
        self.rig, self.noise, self.embed_white = rig, noise, embed_white
        specimen = rig.random("body", model, rig.width, rig.height)
        self.body: Body = make_body(model, rig.width, rig.height, rig.view_pixel_m, specimen)

    @property
    def steps(self) -> int:
        """How often `shoot` advances the monitor when nothing is cached and the true views are wanted."""
        return -(-self.body.shape[0] // render.ROWS_AT_ONCE) + TRUE_VIEWS

    @property
    def calibration_name(self) -> str:
        """Of the archive, without its ``.tar``."""
        return f"caldata-{self.body.serial}"

    def lattice(self, index: int | str) -> Lattice:
        """Where the lenses are imaged at a shot's zoom and focus."""
        return self.body.lattice(self.rig.random("lattice", self.body.model, index))

    def shoot(
        self, index: int, commanded_deg: float, monitor: Monitor | None = None, *, truth_views: bool = True
    ) -> RawShot:
        """The ``index``-th shot, with the plate commanded to ``commanded_deg``.

        ``truth_views`` False spares the true views. The file's metadata say the same of the optics as the document.
        """
        lattice, exposure = self.lattice(index), self.rig.exposure(index)
        radiance = self.radiance(index, commanded_deg, monitor)
        transmitted = modulation(lattice, self.body.shape)
        values = read_out(exposed(radiance, transmitted, self.body, exposure), self.body, self._noise("shot", index))
        white = self._white(index).values if self.embed_white else None
        spec = RawSpec(path=RAW_FILE, calibration=self.calibration_name)
        known = self.rig.light_field_document(index, commanded_deg, raw=spec)
        metadata = shot_metadata(
            self.body, lattice, self._recorded_lens(index, known), gains=recorded_gains(self.body, exposure),
            exposure_s=_seconds(known), iso=100.0, time=f"2026-01-01T12:{index:02d}:00.000Z",
            gravity=self._gravity(index, commanded_deg),
        )  # fmt: skip
        raw = shot_file(self.body, values, metadata, geometry_ref=reference(self._geometry(index)), white=white)
        spec = spec.model_copy(update={"sha256": hashlib.sha256(raw).hexdigest()})
        document = known.model_copy(update={"raw": spec})
        noise = DECODED_NOISE_LEVELS if self.noise else 0.0
        truth = self.rig.light_field_truth(index, commanded_deg, monitor, views=truth_views, noise_sigma=noise)
        return RawShot(raw, document, truth, lattice)

    def radiance(self, index: int, commanded_deg: float, monitor: Monitor | None = None) -> F32:
        """Linear radiance of each pixel's own colour at a shot, float32 [Hs, Ws], without vignetting."""
        camera, lattice = self.rig.light_field_camera(index, commanded_deg), self.lattice(index)
        seed = zlib.crc32(repr((self.rig.seed, "lenslets", index)).encode())

        def make() -> F32:
            return render.render_lenslets(
                self.rig.packed(), camera, lattice, self.body.colours, self.body.shape, samples=SAMPLES, seed=seed,
                threads=self.rig.threads, on_band=None if monitor is None else monitor.advance,
            )  # fmt: skip

        key = ("lenslets", render.VERSION, *_optics_key(camera, lattice), self.body.shape, self.body.figures.bayer)
        return np.asarray(self.rig.rendered((*key, SAMPLES, seed), make), np.float32)

    def write_calibration(self, stream: BinaryIO, shots: int) -> None:
        """The archive with the white images of the first ``shots`` shots and of one zoom and focus beside."""
        write_calibration(stream, self.body, (self._white(index) for index in [*range(shots), NEIGHBOUR]))

    def _white(self, index: int | str) -> WhiteShot:
        lattice = self.lattice(index)
        signal = white_signal(modulation(lattice, self.body.shape), self.body)
        values = read_out(signal, self.body, self._noise("white", index))
        return WhiteShot(values, white_metadata(self.body, lattice, self._true_lens(index)), self._geometry(index))

    def _noise(self, *what: object) -> np.random.Generator | None:
        return self.rig.random("sensor", self.body.model, *what) if self.noise else None

    def _geometry(self, index: int | str) -> bytes:
        """Geometry correction of a zoom and focus: by its hash a shot names its white image."""
        zoom_step, focus_step = self._steps(index)
        known = {"serialNumber": self.body.serial, "zoomStep": zoom_step, "focusStep": focus_step}
        return json.dumps(known).encode()

    def _steps(self, index: int | str) -> tuple[int, int]:
        zoom_mm, focus_m = self.rig.lens(index)
        return round(100 * zoom_mm), round(1000 * focus_m)

    def _recorded_lens(self, index: int, known: CaptureDocument) -> LensSetting:
        camera, optics = known.camera, known.optics
        assert camera is not None
        assert optics is not None
        assert camera.fx is not None
        assert optics.baseline_m is not None
        assert optics.focus_distance_m is not None
        return lens_setting(
            camera.fx, optics.baseline_m, optics.focus_distance_m, self.body, self.lattice(index), self._steps(index)
        )

    def _true_lens(self, index: int | str) -> LensSetting:
        camera = self.rig.light_field_camera(index, 0.0)
        return lens_setting(
            camera.focal_px, camera.baseline_m, camera.focus_m, self.body, self.lattice(index), self._steps(index)
        )

    def _gravity(self, index: int, commanded_deg: float) -> Sequence[float]:
        """Which way is down, as the accelerometer would say to a hundredth of g."""
        down = -self.rig.light_field_camera(index, commanded_deg).rotation[:, 2]
        noise = self.rig.random("accelerometer", index).standard_normal(3)
        return [float(v) for v in down + 0.01 * noise]


def _seconds(known: CaptureDocument) -> float:
    assert known.exposure is not None
    assert known.exposure.time_s is not None
    return known.exposure.time_s


def _optics_key(camera: SimCamera, lattice: Lattice) -> tuple[object, ...]:
    return camera.record().tobytes(), camera.width, camera.height, lattice.record().tobytes()
