from __future__ import annotations

from pathlib import Path

import pytest

from lfrig.bench import regression
from lfrig.bench.reference import reference_cpu_s
from lfrig.bench.regression import Bound, checks_of, kind_of, load_bounds, propose
from lfrig.contracts.bench import BenchDocument
from lfrig.contracts.errors import BadInput
from lfrig.sim.scenes import TUNING

FIGURES = {
    "given.refused": 0.0, "given.mse": 0.001, "given.ppe_005": 95.0, "given.below_z_buffer_db": -0.1,
    "prior.pose_error_deg": 0.2, "cpu.fusion": 12.345678,
}  # fmt: skip


def stored(tmp_path: Path, figures: dict[str, float] = FIGURES) -> list[Bound]:
    (tmp_path / "bounds.toml").write_text(propose(figures), encoding="utf-8")
    return load_bounds(tmp_path / "bounds.toml")


def test_what_is_proposed_can_be_stored_and_holds_itself(tmp_path: Path) -> None:
    bounds = stored(tmp_path)
    assert [bound.figure for bound in bounds] == list(FIGURES)
    assert all(check.ok for check in checks_of(FIGURES, bounds))
    by_name = {bound.figure: bound for bound in bounds}
    assert by_name["cpu.fusion"].bound == pytest.approx(2 * FIGURES["cpu.fusion"] + 0.5, rel=0.01)
    assert by_name["given.ppe_005"].bound < 95 and by_name["given.mse"].bound > 0.001


@pytest.mark.parametrize("figure", FIGURES)
def test_a_broken_bound_fails(tmp_path: Path, figure: str) -> None:
    bounds = stored(tmp_path)
    bound = next(bound for bound in bounds if bound.figure == figure)
    worse = bound.bound + (0.01 if bound.direction == "<=" else -0.01) * max(abs(bound.bound), 1)
    assert [c.name for c in checks_of(FIGURES | {figure: worse}, bounds) if not c.ok] == [figure]


def test_a_figure_without_a_bound_and_a_bound_without_a_figure_fail(tmp_path: Path) -> None:
    bounds = stored(tmp_path)
    checks = checks_of(FIGURES | {"cpu.refine": 3.0}, bounds)
    assert [check.name for check in checks if not check.ok] == ["cpu.refine: bounded"]
    fewer = {name: value for name, value in FIGURES.items() if name != "given.mse"}
    assert [check.name for check in checks_of(fewer, bounds) if not check.ok] == ["given.mse: measured"]


def test_cpu_ratios_are_left_out_without_the_native_core(tmp_path: Path) -> None:
    names = [check.name for check in checks_of(FIGURES | {"cpu.fusion": 1e9}, stored(tmp_path), cpu=False)]
    assert names == [name for name in FIGURES if not name.startswith("cpu.")]


def test_every_stored_bound_has_a_reason_and_room() -> None:
    bounds = load_bounds()
    assert len({bound.figure for bound in bounds}) == len(bounds) > 15
    for bound in bounds:
        kind = kind_of(bound.figure)
        assert len(bound.why) > 20 and bound.direction == kind.direction
        assert bound.measured <= bound.bound if bound.direction == "<=" else bound.measured >= bound.bound
    for poses in regression.POSES:
        assert {f"{poses}.{name}" for name in (*regression.SCORED, "refused")} <= {bound.figure for bound in bounds}
    assert {f"prior.{name}" for name in regression.FOUND_POSES} <= {bound.figure for bound in bounds}
    stages = {"evidence", "poses", "fusion", "surface", "refine", "synthesis", "total"}
    assert {f"cpu.{stage}" for stage in stages} <= {bound.figure for bound in bounds}


def test_the_gate_looks_at_tuning_scenes_only() -> None:
    assert set(regression.SCENES) <= set(TUNING)


@pytest.mark.parametrize("text", ["[[bound]", '[[bound]]\nfigure = "given.mse"\n', "bound = [1]"])
def test_a_damaged_file_of_bounds_is_named(tmp_path: Path, text: str) -> None:
    (tmp_path / "bounds.toml").write_text(text, encoding="utf-8")
    with pytest.raises(BadInput, match=r"bounds\.toml"):
        load_bounds(tmp_path / "bounds.toml")


def test_the_reference_takes_time() -> None:
    assert 1e-4 < reference_cpu_s(runs=1) < 60


@pytest.mark.slow
def test_the_gate_end_to_end(tmp_path: Path) -> None:
    tiny = {"scenes": ["tabletop"], "size": (135, 94), "cache_dir": tmp_path / "cache"}
    figures, rows = regression.measure(**tiny)
    assert [(row["scene"], row["poses"]) for row in rows] == [("tabletop", "given"), ("tabletop", "prior")]
    assert "total" not in figures and figures["cpu.total"] > figures["cpu.fusion"] > 0
    bounds = tmp_path / "bounds.toml"
    loose = {name: value * 3 if name.startswith("cpu.") else value for name, value in figures.items()}
    bounds.write_text(propose(loose).replace("given.mse", "given.other", 1), encoding="utf-8")
    document = regression.run(tmp_path / "out", bounds=bounds, **tiny)
    assert BenchDocument.load(tmp_path / "out" / "regression.json") == document
    failed = {check.name for check in document.checks if not check.ok}
    assert failed == {"given.other: measured", "given.mse: bounded"}
    assert "tabletop" in (tmp_path / "out" / "regression.md").read_text(encoding="utf-8")
