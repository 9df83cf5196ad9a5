"""Inputs of the stress trials: exact anchors, one plane, and a case in another gauge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lfrig.bench.cases import Case
from lfrig.processing.model import (
    F64,
    U8,
    Anchors,
    Camera,
    Evidence,
    LightField,
    Optics,
    Photo,
    Pose,
    RigPrior,
    ScaleFit,
)
from lfrig.rig.truth import CaptureTruth

WIDTH, HEIGHT, FOCAL_PX = 160, 120, 300.0
TRUE_SCALE = ScaleFit(a=1 / 0.7, c=1 / 0.46)
"""bF = 0.70 px·m, focused at 0.46 m: inside the range of depths."""

DISPARITY_NOISE_PX = 0.02
PLANE_DEPTH_M, VIEWS = 0.47, 5


def exact_anchors(
    count: int, *, outliers: float = 0.0, one_depth: bool = False, mirrored: bool = False
) -> tuple[LightField, Camera, Anchors, Evidence, ScaleFit]:
    """Anchors of known depth in a light field whose evidence has `DISPARITY_NOISE_PX` of noise.

    Each anchor stands in a patch of its own, so that reading the disparity there interpolates nothing. ``outliers``
    is the share of anchors with another depth; ``mirrored`` turns the sign of the disparity. The optics are unknown.
    """
    rng = np.random.default_rng(count)
    cells = [(x, y) for y in range(8, HEIGHT - 8, 4) for x in range(8, WIDTH - 8, 4)]
    picked = rng.permutation(len(cells))[:count]
    xy = np.array([cells[i] for i in picked], np.float64).reshape(-1, 2)
    depth_m = np.full(count, PLANE_DEPTH_M) if one_depth else 1 / rng.uniform(1 / 0.8, 1 / 0.3, count)
    disparity = np.zeros((HEIGHT, WIDTH), np.float32)
    noise = 0.002 if one_depth else DISPARITY_NOISE_PX
    for (x, y), z in zip(xy.astype(int), depth_m, strict=True):
        value = (1 / z - TRUE_SCALE.c) / TRUE_SCALE.a + noise * rng.standard_normal()
        disparity[y - 1 : y + 3, x - 1 : x + 3] = -value if mirrored else value
    wrong = rng.permutation(count)[: round(outliers * count)]
    depth_m[wrong] = 1 / rng.uniform(1 / 0.8, 1 / 0.3, len(wrong))
    camera = Camera.centred(WIDTH, HEIGHT, FOCAL_PX)
    rays = np.c_[(xy - [camera.cx, camera.cy]) / FOCAL_PX, np.ones(count)]
    anchors = Anchors(xy, depth_m, rays * depth_m[:, None])
    planes = 100
    evidence = Evidence(
        probability=np.zeros((1, 1, planes), np.float16),
        planes_px=(-1.6, 3.2 / (planes - 1)),
        disparity=disparity,
        confidence=np.ones((HEIGHT, WIDTH), np.float32),
    )
    light_field = LightField("anchors", np.zeros((3, 3, HEIGHT, WIDTH, 3), np.uint8), camera)
    return light_field, camera, anchors, evidence, TRUE_SCALE


def one_plane() -> tuple[list[LightField], Photo, RigPrior, float]:
    """Two light fields and a photo of one fronto-parallel textured plane, exactly rendered: sources, photo, prior and
    the plane's depth [m].
    """
    baseline_m, focus_m = 0.0036, 0.5
    camera = Camera.centred(WIDTH, HEIGHT, FOCAL_PX)
    sources = []
    for name, x in (("000", -0.08), ("001", 0.08)):
        views = np.empty((VIEWS, VIEWS, HEIGHT, WIDTH, 3), np.uint8)
        for r, c in np.ndindex(VIEWS, VIEWS):
            shift = np.array([c, r]) - VIEWS // 2
            views[r, c] = _look(camera, x + shift[0] * baseline_m, shift[1] * baseline_m, shift * baseline_m / focus_m)
        pose = Pose(np.eye(3), np.array([-x, 0.0, 0.0]))
        sources.append(LightField(name, views, camera, Optics(baseline_m, focus_m), pose))
    photo = Photo("002", _look(camera, 0.0, 0.0, np.zeros(2)), camera, Pose(np.eye(3), np.zeros(3)))
    return sources, photo, RigPrior(depth_range_m=(0.3, 0.8)), PLANE_DEPTH_M


def rigid(rotation_deg: float, offset_m: float) -> tuple[F64, F64]:
    """A rotation about an oblique axis [3, 3] and an oblique offset [3]."""
    axis = np.array([0.36, -0.48, 0.8])
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    angle = np.deg2rad(rotation_deg)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k, offset_m * np.array([0.48, 0.6, -0.64])


def transformed(case: Case, scale: float, rotation: F64, offset: F64) -> Case:
    """The same pictures in a world that was scaled, turned and moved: X' = scale · rotation X + offset."""

    def moved(pose: Pose | None) -> Pose | None:
        if pose is None:
            return None
        turned = pose.rotation @ rotation.T
        return Pose(turned, scale * pose.translation - turned @ offset)

    def length(value: float | None) -> float | None:
        return None if value is None else scale * value

    def span(limits: tuple[float, float] | None) -> tuple[float, float] | None:
        return None if limits is None else (scale * limits[0], scale * limits[1])

    sources = [
        replace(
            source, pose=moved(source.pose), depth_range_m=span(source.depth_range_m),
            optics=replace(source.optics, baseline_m=length(source.optics.baseline_m),
                           focus_distance_m=length(source.optics.focus_distance_m)),
        )
        for source in case.sources
    ]  # fmt: skip
    truth: CaptureTruth = replace(
        case.truth, inverse_depth=case.truth.inverse_depth / np.float32(scale),
        baseline_m=length(case.truth.baseline_m), focus_distance_m=length(case.truth.focus_distance_m),
    )  # fmt: skip
    # The rig's own frame is not that of the world any more: the poses in the captures count.
    prior = replace(
        case.prior, light_field_from_plate=None, target_from_plate=None, depth_range_m=span(case.prior.depth_range_m)
    )
    return replace(
        case, sources=sources, target=replace(case.target, pose=moved(case.target.pose)), truth=truth, prior=prior
    )


def _look(camera: Camera, x_m: float, y_m: float, shear: F64) -> U8:
    """The plane as seen from (x, y, 0), uint8 [H, W, 3]; ``shear`` moves the principal point, as off-axis views
    do.
    """
    ys, xs = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float64)
    u = ((xs - camera.cx) / FOCAL_PX - shear[0]) * PLANE_DEPTH_M + x_m
    v = ((ys - camera.cy) / FOCAL_PX - shear[1]) * PLANE_DEPTH_M + y_m
    rng = np.random.default_rng(0)
    picture = np.zeros((camera.height, camera.width, 3))
    # A band-limited texture without repetition: waves of 4 to 20 px in all directions.
    for _ in range(16):
        period_m = rng.uniform(4, 20) * PLANE_DEPTH_M / FOCAL_PX
        angle, phase = rng.uniform(0, np.pi), rng.uniform(0, 2 * np.pi)
        wave = np.sin(2 * np.pi * (np.cos(angle) * u + np.sin(angle) * v) / period_m + phase)
        picture += wave[..., None] * rng.uniform(0.3, 1, 3)
    return np.asarray(np.clip(np.rint(128 + 24 * picture), 0, 255), np.uint8)
