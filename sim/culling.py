"""Where a primitive can appear: conservative rectangles of its bounding box in a view and on the lamp's grid.

Culling never changes a picture; it only spares rays that cannot hit. Both renderers use the same rectangles.
"""

from __future__ import annotations

import numpy as np

from lfrig.sim.optics import SimCamera
from lfrig.sim.scene import F64, PackedScene

NEAREST_M = 0.02
EVERYWHERE = 1e9


def view_rectangles(scene: PackedScene, camera: SimCamera, offsets: F64, aperture: float) -> tuple[F64, F64]:
    """Screen rectangles (x0, y0, x1, y1) [px], float64 [V, N, 4], and nearest depths [V, N] [m].

    ``offsets`` [V, 2] are (row, col) view steps; ``aperture`` is the width of a view's pupil in view steps.
    """
    local = scene.corners @ camera.rotation.T + camera.translation
    z = local[..., 2]
    safe = np.maximum(z, NEAREST_M)
    centre = local[..., :2] / safe[..., None] * camera.focal_px + [camera.cx, camera.cy]
    disparity = camera.baseline_m * camera.focal_px * (1 / safe - 1 / camera.focus_m)
    # [V, N, 8, 2]: x moves with the column offset, y with the row offset.
    xy = centre[None] - offsets[:, None, None, ::-1] * disparity[None, ..., None]
    margin = 1.0 + 0.5 * aperture * np.abs(disparity).max(1)
    low, high = xy.min(2) - margin[:, None], xy.max(2) + margin[:, None]
    rectangles = np.concatenate([low, high], -1)
    behind = z.min(1) < NEAREST_M  # the projection of a box that crosses the camera plane is unbounded
    rectangles[:, behind] = [-EVERYWHERE, -EVERYWHERE, EVERYWHERE, EVERYWHERE]
    near = np.where(behind, 0.0, z.min(1) - 1e-6)
    return np.ascontiguousarray(rectangles), np.ascontiguousarray(np.broadcast_to(near, (len(offsets), len(near))))


def lamp_rectangles(scene: PackedScene) -> F64:
    """Rectangles (x0, y0, x1, y1) in tangents about the lamp's axis that a primitive can shade, float64 [N, 4].

    The lamp is a camera with a wide aperture: an occluder at depth z moves by at most radius / z.
    """
    local = (scene.corners - np.array(scene.lamp.position)) @ scene.lamp_frame.T
    z = local[..., 2]
    safe = np.maximum(z, NEAREST_M)
    tangent = local[..., :2] / safe[..., None]
    margin = scene.lamp.radius / safe.min(1)
    rectangles = np.concatenate([tangent.min(1) - margin[:, None], tangent.max(1) + margin[:, None]], -1)
    rectangles[z.min(1) < NEAREST_M] = [-EVERYWHERE, -EVERYWHERE, EVERYWHERE, EVERYWHERE]
    return np.ascontiguousarray(rectangles)
