"""What a simulated scene is made of: textured primitives, one soft lamp, ambient light. Metres; z up from the plate.

Twins and the native core read a scene as plain arrays; `pack` is the one place that knows their layout.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Vec3 = tuple[float, float, float]
LIGHT_POINTS = 32
RECORD_LENGTH = 30


class Kind(IntEnum):
    """Primitive kinds, as the renderers number them."""

    SPHERE = 0
    BOX = 1
    CYLINDER = 2
    TORUS = 3
    BOARD = 4
    DISC = 5
    BACKDROP = 6


@dataclass(frozen=True, eq=False)
class Texture:
    """A repeating picture: ``image`` float32 [H, W, 3] linear RGB in 0..1, sides powers of two, ``width_m`` wide."""

    image: F32
    width_m: float

    def __post_init__(self) -> None:
        height, width = self.image.shape[:2]
        if self.image.dtype != np.float32 or self.image.ndim != 3 or self.image.shape[2] != 3:
            raise ValueError(f"a texture is float32 [H, W, 3], got {self.image.dtype} {list(self.image.shape)}")
        if width & (width - 1) or height & (height - 1):
            raise ValueError(f"a texture's sides are powers of two, got {width}×{height}")

    @property
    def height_m(self) -> float:
        """Height of one repetition [m]."""
        return float(self.width_m * self.image.shape[0] / self.image.shape[1])


@dataclass(frozen=True)
class Material:
    """How a surface looks. ``specular`` is the height of a Blinn-Phong highlight of exponent ``shininess``;
    ``shift`` moves the texture by fractions of a repetition.
    """

    texture: Texture
    tint: Vec3 = (1.0, 1.0, 1.0)
    specular: float = 0.0
    shininess: float = 60.0
    shift: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Primitive:
    """One surface: ``size`` by kind (`sphere` and the others below say what), ``rotation`` local from world [3, 3]."""

    kind: Kind
    position: Vec3
    size: Vec3
    material: Material
    rotation: F64 = field(default_factory=lambda: np.eye(3))
    casts_shadow: bool = True

    def half_extent(self) -> Vec3:
        """Half sizes of the bounding box in the local frame [m]."""
        a, b, c = self.size
        match self.kind:
            case Kind.SPHERE:
                return a, a, a
            case Kind.BOX:
                return a, b, c
            case Kind.CYLINDER:
                return a, a, b
            case Kind.TORUS:
                return a + b, a + b, b
            case Kind.BOARD:
                return a, 0.0, b
            case Kind.DISC:
                return a, a, 0.0
            case Kind.BACKDROP:
                return a, a, b


def turned(yaw_deg: float = 0.0, tilt_deg: float = 0.0, roll_deg: float = 0.0) -> F64:
    """Local-from-world rotation of an object rolled about its x, tilted about its y, then turned about z; [3, 3]."""
    (cz, cy, cx), (sz, sy, sx) = np.cos(angles := np.deg2rad([yaw_deg, tilt_deg, roll_deg])), np.sin(angles)
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    return np.ascontiguousarray((about_z @ about_y @ about_x).T)


def sphere(centre: Vec3, radius: float, material: Material, rotation: F64 | None = None) -> Primitive:
    """A ball."""
    return Primitive(Kind.SPHERE, centre, (radius, 0, 0), material, np.eye(3) if rotation is None else rotation)


def box(centre: Vec3, half: Vec3, material: Material, rotation: F64 | None = None) -> Primitive:
    """A box of half sizes ``half``."""
    return Primitive(Kind.BOX, centre, half, material, np.eye(3) if rotation is None else rotation)


def cylinder(centre: Vec3, radius: float, half: float, material: Material, rotation: F64 | None = None) -> Primitive:
    """A capped cylinder along its local z, of half length ``half``."""
    return Primitive(Kind.CYLINDER, centre, (radius, half, 0), material, np.eye(3) if rotation is None else rotation)


def rod(start: Vec3, end: Vec3, radius: float, material: Material) -> Primitive:
    """A thin cylinder from ``start`` to ``end``."""
    a, b = np.array(start, float), np.array(end, float)
    length = float(np.linalg.norm(b - a))
    z = (b - a) / length
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    centre = (a + b) / 2
    frame = np.ascontiguousarray([x, np.cross(z, x), z])
    return cylinder((centre[0], centre[1], centre[2]), radius, length / 2, material, frame)


def torus(centre: Vec3, major: float, minor: float, material: Material, rotation: F64 | None = None) -> Primitive:
    """A ring around its local z."""
    return Primitive(Kind.TORUS, centre, (major, minor, 0), material, np.eye(3) if rotation is None else rotation)


def board(centre: Vec3, half_width: float, half_height: float, material: Material, yaw_deg: float = 0.0) -> Primitive:
    """An upright rectangle; at yaw 0 it faces −y."""
    return Primitive(Kind.BOARD, centre, (half_width, half_height, 0), material, turned(yaw_deg))


def ground(radius: float, material: Material) -> Primitive:
    """The table top: a disc at z = 0."""
    return Primitive(Kind.DISC, (0, 0, 0), (radius, 0, 0), material, casts_shadow=False)


def backdrop(radius: float, material: Material, height: float = 1.0) -> Primitive:
    """A round wall about the axis that is seen from inside only, so that every ray of every view ends somewhere."""
    return Primitive(Kind.BACKDROP, (0, 0, 0), (radius, height, 0), material, casts_shadow=False)


@dataclass(frozen=True)
class Lamp:
    """A round lamp of ``radius`` [m] that turns with the plate, and the ambient light (more from above)."""

    position: Vec3 = (-0.45, -0.25, 0.60)
    radius: float = 0.06
    power: float = 0.42
    ambient: float = 0.26
    ambient_slope: float = 0.08


@dataclass(frozen=True)
class Scene:
    """A named arrangement on the plate."""

    name: str
    primitives: Sequence[Primitive]
    lamp: Lamp = field(default_factory=Lamp)


@dataclass(frozen=True)
class PackedScene:
    """A scene as arrays: ``primitives`` float64 [N, 30]; ``texels`` float32 of all mip levels; ``table`` int64
    [textures, levels, 3] = (first texel, width, height); ``lamp_points`` float64 [32, 3]; ``lamp_frame`` float64
    [3, 3], rows, z towards the plate; ``corners`` float64 [N, 8, 3], bounding boxes in the world; ``extents`` float64
    [N, 3], their half sizes.
    """

    primitives: F64
    texels: F32
    table: I64
    lamp: Lamp
    lamp_points: F64
    lamp_frame: F64
    corners: F64
    extents: F64


def pack(scene: Scene) -> PackedScene:
    """Lay a scene out for the renderers."""
    textures: list[Texture] = []
    for p in scene.primitives:
        if not any(p.material.texture is t for t in textures):
            textures.append(p.material.texture)
    texels, table = _mip_chains(textures)
    index = {id(t): i for i, t in enumerate(textures)}
    records = np.array([_record(p, index[id(p.material.texture)]) for p in scene.primitives])
    assert records.shape[1] == RECORD_LENGTH
    frame = _lamp_frame(scene.lamp)
    return PackedScene(
        records, texels, table, scene.lamp, _lamp_points(scene.lamp, frame), frame,
        np.array([_corners(p) for p in scene.primitives]), np.array([p.half_extent() for p in scene.primitives], float),
    )  # fmt: skip


def _record(p: Primitive, texture: int) -> list[float]:
    t, (a, b, _) = p.material.texture, p.size
    girth, second = {
        Kind.SPHERE: (a, a / 2),
        Kind.TORUS: (a + b, b),
        Kind.CYLINDER: (a, 0),
        Kind.BACKDROP: (a, 0),
    }.get(p.kind, (0, 0))
    # Whole turns, so that the texture closes on itself.
    turns_u = max(1, round(2 * np.pi * girth / t.width_m)) if girth else 0
    turns_v = max(1, round(2 * np.pi * second / t.height_m)) if second else 0
    density = t.image.shape[1] / t.width_m
    if girth:
        density = max(density, turns_u * t.image.shape[1] / (2 * np.pi * girth))
    return [
        float(p.kind), *p.position, *p.rotation.ravel(), *p.size,
        texture, 1 / t.width_m, 1 / t.height_m, turns_u, turns_v, *p.material.shift, density,
        *p.material.tint, p.material.specular, p.material.shininess, float(p.casts_shadow),
    ]  # fmt: skip


def _corners(p: Primitive) -> F64:
    signs = np.array(np.meshgrid(*[[-1, 1]] * 3, indexing="ij")).reshape(3, 8).T
    return np.asarray(signs * np.array(p.half_extent()) @ p.rotation + np.array(p.position))


def _mip_chains(textures: Sequence[Texture]) -> tuple[F32, I64]:
    """All levels of all textures in one array. Short chains repeat their last level."""
    levels = max(int(np.log2(min(t.image.shape[:2]))) + 1 for t in textures)
    pieces: list[F32] = []
    table = np.zeros((len(textures), levels, 3), np.int64)
    start = 0
    for i, texture in enumerate(textures):
        image = texture.image
        for level in range(levels):
            if level and min(image.shape[:2]) > 1:
                image = ((image[0::2, 0::2] + image[1::2, 0::2] + image[0::2, 1::2] + image[1::2, 1::2]) / 4).astype(
                    np.float32
                )
            table[i, level] = start, image.shape[1], image.shape[0]
            pieces.append(image.ravel())
            start += image.size
    return np.concatenate(pieces), table


def _lamp_frame(lamp: Lamp) -> F64:
    z = -np.array(lamp.position, float)
    z /= np.linalg.norm(z)
    x = np.cross([0.0, 0.0, 1.0], z)
    x = np.array([1.0, 0, 0]) if np.linalg.norm(x) < 1e-9 else x / np.linalg.norm(x)
    return np.ascontiguousarray([x, np.cross(z, x), z])


def _lamp_points(lamp: Lamp, frame: F64) -> F64:
    """Points on the lamp's disc in a sunflower spiral, shuffled so that any stride of them covers the disc."""
    i = np.arange(LIGHT_POINTS)
    radius = lamp.radius * np.sqrt((i + 0.5) / LIGHT_POINTS)
    angle = i * np.pi * (3 - np.sqrt(5))
    disc = np.c_[radius * np.cos(angle), radius * np.sin(angle)] @ frame[:2] + np.array(lamp.position)
    # Bit reversal: strides of a power of two become contiguous runs of radii spread over the disc.
    order = [int(f"{k:05b}"[::-1], 2) for k in range(LIGHT_POINTS)]
    return np.ascontiguousarray(disc[order])
