from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfrig.bench import inputs
from lfrig.bench.accuracy_table import SHIPPED
from lfrig.bench.cases import shoot_case
from lfrig.sim.rig import SimulatedRig

SIZE = (135, 94)
ANGLES = (10.0, 30.0)
GOOD = {"mse": 0.002, "ppe_005": 90.0, "ppe_010": 96.0, "below_z_buffer_db": 0.5}


def row(kind: str, setup: str, scene: str, **numbers: Any) -> dict[str, Any]:
    return {"scene": scene, "setup": setup, "input": kind, **GOOD, **numbers}


@pytest.mark.slow
def test_raw_sources_show_what_the_views_show(tmp_path: Path) -> None:
    """The same shots, once rendered as views and once through sensor, file and decode."""
    case = shoot_case("plaster", SIZE, angles_deg=ANGLES, truth_views=False, cache_dir=tmp_path)
    sources = inputs.decoded_sources(SimulatedRig("plaster", *SIZE, cache_dir=tmp_path), ANGLES)
    seen = inputs.with_views_of(case, sources)
    assert [s.id for s in seen.sources] == ["000", "001"]
    for clean, raw in zip(case.sources, seen.sources, strict=True):
        assert (raw.pose, raw.camera, raw.turntable_deg) == (clean.pose, clean.camera, clean.turntable_deg)
        middle = np.abs(raw.centre_view[4:-4, 4:-4].astype(float) - clean.centre_view[4:-4, 4:-4])
        assert 0.2 < middle.mean() < 4.0
    others = inputs.with_views_of(case, sources[::-1])
    assert np.abs(others.sources[0].centre_view.astype(float) - case.sources[0].centre_view).mean() > 6.0


def test_noisy_sources_are_the_clean_ones_and_noise(tmp_path: Path) -> None:
    clean, noisy = (
        inputs.seen_sources(kind, "plaster", (48, 32), ANGLES, cache_dir=tmp_path) for kind in ("views", "noisy")
    )
    difference = noisy[0].views.astype(float) - clean[0].views
    assert difference.std() == pytest.approx(inputs.DECODED_NOISE_LEVELS, rel=0.1)
    assert abs(difference.mean()) < 0.1


def test_rows_say_what_each_input_adds() -> None:
    setup = inputs.SETUPS[0].name
    scenes = [
        row("views", setup, "a", mse=0.001), row("views", setup, "b", mse=0.003),
        row("noisy", setup, "a", mse=0.002), row("noisy", setup, "b", mse=0.004),
        row("raw", setup, "a", mse=0.009), {"scene": "b", "setup": setup, "input": "raw", "refused": "no-overlap"},
    ]  # fmt: skip
    views, noisy, raw = inputs.input_rows(scenes)[:3]
    assert (views["mse"], views["worst"], views["mse_added"]) == (pytest.approx(0.002), "b", None)
    assert noisy["mse_added"] == pytest.approx(0.001)
    assert (raw["scenes"], raw["refused"], raw["mse_added"]) == (1, ["b"], pytest.approx(0.006))
    failed = {check.name for check in inputs.input_checks([views, noisy, raw]) if not check.ok}
    assert failed == {f"from raw, {setup}: mse", f"from raw, {setup}: scenes refused"}


def test_clean_rows_are_those_of_the_shipped_preset() -> None:
    two, four = inputs.SETUPS[0].name, "4 sources, poses given"
    scenes = [{"stage": SHIPPED, "setup": two}, {"stage": "paper", "setup": two}, {"stage": SHIPPED, "setup": four}]
    assert inputs.clean_rows(scenes) == [{"stage": SHIPPED, "setup": two, "input": "views"}]
