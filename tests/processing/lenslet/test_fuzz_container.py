"""A short run of the mutation fuzzer, and that it notices what it is there to notice."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from lfrig.bench import fuzz_containers
from lfrig.bench.fuzz_containers import ACCEPTED, run
from lfrig.bench.fuzz_mutations import NASTY_VALUES

EXPECTED = {"wrong-sha1", "truncated", "garbage", "invalid-metadata", "missing-section", "not-json", "unsafe-member"}


def test_three_thousand_cases(tmp_path: Path) -> None:
    tally = run(3000, 20260101, folder=tmp_path)
    assert tally.failures == []
    assert sum(tally.outcomes.values()) == 3000
    assert set(tally.outcomes) >= EXPECTED
    assert tally.outcomes[ACCEPTED] > 300, "mutations that break everything find nothing"


def test_a_case_can_be_run_again_alone(tmp_path: Path) -> None:
    before = repr(NASTY_VALUES)
    whole = run(40, 7, folder=tmp_path).outcomes
    parts = [run(1, 7, first=case, folder=tmp_path).outcomes for case in range(40)]
    assert sum(parts, type(whole)()) == whole
    assert repr(NASTY_VALUES) == before


@pytest.mark.parametrize("fault", ["crash", "hang", "memory"])
def test_faults_are_found_and_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str) -> None:
    def broken(*arguments: Any) -> None:
        if fault == "crash":
            raise IndexError("out of range")
        if fault == "memory":
            bytearray(1 << 30)
        while fault == "hang":
            pass

    monkeypatch.setattr(fuzz_containers, "HANG_CPU_S", 0.02)
    monkeypatch.setattr(fuzz_containers, "camera_and_optics", broken)
    tally = run(12, 3, folder=tmp_path)
    assert tally.failures
    assert all(case in range(12) for case, _ in tally.failures)
    name = {"crash": "IndexError", "hang": "Hang", "memory": "MemoryError"}[fault]
    assert all(name in why for _, why in tally.failures)
