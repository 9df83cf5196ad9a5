"""Light through the lenses onto the sensor: lattice, twins, and what each pixel sees."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfrig.sim import culling
from lfrig.sim.optics import SimCamera
from lfrig.sim.plenoptic import render_numpy
from lfrig.sim.plenoptic.lattice import Lattice, from_nearest_lens, in_lattice
from lfrig.sim.plenoptic.render import ROWS_AT_ONCE, render_lenslets
from lfrig.sim.scene import F32, F64, Lamp, PackedScene, backdrop, pack, sphere
from tests.sim.lenses import all_lenses, pixels_by_lens
from tests.sim.small import camera, flat, head_on, one_of_each, scene

GRBG = np.array([[1, 0], [2, 1]], np.uint8)
LATTICE = Lattice(7.15, 0.003, (83.3, 55.8), 1.001)
SHAPE = 114, 172  # of views of 24×16
GLOW = Lamp(ambient=1.0, ambient_slope=0.0, power=0.0)

two_twins = pytest.mark.skipif(
    find_spec("lfrig.sim._render") is None, reason="no native renderer here: only its twin exists"
)


def light(packed: PackedScene, k: SimCamera, **options: int) -> F32:
    return render_lenslets(packed, k, LATTICE, GRBG, SHAPE, **options)


def test_centres_follow_the_definition() -> None:
    lenses = all_lenses(LATTICE, SHAPE)
    gx, gy = in_lattice(LATTICE.record(), lenses[:, 0], lenses[:, 1])
    offsets = from_nearest_lens(gx, gy, LATTICE.pitch_px, LATTICE.row_pitch_px)
    assert np.abs(offsets).max() < 1e-9
    np.testing.assert_allclose(LATTICE.centres(np.array(2.0), np.array(-3.0)), _by_hand(2, -3))


def _by_hand(i: int, j: int) -> tuple[float, float]:
    gx, gy = (i + 0.5) * 7.15, j * 0.8660254037844386 * 7.15 * 1.001  # j is odd
    return (83.3 + np.cos(0.003) * gx - np.sin(0.003) * gy, 55.8 + np.sin(0.003) * gx + np.cos(0.003) * gy)


@given(st.floats(-60, 60), st.floats(-60, 60), st.floats(0.98, 1.02))
def test_nearest_lens_is_the_nearest(x: float, y: float, stretch: float) -> None:
    row = np.sqrt(3) / 2 * stretch
    i, j = np.meshgrid(np.arange(-80, 81), np.arange(-80, 81))
    distance = np.hypot(x - (i + 0.5 * (j % 2)), y - j * row)
    dx, dy = from_nearest_lens(np.array(x), np.array(y), 1.0, row)
    assert np.hypot(dx, dy) == pytest.approx(distance.min(), abs=1e-9)


def test_rays_fill_the_hexagon_of_the_lens_and_the_square_of_the_pixel() -> None:
    regular = Lattice(10.0, 0.0, (0.0, 0.0)).record()
    key = np.repeat(render_numpy.hash32(np.arange(2000, dtype=np.uint32)), 4)
    (x, y), pixel = render_numpy.sample_places(regular, key, np.arange(8000) % 4, 2)
    # Inside: along the three directions to its neighbours, a lens ends half way.
    for direction in np.deg2rad([0.0, 60.0, 120.0]):
        assert np.abs(x * np.cos(direction) + y * np.sin(direction)).max() <= 0.5 + 1e-9
    # The second moments of a regular hexagon of width 1, and of a unit square.
    assert np.mean(x * x) == pytest.approx(5 / 72, rel=0.05)
    assert np.mean(y * y) == pytest.approx(5 / 72, rel=0.05)
    assert np.abs(np.mean([x, y], 1)).max() < 0.01
    assert np.abs(pixel).max() <= 0.5
    np.testing.assert_allclose(np.mean(np.square(pixel), 1), 1 / 12, rtol=0.05)
    # And neither place says anything about the other.
    correlation = np.corrcoef(np.array([x, y, *pixel])) - np.eye(4)
    assert np.abs(correlation).max() < 0.04


@two_twins
@pytest.mark.parametrize("options", [{"samples": 4, "seed": 3}, {"samples": 1}])
def test_twins_give_the_same_picture(monkeypatch: pytest.MonkeyPatch, options: dict[str, int]) -> None:
    packed, k = pack(scene(*one_of_each())), camera(24, 16)
    pictures = []
    for native in "10":
        monkeypatch.setenv("LFRIG_NATIVE", native)
        pictures.append(light(packed, k, **options))
    assert pictures[0].std() > 0.05
    np.testing.assert_allclose(pictures[0], pictures[1], rtol=1e-5, atol=1e-6)


def test_thread_count_changes_nothing() -> None:
    packed, k = pack(scene(*one_of_each())), camera(24, 16)
    np.testing.assert_array_equal(light(packed, k, threads=1), light(packed, k, threads=3))


def test_seed_decides_the_jitter() -> None:
    packed, k = pack(scene(*one_of_each())), camera(24, 16)
    first, again, other = (light(packed, k, samples=1, seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert 0 < np.abs(first - other).mean() < 0.1


def test_culling_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    packed, k = pack(scene(*one_of_each())), camera(24, 16)
    culled = light(packed, k, samples=1)

    def everywhere(*_: object) -> tuple[F64, F64]:
        count = len(packed.primitives)
        return np.tile([-1e9, -1e9, 1e9, 1e9], (1, count, 1)), np.zeros((1, count))

    monkeypatch.setattr(culling, "view_rectangles", everywhere)
    np.testing.assert_array_equal(culled, light(packed, k, samples=1))


@pytest.mark.parametrize("depth_m", [0.30, 0.46, 0.70])
def test_bright_ball_is_seen_where_the_views_have_it(depth_m: float) -> None:
    """Pixels at (du, dv) under their lenses form the view (dv, du): there the ball has moved by its disparity."""
    k = head_on(24, 16)
    ball = sphere((0.004, depth_m, 0.002), 5 * depth_m / k.focal_px, flat(1.0))
    seen = light(pack(scene(ball, backdrop(2.0, flat(0.0)), lamp=GLOW)), k)
    x, y, du, dv = pixels_by_lens(LATTICE, SHAPE)
    # The outline is a hundredth nearer than the centre.
    disparity = k.baseline_m * k.focal_px * (1.01 / depth_m - 1 / k.focus_m)
    columns = np.stack([np.ones_like(du), du, dv], -1)
    root = np.sqrt(seen)[..., None]
    for place, middle, slopes in (
        (x, k.focal_px * 0.004 / depth_m, (-disparity, 0.0)),
        (y, -k.focal_px * 0.002 / depth_m, (0.0, -disparity)),
    ):
        fit, *_ = np.linalg.lstsq((columns * root).reshape(-1, 3), (place * root[..., 0]).ravel(), rcond=None)
        np.testing.assert_allclose(fit, (middle, *slopes), atol=0.02)


def test_each_pixel_receives_its_own_colour() -> None:
    colours = (0.2, 0.5, 0.9)
    wall = flat(1.0)
    glowing = scene(backdrop(0.25, type(wall)(wall.texture, tint=colours)), lamp=GLOW)
    seen = light(pack(glowing), camera(24, 16), samples=1)
    for y, x, colour in ((0, 0, 1), (0, 1, 0), (1, 0, 2), (1, 1, 1)):
        np.testing.assert_allclose(seen[y::2, x::2], colours[colour], rtol=1e-6)


def test_says_how_far_it_is() -> None:
    calls: list[int] = []
    tall = 2 * ROWS_AT_ONCE + 1
    render_lenslets(
        pack(scene(backdrop(0.25, flat(0.5)))), camera(8, 8), LATTICE, GRBG, (tall, 8), samples=1,
        on_band=lambda: calls.append(1),
    )  # fmt: skip
    assert len(calls) == 3


@pytest.mark.parametrize("samples", [0, 2, 36])
def test_sample_counts_that_are_no_grid_are_refused(samples: int) -> None:
    with pytest.raises(ValueError, match="samples"):
        light(pack(scene(*one_of_each())), camera(24, 16), samples=samples)
