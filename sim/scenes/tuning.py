"""Scenes that parameters may be chosen on. None of their textures, objects or optics recur in `reporting`."""

from __future__ import annotations

import numpy as np

from lfrig.sim import textures as tx
from lfrig.sim.scene import Lamp, Primitive, Scene, Texture
from lfrig.sim.scenes.props import (
    ball,
    cloth,
    column,
    crate,
    figure,
    hoop,
    mug,
    paint,
    panel,
    ring,
    stage,
    stick,
)


def tabletop(seed: int) -> Scene:
    """Everyday things with rich texture on a wooden table."""
    leaves, page = tx.dead_leaves(seed + 11, "autumn", 0.16), tx.printed(seed + 12, width_m=0.09)
    objects = [
        ball(-0.062, -0.015, 0.031, cloth(leaves, specular=0.15)),
        crate(0.045, 0.035, (0.024, 0.030, 0.034), cloth(page), 24),
        *mug(0.030, -0.058, 0.019, 0.042, cloth(tx.patches(seed + 13, "sea", 0.08)), paint(0.85, 0.83, 0.78)),
        ring(-0.025, -0.075, 0.020, 0.008, cloth(tx.noise(seed + 14, "dusk", 0.06), specular=0.2)),
        panel(-0.045, 0.115, 0.050, 0.045, cloth(tx.dead_leaves(seed + 15, "meadow", 0.12)), 12),
        column(0.098, 0.010, 0.014, 0.060, cloth(tx.bricks(seed + 16, "dusk", 0.05))),
    ]
    return stage("tabletop", objects, cloth(tx.wood(seed + 1)), cloth(tx.noise(seed + 2, "stone", 0.3)))


def chequered(seed: int) -> Scene:
    """Patterns that repeat exactly: chequerboard table, striped and chequered bodies."""
    check = tx.checker(width_m=0.16)
    small = tx.checker((0.55, 0.12, 0.12), (0.93, 0.88, 0.76), 0.05)
    bars = tx.stripes(((0.12, 0.25, 0.45), (0.92, 0.90, 0.82)), 0.06)
    hoops = tx.stripes(((0.16, 0.40, 0.28), (0.94, 0.90, 0.70), (0.80, 0.45, 0.15)), 0.07, vertical=False)
    objects = [
        column(-0.055, 0.010, 0.024, 0.070, cloth(bars)),
        ball(0.010, -0.052, 0.027, cloth(small)),
        crate(0.060, 0.028, (0.026, 0.026, 0.030), cloth(small), 35),
        column(0.075, -0.055, 0.013, 0.040, cloth(hoops)),
        ring(-0.065, -0.075, 0.021, 0.009, cloth(bars)),
        panel(0.005, 0.110, 0.060, 0.040, cloth(hoops), -8),
    ]
    wall = tx.bricks(seed + 3, "stone", 0.12, rows=6, columns=3)
    return stage("chequered", objects, cloth(check), cloth(wall))


def plaster(seed: int) -> Scene:
    """Weak contrast everywhere: whitewashed bodies before a whitewashed wall."""

    def white(k: int, warm: float) -> Texture:
        return tx.weak(seed + k, (0.74 + 0.05 * warm, 0.72, 0.70 - 0.05 * warm), 0.12, 0.020)

    objects = [
        ball(-0.045, -0.030, 0.034, cloth(white(1, 0.5))),
        crate(0.040, 0.020, (0.028, 0.022, 0.040), cloth(white(2, -0.6)), 28),
        column(0.070, -0.055, 0.017, 0.036, cloth(white(3, 1.0))),
        ring(-0.005, -0.080, 0.022, 0.009, cloth(white(4, 0.0))),
        column(-0.085, 0.055, 0.016, 0.085, cloth(white(5, -1.0))),
        panel(-0.010, 0.120, 0.040, 0.050, cloth(tx.noise(seed + 6, "stone", 0.2, contrast=0.35)), 10),
    ]
    floor = tx.weak(seed + 7, (0.62, 0.58, 0.52), 0.25, 0.025)
    wall = tx.weak(seed + 8, (0.66, 0.69, 0.70), 0.35, 0.022)
    return stage("plaster", objects, cloth(floor), cloth(wall))


