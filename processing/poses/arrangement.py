"""How the cameras of a shoot hang together: what is shared, what may move, and by how much it is expected to.

View v sees ``X_c = wobble_v ∘ correction_g ∘ mount_g ∘ Rz(angle_v + turn_v) X``, with mount g shared by all views of
one standing camera. A view with a pose of its own is a mount that nobody shares. Every parameter has a Gaussian prior
around zero, whose sigma the calibration knows; a sigma of zero holds it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.kernels.rig_chain import Rig, after, before_wobble, rig_chain
from lfrig.processing.model import F64, Camera, Pose, ScaleFit

BLUNDER = 4.0
"""Beyond this many sigmas a turntable angle, a focal length or recorded optics count as a blunder and lose their pull
(Cauchy)."""


@dataclass(frozen=True)
class Line:
    """Disparity by depth, ``δ = b F (1/z − c)`` [px per view step]: baseline b [m], inverse focus distance c [1/m], and
    the relative standard deviation of each (0 = held).
    """

    baseline_m: float
    inverse_focus: float
    sigma: float = 0.0

    @classmethod
    def of_scale(cls, scale: ScaleFit, camera: Camera, sigma: float) -> Line:
        """The line of a fitted scale ``1/z = a δ + c``."""
        return cls(1 / (scale.a * camera.focal_px), scale.c, sigma)

    def scale(self, camera: Camera) -> ScaleFit:
        """As ``1/z = a δ + c``."""
        return ScaleFit(1 / (self.baseline_m * camera.focal_px), self.inverse_focus)


@dataclass(frozen=True)
class Viewpoint:
    """One view: its camera (with ``sigma_focal``), its mount, the plate's angle, how far it may stray, and for a light
    field its line.

    ``sigma_wobble_z_m`` is the wobble along the optical axis where it exceeds the others: zoom and focus move the
    entrance pupil.
    """

    camera: Camera
    mount: int
    angle_deg: float = 0.0
    sigma_angle_deg: float = 0.0
    sigma_wobble_deg: float = 0.0
    sigma_wobble_m: float = 0.0
    sigma_wobble_z_m: float = 0.0
    line: Line | None = None


@dataclass(frozen=True)
class Arrangement:
    """The prior: poses of the mounts (with sigmas) and the views on them. Parameters are one vector:
    mount corrections [6 G], turns [V] (rad), wobbles [6 V], log focals [V], and log baselines and inverse focus
    distances [2 V].
    """

    mounts: tuple[Pose, ...]
    views: tuple[Viewpoint, ...]

    @property
    def size(self) -> int:
        """Number of parameters, held ones included."""
        return 6 * len(self.mounts) + 10 * len(self.views)

    @cached_property
    def turns(self) -> slice:
        """Where the turns are."""
        start = 6 * len(self.mounts)
        return slice(start, start + len(self.views))

    @cached_property
    def log_focals(self) -> slice:
        """Where the logarithms of the focal corrections are."""
        start = self.turns.stop + 6 * len(self.views)
        return slice(start, start + len(self.views))

    @cached_property
    def log_lines(self) -> slice:
        """Where the logarithms of the lines' corrections are, two per view."""
        return slice(self.log_focals.stop, self.size)

    def wobble(self, view: int) -> slice:
        """Where the wobble of a view is."""
        start = self.turns.stop + 6 * view
        return slice(start, start + 6)

    def of_view(self, view: int) -> NDArray[np.intp]:
        """Indices of a view's own parameters [10]: turn, wobble, log focal, line."""
        wobble, line = self.wobble(view), self.log_lines.start + 2 * view
        return np.array(
            [self.turns.start + view, *range(wobble.start, wobble.stop), self.log_focals.start + view, line, line + 1],
            np.intp,
        )

    def sigmas(self) -> F64:
        """Standard deviation of every parameter, float64 [size]; 0 = held."""
        sigma = np.zeros(self.size)
        for g, mount in enumerate(self.mounts):
            sigma[6 * g : 6 * g + 6] = [np.deg2rad(mount.sigma_deg)] * 3 + [mount.sigma_m] * 3
        for v, view in enumerate(self.views):
            sigma[self.turns.start + v] = np.deg2rad(view.sigma_angle_deg)
            along = max(view.sigma_wobble_m, view.sigma_wobble_z_m)
            sigma[self.wobble(v)] = [np.deg2rad(view.sigma_wobble_deg)] * 3 + [view.sigma_wobble_m] * 2 + [along]
            sigma[self.log_focals.start + v] = view.camera.sigma_focal
            if view.line is not None:
                sigma[self.log_lines][2 * v : 2 * v + 2] = view.line.sigma
        return sigma

    @property
    def _heavy_tailed(self) -> tuple[slice, ...]:
        return self.turns, self.log_focals, self.log_lines

    def precision(self, x: F64, sigma: F64) -> F64:
        """1/σ² of the prior on every free parameter at x [n]; a blunder pulls less."""
        weight = 1 / sigma**2
        for part in self._heavy_tailed:
            weight[part] /= 1 + (x[part] / (BLUNDER * sigma[part])) ** 2
        return weight

    def prior_cost(self, x: F64, sigma: F64) -> float:
        """What the parameters' distance from the prior costs, in squared sigmas."""
        free = sigma > 0
        squared = np.zeros(len(x))
        squared[free] = (x[free] / sigma[free]) ** 2
        for part in self._heavy_tailed:
            squared[part] = BLUNDER**2 * np.log1p(squared[part] / BLUNDER**2)
        return float(squared.sum())

    def poses(self, x: F64) -> tuple[Pose, ...]:
        """Camera poses at parameters x."""
        return tuple(Pose(v[:9].reshape(3, 3), v[9:12]) for v in self.linearise(x)[0])

    def cameras(self, x: F64) -> tuple[Camera, ...]:
        """Cameras at parameters x."""
        scale = np.exp(x[self.log_focals])
        return tuple(
            replace(view.camera, focal_px=view.camera.focal_px * float(s))
            for view, s in zip(self.views, scale, strict=True)
        )

    def lines(self, x: F64) -> tuple[Line | None, ...]:
        """Lines at parameters x."""
        change = np.exp(x[self.log_lines])
        return tuple(
            view.line
            and Line(
                view.line.baseline_m * float(change[2 * v]),
                view.line.inverse_focus * float(change[2 * v + 1]),
                view.line.sigma,
            )
            for v, view in enumerate(self.views)
        )

    @cached_property
    def _rig(self) -> Rig:
        mounts = [np.r_[m.rotation.ravel(), m.translation] for m in self.mounts]
        fixed = [
            (np.deg2rad(v.angle_deg), v.camera.focal_px, v.camera.cx, v.camera.cy)
            + ((0.0, 0.0) if v.line is None else (v.line.baseline_m, v.line.inverse_focus))
            for v in self.views
        ]
        mount = np.array([v.mount for v in self.views], np.int32)
        return Rig(np.array(mounts, np.float64), mount, np.array(fixed, np.float64))

    def linearise(self, x: F64) -> tuple[F64, F64]:
        """Poses, cameras and lines at parameters x as the kernels of the adjustment take them, float64 [V, 17]; and the
        motion of each view's local parameters with x, float64 [V, LOCAL, size].
        """
        return rig_chain(self._rig, x)

    def local_derivative(self, x: F64) -> F64:
        """Motion of each view's local parameters with x, float64 [V, LOCAL, size]."""
        return self.linearise(x)[1]

    def start_at(self, x: F64, view: int, pose: Pose) -> F64:
        """X with the mount correction that puts ``view``, alone on its mount, at ``pose``."""
        if sum(other.mount == self.views[view].mount for other in self.views) != 1:
            raise ValueError("the mount is shared")
        x = x.copy()
        g = self.views[view].mount
        x[6 * g : 6 * g + 6] = 0
        x[self.wobble(view)] = 0
        rotation, translation = (part[view] for part in before_wobble(self._rig, x))
        turn = pose.rotation @ rotation.T
        x[6 * g : 6 * g + 6] = np.r_[rotation_vector(turn), pose.translation - turn @ translation]
        return x


def rotation_vector(rotation: F64) -> F64:
    """Inverse of `rotation_matrix` [3] for angles below 180°."""
    import cv2

    return np.asarray(cv2.Rodrigues(rotation)[0], np.float64).reshape(3)


def moved(motion: F64, pose: Pose) -> Pose:
    """The pose after ``X → rotation_matrix(motion[:3]) X + motion[3:]`` in the camera's frame."""
    return Pose(*after(motion, (pose.rotation, pose.translation)))
