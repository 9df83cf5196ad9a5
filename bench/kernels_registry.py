"""Every kernel of ``processing/kernels`` for the benchmark: which call, what it is held against, what it has to do.

The data comes from the pipeline (`kernels_replay`), so an entry says little: the function, OpenCV's version where there
is a proper one (else the NumPy twin is the reference), and how many arithmetic operations a plain loop needs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from lfrig.bench.kernels_replay import Array, Call, Spot
from lfrig.processing.kernels.sgm import active_labels

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
    difference to the twin, in units of the output, or as a share of the largest value (``relative``); ``ties`` is the
    share of values that may differ more, because rounding decides on which side of a limit they fall. ``exact`` says
    that no function is used whose rounding the C library chooses: then all machines give the same bits.
    """

    spot: Spot
    title: str
    operations: Count | None
    tolerance: float
    unit: Unit = "float32"
    touched: Count = lambda call, outputs: 1.0
    opencv: Opencv = dict
    exact: bool = True
    ties: float = 0.0
    relative: bool = False
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
    return call.kwargs.get("span") is not None and call.kwargs.get("out") is None


def _whole(call: Call) -> bool:
    return all(call.kwargs.get(name) is None for name in ("span", "halves", "out", "chosen"))


def _active_share(call: Call, outputs: list[Array]) -> float:
    """Of pixels and planes, those that some tile wants."""
    return float(active_labels(call.kwargs["span"], outputs[0].shape).mean())


def _wanted(call: Call, outputs: list[Array]) -> list[Array]:
    return [outputs[0][active_labels(call.kwargs["span"], outputs[0].shape)]]


SWEEP_OPERATIONS = 10
"""Per view, plane and pixel: two linear interpolations (3 each), absolute difference (2), truncation, sum."""


def _compared_views(call: Call) -> Array:
    """Indices of the views that are compared with the centre."""
    chosen: Array | None = call.kwargs.get("chosen")
    return np.asarray(call.args[0].others() if chosen is None else chosen)


def _sweep_operations(call: Call, outputs: list[Array]) -> float:
    return float(SWEEP_OPERATIONS * len(_compared_views(call)) * outputs[0].size)


def _sweep_arguments(call: Call) -> tuple[tuple[Any, ...], dict[str, Any]]:
    """Those of OpenCV's sweeps: the compared views, the centre, offsets, planes."""
    views, grid, truncation = call.args
    compared, images = _compared_views(call), views.images
    planes = (grid.first, grid.step, grid.count, truncation)
    return (images[compared], images[views.centre], views.offsets[compared], *planes), {}


def _band_operations(call: Call, outputs: list[Array]) -> float:
    # Per view and tap: the map into the source (10), bilinear (11), three weighted sums (6).
    views, patch = call.args[2], call.args[6]
    taps = len(patch.taps)
    return float(27 * taps * len(views) * outputs[0].size)


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


def _fusion_operations(call: Call, outputs: list[Array]) -> float:
    # Per voxel and source: evidence (55), colours (60); per voxel the first-surface rule (7).
    return float((115 * len(call.args[0]) + 7) * outputs[0].size)


SWEEPS = _opencv("sweep_by_warps", "sweep_by_rectangles", arguments=_sweep_arguments)