def reeds(seed: int) -> Scene:
    """Leaning reeds 1.3–2.9 mm thick (3–8 px at full size) before foliage."""
    rng = np.random.default_rng([seed, 101])
    colours = [paint(0.72, 0.62, 0.28), paint(0.45, 0.50, 0.20), cloth(tx.wood(seed + 5, width_m=0.05))]
    objects: list[Primitive] = []
    for k in range(17):
        side, away = rng.uniform(-0.11, 0.11), rng.uniform(-0.07, 0.09)
        lean = rng.normal(0, 0.014, 2)
        top = (side + lean[0], away + lean[1], rng.uniform(0.07, 0.13))
        objects.append(stick((side, away, 0.0), top, rng.uniform(1.3, 2.9), colours[k % 3]))
        if k % 3 == 0:
            objects.append(ball(top[0], top[1], 0.005, paint(0.42, 0.24, 0.12), lift=top[2] - 0.004))
    objects += [
        ball(-0.040, 0.030, 0.024, cloth(tx.dead_leaves(seed + 1, "sea", 0.1))),
        crate(0.055, 0.045, (0.020, 0.020, 0.018), cloth(tx.noise(seed + 2, "dusk", 0.1)), 15),
    ]
    floor, wall = tx.noise(seed + 3, "autumn", 0.2), tx.dead_leaves(seed + 4, "meadow", 0.22)
    return stage("reeds", objects, cloth(floor), cloth(wall))


def marbles(seed: int) -> Scene:
    """Glossy balls and rings with sharp highlights that move with the view."""
    rng = np.random.default_rng([seed, 102])
    swirl = [tx.noise(seed + k, p, 0.07, slope=1.8) for k, p in enumerate(("sea", "dusk", "meadow", "toy"))]
    objects: list[Primitive] = []
    spots = [(-0.07, -0.02), (-0.02, -0.06), (0.03, -0.01), (0.075, -0.05), (-0.045, 0.05), (0.05, 0.06), (0.0, 0.025)]
    for k, (side, away) in enumerate(spots):
        radius = rng.uniform(0.014, 0.026)
        gloss = rng.uniform(1.2, 2.2)
        objects.append(ball(side, away, radius, cloth(swirl[k % 4], specular=gloss, shininess=260, shift=0.2 * k)))
    objects += [
        ring(0.020, -0.088, 0.016, 0.006, paint(0.80, 0.60, 0.20, specular=1.5, shininess=120)),
        hoop(-0.095, 0.035, 0.026, 0.006, paint(0.70, 0.70, 0.74, specular=1.5, shininess=120), 30),
        panel(0.010, 0.118, 0.070, 0.030, cloth(tx.printed(seed + 9, width_m=0.1), specular=0.1)),
    ]
    floor = tx.fabric(seed + 5, (0.30, 0.34, 0.44), 0.12)
    return stage("marbles", objects, cloth(floor), cloth(tx.noise(seed + 6, "autumn", 0.3)))


def colonnade(seed: int) -> Scene:
    """Pillars and a frame close to the camera hide most of what stands behind: deep occlusion."""
    stone = tx.noise(seed + 1, "stone", 0.1)
    objects = [
        column(-0.085, -0.095, 0.011, 0.110, cloth(stone)),
        column(-0.015, -0.105, 0.010, 0.105, cloth(stone, shift=0.3)),
        column(0.060, -0.095, 0.011, 0.110, cloth(stone, shift=0.6)),
        crate(-0.012, -0.098, (0.095, 0.012, 0.007), cloth(stone, shift=0.8), 0, 0.108),
        ball(-0.045, 0.020, 0.032, cloth(tx.dead_leaves(seed + 2, "dusk", 0.12))),
        crate(0.050, 0.035, (0.030, 0.022, 0.042), cloth(tx.bricks(seed + 3, "autumn", 0.07)), 18),
        column(0.105, -0.015, 0.015, 0.055, cloth(tx.patches(seed + 4, "meadow", 0.07))),
        panel(-0.060, 0.125, 0.045, 0.060, cloth(tx.dead_leaves(seed + 5, "sea", 0.12)), 14),
    ]
    floor = tx.bricks(seed + 6, "stone", 0.16, rows=4, columns=4, bond=0)
    return stage("colonnade", objects, cloth(floor), cloth(tx.dead_leaves(seed + 7, "autumn", 0.3)))


