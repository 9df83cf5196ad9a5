"""From the parameters of a turntable rig to its views, and their derivatives. C++ form: ``rig_chain.cpp``.

View v sees ``X_c = wobble_v ∘ correction_g ∘ mount_g ∘ Rz(angle_v + turn_v) X``. A motion of six numbers is
``X → rotation_matrix(m[:3]) X + m[3:]``, in a camera's frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.kernels.bundle import LOCAL, view_table
from lfrig.processing.model import F64

Rigid = tuple[F64, F64]
"""Rotations [..., 3, 3] and translations [..., 3]."""


@dataclass(frozen=True)
class Rig:
    """What is known of G mounts and V views: ``mounts`` float64 [G, 12] (R by rows, t); ``mount`` int32 [V], each
    view's; ``fixed`` float64 [V, 6]: angle [rad], focal length, principal point, baseline, inverse focus distance (0
    where there are none).
    """

    mounts: F64
    mount: NDArray[np.int32]
    fixed: F64

    @property
    def size(self) -> int:
        """Number of parameters: corrections [6 G], turns [V], wobbles [6 V], log focals [V], and logarithms of
        baselines and inverse focus distances [2 V].
        """
        return 6 * len(self.mounts) + 10 * len(self.mount)


def rig_chain(rig: Rig, x: F64) -> tuple[F64, F64]:
    """Views float64 [V, 17] (see `view_table`) at parameters x, and how their local parameters move with x, [V, 9,
    size].

    C++ and NumPy differ by rounding.
    """
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return rig_chain_numpy(rig, x)
    views, derivative = np.empty((len(rig.mount), 17)), np.zeros((len(rig.mount), LOCAL, rig.size))
    native.rig_chain(rig.mounts, rig.mount, rig.fixed, np.ascontiguousarray(x, np.float64), views, derivative)
    return views, derivative


def before_wobble(rig: Rig, x: F64) -> Rigid:
    """Poses of the views without their wobbles."""
    mounts = rig.mounts[:, :9].reshape(-1, 3, 3), rig.mounts[:, 9:]
    corrected = after(x[: 6 * len(rig.mounts)].reshape(-1, 6), mounts)
    first = 6 * len(rig.mounts)
    angle = rig.fixed[:, 0] + x[first : first + len(rig.mount)]
    turn = np.zeros((len(angle), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
    turn[:, 1, 0] = np.sin(angle)
    turn[:, 0, 1] = -turn[:, 1, 0]
    turn[:, 2, 2] = 1
    return corrected[0][rig.mount] @ turn, corrected[1][rig.mount]


def rig_chain_numpy(rig: Rig, x: F64) -> tuple[F64, F64]:
    """NumPy twin of `rig_chain`."""
    count, own = len(rig.mount), np.arange(len(rig.mount))
    turns = 6 * len(rig.mounts)
    wobble_at = turns + count
    focal_at = wobble_at + 6 * count
    line_at = focal_at + count
    corrections, wobbles = x[:turns].reshape(-1, 6), x[wobble_at:focal_at].reshape(-1, 6)
    before = before_wobble(rig, x)
    rotation, translation = after(wobbles, before)
    focal = rig.fixed[:, 1] * np.exp(x[focal_at:line_at])
    line = rig.fixed[:, 4:] * np.exp(x[line_at:]).reshape(-1, 2)
    views = view_table(rotation, translation, focal, rig.fixed[:, 2:4], line)

    table = np.zeros((count, LOCAL, rig.size))
    lift = adjoint(wobbles)
    by_mount, by_wobble = lift @ motion_derivative(corrections)[rig.mount], motion_derivative(wobbles)
    for v in range(count):
        table[v, :6, 6 * rig.mount[v] : 6 * rig.mount[v] + 6] = by_mount[v]
        table[v, :6, wobble_at + 6 * v : wobble_at + 6 * v + 6] = by_wobble[v]
    axis = before[0][:, :, 2]
    swing = np.concatenate([axis, -np.cross(axis, before[1])], 1)
    table[own, :6, turns + own] = (lift @ swing[:, :, None])[:, :, 0]
    table[own, 6, focal_at + own] = 1.0
    for k in (0, 1):
        table[own, 7 + k, line_at + 2 * own + k] = 1.0
    return views, table


def skew(v: F64) -> F64:
    """[v]× with ``skew(v) @ p = v × p``, [..., 3, 3] from [..., 3]."""
    out = np.zeros((*v.shape, 3))
    for i, j, k in ((2, 1, 0), (0, 2, 1), (1, 0, 2)):
        out[..., i, j], out[..., j, i] = v[..., k], -v[..., k]
    return out


def _angles(vector: F64) -> tuple[F64, F64, F64]:
    """Of the angles a of rotation vectors [..., 3]: sin(a)/a, (1 − cos a)/a² and (a − sin a)/a³, [..., 1, 1] each."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    # Series where the quotients lose their digits.
    small = angle < 1e-4
    a = np.where(small, 1.0, angle)
    return (
        np.where(small, 1 - angle**2 / 6, np.sin(a) / a),
        np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(a)) / a**2),
        np.where(small, 1 / 6, (a - np.sin(a)) / a**3),
    )


def rotation_matrix(vector: F64) -> F64:
    """Rodrigues' formula: rotation by |vector| rad about it, [..., 3, 3] from [..., 3]."""
    first, second, _ = _angles(vector)
    s = skew(vector)
    return np.asarray(np.eye(3) + first * s + second * (s @ s), np.float64)


def after(motion: F64, rigid: Rigid) -> Rigid:
    """What ``X → rotation_matrix(motion[:3]) X + motion[3:]`` in the cameras' frames makes of poses; motions [K, 6]."""
    turn = rotation_matrix(motion[..., :3])
    return turn @ rigid[0], (turn @ rigid[1][..., None])[..., 0] + motion[..., 3:]


def adjoint(motion: F64) -> F64:
    """[..., 6, 6]: a small left motion before ``motion`` [..., 6] as a small left motion after it."""
    turn = rotation_matrix(motion[..., :3])
    table = np.zeros((*motion.shape, 6))
    table[..., :3, :3] = table[..., 3:, 3:] = turn
    table[..., 3:, :3] = skew(motion[..., 3:]) @ turn
    return table


def motion_derivative(motion: F64) -> F64:
    """[..., 6, 6]: change of ``motion``'s six numbers as a small left motion after it (left Jacobian of SO(3))."""
    _, second, third = _angles(motion[..., :3])
    s = skew(motion[..., :3])
    left = np.eye(3) + second * s + third * (s @ s)
    table = np.zeros((*motion.shape, 6))
    table[..., :3, :3], table[..., 3:, 3:] = left, np.eye(3)
    table[..., 3:, :3] = skew(motion[..., 3:]) @ left
    return table
