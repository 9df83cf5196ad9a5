"""``lfrig capture --rig sim``: a session from the simulated rig, and what really was beside it."""

from __future__ import annotations

import tarfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lfrig.contracts.capture import ViewsSpec
from lfrig.contracts.errors import BadInput, UsageError
from lfrig.contracts.files import CALIBRATION, atomic_folder, atomic_writer
from lfrig.contracts.progress import Monitor
from lfrig.contracts.truth import TruthDocument
from lfrig.rig.controller import Devices, run_plan
from lfrig.rig.plan import CapturePlan
from lfrig.rig.session.store import SessionStore
from lfrig.rig.session.views import write_views

if TYPE_CHECKING:
    from lfrig.drivers.protocols import Frame
    from lfrig.sim.devices import Record
    from lfrig.sim.plenoptic.camera import PlenopticCamera
    from lfrig.sim.rig import CaptureTruth, Poses

SIZES = {"tiny": (96, 64), "small": (135, 94), "medium": (270, 188), "full": (541, 376)}
"""Width and height of a light-field view [px]."""
DEFAULT_RECORD: Record = "raw"
TRUTH_FILE = "truth.json"


def capture_simulated(
    session_path: Path | str,
    *,
    scene: str,
    size: str | tuple[int, int],
    angles_deg: Sequence[float],
    target_deg: float | None,
    seed: int = 0,
    noise_sigma: float = 0.0,
    poses: Poses = "prior",
    record: Record | None = None,
    threads: int = 0,
    monitor: Monitor | None = None,
    cache_dir: Path | None = None,
) -> SessionStore:
    """Shoot a simulated scene into a session, and its truth into SESSION.truth.

    Parameters
    ----------
    size : str or (int, int)
        A name of `SIZES`, or width and height of a light-field view; the photo is about as wide, 3:2.
    angles_deg, target_deg
        As in `CapturePlan`; None = no photo.
    record : {"views", "raw"}, optional
        Whether light fields are stored as views or as raw files, these with the camera's calibration;
        `DEFAULT_RECORD` when None.
    noise_sigma, poses, cache_dir
        As in `lfrig.sim.rig.SimulatedRig`. Raw files have the noise of their sensor instead.

    Raises
    ------
    BadInput
        No such scene; the session is of another scene, seed or rig, or not the simulator's.
    UsageError
        No such size.
    DiskError, Interrupted
        Captures that were whole by then are kept, with their truth.
    """
    from lfrig.sim.devices import SimulatedLightFieldCamera, SimulatedTargetCamera, SimulatedTurntable
    from lfrig.sim.plenoptic.camera import PlenopticCamera
    from lfrig.sim.rig import SimulatedRig

    monitor = monitor or Monitor()
    width, height = _size(size)
    plan = CapturePlan(angles_deg=tuple(angles_deg), target_deg=target_deg, settle_s=0)
    rig = SimulatedRig(
        scene, width, height, seed=seed, noise_sigma=noise_sigma, poses=poses, threads=threads, cache_dir=cache_dir
    )
    truth = _open_truth(Path(session_path), scene, seed)
    store = SessionStore.create(session_path, rig.rig_spec())
    turntable = SimulatedTurntable()
    record = record or DEFAULT_RECORD
    if record == "raw":
        _write_calibration(store.path / CALIBRATION, PlenopticCamera(rig), len(plan.angles_deg))
    cameras = {
        "light_field": SimulatedLightFieldCamera(rig, turntable, monitor, record=record),
        "photo": SimulatedTargetCamera(rig, turntable, monitor),
    }

    def keep_truth(capture_id: str, frame: Frame) -> None:
        nonlocal truth
        known = cameras[frame.document.kind].take_truth(frame.frame_id)
        truth = _write_truth(store.truth_path, truth, capture_id, known, threads)

    devices = Devices(turntable, cameras["light_field"], cameras["photo"])  # type: ignore[arg-type]
    run_plan(plan, devices, store, monitor=monitor, on_ingested=keep_truth)
    return store


def _size(size: str | tuple[int, int]) -> tuple[int, int]:
    if not isinstance(size, str):
        return size
    if size not in SIZES:
        raise UsageError(f"there is no size {size!r}", code="unknown-size", remedy=f"choose one of {', '.join(SIZES)}")
    return SIZES[size]


def _write_calibration(folder: Path, camera: PlenopticCamera, shots: int) -> None:
    """The camera's archive with white images of this many shots, unless the session has one of as many."""
    path = folder / f"{camera.calibration_name}.tar"
    if path.exists():
        with tarfile.open(path) as archive:
            # One white image is of no shot.
            if sum(name.endswith(".RAW") for name in archive.getnames()) > shots:
                return
    with atomic_writer(path) as stream:
        camera.write_calibration(stream, shots)


def _open_truth(session: Path, scene: str, seed: int) -> TruthDocument:
    """The truth that a session has already, or a new one; refuses to mix."""
    folder = session.absolute().with_name(f"{session.absolute().name}.truth")
    if (folder / TRUTH_FILE).exists():
        known = TruthDocument.load(folder / TRUTH_FILE)
        if (known.scene, known.seed) != (scene, seed):
            raise BadInput(
                f"holds scene {known.scene!r} with seed {known.seed}", path=folder / TRUTH_FILE, field="scene",
                code="other-scene", remedy="capture another scene into another session",
            )  # fmt: skip
        return known
    if (session / "session.json").exists() and SessionStore.open(session).document.captures:
        raise BadInput(
            "has captures that are not the simulator's", path=session, code="not-simulated",
            remedy="capture into a new session",
        )  # fmt: skip
    return TruthDocument(scene=scene, seed=seed)


def _write_truth(
    folder: Path, document: TruthDocument, capture_id: str, truth: CaptureTruth, threads: int
) -> TruthDocument:
    """Add one capture's truth: its folder first, then its line in truth.json."""
    views = truth.views
    # A light field without noise shows the truth itself.
    if truth.record.kind == "light_field" and truth.record.noise_sigma == 0:
        views = None
    spec = None if views is None else ViewsSpec(rows=views.shape[0], cols=views.shape[1])
    # A folder that no truth.json lists is left from a run that was killed.
    with atomic_folder(folder / "captures" / capture_id, overwrite=True) as staging:
        np.save(staging / "depth.npy", truth.depth_m)
        if views is not None and spec is not None:
            write_views(staging, views, spec.file, threads=threads)
    record = truth.record.model_copy(update={"views": spec})
    document = document.model_copy(update={"captures": {**document.captures, capture_id: record}})
    document.save(folder / TRUTH_FILE)
    return document
