from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lfrig.bench import inputs
from lfrig.bench.cases import shoot_case
from lfrig.sim.rig import SimulatedRig

SIZE = (135, 94)
ANGLES = (10.0, 30.0)


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


@pytest.mark.parametrize(("kind", "levels"), [("noisy", 5.0), ("equal", 2.0)])
def test_noisy_sources_are_the_clean_ones_and_noise(tmp_path: Path, kind: inputs.Input, levels: float) -> None:
    clean, noisy = (
        inputs.seen_sources(seen, "plaster", (48, 32), ANGLES, cache_dir=tmp_path) for seen in ("views", kind)
    )
    difference = noisy[0].views.astype(float) - clean[0].views
    assert difference.std() == pytest.approx(levels, rel=0.1)
    assert abs(difference.mean()) < 0.1
