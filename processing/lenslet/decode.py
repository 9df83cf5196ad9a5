"""Raw light field → views: lattice, levels, one interpolation from sensor to view."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.errors import BadInput, DiskError, UsageError
from lfrig.contracts.files import atomic_write_text
from lfrig.contracts.progress import Monitor, Notice
from lfrig.processing.kernels.lenslet import Colours, decode_views
from lfrig.processing.lenslet.colour import colour_matrix, srgb_lut
from lfrig.processing.lenslet.develop import (
    Modulation,
    at_peak,
    equalised,
    may_smooth,
    modulation_of,
    no_modulation,
    sensor_planes,
)
from lfrig.processing.lenslet.lattice import HexLattice, fit_lattice, fit_lattice_on_capture
from lfrig.processing.lenslet.metadata import RawMetadata
from lfrig.processing.lenslet.priors import camera_and_optics, view_size
from lfrig.processing.lenslet.raw import RawCapture
from lfrig.processing.lenslet.resample import lens_sampling
from lfrig.processing.model import F32, U8, Camera, LightField, Optics

Views = Literal[7, 14, 15]
VIEWS = (7, 14, 15)
LATTICE_SCHEMA = "lfrig.lattice/1"


@dataclass(frozen=True, eq=False)
class Decoded:
    """A decoded light field.

    ``views`` uint8 [n, n, H, W, 3] sRGB; ``weight`` uint8 [n, n, H, W], 255 = full modulation and nothing saturated;
    ``linear`` float32 [n, n, H, W, 3] linear sRGB with its highlights, where asked for; ``camera`` and ``optics`` from
    the metadata, of the view at ``centre`` (row = column); ``notices`` what was less than ideal.
    """

    views: U8
    weight: U8
    linear: F32 | None
    camera: Camera | None
    optics: Optics
    lattice: HexLattice
    centre: int
    notices: tuple[Notice, ...] = ()

    def light_field(self, name: str) -> LightField:
        """The nouns of the pipeline."""
        return LightField(name, self.views, self.camera, self.optics)


def decode(
    raw: RawCapture,
    *,
    views: Views = 7,
    linear: bool = False,
    lattice_cache: Path | None = None,
    threads: int = 0,
    monitor: Monitor | None = None,
) -> Decoded:
    """Decode a raw light field.

    Parameters
    ----------
    views : {7, 14, 15}
        7×7 views around the centre; 15×15; or 14×14 of those, steps −6…+7, so that the view at (6, 6) is the centre
        one, as in an ESLF picture.
    linear : bool
        Also the linear light, float32.
    lattice_cache : Path, optional
        Folder for fitted lattices, by white image and metadata; about 0.3 KB each.
    monitor : Monitor, optional
        Warned with code ``lattice-from-shot``, ``no-white-balance`` or ``cache-not-written``.

    Raises
    ------
    BadInput
        ``lattice-residual`` when no lens lattice is found; a white image that is black or of another size; levels
        that make no sense.
    UsageError
        More views than the lenses have pixels.
    """
    monitor = monitor or Monitor()
    known = len(monitor.notices)
    metadata = raw.metadata
    steps = view_steps(views)
    outermost = max(map(abs, steps))
    _refuse_too_many(views, outermost, metadata.lens_pitch_px)
    modulation = _modulation(raw, outermost)
    monitor.advance(0)
    lattice = _lattice(raw, modulation, lattice_cache, monitor)
    if raw.white is not None:
        modulation = at_peak(modulation, lattice)
    if metadata.white_balance is None:
        monitor.warn("no-white-balance", f"{raw.path}: no white balance is recorded; the white image's is used")
    planes = sensor_planes(raw.sensor, metadata, modulation, raw.hot_pixels)
    grid = [(r, c) for r in steps for c in steps]
    sampling = lens_sampling(lattice, raw.sensor.shape, view_size(metadata), grid, planes.colours)
    pixels, weight, light = decode_views(
        planes, sampling, Colours(colour_matrix(metadata), srgb_lut()), linear=linear, threads=threads, monitor=monitor
    )
    n, shape = len(steps), pixels.shape[1:3]
    camera, optics = camera_and_optics(_with_fitted_pitch(metadata, lattice))
    if camera is not None:
        camera = Camera.centred(shape[1], shape[0], camera.focal_px, camera.sigma_focal)
    return Decoded(
        pixels.reshape(n, n, *shape, 3), weight.reshape(n, n, *shape),
        None if light is None else light.reshape(n, n, *shape, 3), camera, optics, lattice, steps.index(0),
        tuple(monitor.notices[known:]),
    )  # fmt: skip


def view_steps(views: int) -> list[int]:
    """Offsets of the rows (and of the columns) of views from the centre view."""
    if views not in VIEWS:
        raise UsageError(f"{views}×{views} views", remedy=f"choose one of {', '.join(map(str, VIEWS))}")
    return list(range(-((views - 1) // 2), views // 2 + 1))


def _refuse_too_many(views: int, outermost: int, pitch_px: float) -> None:
    if outermost > pitch_px / 2:
        raise UsageError(
            f"{views}×{views} views: the lenses of this camera are {pitch_px:.2f} px wide", code="too-many-views",
            remedy="choose 7 views",
        )  # fmt: skip


def _modulation(raw: RawCapture, outermost: int) -> Modulation:
    shape = raw.sensor.shape
    if raw.white is None:
        return no_modulation((shape[0], shape[1]))
    if raw.white.sensor.shape != shape:
        raise BadInput(
            f"is {raw.white.sensor.shape[1]}×{raw.white.sensor.shape[0]} px, the shot {shape[1]}×{shape[0]}",
            path=raw.white.name, code="wrong-size", remedy="use this camera's calibration",
        )  # fmt: skip
    smooth = may_smooth(raw.metadata.lens_pitch_px, outermost)
    return modulation_of(raw.white.sensor, raw.white.metadata, raw.hot_pixels, smooth=smooth, name=raw.white.name)


def _lattice(raw: RawCapture, modulation: Modulation, cache: Path | None, monitor: Monitor) -> HexLattice:
    metadata = raw.metadata
    # Recorded clockwise as seen by one who looks into the camera: against the sense from x to y of the picture.
    start = metadata.lens_pitch_px, -metadata.mla_rotation_rad, metadata.mla_aspect
    if raw.white is None:
        monitor.warn("lattice-from-shot", f"{raw.path}: the lens lattice is fitted to the shot itself")
        return fit_lattice_on_capture(equalised(raw.sensor, metadata, raw.path)[0], *start)
    path = cache / f"lattice-{_lattice_key(raw.white.sha1, raw.white.sensor, start)}.json" if cache else None
    found = _cached_lattice(path) if path else None
    if found is None:
        found = fit_lattice(modulation.values, *start)
        if path:
            _keep_lattice(path, found, monitor)
    return found


def _keep_lattice(path: Path, lattice: HexLattice, monitor: Monitor) -> None:
    try:
        atomic_write_text(path, json.dumps({"schema": LATTICE_SCHEMA, **lattice.as_dict()}) + "\n")
    except DiskError as error:
        monitor.warn("cache-not-written", f"the lens lattice is not kept: {error.message}")


def _lattice_key(white_sha1: str, white: NDArray[np.uint16], start: tuple[float, float, float]) -> str:
    """Names what a fit depends on: the white image, its size, and where the fit starts."""
    text = json.dumps([LATTICE_SCHEMA, white_sha1, list(white.shape), [round(value, 9) for value in start]])
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _cached_lattice(path: Path) -> HexLattice | None:
    """None when it is not there, or damaged: it is fitted again."""
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        return HexLattice.from_dict(values) if values["schema"] == LATTICE_SCHEMA else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _with_fitted_pitch(metadata: RawMetadata, lattice: HexLattice) -> RawMetadata:
    """The metadata with the pitch that the lenses have: the view pixel is that wide."""
    scale = lattice.pitch_px / metadata.lens_pitch_px
    return replace(metadata, mla_scale=(metadata.mla_scale[0] * scale, metadata.mla_scale[1] * scale))
