from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import lfrig.bench
from lfrig.bench import plots
from lfrig.bench.document import Column, Table, machine, markdown_checks, markdown_table, write
from lfrig.contracts.bench import BenchDocument, Check
from lfrig.contracts.errors import UsageError


def test_benchmarks_are_found_by_name() -> None:
    for name in lfrig.bench.BENCHES:
        assert callable(lfrig.bench.load(name).run)
    with pytest.raises(UsageError, match="accuracy"):
        lfrig.bench.load("luck")


def test_a_document_is_written_as_json_and_markdown(tmp_path: Path) -> None:
    rows = [{"name": "one", "value": 0.123456}, {"name": "two"}]
    checks = [Check.of("value", 0.2, "<=", 0.1, "because"), Check.of("other", 2, ">=", 1, "why not")]
    document = write(
        tmp_path, "trial", rows=rows, checks=checks, text="What was done.", pictures=["a.png"],
        tables=[Table("All", rows, [Column("name", "what"), Column("value", "how much", ".2f")])],
    )  # fmt: skip
    assert BenchDocument.load(tmp_path / "trial.json") == document
    text = (tmp_path / "trial.md").read_text()
    for part in (
        "# trial",
        "What was done.",
        "| one | 0.12 |",
        "| two |  |",
        "![a.png](a.png)",
        "**failed**",
        "why not",
    ):
        assert part in text


def test_cells_say_yes_and_no_and_list() -> None:
    columns = [Column("ok", "ok"), Column("codes", "codes")]
    table = markdown_table([{"ok": True, "codes": ["a", "b"]}, {"ok": False, "codes": []}], columns)
    assert "| yes | a, b |" in table and "| **no** |  |" in table


def test_a_pipe_in_a_cell_stays_in_its_cell() -> None:
    table = markdown_table([{"name": "a|b"}], [Column("name", "n")])
    assert table.splitlines()[-1] == r"| a\|b |"


def test_checks_show_value_and_bound() -> None:
    assert "| speed | 3 | >= | 2 | ok | fast |" in markdown_checks([Check.of("speed", 3, ">=", 2, "fast")])


def test_the_machine_is_described() -> None:
    found = machine()
    assert found["cpus"] >= 1 and found["memory_gb"] > 0
    assert isinstance(found["native"], bool)


def test_plots_are_drawn(tmp_path: Path) -> None:
    plots.bars(tmp_path / "bars.png", {"a": {"x": 1.0, "y": 2.0}, "b": {"x": 0.5}}, title="t", unit="px²")
    plots.front(tmp_path / "front.png", {"ours": [(1, 2), (0.5, 3)], "theirs": [(2, 2)]}, title="t", x="x", y="y")
    photo = np.zeros((20, 30, 3), np.uint8)
    truth = np.linspace(-0.3, 0.3, 600, dtype=np.float32).reshape(20, 30)
    plots.error_picture(tmp_path / "error.png", photo, truth, truth + np.float32(0.05), title="t")
    for name in ("bars.png", "front.png", "error.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
