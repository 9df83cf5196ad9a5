"""The kernels of the synthesis against their NumPy twins and against their plain loops."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

import numpy as np
import pytest

from lfrig.processing.kernels import rims, warp
from lfrig.processing.kernels.layered_views import Layers, layered_views
from lfrig.processing.synthesis import SynthesisSettings
from lfrig.processing.synthesis.matte import split_layers
from tests.processing.kernels.twins import both

pytestmark = pytest.mark.skipif(
    find_spec("lfrig.processing.kernels._native") is None, reason="no native core here: only the twins exist"
)


@pytest.fixture(autouse=True)
def native(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the environment says: these tests are about the native form."""
    monkeypatch.setenv("LFRIG_NATIVE", "1")


OFFSETS = np.array([[-3, -3], [-3, 2], [0, 0], [0, 1], [0.5, -0.5], [2, 0], [3, 3]], np.float32)


@contextmanager
def plain_loops() -> Iterator[None]:
    from lfrig.processing.kernels import _native

    _native.use_plain_loops(True)
    try:
        yield
    finally:
        _native.use_plain_loops(False)


def scene(shape: tuple[int, int], dtype: type = np.uint8, amplitude: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """A textured picture, and the disparity of a slanted wall with cards and a bowl before it."""
    rng = np.random.default_rng(3)
    height, width = shape
    ys, xs = np.mgrid[0:height, 0:width].astype(np.float32)
    image = rng.normal(128, 25, (*shape, 3)) + 40 * np.sin(xs / 3 + ys / 5)[..., None]
    disparity = -0.5 + 0.004 * xs - 0.006 * ys
    card = (np.abs(xs - 0.3 * width) < 0.12 * width) & (np.abs(ys - 0.5 * height) < 0.3 * height)
    disparity = np.where(card, 0.9, disparity)
    image[card] += 60
    bowl = np.hypot(xs - 0.75 * width, ys - 0.4 * height) / (0.2 * width + 1)
    disparity = np.where(bowl < 1, np.maximum(0.6 - 0.8 * bowl**2, disparity), disparity)
    disparity = disparity + rng.normal(0, 0.002, shape)
    limit = np.iinfo(dtype).max
    return np.clip(image / 255 * limit, 0, limit).astype(dtype), (amplitude * disparity).astype(np.float32)


def layers_of(image: np.ndarray, disparity: np.ndarray) -> Layers:
    grey = (image / (1 if image.dtype == np.uint8 else 257)).astype(np.float32)
    return split_layers(grey, disparity, 8, SynthesisSettings())


def render(image: np.ndarray, disparity: np.ndarray, layers: Layers, **options) -> np.ndarray:  # type: ignore[no-untyped-def]
    return layered_views(image, disparity, layers, OFFSETS, match_px=0.08, hidden_px=0.06, **options)[0]


@pytest.mark.parametrize("certain", [True, False])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (7, 2), (33, 65), (90, 141)])
def test_layered_views(monkeypatch, shape, dtype, certain) -> None:
    image, disparity = scene(shape, dtype)
    layers = layers_of(image, disparity)
    native, twin = both(monkeypatch, lambda: render(image, disparity, layers, certain=certain))
    assert native.dtype == dtype and native.shape == (len(OFFSETS), *shape, 3)
    assert np.array_equal(native[2], image), "the view at (0, 0) is the photo"
    level = 1 if dtype == np.uint8 else 257
    apart = np.abs(native.astype(int) - twin.astype(int))
    assert np.mean(apart > level) < 2e-3
    assert np.mean(apart) < 0.05 * level


@pytest.mark.parametrize("amplitude", [0.0, 1.0, 3.0])
def test_layered_views_leave_out_what_cannot_matter(amplitude) -> None:
    image, disparity = scene((90, 141), amplitude=amplitude)
    layers = layers_of(image, disparity)
    options = {"match_px": 0.08, "hidden_px": 0.06}
    part, worked, _ = layered_views(image, disparity, layers, OFFSETS, certain=True, **options)
    whole, everything, _ = layered_views(image, disparity, layers, OFFSETS, certain=False, **options)
    assert everything == (len(OFFSETS) - 1) * disparity.size
    assert worked < 0.5 * everything or amplitude > 1
    assert np.mean(np.abs(part.astype(int) - whole.astype(int)) > 1) < 1e-3