KERNELS = (
    Kernel(
        _spot("sweep", "plane_cost", "plane_cost", meant=_whole),
        "plane sweep of 48 views", _sweep_operations, 4.0, unit="int16", opencv=SWEEPS,
    ),
    Kernel(
        _spot("sweep-masked", "plane_cost", "plane_cost", meant=_masked), "plane sweep where it is wanted",
        lambda call, outputs: _active_share(call, outputs) * _sweep_operations(call, outputs), 4.0, unit="int16",
        touched=_active_share, opencv=SWEEPS, compared=_wanted,
    ),
    Kernel(
        _spot("sgm", "sgm", "aggregate"), "semi-global matching, 8 paths", _per_output(8 * 7), 0.0, unit="int16",
    ),
    Kernel(
        _spot("softmax", "softmax", "sgm_softmax"), "semi-global matching, softmax and peak",
        _per_output(8 * 7 + 24), 1.0,
    ),
    Kernel(_spot("summary", "softmax", "summarise"), "least and mean costs", None, 1.0, unit="int16"),
    Kernel(_spot("grey", "grey", "grey_views"), "grey views with a margin", None, 1.0, unit="int16"),
    Kernel(_spot("clipping", "clipping", "soften_clipped"), "blur where views clip", None, 1.0),
    Kernel(_spot("moments", "plain_cost", "view_moments"), "view differences, for plain areas", None, 1.0),
    Kernel(_spot("power", "plain_cost", "difference_power"), "how views differ, for plain areas", None, 1.0),
    Kernel(_spot("blend", "plain_cost", "blend_plain", in_place=(0,)), "plain areas' costs", None, 1.0),
    Kernel(_spot("occupancy", "occupancy", "occupancy"), "where a source has mass", None, 0.0),
    Kernel(
        _spot("fusion", "fusion", "fuse_volume"), "fusion of all sources, with colours", _fusion_operations, 8.0,
        opencv=_opencv("fuse_volume_by_remap"), ties=2e-3,
    ),
    Kernel(_spot("plane-fit", "plane_fit", "local_planes"), "bilateral plane fit", _fit_operations, 1e-2),
    Kernel(
        _spot("band", "band_cost", "band_cost"), "band sweep of all sources", _band_operations, 4.0, exact=False,
        ties=2e-3,
    ),
    Kernel(
        _spot("warp", "warp", "warp_views"), "warp to 48 views", _per_output(55), 1.0, opencv=_opencv("warp_by_remap")
    ),
    Kernel(
        _spot("lenslet", "lenslet", "decode_views"), "lenslet decode", _decode_operations, 2.0
    ),
    Kernel(
        _spot("surface", "surface", "sgm_surface"), "semi-global matching and peak",
        lambda call, outputs: 8 * 7 * call.args[0].size, 1e-2, unit="int16",
    ),
    Kernel(_spot("band-peak", "band_peak", "band_peak"), "peak of the band", None, 1e-2),
    Kernel(_spot("edge-cost", "edge_cost", "edge_cost"), "near or far by colours", None, 1e-2, exact=False),
    Kernel(_spot("edge-snap", "edge_snap", "edge_snap"), "snap to the photo's edges", None, 1e-3),
    Kernel(_spot("landing", "landing", "landing"), "surface carried into a source", None, 1e-2),
    Kernel(_spot("layer-mean", "layer_mean", "layer_mean"), "mean within a layer", None, 1e-3),
    Kernel(_spot("perceptron", "perceptron", "perceptron"), "confidence's perceptron", None, 1e-3),
    Kernel(_spot("curve", "curve", "curve"), "confidence's curves", None, 1e-4),
    Kernel(_spot("spread", "spread", "spread"), "planes spread into hidden areas", None, 0.0),
    Kernel(_spot("views", "layered_views", "layered_views"), "layered synthesis of 48 views", None, 1.0, ties=2e-3),
    Kernel(_spot("peel", "rims", "peel"), "background under depth steps", None, 1e-3),
    Kernel(_spot("patches", "patches", "align_patches"), "patches aligned", None, 1e-2),
    Kernel(_spot("flow", "corner_disparity", "follow_disparities"), "corners followed through the views", None, 1e-2),
    Kernel(_spot("correlation", "correlation", "shifted_correlations"), "patches compared elsewhere", None, 1e-3),
    Kernel(_spot("line-fit", "line_fit", "biweight_line"), "robust line through anchors", None, 1e-9, relative=True),
    Kernel(_spot("rig-chain", "rig_chain", "rig_chain"), "rig chain and its derivatives", None, 1e-9),
    Kernel(
        _spot("normal-equations", "bundle", "reduced_system"), "normal equations of the adjustment", None, 1e-9,
        relative=True,
    ),
    Kernel(_spot("unpack", "unpack", "unpack_little10"), "unpack 10 bits", None, 0.0),
)  # fmt: skip
UNTIMED = {
    "fusion_twin": "the twin of fusion", "stream": "what the others are held against",
    "spline": "the pipeline samples splines within layered_views only",
    "view_field": "the twin of a part of layered_views; it has no native form of its own",
}  # fmt: skip
"""Files of ``processing/kernels`` that hold no kernel to be timed."""
