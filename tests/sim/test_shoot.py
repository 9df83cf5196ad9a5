"""Sessions in memory."""

from __future__ import annotations

import numpy as np
import pytest

from lfrig.contracts.errors import Interrupted
from lfrig.contracts.progress import Monitor
from lfrig.sim.shoot import shoot
from tests.sim.small import one_of_each, scene

SCENE = scene(*one_of_each())


def test_sources_then_the_target() -> None:
    session = shoot(SCENE, 24, 16, (0.0, 15.0), 8.0)
    assert list(session.captures) == ["000", "001", "002"]
    assert session.source_ids == ["000", "001"]
    assert session.target_id == "002"
    assert [c.document.kind for c in session.captures.values()] == ["light_field", "light_field", "photo"]
    assert [c.document.turntable_deg for c in session.captures.values()] == [0.0, 15.0, 8.0]
    assert set(session.truth.captures) == set(session.captures)
    assert session.truth.scene == "test"


def test_light_field_as_target() -> None:
    session = shoot(SCENE, 24, 16, (0.0,), 8.0, lf_as_target=True)
    assert session.target.document.kind == "light_field"
    assert session.target.pixels.shape == (7, 7, 16, 24, 3)
    assert session.target.truth.views is not None
    np.testing.assert_array_equal(session.target.pixels, session.target.truth.views)


def test_pixels_do_not_depend_on_what_is_recorded_of_the_poses() -> None:
    prior, given = (shoot(SCENE, 24, 16, (0.0,), 8.0, poses=p, truth_views=False) for p in ("prior", "given"))
    for name in prior.captures:
        np.testing.assert_array_equal(prior.captures[name].pixels, given.captures[name].pixels)


def test_cancel() -> None:
    class Impatient(Monitor):
        def on_advance(self, steps: int) -> None:
            self.cancel()

    with pytest.raises(Interrupted):
        shoot(SCENE, 24, 16, (0.0, 15.0), 8.0, monitor=Impatient())
