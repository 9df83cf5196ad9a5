"""The simulated rig: what its devices really do, and what it would know and record of that.

Every random quantity is drawn from (seed, what it belongs to), never from a running generator, so a capture is the
same whether it is shot alone, again, or after others.
"""

from __future__ import annotations

import functools
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.capture import CaptureDocument, RawSpec, ViewsSpec
from lfrig.contracts.progress import Monitor
from lfrig.contracts.session import CameraMount, RigCameras, RigSpec
from lfrig.contracts.truth import TruthCapture
from lfrig.sim.cache import cached, scene_digest, source_digest
from lfrig.sim.optics import SimCamera, look_at, view_offsets
from lfrig.sim.plenoptic.camera import PlenopticCamera, RawShot
from lfrig.sim.recorded import recorded_camera, recorded_exposure, recorded_mount, recorded_optics
from lfrig.sim.renderer import VERSION, render_depth, render_radiance
from lfrig.sim.scene import F32, F64, PackedScene, Scene, pack
from lfrig.sim.scenes import RigOptics, build_scene, check_scene_name, optics_of
from lfrig.sim.tone import U8, Exposure, add_noise, develop

Poses = Literal["prior", "given"]
ROWS = COLS = 7
FULL_WIDTH = 541

TURNTABLE_SIGMA_DEG = 0.3
RIG_DEPTH_RANGE_M = (0.25, 0.90)

PIXELS_PER_MM = 50.0  # at 541 px: a sensor 10.8 mm wide
BASELINE_PER_FOCAL = 1 / 30  # adjacent views: 1/15 of the pupil of an f/2 lens
REQUEST_BF = 0.70  # px m at 541 px width
REQUEST_FOCUS_M = 0.46
LIGHT_FIELD_SAMPLES = 4
PHOTO_SAMPLES = 16
TRUTH_SAMPLES = 9  # 44 dB from the limit of many samples; 4 would be 40 dB, as much as good results reach


@dataclass(frozen=True, eq=False)
class CaptureTruth:
    """What really was: ``depth_m`` float32 [H, W] of the centre view; ``views`` uint8 [7, 7, H, W, 3] without noise
    (None when they were not asked for); ``record`` for truth.json.
    """

    record: TruthCapture
    depth_m: F32
    views: U8 | None


@dataclass(frozen=True, eq=False)
class SimulatedCapture:
    """One shot. ``pixels`` uint8: views [7, 7, H, W, 3] of a light field, [H, W, 3] of a photo."""

    pixels: U8
    document: CaptureDocument
    truth: CaptureTruth


@functools.lru_cache(maxsize=2)
def _library_scene(name: str, seed: int) -> PackedScene:
    return pack(build_scene(name, seed))


