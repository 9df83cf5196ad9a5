"""The ray tracer: twins agree, results are reproducible, disparity has the documented sign."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec

import numpy as np
import pytest

from lfrig.sim import culling, render_numpy
from lfrig.sim.optics import view_offsets
from lfrig.sim.renderer import render_depth, render_radiance
from lfrig.sim.scene import F32, RECORD_LENGTH, Kind, Lamp, Material, Texture, backdrop, board, pack, sphere
from lfrig.sim.tone import Exposure, develop
from tests.sim.small import CENTRE, camera, centroid, flat, head_on, one_of_each, scene

VIEWS = view_offsets(3, 3)


@pytest.fixture
def numpy_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", "0")


two_twins = pytest.mark.skipif(
    find_spec("lfrig.sim._render") is None, reason="no native renderer here: only its twin exists"
)


def both_twins(monkeypatch: pytest.MonkeyPatch, **options: int | float) -> tuple[F32, F32]:
    packed, k = pack(scene(*one_of_each())), camera()
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    native = render_radiance(packed, k, VIEWS, **options)  # type: ignore[arg-type]
    monkeypatch.setenv("LFRIG_NATIVE", "0")
    return native, render_radiance(packed, k, VIEWS, **options)  # type: ignore[arg-type]


@two_twins
@pytest.mark.parametrize("options", [{"samples": 4, "aperture": 1.0}, {"samples": 9}, {"samples": 1, "seed": 5}])
def test_twins_give_the_same_picture(monkeypatch: pytest.MonkeyPatch, options: dict[str, int]) -> None:
    native, twin = both_twins(monkeypatch, **options)
    levels = [develop(r, Exposure(1.5)).astype(int) for r in (native, twin)]
    assert np.abs(levels[0] - levels[1]).max() <= 1


@two_twins
def test_twins_give_the_same_depth(monkeypatch: pytest.MonkeyPatch) -> None:
    packed, k = pack(scene(*one_of_each())), camera(96, 64)
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    native = render_depth(packed, k, VIEWS)
    monkeypatch.setenv("LFRIG_NATIVE", "0")
    np.testing.assert_allclose(native, render_depth(packed, k, VIEWS), rtol=1e-5)


@two_twins
def test_native_core_knows_the_same_record() -> None:
    assert import_module("lfrig.sim._render").RECORD_LENGTH == RECORD_LENGTH


def test_thread_count_changes_nothing() -> None:
    packed, k = pack(scene(*one_of_each())), camera()
    one, three = (render_radiance(packed, k, VIEWS, aperture=1.0, threads=n) for n in (1, 3))
    np.testing.assert_array_equal(one, three)


def test_seed_decides_the_jitter() -> None:
    packed, k = pack(scene(*one_of_each())), camera()
    first, again, other = (render_radiance(packed, k, CENTRE, seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert 0 < np.abs(first - other).mean() < 0.05


def test_view_does_not_depend_on_the_others() -> None:
    packed, k = pack(scene(*one_of_each())), camera()
    together = render_radiance(packed, k, VIEWS, aperture=1.0)
    alone = render_radiance(packed, k, VIEWS[5:6], aperture=1.0)
    np.testing.assert_array_equal(together[5], alone[0])


@pytest.mark.parametrize("depth_m", [0.30, 0.46, 0.70])
def test_bright_ball_moves_against_the_view_by_its_disparity(depth_m: float) -> None:
    """The point at (x, y) of the centre view is at (x − (c − c0) δ, y − (r − r0) δ) in view (r, c)."""
    k = head_on(64, 48)
    glow = Lamp(ambient=1.0, ambient_slope=0.0, power=0.0)
    ball = sphere((0.01, depth_m, 0.005), 0.012, flat(1.0))
    packed = pack(scene(ball, backdrop(2.0, flat(0.0)), lamp=glow))
    offsets = np.array([[0.0, 0.0], [0.0, 2.0], [-1.0, 0.0], [2.0, -2.0]])
    pictures = render_radiance(packed, k, offsets, samples=16)[..., 1]
    x0, y0 = centroid(pictures[0])
    disparity = k.baseline_m * k.focal_px * (1 / depth_m - 1 / k.focus_m)
    for (row, col), picture in zip(offsets[1:], pictures[1:], strict=True):
        x, y = centroid(picture)
        assert x - x0 == pytest.approx(-col * disparity, abs=0.04)
        assert y - y0 == pytest.approx(-row * disparity, abs=0.04)


def test_depth_of_views_follows_the_same_disparity() -> None:
    """A tilted board: the depth that a view sees at the moved pixel is the centre view's."""
    k = head_on(64, 48)
    packed = pack(scene(board((0.0, 0.45, 0.0), 0.3, 0.3, flat(0.5), yaw_deg=35.0), backdrop(2.0, flat(0.0))))
    (row, col), x, y = (1.0, 2.0), 30, 20
    offsets = np.array([[0.0, 0.0], [row, col]])
    centre, view = render_depth(packed, k, offsets).astype(float)
    disparity = k.baseline_m * k.focal_px * (1 / centre[y, x] - 1 / k.focus_m)
    xs = np.arange(k.width)
    # Inverse depth is affine along a row of a plane, so interpolating it is exact; rows of an upright board are equal.
    there = np.interp(x - col * disparity, xs, 1 / view[round(y - row * disparity)])
    assert there == pytest.approx(1 / centre[y, x], rel=1e-6)


