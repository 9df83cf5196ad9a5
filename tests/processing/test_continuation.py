"""Hidden areas continue the planes beside them, and nothing grows into what a source sees through."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from lfrig.processing import continuation
from lfrig.processing.continuation import DEFAULT_CONTINUATION, continue_hidden
from lfrig.processing.match_doubt import excess_cost
from lfrig.processing.model import F32, U8, Camera, Evidence, LightField, Optics, Pose, ScaleFit, Source
from lfrig.processing.plane_fit import Planes
from lfrig.processing.visibility import Mask, land
from lfrig.processing.wide_baseline import WideMatch

WIDTH, HEIGHT, FOCAL = 128, 72, 190.0
CAMERA = Camera.centred(WIDTH, HEIGHT, FOCAL)
WIDE = Camera.centred(WIDTH + 80, HEIGHT, FOCAL)
"""Of the source, which sees the whole wall."""
HERE = Pose(np.eye(3), np.zeros(3))
BASELINE_M = 0.05
PX = 0.0036 * FOCAL
NEAR, FAR, RECEDES = 3.6, 1.6, 0.006
"""1/m, 1/m, 1/m per px: a board before a wall that recedes to the left."""


def grid(camera: Camera) -> tuple[F32, F32]:
    """Pixels relative to the principal point, float32 [H, W] each."""
    ys, xs = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float32)
    return xs - np.float32(camera.cx), ys - np.float32(camera.cy)


@cache
def truth() -> tuple[F32, Mask]:
    """The surface that the photo sees [1/m], and where the board is."""
    x, y = grid(CAMERA)
    board = (np.abs(x) < 14) & (np.abs(y) < 20)
    return np.where(board, NEAR, FAR + RECEDES * x).astype(np.float32), board


@cache
def source() -> Source:
    """One source to the right of the photo, with its exact surface."""
    x, y = grid(WIDE)
    shift = BASELINE_M * FOCAL
    # x_source = x − shift · w(x), and w is linear in x.
    wall = (FAR + RECEDES * x) / (1 - RECEDES * shift)
    board = (np.abs(x + shift * NEAR) < 14) & (np.abs(y) < 20)
    scale = ScaleFit(1 / PX, 1.5)
    disparity = scale.disparity(np.where(board, NEAR, wall).astype(np.float32))
    pose = Pose(np.eye(3), np.array([-BASELINE_M, 0.0, 0.0]))
    views = np.zeros((3, 3, HEIGHT, WIDE.width, 3), np.uint8)
    evidence = Evidence(np.zeros((1, 1, 1), np.uint16), (0.0, 1.0), disparity, np.ones_like(disparity))
    return Source(LightField("right", views, WIDE, Optics(0.0036, 0.6), pose), WIDE, pose, evidence, scale)


@cache
def photo() -> U8:
    """Wall and board differ in colour, and both have texture."""
    image = np.where(truth()[1][..., None], [200, 90, 60], [90, 120, 160]) + np.random.default_rng(1).normal(
        0, 6, (HEIGHT, WIDTH, 3)
    )
    return np.asarray(np.clip(image, 0, 255), np.uint8)


@cache
def hidden() -> Mask:
    """What the source does not see."""
    return np.asarray(land(truth()[0], source(), CAMERA, HERE).visible(0.08) < 0.5)


def drawn_frontally(cost_of_the_seen: float = 0.0) -> tuple[WideMatch, Planes]:
    """The truth, but hidden areas at the inverse depth that the wall has at their left end, and its slopes."""
    true, board = truth()
    first = int(np.nonzero(hidden().any(0))[0][0])
    surface = np.where(hidden(), FAR + RECEDES * (first - CAMERA.cx), true).astype(np.float32)
    nothing = np.zeros_like(true)
    cost = np.where(hidden(), 1, cost_of_the_seen).astype(np.float32)
    match = WideMatch(surface, cost, nothing + 1, ~hidden(), nothing, nothing)
    return match, Planes(surface, np.where(board | hidden(), 0, RECEDES).astype(np.float32), nothing)


def test_a_hidden_part_of_a_receding_wall_goes_on_receding() -> None:
    match, planes = drawn_frontally()
    out, filled = continue_hidden(match, planes, [source()], CAMERA, HERE, photo(), PX)
    before, after = (PX * np.abs(w - truth()[0])[hidden()] for w in (match.inverse_depth, out))
    assert hidden().sum() > 500 and filled > 0.9 * hidden().sum()
    assert np.quantile(after, 0.9) < 0.1 * np.quantile(before, 0.9) and np.quantile(before, 0.9) > 0.05


def test_what_is_seen_stays() -> None:
    match, planes = drawn_frontally()
    out, _ = continue_hidden(match, planes, [source()], CAMERA, HERE, photo(), PX)
    seen = ~hidden()
    assert np.array_equal(out[seen], match.inverse_depth[seen])


def test_a_poor_match_moves_nothing_that_is_seen_wherever_it_lies() -> None:
    match, planes = drawn_frontally()
    left = int(np.nonzero(hidden().any(0))[0][0])
    rim = np.zeros_like(hidden())
    rim[20:52, left - 8 : left] = True
    off = np.where(rim, match.inverse_depth + np.float32(0.03 / PX), match.inverse_depth).astype(np.float32)
    doubted = replace(match, inverse_depth=off, cost=np.maximum(match.cost, rim).astype(np.float32))
    out, _ = continue_hidden(doubted, planes, [source()], CAMERA, HERE, photo(), PX)
    assert np.array_equal(out[rim & ~hidden()], off[rim & ~hidden()])


def test_noise_explains_a_poor_match_of_weak_texture() -> None:
    cost, variance = np.full((1, 3), 0.3, np.float32), np.array([[2.0, 60.0, 4000.0]], np.float32)
    clean, noisy = excess_cost(cost, variance, 0.0), excess_cost(cost, variance, 5.0)
    assert (noisy <= clean).all() and noisy[0, 1] == 0 and clean[0, 1] > 0.25
    assert noisy[0, 2] > 0.28


def test_an_occluder_does_not_grow_into_what_it_hides() -> None:
    # Nothing can be trusted but the board: its plane would float before the wall that the source sees.
    match, planes = drawn_frontally(cost_of_the_seen=1.0)
    match.cost[truth()[1]] = 0
    out, _ = continue_hidden(match, planes, [source()], CAMERA, HERE, photo(), PX)
    assert out[~truth()[1]].max() < 0.5 * (NEAR + FAR)


def test_without_hidden_areas_nothing_is_done() -> None:
    flat = np.full((HEIGHT, WIDTH), FAR, np.float32)
    nothing = np.zeros_like(flat)
    wall = source().scale.disparity(np.full((HEIGHT, WIDE.width), FAR, np.float32))
    seen = replace(source(), evidence=replace(source().evidence, disparity=wall))
    match = WideMatch(flat, nothing + 1, nothing + 1, nothing > 0, nothing, nothing)
    out, filled = continue_hidden(match, Planes(flat, nothing, nothing), [seen], CAMERA, HERE, photo(), PX)
    assert filled == 0 and out is flat


def test_planes_move_a_pixel_no_further_than_they_may() -> None:
    match, planes = drawn_frontally()
    moved = []
    for nearer, farther in ((9.0, 9.0), (0.02, 9.0), (9.0, 0.02)):
        bounds = replace(DEFAULT_CONTINUATION, nearer_px=nearer, farther_px=farther)
        out, _ = continue_hidden(match, planes, [source()], CAMERA, HERE, photo(), PX, bounds)
        moved.append(PX * (out - match.inverse_depth))
    free, near, far = moved
    assert np.abs(free).max() > 0.04
    bound = 0.0201 * WIDTH / continuation.WIDTH
    np.testing.assert_allclose(near, np.minimum(free, bound), atol=0.01 * bound)
    np.testing.assert_allclose(far, np.maximum(free, -bound), atol=0.01 * bound)
