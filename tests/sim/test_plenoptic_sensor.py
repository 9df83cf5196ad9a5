"""What the sensor makes of light: vignetting where the lattice says, radiometry as docs/lenslet.md, noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfrig.sim.plenoptic.body import Body, Model, make_body
from lfrig.sim.plenoptic.lattice import Lattice
from lfrig.sim.plenoptic.sensor import (
    FULL_WELL_E,
    READ_NOISE_E,
    WHITE_LEVEL,
    exposed,
    modulation,
    read_out,
    recorded_gains,
    white_signal,
)
from lfrig.sim.scene import F32, F64
from lfrig.sim.tone import Exposure, develop, linear_from_srgb

EXPOSURE = Exposure(1.4, (1.05, 1.0, 0.95))


def body(model: Model = "ILLUM", width: int = 24, height: int = 16, seed: int = 0) -> Body:
    return make_body(model, width, height, 1e-4, np.random.default_rng(seed))


def fraction(values: F64, b: Body) -> F64:
    """Of the way from black to white."""
    return (values.astype(float) - b.figures.black) / (b.figures.white - b.figures.black)


def uniform(b: Body, level: float) -> F32:
    return np.full(b.shape, level, np.float32)


@pytest.mark.parametrize(
    ("size", "sensor"),
    [((96, 64), (880, 586)), ((135, 94), (1236, 860)), ((270, 188), (2472, 1720)), ((541, 376), (7728, 5368))],
)
def test_sensor_sizes(size: tuple[int, int], sensor: tuple[int, int]) -> None:
    b = body("ILLUM", *size)
    assert (b.figures.width, b.figures.height) == sensor
    for n in range(20):
        lattice = b.lattice(np.random.default_rng(n))
        assert (round(sensor[0] / lattice.pitch_px), round(sensor[1] / lattice.pitch_px)) == size


def test_real_sensors_have_their_real_pitch() -> None:
    illum, f01 = body("ILLUM", 541, 376), body("F01", 328, 328)
    assert illum.nominal_pitch_px == pytest.approx(20 / 1.4)
    assert (f01.figures.width, f01.figures.height, f01.nominal_pitch_px) == (3280, 3280, pytest.approx(10.0))


@pytest.mark.parametrize("size", [(18, 12), (48, 32), (100, 80), (333, 222)])
@pytest.mark.parametrize("model", ["ILLUM", "F01"])
def test_any_size_has_whole_groups_of_pixels(model: Model, size: tuple[int, int]) -> None:
    b = body(model, *size)
    assert b.figures.width % 4 == b.figures.height % 2 == 0
    p = b.nominal_pitch_px
    assert (round(b.figures.width / p), round(b.figures.height / p)) == size


def test_specimens_differ_in_rotation_origin_and_hot_pixels() -> None:
    first, other = body(seed=1), body(seed=2)
    assert first.serial != other.serial
    assert first.rotation_rad != other.rotation_rad
    assert np.deg2rad(0.05) < abs(first.rotation_rad) < np.deg2rad(0.15)
    assert first.origin_px != other.origin_px
    assert first.hot_pixels.tolist() != other.hot_pixels.tolist()


def displacement(image: F64, lattice: Lattice, x: float, y: float) -> F64:
    """How far the lens images around (x, y) are from where the lattice has them [px]: the phases of two of the waves
    that a lattice of symmetric spots is made of.
    """
    p, rise = lattice.pitch_px, lattice.pitch_px * np.sqrt(3) / 2 * lattice.stretch
    c, s = np.cos(lattice.rotation_rad), np.sin(lattice.rotation_rad)
    waves = np.array([[1 / p, -0.5 / rise], [0.0, 1 / rise]]) @ np.array([[c, s], [-s, c]])
    ys, xs = np.mgrid[: image.shape[0], : image.shape[1]].astype(float)
    window = np.exp(-((xs - x) ** 2 + (ys - y) ** 2) / (2 * (2 * p) ** 2)) * image
    x0, y0 = lattice.origin_px
    phases = [np.angle(np.sum(window * np.exp(2j * np.pi * (kx * (xs - x0) + ky * (ys - y0))))) for kx, ky in waves]
    return np.linalg.solve(2 * np.pi * waves, phases)


@pytest.mark.parametrize("pitch", [7.15, 9.15, 20 / 1.4])
def test_white_image_shows_the_lenses_where_the_lattice_has_them(pitch: float) -> None:
    b = body(width=80, height=60)
    lattice = Lattice(pitch, 0.0021, (101.37, 77.81), 0.9995)
    values = read_out(white_signal(modulation(lattice, b.shape), b), b, None)
    white = fraction(values, b) / np.tile(np.array(b.responses)[b.colours], np.array(b.shape) // 2)
    assert white.max() == pytest.approx(WHITE_LEVEL, abs=0.01)
    for x, y in ((110.0, 110.0), (250.0, 178.0), (420.0, 120.0), (330.0, 290.0)):
        assert np.hypot(*displacement(white, lattice, x, y)) < 0.02
    moved = replace(lattice, origin_px=(101.37 - 0.3, 77.81 + 0.2))
    np.testing.assert_allclose(displacement(white, moved, 250.0, 178.0), (0.3, -0.2), atol=0.02)


def test_modulation_is_one_at_the_middle_and_dark_between_lenses() -> None:
    lattice = Lattice(9.15, 0.0, (100.0, 80.0))
    m = modulation(lattice, (161, 201))  # its middle is a lens
    assert m.max() == m[80, 100] == pytest.approx(1.0, abs=1e-4)
    x, y = lattice.centres(np.array(0.0), np.array(0.0))
    corner = m[round(float(y) - 9.15 / np.sqrt(3)), round(float(x))]
    assert corner < 0.25
    # 3 steps to the side, the outer of 7 views, are well lit; far lenses get less than the middle one.
    assert m[80, 103] > 0.8
    assert m[80, 100 + 82] < m[80, 100] - 0.1


@pytest.mark.parametrize("model", ["ILLUM", "F01"])
def test_reading_as_documented_gives_what_develop_gives(model: Model) -> None:
    """Divide by the white image at peak 1 per colour, apply the gains: the exposure's linear picture."""
    b = body(model)
    m = modulation(b.lattice(np.random.default_rng(1)), b.shape)
    raw = fraction(read_out(exposed(uniform(b, 0.3), m, b, EXPOSURE), b, None), b)
    white = fraction(read_out(white_signal(m, b), b, None), b)
    expected = linear_from_srgb(develop(np.full(3, 0.3, np.float32), EXPOSURE) / 255.0)
    gains = recorded_gains(b, EXPOSURE)
    assert gains[1] == 1.0
    lit = m > 0.25
    for y, x in ((0, 0), (0, 1), (1, 0), (1, 1)):
        colour = b.colours[y, x]
        cell = np.s_[y::2, x::2]
        # The brightest pixel of each colour is under a lens near the middle.
        ratio = raw[cell] / (white[cell] / white[cell].max()) * gains[colour]
        assert ratio[lit[cell]].std() / ratio[lit[cell]].mean() < 0.006  # what 10 bits leave
        assert ratio[lit[cell]].mean() == pytest.approx(expected[colour], rel=0.02)