def target_size(width: int, height: int) -> tuple[int, int]:
    """Size of the target camera's photo beside light-field views of ``width`` × ``height``: about as wide,
    3:2, never the same.
    """
    wide = 2 * (width // 2)
    high = 2 * round(wide / 3)
    return (wide, high) if (wide, high) != (width, height) else (wide - 6, high - 4)


class SimulatedRig:
    """Devices' true state and their records, for one scene and seed.

    Parameters
    ----------
    scene : str or Scene
        A name of the library, or a scene of one's own (shot with the tuning half's optics).
    width, height : int
        Size of a light-field view; the photo's follows (`target_size`).
    noise_sigma : float
        Gaussian noise on recorded pixels [grey levels].
    poses : {"prior", "given"}
        ``given`` records exact poses and focal lengths in each capture.
    cache_dir : Path, optional
        Where renders are kept between runs; None keeps nothing.
    """

    def __init__(
        self,
        scene: str | Scene,
        width: int,
        height: int,
        *,
        seed: int = 0,
        noise_sigma: float = 0.0,
        poses: Poses = "prior",
        threads: int = 0,
        cache_dir: Path | None = None,
    ) -> None:
        if isinstance(scene, str):
            check_scene_name(scene)
            self.scene_name = scene
            self._pack: Callable[[], PackedScene] = functools.partial(_library_scene, scene, seed)
            self._digest: tuple[object, ...] = (source_digest(), scene, seed)
        else:
            packed = pack(scene)
            self.scene_name = scene.name
            self._pack = lambda: packed
            self._digest = (scene_digest(packed),)
        self.optics: RigOptics = optics_of(self.scene_name)
        self.width, self.height, self.seed = width, height, seed
        self.noise_sigma, self.poses, self.threads, self.cache_dir = noise_sigma, poses, threads, cache_dir

    # What is true ------------------------------------------------------------------------------------------------

    def random(self, *what: object) -> np.random.Generator:
        """A generator of its own for whatever ``what`` names."""
        return np.random.default_rng([self.seed, zlib.crc32(repr((self.scene_name, *what)).encode())])

    @property
    def view_pixel_m(self) -> float:
        """Width on the sensor of a pixel of the light-field camera's views [m]."""
        return FULL_WIDTH / (1000 * PIXELS_PER_MM * self.width)

    def packed(self) -> PackedScene:
        """The scene as the renderers take it."""
        return self._pack()

    def rendered(self, key: tuple[object, ...], make: Callable[[], NDArray[np.generic]]) -> NDArray[np.generic]:
        """``make()`` through the rig's cache; ``key`` says all that it depends on besides the scene."""
        return cached(self.cache_dir, (key[0], key[1], *self._digest, *key[2:]), make)

    def true_angle_deg(self, commanded_deg: float) -> float:
        """Where the plate really stands."""
        return commanded_deg + TURNTABLE_SIGMA_DEG * self.random("angle", round(commanded_deg, 6)).standard_normal()

    def _mount(self, target: bool) -> tuple[F64, F64]:
        """True (R, t) of a camera to the plate at angle 0. The target camera stands a little aside and above."""
        rng = self.random("mount", target)
        elevation = rng.uniform(*self.optics.elevation_deg) + (rng.uniform(1.0, 2.5) if target else 0.0)
        azimuth = rng.uniform(-2.0, 2.0) if target else 0.0
        distance = rng.uniform(*self.optics.distance_m) + (rng.uniform(0.0, 0.02) if target else 0.0)
        e, a = np.deg2rad([elevation, azimuth])
        centre = distance * np.array([np.cos(e) * np.sin(a), -np.cos(e) * np.cos(a), np.sin(e)])
        aim = np.array([0.0, 0.0, 0.040]) + rng.normal(0, 0.002, 3)
        return look_at(centre, aim)

    def lens(self, index: int | str) -> tuple[float, float]:
        """True focal length [mm] and focus distance [m] of the light-field camera at a shot."""
        rng = self.random("lens", index)
        return rng.uniform(*self.optics.zoom_mm), rng.uniform(*self.optics.focus_m)

    def light_field_camera(self, index: int | str, commanded_deg: float) -> SimCamera:
        """True state of the light-field camera at its ``index``-th shot: each has its own zoom and focus."""
        zoom_mm, focus_m = self.lens(index)
        focal_px = _image_distance_mm(zoom_mm, focus_m) * PIXELS_PER_MM * self.width / FULL_WIDTH
        still = SimCamera(
            self.width, self.height, focal_px, zoom_mm * BASELINE_PER_FOCAL / 1000, focus_m, *self._mount(False)
        )
        return still.on_plate_at(self.true_angle_deg(commanded_deg))

    def target_camera(self, commanded_deg: float) -> SimCamera:
        """True state of the target camera; baseline and focus are those of the light field to be made."""
        width, height = target_size(self.width, self.height)
        zoom_mm = self.random("target lens").uniform(*self.optics.target_mm)
        focal_px = _image_distance_mm(zoom_mm, REQUEST_FOCUS_M) * PIXELS_PER_MM * width / FULL_WIDTH
        baseline = REQUEST_BF * width / FULL_WIDTH / focal_px
        still = SimCamera(width, height, focal_px, baseline, REQUEST_FOCUS_M, *self._mount(True))
        return still.on_plate_at(self.true_angle_deg(commanded_deg))

    def exposure(self, index: int, *, target: bool = False) -> Exposure:
        """Exposure and white balance of a shot: they drift from shot to shot, and the target camera differs more."""
        rng = self.random("exposure", index, target)
        gain = 1.5 * rng.uniform(0.72, 1.25) if target else 1.5 * rng.uniform(0.85, 1.18)
        red, blue = rng.uniform(0.90, 1.10, 2) if target else rng.uniform(0.94, 1.06, 2)
        return Exposure(float(gain), (float(red), 1.0, float(blue)))

    # What is recorded --------------------------------------------------------------------------------------------

    def rig_spec(self) -> RigSpec:
        """What the rig knows of itself: mounts with errors, and how large those may be."""
        light_field, target = (recorded_mount(*self._mount(t), self.random("mount error", t)) for t in (False, True))
        return RigSpec(
            cameras=RigCameras(
                light_field=CameraMount(camera_from_plate=light_field), target=CameraMount(camera_from_plate=target)
            ),
            turntable_sigma_deg=TURNTABLE_SIGMA_DEG,
            depth_range_m=RIG_DEPTH_RANGE_M,
        )

    def _focal_error(self, *what: object) -> np.random.Generator | None:
        return self.random("focal error", *what) if self.poses == "prior" else None

    # Shots -------------------------------------------------------------------------------------------------------

    def shoot_light_field(self, index: int, commanded_deg: float, monitor: Monitor | None = None) -> SimulatedCapture:
        """The light-field camera's ``index``-th shot, with the plate commanded to ``commanded_deg``."""
        truth = self.light_field_truth(index, commanded_deg, monitor)
        assert truth.views is not None
        document = self.light_field_document(index, commanded_deg, views=ViewsSpec(rows=ROWS, cols=COLS))
        return SimulatedCapture(self._noisy(truth.views, "light field", index), document, truth)

    def light_field_document(
        self, index: int, commanded_deg: float, *, views: ViewsSpec | None = None, raw: RawSpec | None = None
    ) -> CaptureDocument:
        """What is recorded of the light-field camera's ``index``-th shot, whichever way its pixels are."""
        camera = self.light_field_camera(index, commanded_deg)
        return CaptureDocument(
            kind="light_field",
            views=views,
            raw=raw,
            camera=recorded_camera(camera, self._focal_error("light field", index)),
            optics=recorded_optics(camera, self.random("optics error", index)),
            exposure=recorded_exposure(self.exposure(index)),
            depth_range_m=RIG_DEPTH_RANGE_M,
            turntable_deg=commanded_deg,
            pose=camera.pose_spec() if self.poses == "given" else None,
        )

    def light_field_truth(
        self, index: int, commanded_deg: float, monitor: Monitor | None = None, *, views: bool = True,
        noise_sigma: float | None = None,
    ) -> CaptureTruth:  # fmt: skip
        """What really was at that shot, with or without its views; ``noise_sigma`` where it is not the rig's own."""
        camera, exposure = self.light_field_camera(index, commanded_deg), self.exposure(index)
        what = ("light field", index)
        shown = self._views(camera, exposure, LIGHT_FIELD_SAMPLES, 1.0, what, monitor) if views else None
        return self._truth(camera, "light_field", commanded_deg, shown, noise_sigma)

    def shoot_raw(
        self, index: int, commanded_deg: float, monitor: Monitor | None = None, *, truth_views: bool = True
    ) -> RawShot:
        """The same shot as `shoot_light_field` takes, as an Illum's raw file; see `PlenopticCamera.shoot`."""
        return PlenopticCamera(self).shoot(index, commanded_deg, monitor, truth_views=truth_views)

    def shoot_photo(
        self, index: int, commanded_deg: float, monitor: Monitor | None = None, *, truth_views: bool = True
    ) -> SimulatedCapture:
        """The target camera's photo; its truth is the light field that it would have taken from there.

        ``truth_views`` False spares the 48 views that only scoring needs.
        """
        camera = self.target_camera(commanded_deg)
        exposure = self.exposure(index, target=True)
        what = ("photo", index)
        photo = self._views(camera, exposure, PHOTO_SAMPLES, 0.0, what, None, centre_only=True)[0, 0]
        views = None
        if truth_views:
            views = self._views(camera, exposure, TRUTH_SAMPLES, 0.0, what, monitor)
            views[ROWS // 2, COLS // 2] = photo
        document = CaptureDocument(
            kind="photo",
            image="photo.png",
            camera=recorded_camera(camera, self._focal_error("photo", index)),
            exposure=recorded_exposure(exposure),
            turntable_deg=commanded_deg,
            pose=camera.pose_spec() if self.poses == "given" else None,
        )
        truth = self._truth(camera, "photo", commanded_deg, views)
        return SimulatedCapture(self._noisy(photo, *what), document, truth)

    def _noisy(self, pixels: U8, *what: object) -> U8:
        return add_noise(pixels, self.noise_sigma, [self.seed, zlib.crc32(repr(("noise", *what)).encode())])

    def _truth(
        self, camera: SimCamera, kind: str, commanded_deg: float, views: U8 | None, noise_sigma: float | None = None
    ) -> CaptureTruth:
        centre = np.zeros((1, 2))
        key = ("depth", VERSION, camera.record().tobytes(), camera.width, camera.height)
        depth = self.rendered(key, lambda: render_depth(self._pack(), camera, centre, threads=self.threads)[0])
        record = TruthCapture(
            kind=kind,
            camera=camera.camera_spec(sigma_f=0.0),
            optics=camera.optics_spec(),
            pose=camera.pose_spec(),
            turntable_deg=self.true_angle_deg(commanded_deg),
            views=ViewsSpec(rows=ROWS, cols=COLS) if views is not None else None,
            noise_sigma=self.noise_sigma if noise_sigma is None else noise_sigma,
        )
        return CaptureTruth(record, np.asarray(depth, np.float32), views)

    def _views(
        self, camera: SimCamera, exposure: Exposure, samples: int, aperture: float, what: tuple[str, int],
        monitor: Monitor | None, *, centre_only: bool = False,
    ) -> U8:  # fmt: skip
        """uint8 [rows, cols, H, W, 3] without noise, or [1, 1, H, W, 3] of the centre."""
        rows, cols = (1, 1) if centre_only else (ROWS, COLS)
        seed = zlib.crc32(repr((self.seed, *what)).encode())

        def make() -> U8:
            scene = self._pack()
            out = np.empty((rows, cols, camera.height, camera.width, 3), np.uint8)
            offsets = view_offsets(rows, cols).reshape(rows, cols, 2)
            for r in range(rows):
                radiance = render_radiance(
                    scene, camera, offsets[r], samples=samples, aperture=aperture, seed=seed,
                    threads=self.threads,
                )  # fmt: skip
                out[r] = develop(radiance, exposure)
                if monitor is not None:
                    monitor.advance(cols)
            return out

        size = (camera.width, camera.height, rows, cols)
        key = ("views", VERSION, camera.record().tobytes(), size, samples, aperture, seed, exposure)
        return np.asarray(self.rendered(key, make), np.uint8)


def _image_distance_mm(focal_mm: float, focus_m: float) -> float:
    """Distance of the sensor behind a thin lens focused at ``focus_m``: the focal length in the pinhole sense."""
    return focal_mm * focus_m / (focus_m - focal_mm / 1000)
