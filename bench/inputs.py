"""The same scenes seen through worse eyes: clean views, views with noise, views decoded from raw files.

The photo is the same in all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

from lfrig.bench.cases import NEAR_DEG, Case, shoot_case
from lfrig.contracts.progress import Monitor
from lfrig.processing.lenslet.decode import decode
from lfrig.processing.lenslet.raw import read_raw
from lfrig.processing.model import LightField
from lfrig.rig.session.convert import to_light_field
from lfrig.sim.cache import default_cache_dir
from lfrig.sim.plenoptic.camera import DECODED_NOISE_LEVELS, PlenopticCamera
from lfrig.sim.rig import SimulatedRig

Input = Literal["views", "noisy", "equal", "raw"]
INPUTS: tuple[Input, ...] = ("views", "noisy", "raw")
"""What may be asked for. ``equal`` is run beside ``raw``: what is then left between the two is the decode's."""

NOISE_LEVELS: dict[Input, float] = {"views": 0.0, "noisy": 5.0, "equal": DECODED_NOISE_LEVELS}
"""Standard deviation of the noise on views [grey levels]."""

TITLES: dict[Input, str] = {
    "views": "clean views",
    "noisy": f"views with noise of {NOISE_LEVELS['noisy']:g} grey levels",
    "equal": f"views with the noise of decoded ones, {NOISE_LEVELS['equal']:g} grey levels",
    "raw": "decoded from raw files with sensor noise",
}


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
    case = shoot_case(
        scene, size, angles_deg=angles_deg, noise_sigma=NOISE_LEVELS[kind], truth_views=False, threads=threads,
        cache_dir=cache_dir,
    )  # fmt: skip
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
