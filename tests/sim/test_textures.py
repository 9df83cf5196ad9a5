"""Procedural textures: seeded, repeating without a seam, band-limited, within range."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from lfrig.sim import textures as tx
from lfrig.sim.scene import F64, Material, Texture, pack, sphere
from lfrig.sim.tone import srgb_from_linear
from tests.sim.small import scene

SIZE = 128
MAKERS: dict[str, Callable[[int], Texture]] = {
    "noise": lambda seed: tx.noise(seed, size=SIZE),
    "weak": lambda seed: tx.weak(seed, size=SIZE),
    "dead_leaves": lambda seed: tx.dead_leaves(seed, size=SIZE, smallest=0.02),
    "wood": lambda seed: tx.wood(seed, size=SIZE),
    "bricks": lambda seed: tx.bricks(seed, size=SIZE),
    "checker": lambda seed: tx.checker(grain=0.05, seed=seed, size=SIZE),
    "printed": lambda seed: tx.printed(seed, lines=4, size=SIZE),
    "patches": lambda seed: tx.patches(seed, size=SIZE),
    "fabric": lambda seed: tx.fabric(seed, size=SIZE),
}


def grey(texture: Texture) -> F64:
    return srgb_from_linear(texture.image.astype(float).mean(2))


@pytest.mark.parametrize("name", MAKERS)
def test_seed_decides(name: str) -> None:
    first, again, other = (MAKERS[name](seed).image for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).mean() > 0.001


@pytest.mark.parametrize("name", MAKERS)
def test_values_are_colours(name: str) -> None:
    image = MAKERS[name](3).image
    assert image.dtype == np.float32
    assert image.min() >= 0
    assert image.max() <= 1
    assert image.std() > 0.001


@pytest.mark.parametrize("name", sorted(set(MAKERS) - {"printed"}))  # a page has margins where it repeats
def test_there_is_no_seam(name: str) -> None:
    """Neighbours across the border differ no more than neighbours elsewhere."""
    image = grey(MAKERS[name](4))
    for axis in (0, 1):
        steps = np.abs(image - np.roll(image, 1, axis)).mean(1 - axis)
        assert steps[0] <= 1.5 * steps.max()
        assert steps[0] <= np.sort(steps)[-2] * 1.3


@pytest.mark.parametrize("name", MAKERS)
def test_little_energy_near_the_nyquist_limit(name: str) -> None:
    image = grey(MAKERS[name](5))
    power = np.abs(np.fft.fft2(image - image.mean())) ** 2
    f = np.fft.fftfreq(SIZE)
    fine = np.maximum(np.abs(f)[:, None], np.abs(f)[None, :]) > 0.4
    assert power[fine].sum() < 0.03 * power.sum()


def test_noise_has_the_spectrum_that_was_asked_for() -> None:
    image = tx.spectrum_noise(np.random.default_rng(0), 256, slope=1.3)
    amplitude = np.abs(np.fft.fft2(image))
    f = np.hypot(*np.meshgrid(np.fft.fftfreq(256, 1 / 256), np.fft.fftfreq(256, 1 / 256)))
    bands = [(4, 8), (8, 16), (16, 32)]
    means = [np.sqrt((amplitude[(f >= a) & (f < b)] ** 2).mean()) for a, b in bands]
    slopes = -np.diff(np.log2(means))
    np.testing.assert_allclose(slopes, 1.3, atol=0.25)


def test_repeating_patterns_repeat_exactly() -> None:
    for texture, period in ((tx.checker(squares=8, size=128), 32), (tx.stripes(((0, 0, 0), (1, 1, 1)), size=128), 32)):
        np.testing.assert_allclose(texture.image, np.roll(texture.image, period, 1), atol=1e-6)


def test_weak_is_weak_and_plain_is_plain() -> None:
    assert 1 < 255 * grey(tx.weak(1, size=SIZE)).std() < 6
    assert np.ptp(tx.plain((0.2, 0.5, 0.8)).image, axis=(0, 1)).max() == 0


def test_gradient_has_no_edges() -> None:
    image = grey(tx.gradient((0.1, 0.1, 0.1), (0.9, 0.9, 0.9)))
    assert np.abs(np.diff(image, axis=0)).max() < 0.025
    assert np.ptp(image) > 0.75


def test_mip_levels_keep_the_mean() -> None:
    texture = tx.noise(7, size=64)
    packed = pack(scene(sphere((0, 0, 0), 0.1, Material(texture))))
    for start, width, height in packed.table[0]:
        level = packed.texels[start : start + 3 * width * height].reshape(-1, 3)
        np.testing.assert_allclose(level.mean(0), texture.image.mean((0, 1)), rtol=1e-5)
    assert list(packed.table[0, :, 1]) == [64, 32, 16, 8, 4, 2, 1]


@pytest.mark.parametrize("shape", [(30, 32, 3), (32, 32), (32, 32, 4)])
def test_unusable_pictures_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="texture"):
        Texture(np.zeros(shape, np.float32), 0.1)
