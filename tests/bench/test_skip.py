"""What skipping saves: the arithmetic on rows, the scene that needs everything, and a small run of it all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfrig.bench import skip
from lfrig.bench.cases import SMALL, shoot_case
from lfrig.bench.memory import BEFORE
from lfrig.bench.skip_scene import NAME as EVERYTHING
from lfrig.bench.skip_scene import everything
from lfrig.processing.skipping import Skips


def rows_of(scene: str, poses: str, **figures: tuple[float, float]) -> list[dict[str, Any]]:
    """Rows of variants with (CPU s, MSE); underscores in names are spaces."""
    return [
        {
            "kind": "variant", "scene": scene, "poses": poses, "variant": name.replace("_", " "), "cpu_s": cpu_s,
            "wall_s": cpu_s, "mse": mse, "ppe_005": 90.0,
        }
        for name, (cpu_s, mse) in figures.items()
    ]  # fmt: skip


def test_every_switch_has_a_row_or_a_reason() -> None:
    run = {variant.name for poses in ("given", "prior") for variant in skip.variants(poses)}
    assert run - {skip.ALL, skip.NOTHING} | set(skip.ELSEWHERE) == set(Skips.names())
    for variant in skip.variants("given"):
        if variant.name in Skips.names() and not variant.kept:
            assert variant.skips == Skips().without(variant.name)


def test_what_a_switch_saves_and_costs() -> None:
    on, kept = (1.0, 0.00102), (0.4, 0.00102)
    rows = rows_of("a", "given", all_on=on, all_off=(4.0, 0.001), planes=(2.0, 0.001), unchanged=kept)
    rows += rows_of("b", "given", all_on=on, all_off=(2.0, 0.001), planes=(2.0, 0.001), unchanged=kept)
    rows += rows_of("everything", "given", all_on=(4.2, 0.002), all_off=(4.0, 0.002), planes=on, unchanged=on)
    means = {row["variant"]: row for row in skip.switch_rows(rows)}
    assert means["all off"]["saves"] == pytest.approx(2 / 3) and means["all off"]["mse_change"] == pytest.approx(0.02)
    assert means["planes"]["saves"] == pytest.approx(0.5)
    # Kept evidence is the other way round: its row is the run that saves.
    assert means["unchanged"]["saves"] == pytest.approx(0.6) and means["unchanged"]["mse_change"] == pytest.approx(0)
    assert means["all off"]["everything_saves"] == pytest.approx(-0.05)
    memory = [{"kind": "memory", "sources": 4, "peak_rss_mb": peak} for peak in (500.0, 650.0)]
    checks = [(check.value, check.ok) for check in skip.acceptance(list(means.values()), [*rows, *memory])]
    expected = [(0, True), (200 / 3, True), (2, True), (5, True), (650, False)]
    assert [value for value, _ in checks] == pytest.approx([value for value, _ in expected])
    assert checks[4][1] is False and checks[1][1] is True


def test_a_scene_that_a_variant_refused_is_left_out() -> None:
    rows = rows_of("a", "given", all_on=(1.0, 1.0), all_off=(2.0, 1.0))
    refused = rows_of("b", "given", all_on=(9.0, 9.0))
    refused.append({"kind": "variant", "scene": "b", "poses": "given", "variant": "all off", "refused": "no-overlap"})
    means = {row["variant"]: row for row in skip.switch_rows([*rows, *refused])}
    assert means["all on"]["cpu_s"] == 1.0 and means["all off"]["saves"] == 0.5


def test_the_scene_that_needs_everything_has_texture_and_depths_everywhere(tmp_path: Path) -> None:
    case = shoot_case(everything(), SMALL, angles_deg=[10.0], truth_views=False, cache_dir=tmp_path)
    assert case.scene == EVERYTHING
    depth = 1 / case.truth.inverse_depth
    shares, _ = np.histogram(depth, 12, (np.quantile(depth, 0.01), np.quantile(depth, 0.99)))
    assert shares.min() > 0.01 * depth.size, "some depths are empty"
    grey = case.target.image8.astype(np.float32).mean(2)
    rows, cols = (side // 8 for side in grey.shape)
    blocks = grey[: 8 * rows, : 8 * cols].reshape(rows, 8, cols, 8).std((1, 3))
    assert (blocks > 5).mean() > 0.97, "some of it is plain"


@pytest.mark.slow
def test_the_benchmark_end_to_end(tmp_path: Path) -> None:
    document = skip.run(tmp_path, scenes=["tabletop"], size=SMALL, threads=1, runs=1, cache_dir=tmp_path / "renders")
    scenes = {(row["scene"], row["variant"]) for row in document.rows if row["kind"] == "variant" and "mse" in row}
    assert {("tabletop", skip.ALL), ("tabletop", skip.NOTHING), (EVERYTHING, skip.ALL)} <= scenes
    peaks = {(row["sources"], row["stage"]): row["peak_rss_mb"] for row in document.rows if row["kind"] == "memory"}
    assert {stage for _, stage in peaks} >= {BEFORE, "evidence", "fusion", "synthesis"}
    assert all(peak > 30 for peak in peaks.values()) and peaks[4, BEFORE] > peaks[2, BEFORE]
    assert document.checks == []  # bounds are those of full size and the reporting half
    assert (tmp_path / skip.PICTURE).stat().st_size > 500
