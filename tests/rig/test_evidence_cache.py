"""Evidence on disk: whole or not at all, checked when read, bounded; a second run of a session computes none."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from lfrig.contracts.progress import Monitor
from lfrig.processing.model import Evidence
from lfrig.rig.session.evidence_cache import EvidenceCache, Pending


def made(seed: int) -> Evidence:
    rng = np.random.default_rng(seed)
    flat = rng.standard_normal((5, 7)).astype(np.float32)
    return Evidence(rng.integers(0, 65536, (5, 7, 9)).astype(np.uint16), (-0.5, 0.1), flat, abs(flat), 1.5, 49, 0.25)


def same(a: Evidence, b: Evidence) -> bool:
    figures = (a.planes_px, a.noise_sigma, a.views_used, a.occlusion_tested)
    return figures == (b.planes_px, b.noise_sigma, b.views_used, b.occlusion_tested) and all(
        np.array_equal(getattr(a, name), getattr(b, name)) for name in ("probability", "disparity", "confidence")
    )


def test_what_is_saved_is_loaded(tmp_path: Path) -> None:
    cache = EvidenceCache(tmp_path / "cache")
    assert cache.load("k") is None
    cache.save("k", made(1))
    found = EvidenceCache(tmp_path / "cache").load("k")
    assert found is not None and same(found, made(1))
    cache.save("k", made(2))
    found = cache.load("k")
    assert found is not None and same(found, made(2))


@pytest.mark.parametrize("damage", ["zeros", "short", "missing", "figures", "kind", "shape"])
def test_damage_is_noticed(tmp_path: Path, damage: str) -> None:
    cache = EvidenceCache(tmp_path)
    cache.save("k", made(1))
    path = tmp_path / "k" / "probability.npy"
    if damage == "zeros":  # a page that never reached the disk
        content = bytearray(path.read_bytes())
        content[-64:] = bytes(64)
        path.write_bytes(content)
    elif damage == "short":
        path.write_bytes(path.read_bytes()[:-10])
    elif damage == "missing":
        path.unlink()
    elif damage == "figures":
        (tmp_path / "k" / "evidence.json").write_text('{"planes_px": [1]}')
    elif damage == "kind":
        np.save(path, made(1).probability.astype(np.int32))
    else:
        np.save(path, made(1).probability[:4])
    assert cache.load("k") is None
    cache.save("k", made(1))
    found = cache.load("k")
    assert found is not None and same(found, made(1))


def test_old_entries_make_room(tmp_path: Path) -> None:
    cache = EvidenceCache(tmp_path)
    for i, name in enumerate(("a", "b")):
        cache.save(name, made(i))
        os.utime(tmp_path / name, (i, i))
    size = sum(path.stat().st_size for path in (tmp_path / "a").iterdir())
    assert cache.load("a") is not None  # used: younger than b
    EvidenceCache(tmp_path, limit_bytes=2 * size + size // 2).save("c", made(3))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "c"]


def test_no_room_is_a_warning(tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("a file where the folder should be")
    monitor = Monitor()
    cache = EvidenceCache(tmp_path / "cache", monitor)
    cache.save("k", made(1))
    assert [notice.code for notice in monitor.notices] == ["cache-not-written"]
    assert cache.load("k") is None


def test_pending_evidence_reaches_the_disk_when_told(tmp_path: Path) -> None:
    pending = Pending(EvidenceCache(tmp_path / "cache"))
    pending.save("k", made(1))
    assert pending.load("k") is not None and not (tmp_path / "cache").exists()
    pending.write()
    found = Pending(EvidenceCache(tmp_path / "cache")).load("k")
    assert found is not None and same(found, made(1))
