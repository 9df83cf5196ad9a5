"""The kernel benchmark: what is recorded, what is compared, and that no kernel is forgotten."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from lfrig.bench import kernels, kernels_bits, kernels_opencv
from lfrig.bench.cases import SMALL
from lfrig.bench.kernels_data import record_calls
from lfrig.bench.kernels_limits import Limits, measure_limits
from lfrig.bench.kernels_registry import KERNELS, UNTIMED
from lfrig.bench.kernels_replay import Call, Function, Replay, Spot, largest_difference, native_switched, recording
from lfrig.contracts.errors import UsageError
from lfrig.processing import plane_search
from lfrig.processing.kernels import fusion, plane_cost, warp
from lfrig.processing.kernels.grey import GreyViews, with_margin
from lfrig.processing.kernels.occupancy import occupancy
from lfrig.processing.model import Evidence, ScaleFit

needs_native = pytest.mark.skipif(
    find_spec("lfrig.processing.kernels._native") is None, reason="no native core here: only the twins exist"
)
BY_NAME = {kernel.name: kernel for kernel in KERNELS}
SWEEP = BY_NAME["sweep"]


def test_every_kernel_is_in_the_registry(repository: Path) -> None:
    files = {path.stem for path in (repository / "processing" / "kernels").glob("*.py")} - {"__init__"}
    assert files - {kernel.source for kernel in KERNELS} - set(UNTIMED) == set()
    assert len({kernel.name for kernel in KERNELS}) == len(KERNELS)
    for kernel in KERNELS:
        assert callable(kernel.spot.resolve())


def used_by_search() -> Function:
    """What the search for planes calls: it imports the kernel by name."""
    found: Function = vars(plane_search)["plane_cost"]
    return found


def nine_views(images: np.ndarray) -> GreyViews:
    """Images int16 [9, H, W], grey × 64, as a 3×3 light field."""
    offsets = np.array([(r, c) for r in (-1, 0, 1) for c in (-1, 0, 1)], float)
    pad, (_, height, width) = 6, images.shape
    return GreyViews(with_margin(images, pad), offsets, 4, pad, height, width)


def test_the_largest_meant_call_is_kept(tmp_path: Path) -> None:
    spots = [
        Spot("sweep", plane_cost.__name__, "plane_cost", meant=lambda call: call.kwargs.get("span") is None),
        Spot("masked", plane_cost.__name__, "plane_cost", meant=lambda call: call.kwargs.get("span") is not None),
    ]
    rng = np.random.default_rng(0)
    original, grid = used_by_search(), plane_cost.PlaneGrid(-0.5, 0.5, 3)
    with recording(spots, tmp_path):
        for side in (12, 20, 16):
            views = nine_views(rng.integers(0, 16000, (9, side, side)).astype(np.int16))
            used_by_search()(views, grid, 20.0, threads=1)
    assert used_by_search() is original is plane_cost.plane_cost
    assert not (tmp_path / "masked.pkl").exists()
    call = Call.load(tmp_path / "sweep.pkl")
    assert call.args[0].images.shape == (9, 20, 20) and "threads" not in call.kwargs
    assert Replay(spots[0], call).run(2).shape == (20, 20, 3)


def test_the_original_comes_back_when_the_block_fails(tmp_path: Path) -> None:
    original = used_by_search()
    with pytest.raises(RuntimeError), recording([SWEEP.spot], tmp_path):
        assert used_by_search() is not original
        raise RuntimeError
    assert used_by_search() is original


def test_a_replay_starts_from_the_same_inputs_each_time() -> None:
    rng = np.random.default_rng(1)
    cost = rng.integers(0, 5000, (11, 13, 9)).astype(np.uint16)
    before = cost.copy()
    disparity, steepness, weight = (rng.uniform(0, most, (11, 13)).astype(np.float32) for most in (1.0, 1e5, 1.0))
    in_place = Spot("blend", "lfrig.processing.kernels.plain_cost", "blend_plain", in_place=(0,))
    arguments = (cost, plane_cost.PlaneGrid(-0.5, 0.2, 9), disparity, steepness, weight, 4000.0)
    replay = Replay(in_place, Call(arguments, {}))
    found = []
    for _ in range(2):
        replay.reset()
        found.append([array.copy() for array in replay.outputs(replay.run())])
    assert np.array_equal(found[0][0], found[1][0]) and not np.array_equal(found[0][0], before)
    replay.reset()
    assert np.array_equal(cost, before)


def test_differences_see_what_is_not_finite() -> None:
    a = np.array([1.0, np.nan, np.inf], np.float32)
    assert largest_difference([a], [a]) == 0
    assert largest_difference([a], [a + np.array([0.5, 0, 0], np.float32)]) == 0.5
    assert largest_difference([a], [np.array([1.0, 2.0, np.inf], np.float32)]) == float("inf")
    assert largest_difference([np.array([0], np.uint8)], [np.array([255], np.uint8)]) == 255


def test_a_share_of_ties_is_left_out_of_differences() -> None:
    zeros, other = np.zeros(1000), np.concatenate([np.full(3, 50.0), np.full(997, 0.25)])
    assert largest_difference([zeros], [other]) == largest_difference([zeros], [other], ties=2e-3) == 50
    assert largest_difference([zeros], [other], ties=3e-3) == 0.25
    assert largest_difference([zeros], [other], ties=3e-3, relative=True) == 0.005
    assert largest_difference([zeros[:0]], [zeros[:0]], ties=0.1, relative=True) == 0


@pytest.mark.parametrize("chosen", [None, np.array([0, 2, 3, 7], np.int32)])
def test_opencv_sweeps_are_correct(chosen: np.ndarray | None) -> None:
    rng = np.random.default_rng(2)
    # Smooth: OpenCV sees 8 bits, and interpolates in steps of 1/32 px.
    import cv2

    images = (cv2.GaussianBlur(rng.uniform(0, 255, (40, 50, 9)), (0, 0), 2.0) * 64).transpose(2, 0, 1).astype(np.int16)
    images[4] = images[3]
    call = Call((nine_views(images), plane_cost.PlaneGrid(-0.8, 0.3, 6), 23.0), {"chosen": chosen})
    ours = plane_cost.plane_cost(*call.args, **call.kwargs)[3:-3, 3:-3] / plane_cost.COST_UNIT
    references = SWEEP.opencv()
    assert references.keys() == {"OpenCV, warps", "OpenCV, rectangles"}
    for reference in references.values():
        assert np.abs(reference(call)[3:-3, 3:-3] - ours).max() < 0.6


def test_opencv_warp_is_correct() -> None:
    rng = np.random.default_rng(3)
    import cv2

    image = cv2.GaussianBlur(rng.integers(0, 256, (40, 50, 3)).astype(np.uint8), (0, 0), 1.0)
    fields = rng.uniform(-1, 1, (2, 40, 50)).astype(np.float32)
    offsets = np.array([[1, -2], [0, 3]], np.float32)
    ours, reference = warp.warp_views(image, fields, offsets), kernels_opencv.warp_by_remap(image, fields, offsets)
    # a = −3/4 there, −1/2 here.
    assert np.abs(ours.astype(int) - reference.astype(int))[:, 4:-4, 4:-4].mean() < 1.0


UNIT = 1 / 256
"""Of fused costs [log evidence]."""


def source_volume(rng: np.random.Generator, *, offset_px: float) -> fusion.SourceVolume:
    p = rng.dirichlet(np.full(14, 0.3), (19, 23))
    disparity = (-0.5 + p.argmax(2) / 13).astype(np.float32)
    evidence = Evidence((p * 65535).astype(np.uint16), (-0.5, 1 / 13), disparity, p.max(2).astype(np.float32))
    colour = rng.integers(0, 256, (19, 23, 4)).astype(np.uint8)
    colour[..., 3] = np.where(rng.random((19, 23)) < 0.2, 255, 0)
    way = np.array([[1, 0.02, -3], [0.01, 1.1, 1], [0.0005, 0, 0.95]]), np.array([offset_px, -1.0, 0.03])
    tables = occupancy(evidence.probability, disparity, 4, threads=1)
    return fusion.SourceVolume(evidence, ScaleFit(1.4, 2.0), way, tables, colour)


def fusion_call(rng: np.random.Generator, **more: object) -> Call:
    sources = [source_volume(rng, offset_px=offset_px) for offset_px in (2.0, -1.5)]
    arguments = (sources, (15, 27, 9), (1.4, 0.15), fusion.Pool())
    return Call(arguments, {"scale": fusion.CostScale(UNIT, 60.0), **more})


def evidence_of(fused: fusion.FusedCost) -> np.ndarray:
    """Log evidence float32 [H, W, N]."""
    return np.asarray(fused.best[..., None] - fused.cost * np.float32(UNIT))


def fused_both_ways(call: Call) -> tuple[fusion.FusedCost, fusion.FusedCost]:
    return fusion.fuse_volume(*call.args, **call.kwargs), BY_NAME["fusion"].opencv()["OpenCV, remap"](call)


def test_opencv_fusion_is_correct() -> None:
    for surface in (None, fusion.SurfaceRule(3, 2.0, 4.0, 10.0)):
        ours, reference = fused_both_ways(fusion_call(np.random.default_rng(4), surface=surface))
        assert reference.inside == ours.inside > 0
        # OpenCV reads between pixels in steps of 1/32; logarithms of small probabilities feel it.
        error = np.abs(evidence_of(ours) - evidence_of(reference))
        assert np.quantile(error, 0.95) < 0.1
        # The rule subtracts a nearer plane's evidence β times, and with it the difference.
        assert error.max() < (1.0 if surface is None else 1.0 + surface.beta)


@pytest.mark.parametrize("reach", [float("inf"), 1.5])
def test_opencv_colours_are_correct(reach: float) -> None:
    rng = np.random.default_rng(5)
    photo = rng.integers(0, 256, (15, 27, 4)).astype(np.uint8)
    photo[..., 3] = np.where(rng.random((15, 27)) < 0.2, 255, 0)
    term = fusion.ColourTerm(1.5, 40.0, 3.0, 1.0, reach)
    coloured = fused_both_ways(fusion_call(np.random.default_rng(6), photo=photo, colour=term))
    plain = fused_both_ways(fusion_call(np.random.default_rng(6)))
    found = [evidence_of(with_it) - evidence_of(without) for with_it, without in zip(coloured, plain, strict=True)]
    assert np.abs(found[0]).max() > 0.5
    error = np.abs(found[0] - found[1])  # where a tap is saturated, a 32nd of a pixel decides whether the value is
    assert np.median(error) < 0.02 and (error < 0.2).mean() > 0.85
    for fused, change in zip(plain, found, strict=True):
        out_of_reach = fused.cost * UNIT > reach + 2 * UNIT
        assert out_of_reach.any() == np.isfinite(reach)
        assert np.abs(change[out_of_reach]).max(initial=0) <= 2 * UNIT


def test_the_longer_of_two_times_is_the_limit() -> None:
    limits = Limits(1, 10e9, {"int16": 100e9, "float32": 50e9}, 12.0)
    assert limits.least_cpu_s(1e9, 1e9, "int16") == (0.1, "memory")
    assert limits.least_cpu_s(1e6, 1e10, "float32") == (0.2, "arithmetic")


@needs_native
def test_limits_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    monkeypatch.setattr("lfrig.bench.kernels_limits.TRIAD_FLOATS", 1 << 20)
    monkeypatch.setattr("lfrig.bench.kernels_limits.TRIAD_BYTES", 12 << 20)
    found = measure_limits(2).row()
    # Any machine that runs this moves more than 100 MB/s and counts faster than it moves.
    assert found["triad_gb_per_s"] > 0.1 and found["int16_gops_per_cpu_s"] > found["triad_gb_per_cpu_s"] / 4


def test_without_the_native_core_there_is_nothing_to_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", "0")
    with pytest.raises(UsageError, match="native core"):
        kernels.run(tmp_path)


def test_ratios_are_promised_at_full_size_with_avx512() -> None:
    rows = [
        {"kind": "kernel", "kernel": "sweep", "reference": "OpenCV, warps", "size": "full", "threads": threads,
         "cpu_ratio": 7.0, "difference": 0.01}
        for threads in (1, 2)
    ]  # fmt: skip
    checks = kernels.acceptance(rows, KERNELS, ["full"], "AVX-512")
    assert [(check.value, check.ok) for check in checks] == [(0.01, True), (7.0, False)]
    assert len(kernels.acceptance(rows, KERNELS, ["full"], "AVX2")) == 1
    assert {name for name, *_ in kernels.BOUNDS} <= {kernel.name for kernel in KERNELS}


@pytest.fixture(scope="module")
def calls(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Calls of all kernels on a small case, and their bits."""
    folder = tmp_path_factory.mktemp("calls")
    with native_switched(True):
        kernels_bits.write_folder(folder, SMALL)
    return folder


