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
from lfrig.bench.kernels_replay import Call, Replay, Spot, largest_difference, native_switched, recording
from lfrig.contracts.errors import UsageError
from lfrig.processing import dpv
from lfrig.processing.kernels import colour_evidence, fusion, plane_cost, warp
from lfrig.processing.model import Evidence, ScaleFit

needs_native = pytest.mark.skipif(
    find_spec("lfrig.processing.kernels._native") is None, reason="no native core here: only the twins exist"
)
SWEEP = next(kernel for kernel in KERNELS if kernel.name == "sweep")


def test_every_kernel_is_in_the_registry(repository: Path) -> None:
    files = {path.stem for path in (repository / "processing" / "kernels").glob("*.py")} - {"__init__"}
    assert files - {kernel.source for kernel in KERNELS} - set(UNTIMED) == set()
    assert len({kernel.name for kernel in KERNELS}) == len(KERNELS)
    for kernel in KERNELS:
        assert callable(kernel.spot.resolve())


def test_the_largest_meant_call_is_kept(tmp_path: Path) -> None:
    spots = [
        Spot("sweep", plane_cost.__name__, "plane_cost", meant=lambda call: call.kwargs.get("active") is None),
        Spot("masked", plane_cost.__name__, "plane_cost", meant=lambda call: call.kwargs.get("active") is not None),
    ]
    rng = np.random.default_rng(0)
    original = dpv.plane_cost
    with recording(spots, tmp_path):
        for side in (12, 20, 16):
            grey = rng.integers(0, 16000, (2, side, side)).astype(np.int16)
            dpv.plane_cost(grey, grey[0], np.array([[0.0, 1], [1, 0]]), -0.5, 0.5, 3, 20.0, threads=1)
    assert dpv.plane_cost is original is plane_cost.plane_cost
    assert not (tmp_path / "masked.pkl").exists()
    call = Call.load(tmp_path / "sweep.pkl")
    assert call.args[0].shape == (2, 20, 20) and "threads" not in call.kwargs
    assert Replay(spots[0], call).run(2).shape == (20, 20, 3)


def test_the_original_comes_back_when_the_block_fails(tmp_path: Path) -> None:
    original = dpv.plane_cost
    with pytest.raises(RuntimeError), recording([SWEEP.spot], tmp_path):
        assert dpv.plane_cost is not original
        raise RuntimeError
    assert dpv.plane_cost is original


def fusion_call(rng: np.random.Generator) -> Call:
    p = rng.dirichlet(np.full(14, 0.3), (19, 23))
    disparity = (-0.5 + p.argmax(2) / 13).astype(np.float32)
    evidence = Evidence((p * 65535).astype(np.uint16), (-0.5, 1 / 13), disparity, p.max(2).astype(np.float32))
    matrix = np.array([[1, 0.02, -3], [0.01, 1.1, 1], [0.0005, 0, 0.95]])
    volume = rng.normal(size=(15, 27, 9)).astype(np.float32)
    pool = fusion.Pool()
    return Call(
        (volume, None, evidence, ScaleFit(1.4, 2.0), matrix, np.array([2.0, -1.0, 0.03]), (1.4, 0.15), pool), {}
    )


def test_a_replay_starts_from_the_same_inputs_each_time() -> None:
    spot = next(kernel.spot for kernel in KERNELS if kernel.name == "fusion")
    call = fusion_call(np.random.default_rng(1))
    before = call.args[0].copy()
    replay = Replay(spot, call)
    found = []
    for _ in range(2):
        replay.reset()
        found.append([array.copy() for array in replay.outputs(replay.run())])
    assert np.array_equal(found[0][0], found[1][0]) and not np.array_equal(found[0][0], before)
    replay.reset()
    assert np.array_equal(call.args[0], before)


def test_differences_see_what_is_not_finite() -> None:
    a = np.array([1.0, np.nan, np.inf], np.float32)
    assert largest_difference([a], [a]) == 0
    assert largest_difference([a], [a + np.array([0.5, 0, 0], np.float32)]) == 0.5
    assert largest_difference([a], [np.array([1.0, 2.0, np.inf], np.float32)]) == float("inf")
    assert largest_difference([np.array([0], np.uint8)], [np.array([255], np.uint8)]) == 255


