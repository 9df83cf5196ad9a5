"""Two layers at depth steps. A pixel that a step crosses holds both surfaces' colours; carried along with either it
leaves a fringe in the views. So the near and the far colour are continued to it from both sides, its own colour says
how much of each it has, and the layers part (after Zitnick et al., "High-quality video view interpolation using a
layered representation", SIGGRAPH 2004). Put back over each other without a shift they give the photo again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.kernels.layered_views import Layers
from lfrig.processing.kernels.rims import Mask, grow, grow_in_place, near_rim, peel
from lfrig.processing.model import F32
from lfrig.processing.synthesis.settings import SynthesisSettings

MARGIN_PX = 3
"""The near surface is continued this far beyond what is drawn of it, so that no sample mixes it with the far one."""


def split_layers(photo_grey: F32, disparity: F32, reach_px: int, settings: SynthesisSettings) -> Layers:
    """Take a photo apart at the depth steps of its disparity.

    Parameters
    ----------
    photo_grey : float32 [H, W, 3]
        Grey levels of 0..255.
    disparity : float32 [H, W]
        px per view step, finite.
    reach_px : int
        How far any view looks behind a near surface.
    """
    step = settings.step_px
    behind = peel(disparity, step, reach_px)
    near = near_rim(disparity, step)
    far = near_rim(-disparity, step) & ~near
    rim = near | far
    beyond = (far | (_dilate(far, 1) & ~near & (_highest(disparity, 2) - disparity > step))) & ~behind.peeled
    continued = beyond
    for _ in range(MARGIN_PX):
        continued = continued | (_dilate(continued, 1) & ~behind.peeled & ~near)
    near_grey = np.empty((*disparity.shape, 4), np.float32)
    near_grey[..., :3], near_grey[..., 3] = photo_grey, 1
    near_known = grow_in_place(near_grey, behind.peeled & ~rim & ~beyond, rim | continued, reach_px + MARGIN_PX)
    # What is left of a near surface deeper than it was peeled is not background either.
    deep = _dilate(behind.peeled, MARGIN_PX) & ~behind.peeled
    deep &= disparity + _highest(-behind.disparity, MARGIN_PX) > step
    sure_far = ~(behind.peeled | rim | deep)
    far_grey, far_known = grow(photo_grey, sure_far, behind.peeled | rim, reach_px + 1)
    mixed = _part(photo_grey, near_grey, far_grey, rim, near & rim, near_known & far_known, settings)
    near_grey[continued & ~rim, 3] = 0
    grow_in_place(far_grey, sure_far | rim, behind.peeled & ~rim, reach_px)
    changed = rim | behind.peeled
    far_grey[changed] = np.clip(far_grey[changed], 0, 255)
    near_px, _ = grow(disparity[..., None], near | behind.peeled, continued, MARGIN_PX + 2)
    at_mixed = _dilate(mixed, 1)
    return Layers(
        behind_px=behind.disparity,
        far_grey=far_grey,
        near_px=np.ascontiguousarray(near_px[..., 0]),
        near_grey=near_grey,
        near_drawn=(near & at_mixed) | (beyond & _dilate(mixed, 2)),
        far_drawn=_dilate(far & at_mixed, 2) & ~behind.peeled,
    )


def _part(
    photo: F32, near_grey: F32, far_grey: F32, rim: Mask, near: Mask, known: Mask, settings: SynthesisSettings
) -> Mask:
    """Part near and far colours of the pixels at steps, in place; returns, bool [H, W], those that are mixed.

    ``near_grey`` float32 [H, W, 4] gets the near surface's share too: 1 and 0 on the two sides of a step where the
    colours do not tell it.
    """
    at = np.flatnonzero(rim)
    own, near_own, far_own = (a.reshape(-1, a.shape[2])[at, :3] for a in (photo, near_grey, far_grey))
    share, fits = _shares(own, near_own, far_own, settings)
    fits &= known.ravel()[at]
    share = np.where(fits, share, near.ravel()[at]).astype(np.float32)
    near_own, far_own = _reconciled(own, near_own, far_own, share)
    near_grey.reshape(-1, 4)[at] = np.column_stack([np.clip(near_own, 0, 255), share])
    far_grey.reshape(-1, 3)[at] = far_own
    mixed = np.zeros(rim.shape, bool)
    mixed.ravel()[at] = fits
    return mixed


def _shares(own: F32, near: F32, far: F32, settings: SynthesisSettings) -> tuple[F32, Mask]:
    """The near surface's share of N pixels from the colours [N, 3], float32 [N], and whether the colours tell it.

    pixel = share · near + (1 − share) · far, by least squares over the channels.
    """
    axis = near - far
    length2 = np.einsum("nc,nc->n", axis, axis)
    share = np.clip(np.einsum("nc,nc->n", own - far, axis) / np.maximum(length2, 1), 0, 1)
    misfit = own - far - share[:, None] * axis
    channels = own.shape[1]
    fits = length2 > channels * settings.matte_contrast_grey**2
    fits &= np.einsum("nc,nc->n", misfit, misfit) < channels * settings.matte_fit_grey**2
    return share, fits


def _reconciled(own: F32, near: F32, far: F32, share: F32) -> tuple[F32, F32]:
    """Both layers' colours [N, 3], changed as little as possible so that together they give the photo's."""
    near_share = share[:, None]
    far_share = 1 - near_share
    rest = own - near_share * near - far_share * far
    rest /= near_share**2 + far_share**2
    return near + near_share * rest, far + far_share * rest


def _dilate(mask: Mask, radius_px: int) -> Mask:
    return np.asarray(_highest(mask.astype(np.uint8), radius_px) > 0)


def _highest(values: F32 | NDArray[np.uint8], radius_px: int) -> F32:
    import cv2

    size = 2 * radius_px + 1
    return np.asarray(cv2.dilate(values, np.ones((size, size), np.uint8)))
