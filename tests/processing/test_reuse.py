"""Evidence that is not computed twice: the key tells everything apart that matters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfrig.contracts.progress import Monitor
from lfrig.processing import prepare
from lfrig.processing.dpv import DpvSettings
from lfrig.processing.model import Evidence, LightField, RigPrior
from lfrig.processing.options import Settings
from lfrig.processing.reuse import MemoryStore, evidence_key, size_bytes
from lfrig.processing.skipping import Skips, Tally
from tests.processing import scenes


def little(value: int) -> Evidence:
    flat = np.zeros((4, 5), np.float32)
    return Evidence(np.full((4, 5, 6), value, np.uint16), (0.0, 0.1), flat, flat)


def test_the_key_tells_apart_what_evidence_depends_on() -> None:
    field = scenes.light_field("a", 0.0, 3)
    changed = field.views.copy()
    changed[2, 1, 7, 9, 1] ^= 1
    keys = [
        evidence_key(field, None, DpvSettings(), Skips()),
        evidence_key(replace(field, views=changed), None, DpvSettings(), Skips()),
        evidence_key(field, (-1.0, 1.0), DpvSettings(), Skips()),
        evidence_key(field, None, DpvSettings(window=4), Skips()),
        evidence_key(field, None, DpvSettings(), Skips().without("planes")),
    ]
    assert len(set(keys)) == len(keys)
    assert evidence_key(replace(field, id="another", pose=None), None, DpvSettings(), Skips()) == keys[0]


def test_memory_forgets_what_was_not_used_for_longest() -> None:
    store = MemoryStore(limit_bytes=2 * size_bytes(little(0)))
    for name in ("a", "b"):
        store.save(name, little(1))
    assert store.load("a") is not None
    store.save("c", little(3))
    assert store.load("b") is None and store.load("a") is not None and store.load("c") is not None
    assert store.held_bytes <= store.limit_bytes
    tight = MemoryStore(limit_bytes=1)
    tight.save("a", little(1))
    assert tight.load("a") is not None  # the newest always stays


def test_a_second_time_takes_what_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    fields: list[LightField] = [scenes.light_field(name, x, 3) for name, x in (("a", 0.0), ("b", 0.02))]
    store, settings = MemoryStore(), Settings()

    def find(which: list[LightField], knobs: Settings = settings) -> tuple[list[Evidence], Tally]:
        tally = Tally()
        found = prepare.find_evidence(which, RigPrior(), knobs, store=store, threads=1, monitor=Monitor(), tally=tally)
        return found, tally

    first, tally = find(fields[:1])
    assert (tally.counts["unchanged"].done, tally.counts["unchanged"].skipped) == (1, 0)
    both, tally = find(fields)
    assert (tally.counts["unchanged"].done, tally.counts["unchanged"].skipped) == (1, 1)
    assert both[0] is first[0] and tally.counts["unchanged"].saved_ms > 0
    off = replace(settings, skips=settings.skips.without("unchanged"))
    again, tally = find(fields, off)
    assert tally.counts["unchanged"].done == 2
    assert again[0] is not first[0] and np.array_equal(again[0].probability, first[0].probability)
