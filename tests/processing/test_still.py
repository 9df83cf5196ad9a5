from __future__ import annotations

from itertools import combinations

import cv2
import numpy as np
import pytest

from lfrig.contracts.progress import Monitor
from lfrig.processing.model import Camera, LightField
from lfrig.processing.still import STILL_SHARE, still_share, warn_of_still_background

W, H = 200, 140


def noise(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    image = cv2.GaussianBlur(rng.normal(0, 1, (H, W, 3)).astype(np.float32), (0, 0), 1.5)
    return np.clip(128 + 60 * image / image.std(), 0, 255).astype(np.uint8)


def zoomed(image: np.ndarray, zoom: float) -> np.ndarray:
    """The picture of a longer lens."""
    move = np.array([[zoom, 0, (1 - zoom) * (W - 1) / 2], [0, zoom, (1 - zoom) * (H - 1) / 2]], np.float32)
    return cv2.warpAffine(image, move, (W, H), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


def pictures(still: float, zoom: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Two pictures whose upper part of this share is the same thing, seen through two lenses; the rest is not."""
    rows = round(still * H)
    first, second = noise(1), noise(2)
    second[:rows] = zoomed(first, zoom)[:rows]
    return first, second


def captures(images: list[np.ndarray], angles: list[float | None], focals: list[float]) -> list[LightField]:
    return [
        LightField(f"00{k}", np.broadcast_to(image, (3, 3, H, W, 3)), Camera.centred(W, H, focal), turntable_deg=angle)
        for k, (image, angle, focal) in enumerate(zip(images, angles, focals, strict=True))
    ]


@pytest.mark.parametrize("zoom", [1.0, 1.15])
def test_the_share_that_stands_still(zoom: float) -> None:
    assert still_share(*pictures(0.0, zoom), zoom) < 0.02
    assert 0.25 < still_share(*pictures(0.5, zoom), zoom) < 0.6, "a longer lens shows less of it"


def test_cropped_pictures_are_compared_about_their_optical_axes() -> None:
    first, second = pictures(1.0, 1.15)
    middle = (W - 1) / 2, (H - 1) / 2
    cut = np.ascontiguousarray(second[30:, 60:])
    moved = middle[0] - 60, middle[1] - 30
    assert still_share(first, cut, 1.15, (middle, moved)) > 0.25 and still_share(first, cut, 1.15) < 0.02


def test_a_focal_length_a_few_percent_off_hides_nothing() -> None:
    assert still_share(*pictures(0.5, 1.0), 1.03) > 0.2


def test_plain_pictures_have_no_corners() -> None:
    plain = np.full((H, W, 3), 90, np.uint8)
    assert still_share(plain, plain, 1.0) == 0 and still_share(noise(1), plain, 1.0) == 0


def test_a_still_background_is_reported() -> None:
    monitor = Monitor()
    warn_of_still_background(captures(list(pictures(0.4, 1.1)), [0.0, 15.0], [300.0, 330.0]), monitor)
    (notice,) = monitor.notices
    assert notice.code == "still-background" and "000 and 001" in notice.message


@pytest.mark.parametrize(("angles", "said"), [([0.0, 15.0], True), ([None, None], True), ([0.0, 359.0], False)])
def test_only_what_should_have_turned_is_judged(angles: list[float | None], said: bool) -> None:
    monitor = Monitor()
    warn_of_still_background(captures(list(pictures(0.5)), angles, [300.0, 300.0]), monitor)
    assert bool(monitor.notices) == said


def test_one_pair_of_many_is_not_believed() -> None:
    first, second = pictures(0.5)
    monitor = Monitor()
    warn_of_still_background(captures([first, second, noise(3)], [0.0, 15.0, 30.0], [300.0] * 3), monitor)
    assert monitor.notices == [] and still_share(first, second, 1.0) > STILL_SHARE


def test_what_repeats_around_the_plate_does_not_stand_still() -> None:
    """Captures a period apart look alike, the others do not."""
    first, second = pictures(0.5)
    images = [first, noise(3), second, noise(4), zoomed(first, 1.0)]
    monitor = Monitor()
    warn_of_still_background(captures(images, [0.0, 15.0, 30.0, 45.0, 60.0], [300.0] * 5), monitor)
    assert monitor.notices == []
    assert sum(still_share(a, b, 1.0) > STILL_SHARE for a, b in combinations(images, 2)) == 3


def test_the_same_every_time() -> None:
    assert len({still_share(*pictures(0.3, 1.1), 1.1) for _ in range(3)}) == 1
