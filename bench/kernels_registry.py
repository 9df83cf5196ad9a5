"""Every kernel of ``processing/kernels`` for the benchmark: which call, what it is held against, what it has to do.

The data comes from the pipeline (`kernels_replay`), so an entry says little: the function, OpenCV's version where there
is a proper one (else the NumPy twin is the reference), and how many arithmetic operations a plain loop needs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from lfrig.bench.kernels_replay import Array, Call, Spot

Unit = Literal["int16", "float32"]
Reference = Callable[[Call], Any]
Opencv = Callable[[], dict[str, Reference]]
Count = Callable[[Call, list[Array]], float]
"""(call, outputs) → a number."""
PACKAGE = "lfrig.processing.kernels"


@dataclass(frozen=True)
class Kernel:
    """A kernel in the benchmark.

    ``operations`` counts multiplications, additions, comparisons of one call in ``unit``; ``None`` where memory alone
    limits. ``touched`` is the share of the arrays that a call has to read and write. ``tolerance`` bounds the largest
    difference to the twin, in units of the output. ``exact`` says that no function is used whose rounding the C library
    chooses: then all machines give the same bits.
    """

    spot: Spot
    title: str
    operations: Count | None
    tolerance: float
    unit: Unit = "float32"
    touched: Count = lambda call, outputs: 1.0
    opencv: Opencv = dict
    exact: bool = True
    compared: Callable[[Call, list[Array]], list[Array]] = lambda call, outputs: outputs
    """Of the outputs, what the kernel promises."""

    @property
    def name(self) -> str:
        """Its key."""
        return self.spot.name

    @property
    def source(self) -> str:
        """Stem of the file that holds it."""
        return self.spot.module.rpartition(".")[2]

    def bytes_moved(self, call: Call, outputs: list[Array]) -> float:
        """What has to move at least once: arrays read and arrays written (those changed in place count twice)."""
        whole = sum(array.nbytes for array in [*call.arrays(), *outputs])
        return whole * self.touched(call, outputs)


def _spot(name: str, file: str, function: str, **more: Any) -> Spot:
    return Spot(name, f"{PACKAGE}.{file}", function, **more)


def _per_output(operations: float) -> Count:
    """So many operations per value of the first output."""
    return lambda call, outputs: operations * outputs[0].size


def _masked(call: Call) -> bool:
    return call.kwargs.get("active") is not None


def _active_share(call: Call, outputs: list[Array]) -> float:
    return float(np.mean(call.kwargs["active"]))


SWEEP_OPERATIONS = 10
"""Per view, plane and pixel: two linear interpolations (3 each), absolute difference (2), truncation, sum."""


def _sweep_operations(call: Call, outputs: list[Array]) -> float:
    return float(SWEEP_OPERATIONS * len(call.args[0]) * outputs[0].size)


def _band_operations(call: Call, outputs: list[Array]) -> float:
    # Per tap: the map into the source (10), bilinear (11), three weighted sums (6).
    visible, patch = call.args[3], call.args[8]
    taps = len(range(-patch.radius, patch.radius + 1, patch.stride)) ** 2
    return float(27 * taps * (visible > 0.01).sum() * call.args[7])


def _fit_operations(call: Call, outputs: list[Array]) -> float:
    # Per neighbour: exponent (12), exponential (18), nine weighted sums (15).
    side = len(range(-call.kwargs["radius"], call.kwargs["radius"] + 1, call.kwargs.get("stride", 1)))
    return float(45 * side**2 * call.args[3].sum())


def _decode_operations(call: Call, outputs: list[Array]) -> float:
    # Per view pixel: a lens is read (25 pixels, 4 channels), and 7 lenses are weighted.
    return float((25 * 4 + 7 * 4) * 2 * outputs[1].size)


def _as_called(call: Call) -> tuple[tuple[Any, ...], dict[str, Any]]:
    return call.args, call.kwargs


def _opencv(*names: str, arguments: Callable[[Call], tuple[tuple[Any, ...], dict[str, Any]]] = _as_called) -> Opencv:
    """Functions of `kernels_opencv` by title; ``arguments`` are theirs from a call. OpenCV is loaded when asked for."""

    def load() -> dict[str, Reference]:
        from lfrig.bench import kernels_opencv

        def reference(name: str) -> Reference:
            def make(call: Call) -> Any:
                args, kwargs = arguments(call)
                return getattr(kernels_opencv, name)(*args, **kwargs)

            return make

        return {f"OpenCV, {name.partition('_by_')[2]}": reference(name) for name in names}

    return load


def _fusion_arguments(call: Call) -> tuple[tuple[Any, ...], dict[str, Any]]:
    volume, _, evidence, scale, matrix, offset, planes, pool = call.args
    # Of the kernel's modes the shipped one: log pool, visibility, exact map.
    assert pool.log_pool and pool.visibility and not pool.literal
    margin_px = call.kwargs.get("margin_px", 0.06)
    return (volume, evidence, scale, matrix, offset, planes), {"floor_share": pool.floor_share, "margin_px": margin_px}


def _colour_arguments(call: Call) -> tuple[tuple[Any, ...], dict[str, Any]]:
    return call.args[:7], asdict(call.args[7])


SWEEPS = _opencv("sweep_by_warps", "sweep_by_rectangles")

KERNELS = (
    Kernel(
        _spot("sweep", "plane_cost", "plane_cost", meant=lambda call: not _masked(call)),
        "plane sweep of 48 views", _sweep_operations, 1 / 16, unit="int16", opencv=SWEEPS,
    ),
    Kernel(
        _spot("sweep-masked", "plane_cost", "plane_cost", meant=_masked), "plane sweep where it is wanted",
        lambda call, outputs: _active_share(call, outputs) * _sweep_operations(call, outputs), 1 / 16, unit="int16",
        touched=_active_share, opencv=SWEEPS, compared=lambda call, outputs: [outputs[0][call.kwargs["active"]]],
    ),
    Kernel(_spot("sgm", "sgm", "aggregate"), "semi-global matching, 8 paths", _per_output(8 * 7), 1e-2),
    Kernel(_spot("softmax", "softmax", "softmax_peak"), "softmax and peak", _per_output(24), 1.0),
    Kernel(
        _spot("fusion", "fusion", "add_evidence", in_place=(0,)), "fusion of one source", _per_output(55), 1e-2,
        opencv=_opencv("fuse_by_remap", arguments=_fusion_arguments), exact=False,
    ),
    Kernel(
        _spot("colours", "colour_evidence", "add_colour_evidence", in_place=(0,)), "colours of one source",
        _per_output(60), 1e-2, opencv=_opencv("colours_by_remap", arguments=_colour_arguments),
    ),
    Kernel(
        _spot("first-surface", "fusion", "first_surface", in_place=(0,)), "first-surface rule", _per_output(7), 1e-4
    ),
    Kernel(_spot("plane-fit", "plane_fit", "local_planes"), "bilateral plane fit", _fit_operations, 1e-2),
    Kernel(
        _spot("band", "band_cost", "band_cost"), "band sweep of one source", _band_operations, 1e-2, exact=False
    ),
    Kernel(
        _spot("warp", "warp", "warp_views"), "warp to 48 views", _per_output(55), 1.0, opencv=_opencv("warp_by_remap")
    ),
    Kernel(_spot("spline", "spline", "sample_spline"), "spline samples", _per_output(45), 1e-2),
    Kernel(
        _spot("lenslet", "lenslet", "decode_views"), "lenslet decode", _decode_operations, 2.0
    ),
    Kernel(_spot("unpack", "unpack", "unpack_little10"), "unpack 10 bits", None, 0.0),
)  # fmt: skip
UNTIMED = {"module": "no kernel", "stream": "what the others are held against"}
"""Files of ``processing/kernels`` that hold no kernel to be timed."""
