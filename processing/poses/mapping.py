"""Poses from images alone: COLMAP's incremental mapping, several times, and the answer that the runs agree on.

Schönberger & Frahm, CVPR 2016. One run is not to be trusted on a handful of views: every run registers all images
with a third of a pixel of error, and the rotation may still be 0.1 to 10° off, depending on the seed.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lfrig.contracts.progress import Monitor
from lfrig.processing.geometry import rotation_angle_deg
from lfrig.processing.model import Camera, Pose
from lfrig.processing.poses.features import Features
from lfrig.processing.poses.matching import Matches
from lfrig.processing.poses.priors import UNKNOWN_FOCAL_SIGMA
from lfrig.processing.poses.tracks import Pair

SEEDS = (1, 2, 3, 4, 5)
MIN_TRIANGULATION_DEG = 6.0
DISAGREEMENT_DEG = 1.0

Mapped = dict[int, tuple[Pose, Camera]]


def map_incrementally(
    cameras: Sequence[Camera], features: Sequence[Features], matches: Mapping[Pair, Matches], monitor: Monitor
) -> Mapped:
    """Pose and camera of every view that could be registered, in a frame and scale of their own.

    The run whose relative rotations are nearest to those of the others is returned; a warning tells when they differ.
    """
    import pycolmap

    quiet = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = int(pycolmap.logging.Level.FATAL)
    runs: list[Mapped] = []
    try:
        with tempfile.TemporaryDirectory(prefix="lfrig-") as folder:
            database = Path(folder) / "matches.db"
            _write_database(database, cameras, features, matches)
            for seed in SEEDS:
                monitor.advance(0)
                run = _run(database, Path(folder), cameras, seed)
                if run:
                    runs.append(run)
    finally:
        pycolmap.logging.minloglevel = quiet
    if not runs:
        return {}
    most = max(len(r) for r in runs)
    runs = [r for r in runs if len(r) == most and r.keys() == max(runs, key=len).keys()]
    distance = [[_disagreement_deg(a, b) for b in runs] for a in runs]
    middle = int(np.argmin(np.median(distance, axis=1)))
    spread = float(np.median(distance[middle]))
    if spread > DISAGREEMENT_DEG:
        monitor.warn(
            "unstable-poses",
            f"structure from motion gives rotations that differ by {spread:.1f}° from run to run; record the "
            "turntable's angles or the poses",
        )
    return runs[middle]


def _disagreement_deg(a: Mapped, b: Mapped) -> float:
    """Largest difference of rotations relative to the first view."""
    first, *others = sorted(a)
    return max(
        (
            rotation_angle_deg(a[v][0].rotation @ a[first][0].rotation.T, b[v][0].rotation @ b[first][0].rotation.T)
            for v in others
        ),
        default=0.0,
    )


def _write_database(
    path: Path, cameras: Sequence[Camera], features: Sequence[Features], matches: Mapping[Pair, Matches]
) -> None:
    """Our features and matches, geometrically verified, as COLMAP wants them (pixel centres at +0.5)."""
    import pycolmap

    pycolmap.set_random_seed(SEEDS[0])
    database = pycolmap.Database.open(str(path))
    try:
        models = []
        for view, (camera, f) in enumerate(zip(cameras, features, strict=True)):
            model = _colmap_camera(camera, view + 1)
            models.append(model)
            rig = pycolmap.Rig(rig_id=view + 1)
            sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, view + 1)
            rig.add_ref_sensor(sensor)
            database.write_camera(model, use_camera_id=True)
            database.write_rig(rig, use_rig_id=True)
            image = pycolmap.Image(name=f"{view:04d}", camera_id=view + 1, image_id=view + 1)
            database.write_image(image, use_image_id=True)
            frame = pycolmap.Frame(frame_id=view + 1, rig_id=view + 1)
            frame.add_data_id(pycolmap.data_t(sensor, view + 1))
            database.write_frame(frame, use_frame_id=True)
            database.write_keypoints(view + 1, (f.xy + 0.5).astype(np.float32))
        for (i, j), pairs in matches.items():
            if len(pairs) < 8:
                continue
            options = pycolmap.TwoViewGeometryOptions()
            options.ransac.random_seed = SEEDS[0]
            options.detect_watermark = False
            table = pairs.astype(np.uint32)
            geometry = pycolmap.estimate_calibrated_two_view_geometry(
                models[i], features[i].xy + 0.5, models[j], features[j].xy + 0.5, table, options
            )
            database.write_matches(i + 1, j + 1, table)
            database.write_two_view_geometry(i + 1, j + 1, geometry)
    finally:
        database.close()


def _colmap_camera(camera: Camera, camera_id: int) -> Any:
    import pycolmap

    model = pycolmap.Camera(
        model="SIMPLE_PINHOLE", width=camera.width, height=camera.height,
        params=[camera.focal_px, camera.cx + 0.5, camera.cy + 0.5], camera_id=camera_id,
    )  # fmt: skip
    model.has_prior_focal_length = camera.sigma_focal < UNKNOWN_FOCAL_SIGMA
    return model


def _run(database: Path, folder: Path, cameras: Sequence[Camera], seed: int) -> Mapped:
    import pycolmap

    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = seed
    options.num_threads = 1
    options.multiple_models = False
    options.extract_colors = False
    options.min_model_size = 2
    options.ba_refine_extra_params = False
    # Focal lengths that are known to a few percent are refined later, with their prior; COLMAP has none.
    options.ba_refine_focal_length = any(c.sigma_focal >= UNKNOWN_FOCAL_SIGMA for c in cameras)
    options.mapper.abs_pose_refine_focal_length = options.ba_refine_focal_length
    options.mapper.init_min_tri_angle = MIN_TRIANGULATION_DEG
    options.mapper.init_min_num_inliers = 30
    options.mapper.random_seed = seed
    options.triangulation.ignore_two_view_tracks = False
    options.triangulation.random_seed = seed
    pycolmap.set_random_seed(seed)
    out = folder / f"run{seed}"
    out.mkdir()
    models = pycolmap.incremental_mapping(str(database), str(folder), str(out), options)
    if not models:
        return {}
    best = max(models.values(), key=lambda m: m.num_reg_images())
    result: Mapped = {}
    for image in best.images.values():
        if not image.has_pose:
            continue
        view = image.image_id - 1
        transform = image.cam_from_world()
        pose = Pose(np.array(transform.rotation.matrix(), np.float64), np.array(transform.translation, np.float64))
        focal = float(best.cameras[image.camera_id].params[0])
        result[view] = (pose, replace(cameras[view], focal_px=focal))
    return result
