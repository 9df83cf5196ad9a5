"""Objects that several scenes are built from. Positions are (side, away): metres to the right of and away from the
camera as it stands at plate angle 30°, the middle of the usual 0–60°, so that scenes read well from all of them.
"""

from __future__ import annotations

import numpy as np

from lfrig.sim.scene import (
    Lamp,
    Material,
    Primitive,
    Scene,
    Texture,
    Vec3,
    backdrop,
    board,
    box,
    cylinder,
    ground,
    rod,
    sphere,
    torus,
    turned,
)
from lfrig.sim.textures import Colour, plain

MIDDLE_DEG = 30.0
_SIDE = np.array([np.cos(np.deg2rad(-MIDDLE_DEG)), np.sin(np.deg2rad(-MIDDLE_DEG))])
_AWAY = np.array([-_SIDE[1], _SIDE[0]])


def at(side: float, away: float, z: float) -> Vec3:
    """Plate coordinates of a point seen from the middle direction [m]."""
    x, y = side * _SIDE + away * _AWAY
    return float(x), float(y), z


def paint(red: float, green: float, blue: float, *, specular: float = 0.0, shininess: float = 60.0) -> Material:
    """A plain colour (sRGB 0..1)."""
    return Material(plain((red, green, blue)), specular=specular, shininess=shininess)


def cloth(texture: Texture, *, specular: float = 0.0, shininess: float = 60.0, shift: float = 0.0,
          tint: Colour = (1.0, 1.0, 1.0)) -> Material:  # fmt: skip
    """A textured surface; ``shift`` moves the texture so that equal objects differ."""
    return Material(texture, tint, specular, shininess, (shift, shift * 0.61))


def stage(name: str, objects: list[Primitive], floor: Material, wall: Material, *, wall_m: float = 0.24,
          lamp: Lamp | None = None) -> Scene:  # fmt: skip
    """A scene: objects on a table before a round wall ``wall_m`` behind the axis."""
    return Scene(name, [ground(0.9, floor), backdrop(wall_m, wall), *objects], lamp or Lamp())


def crate(side: float, away: float, half: Vec3, material: Material, yaw: float = 0.0, lift: float = 0.0) -> Primitive:
    """A box that stands on the table (or ``lift`` above it), turned by ``yaw`` degrees."""
    return box(at(side, away, lift + half[2]), half, material, turned(yaw - MIDDLE_DEG))


def ball(side: float, away: float, radius: float, material: Material, lift: float = 0.0, yaw: float = 0.0) -> Primitive:
    """A ball on the table; its texture's poles lie on the outline that the camera sees."""
    return sphere(at(side, away, lift + radius), radius, material, turned(yaw - MIDDLE_DEG, 0.0, -28.0))


def column(side: float, away: float, radius: float, height: float, material: Material, lift: float = 0.0) -> Primitive:
    """An upright cylinder on the table."""
    return cylinder(at(side, away, lift + height / 2), radius, height / 2, material, turned(-MIDDLE_DEG))


def ring(side: float, away: float, major: float, minor: float, material: Material, lift: float = 0.0) -> Primitive:
    """A ring that lies flat."""
    return torus(at(side, away, lift + minor), major, minor, material)


def hoop(side: float, away: float, major: float, minor: float, material: Material, yaw: float = 0.0,
         lift: float = 0.0) -> Primitive:  # fmt: skip
    """A ring that stands upright."""
    return torus(at(side, away, lift + major + minor), major, minor, material, turned(yaw - MIDDLE_DEG, 0.0, 90.0))


def panel(side: float, away: float, half_width: float, half_height: float, material: Material, yaw: float = 0.0,
          lift: float = 0.0) -> Primitive:  # fmt: skip
    """An upright picture that faces the middle camera, turned by ``yaw``."""
    return board(at(side, away, lift + half_height), half_width, half_height, material, yaw - MIDDLE_DEG)


def stick(start: tuple[float, float, float], end: tuple[float, float, float], diameter_mm: float,
          material: Material) -> Primitive:  # fmt: skip
    """A thin rod between two (side, away, z) points."""
    return rod(at(*start), at(*end), diameter_mm / 2000, material)


def mug(
    side: float, away: float, radius: float, height: float, material: Material, handle: Material
) -> list[Primitive]:
    """A closed mug with a handle to its right."""
    return [
        column(side, away, radius, height, material),
        hoop(side + radius, away, height * 0.28, height * 0.07, handle, lift=height * 0.12),
    ]


def book_pile(side: float, away: float, covers: list[Material], pages: Material, yaw: float) -> list[Primitive]:
    """Books lying on each other, each turned a little further."""
    pile: list[Primitive] = []
    lift = 0.0
    for k, cover in enumerate(covers):
        thick = 0.007 + 0.003 * (k % 2)
        turn = yaw + 11 * k
        pile.append(crate(side, away, (0.040 - 0.003 * k, 0.028, 0.0015), cover, turn, lift))
        pile.append(crate(side, away, (0.038 - 0.003 * k, 0.0265, thick), pages, turn, lift + 0.003))
        pile.append(crate(side, away, (0.040 - 0.003 * k, 0.028, 0.0015), cover, turn, lift + 0.003 + 2 * thick))
        lift += 0.006 + 2 * thick
    return pile


def figure(side: float, away: float, scale: float, body: Material, head: Material, limbs: Material,
           hat: Material | None = None) -> list[Primitive]:  # fmt: skip
    """A standing figurine about 9.5 cm · ``scale`` tall: feet, legs, body, arms, head with eyes and nose, hat."""
    s = scale
    dark = paint(0.08, 0.08, 0.09, specular=0.3)
    parts = [
        ball(side - 0.010 * s, away - 0.004 * s, 0.008 * s, limbs),
        ball(side + 0.010 * s, away - 0.004 * s, 0.008 * s, limbs),
        column(side, away, 0.019 * s, 0.040 * s, body, lift=0.010 * s),
        ball(side, away, 0.019 * s, body, lift=0.031 * s),
        stick((side - 0.017 * s, away, 0.043 * s), (side - 0.033 * s, away - 0.012 * s, 0.022 * s), 7 * s, limbs),
        stick((side + 0.017 * s, away, 0.043 * s), (side + 0.034 * s, away - 0.006 * s, 0.058 * s), 7 * s, limbs),
        ball(side, away, 0.016 * s, head, lift=0.060 * s),
        ball(side, away - 0.016 * s, 0.004 * s, limbs, lift=0.071 * s),
        ball(side - 0.006 * s, away - 0.0138 * s, 0.0026 * s, dark, lift=0.0775 * s),
        ball(side + 0.006 * s, away - 0.0138 * s, 0.0026 * s, dark, lift=0.0775 * s),
    ]
    if hat is not None:
        parts.append(ring(side, away, 0.014 * s, 0.004 * s, hat, lift=0.083 * s))
        parts.append(column(side, away, 0.011 * s, 0.018 * s, hat, lift=0.085 * s))
    return parts
