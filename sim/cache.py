"""Rendered arrays kept on disk, keyed by all that they depend on: benchmarks shoot the same scenes many times."""

from __future__ import annotations

import functools
import hashlib
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.files import disk_errors
from lfrig.sim.scene import PackedScene


def default_cache_dir() -> Path:
    """``$LFRIG_CACHE``/renders, else lfrig/renders under the user's cache folder. Safe to delete."""
    root = os.environ.get("LFRIG_CACHE")
    if root:
        return Path(root) / "renders"
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "lfrig" / "renders"


def scene_digest(scene: PackedScene) -> bytes:
    """Hash of all that a scene looks like."""
    total = hashlib.sha256(repr(scene.lamp).encode())
    for array in (scene.primitives, scene.texels, scene.table, scene.lamp_points):
        total.update(np.ascontiguousarray(array).tobytes())
    return total.digest()


@functools.cache
def source_digest() -> bytes:
    """Hash of the sources that scenes are made by: a library scene is known by it, its name and its seed, without
    being built. What the renderers do with a scene is told by `lfrig.sim.renderer.VERSION`.
    """
    here = Path(__file__).parent
    total = hashlib.sha256()
    for path in (here / "scene.py", here / "textures.py", here / "tone.py", *sorted((here / "scenes").glob("*.py"))):
        total.update(path.read_bytes())
    return total.digest()


def cached(
    folder: Path | None, key: tuple[object, ...], make: Callable[[], NDArray[np.generic]]
) -> NDArray[np.generic]:
    """``make()``, or what it gave before for the same key. ``folder`` None = no cache.

    The key's parts are hashed by their `repr` (bytes and numbers, not arrays). Files appear by rename: a crash or a
    second process leaves whole files only.
    """
    if folder is None:
        return make()
    path = folder / f"{hashlib.sha256(repr(key).encode()).hexdigest()[:40]}.npy"
    try:
        return np.asarray(np.load(path, allow_pickle=False))
    except (OSError, ValueError, EOFError):
        pass  # absent or damaged: make it again
    array = make()
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        temporary = path.with_name(f".{path.stem}.{os.getpid()}.tmp")
        try:
            with temporary.open("wb") as stream:
                np.save(stream, array)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    return array
