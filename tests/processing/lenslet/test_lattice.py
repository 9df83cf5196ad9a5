from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfrig.contracts.errors import BadInput
from lfrig.processing.lenslet.lattice import HexLattice, fit_lattice, fit_lattice_on_capture

ILLUM_PX = 20 / 1.4


@dataclass(frozen=True)
class White:
    """A hexagonal lattice drawn from its definition, with nothing of the code under test."""

    pitch: float = ILLUM_PX
    rotation: float = 1.3e-3
    origin: tuple[float, float] = (3.7, 8.2)
    vertical: float = 1.0
    shape: tuple[int, int] = (560, 720)
    electrons: float | None = 4000.0
    shading: float = 0.3

    def offsets(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of points from the nearest lens centre."""
        c, s = np.cos(self.rotation), np.sin(self.rotation)
        gx, gy = (
            c * (x - self.origin[0]) + s * (y - self.origin[1]),
            -s * (x - self.origin[0]) + c * (y - self.origin[1]),
        )
        rise = self.pitch * np.sqrt(3) / 2 * self.vertical
        best = np.full((3, *np.shape(x)), np.inf)
        for row in (np.floor(gy / rise), np.floor(gy / rise) + 1):
            shift = (row % 2) / 2
            dx, dy = gx - (np.round(gx / self.pitch - shift) + shift) * self.pitch, gy - row * rise
            nearer = dx**2 + dy**2 < best[2]
            best = np.where(nearer, np.stack([dx, dy, dx**2 + dy**2]), best)
        return best[0], best[1]

    def image(self, seed: int = 0) -> np.ndarray:
        y, x = np.mgrid[0 : self.shape[0], 0 : self.shape[1]].astype(float)
        radius = np.hypot(*self.offsets(x, y)) / (self.pitch / 2)
        level = (1 - 0.3 * radius**2).clip(0.05) / (1 + np.exp((radius - 1.0) * 12))
        half = np.array(self.shape) / 2
        level *= 1 - self.shading * ((x - half[1]) ** 2 + (y - half[0]) ** 2) / (half**2).sum()
        if self.electrons:
            level = np.random.default_rng(seed).poisson(level * self.electrons) / self.electrons
        return (1000 * level).astype(np.float32)

    def miss_px(self, lattice: HexLattice) -> np.ndarray:
        """Distances of all the lattice's centres on the sensor from the true ones."""
        steps = np.arange(-200, 201)
        x, y = np.moveaxis(lattice.centres(steps[None], steps[:, None]), -1, 0)
        on = (x > 0) & (x < self.shape[1]) & (y > 0) & (y < self.shape[0])
        return np.hypot(*self.offsets(x[on], y[on]))


@pytest.mark.parametrize("pitch", [10.004, ILLUM_PX])
def test_noisy_white_images_give_the_lattice_to_a_hundredth_of_a_pixel(pitch: float) -> None:
    white = White(pitch=pitch)
    found = fit_lattice(white.image(), pitch * 1.004)
    miss = white.miss_px(found)
    assert np.sqrt((miss**2).mean()) < 0.015 and miss.max() < 0.05
    # Shading pulls the pitch by the inverse square of the sensor's size: the full sensor is 50 times better.
    assert found.pitch_px == pytest.approx(pitch, abs=6e-4)
    assert found.rotation_rad == pytest.approx(white.rotation, abs=5e-5)
    assert found.vertical == pytest.approx(1, abs=1e-4)
    assert found.lenses > 0.9 * white.shape[0] * white.shape[1] / (pitch**2 * 0.866)
    assert 0.005 < found.residual_rms_px < 0.15


@settings(max_examples=20)
@given(
    st.floats(9, 16), st.floats(-0.02, 0.02), st.floats(-8, 8), st.floats(-8, 8), st.floats(0.99, 1.01),
    st.floats(-0.015, 0.015),
)  # fmt: skip
def test_any_lattice_is_found_from_metadata_that_are_a_little_off(
    pitch: float, rotation: float, x: float, y: float, vertical: float, wrong: float
) -> None:
    white = White(pitch, rotation, (x, y), vertical, (280, 330), electrons=None, shading=0.1)
    found = fit_lattice(white.image(), pitch * (1 + wrong))
    assert white.miss_px(found).max() < 0.06
    assert found.vertical == pytest.approx(vertical, abs=1e-3)


def test_origin_is_the_lens_nearest_the_middle() -> None:
    white = White()
    found = fit_lattice(white.image(), ILLUM_PX)
    assert np.hypot(found.origin[0] - 359.5, found.origin[1] - 279.5) < ILLUM_PX * 0.58


def test_integers_serve_as_well_as_floats() -> None:
    image = White().image()
    fine = fit_lattice(image, ILLUM_PX)
    stored = fit_lattice((image * 40).astype(np.uint16), ILLUM_PX)
    assert stored.origin == pytest.approx(fine.origin, abs=2e-3)


def test_dead_lenses_do_not_pull() -> None:
    white = White()
    image = white.image()
    rng = np.random.default_rng(1)
    for x, y in rng.uniform(0.05, 0.95, (40, 2)) * [720, 560]:
        image[int(y) : int(y) + 9, int(x) : int(x) + 6] = rng.uniform(0, 1500)
    found = fit_lattice(image, ILLUM_PX)
    assert white.miss_px(found).max() < 0.05


@pytest.mark.parametrize(
    ("image", "pitch"),
    [
        (np.random.default_rng(0).random((400, 500), dtype=np.float32), ILLUM_PX),
        (np.ones((400, 500), np.float32), ILLUM_PX),
        (np.zeros((400, 500), np.uint16), ILLUM_PX),
        (White().image(), ILLUM_PX * 1.05),
        (White().image(), ILLUM_PX / 2),
        (White().image(), 3.0),
        (White(shape=(60, 80)).image(), ILLUM_PX),
        (White().image(), float("nan")),
    ],
    ids=["noise", "flat", "black", "pitch 5 % off", "half the pitch", "tiny pitch", "few lenses", "NaN pitch"],
)
def test_what_is_no_white_image_is_refused(image: np.ndarray, pitch: float) -> None:
    with pytest.raises(BadInput) as refusal:
        fit_lattice(image, pitch)
    assert refusal.value.code == "lattice-residual" and refusal.value.remedy


def test_a_shot_shows_its_lattice_too() -> None:
    white = White()
    x, y = np.meshgrid(np.arange(720), np.arange(560))
    scene = 0.5 + 0.4 * np.sin(x / 31) * np.cos(y / 23) + 0.1 * np.sign(np.sin(x / 77 + y / 50))
    shot = white.image() * scene.astype(np.float32)
    found = fit_lattice_on_capture(shot, ILLUM_PX)
    assert np.sqrt((white.miss_px(found) ** 2).mean()) < 0.25
    for seed in range(3):
        with pytest.raises(BadInput):
            fit_lattice_on_capture(np.random.default_rng(seed).random((560, 720), dtype=np.float32), ILLUM_PX)


def test_as_dict_and_back() -> None:
    lattice = HexLattice((1.5, 2.5), 14.3, -0.001, 1.0001, 0.02, 123)
    assert HexLattice.from_dict(lattice.as_dict()) == lattice
    for broken in ({}, lattice.as_dict() | {"origin": [1]}, lattice.as_dict() | {"pitch_px": "nan"}):
        with pytest.raises((KeyError, TypeError, ValueError)):
            HexLattice.from_dict(broken)


def test_centres_follow_the_definition() -> None:
    lattice = HexLattice((10.0, 20.0), 14.0, np.pi / 2, 1.1)
    across, down = lattice.centres(np.array([2]), np.array([-1]))[0]
    # Half a pitch to the right in odd rows, the negative ones too; turned by 90° from +x towards +y.
    assert (across, down) == pytest.approx((10 + 14 * np.sqrt(3) / 2 * 1.1, 20 + 2.5 * 14))