@needs_native
@pytest.mark.slow
def test_the_same_bits_for_any_number_of_threads(calls: Path) -> None:
    with native_switched(True):
        found = kernels_bits.check_folder(calls)
    assert len(found) >= 10 and all(found.values()), found


@needs_native
@pytest.mark.slow
def test_other_bits_are_noticed(calls: Path) -> None:
    call = Call.load(calls / "warp.pkl")
    assert kernels_bits.outputs_digest(next(k for k in KERNELS if k.name == "warp"), call, 1)
    with native_switched(False):
        found = kernels_bits.check_folder(calls)
    assert not found["softmax"], "the twin rounds differently: a check that does not see that sees nothing"


@needs_native
@pytest.mark.slow
def test_the_benchmark_end_to_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    chosen = [kernel for kernel in KERNELS if kernel.name in ("warp", "softmax", "unpack")]
    document = kernels.run(tmp_path, threads=1, sizes=["quarter"], kernels=chosen, runs=2)
    rows = [row for row in document.rows if row["kind"] == "kernel"]
    assert {(row["kernel"], row["threads"]) for row in rows} == {
        ("warp", 1), ("warp", 2), ("softmax", 1), ("softmax", 2), ("unpack", 1)
    }  # fmt: skip
    assert all(row["cpu_ms"] > 0 and row["of_limit"] > 0 and row["reference_cpu_ms"] > 0 for row in rows)
    assert all(check.ok for check in document.checks) and len(document.checks) == 3
    assert (tmp_path / kernels.PICTURE).stat().st_size > 500
    assert "| warp to 48 views | 2 |" in (tmp_path / "kernels.md").read_text(encoding="utf-8")


def test_a_recording_without_raw_kernels_decodes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfrig.bench.kernels_data.decode_capture", lambda *_: pytest.fail("decoded"))
    monkeypatch.setattr("lfrig.bench.kernels_data.process", lambda *_: None)
    record_calls([SWEEP], (48, 32), tmp_path, cache_dir=tmp_path / "renders")
