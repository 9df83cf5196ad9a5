"""A scene that needs everything: texture on every surface, surfaces at every depth, edges everywhere.

It is no part of the library: nothing is tuned or reported on it but what skipping costs where nothing can be skipped.
"""

from __future__ import annotations

import numpy as np

from lfrig.sim import textures as tx
from lfrig.sim.scene import Primitive, Scene, box, sphere, turned
from lfrig.sim.scenes.props import MIDDLE_DEG, at, cloth, stage

NAME = "everything"
PALETTES = ("autumn", "sea", "meadow", "dusk", "toy")
NEAREST_M, FARTHEST_M = -0.13, 0.16
"""Where bodies hang, from before the plate's middle to the wall: the depths that the rig allows."""
REACH_M = 0.15
BODIES = 70


def everything(seed: int = 0) -> Scene:
    """Seventy textured bodies that hang in the air at all depths, before a textured wall over a textured table."""
    rng = np.random.default_rng([seed, 7070])
    skins = [cloth(tx.dead_leaves(seed + 9000 + k, palette, 0.06)) for k, palette in enumerate(PALETTES)]
    skins.append(cloth(tx.printed(seed + 9010, width_m=0.05)))
    bodies: list[Primitive] = []
    for k, away in enumerate(np.linspace(FARTHEST_M, NEAREST_M, BODIES)):
        # The nearer, the smaller: every depth covers about as many pixels as the others.
        half = rng.uniform(0.006, 0.011) * (0.45 + 0.27 - away)
        side, height = rng.uniform(-REACH_M, REACH_M) * (0.4 + away), rng.uniform(0.0, 0.13)
        centre, skin = at(float(side), float(away), float(height)), skins[k % len(skins)]
        if k % 2:
            bodies.append(sphere(centre, 1.6 * half, skin, turned(yaw_deg=float(rng.uniform(0, 360)))))
        else:
            bodies.append(box(centre, (half, half, 1.6 * half), skin, turned(float(rng.uniform(0, 90)) - MIDDLE_DEG)))
    floor, wall = tx.dead_leaves(seed + 9020, "dusk", 0.15), tx.dead_leaves(seed + 9021, "stone", 0.20)
    return stage(NAME, bodies, cloth(floor), cloth(wall))
