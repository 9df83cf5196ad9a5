"""A whole simulated session in memory: for benchmarks and tests that need no disk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from lfrig.contracts.progress import Monitor
from lfrig.contracts.session import RigSpec
from lfrig.contracts.truth import TruthDocument
from lfrig.sim.rig import COLS, ROWS, Poses, SimulatedCapture, SimulatedRig
from lfrig.sim.scene import Scene


@dataclass(frozen=True, eq=False)
class SimulatedSession:
    """Captures by id in order of shooting; ``target_id`` names the one to be raised."""

    captures: dict[str, SimulatedCapture]
    target_id: str
    rig: RigSpec
    truth: TruthDocument

    @property
    def source_ids(self) -> list[str]:
        """The captures that are not the target."""
        return [name for name in self.captures if name != self.target_id]

    @property
    def target(self) -> SimulatedCapture:
        """The capture to be raised."""
        return self.captures[self.target_id]


def shoot(
    scene: str | Scene,
    width: int,
    height: int,
    angles_deg: Sequence[float],
    target_deg: float,
    *,
    seed: int = 0,
    noise_sigma: float = 0.0,
    poses: Poses = "prior",
    lf_as_target: bool = False,
    truth_views: bool = True,
    threads: int = 0,
    cache_dir: Path | None = None,
    monitor: Monitor | None = None,
) -> SimulatedSession:
    """Shoot light fields at ``angles_deg`` and then the target at ``target_deg``.

    ``lf_as_target`` takes the target with the light-field camera too (leave-one-out): its truth is its own views.
    ``truth_views`` False leaves out the target's true views, which takes half the time of two sources. The other
    arguments are those of `lfrig.sim.rig.SimulatedRig`.

    Raises
    ------
    BadInput
        There is no such scene.
    Interrupted
        The monitor was cancelled.
    """
    rig = SimulatedRig(
        scene, width, height, seed=seed, noise_sigma=noise_sigma, poses=poses, threads=threads, cache_dir=cache_dir
    )
    monitor = monitor or Monitor()
    shots = len(angles_deg) + 1
    captures: dict[str, SimulatedCapture] = {}
    with monitor.task("simulate", shots * ROWS * COLS):
        for index, angle in enumerate(angles_deg):
            captures[f"{index:03d}"] = rig.shoot_light_field(index, angle, monitor)
            monitor.advance(0)
        target_id = f"{shots - 1:03d}"
        captures[target_id] = (
            rig.shoot_light_field(shots - 1, target_deg, monitor)
            if lf_as_target
            else rig.shoot_photo(0, target_deg, monitor, truth_views=truth_views)
        )
    truth = TruthDocument(
        scene=rig.scene_name, seed=seed, captures={name: c.truth.record for name, c in captures.items()}
    )
    return SimulatedSession(captures, target_id, rig.rig_spec(), truth)