def test_focal_plane_has_no_disparity() -> None:
    k = head_on()
    texture = Texture(np.random.default_rng(3).random((16, 16, 3), dtype=np.float32), 0.05)
    packed = pack(scene(board((0.0, k.focus_m, 0.0), 0.3, 0.3, Material(texture)), backdrop(2.0, flat(0.0))))
    pictures = render_radiance(packed, k, view_offsets(3, 3), samples=16)
    assert np.abs(pictures - pictures[4]).mean() < 0.01


def test_culling_changes_nothing(numpy_only: None) -> None:
    """The twin with rectangles that hide nothing gives the same picture and depth."""
    packed, k = pack(scene(*one_of_each())), camera()
    rectangles, _ = culling.view_rectangles(packed, k, VIEWS, 1.0)
    lamp = culling.lamp_rectangles(packed)
    seeds = np.arange(9, dtype=np.uint32)
    pictures, depths = [], []
    for hide in (True, False):
        if not hide:
            rectangles, lamp = (np.broadcast_to([-1e9, -1e9, 1e9, 1e9], r.shape) for r in (rectangles, lamp))
        picture, depth = np.zeros((9, k.height, k.width, 3), np.float32), np.zeros((9, k.height, k.width), np.float32)
        render_numpy.radiance(packed, k, VIEWS, rectangles, lamp, seeds, 1, 1.0, picture)
        render_numpy.depth(packed, k, VIEWS, rectangles, depth)
        pictures.append(picture)
        depths.append(depth)
    np.testing.assert_array_equal(pictures[0], pictures[1])
    np.testing.assert_array_equal(depths[0], depths[1])


def test_wide_pupil_blurs_what_is_out_of_focus_only() -> None:
    k = head_on(64, 48)
    stripes = Texture(np.tile([[[0.0] * 3], [[1.0] * 3]], (1, 1, 1)).astype(np.float32).reshape(1, 2, 3), 0.03)

    def contrast(depth_m: float, aperture: float) -> float:
        wall = board((0.0, depth_m, 0.0), 0.5, 0.5, Material(replace(stripes, width_m=0.03 * depth_m / 0.46)))
        packed = pack(scene(wall, backdrop(2.0, flat(0.0)), lamp=Lamp(ambient=1.0, ambient_slope=0, power=0)))
        return float(render_radiance(packed, k, CENTRE, samples=16, aperture=aperture).std())

    assert contrast(0.46, 6.0) == pytest.approx(contrast(0.46, 0.0), rel=0.02)
    assert contrast(0.80, 6.0) < 0.7 * contrast(0.80, 0.0)


def test_shadow_of_a_round_lamp_is_soft() -> None:
    """Light on a wall behind a blade: what each of the lamp's points sends past it, counted by hand."""
    k = head_on(96, 16)
    lamp = Lamp(position=(-0.3, 0.1, 0.0), radius=0.05, power=0.3, ambient=0.0, ambient_slope=0.0)
    wall = replace(board((0.0, 0.5, 0.0), 0.5, 0.5, flat(1.0)), casts_shadow=False)
    blade = board((-0.20, 0.3, 0.0), 0.05, 0.5, flat(0.0))
    packed = pack(scene(wall, blade, backdrop(2.0, flat(0.0)), lamp=lamp))
    row = render_radiance(packed, k, CENTRE, samples=16)[0, 8, :, 0]
    x = (np.arange(k.width) - k.cx) / k.focal_px * 0.5
    past = packed.lamp_points[:, 0] + (x[:, None] - packed.lamp_points[:, 0]) * (0.3 - packed.lamp_points[:, 1]) / (
        0.5 - packed.lamp_points[:, 1]
    )
    seen = ((past < -0.25) | (past > -0.15)).mean(1)
    towards = np.stack([-0.3 - x, np.full_like(x, 0.1 - 0.5)])
    distance = np.hypot(*towards)
    expected = seen * lamp.power * (0.4 / distance) / distance**2
    assert ((seen > 0.05) & (seen < 0.95)).sum() > 8
    np.testing.assert_allclose(row, expected, atol=0.04 * expected.max())


@pytest.mark.parametrize("samples", [0, 2, 36])
def test_sample_counts_that_are_no_grid_are_refused(samples: int) -> None:
    with pytest.raises(ValueError, match="samples"):
        render_radiance(pack(scene(*one_of_each())), camera(), CENTRE, samples=samples)


def test_all_kinds_are_rendered_in_these_tests() -> None:
    assert {p.kind for p in one_of_each()} == set(Kind)
