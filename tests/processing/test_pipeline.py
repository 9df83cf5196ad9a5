"""The stages from evidence to views on a tiny analytic scene: accuracy, invariances, refusals."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfrig.contracts.errors import BadInput, GeometryRefused, Interrupted, NotInThisVersion, UsageError
from lfrig.contracts.progress import Monitor
from lfrig.processing.dpv import light_field_evidence
from lfrig.processing.edges import EdgeSettings, decide_edges
from lfrig.processing.fusion import FusedVolume, FusionSettings, fuse, inverse_depth_range
from lfrig.processing.geometry import rotation_z
from lfrig.processing.kernels.plane_fit import local_planes
from lfrig.processing.model import F32, Pose, RigPrior, ScaleFit, Source
from lfrig.processing.options import ProcessOptions
from lfrig.processing.pipeline import process
from lfrig.processing.refine import RefineSettings, smooth, snap_to_edges
from lfrig.processing.regularise import RegulariseSettings, regularise
from lfrig.processing.visibility import count_agreeing, land
from lfrig.processing.wide_baseline import refine_wide
from tests.processing import scenes

PX = scenes.BASELINE_M * scenes.FOCAL
TRUE_SCALE = ScaleFit(1 / PX, 1 / scenes.FOCUS_M)


@cache
def sources() -> tuple[Source, ...]:
    """Two sources, 5 cm to each side of the photo, with exact poses and scales."""
    ready = []
    for name, x in (("a", -0.05), ("b", 0.05)):
        lf = scenes.light_field(name, x)
        assert lf.pose is not None
        ready.append(Source(lf, scenes.CAMERA, lf.pose, light_field_evidence(lf, (-0.5, 0.5)), TRUE_SCALE))
    return tuple(ready)


def errors(inverse_depth: F32) -> np.ndarray:
    """|disparity error| [px] inside a border of 8 px."""
    truth = 1 / scenes.photo()[1]
    return np.abs(PX * (inverse_depth - truth))[8:-8, 8:-8]


@cache
def surface() -> tuple[F32, F32]:
    photo, _ = scenes.photo()
    limits = inverse_depth_range(sources(), scenes.CAMERA, photo.pose, (0.35, 0.8))
    return regularise(fuse(sources(), scenes.CAMERA, photo.pose, limits), photo.image8)


def test_range_holds_what_the_target_sees() -> None:
    photo, depth = scenes.photo()
    lo, hi = inverse_depth_range(sources(), scenes.CAMERA, photo.pose, None)
    assert lo < 1 / depth.max() and 1 / depth.min() < hi < 4


def test_surface_is_right() -> None:
    error = errors(surface()[0])
    assert np.median(error) < 0.015 and (error < 0.1).mean() > 0.93


@pytest.mark.parametrize(
    "worse",
    [FusionSettings(pool="mean", visibility=False), FusionSettings(mapping="literal", pool="mean")],
    ids=["mean-pool", "literal-planes"],
)
def test_each_switch_of_the_fusion_is_worth_having(worse: FusionSettings) -> None:
    photo, _ = scenes.photo()
    limits = inverse_depth_range(sources(), scenes.CAMERA, photo.pose, (0.35, 0.8))
    plain = RegulariseSettings(method="none")
    best, other = (
        errors(regularise(fuse(sources(), scenes.CAMERA, photo.pose, limits, s), photo.image8, plain)[0])
        for s in (FusionSettings(), worse)
    )
    assert np.mean(best**2) <= 1.02 * np.mean(other**2)


def test_first_surface_rule_wants_a_nearer_surface() -> None:
    photo, _ = scenes.photo()
    limits = (1.4, 2.5)
    volumes = [
        fuse(sources(), scenes.CAMERA, photo.pose, limits, FusionSettings(first_surface=on)) for on in (True, False)
    ]
    with_rule, without = (volume.evidence for volume in volumes)
    # Both are rounded, and capped below the best plane, which the rule may have lowered.
    capped = (volumes[0].cost * volumes[0].unit > volumes[0].cap - 0.01)[..., -6:]
    assert (with_rule <= without + volumes[0].unit).all()
    assert (np.abs(with_rule - without)[..., -6:] <= volumes[0].unit)[~capped].all() and not capped.all()


def test_colours_refute_what_sources_see_otherwise() -> None:
    photo, depth = scenes.photo()
    limits, truth = (1.4, 2.5), (1 / depth).astype(np.float32)
    with_colours, without = (
        fuse(sources(), scenes.CAMERA, photo.pose, limits, FusionSettings(first_surface=False), photo=image)
        for image in (photo.image8, None)
    )
    gained = with_colours.evidence - without.evidence
    w0, dw = with_colours.planes
    here = np.clip(np.rint((truth - w0) / dw), 0, gained.shape[2] - 1).astype(int)
    at_truth = np.take_along_axis(gained, here[..., None], 2)[8:-8, 8:-8, 0]
    assert np.median(at_truth) > 0.3 and np.median(at_truth) > np.median(gained) + 0.3


def test_wide_baseline_sharpens_a_surface_that_is_a_little_off() -> None:
    photo, depth = scenes.photo()
    truth = (1 / depth).astype(np.float32)
    off = truth + np.float32(0.04 / PX)
    planes = smooth(off, np.ones_like(off), photo.image8, PX, RefineSettings())
    match = refine_wide(planes, sources(), scenes.CAMERA, photo.pose, photo.image8)
    assert match.accepted.mean() > 0.5 and match.cost[match.accepted].max() < 0.8
    assert np.median(errors(match.inverse_depth)) < 0.5 * np.median(errors(off))
    assert np.array_equal(match.inverse_depth[~match.accepted], planes.value[~match.accepted])


def test_edge_test_mends_a_fattened_edge() -> None:
    photo, depth = scenes.photo()
    import cv2

    truth = (1 / depth).astype(np.float32)
    fat = cv2.dilate(truth, np.ones((7, 7), np.uint8))
    mended, changed = decide_edges(fat, sources(), scenes.CAMERA, photo.pose, photo.image8, PX)
    assert changed > 50
    assert np.mean(errors(mended) ** 2) < 0.5 * np.mean(errors(fat) ** 2)


def test_edge_test_leaves_a_smooth_surface_alone() -> None:
    photo, _ = scenes.photo()
    flat = np.full((scenes.HEIGHT, scenes.WIDTH), 1.7, np.float32)
    out, changed = decide_edges(flat, sources(), scenes.CAMERA, photo.pose, photo.image8, PX, EdgeSettings())
    assert changed == 0 and out is flat


def test_support_counts_agreeing_sources() -> None:
    photo, depth = scenes.photo()
    truth = (1 / depth).astype(np.float32)
    there, aside = (
        [land(w, source, scenes.CAMERA, photo.pose) for source in sources()] for w in (truth, truth + np.float32(0.3))
    )
    right, wrong = count_agreeing(there, 0.06), count_agreeing(aside, 0.06)
    in_view = np.any([landing.inside for landing in there], axis=0)
    assert right.max() == 2 and right[in_view].mean() > 1.2 > 0.2 > wrong.mean()


def test_planes_are_exact_on_a_plane() -> None:
    ys, xs = np.mgrid[0:20, 0:25].astype(np.float32)
    plane = 1.5 + 0.01 * xs - 0.02 * ys
    v, gx, gy, _ = local_planes(
        plane, np.ones_like(plane), np.zeros((20, 25, 3), np.uint8), np.ones((20, 25), bool), radius=4,
        sigma_value=10.0, sigma_grey=30.0, ridge=0.0,
    )  # fmt: skip
    np.testing.assert_allclose(v.reshape(plane.shape), plane, atol=1e-4)
    np.testing.assert_allclose(gx, 0.01, atol=1e-4)
    np.testing.assert_allclose(gy, -0.02, atol=1e-4)


def test_smoothing_and_snapping_keep_a_step() -> None:
    photo = np.zeros((30, 40, 3), np.uint8)
    photo[:, 20:] = 200
    step = np.full((30, 40), 1.5, np.float32)
    step[:, 20:] = 2.5
    rough = step + np.random.default_rng(0).normal(0, 0.01, step.shape).astype(np.float32)
    rough[10, 18] = 2.5
    smoothed = smooth(rough, np.ones_like(step), photo, 0.7, RefineSettings()).value
    assert np.std((smoothed - step)[2:-2, 2:15]) < 0.7 * np.std((rough - step)[2:-2, 2:15])
    snapped = snap_to_edges(smoothed, photo, 0.7, RefineSettings())
    assert abs(snapped[10, 18] - 1.5) < 0.1
    assert (np.abs(snapped - step) < 0.1).all()


def run(monitor: Monitor | None = None, **changes):  # type: ignore[no-untyped-def]
    photo, _ = scenes.photo()
    lights = [s.light_field for s in sources()]
    options = ProcessOptions(target_baseline_m=scenes.BASELINE_M, target_focus_m=scenes.FOCUS_M, rows=3, cols=3)
    return process(lights, photo, RigPrior(), replace(options, **changes), monitor or Monitor())


@pytest.fixture(scope="module")
def result():  # type: ignore[no-untyped-def]
    return run()


def test_the_pipeline_gives_the_true_geometry(result) -> None:
    error = errors(result.light_field.surface.inverse_depth)
    assert np.median(error) < 0.02 and (error < 0.1).mean() > 0.93
    assert np.array_equal(result.light_field.views[1, 1], scenes.photo()[0].image)
    names = [s.name for s in result.stages]
    assert names == ["evidence", "poses", "scale-fit", "fusion", "surface", "refine", "synthesis"]
    assert all(s.cpu_s >= 0 and s.work_done >= 0 for s in result.stages)


def test_threads_change_no_byte(result) -> None:
    other = run(threads=1)
    assert other.light_field.disparity.tobytes() == result.light_field.disparity.tobytes()
    assert other.light_field.views.tobytes() == result.light_field.views.tobytes()
    assert other.light_field.surface.confidence.tobytes() == result.light_field.surface.confidence.tobytes()


def test_given_evidence_is_used(result) -> None:
    photo, _ = scenes.photo()
    evidence = [s.source.evidence for s in result.sources]
    options = ProcessOptions(target_baseline_m=scenes.BASELINE_M, target_focus_m=scenes.FOCUS_M, rows=3, cols=3)
    again = process([s.light_field for s in sources()], photo, RigPrior(), options, Monitor(), evidence=evidence)
    assert again.light_field.disparity.tobytes() == result.light_field.disparity.tobytes()


def test_lower_resolution_still_fills_the_photo() -> None:
    half = run(resolution=0.5)
    assert half.light_field.disparity.shape == (scenes.HEIGHT, scenes.WIDTH)
    assert (errors(half.light_field.surface.inverse_depth) < 0.1).mean() > 0.75


@settings(max_examples=8)
@given(angle=st.floats(-3, 3), shift=st.tuples(*[st.floats(-1e4, 1e4)] * 3), scale=st.sampled_from([0.01, 1.0, 1000.0]))
def test_fusion_does_not_care_where_the_world_is(angle: float, shift: tuple[float, ...], scale: float) -> None:
    """Rotating, moving and scaling the world changes depth by the scale alone."""
    photo, _ = scenes.photo()
    rotation, move = rotation_z(angle), np.array(shift)

    def moved(pose: Pose) -> Pose:
        r = pose.rotation @ rotation.T
        return Pose(r, scale * (pose.translation - r @ move))

    there = [replace(s, pose=moved(s.pose), scale=ScaleFit(s.scale.a / scale, s.scale.c / scale)) for s in sources()]
    knobs = FusionSettings(planes=32, cost_unit=1 / 2048)  # finer than the tolerance below
    camera, plain = scenes.CAMERA, RegulariseSettings(method="none")
    here, moved_away = (
        regularise(fuse(found, camera, pose, limits, knobs), photo.image8, plain)[0]
        for found, pose, limits in (
            (sources(), photo.pose, (1.4, 2.5)),
            (there, moved(photo.pose), (1.4 / scale, 2.5 / scale)),
        )
    )
    # A few pixels sit on a tie of the nearest-pixel visibility test and may fall to either side.
    assert (np.abs(scale * moved_away / here - 1) > 1e-5).mean() < 5e-3


def test_one_source_warns() -> None:
    photo, _ = scenes.photo()
    monitor = Monitor()
    options = ProcessOptions(target_baseline_m=scenes.BASELINE_M, target_focus_m=scenes.FOCUS_M, rows=3, cols=3)
    made = process([sources()[0].light_field], photo, RigPrior(), options, monitor)
    assert "one-source" in [n.code for n in monitor.notices]
    assert (errors(made.light_field.surface.inverse_depth) < 0.1).mean() > 0.7


def test_default_optics_are_those_of_the_nearest_source() -> None:
    request = run(target_baseline_m=None, target_focus_m=None).light_field.request
    assert request.baseline_m == pytest.approx(scenes.BASELINE_M, rel=0.1)
    assert request.focus_distance_m == pytest.approx(scenes.FOCUS_M, rel=0.05)


def test_no_overlap_is_refused() -> None:
    photo, _ = scenes.photo()
    behind = Pose(np.diag([-1.0, 1.0, -1.0]), np.zeros(3))
    with pytest.raises(GeometryRefused) as refusal:
        inverse_depth_range(sources(), scenes.CAMERA, behind, None)
    assert refusal.value.code == "no-overlap"
    with pytest.raises(GeometryRefused):
        fuse(sources(), scenes.CAMERA, behind, (1.4, 2.5))
    assert photo.pose is not None


def test_no_source_is_refused() -> None:
    with pytest.raises(BadInput, match="no source"):
        process([], scenes.photo()[0], RigPrior(), ProcessOptions(), Monitor())


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"preset": "balanced"}, NotInThisVersion),
        ({"preset": "quick"}, UsageError),
        ({"resolution": 0.0}, UsageError),
        ({"rows": 0}, UsageError),
        ({"bit_depth": 12}, UsageError),
        ({"target_focus_m": -1.0}, UsageError),
        ({"target_baseline_m": float("nan")}, UsageError),
    ],
)
def test_senseless_options_are_refused_before_any_work(changes, error) -> None:
    with pytest.raises(error):
        run(**changes)


def test_cancel_stops_it() -> None:
    class Stops(Monitor):
        def on_start(self, name: str, total: int | None) -> None:
            if name == "fusion":
                self.cancel()

    with pytest.raises(Interrupted):
        run(monitor=Stops())


def test_two_planes_equally_good_give_what_lies_between_them() -> None:
    # Heavy tails to one side: a window that jumps with the best plane would take in another plane of them.
    lobe = -np.abs(np.arange(24, dtype=np.float32) - 9.5) * np.float32(0.4)
    lobe[10:] *= np.float32(0.6)
    lobe[9] = lobe[10] = -0.1
    found = []
    for favoured in (9, 10):
        evidence = np.tile(lobe, (2, 2, 1))
        evidence[..., favoured] += np.float32(2e-5)  # one count
        volume = FusedVolume.of_evidence(np.ascontiguousarray(evidence), (0.0, 1.0), unit=2e-5)
        found.append(regularise(volume, np.zeros((2, 2, 3), np.uint8), RegulariseSettings(method="none"))[0])
    assert np.abs(found[0] - found[1]).max() < 1e-4