def test_opencv_sweeps_are_correct() -> None:
    rng = np.random.default_rng(2)
    # Smooth: OpenCV sees 8 bits, and interpolates in steps of 1/32 px.
    import cv2

    grey = (cv2.GaussianBlur(rng.uniform(0, 255, (40, 50, 8)), (0, 0), 2.0) * 64).transpose(2, 0, 1).astype(np.int16)
    offsets = np.array([(r, c) for r in (-1, 0, 1) for c in (-1, 0, 1) if r or c], float)
    arguments = (grey, grey[3].copy(), offsets, -0.8, 0.3, 6, 23.0)
    ours = plane_cost.plane_cost(*arguments)[3:-3, 3:-3]
    for reference in (kernels_opencv.sweep_by_warps, kernels_opencv.sweep_by_rectangles):
        assert np.abs(reference(*arguments)[3:-3, 3:-3] - ours).max() < 0.6


def test_opencv_warp_is_correct() -> None:
    rng = np.random.default_rng(3)
    import cv2

    image = cv2.GaussianBlur(rng.integers(0, 256, (40, 50, 3)).astype(np.uint8), (0, 0), 1.0)
    fields = rng.uniform(-1, 1, (2, 40, 50)).astype(np.float32)
    offsets = np.array([[1, -2], [0, 3]], np.float32)
    ours, reference = warp.warp_views(image, fields, offsets), kernels_opencv.warp_by_remap(image, fields, offsets)
    # a = −3/4 there, −1/2 here.
    assert np.abs(ours.astype(int) - reference.astype(int))[:, 4:-4, 4:-4].mean() < 1.0


def test_opencv_fusion_is_correct() -> None:
    call = fusion_call(np.random.default_rng(4))
    ours, reference = call.args[0].copy(), call.args[0].copy()
    inside = fusion.add_evidence(ours, *call.args[1:])
    replaced = Call((reference, *call.args[1:]), {})
    kernel = next(kernel for kernel in KERNELS if kernel.name == "fusion")
    assert kernel.opencv()["OpenCV, remap"](replaced) == inside > 0
    # OpenCV reads between pixels in steps of 1/32; logarithms of small probabilities feel it.
    error = np.abs(ours - reference)
    assert np.quantile(error, 0.95) < 0.1 and error.max() < 1.0


def test_opencv_colours_are_correct() -> None:
    rng = np.random.default_rng(5)
    photo, image = (rng.uniform(0, 255, (12, 17, 4)).astype(np.float32) for _ in range(2))
    photo[..., 3], image[..., 3] = rng.random((12, 17)) < 0.2, rng.random((12, 17)) < 0.2
    disparity = rng.uniform(-0.5, 0.5, (12, 17)).astype(np.float32)
    view = np.array([[1, 0.02, -2], [0.01, 1.05, 1], [0.0005, 0, 0.95]]), np.array([1.5, -1.0, 0.03])
    term = colour_evidence.ColourTerm(1.5, 40.0, 3.0, 1.0, 0.06)
    found = [np.zeros((12, 17, 7), np.float32) for _ in range(2)]
    calls = [Call((v, photo, image, disparity, ScaleFit(1.4, 2.0), view, (1.4, 0.15), term), {}) for v in found]
    kernel = next(kernel for kernel in KERNELS if kernel.name == "colours")
    colour_evidence.add_colour_evidence(*calls[0].args)
    kernel.opencv()["OpenCV, remap"](calls[1])
    assert np.abs(found[0]).max() > 0.5
    error = np.abs(found[0] - found[1])  # where a tap is saturated, a 32nd of a pixel decides whether the value is
    assert np.median(error) < 0.02 and (error < 0.2).mean() > 0.85


def test_the_longer_of_two_times_is_the_limit() -> None:
    limits = Limits(1, 10e9, {"int16": 100e9, "float32": 50e9}, 12.0)
    assert limits.least_cpu_s(1e9, 1e9, "int16") == (0.1, "memory")
    assert limits.least_cpu_s(1e6, 1e10, "float32") == (0.2, "arithmetic")


@needs_native
def test_limits_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
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
    kernels_bits.write_folder(folder, SMALL)
    return folder


@needs_native
@pytest.mark.slow
def test_the_same_bits_for_any_number_of_threads(calls: Path) -> None:
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
def test_the_benchmark_end_to_end(tmp_path: Path) -> None:
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
