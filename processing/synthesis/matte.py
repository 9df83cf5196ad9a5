"""Two layers at depth steps. A pixel that a step crosses holds both surfaces' colours; carried along with either it
leaves a fringe in the views. So the near and the far colour are continued to it from both sides, its own colour says
how much of each it has, and the layers part (after Zitnick et al., "High-quality video view interpolation using a
layered representation", SIGGRAPH 2004). Put back over each other without a shift they give the photo again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.kernels.layered_views import Layers
from lfrig.processing.model import F32
from lfrig.processing.synthesis.peel import Mask, grow, near_rim, peel
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
    near_grey, near_known = grow(photo_grey, behind.peeled & ~rim & ~beyond, rim | continued, reach_px + MARGIN_PX)
    # What is left of a near surface deeper than it was peeled is not background either.
    deep = _dilate(behind.peeled, MARGIN_PX) & ~behind.peeled
    deep &= disparity + _highest(-behind.disparity, MARGIN_PX) > step
    sure_far = ~(behind.peeled | rim | deep)
    far_grey, far_known = grow(photo_grey, sure_far, behind.peeled | rim, reach_px + 1)
    share, mixed = _shares(photo_grey, near_grey, far_grey, rim & near_known & far_known, settings)
    share = np.where(rim & ~mixed, np.float32(0), share)
    share[near & ~mixed] = 1
    share[continued & ~rim] = 0
    _reconcile(photo_grey, near_grey, far_grey, share, rim)
    far_grey, _ = grow(far_grey, sure_far | rim, behind.peeled & ~rim, reach_px)
    near_px, _ = grow(disparity[..., None], near | behind.peeled, continued, MARGIN_PX + 2)
    at_mixed = _dilate(mixed, 1)
    return Layers(
        behind_px=behind.disparity,
        far_grey=np.clip(far_grey, 0, 255),
        near_px=np.ascontiguousarray(near_px[..., 0]),
        near_grey=np.dstack([np.clip(near_grey, 0, 255), share]),
        near_drawn=(near & at_mixed) | (beyond & _dilate(mixed, 2)),
        far_drawn=_dilate(far & at_mixed, 2) & ~behind.peeled,
    )


def _shares(photo: F32, near_grey: F32, far_grey: F32, known: Mask, settings: SynthesisSettings) -> tuple[F32, Mask]:
    """The near surface's share, float32 [H, W], where the colours tell it (second output), else 1.

    pixel = share · near + (1 − share) · far, by least squares over the channels.
    """
    own, far = photo[known], far_grey[known]
    axis = near_grey[known] - far
    length2 = np.einsum("nc,nc->n", axis, axis)
    found = np.clip(np.einsum("nc,nc->n", own - far, axis) / np.maximum(length2, 1), 0, 1)
    misfit = own - far - found[:, None] * axis
    channels = photo.shape[2]
    fits = length2 > channels * settings.matte_contrast_grey**2
    fits &= np.einsum("nc,nc->n", misfit, misfit) < channels * settings.matte_fit_grey**2
    mixed = np.zeros(known.shape, bool)
    mixed[known] = fits
    share = np.ones(known.shape, np.float32)
    share[mixed] = found[fits]
    return share, mixed


def _reconcile(photo: F32, near_grey: F32, far_grey: F32, share: F32, where: Mask) -> None:
    """Change both layers' colours, in place and as little as possible, so that together they give the photo."""
    near_share = share[where][:, None]
    far_share = 1 - near_share
    rest = photo[where] - near_share * near_grey[where] - far_share * far_grey[where]
    rest /= near_share**2 + far_share**2
    near_grey[where] += near_share * rest
    far_grey[where] += far_share * rest


def _dilate(mask: Mask, radius_px: int) -> Mask:
    return np.asarray(_highest(mask.astype(np.uint8), radius_px) > 0)


def _highest(values: F32 | NDArray[np.uint8], radius_px: int) -> F32:
    import cv2

    size = 2 * radius_px + 1
    return np.asarray(cv2.dilate(values, np.ones((size, size), np.uint8)))