def blocks(seed: int) -> Scene:
    """A child's building blocks, rings on a peg and a doll: crisp borders between plain colours."""
    cell = [tx.patches(seed + k, "toy", 0.09, 14 + 4 * k) for k in range(3)]
    wood = cloth(tx.wood(seed + 4, (0.62, 0.44, 0.25), (0.86, 0.70, 0.46), 0.08))
    objects = [
        crate(-0.070, 0.020, (0.020, 0.020, 0.020), cloth(cell[0]), 12),
        crate(-0.030, 0.025, (0.018, 0.018, 0.018), cloth(cell[1]), -20),
        crate(-0.050, 0.022, (0.017, 0.017, 0.017), cloth(cell[2]), 33, 0.040),
        crate(0.075, 0.045, (0.015, 0.040, 0.015), wood, 50),
        column(0.045, -0.035, 0.004, 0.070, wood),
        *[
            ring(0.045, -0.035, 0.019 - 0.0025 * k, 0.0075, paint(*colour, specular=0.25), lift=0.013 * k)
            for k, colour in enumerate(((0.80, 0.16, 0.15), (0.93, 0.66, 0.12), (0.15, 0.52, 0.30), (0.15, 0.30, 0.62)))
        ],
        *figure(-0.035, -0.060, 0.85, cloth(cell[1]), paint(0.92, 0.76, 0.62), paint(0.20, 0.28, 0.52), wood),
        ball(0.095, -0.060, 0.017, cloth(cell[0], specular=0.3)),
    ]
    rug = tx.fabric(seed + 6, (0.62, 0.42, 0.36), 0.2, 48)
    return stage("blocks", objects, cloth(rug), cloth(tx.patches(seed + 7, "sea", 0.3, 60)))


def lanterns(seed: int) -> Scene:
    """A strong lamp: bodies and paper burn out to white, shadows stay deep."""
    bright = paint(0.99, 0.98, 0.95, specular=0.6, shininess=30)
    objects = [
        ball(-0.055, -0.020, 0.030, bright),
        column(0.020, 0.020, 0.020, 0.075, cloth(tx.gradient((0.80, 0.55, 0.30), (1.0, 0.98, 0.92), 0.05))),
        crate(0.072, -0.025, (0.020, 0.026, 0.024), cloth(tx.printed(seed + 1, (0.99, 0.98, 0.96), width_m=0.08)), 40),
        ring(-0.010, -0.078, 0.020, 0.008, paint(0.95, 0.80, 0.35, specular=0.9, shininess=40)),
        panel(-0.070, 0.105, 0.040, 0.050, cloth(tx.dead_leaves(seed + 2, "dusk", 0.12)), 20),
        column(0.110, 0.055, 0.012, 0.090, cloth(tx.stripes(((0.95, 0.93, 0.90), (0.60, 0.12, 0.12)), 0.05, slant=2))),
    ]
    lamp = Lamp(position=(-0.50, -0.10, 0.52), radius=0.05, power=0.95, ambient=0.16)
    floor = tx.wood(seed + 3, (0.30, 0.17, 0.10), (0.60, 0.40, 0.25))
    return stage("lanterns", objects, cloth(floor), cloth(tx.noise(seed + 4, "dusk", 0.3)), lamp=lamp)


def poster(seed: int) -> Scene:
    """Nearly one plane: a large picture close to the axis, with almost nothing before it."""
    objects = [
        panel(0.0, -0.005, 0.15, 0.10, cloth(tx.dead_leaves(seed + 1, "toy", 0.26)), 4),
        crate(0.035, -0.018, (0.016, 0.006, 0.012), cloth(tx.printed(seed + 2, width_m=0.05)), 4),
    ]
    floor = tx.noise(seed + 3, "meadow", 0.2)
    return stage("poster", objects, cloth(floor), cloth(tx.noise(seed + 4, "sea", 0.3)))


def atelier(seed: int) -> Scene:
    """Plain bodies before a plain backdrop, shaded softly: only edges, shadows and a faint floor carry texture."""
    objects = [
        ball(0.045, 0.015, 0.034, paint(0.80, 0.78, 0.70)),
        crate(-0.055, -0.005, (0.024, 0.030, 0.034), paint(0.55, 0.64, 0.58), -25),
        column(-0.005, 0.055, 0.018, 0.090, paint(0.78, 0.60, 0.52)),
        ring(0.060, -0.070, 0.020, 0.010, paint(0.45, 0.50, 0.62)),
        panel(0.090, 0.100, 0.030, 0.040, cloth(tx.gradient((0.85, 0.80, 0.70), (0.60, 0.55, 0.55), 0.1)), -15),
        crate(-0.030, -0.080, (0.014, 0.014, 0.008), cloth(tx.dead_leaves(seed + 1, "autumn", 0.08)), 35),
        column(-0.100, 0.060, 0.012, 0.060, cloth(tx.weak(seed + 2, (0.66, 0.62, 0.60), 0.15, 0.02))),
    ]
    floor = tx.weak(seed + 3, (0.66, 0.64, 0.60), 0.2, 0.012)
    wall = tx.gradient((0.62, 0.58, 0.54), (0.78, 0.80, 0.82), 0.5)
    return stage("atelier", objects, cloth(floor), cloth(wall), wall_m=0.25)
