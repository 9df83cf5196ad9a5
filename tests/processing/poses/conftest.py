"""A small textured scene on a turntable, ray-cast in NumPy: exact poses and depths, no simulator needed."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from lfrig.processing import geometry
from lfrig.processing.model import Camera, Evidence, LightField, Optics, Photo, Pose, RigPrior

FOCUS_M = 0.46
BASELINE_TIMES_FOCAL = 0.7


@dataclass(frozen=True)
class Rectangle:
    """``corner + a·u + b·v`` for a, b in 0..1, with a texture stretched over it."""

    corner: np.ndarray
    u: np.ndarray
    v: np.ndarray
    texture: np.ndarray


def texture(seed: int, size: int = 256) -> np.ndarray:
    """Band-limited noise with detail at every scale, float32 [size, size, 3] 0..255."""
    import cv2

    rng = np.random.default_rng(seed)
    total = np.zeros((size, size, 3), np.float32)
    for octave in range(1, size.bit_length() - 1):
        coarse = rng.normal(size=(2**octave + 3, 2**octave + 3, 3)).astype(np.float32)
        total += cv2.resize(coarse, (size, size), interpolation=cv2.INTER_CUBIC) / octave
    return np.clip(total / total.std() * 45 + 128, 0, 255)


def box(centre: tuple[float, float], size: tuple[float, float, float], yaw_deg: float, seed: int) -> list[Rectangle]:
    """The four sides and the top of a box that stands on the plate."""
    yaw = np.deg2rad(yaw_deg)
    x, y = np.array([np.cos(yaw), np.sin(yaw), 0]) * size[0], np.array([-np.sin(yaw), np.cos(yaw), 0]) * size[1]
    z, o = np.array([0, 0, size[2]]), np.array([*centre, 0.0])
    o = o - x / 2 - y / 2
    faces = [(o, x, z), (o + y, x, z), (o, y, z), (o + x, y, z), (o + z, x, y)]
    return [Rectangle(*f, texture(seed * 10 + i)) for i, f in enumerate(faces)]


@functools.cache
def still_life(seed: int = 0) -> tuple[Rectangle, ...]:
    """Three boxes on a textured plate."""
    plate = Rectangle(np.array([-0.2, -0.2, 0]), np.array([0.4, 0, 0]), np.array([0, 0.4, 0]), texture(seed + 7, 512))
    return (
        plate,
        *box((0.03, -0.02), (0.06, 0.05, 0.08), 20, seed + 1),
        *box((-0.05, 0.02), (0.05, 0.05, 0.05), -35, seed + 2),
        *box((0.0, 0.08), (0.12, 0.03, 0.11), 5, seed + 3),
    )


@functools.cache
def picture(scene_seed: int, camera: Camera, target: bool, angle_deg: float) -> tuple[np.ndarray, np.ndarray, Pose]:
    """What one of the two cameras sees with the plate at an angle: image, depth and the true pose; rendered once."""
    pose = geometry.turntable_pose(mount(29.0, 0.5, 0.035) if target else mount(), angle_deg)
    return *render(still_life(scene_seed), camera, pose), pose


def render(scene: Sequence[Rectangle], camera: Camera, pose: Pose, samples: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Image uint8 [H, W, 3] and depth float64 [H, W] along the optical axis (inf where nothing is hit)."""
    import cv2

    h, w = camera.height, camera.width
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    image = np.zeros((h, w, 3), np.float32)
    for dy in (*offsets, None):
        for dx in offsets if dy is not None else (0.0,):
            ys, xs = np.mgrid[0:h, 0:w].astype(float)
            rays = np.stack([xs + dx - camera.cx, ys + (dy or 0.0) - camera.cy], -1) / camera.focal_px
            rays = np.concatenate([rays, np.ones((h, w, 1))], -1) @ pose.rotation
            depth, colour = np.full((h, w), np.inf), np.full((h, w, 3), 40, np.float32)
            for r in scene:
                normal = np.cross(r.u, r.v)
                with np.errstate(divide="ignore", invalid="ignore"):
                    t = (r.corner - pose.centre) @ normal / (rays @ normal)
                    hit = pose.centre + rays * t[..., None] - r.corner
                a, b = hit @ r.u / (r.u @ r.u), hit @ r.v / (r.v @ r.v)
                seen = (t > 0) & (t < depth) & (a >= 0) & (a <= 1) & (b >= 0) & (b <= 1)
                if not seen.any():
                    continue
                depth[seen] = t[seen]
                size = r.texture.shape[0] - 1
                a, b = (np.where(seen, c * size, 0).astype(np.float32) for c in (a, b))
                colour[seen] = cv2.remap(r.texture, a, b, cv2.INTER_LINEAR)[seen]
            if dy is None:
                return np.clip(image / samples**2 + 0.5, 0, 255).astype(np.uint8), depth
            image += colour
    raise AssertionError("unreachable")