def test_highlights_end_at_the_white_level() -> None:
    b = body()
    for rng in (None, np.random.default_rng(0)):
        values = read_out(uniform(b, 3.0), b, rng)
        assert (values == b.figures.white).all()
    dark = read_out(uniform(b, 0.0), b, None)
    assert (dark == b.figures.black).all()


@pytest.mark.parametrize("level", [0.0, 0.1, 0.6])
def test_noise_is_shot_and_read_noise(level: float) -> None:
    b = replace(body(width=90, height=60), hot_pixels=np.empty((0, 2), np.int32), hot_level=np.empty(0, np.float32))
    values = read_out(uniform(b, level), b, np.random.default_rng(3))
    electrons = fraction(values, b) * FULL_WELL_E
    step = FULL_WELL_E / (b.figures.white - b.figures.black)
    assert electrons.mean() == pytest.approx(level * FULL_WELL_E, abs=0.5)
    variance = level * FULL_WELL_E + READ_NOISE_E**2 + step**2 / 12
    assert electrons.var() == pytest.approx(variance, rel=0.02)


def test_same_generator_same_noise() -> None:
    b = body()
    first, again, other = (read_out(uniform(b, 0.4), b, np.random.default_rng(s)) for s in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.8


def test_hot_pixels_are_where_the_list_has_them() -> None:
    b = body(width=90, height=60)
    dark = read_out(uniform(b, 0.0), b, np.random.default_rng(5))
    ys, xs = np.nonzero(dark > b.figures.black + 60)
    assert sorted(zip(xs, ys, strict=True)) == sorted(map(tuple, b.hot_pixels.tolist()))
    assert len(xs) >= 3
