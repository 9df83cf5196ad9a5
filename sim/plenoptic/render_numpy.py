"""NumPy twin of lenslet.cpp: the same float64 operations in the same order."""

from __future__ import annotations

import numpy as np

from lfrig.sim.optics import SimCamera
from lfrig.sim.plenoptic.lattice import from_nearest_lens, in_lattice
from lfrig.sim.render_numpy import I64, RAYS_AT_ONCE, U32, hash32, nearest, shade, unit, view_rays
from lfrig.sim.scene import F32, F64, PackedScene
from lfrig.sim.tone import U8


def lenslets(
    scene: PackedScene, camera: SimCamera, lattice: F64, rectangles: F64, lamp_rectangles: F64, colours: U8,
    seed: int, side: int, first_row: int, sensor_height: int, out: F32,
) -> None:  # fmt: skip
    """Fill ``out`` float32 [rows, Ws], the sensor's rows from ``first_row``; as in `render.render_lenslets`."""
    width, samples = out.shape[1], side * side
    pixels = out.reshape(-1)
    middle = in_lattice(lattice, np.array((width - 1) * 0.5), np.array((sensor_height - 1) * 0.5))
    at_once = max(1, RAYS_AT_ONCE // samples)
    for start in range(0, out.size, at_once):
        index = np.arange(start, min(start + at_once, out.size))
        ys, xs = np.divmod(index + first_row * width, width)
        key = hash32((np.uint32(seed) + (ys * width + xs).astype(np.uint32)).astype(np.uint32))
        gx, gy = in_lattice(lattice, xs.astype(np.float64), ys.astype(np.float64))
        off_x, off_y = from_nearest_lens(gx, gy, lattice[0], lattice[1])
        lens_x = (gx - off_x - middle[0]) / lattice[0] + camera.cx
        lens_y = (gy - off_y - middle[1]) / lattice[0] + camera.cy
        # One row per pixel, one column per sample.
        sample = np.tile(np.arange(samples), len(index))
        lens_x, lens_y, off_x, off_y, key = (np.repeat(a, samples) for a in (lens_x, lens_y, off_x, off_y, key))
        on_lens, on_pixel = sample_places(lattice, key, sample, side)
        ray = view_rays(
            camera, lens_x + on_lens[0], lens_y + on_lens[1], off_x + on_pixel[0], off_y + on_pixel[1]
        )  # fmt: skip
        t, hit, face = nearest(scene, ray, rectangles, np.zeros(len(sample), np.int64), lens_x, lens_y)
        colour = shade(scene, ray, t, hit, face, lamp_rectangles, 1.0 / side / camera.focal_px, sample, samples)
        own = colour[np.arange(len(sample)), np.repeat(colours[ys & 1, xs & 1], samples)]
        total = np.zeros(len(index))
        for s in range(samples):
            total += own[s::samples]
        pixels[index] = (total / samples).astype(np.float32)


def sample_places(lattice: F64, pixel: U32, sample: I64, side: int) -> tuple[tuple[F64, F64], tuple[F64, F64]]:
    """Where samples lie on their lens [lens pitches] and on their pixel [px], both in the lattice's axes.

    Multi-jittered (Chiu, Shirley & Wang 1994). Over the lens: a parallelogram that tiles as the lenses do, each point
    of it moved by whole lenses to where it lies on this one. Each pixel moves the pattern of its samples over the lens:
    in itself it favours parts of the hexagon. ``pixel`` uint32 [N] is the pixel's hash, ``sample`` the sample's number.
    """
    key = pixel + sample.astype(np.uint32) * np.uint32(4)
    shift_a, shift_b = unit(hash32(pixel + np.uint32(1000))), unit(hash32(pixel + np.uint32(1001)))
    pitch, row_pitch, cosine, sine = lattice[:4]
    row_step, step = row_pitch / pitch, 1.0 / side
    i, j = (sample % side).astype(np.float64), (sample // side).astype(np.float64)
    a = (i + (j + unit(hash32(key))) * step) * step + shift_a
    b = (j + (i + unit(hash32(key + np.uint32(1)))) * step) * step + shift_b
    on_lens = from_nearest_lens(a + 0.5 * b, b * row_step, 1.0, row_step)
    px = (j + unit(hash32(key + np.uint32(2)))) * step - 0.5
    py = (i + unit(hash32(key + np.uint32(3)))) * step - 0.5
    return on_lens, (cosine * px + sine * py, cosine * py - sine * px)
