"""Poses from images alone: COLMAP's incremental mapping, from several first pairs, and how well each answer does.

Schönberger & Frahm, CVPR 2016. One run is not to be trusted on a handful of views: every run registers all images
with a third of a pixel of error, right or wrong, and where texture repeats what it comes to depends on the pair that
it starts from. (A run's seed changes nothing: with a few hundred clean matches RANSAC finds the same inliers.) What
tells the runs apart is how many of all matches agree with each.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lfrig.contracts.progress import Monitor
from lfrig.processing.model import Camera, Pose
from lfrig.processing.poses.epipolar import fundamental_matrix, sampson_distance
from lfrig.processing.poses.features import Features
from lfrig.processing.poses.gate import AGREE
from lfrig.processing.poses.matching import Matches
from lfrig.processing.poses.priors import UNKNOWN_FOCAL_SIGMA
from lfrig.processing.poses.tracks import Pair

SEED = 1
STARTS = 5
"""First pairs that are tried beside COLMAP's own choice."""

MIN_TRIANGULATION_DEG = 6.0
MIN_INLIERS = 30
Mapped = dict[int, tuple[Pose, Camera]]


@dataclass(frozen=True)
class Candidate:
    """A run's result: pose and camera of every view it registered, and how many of all matches agree with it."""

    views: Mapped
    agreeing: int


def map_incrementally(
    cameras: Sequence[Camera], features: Sequence[Features], matches: Mapping[Pair, Matches], monitor: Monitor
) -> list[Candidate]:
    """What the runs come to, each in a frame and scale of its own: the best first.

    Those with most views come first, of these those that most matches agree with. Neither is proof: a backdrop that
    repeats has more matches than what stands before it, and most of one pair's may hold a false geometry together.
    """
    import pycolmap

    quiet = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = int(pycolmap.logging.Level.FATAL)
    found: list[Candidate] = []
    try:
        with tempfile.TemporaryDirectory(prefix="lfrig-") as folder:
            database = Path(folder) / "matches.db"
            verified = _write_database(database, cameras, features, matches)
            strongest = sorted(verified, key=lambda pair: (-len(verified[pair]), pair))[:STARTS]
            for start in (None, *strongest):
                monitor.advance(0)
                run = _run(database, Path(folder), cameras, start)
                if run:
                    found.append(Candidate(run, _agreeing(run, features, matches)))
    finally:
        pycolmap.logging.minloglevel = quiet
    return sorted(found, key=lambda c: (-len(c.views), -c.agreeing))


def _agreeing(run: Mapped, features: Sequence[Features], matches: Mapping[Pair, Matches]) -> int:
    """How many matches lie near the epipolar lines of a run."""
    total = 0
    for (i, j), rows in matches.items():
        if not (len(rows) and i in run and j in run):
            continue
        (first, one), (second, other) = run[i], run[j]
        fundamental = fundamental_matrix(one, first, other, second)
        distance = sampson_distance(fundamental, features[i].xy[rows[:, 0]], features[j].xy[rows[:, 1]])
        total += int((distance < AGREE * other.width).sum())
    return total


def _write_database(
    path: Path, cameras: Sequence[Camera], features: Sequence[Features], matches: Mapping[Pair, Matches]
) -> dict[Pair, Matches]:
    """Our features and matches, geometrically verified, as COLMAP wants them (pixel centres at +0.5); returns the
    matches that fit each pair's own geometry.
    """
    import pycolmap

    pycolmap.set_random_seed(SEED)
    verified = {}
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
            options.ransac.random_seed = SEED
            options.detect_watermark = False
            table = pairs.astype(np.uint32)
            geometry = pycolmap.estimate_calibrated_two_view_geometry(
                models[i], features[i].xy + 0.5, models[j], features[j].xy + 0.5, table, options
            )
            database.write_matches(i + 1, j + 1, table)
            database.write_two_view_geometry(i + 1, j + 1, geometry)
            if len(geometry.inlier_matches) >= MIN_INLIERS:
                verified[i, j] = np.asarray(geometry.inlier_matches, np.int64)
    finally:
        database.close()
    return verified


def _colmap_camera(camera: Camera, camera_id: int) -> Any:
    import pycolmap

    model = pycolmap.Camera(
        model="SIMPLE_PINHOLE", width=camera.width, height=camera.height,
        params=[camera.focal_px, camera.cx + 0.5, camera.cy + 0.5], camera_id=camera_id,
    )  # fmt: skip
    model.has_prior_focal_length = camera.sigma_focal < UNKNOWN_FOCAL_SIGMA
    return model


def _run(database: Path, folder: Path, cameras: Sequence[Camera], start: Pair | None) -> Mapped:
    """One run, from a first pair or from COLMAP's own choice of it."""
    import pycolmap

    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = SEED
    options.num_threads = 1
    options.multiple_models = False
    options.extract_colors = False
    options.min_model_size = 2
    options.ba_refine_extra_params = False
    # Focal lengths that are known to a few percent are refined later, with their prior; COLMAP has none.
    options.ba_refine_focal_length = any(c.sigma_focal >= UNKNOWN_FOCAL_SIGMA for c in cameras)
    options.mapper.abs_pose_refine_focal_length = options.ba_refine_focal_length
    options.mapper.init_min_tri_angle = MIN_TRIANGULATION_DEG
    options.mapper.init_min_num_inliers = MIN_INLIERS
    options.mapper.random_seed = SEED
    options.triangulation.ignore_two_view_tracks = False
    options.triangulation.random_seed = SEED
    pycolmap.set_random_seed(SEED)
    if start is not None:
        options.init_image_id1, options.init_image_id2 = start[0] + 1, start[1] + 1
    out = folder / ("run" if start is None else f"run{start[0]}-{start[1]}")
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
