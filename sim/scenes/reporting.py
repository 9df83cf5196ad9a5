"""Scenes that results are reported on; nothing may be tuned on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lfrig.sim import textures as tx
from lfrig.sim.scene import Lamp, Primitive, Scene
from lfrig.sim.scenes.props import (
    ball,
    book_pile,
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


def desk(seed: int) -> Scene:
    """Books, a pencil cup and papers: mixed, mostly good texture."""
    covers = [cloth(tx.fabric(seed + k, c, 0.05)) for k, c in enumerate(((0.55, 0.16, 0.14), (0.15, 0.30, 0.42)))]
    covers.append(cloth(tx.patches(seed + 3, "dusk", 0.06, 10)))
    pages = cloth(tx.stripes(((0.90, 0.87, 0.79), (0.82, 0.78, 0.68)), 0.02, 8, vertical=False))
    cup = cloth(tx.dead_leaves(seed + 4, "sea", 0.1))
    objects = [*book_pile(-0.050, 0.020, covers, pages, 14), column(0.062, -0.012, 0.020, 0.045, cup)]
    rng = np.random.default_rng([seed, 201])
    for k in range(6):
        a = 2 * np.pi * k / 6 + rng.uniform(-0.3, 0.3)
        foot = (0.062 + 0.008 * np.cos(a), -0.012 + 0.008 * np.sin(a), 0.044)
        top = (0.062 + 0.020 * np.cos(a), -0.012 + 0.020 * np.sin(a), rng.uniform(0.075, 0.1))
        objects.append(stick(foot, top, 4.5, paint(*rng.uniform(0.15, 0.9, 3))))
    objects += [
        crate(-0.005, -0.070, (0.034, 0.024, 0.0015), cloth(tx.printed(seed + 6, width_m=0.07)), -25),
        ball(-0.080, -0.070, 0.016, cloth(tx.noise(seed + 7, "autumn", 0.06), specular=0.2)),
        panel(0.050, 0.120, 0.050, 0.050, cloth(tx.dead_leaves(seed + 8, "autumn", 0.14)), -10),
    ]
    floor = tx.fabric(seed + 9, (0.36, 0.44, 0.36), 0.14, 40)
    return stage("desk", objects, cloth(floor), cloth(tx.dead_leaves(seed + 10, "stone", 0.35)), wall_m=0.26)


def masonry(seed: int) -> Scene:
    """Bricks, tiles and barber's poles: patterns that repeat at several scales."""
    tiles = tx.checker((0.30, 0.40, 0.46), (0.80, 0.83, 0.80), 0.12, 6)
    poles = tx.stripes(((0.90, 0.88, 0.84), (0.70, 0.15, 0.15), (0.18, 0.24, 0.50)), 0.05, 2, slant=2)
    fine = tx.checker((0.86, 0.70, 0.30), (0.30, 0.22, 0.16), 0.04)
    objects = [
        crate(-0.060, 0.030, (0.030, 0.020, 0.035), cloth(tx.bricks(seed + 1, "autumn", 0.06)), 20),
        column(0.010, 0.005, 0.014, 0.080, cloth(poles)),
        column(0.075, 0.030, 0.018, 0.050, cloth(tx.bricks(seed + 2, "stone", 0.04, rows=6, columns=6, bond=0))),
        ball(0.045, -0.060, 0.023, cloth(poles)),
        crate(-0.040, -0.065, (0.018, 0.018, 0.012), cloth(fine), 40),
        hoop(-0.105, -0.020, 0.024, 0.007, cloth(fine), 25),
    ]
    wall = tx.bricks(seed + 3, "dusk", 0.16, rows=10, columns=5)
    return stage("masonry", objects, cloth(tiles), cloth(wall), wall_m=0.22)


