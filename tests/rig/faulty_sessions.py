"""Simulated sessions with something wrong in them, and how far a result is from the truth."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from lfrig.bench.poses_scene import SceneShots
from lfrig.bench.poses_wall import painted, wall_texture
from lfrig.contracts.capture import CaptureDocument
from lfrig.processing.model import U8
from lfrig.rig.session.store import SessionStore
from lfrig.sim.optics import view_offsets
from lfrig.sim.rig import COLS, ROWS, SimulatedCapture, SimulatedRig
from lfrig.sim.shoot import SimulatedSession, shoot

SIZE = (135, 94)
ANGLES_DEG, PHOTO_DEG = (0.0, 15.0, 30.0), 20.0
PHOTO = "003"
BORDER_PX = 8


@functools.cache
def shot(scene: str = "tabletop") -> SimulatedSession:
    """Captures 000, 001, 002 at 15° and photo 003 among them, from a rig that knows its priors; shot once."""
    return shoot(scene, *SIZE, ANGLES_DEG, PHOTO_DEG, truth_views=False)


@functools.cache
def photo_of(scene: str, plate_deg: float) -> SimulatedCapture:
    """Another photo."""
    return SimulatedRig(scene, *SIZE).shoot_photo(0, plate_deg, truth_views=False)


def documents(session: SimulatedSession, **changes: Mapping[str, object]) -> dict[str, CaptureDocument]:
    """The captures' documents; fields of some replaced, by id (``c001={"turntable_deg": 3.0}``)."""
    known = {name: capture.document for name, capture in session.captures.items()}
    return {name: d.model_copy(update=dict(changes.get(f"c{name}", {}))) for name, d in known.items()}


def angles(session: SimulatedSession, said_deg: Mapping[str, float]) -> dict[str, CaptureDocument]:
    """The documents with other plate angles."""
    return documents(session, **{f"c{name}": {"turntable_deg": angle} for name, angle in said_deg.items()})


def write(
    folder: Path,
    session: SimulatedSession,
    said: Mapping[str, CaptureDocument] | None = None,
    pixels: Mapping[str, U8] | None = None,
) -> Path:
    """Store the session as the rig would, with other documents and pixels where given."""
    said, pixels = said or documents(session), pixels or {}
    store = SessionStore.create(folder, session.rig)
    for name in session.source_ids:
        store.add_light_field(pixels.get(name, session.captures[name].pixels), said[name])
    store.add_photo_array(pixels.get(session.target_id, session.target.pixels), said[session.target_id])
    return folder


def with_photo(session: SimulatedSession, photo: SimulatedCapture) -> SimulatedSession:
    """The session with another photo, and what is recorded of it."""
    return replace(session, captures={**session.captures, session.target_id: photo})


def still_wall(scene: str) -> dict[str, U8]:
    """Pixels of all captures before a textured wall that does not turn with the plate."""
    session, shots, texture = shot(scene), SceneShots(scene, SIZE), wall_texture(3)
    rig = shots.rig
    pixels = {
        name: painted(
            shots, session.captures[name].pixels, rig.light_field_camera(k, angle), view_offsets(ROWS, COLS),
            rig.true_angle_deg(angle), rig.exposure(k), texture,
        )
        for k, (name, angle) in enumerate(zip(session.source_ids, ANGLES_DEG, strict=True))
    }  # fmt: skip
    image = painted(
        shots, session.target.pixels[None, None], rig.target_camera(PHOTO_DEG), np.zeros((1, 2)),
        rig.true_angle_deg(PHOTO_DEG), rig.exposure(0, target=True), texture,
    )  # fmt: skip
    return pixels | {session.target_id: image[0, 0]}


def depth_error(result: Path, session: SimulatedSession) -> float:
    """Median relative error of depth after the best scale (a plain mount fixes it to a percent only)."""
    found = np.load(result / "inverse_depth.npy").astype(np.float64)
    ratio = (found * session.target.truth.depth_m)[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX]
    ratio = ratio[np.isfinite(ratio)]
    return float(np.median(np.abs(ratio / np.median(ratio) - 1)))
