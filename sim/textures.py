"""Procedural textures from a seed: repeating, band-limited to their own grid, linear RGB. No photos, no dependencies.

Each maker returns a `Texture`; ``size`` is the side in texels (a power of two), ``width_m`` the side in metres.
Patterns are drawn in sRGB, where contrasts look even, at twice the size and filtered down.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lfrig.sim.scene import F64, Texture
from lfrig.sim.tone import linear_from_srgb

Colour = tuple[float, float, float]
SIZE = 512

# Muted painters' palettes (sRGB 0..1), dark to light.
PALETTES: dict[str, tuple[Colour, ...]] = {
    "autumn": ((0.16, 0.10, 0.08), (0.45, 0.19, 0.10), (0.72, 0.38, 0.14), (0.87, 0.65, 0.29), (0.95, 0.88, 0.72)),
    "sea": ((0.05, 0.12, 0.18), (0.08, 0.32, 0.42), (0.19, 0.53, 0.57), (0.55, 0.75, 0.70), (0.92, 0.93, 0.84)),
    "meadow": ((0.10, 0.15, 0.07), (0.22, 0.36, 0.13), (0.47, 0.56, 0.22), (0.76, 0.75, 0.40), (0.93, 0.92, 0.80)),
    "dusk": ((0.12, 0.08, 0.17), (0.35, 0.16, 0.33), (0.67, 0.29, 0.36), (0.90, 0.55, 0.42), (0.97, 0.86, 0.70)),
    "stone": ((0.17, 0.16, 0.15), (0.36, 0.34, 0.32), (0.55, 0.53, 0.49), (0.72, 0.70, 0.65), (0.89, 0.87, 0.83)),
    "toy": ((0.13, 0.18, 0.42), (0.75, 0.15, 0.16), (0.12, 0.52, 0.34), (0.95, 0.75, 0.15), (0.96, 0.95, 0.92)),
}


def _texture(srgb: F64, width_m: float) -> Texture:
    return Texture(linear_from_srgb(np.clip(srgb, 0, 1)).astype(np.float32), width_m)


def _halved(image: F64) -> F64:
    """Box filter by two, after a light blur: no energy near the Nyquist limit of the result."""
    smooth = image
    for axis in (0, 1):
        smooth = 0.25 * np.roll(smooth, 1, axis) + 0.5 * smooth + 0.25 * np.roll(smooth, -1, axis)
    return (smooth[0::2, 0::2] + smooth[1::2, 0::2] + smooth[0::2, 1::2] + smooth[1::2, 1::2]) / 4


def _ramp(value: F64, palette: Sequence[Colour]) -> F64:
    """Colours [H, W, 3] along a palette for values [H, W] in 0..1."""
    stops = np.linspace(0, 1, len(palette))
    table = np.array(palette)
    return np.stack([np.interp(value, stops, table[:, c]) for c in range(3)], -1)


def spectrum_noise(rng: np.random.Generator, size: int, slope: float, low: float = 1, high: float | None = None) -> F64:
    """Periodic noise [size, size] of amplitude spectrum f^−slope between ``low`` and ``high`` cycles per side;
    zero mean, unit variance. Band-limited by construction.
    """
    f = np.hypot(*np.meshgrid(np.fft.fftfreq(size, 1 / size), np.fft.rfftfreq(size, 1 / size), indexing="ij"))
    high = size * 0.35 if high is None else high
    gain = np.where(f >= low, np.maximum(f, 1.0) ** -slope, 0.0) * np.exp(-((f / high) ** 4))
    spectrum = np.fft.rfft2(rng.standard_normal((size, size))) * gain
    noise = np.fft.irfft2(spectrum, s=(size, size))
    return np.asarray((noise - noise.mean()) / noise.std())


def plain(colour: Colour = (0.8, 0.8, 0.8), width_m: float = 0.1) -> Texture:
    """One colour."""
    return _texture(np.broadcast_to(np.array(colour), (8, 8, 3)).astype(np.float64), width_m)


def noise(seed: int, palette: str = "stone", width_m: float = 0.2, slope: float = 1.3, contrast: float = 1.0,
          size: int = SIZE) -> Texture:  # fmt: skip
    """Multi-octave noise along a palette; ``contrast`` 0..1 shrinks it about its middle."""
    rng = np.random.default_rng([seed, 1])
    value = 0.5 + 0.22 * contrast * spectrum_noise(rng, size, slope)
    tint = 0.03 * contrast * spectrum_noise(rng, size, slope)[..., None] * np.array([1.0, 0.0, -1.0])
    return _texture(_ramp(np.clip(value, 0, 1), PALETTES[palette]) + tint, width_m)


def weak(seed: int, colour: Colour = (0.72, 0.70, 0.66), width_m: float = 0.2, amplitude: float = 0.012,
         size: int = SIZE) -> Texture:  # fmt: skip
    """A nearly plain surface: noise of a few grey levels."""
    rng = np.random.default_rng([seed, 2])
    grain = spectrum_noise(rng, size, 0.8, low=4)[..., None] * amplitude
    return _texture(np.array(colour) + grain, width_m)


def dead_leaves(seed: int, palette: str = "autumn", width_m: float = 0.2, smallest: float = 0.008,
                largest: float = 0.18, size: int = SIZE) -> Texture:  # fmt: skip
    """Occluding discs of radius density r^−3, the statistics of natural images (Lee, Mumford & Huang 2001).

    Radii are fractions of the side.
    """
    rng = np.random.default_rng([seed, 3])
    n = 2 * size
    image = np.zeros((n, n, 3))
    colours = np.array(PALETTES[palette])
    free = np.ones((n, n), bool)
    left = n * n
    # Front to back: a disc paints what is still free, until little is.
    while left > 0.002 * n * n:
        u = rng.random()
        radius = n / np.sqrt((1 - u) / smallest**2 + u / largest**2)
        cx, cy = rng.random(2) * n
        a = rng.integers(len(colours))
        colour = np.clip(colours[a] * (0.75 + 0.5 * rng.random()) + 0.06 * rng.standard_normal(3), 0, 1)
        shade = rng.standard_normal(2) * 0.12
        reach = int(np.ceil(radius))
        xs, ys = np.arange(-reach, reach + 1) + int(cx), np.arange(-reach, reach + 1) + int(cy)
        inside = (xs - cx)[None, :] ** 2 + (ys - cy)[:, None] ** 2 <= radius * radius
        index = np.ix_(ys % n, xs % n)
        paint = inside & free[index]
        painted = int(np.count_nonzero(paint))
        if not painted:
            continue
        left -= painted
        lit = 1 + (shade[0] * (xs - cx)[None, :] + shade[1] * (ys - cy)[:, None]) / radius
        block = image[index]
        block[paint] = (colour * lit[..., None])[paint]
        image[index] = block
        free[index] &= ~inside
    image[free] = colours[0]
    return _texture(_halved(np.clip(image, 0, 1)), width_m)


def wood(seed: int, dark: Colour = (0.42, 0.26, 0.14), light: Colour = (0.78, 0.58, 0.36), width_m: float = 0.25,
         rings: int = 9, size: int = SIZE) -> Texture:  # fmt: skip
    """Planed wood: rings bent by slow noise, pores and fibres along x."""
    rng = np.random.default_rng([seed, 4])
    y = np.arange(size)[:, None] / size
    bend = spectrum_noise(rng, size, 2.0, high=6) * 0.05
    phase = rings * (y + bend)
    ring = 0.5 + 0.5 * np.sin(2 * np.pi * phase + 0.8 * np.sin(2 * np.pi * phase))
    # Fibres: white noise low-passed strongly along x, weakly along y.
    fy, fx = np.meshgrid(np.fft.fftfreq(size, 1 / size), np.fft.rfftfreq(size, 1 / size), indexing="ij")
    gain = np.exp(-((fx / (size * 0.02)) ** 2) - (fy / (size * 0.3)) ** 4)
    fibre = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((size, size))) * gain, s=(size, size))
    fibre /= fibre.std()
    value = np.clip(0.25 + 0.45 * ring + 0.13 * fibre, 0, 1)[..., None]
    return _texture(np.array(dark) * (1 - value) + np.array(light) * value, width_m)


def bricks(seed: int, palette: str = "autumn", width_m: float = 0.2, rows: int = 8, columns: int = 4,
           bond: float = 0.5, joint: float = 0.08, size: int = SIZE) -> Texture:  # fmt: skip
    """Bricks (``bond`` 0.5) or tiles (``bond`` 0): each its own shade, with grain and light joints."""
    rng = np.random.default_rng([seed, 5])
    n = 2 * size
    y, x = np.meshgrid((np.arange(n) + 0.5) / n * rows, (np.arange(n) + 0.5) / n * columns, indexing="ij")
    row = np.floor(y).astype(int)
    x = x + bond * (row % 2)
    column = np.floor(x).astype(int) % columns
    colours = np.array(PALETTES[palette])[1:4]
    each = colours[rng.integers(len(colours), size=(rows, columns))] * (0.85 + 0.3 * rng.random((rows, columns, 1)))
    image = each[row % rows, column] * (1 + 0.09 * spectrum_noise(rng, n, 1.0)[..., None])
    fx, fy = (x % 1) * rows / columns, y % 1
    width = rows / columns
    gap = (fy < joint) | (np.minimum(fx, width - fx) < joint / 2)
    image[gap] = np.array([0.80, 0.77, 0.72]) * (1 + 0.05 * spectrum_noise(rng, n, 1.0)[gap, None])
    return _texture(_halved(np.clip(image, 0, 1)), width_m)


def checker(a: Colour = (0.12, 0.12, 0.14), b: Colour = (0.88, 0.86, 0.82), width_m: float = 0.2, squares: int = 8,
            grain: float = 0.0, seed: int = 0, size: int = SIZE) -> Texture:  # fmt: skip
    """A chequerboard of ``squares`` (even) per side; exactly repeating unless ``grain`` is given."""
    n = 2 * size
    i = np.arange(n) * squares // n
    odd = ((i[:, None] + i[None, :]) % 2)[..., None]
    image = np.array(a) * (1 - odd) + np.array(b) * odd
    if grain:
        image = image + grain * spectrum_noise(np.random.default_rng([seed, 6]), n, 1.0)[..., None]
    return _texture(_halved(image), width_m)


def stripes(colours: tuple[Colour, ...], width_m: float = 0.1, repeats: int = 4, vertical: bool = True,
            slant: int = 0, size: int = SIZE) -> Texture:  # fmt: skip
    """Equal stripes, exactly repeating; ``slant`` stripes sets climb per repetition."""
    n = 2 * size
    y, x = np.meshgrid(np.arange(n) / n, np.arange(n) / n, indexing="ij")
    along = (x if vertical else y) * repeats + (y if vertical else x) * slant
    index = np.floor((along % 1) * len(colours)).astype(int) % len(colours)
    return _texture(_halved(np.array(colours)[index]), width_m)


def printed(seed: int, paper: Colour = (0.93, 0.91, 0.86), ink: Colour = (0.12, 0.11, 0.13), width_m: float = 0.12,
            lines: int = 14, size: int = SIZE) -> Texture:  # fmt: skip
    """Lines of letter-like strokes with word gaps and paragraphs, like a printed page."""
    rng = np.random.default_rng([seed, 7])
    n = 2 * size
    page = np.zeros((n, n), bool)
    pitch = n // lines
    height = int(pitch * 0.55)
    for line in range(lines):
        x, top = int(rng.integers(0, pitch)), line * pitch + (pitch - height) // 2
        end = int(n * (0.45 + 0.5 * rng.random())) if rng.random() < 0.25 else n - pitch // 3
        while x < end:
            for _ in range(rng.integers(2, 9)):
                x = _letter(rng, page, x, top, height, end)
            x += height // 2
    ink_here = page[..., None]
    image = np.where(ink_here, np.array(ink), np.array(paper))
    image = image + 0.012 * spectrum_noise(rng, n, 0.7, low=8)[..., None]
    return _texture(_halved(image), width_m)


def _letter(rng: np.random.Generator, page: F64, x: int, top: int, height: int, end: int) -> int:
    """Draw a random letter of upright and level strokes; returns where the next one starts."""
    stroke = max(2, height // 6)
    width = int(height * (0.35 + 0.35 * rng.random()))
    if x + width >= end:
        return end
    small = top + height // 3 * int(rng.random() < 0.7)
    for position in (x, x + width - stroke):
        if rng.random() < 0.75:
            page[small : top + height, position : position + stroke] = True
    for level in (small, (small + top + height) // 2, top + height - stroke):
        if rng.random() < 0.6:
            page[level : level + stroke, x : x + width] = True
    return x + width + stroke


def gradient(low: Colour, high: Colour, width_m: float = 0.2, size: int = 128) -> Texture:
    """A smooth cosine ramp down and up again: no edges, no grain."""
    level = (0.5 - 0.5 * np.cos(2 * np.pi * np.arange(size) / size))[:, None, None]
    image = np.array(low) * (1 - level) + np.array(high) * level
    return _texture(np.broadcast_to(image, (size, size, 3)).copy(), width_m)


def patches(seed: int, palette: str = "toy", width_m: float = 0.1, cells: int = 24, size: int = SIZE) -> Texture:
    """Voronoi cells in palette colours: large flat areas with crisp borders, like painted toys."""
    rng = np.random.default_rng([seed, 8])
    n = 2 * size
    points = rng.random((cells, 2)) * n
    axis = np.arange(n)
    best, owner = np.full((n, n), np.inf), np.zeros((n, n), int)
    for k, (px, py) in enumerate(points):
        dx, dy = np.abs(axis - px), np.abs(axis - py)
        distance = np.minimum(dx, n - dx)[None, :] ** 2 + np.minimum(dy, n - dy)[:, None] ** 2
        closer = distance < best
        best[closer], owner[closer] = distance[closer], k
    colours = np.array(PALETTES[palette])[rng.integers(len(PALETTES[palette]), size=cells)]
    colours = np.clip(colours * (0.85 + 0.3 * rng.random((cells, 1))), 0, 1)
    grain = 0.02 * spectrum_noise(rng, n, 1.0)[..., None]
    return _texture(_halved(colours[owner] + grain), width_m)


def fabric(seed: int, colour: Colour = (0.35, 0.42, 0.52), width_m: float = 0.15, threads: int = 64,
           size: int = SIZE) -> Texture:  # fmt: skip
    """Plain weave with uneven threads: fine and nearly periodic."""
    rng = np.random.default_rng([seed, 9])
    phase = 2 * np.pi * threads * np.arange(size) / size
    warp, weft = np.meshgrid(np.sin(phase), np.sin(phase), indexing="ij")
    uneven = spectrum_noise(rng, size, 0.9, low=2)
    value = 1 + 0.10 * warp + 0.10 * weft + 0.10 * uneven
    return _texture(np.array(colour) * value[..., None], width_m)
