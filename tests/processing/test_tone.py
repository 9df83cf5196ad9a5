"""Colours of one shot in the tone of another."""

from __future__ import annotations

import numpy as np
import pytest

from lfrig.processing.tone import fit_tone, marked


def scene(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(25, 220, (60, 80, 3)).astype(np.float32)


@pytest.mark.parametrize(("gain", "gamma"), [((0.8, 0.9, 1.0), 1.0), ((0.5, 0.5, 0.6), 1.12)])
def test_exposure_and_tone_curve_are_found(gain: tuple[float, ...], gamma: float) -> None:
    source = scene()
    photo = np.float32(gain) * source**gamma
    outliers = np.random.default_rng(1).random(source.shape[:2]) < 0.2
    photo[outliers] = scene(2)[outliers]
    tone = fit_tone(photo, source, np.ones(source.shape[:2], bool))
    right = ~outliers[..., None] & (photo < 235)
    assert np.abs(tone.apply(source) - photo)[right & (photo > 20)].max() < 3


def test_too_few_pixels_leave_colours_as_they_are() -> None:
    source = scene()
    tone = fit_tone(0.5 * source, source, np.zeros(source.shape[:2], bool))
    np.testing.assert_array_equal(tone.apply(source), source)


def test_one_grey_gives_a_gain_alone() -> None:
    source = np.full((40, 40, 3), 100, np.float32)
    tone = fit_tone(0.7 * source, source, np.ones((40, 40), bool))
    np.testing.assert_allclose(tone.gain, 0.7, rtol=1e-4)
    np.testing.assert_array_equal(tone.gamma, 1)


def test_saturation_spreads_with_the_blur() -> None:
    image = np.full((20, 20, 3), 100, np.uint8)
    image[10, 10, 1] = 255
    share = marked(image, 1.0)[..., 3] / 255
    assert share[10, 10] > 0.1 and share[10, 11] > 0.02 and share[2, 2] == 0
