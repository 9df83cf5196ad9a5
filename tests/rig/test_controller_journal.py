"""The journal on disk."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfrig.contracts.errors import BadInput
from lfrig.rig.journal import Journal, read_journal

Values = st.dictionaries(
    st.text(st.characters(codec="ascii", categories=["Ll"]), min_size=1).filter(
        lambda k: k not in {"seq", "time", "monotonic_s", "event", "self"}
    ),
    st.one_of(st.integers(), st.text(), st.floats(allow_nan=False, allow_infinity=False), st.none()),
    max_size=3,
)


@settings(max_examples=20)
@given(st.lists(Values, max_size=4))
def test_what_is_recorded_is_read(tmp_path_factory: pytest.TempPathFactory, records: list[dict[str, object]]) -> None:
    path = tmp_path_factory.mktemp("journal") / "journal.jsonl"
    with Journal(path) as journal:
        for fields in records:
            journal.record("x", **fields)
    back = read_journal(path)
    assert [{k: r[k] for k in fields} for r, fields in zip(back, records, strict=True)] == records
    assert [r["monotonic_s"] for r in back] == sorted(r["monotonic_s"] for r in back)


@settings(max_examples=40)
@given(st.integers(0, 200))
def test_torn_last_line_is_cut_and_the_rest_kept(tmp_path_factory: pytest.TempPathFactory, cut: int) -> None:
    path = tmp_path_factory.mktemp("journal") / "journal.jsonl"
    with Journal(path) as journal:
        journal.record("first", note="é\n")
        journal.record("second")
    data = path.read_bytes()
    path.write_bytes(data[: max(0, len(data) - cut)])
    whole = read_journal(path)
    with Journal(path) as journal:
        journal.record("after")
    back = read_journal(path)
    assert back[:-1] == whole
    assert [r["seq"] for r in back] == list(range(len(back)))


def test_records_are_on_disk_at_once(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "journal.jsonl")
    journal.record("trigger")
    assert read_journal(tmp_path / "journal.jsonl")[0]["event"] == "trigger"
    journal.close()
    journal.close()


@pytest.mark.parametrize("text", ["hello\n", "[1]\n", '{"a": 1}\n', '{"event": "x"}\ngarbage\n{"event": "y"}\n'])
def test_other_files_are_refused_and_left(tmp_path: Path, text: str) -> None:
    path = tmp_path / "journal.jsonl"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BadInput, match="journal"):
        Journal(path)
    assert path.read_text(encoding="utf-8") == text