def studio(seed: int) -> Scene:
    """A product shot: large plain areas, smooth shading, texture only on a few small things."""
    objects = [
        crate(-0.040, 0.030, (0.032, 0.032, 0.026), paint(0.82, 0.79, 0.74), 32),
        ball(-0.040, 0.030, 0.020, paint(0.76, 0.42, 0.30), lift=0.052),
        column(0.050, -0.005, 0.024, 0.055, paint(0.38, 0.52, 0.56)),
        ring(0.000, -0.070, 0.024, 0.009, paint(0.85, 0.70, 0.40)),
        column(0.100, 0.050, 0.013, 0.080, cloth(tx.weak(seed + 1, (0.60, 0.60, 0.64), 0.1, 0.02))),
        crate(-0.085, -0.055, (0.014, 0.014, 0.014), cloth(tx.dead_leaves(seed + 2, "sea", 0.08)), 15),
        crate(0.068, -0.072, (0.016, 0.010, 0.010), cloth(tx.printed(seed + 3, width_m=0.05)), -20),
    ]
    floor = tx.weak(seed + 4, (0.70, 0.71, 0.73), 0.3, 0.010)
    wall = tx.gradient((0.50, 0.55, 0.62), (0.80, 0.80, 0.78), 0.5)
    return stage("studio", objects, cloth(floor), cloth(wall), wall_m=0.25)


def fence(seed: int) -> Scene:
    """A wire fence and a bare shrub before textured bodies: structures 3–8 px wide at several depths."""
    rng = np.random.default_rng([seed, 202])
    iron, bark = paint(0.20, 0.21, 0.23, specular=0.2), cloth(tx.noise(seed + 1, "autumn", 0.05))
    objects: list[Primitive] = []
    for k in range(9):
        side = -0.115 + 0.027 * k
        objects.append(stick((side, -0.075, 0.0), (side, -0.075, 0.062), 1.5 + 0.9 * (k % 2), iron))
    for z in (0.018, 0.052):
        objects.append(stick((-0.125, -0.0755, z), (0.112, -0.0755, z), 1.8, iron))
    tip = np.array([0.045, 0.01, 0.0])
    objects.append(stick((0.045, 0.01, 0.0), (0.048, 0.012, 0.06), 3.4, bark))
    for _ in range(11):
        start = tip + np.array([0.003, 0.002, rng.uniform(0.025, 0.058)])
        end = start + rng.normal(0, 1, 3) * [0.028, 0.022, 0.0] + [0.0, 0.0, rng.uniform(0.02, 0.055)]
        objects.append(stick(tuple(start), tuple(end), rng.uniform(1.3, 2.2), bark))
    objects += [
        ball(-0.055, 0.015, 0.030, cloth(tx.dead_leaves(seed + 2, "toy", 0.12))),
        crate(0.085, 0.070, (0.024, 0.020, 0.032), cloth(tx.bricks(seed + 3, "meadow", 0.06)), -15),
        column(-0.010, 0.085, 0.016, 0.070, cloth(tx.noise(seed + 4, "sea", 0.08))),
    ]
    floor = tx.noise(seed + 5, "meadow", 0.16)
    return stage("fence", objects, cloth(floor), cloth(tx.dead_leaves(seed + 6, "dusk", 0.26)), wall_m=0.26)