def mount(elevation_deg: float = 25.0, radius_m: float = 0.46, look_z_m: float = 0.04, **sigmas: float) -> Pose:
    """Camera that looks at the axis of the plate from ``radius_m`` away."""
    e = np.deg2rad(elevation_deg)
    centre = np.array([0, -radius_m * np.cos(e), look_z_m + radius_m * np.sin(e)])
    z = np.array([0, 0, look_z_m]) - centre
    z /= np.linalg.norm(z)
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z])
    return Pose(rotation, -rotation @ centre, **sigmas)


def disturbed(pose: Pose, rng: np.random.Generator, sigma_deg: float, sigma_m: float) -> Pose:
    """The pose as a calibration with these errors would report it, with the sigmas written into it."""
    import cv2

    turn = cv2.Rodrigues(rng.normal(0, np.deg2rad(sigma_deg), 3))[0]
    return Pose(turn @ pose.rotation, turn @ pose.translation + rng.normal(0, sigma_m, 3), sigma_deg, sigma_m)


@dataclass
class Shoot:
    """A simulated shoot: what the pose stage is given, and beside it the truth."""

    sources: list[LightField]
    evidence: list[Evidence]
    target: Photo
    prior: RigPrior
    true_poses: list[Pose]
    true_cameras: list[Camera]
    depths: list[np.ndarray]
    true_target_pose: Pose
    true_target_camera: Camera
    target_depth: np.ndarray
    extra: dict = field(default_factory=dict)

    def arguments(self) -> tuple:
        """The leading arguments of `solve_poses`."""
        return self.sources, self.evidence, self.target, self.prior

    def rotation_error_deg(self, solution) -> float:
        """Largest error of a source's rotation relative to the first."""
        first, true = solution.poses[0].rotation, self.true_poses[0].rotation
        return max(
            geometry.rotation_angle_deg(p.rotation @ first.T, t.rotation @ true.T)
            for p, t in zip(solution.poses, self.true_poses, strict=True)
        )

    def depth_ratios(self, solution, source) -> np.ndarray:
        """Anchor depth over true depth; of the pixels around a keypoint (they sit on edges) the one that fits best."""
        anchors, truth = solution.anchors[source], self.depths[source]
        x = np.clip(np.rint(anchors.xy[:, 0]).astype(int), 1, truth.shape[1] - 2)
        y = np.clip(np.rint(anchors.xy[:, 1]).astype(int), 1, truth.shape[0] - 2)
        around = np.stack([anchors.depth_m / truth[y + j, x + i] for i in (-1, 0, 1) for j in (-1, 0, 1)])
        return around[np.abs(np.log(np.maximum(around, 1e-9))).argmin(0), np.arange(len(anchors))]

    def target_error_px(self, solution) -> float:
        """Median distance in the sources between where a target pixel's true point lies and where the solution puts it,
        with the target's depths in whatever scale fits best.
        """
        depth = self.target_depth
        ys, xs = np.mgrid[6 : depth.shape[0] - 6 : 9, 6 : depth.shape[1] - 6 : 9]
        hit = np.isfinite(depth[ys, xs])
        xy, z = np.c_[xs[hit], ys[hit]].astype(float), depth[ys[hit], xs[hit]]
        true = geometry.world_points(self.true_target_camera, self.true_target_pose, xy, z)
        anchors = np.concatenate([self.depth_ratios(solution, k) for k in range(len(self.sources))])
        errors = []
        for scale in np.median(anchors) * np.arange(0.98, 1.0201, 0.001):
            ours = geometry.world_points(solution.target_camera, solution.target_pose, xy, z * scale)
            in_sources = []
            for k, pose in enumerate(solution.poses):
                a, _ = geometry.project_points(self.true_cameras[k], self.true_poses[k], true)
                b, _ = geometry.project_points(solution.cameras[k], pose, ours)
                in_sources.append(np.median(np.linalg.norm(a - b, axis=1)))
            errors.append(max(in_sources))
        return float(min(errors))