def test_a_plane_needs_work_only_beyond_the_frame() -> None:
    image, _ = scene((40, 70))
    plane = np.full((40, 70), 0.7, np.float32)
    layers = layers_of(image, plane)
    _, worked, _ = layered_views(image, plane, layers, OFFSETS, match_px=0.08, hidden_px=0.06)
    shifts = np.ceil(0.7 * np.abs(OFFSETS) - 0.5).astype(int)
    assert worked == sum(40 * 70 - (40 - dy) * (70 - dx) for dy, dx in shifts)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("amplitude", [0.3, 1.0, 8.0])
def test_layered_views_are_the_same_for_any_width_and_number_of_threads(dtype, amplitude) -> None:
    image, disparity = scene((61, 93), dtype, amplitude)
    layers = layers_of(image, disparity)
    one = render(image, disparity, layers, threads=1)
    assert np.array_equal(render(image, disparity, layers, threads=3), one)
    with plain_loops():
        assert np.array_equal(render(image, disparity, layers, threads=2), one)


@pytest.mark.parametrize("hostile", [np.nan, np.inf, -np.inf, 1e9, -1e30])
def test_layered_views_survive_hostile_disparities(hostile) -> None:
    image, disparity = scene((33, 65))
    layers = layers_of(image, disparity)
    good = render(image, disparity, layers)
    disparity[5, 60] = hostile
    found = render(image, disparity, layers)
    assert np.mean(np.abs(found.astype(int) - good)[:, 20:] > 1) < 0.02, "far from the pixel nothing changes"


def test_layered_views_refuse_wrong_shapes() -> None:
    image, disparity = scene((9, 11))
    layers = layers_of(image, disparity)
    with pytest.raises(ValueError, match="shapes"):
        render(image, disparity[:, 1:], layers)
    with pytest.raises(ValueError, match="shapes"):
        render(image[:, 1:], disparity[:, 1:].copy(), layers)


@pytest.mark.parametrize("shape", [(1, 1), (5, 9), (40, 64), (40, 65), (40, 66), (20, 200)])
def test_warp_has_the_bits_of_its_plain_loops(shape) -> None:
    rng = np.random.default_rng(1)
    image = rng.integers(0, 256, (*shape, 3)).astype(np.uint8)
    fields = rng.normal(0, 2, (len(OFFSETS), *shape)).astype(np.float32)
    fields[0].flat[0] = np.nan
    vector = warp.warp_views(image, fields, OFFSETS, threads=2)
    with plain_loops():
        assert np.array_equal(warp.warp_views(image, fields, OFFSETS, threads=1), vector)


@pytest.mark.parametrize("shape", [(1, 1), (2, 9), (40, 61)])
@pytest.mark.parametrize("reach_px", [0, 1, 5])
def test_peel(monkeypatch, shape, reach_px) -> None:
    _, disparity = scene(shape)
    native, twin = both(monkeypatch, lambda: rims.peel(disparity, 0.2, reach_px))
    assert np.array_equal(native.peeled, twin.peeled)
    np.testing.assert_allclose(native.disparity, twin.disparity, atol=1e-5)
    assert native.peeled.any() == (shape != (1, 1) and reach_px > 0)


@pytest.mark.parametrize("shape", [(1, 1), (3, 7), (30, 41)])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_grow(monkeypatch, shape, channels) -> None:
    rng = np.random.default_rng(5)
    values = rng.uniform(0, 255, (*shape, channels)).astype(np.float32)
    known, wanted = rng.uniform(size=(2, *shape)) < np.array([0.05, 0.6])[:, None, None]
    values[~known & ~wanted] = 1e9  # neither gives nor gets
    native, twin = both(monkeypatch, lambda: rims.grow(values, known, wanted, 3))
    assert np.array_equal(native[1], twin[1])
    np.testing.assert_allclose(native[0], twin[0], rtol=1e-5, atol=1e-4)
