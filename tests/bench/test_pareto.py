from __future__ import annotations

from pathlib import Path

import pytest

from lfrig.bench import cotton, pareto
from lfrig.contracts.progress import Monitor
from lfrig.processing.export.pfm import write_pfm
from lfrig.processing.export.png import write_png
from tests.rig.card_scene import BASELINE_M, FOCUS_M, VIEWS, capture_truth, scene


@pytest.fixture
def hci(tmp_path: Path) -> Path:
    """The card in the layout of the HCI benchmark."""
    folder = tmp_path / "card"
    folder.mkdir()
    truth = capture_truth()
    for number, view in enumerate(scene()[1].reshape(VIEWS**2, *scene()[1].shape[2:])):
        write_png(folder / f"input_Cam{number:03d}.png", view)
    write_pfm(folder / cotton.TRUTH_DISPARITY, truth.disparity(BASELINE_M, FOCUS_M))
    write_pfm(folder / cotton.TRUTH_DEPTH, scene()[0])
    return folder


def test_means_are_relative_to_our_preset() -> None:
    rows = [
        {"method": "preset fast", "scene": "a", "mse": 1.0, "cpu_s": 4.0},
        {"method": "preset fast", "scene": "b", "mse": 3.0, "cpu_s": 6.0},
        {"method": "peer", "scene": "a", "mse": 5.0, "cpu_s": 1.0},
        {"method": "peer", "scene": "b", "refused": "no-overlap"},
    ]
    ours, peer = pareto.mean_rows(rows)
    assert ours["mse"] == 2 and ours["cpu_ratio"] == 1
    assert peer["cpu_ratio"] == 0.2 and peer["refused"] == ["b"]


def test_one_light_field_alone_against_the_peer(hci: Path) -> None:
    rows, table, checks = cotton.run(hci, threads=1, monitor=Monitor())
    ours, peer = rows
    assert (ours["method"], peer["method"]) == (cotton.OURS, cotton.SGBM)
    # Two textured planes: nothing but their edges may be wrong.
    assert ours["badpix_007"] < 15
    # With one view to each side the peer locks to half pixels: bad by the thresholds, yet on the right surface.
    assert ours["badpix_007"] < peer["badpix_007"] and peer["mse"] < 0.1
    assert ours["mse_x100"] == pytest.approx(100 * ours["mse"]) and ours["peak_rss_mb"] > 50
    assert [check.value for check in checks] == [ours["badpix_007"]]
    assert [row["method"] for row in table.rows] == [cotton.OURS, cotton.SGBM]


def test_the_scene_is_looked_for_beside_the_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cotton, "BESIDE_CHECKOUT", tmp_path / "nowhere")
    assert cotton.find(None) is None
    assert cotton.find(tmp_path) == tmp_path


@pytest.mark.slow
def test_the_benchmark_end_to_end(tmp_path: Path, hci: Path) -> None:
    document = pareto.run(
        tmp_path / "out", half="tuning", scenes=["tabletop"], size=(96, 64), hci=hci, cache_dir=tmp_path / "cache"
    )
    means = {row["method"]: row for row in document.rows if row.get("kind") == "mean"}
    assert set(pareto.PEERS) <= set(means) and len(means) == len(pareto.PEERS) + len(pareto.RESOLUTIONS)
    assert means["preset fast"]["peak_rss_mb"] > 50 and means["preset fast"]["cpu_ratio"] == 1
    assert [check.name for check in document.checks] == ["lfrig depth on card: BadPix(0.07) [%]"]
    assert (tmp_path / "out" / pareto.PICTURE).stat().st_size > 500