def glaze(seed: int) -> Scene:
    """Glazed pottery: broad and sharp highlights on weakly and strongly painted ware."""
    celadon = tx.noise(seed + 1, "sea", 0.10, contrast=0.6)
    rust = tx.noise(seed + 2, "autumn", 0.08)
    painted = tx.dead_leaves(seed + 3, "toy", 0.1)
    glazes = [
        cloth(t, specular=g, shininess=s) for t, g, s in ((celadon, 1.0, 70), (rust, 1.6, 180), (painted, 1.4, 300))
    ]
    objects = [
        ball(-0.050, 0.015, 0.030, glazes[0]),
        column(-0.050, 0.015, 0.011, 0.030, glazes[0], lift=0.052),
        ring(-0.050, 0.015, 0.010, 0.004, glazes[1], lift=0.079),
        *mug(0.045, -0.035, 0.020, 0.040, glazes[2], glazes[1]),
        ring(-0.015, -0.072, 0.026, 0.008, glazes[1]),
        ring(0.085, 0.045, 0.018, 0.012, glazes[0]),
        ball(0.085, 0.045, 0.017, glazes[2], lift=0.016),
        hoop(0.010, 0.075, 0.034, 0.008, glazes[1], -15),
        ball(-0.095, -0.045, 0.014, glazes[1]),
    ]
    floor = tx.wood(seed + 4, (0.24, 0.20, 0.18), (0.50, 0.44, 0.38), 0.2, 14)
    wall = tx.bricks(seed + 5, "sea", 0.14, rows=5, columns=5, bond=0, joint=0.05)
    return stage("glaze", objects, cloth(floor, specular=0.15, shininess=30), cloth(wall), wall_m=0.25)


def shelf(seed: int) -> Scene:
    """A rack of shelves with goods inside, seen past its uprights: deep, self-occluding."""
    timber = tx.wood(seed + 1, (0.50, 0.36, 0.24), (0.80, 0.66, 0.48), 0.12, 6)
    rng = np.random.default_rng([seed, 203])
    objects: list[Primitive] = []
    for k, side in enumerate((-0.100, 0.0, 0.100)):
        objects.append(crate(side, 0.030, (0.004, 0.040, 0.058), cloth(timber, shift=0.3 * k), 0))
    for k, z in enumerate((0.045, 0.112)):
        objects.append(crate(0.0, 0.030, (0.104, 0.041, 0.003), cloth(timber, shift=0.4 + 0.2 * k), 0, z))
    goods = [
        tx.dead_leaves(seed + 2, "meadow", 0.09),
        tx.patches(seed + 3, "autumn", 0.06),
        tx.printed(seed + 4, width_m=0.06),
        tx.noise(seed + 5, "dusk", 0.07),
    ]
    for k, side in enumerate((-0.075, -0.040, 0.030, 0.068)):
        m = cloth(goods[k], shift=rng.uniform())
        objects.append(ball(side, 0.018, 0.0155, m) if k % 2 else crate(side, 0.028, (0.014, 0.020, 0.017), m, 10 * k))
        n = cloth(goods[3 - k], shift=rng.uniform())
        objects.append(
            column(side, 0.02, 0.012, 0.045, n, lift=0.051)
            if k % 2
            else crate(side, 0.03, (0.013, 0.013, 0.022), n, 15, 0.051)
        )
    objects += [
        crate(-0.060, -0.075, (0.022, 0.016, 0.014), cloth(goods[1], shift=0.4), 30),
        column(0.055, -0.080, 0.012, 0.050, cloth(goods[0], shift=0.7)),
    ]
    floor = tx.bricks(seed + 6, "autumn", 0.2, rows=16, columns=4)
    return stage("shelf", objects, cloth(floor), cloth(tx.noise(seed + 7, "meadow", 0.25)), wall_m=0.28)


