"""Colours of a source in the photo's: exposure, white balance and tone curve differ from shot to shot.

In gamma-encoded values exposure and white balance are factors, and a steeper or flatter tone curve an exponent: per
channel ``photo ≈ gain · source^gamma`` [grey levels of 0..255], fitted to pixels that both show well exposed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.model import F32, U8

Mask = NDArray[np.bool_]

FAIR = (20.0, 235.0)
"""Grey levels between which a value is neither noise nor clipped."""
ENOUGH = 100
PLENTY = 4000
"""Pixels that a fit takes: more, evenly left out, would not move it."""
GAMMA_LIMITS = (0.6, 1.6)
SETTLED = 1e-3
"""Change of gamma and log gain from one round of a fit to the next below which it has converged."""
SPREAD = 0.15
"""Standard deviation of log values below which only a gain is fitted."""
SATURATED_GREY = 250
NO_TEXTURE_GREY = 0.5
"""Standard deviation below which a picture shows nothing that could be matched."""

LUMA = np.array([0.299, 0.587, 0.114], np.float32)
"""Rec. 601."""


@dataclass(frozen=True)
class Tone:
    """Per channel ``gain · value^gamma``, float32 [3] each."""

    gain: F32
    gamma: F32

    def apply(self, colour: F32) -> F32:
        """Grey levels [..., 3] in the photo's tone, clipped to 0..255."""
        lifted = np.maximum(colour, np.float32(0))
        if np.abs(self.gamma - 1).max() > 1e-6:
            lifted = np.power(lifted, self.gamma, dtype=np.float32)
        return np.asarray(np.clip(lifted * self.gain, 0, 255), np.float32)

    def apply_marked(self, image: U8) -> U8:
        """The same for grey levels uint8 [H, W, 4] whose last channel is kept, by a table."""
        import cv2

        table = np.empty((256, 1, 4), np.uint8)
        table[:, 0, :3] = np.rint(self.table())
        table[:, 0, 3] = np.arange(256)
        return np.asarray(cv2.LUT(image, table), np.uint8)

    def apply_whole(self, image: U8) -> F32:
        """The same for whole grey levels uint8 [H, W, 3], by a table: float32 [H, W, 3]."""
        import cv2

        return np.asarray(cv2.LUT(image, self.table()[:, None]), np.float32)

    def table(self) -> F32:
        """Of every grey level, float32 [256, 3]."""
        return self.apply(np.repeat(np.arange(256, dtype=np.float32)[:, None], 3, 1))


def fit_tone(photo: F32, colour: F32, seen: Mask) -> Tone:
    """Robust fit; the identity for channels with too few fair pixels.

    Parameters
    ----------
    photo, colour : float32 [..., 3]
        Grey levels that belong together, where ``seen``.
    """
    gain, gamma = np.ones(3, np.float32), np.ones(3, np.float32)
    where = np.flatnonzero(seen)
    where = where[:: max(1, len(where) // PLENTY)]
    ours, theirs = photo.reshape(-1, 3)[where], colour.reshape(-1, 3)[where]
    for channel in range(3):
        a, b = ours[:, channel], theirs[:, channel]
        fair = (a > FAIR[0]) & (a < FAIR[1]) & (b > FAIR[0]) & (b < FAIR[1])
        if int(fair.sum()) > ENOUGH:
            gain[channel], gamma[channel] = _fit_channel(np.log(a[fair]), np.log(b[fair]))
    return Tone(gain, gamma)


def _fit_channel(photo: F32, source: F32) -> tuple[float, float]:
    """Gain and gamma from logarithms [M]: iteratively reweighted (Tukey) straight line, or the median offset."""
    offset = float(np.median(photo - source))
    if float(source.std()) < SPREAD:
        return float(np.exp(offset)), 1.0
    x, y = source.astype(np.float64), photo.astype(np.float64)
    slope, level = 1.0, offset
    middle = len(x) // 2
    for _ in range(8):
        residual = y - slope * x
        residual -= level
        scale = 1.4826 * float(np.partition(np.abs(residual), middle)[middle]) + 1e-3
        residual /= 4.685 * scale
        weight = np.maximum(1 - residual * residual, 0)
        weight *= weight
        total = weight.sum()
        mx, my = float(weight @ x) / total, float(weight @ y) / total
        before, dx = (slope, level), x - mx
        weight *= dx
        slope = float(np.clip(float(weight @ (y - my)) / max(float(weight @ dx), 1e-12), *GAMMA_LIMITS))
        level = float(my - slope * mx)
        if abs(slope - before[0]) + abs(level - before[1]) < SETTLED:
            break
    return float(np.exp(level)), slope


def blurred(image: U8 | F32, sigma: float) -> F32:
    """Grey levels float32 of an image [H, W] or [H, W, 3], blurred."""
    import cv2

    return np.asarray(cv2.GaussianBlur(image.astype(np.float32, copy=False), (0, 0), sigma), np.float32)


def luma(image: U8) -> F32:
    """Grey levels float32 [H, W] of RGB uint8 [H, W, 3]."""
    return np.asarray(image.astype(np.float32) @ LUMA, np.float32)


def marked(image: U8, sigma: float) -> U8:
    """RGB uint8 [H, W, 3] blurred, with the share of saturated pixels in the blur (/255) as a fourth channel."""
    import cv2

    below = cv2.inRange(image, np.zeros(3), np.full(3, SATURATED_GREY - 1.0))
    out = np.empty((*image.shape[:2], 4), np.uint8)
    soft, share = cv2.GaussianBlur(image, (0, 0), sigma), cv2.GaussianBlur(cv2.bitwise_not(below), (0, 0), sigma)
    cv2.mixChannels([soft, share], [out], [0, 0, 1, 1, 2, 2, 3, 3])
    return out
