"""The speed benchmark measures what it says: rows for every piece of work, checks only where they are meant."""

from __future__ import annotations

from pathlib import Path

import pytest

from lfrig.bench import speed
from lfrig.bench.cases import SMALL


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(speed.SIZES, "half", SMALL)
    monkeypatch.setattr(speed.cotton, "find", lambda folder: None)


def test_every_piece_of_work_is_measured(small: None, tmp_path: Path) -> None:
    document = speed.run(tmp_path, threads=1, scenes=["desk"], size="half", runs=1, cache_dir=tmp_path / "renders")
    medians = {row["what"]: row for row in document.rows if row["kind"] == "median"}
    assert set(speed.BOUNDS) - set(medians) == {"lfrig depth, cotton"}
    assert all(row["cpu_s"] > 0 and row["wall_s"] > 0 for row in medians.values())
    assert medians["preview: new frame, 2 sources"]["cpu_s"] < medians["all stages, 2 sources"]["cpu_s"]
    assert [row["peak_rss_mb"] > 50 for row in document.rows if row["kind"] == "peak"] == [True]
    assert document.checks == []  # the bounds are those of full size and the reporting half
    assert (tmp_path / "speed.md").is_file()


def test_bounds_are_checked_against_the_medians() -> None:
    rows = [
        {"kind": "time", "scene": scene, "what": "all stages, 2 sources", "cpu_s": cpu_s, "wall_s": 1.0}
        for scene, cpu_s in (("a", 1.0), ("b", 1.1), ("c", 9.0))
    ]
    rows.append({"kind": "memory", "scene": "a", "what": "all stages, 4 sources", "peak_rss_mb": 700.0})
    checks = speed._acceptance(speed._medians(rows))
    assert [(check.value, check.ok) for check in checks] == [(1.1, True), (700.0, False)]
