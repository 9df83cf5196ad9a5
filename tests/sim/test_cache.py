"""Renders kept on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lfrig.sim.cache import cached, default_cache_dir, scene_digest, source_digest
from lfrig.sim.rig import SimulatedRig
from lfrig.sim.scene import pack
from tests.sim.small import one_of_each, scene


class Counter:
    """Makes arrays and counts how often."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self) -> np.ndarray:
        self.calls += 1
        return np.arange(6, dtype=np.float32).reshape(2, 3)


def test_made_once_for_a_key(tmp_path: Path) -> None:
    make = Counter()
    arrays = [cached(tmp_path, ("a", 1), make) for _ in range(3)]
    assert make.calls == 1
    assert all((a == arrays[0]).all() for a in arrays)
    cached(tmp_path, ("a", 2), make)
    assert make.calls == 2
    assert len(list(tmp_path.iterdir())) == 2


def test_damaged_files_are_made_again(tmp_path: Path) -> None:
    make = Counter()
    cached(tmp_path, ("a",), make)
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:-4])
    np.testing.assert_array_equal(cached(tmp_path, ("a",), make), make())
    file.write_bytes(b"")
    np.testing.assert_array_equal(cached(tmp_path, ("a",), make), make())
    assert file.stat().st_size > 100


def test_without_a_folder_nothing_is_kept(tmp_path: Path) -> None:
    make = Counter()
    cached(None, ("a",), make)
    cached(None, ("a",), make)
    assert make.calls == 2


def test_folder_comes_from_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("LFRIG_CACHE", str(tmp_path))
    assert default_cache_dir() == tmp_path / "renders"
    monkeypatch.delenv("LFRIG_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "x"))
    assert default_cache_dir() == tmp_path / "x" / "lfrig" / "renders"


def test_digests_tell_scenes_apart() -> None:
    parts = one_of_each()
    assert scene_digest(pack(scene(*parts))) == scene_digest(pack(scene(*one_of_each())))
    assert scene_digest(pack(scene(*parts))) != scene_digest(pack(scene(*parts[:-1])))
    assert len(source_digest()) == 32


def test_shots_come_out_of_the_cache_as_they_went_in(tmp_path: Path) -> None:
    first, second = (
        SimulatedRig(scene(*one_of_each()), 24, 16, noise_sigma=2.0, cache_dir=tmp_path).shoot_photo(0, 10.0)
        for _ in range(2)
    )
    np.testing.assert_array_equal(first.pixels, second.pixels)
    np.testing.assert_array_equal(first.truth.depth_m, second.truth.depth_m)
    assert len(list(tmp_path.glob("*.npy"))) == 3
    assert not list(tmp_path.glob(".*"))
