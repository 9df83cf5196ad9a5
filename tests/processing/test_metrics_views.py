from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfrig.contracts.errors import BadInput
from lfrig.processing.metrics import light_field_score, psnr, ssim
from lfrig.processing.metrics.views import epi_mae, ssim_map

SHAPE = (40, 48)


def picture(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(20, 230, (*SHAPE, 3)).astype(np.uint8)


def light_field(seed: int = 0, rows: int = 3, cols: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).integers(20, 230, (rows, cols, *SHAPE, 3)).astype(np.uint8)


def test_identical_pictures_reach_the_rounding_limit() -> None:
    assert psnr(picture(), picture()) == pytest.approx(10 * np.log10(255**2 * 12))
    assert ssim(picture(), picture()) == pytest.approx(1.0, abs=1e-6)


@given(shift=st.integers(1, 20))
def test_psnr_of_a_constant_error_by_hand(shift: int) -> None:
    image = picture()
    assert psnr(image + np.uint8(shift), image) == pytest.approx(20 * np.log10(255 / shift), abs=1e-4)


@given(seed=st.integers(1, 50))
def test_psnr_and_ssim_are_symmetric(seed: int) -> None:
    a, b = picture(), picture(seed)
    assert psnr(a, b) == psnr(b, a)
    assert ssim(a, b) == pytest.approx(ssim(b, a), abs=1e-6)


def test_psnr_does_not_depend_on_where_the_pixels_are() -> None:
    a, b = picture(0), picture(1)
    order = np.random.default_rng(2).permutation(a.shape[0])
    assert psnr(a[order], b[order]) == pytest.approx(psnr(a, b))


def test_ssim_against_its_definition() -> None:
    """One pixel by the formula of Wang et al., with the weights written out, in float64."""
    a, b = picture(0), (picture(0) * 0.7 + picture(1) * 0.3).astype(np.uint8)
    offsets = np.arange(11) - 5
    g = np.exp(-(offsets**2) / (2 * 1.5**2))
    window = np.outer(g, g) / g.sum() ** 2
    y, x = 20, 17
    luma = [i[y - 5 : y + 6, x - 5 : x + 6].astype(float) @ [0.299, 0.587, 0.114] for i in (a, b)]
    mean = [(window * i).sum() for i in luma]
    var = [(window * (i - m) ** 2).sum() for i, m in zip(luma, mean, strict=True)]
    cov = (window * (luma[0] - mean[0]) * (luma[1] - mean[1])).sum()
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    expected = (2 * mean[0] * mean[1] + c1) * (2 * cov + c2)
    expected /= (mean[0] ** 2 + mean[1] ** 2 + c1) * (var[0] + var[1] + c2)
    assert ssim_map(a, b)[y, x] == pytest.approx(expected, abs=2e-5)


def test_ssim_falls_with_noise() -> None:
    rng = np.random.default_rng(0)
    image = picture()
    values = [ssim(np.clip(image + rng.normal(0, s, image.shape), 0, 255).astype(np.uint8), image) for s in (2, 10, 40)]
    assert 1 > values[0] > values[1] > values[2] > 0


def test_the_exact_centre_is_left_out_of_the_plain_mean() -> None:
    truth = light_field()
    views = truth + np.uint8(5)
    views[1, 1] = truth[1, 1]
    score = light_field_score(views, truth, border_px=2)
    off = 20 * np.log10(255 / 5)
    exact = 10 * np.log10(255**2 * 12)
    assert score.psnr == pytest.approx(off, abs=1e-4)
    assert score.psnr_corners == pytest.approx(off, abs=1e-4)
    assert score.psnr_with_centre == pytest.approx((8 * off + exact) / 9, abs=1e-4)
    assert score.ssim < score.ssim_with_centre


def test_corners_are_the_four_corners() -> None:
    truth = light_field(rows=5, cols=5)
    views = truth.copy()
    for r, c in ((0, 0), (0, 4), (4, 0), (4, 4)):
        views[r, c] += 10
    score = light_field_score(views, truth, border_px=2)
    assert score.psnr_corners == pytest.approx(20 * np.log10(25.5), abs=1e-4)
    assert score.psnr > score.psnr_corners


def test_the_border_of_the_views_is_not_scored() -> None:
    truth = light_field()
    views = truth.copy()
    views[:, :, :4] = 0
    views[:, :, :, -4:] = 0
    perfect = light_field_score(truth, truth, border_px=4)
    # SSIM windows at the region's rim still look 5 px beyond it.
    assert light_field_score(views, truth, border_px=4).psnr == perfect.psnr
    assert light_field_score(views, truth, border_px=9) == light_field_score(truth, truth, border_px=9)


def test_epi_error_of_one_wrong_view_by_hand() -> None:
    truth = np.full((3, 3, 8, 8, 3), 100, np.uint8)
    views = truth.copy()
    views[1, 1] += 6
    # Horizontal EPIs: in the middle one of three view rows both steps across views are off by 6, none along
    # lines, so (6 + 0) / 2 / 3 = 1; vertical ones alike.
    assert epi_mae(views, truth) == pytest.approx(1.0)


@settings(max_examples=10)
@given(shift=st.integers(1, 20))
def test_epi_error_ignores_a_common_offset(shift: int) -> None:
    truth = light_field()
    assert epi_mae(truth + np.uint8(shift), truth) == 0


def test_other_shapes_and_types_are_refused() -> None:
    with pytest.raises(BadInput, match="one shape"):
        psnr(picture(), picture()[:-1])
    with pytest.raises(BadInput, match="uint16"):
        psnr(picture().astype(np.uint16), picture())  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="one shape"):
        light_field_score(light_field(), light_field(cols=4))
