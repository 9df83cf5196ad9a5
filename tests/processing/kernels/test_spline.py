"""Spline interpolation: it goes through the samples, is exact on cubics, and beats bicubic on what can be told."""

from __future__ import annotations

import numpy as np
import pytest

from lfrig.processing.kernels.spline import sample_spline, spline
from lfrig.processing.kernels.warp import warp_views


def grid(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    return x, y


def test_it_goes_through_the_samples_up_to_the_border() -> None:
    picture = np.random.default_rng(0).uniform(0, 255, (13, 17, 3)).astype(np.float32)
    x, y = grid(13, 17)
    assert np.abs(sample_spline(spline(picture), x, y) - picture).max() < 0.01


def test_it_is_exact_on_cubics_away_from_the_border() -> None:
    x, y = grid(60, 60)
    cubic = lambda x, y: (x / 30 - 1) ** 3 - (y / 30 - 1) ** 2 + x * y / 900  # noqa: E731
    picture = cubic(x, y)[..., None]
    at = np.random.default_rng(0).uniform(20, 40, (2, 200)).astype(np.float32)
    assert np.abs(sample_spline(spline(picture), *at)[:, 0] - cubic(*at)).max() < 1e-4


def test_a_fine_wave_keeps_more_of_itself_than_bicubic() -> None:
    x, y = grid(40, 64)
    wave = lambda x, y: 127.5 + 100 * np.sin(1.9 * x + 0.4 * y)  # noqa: E731
    image = np.repeat(np.rint(wave(x, y))[..., None], 3, -1).astype(np.uint8)
    field = np.full((1, 40, 64), 0.5, np.float32)
    bicubic = warp_views(image, field, np.array([[0, 1]], np.float32))[0]
    ours = sample_spline(spline(image.astype(np.float32)), x + 0.5, y)
    truth, inner = wave(x + 0.5, y)[..., None], np.s_[12:-12, 12:-12]
    error = [float(np.abs(found[inner] - truth[inner]).mean()) for found in (ours, bicubic)]
    assert error[0] < 0.4 * error[1]


@pytest.mark.parametrize("where", [-1e6, -15.0, 40.0])
def test_beyond_the_frame_the_border_is_continued(where: float) -> None:
    picture = np.full((8, 9, 2), 50.0, np.float32)
    picture[:, 4] = 90
    found = sample_spline(spline(picture), np.array([where], np.float32), np.array([4.0], np.float32))
    assert found == pytest.approx(50, abs=0.5)


def test_positions_of_two_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="x is"):
        sample_spline(spline(np.zeros((4, 4, 1), np.float32)), np.zeros(3, np.float32), np.zeros(4, np.float32))