def shoot(
    angles_deg: tuple[float, ...] = (-15.0, 0.0, 15.0),
    target_deg: float = 6.0,
    *,
    width: int = 240,
    height: int = 168,
    seed: int = 0,
    scene: int = 0,
    noise: float = 1.0,
    sigma_angle_deg: float = 0.3,
    sigma_mount_deg: float = 1.0,
    sigma_mount_m: float = 0.0046,
    sigma_focal: float = 0.0,
    given: bool = False,
    light_fields: bool = False,
    sigma_optics: float = 0.03,
) -> Shoot:
    """Shoot the scene at the plate angles; the priors are off by draws from their sigmas.

    With ``light_fields`` the captures' views differ as they should, and their optics are recorded; else every view is
    the centre view.
    """
    rng = np.random.default_rng(seed)
    scale = width / 541
    lf_mount, photo_mount = mount(), mount(29.0, 0.5, 0.035)
    sources, evidence, poses, cameras, depths = [], [], [], [], []
    for k, angle in enumerate(angles_deg):
        camera = Camera.centred(width, height, 1045 * scale * (1 + 0.04 * (k % 2)))
        image, depth, pose = picture(scene, camera, False, angle)
        image = np.clip(image * (1 - 0.08 * (k % 3)) + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8)
        poses.append(pose), cameras.append(camera), depths.append(depth)
        said = replace(camera, focal_px=camera.focal_px * (1 + rng.normal(0, 1) * sigma_focal), sigma_focal=sigma_focal)
        optics, views = Optics(), np.broadcast_to(image, (3, 3, *image.shape))
        if light_fields:
            error = 1 + rng.normal(0, sigma_optics, 2)
            baseline = BASELINE_TIMES_FOCAL / camera.focal_px
            optics = Optics(baseline * error[0], FOCUS_M * error[1], sigma_optics)
            views = views_of(image, depth, rng, noise)
        sources.append(
            LightField(
                f"{k:03d}",
                views,
                said,
                optics,
                pose if given else None,
                None if given else angle + rng.normal(0, sigma_angle_deg),
            )
        )
        evidence.append(evidence_of(depth, rng))
    camera = Camera.centred(round(width * 1.1), round(height * 1.05), 1160 * scale)
    image, depth, pose = picture(scene, camera, True, target_deg)
    image = np.clip(image * 0.8 + 12 + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8)
    said = replace(camera, focal_px=camera.focal_px * (1 + rng.normal(0, 1) * sigma_focal), sigma_focal=sigma_focal)
    target = Photo("photo", image, said, pose if given else None, None if given else target_deg)
    prior = RigPrior(
        None if given else disturbed(lf_mount, rng, sigma_mount_deg, sigma_mount_m),
        None if given else disturbed(photo_mount, rng, sigma_mount_deg, sigma_mount_m),
        sigma_angle_deg,
    )
    return Shoot(sources, evidence, target, prior, poses, cameras, depths, pose, camera, depth)


def disparity_of(depth: np.ndarray) -> np.ndarray:
    """True disparity [px per view step] of a depth map; of the background where nothing was hit."""
    return BASELINE_TIMES_FOCAL * (1 / np.where(np.isfinite(depth), depth, 2.0) - 1 / FOCUS_M)


def views_of(
    image: np.ndarray, depth: np.ndarray, rng: np.random.Generator, noise: float = 0.0, rows: int = 3, cols: int = 3
) -> np.ndarray:
    """Views of a light field whose centre view is ``image``: uint8 [rows, cols, H, W, 3].

    A view's pixel q shows what the centre view has at p = q + offset · δ(p), solved for by iteration: right wherever
    nothing is hidden.
    """
    import cv2

    disparity = disparity_of(depth).astype(np.float32)
    ys, xs = np.mgrid[0 : depth.shape[0], 0 : depth.shape[1]].astype(np.float32)
    out = np.empty((rows, cols, *image.shape), np.uint8)
    for r in range(rows):
        for c in range(cols):
            dr, dc = r - (rows - 1) // 2, c - (cols - 1) // 2
            if dr == dc == 0:
                out[r, c] = image
                continue
            u, v = xs, ys
            for _ in range(3):
                at = cv2.remap(disparity, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
                u, v = xs + dc * at, ys + dr * at
            # OpenCV's cubic is off by up to 0.05 px on a ramp.
            seen = cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float64)
            out[r, c] = np.clip(seen + rng.normal(0, noise, seen.shape) + 0.5, 0, 255)
    return out


def evidence_of(depth: np.ndarray, rng: np.random.Generator) -> Evidence:
    """What a depth stage would say of this depth map: peak disparity with a little noise, no volume worth reading."""
    disparity = (disparity_of(depth) + rng.normal(0, 0.01, depth.shape)).astype(np.float32)
    volume = np.full((*depth.shape, 2), 0.5, np.float16)
    return Evidence(volume, (-1.0, 2.0), disparity, np.full(depth.shape, 0.9, np.float32))


@pytest.fixture(scope="session")
def still() -> Shoot:
    """Three sources and a photo with imperfect priors; shared, read only."""
    return shoot()


@pytest.fixture(scope="session")
def light_still() -> Shoot:
    """The same as light fields, with wider priors; shared, read only."""
    return shoot(light_fields=True, sigma_focal=0.02, sigma_angle_deg=0.5, seed=4)


@pytest.fixture(scope="session")
def studio():
    """The functions of this file, for tests that need their own shoot."""
    import types

    return types.SimpleNamespace(
        shoot=shoot,
        render=render,
        mount=mount,
        disturbed=disturbed,
        still_life=still_life,
        evidence_of=evidence_of,
        views_of=views_of,
        disparity_of=disparity_of,
    )