def figurines(seed: int) -> Scene:
    """A band of painted figurines on a round stage."""
    coat = [
        tx.patches(seed + 1, "dusk", 0.07, 18),
        tx.stripes(((0.90, 0.86, 0.78), (0.14, 0.38, 0.36)), 0.03),
        tx.noise(seed + 2, "toy", 0.06),
    ]
    skin = [
        paint(0.91, 0.74, 0.60, specular=0.1),
        paint(0.56, 0.38, 0.27, specular=0.1),
        paint(0.80, 0.60, 0.45, specular=0.1),
    ]
    trim = [paint(0.72, 0.16, 0.18), paint(0.22, 0.30, 0.20), paint(0.85, 0.65, 0.20)]
    places = [(-0.062, -0.030, 0.88), (0.0, 0.025, 1.0), (0.060, -0.040, 0.80)]
    objects: list[Primitive] = [
        column(0.0, 0.0, 0.125, 0.008, cloth(tx.wood(seed + 3, (0.46, 0.22, 0.16), (0.72, 0.46, 0.34), 0.15)))
    ]
    for k, (side, away, scale) in enumerate(places):
        parts = figure(side, away, scale, cloth(coat[k]), skin[k], trim[k], trim[(k + 1) % 3] if k != 1 else None)
        objects += [_raised(p, 0.008) for p in parts]
    objects += [
        column(
            -0.018, -0.070, 0.017, 0.016, cloth(tx.stripes(((0.85, 0.20, 0.15), (0.95, 0.92, 0.85)), 0.03)), lift=0.008
        ),
        hoop(0.085, 0.045, 0.020, 0.0045, paint(0.84, 0.68, 0.28, specular=0.7), 10, 0.008),
    ]
    wall = tx.dead_leaves(seed + 5, "meadow", 0.3, largest=0.12)
    return stage("figurines", objects, cloth(tx.noise(seed + 4, "dusk", 0.25)), cloth(wall), wall_m=0.24)


def _raised(p: Primitive, lift: float) -> Primitive:
    return replace(p, position=(p.position[0], p.position[1], p.position[2] + lift))


def snowfield(seed: int) -> Scene:
    """White bodies on a bright ground under hard light: clipped highlights beside long shadows."""
    snow, ice = tx.weak(seed + 1, (0.95, 0.96, 0.97), 0.15, 0.02), paint(0.85, 0.92, 0.97, specular=0.9, shininess=50)
    objects = [
        ball(-0.035, 0.005, 0.030, cloth(snow)),
        ball(-0.035, 0.005, 0.021, cloth(snow, shift=0.4), lift=0.050),
        ball(-0.035, -0.010, 0.0045, paint(0.90, 0.45, 0.10), lift=0.069),
        stick((-0.060, 0.0, 0.040), (-0.085, -0.01, 0.070), 3.0, paint(0.30, 0.20, 0.14)),
        crate(0.055, 0.030, (0.024, 0.020, 0.026), ice, 22),
        column(0.060, -0.060, 0.013, 0.045, cloth(tx.stripes(((0.98, 0.97, 0.95), (0.15, 0.30, 0.55)), 0.04, slant=1))),
        ring(-0.030, -0.075, 0.018, 0.007, cloth(tx.patches(seed + 2, "toy", 0.05))),
        panel(0.060, 0.125, 0.050, 0.040, cloth(tx.printed(seed + 3, (0.98, 0.97, 0.93), width_m=0.09)), -12),
    ]
    lamp = Lamp(position=(-0.42, 0.05, 0.50), radius=0.04, power=0.80, ambient=0.22)
    floor = tx.noise(seed + 4, "stone", 0.2, contrast=0.5)
    return stage(
        "snowfield", objects, cloth(floor, tint=(1.3, 1.3, 1.32)), cloth(tx.noise(seed + 5, "sea", 0.3)), lamp=lamp
    )


def mural(seed: int) -> Scene:
    """Nearly one plane: a picture lying on the table with coins on it, filling most of the view."""
    objects = [crate(0.0, 0.0, (0.16, 0.13, 0.004), cloth(tx.dead_leaves(seed + 1, "dusk", 0.24)), 8)]
    metal = cloth(tx.noise(seed + 2, "stone", 0.04, contrast=0.7), specular=0.4, shininess=40)
    for side, away in ((-0.06, -0.03), (0.02, 0.04), (0.07, -0.05), (-0.02, -0.08)):
        objects.append(column(side, away, 0.012, 0.003, metal, lift=0.008))
    return stage("mural", objects, cloth(tx.wood(seed + 3)), cloth(tx.noise(seed + 4, "stone", 0.25)), wall_m=0.23)
