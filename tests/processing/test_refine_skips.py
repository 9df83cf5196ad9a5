"""What the refinement leaves out changes nothing, and is counted."""

from __future__ import annotations

import cv2
import numpy as np

from lfrig.processing.edges import decide_edges
from lfrig.processing.refine import RefineSettings, smooth, snap_to_edges
from lfrig.processing.skipping import Skips, Tally
from lfrig.processing.wide_baseline import refine_wide
from tests.processing import scenes
from tests.processing.test_pipeline import PX, sources

EVERYTHING = Skips.nothing()


def fattened() -> np.ndarray:
    """A surface with a fattened edge [1/m]."""
    _, depth = scenes.photo()
    return np.asarray(cv2.dilate((1 / depth).astype(np.float32), np.ones((7, 7), np.uint8)))


def test_the_snap_leaves_out_what_would_stay() -> None:
    photo, _ = scenes.photo()
    tally, whole = Tally(), Tally()
    less = snap_to_edges(fattened(), photo.image8, PX, RefineSettings(), tally=tally)
    more = snap_to_edges(fattened(), photo.image8, PX, RefineSettings(), skips=EVERYTHING, tally=whole)
    assert np.array_equal(less, more)
    some, everything = tally.counts["certain"], whole.counts["certain"]
    assert 0 < some.done < everything.done == some.done + some.skipped and everything.skipped == 0


def test_the_edge_test_asks_where_it_decides() -> None:
    photo, _ = scenes.photo()
    tally, whole = Tally(), Tally()
    common = (fattened(), sources(), scenes.CAMERA, photo.pose, photo.image8, PX)
    less, changed = decide_edges(*common, tally=tally)
    more, changed_too = decide_edges(*common, skips=EVERYTHING, tally=whole)
    assert np.array_equal(less, more) and changed == changed_too > 0
    some, everything = tally.counts["certain"], whole.counts["certain"]
    assert 0 < some.done < everything.done == some.done + some.skipped and everything.skipped == 0


def test_sources_that_see_nothing_are_not_matched() -> None:
    photo, depth = scenes.photo()
    truth = (1 / depth).astype(np.float32)
    planes = smooth(truth, np.ones_like(truth), photo.image8, PX, RefineSettings())
    tally, whole = Tally(), Tally()
    common = (planes, sources(), scenes.CAMERA, photo.pose, photo.image8)
    less = refine_wide(*common, tally=tally)
    more = refine_wide(*common, skips=EVERYTHING, tally=whole)
    # Only what a source sees by a hundredth or less is weighed differently.
    assert (less.accepted == more.accepted).mean() > 0.999
    assert (np.abs(less.inverse_depth - more.inverse_depth) * PX < 1e-3).mean() > 0.999
    some, everything = tally.counts["sources"], whole.counts["sources"]
    assert 0 < some.done < everything.done == some.done + some.skipped == 2 * truth.size
