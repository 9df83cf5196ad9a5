"""Where the cameras stood: a plan and a side elevation with the scene's points in the photo's colours."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lfrig.processing.geometry import world_points
from lfrig.processing.model import F32, F64, U8, Camera, Pose
from lfrig.processing.report import pictures, words
from lfrig.processing.report.html import Html, el

WIDTH = 480
"""Of a panel [user units]; its points are drawn at twice that many pixels."""
MARGIN = 48
POINTS = 60_000
DOT = 2
"""Side of a point [px of the drawing at double size]."""
GLYPH = 44
"""Length of a drawn frustum [user units]."""


@dataclass(frozen=True)
class Standpoint:
    """A camera to be drawn: a label, its intrinsics and pose; ``target`` marks the photo's."""

    label: str
    camera: Camera
    pose: Pose
    target: bool = False


@dataclass(frozen=True)
class Cloud:
    """Points of the scene: float64 [N, 3] in the world, colours uint8 [N, 3]."""

    points: F64
    colours: U8


def point_cloud(camera: Camera, pose: Pose, inverse_depth: F32, confidence: F32, photo: U8) -> Cloud:
    """The seen surface as world points, at most `POINTS`, confident ones only. All maps are [H, W(, 3)]."""
    usable = (inverse_depth > 0) & (confidence >= 0.5)  # false for NaN
    ys, xs = np.nonzero(usable if usable.any() else inverse_depth > 0)
    every = max(1, len(ys) // POINTS)
    ys, xs = ys[::every], xs[::every]
    depth = 1.0 / inverse_depth[ys, xs].astype(np.float64)
    xy = np.stack([xs, ys], -1).astype(np.float64)
    return Cloud(world_points(camera, pose, xy, depth), photo[ys, xs])


def overview(standpoints: Sequence[Standpoint], cloud: Cloud, *, metric: bool) -> Html:
    """Two panels: seen from above (the target looks up the page) and from the target's right."""
    up, forward, right = axes(standpoints)
    origin = np.mean([s.pose.centre for s in standpoints], 0)
    plan = _Panel("plan: seen from above", origin, right, forward, up)
    side = _Panel("side: seen from the right", origin, forward, up, right)
    return el("div", plan.draw(standpoints, cloud, metric), side.draw(standpoints, cloud, metric), class_="panels")


def axes(standpoints: Sequence[Standpoint]) -> tuple[F64, F64, F64]:
    """(up, forward, right) unit vectors in the world.

    Up is the world axis that the cameras' tops point to, where one is within 45°, else their mean; forward is the
    target's (else the first camera's) optical axis made level.
    """
    mean = -np.sum([s.pose.rotation[1] for s in standpoints], 0)
    norm = float(np.linalg.norm(mean))
    up = mean / norm if norm > 1e-6 else -standpoints[0].pose.rotation[1]
    axis = int(np.argmax(np.abs(up)))
    if abs(up[axis]) > np.sqrt(0.5):
        up = np.eye(3)[axis] * np.sign(up[axis])
    chief = next((s for s in standpoints if s.target), standpoints[0]).pose
    forward = chief.direction - up * (chief.direction @ up)
    if np.linalg.norm(forward) < 0.1:  # it looks straight down: its own up will do
        forward = -chief.rotation[1] - up * (-chief.rotation[1] @ up)
    forward = forward / np.linalg.norm(forward)
    return up, forward, np.cross(forward, up)


class _Panel:
    """An orthographic drawing seen against ``toward``, with ``x`` to the right and ``y`` up the page."""

    def __init__(self, title: str, origin: F64, x: F64, y: F64, toward: F64) -> None:
        self.title, self.origin, self.x, self.y, self.toward = title, origin, x, y, toward

    def flat(self, world: F64) -> F64:
        """World points [..., 3] → (right, up) [..., 2] in world lengths."""
        local = world - self.origin
        return np.stack([local @ self.x, local @ self.y], -1)

    def draw(self, standpoints: Sequence[Standpoint], cloud: Cloud, metric: bool) -> Html:
        low, high = self._bounds(standpoints, cloud)
        extent = high - low
        height = float(np.clip(extent[1] / extent[0], 0.55, 0.85)) * WIDTH
        scale = float(np.min((np.array([WIDTH, height]) - 2 * MARGIN) / extent))
        shift = np.array([WIDTH, height]) / 2 - scale * np.array([1, -1]) * (low + high) / 2

        def page(flat: F64) -> F64:
            return flat * [scale, -scale] + shift

        cameras, labels = [], _Labels()
        for standpoint in sorted(standpoints, key=lambda s: s.target):
            cameras.append(self._camera(standpoint, GLYPH / scale, page, labels))
        words_ = f"{self.title}; cameras {words.listing([s.label for s in standpoints])}"
        drawing = el(
            "svg",
            self._points(cloud, page, round(height)),
            *cameras,
            *_scale_bar(scale, height, metric),
            viewBox=f"0 0 {WIDTH} {height:.0f}",
            role="img",
            aria_label=words_,
            class_="overview",
        )
        return el("figure", drawing, el("figcaption", self.title))

    def _bounds(self, standpoints: Sequence[Standpoint], cloud: Cloud) -> tuple[F64, F64]:
        centres = self.flat(np.array([s.pose.centre for s in standpoints]))
        corners = [centres.min(0), centres.max(0)]
        if len(cloud.points):
            flat = self.flat(cloud.points)
            corners += [np.percentile(flat, 1, axis=0), np.percentile(flat, 99, axis=0)]
        low, high = np.min(corners, 0), np.max(corners, 0)
        # A lone camera, or a row of them, still needs some room around it.
        room = max(1e-6, 0.1 * float(np.max(high - low)))
        return low - room * (high - low < room), high + room * (high - low < room)

    def _points(self, cloud: Cloud, page: Callable[[F64], F64], height: int) -> Html:
        pixels = np.zeros((2 * height, 2 * WIDTH, 4), np.uint8)
        # Painted from the back to what is nearest to the reader.
        order = np.argsort((cloud.points - self.origin) @ self.toward)
        at = np.rint(2 * page(self.flat(cloud.points[order]))).astype(int)
        for dy, dx in np.ndindex(DOT, DOT):
            columns, rows = at[:, 0] + dx, at[:, 1] + dy
            inside = (columns >= 0) & (columns < 2 * WIDTH) & (rows >= 0) & (rows < 2 * height)
            pixels[rows[inside], columns[inside], :3] = cloud.colours[order][inside]
            pixels[rows[inside], columns[inside], 3] = 255
        return el("image", href=pictures.cutout(pixels).uri, x=0, y=0, width=WIDTH, height=height)

    def _camera(self, standpoint: Standpoint, reach: float, page: Callable[[F64], F64], labels: _Labels) -> Html:
        pose, camera = standpoint.pose, standpoint.camera
        half = np.array([camera.width, camera.height]) / (2 * camera.focal_px)
        corners = np.array([[sx * half[0], sy * half[1], 1.0] for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
        ends = page(self.flat(pose.centre + reach * corners @ pose.rotation))
        apex = page(self.flat(pose.centre))
        kind = "target" if standpoint.target else "source"
        outline = " ".join(f"{x:.1f},{y:.1f}" for x, y in _hull(np.vstack([apex, ends])))
        away = apex - ends.mean(0)
        away = away / max(1e-9, float(np.linalg.norm(away)))
        x, y = labels.free_place(apex + 14 * away + [0, 4], len(standpoint.label))
        anchor = "start" if away[0] > 0.4 else "end" if away[0] < -0.4 else "middle"
        return el(
            "g",
            el("polygon", points=outline),
            el("circle", cx=float(apex[0]), cy=float(apex[1]), r=3),
            el("text", standpoint.label, x=x, y=y, text_anchor=anchor),
            class_=kind,
        )


class _Labels:
    """Keeps labels from lying on each other."""

    def __init__(self) -> None:
        self.taken: list[tuple[float, float]] = []

    def free_place(self, wanted: F64, letters: int) -> tuple[float, float]:
        """``wanted`` (x, y), or the nearest place above or below it that no earlier label has."""
        x, y = float(wanted[0]), float(wanted[1])
        width = 8.0 * max(3, letters)
        for step in (0, -1, 1, -2, 2, -3, 3):
            moved = y + 14 * step
            if all(abs(x - tx) > width or abs(moved - ty) > 12 for tx, ty in self.taken):
                y = moved
                break
        self.taken.append((x, y))
        return x, y


def _hull(points: F64) -> F64:
    """Convex hull of [N, 2] points in order, by the monotone chain."""
    ordered = points[np.lexsort((points[:, 1], points[:, 0]))]

    def chain(candidates: F64) -> list[F64]:
        kept: list[F64] = []
        for point in candidates:
            while len(kept) > 1 and _turn(kept[-2], kept[-1], point) <= 0:
                kept.pop()
            kept.append(point)
        return kept[:-1]

    return np.array(chain(ordered) + chain(ordered[::-1]))


def _turn(a: F64, b: F64, c: F64) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _round_length(span: float, metric: bool) -> str:
    if not metric:
        return f"{span:g} units"
    return f"{100 * span:g} cm" if span < 1 else f"{span:g} m"


def _scale_bar(scale: float, height: float, metric: bool) -> list[Html]:
    """A bar of a round length, at most a third of the panel."""
    span = words.nice_ticks(0.0, WIDTH / 3 / scale, 3)[-1]
    y, x = height - 14, 14.0
    return [
        el("line", x1=x, x2=x + span * scale, y1=y, y2=y, class_="scale-bar"),
        el("text", _round_length(span, metric), x=x, y=y - 6),
    ]
