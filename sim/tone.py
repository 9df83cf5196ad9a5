"""From linear radiance to recorded pixels: exposure, white balance, clipping, the sRGB curve, 8 bits, noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.sim.scene import F32, F64

U8 = NDArray[np.uint8]
_STEPS = 1 << 16


@dataclass(frozen=True)
class Exposure:
    """``gain`` multiplies radiance; ``white_balance`` multiplies R, G, B besides."""

    gain: float = 1.0
    white_balance: tuple[float, float, float] = (1.0, 1.0, 1.0)


def linear_from_srgb(srgb: F64) -> F64:
    """IEC 61966-2-1 decoding of values in 0..1."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((np.maximum(srgb, 0.04045) + 0.055) / 1.055) ** 2.4)


def srgb_from_linear(linear: F64) -> F64:
    """IEC 61966-2-1 encoding of values in 0..1."""
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


# Finer than a twentieth of a grey level everywhere: the curve's steepest slope is 12.92 * 255 levels per unit.
_CURVE: U8 = np.round(255 * srgb_from_linear(np.arange(_STEPS) / (_STEPS - 1))).astype(np.uint8)


def develop(radiance: F32, exposure: Exposure) -> U8:
    """8-bit sRGB [..., 3] of linear radiance [..., 3]; clips like a sensor."""
    gain = (exposure.gain * np.array(exposure.white_balance) * (_STEPS - 1)).astype(np.float32)
    index = np.clip(radiance * gain + np.float32(0.5), 0, _STEPS - 1).astype(np.uint16)
    return np.asarray(_CURVE[index])


def add_noise(image: U8, sigma: float, seed: list[int]) -> U8:
    """Gaussian noise of ``sigma`` grey levels, seeded; 0 returns the image itself."""
    if sigma <= 0:
        return image
    noise = np.random.default_rng(seed).standard_normal(image.shape, dtype=np.float32)
    return np.clip(np.rint(image + np.float32(sigma) * noise), 0, 255).astype(np.uint8)
