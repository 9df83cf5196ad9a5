from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfrig.contracts.errors import BadInput
from lfrig.contracts.lytro import COLOURS, BayerPattern
from lfrig.processing.lenslet.colour import LUT_SIZE, colour_matrix, srgb_encode, srgb_lut
from lfrig.processing.lenslet.develop import (
    FULL_SCALE,
    at_peak,
    bayer_sites,
    equalised,
    may_smooth,
    modulation_of,
    no_modulation,
    sensor_planes,
)
from lfrig.processing.lenslet.lattice import HexLattice
from lfrig.processing.lenslet.metadata import RawMetadata

NO_HOT = np.empty((0, 2), np.int32)
META = RawMetadata(
    "ILLUM", 70, 50, 10, "little", "GRBG", (60.0, 64.0, 66.0, 70.0), (1000.0, 1023.0, 1020.0, 1010.0), 1.4e-6, 2e-5,
    white_balance=(1.8, 1.0, 1.0, 1.5),
)  # fmt: skip
RESPONSE = {"r": 0.5, "gr": 1.0, "gb": 0.98, "b": 0.7}


def uniform(level: np.ndarray | float, metadata: RawMetadata = META) -> np.ndarray:
    """Sensor values of a light of this level, by the definition of docs/lenslet.md."""
    signal = np.broadcast_to(level, (metadata.height, metadata.width)).astype(float).copy()
    sites = {"GRBG": ("gr", "r", "b", "gb"), "RGGB": ("r", "gr", "gb", "b")}[metadata.bayer]
    for k, name in enumerate(sites):
        n = COLOURS.index(name)
        cell = np.s_[k // 2 :: 2, k % 2 :: 2]
        signal[cell] = metadata.black[n] + (metadata.white[n] - metadata.black[n]) * signal[cell] * RESPONSE[name]
    return np.rint(signal).astype(np.uint16)


@pytest.mark.parametrize(
    ("bayer", "names"),
    [
        ("RGGB", ["r", "gr", "gb", "b"]), ("GRBG", ["gr", "r", "b", "gb"]),
        ("GBRG", ["gb", "b", "r", "gr"]), ("BGGR", ["b", "gb", "gr", "r"]),
    ],
)  # fmt: skip
def test_the_greens_are_told_apart_by_their_rows(bayer: BayerPattern, names: list[str]) -> None:
    assert [COLOURS[n] for n in bayer_sites(bayer)] == names


@pytest.mark.parametrize("bayer", ["GRBG", "RGGB"])
def test_equalised_colours_lie_on_one_level(bayer: BayerPattern) -> None:
    metadata = replace(META, bayer=bayer)
    values, gains = equalised(uniform(0.6, metadata), metadata)
    assert values.mean() == pytest.approx(FULL_SCALE * 0.6 * 0.99, rel=0.002)
    assert np.ptp(values.astype(int)) < 0.004 * values.mean()
    expected = [0.99 / RESPONSE[name] for name in COLOURS]
    assert gains == pytest.approx(expected, rel=0.004)


def test_noise_below_black_is_no_light() -> None:
    image = uniform(0.5)
    image[10, 10] = 3
    assert equalised(image, META)[0][10, 10] == 0


@pytest.mark.parametrize(
    ("metadata", "level", "code"),
    [(META, 0.0, "black-image"), (replace(META, white=(60.0, 64.0, 66.0, 70.0)), 0.5, "levels")],
)
def test_images_that_cannot_be_a_white_image(metadata: RawMetadata, level: float, code: str) -> None:
    with pytest.raises(BadInput) as refusal:
        equalised(uniform(level), metadata)
    assert refusal.value.code == code and refusal.value.remedy


def test_hot_pixels_of_the_white_image_are_mended_before_it_is_smoothed() -> None:
    image = uniform(0.5)
    hot = np.array([[20, 20], [0, 0], [69, 49]], np.int32)
    image[hot[:, 1], hot[:, 0]] = 1023
    found = modulation_of(image, META, hot, smooth=True).values
    assert np.ptp(found.astype(int)) < 0.01 * found.mean()


def test_smoothing_averages_noise_and_keeps_the_level() -> None:
    level = 0.5 + 0.02 * np.random.default_rng(0).standard_normal((50, 70))
    rough = modulation_of(uniform(level), META, NO_HOT, smooth=False).values
    smooth = modulation_of(uniform(level), META, NO_HOT, smooth=True).values
    assert smooth.std() < 0.45 * rough.std() and smooth.mean() == pytest.approx(rough.mean(), rel=1e-3)


def test_only_views_away_from_the_rim_are_smoothed() -> None:
    assert may_smooth(20 / 1.4, 3) and not may_smooth(20 / 1.4, 7) and not may_smooth(10.0, 3)


def test_the_peak_is_the_brightest_block_of_lenses() -> None:
    metadata = replace(META, width=360, height=300)
    lattice = HexLattice((180.0, 150.0), 14.0)
    y, x = np.mgrid[0:300, 0:360]
    j = np.round((y - 150.0) / lattice.row_rise_px)
    i = np.round((x - 180) / 14 - 0.5 * (j % 2)) + 0.5 * (j % 2)
    radius = np.hypot(x - 180 - 14 * i, y - 150 - lattice.row_rise_px * j)
    shading = 1 - 0.3 * ((x - 180) ** 2 + (y - 150) ** 2) / 230**2
    level = 0.8 * shading * np.clip(1 - (radius / 9) ** 2, 0, 1)
    level += 0.01 * np.random.default_rng(0).standard_normal(level.shape)
    found = at_peak(modulation_of(uniform(level, metadata), metadata, NO_HOT, smooth=False), lattice)
    # The brightest pixel of all is 4 % above it: a draw of the noise.
    assert found.values[149:152, 179:182].mean() * found.unit == pytest.approx(1, abs=0.015)
    assert (found.values * found.unit).max() > 1.02


def test_without_a_white_image_nothing_is_divided() -> None:
    assert (no_modulation((4, 5)).values * no_modulation((4, 5)).unit == 1).all()


def test_levels_and_gains_reach_the_kernel_by_cell_position() -> None:
    planes = sensor_planes(uniform(0.5), META, no_modulation((50, 70)), NO_HOT)
    assert planes.colours == (1, 0, 2, 1)
    assert planes.black == (64, 60, 70, 66)
    assert planes.scale == pytest.approx((1 / 959, 1.8 / 940, 1.5 / 940, 1 / 954))
    assert planes.saturated == (1023, 1000, 1010, 1020)


def test_a_white_level_above_the_bits_still_saturates() -> None:
    metadata = replace(META, white=(1100.0,) * 4)
    assert sensor_planes(uniform(0.5), metadata, no_modulation((50, 70)), NO_HOT).saturated == (1023,) * 4


def test_the_white_image_gives_the_white_balance_where_none_is_recorded() -> None:
    modulation = modulation_of(uniform(0.6), META, NO_HOT, smooth=False)
    planes = sensor_planes(uniform(0.5), replace(META, white_balance=None), modulation, NO_HOT)
    assert planes.scale[1] == pytest.approx(0.99 / 0.5 / 940, rel=0.004)


def test_colour_matrices_keep_grey_grey() -> None:
    rough = ((1.52, -0.4, -0.1), (-0.3, 1.5, -0.19), (0.0, -0.5, 1.5))
    assert colour_matrix(replace(META, colour_matrix=rough)) @ np.ones(3) == pytest.approx(1)
    assert colour_matrix(META) == pytest.approx(np.eye(3))


@pytest.mark.parametrize(
    "matrix",
    [
        ((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        ((float("nan"), 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        ((50.0, -49.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
    ],
)
def test_colour_matrices_that_cannot_be_meant(matrix: tuple[tuple[float, float, float], ...]) -> None:
    assert (colour_matrix(replace(META, colour_matrix=matrix)) == np.eye(3)).all()  # type: ignore[arg-type]


def test_the_display_curve_is_srgb() -> None:
    # IEC 61966-2-1: the ends, the joint of the two parts, mid grey.
    assert srgb_encode(np.array([-1, 0, 0.0031308, 0.21404, 1, 2])) == pytest.approx(
        [0, 0, 0.04045, 0.5, 1, 1], abs=1e-4
    )
    lut = srgb_lut()
    assert (lut[0], lut[-1]) == (0, 255) and (np.diff(lut.astype(int)) >= 0).all()
    light = np.linspace(0, 1, 999)
    assert np.abs(lut[np.rint(light * (LUT_SIZE - 1)).astype(int)] - 255 * srgb_encode(light)).max() < 0.75
