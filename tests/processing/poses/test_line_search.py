"""Lines of light fields by search along epipolar lines: what recorded optics leave open is found, nonsense is not."""

from __future__ import annotations

import numpy as np
import pytest

from lfrig.contracts.progress import Monitor
from lfrig.processing.poses.light_fields import recorded_line, with_lines
from lfrig.processing.poses.line_search import search_lines
from lfrig.processing.poses.priors import given_arrangement, photo_prior, with_photo
from lfrig.processing.poses.sightings import Looks, look_at
from lfrig.processing.poses.with_given import least_kept
from lfrig.processing.poses.work import PoseWork

OFF = (1.06, 0.95)


@pytest.fixture(scope="module")
def posed(studio):
    return studio.shoot((-15.0, 0.0, 15.0), 6.0, width=360, height=250, given=True, light_fields=True, sigma_optics=0.0)


def prepared(posed):
    """Looks, and the arrangement whose lines are off as recorded optics may be."""
    looks = look_at(posed.sources, posed.evidence, posed.target, PoseWork(), Monitor())
    known = photo_prior(posed.target, posed.prior)
    whole = with_photo(given_arrangement(posed.sources), posed.target, known)
    lines = [recorded_line(s, len(posed.sources)) for s in posed.sources]
    wrong = [type(line)(line.baseline_m * OFF[0], line.inverse_focus * OFF[1], 0.05) for line in lines]
    return looks, with_lines(whole, wrong)


def test_lines_are_found(posed):
    looks, whole = prepared(posed)
    x = search_lines(looks, whole, np.zeros(whole.size), [0.03] * 3, (0.1, 2.0))
    found = np.exp(x[whole.log_lines]).reshape(-1, 2)[:3] * OFF
    # Together they place a corner to a fraction of a pixel; each for itself is told less well.
    assert np.abs(found[:, 1] - 1).max() < 0.005 and np.abs(found[:, 0] - 1).max() < 0.04
    assert not x[: whole.log_lines.start].any(), "poses and focal lengths stay"


def test_known_lines_stay(posed):
    looks, whole = prepared(posed)
    x = search_lines(looks, whole, np.zeros(whole.size), [0.03] * 3, (0.1, 2.0), known=[0, 2])
    told = x[whole.log_lines].reshape(-1, 2).any(1)
    np.testing.assert_array_equal(told, [False, True, False, False])


def test_nothing_is_told_of_another_scene(posed, studio):
    looks, whole = prepared(posed)
    other = studio.shoot((-15.0, 0.0, 15.0), 6.0, width=360, height=250, scene=50, given=True)
    strangers = look_at(other.sources, other.evidence, other.target, PoseWork(), Monitor()).pictures
    # The corners of the one in the pictures of the other.
    for v in range(3):
        mixed = Looks((*strangers[:v], looks.pictures[v], *strangers[v + 1 :]), looks.reliefs)
        x = search_lines(mixed, whole, np.zeros(whole.size), [0.03] * 3, (0.1, 2.0), known={0, 1, 2} - {v})
        assert not x.any()


def test_what_fits_is_counted(posed):
    from types import SimpleNamespace

    def solved(kept, found):
        views = SimpleNamespace(views=range(2))
        structure = SimpleNamespace(arrangement=views, seen=SimpleNamespace(view=np.array(kept, np.int64)))
        return SimpleNamespace(
            structure=structure, followed=SimpleNamespace(seen=SimpleNamespace(view=np.array(found)))
        )

    assert least_kept(solved([0, 0, 1], [0, 0, 1, 1])) == 0.5
    assert least_kept(solved([0, 0], [0, 0, 1])) == 0
