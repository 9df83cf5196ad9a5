"""Exposure, the sRGB curve and noise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfrig.sim.tone import Exposure, add_noise, develop, linear_from_srgb, srgb_from_linear


@given(st.floats(0, 1))
def test_the_curve_and_its_inverse(value: float) -> None:
    assert srgb_from_linear(linear_from_srgb(np.array(value))) == pytest.approx(value, abs=1e-6)


@given(st.floats(0, 1.5, width=32), st.floats(0.2, 2), st.floats(0.8, 1.2))
def test_develop_is_the_formula(radiance: float, gain: float, red: float) -> None:
    pixel = develop(np.full((1, 3), radiance, np.float32), Exposure(gain, (red, 1.0, 1.0)))[0]
    exact = 255 * srgb_from_linear(np.clip(np.array([radiance * gain * red, radiance * gain]), 0, 1))
    assert pixel.dtype == np.uint8
    np.testing.assert_allclose(pixel[:2], exact, atol=0.56)


def test_bright_light_clips() -> None:
    assert (develop(np.full((2, 3), 50.0, np.float32), Exposure()) == 255).all()


def test_noise_has_its_sigma_and_its_seed() -> None:
    image = np.full((64, 64, 3), 128, np.uint8)
    noisy = add_noise(image, 5.0, [1])
    assert noisy.std() == pytest.approx(5.0, rel=0.03)
    assert noisy.mean() == pytest.approx(128, abs=0.2)
    np.testing.assert_array_equal(noisy, add_noise(image, 5.0, [1]))
    assert (noisy != add_noise(image, 5.0, [2])).mean() > 0.8


def test_no_noise_is_the_picture_itself() -> None:
    image = np.full((4, 4, 3), 9, np.uint8)
    assert add_noise(image, 0.0, [1]) is image
