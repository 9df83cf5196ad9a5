"""Switches and tallies."""

from __future__ import annotations

import pytest

from lfrig.processing.skipping import SKIP_ALL, Skips, Tally


def test_switches_turn_off_one_by_one_and_together() -> None:
    assert all(getattr(SKIP_ALL, name) for name in Skips.names())
    assert not any(getattr(Skips.nothing(), name) for name in Skips.names())
    without = SKIP_ALL.without("bricks")
    assert [name for name in Skips.names() if not getattr(without, name)] == ["bricks"]
    with pytest.raises(TypeError):
        SKIP_ALL.without("luck")


def test_tally_adds_up_and_prices_what_was_left_out() -> None:
    tally = Tally()
    tally.add("planes", 25, 75, "tile planes", 0.1)
    tally.add("planes", 25, 25, "tile planes", 0.1)
    count = tally.counts["planes"]
    assert (count.done, count.skipped, count.unit) == (50, 100, "tile planes")
    assert count.saved_ms == pytest.approx(400)
    with tally.timed("bricks", "bricks") as bricks:
        bricks.done, bricks.skipped = 3, 1
        sum(range(50_000))
    assert tally.counts["bricks"].cpu_s > 0 and tally.counts["bricks"].saved_ms > 0
    tally.add("sources", 0, 4, "pixels")
    assert tally.counts["sources"].saved_ms == 0
