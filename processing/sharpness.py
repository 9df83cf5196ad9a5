"""Whether a capture is as sharp as its neighbours, which show the same things."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from lfrig.contracts.progress import Monitor
from lfrig.processing.model import F32, U8, LightField
from lfrig.processing.poses.work import PoseWork

FINE_PX, COARSE_PX = 1.0, 2.5
TEXTURED = 0.5
"""The half of the pixels with the stronger coarse gradients is judged."""

QUANTILE_STEP = 7
"""Of the pixels that say where that half begins."""

SOFT = 0.87
"""Fine detail relative to the other captures' median. On the tuning scenes sharp captures lie within 0.97 and 1.04, a
Gaussian blur of 1.5 px brings 0.76 to 0.86, noise of 5 grey levels changes neither."""


def fine_detail(picture: U8) -> float:
    """How steep the edges of a picture uint8 [H, W, 3] are at a fine scale, relative to a coarse one.

    The ratio of root mean square gradients after blurs of `FINE_PX` and `COARSE_PX` does not depend on contrast and
    hardly on content: it is near the same for everything sharp. NaN for a plain picture.
    """
    import cv2

    grey = cv2.cvtColor(np.ascontiguousarray(picture), cv2.COLOR_RGB2GRAY).astype(np.float32)
    fine, coarse = (_squared_gradient(cv2.GaussianBlur(grey, (0, 0), sigma)) for sigma in (FINE_PX, COARSE_PX))
    some = coarse.ravel()[::QUANTILE_STEP].copy()
    some.partition(int(TEXTURED * (len(some) - 1)))
    judged = cv2.compare(coarse, float(some[int(TEXTURED * (len(some) - 1))]), cv2.CMP_GE)
    total, detail = (cv2.mean(part, judged)[0] for part in (coarse, fine))
    return float(np.sqrt(detail / total)) if total > 1e-6 else float("nan")


def warn_of_defocus(sources: Sequence[LightField], monitor: Monitor, work: PoseWork | None = None) -> None:
    """Warn of captures that are softer than the others: out of focus, or moved while exposing.

    ``work`` remembers how sharp they were.
    """
    work = PoseWork() if work is None else work
    detail = np.array([work.once("detail", (s.views,), partial(fine_detail, s.centre_view)) for s in sources])
    for k, source in enumerate(sources):
        others = np.delete(detail, k)
        others = others[np.isfinite(others)]
        if not len(others) or not detail[k] < SOFT * float(np.median(others)):
            continue
        monitor.warn(
            "out-of-focus",
            f"capture {source.id} has {detail[k] / float(np.median(others)):.0%} of the fine detail of the other "
            "captures: it is out of focus or was moved while exposing; shoot it again, or leave it out with --sources",
        )


def _squared_gradient(image: F32) -> F32:
    import cv2

    across, down = (cv2.Sobel(image, cv2.CV_32F, *order, ksize=1) for order in ((1, 0), (0, 1)))
    return np.asarray(cv2.add(cv2.multiply(across, across), cv2.multiply(down, down)))
