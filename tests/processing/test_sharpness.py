from __future__ import annotations

import cv2
import numpy as np
import pytest

from lfrig.contracts.progress import Monitor
from lfrig.processing.model import LightField
from lfrig.processing.sharpness import fine_detail, warn_of_defocus
from tests.processing.scenes import look


def picture(centre_m: float) -> np.ndarray:
    return look(centre_m, 0.0)[0]


def capture(name: str, image: np.ndarray) -> LightField:
    return LightField(name, np.broadcast_to(image, (3, 3, *image.shape)))


def test_detail_follows_blur_and_not_contrast() -> None:
    sharp = picture(0.0)
    blurred = [fine_detail(cv2.GaussianBlur(sharp, (0, 0), sigma)) for sigma in (1.0, 1.5, 3.0)]
    assert fine_detail(sharp) > blurred[0] > blurred[1] > blurred[2]
    assert fine_detail((0.5 * sharp + 60).astype(np.uint8)) == pytest.approx(fine_detail(sharp), rel=0.02)
    assert np.isnan(fine_detail(np.full_like(sharp, 90)))


@pytest.mark.parametrize("soft", [0, 1, 2])
def test_the_soft_one_is_named(soft: int) -> None:
    images = [picture(x) for x in (-0.03, 0.0, 0.03)]
    images[soft] = cv2.GaussianBlur(images[soft], (0, 0), 2.0)
    monitor = Monitor()
    warn_of_defocus([capture(f"00{k}", image) for k, image in enumerate(images)], monitor)
    (notice,) = monitor.notices
    assert notice.code == "out-of-focus" and f"capture 00{soft}" in notice.message


@pytest.mark.parametrize("count", [1, 2, 3])
def test_sharp_ones_are_left_in_peace(count: int) -> None:
    monitor = Monitor()
    warn_of_defocus([capture(f"00{k}", picture(0.02 * k)) for k in range(count)], monitor)
    assert monitor.notices == []


def test_a_plain_capture_says_nothing_of_the_others() -> None:
    monitor = Monitor()
    warn_of_defocus([capture("000", picture(0.0)), capture("001", np.full_like(picture(0.0), 90))], monitor)
    assert monitor.notices == []
