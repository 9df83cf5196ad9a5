"""The pattern that names views, and names that may not leave their folder."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfrig.contracts.capture import ViewsSpec
from lfrig.contracts.paths import check_inside, check_pattern, expand, pattern_regex

fields = st.sampled_from(["{}", "{:d}", "{:02d}", "{:04d}"])
literals = st.text(st.characters(blacklist_characters="{}\0/\\", blacklist_categories=["Nd", "Cs", "Cc"]), max_size=5)


@given(literals, fields, literals, fields, literals, st.integers(0, 300), st.integers(0, 300))
def test_names_give_back_their_row_and_column(
    a: str, row_field: str, b: str, col_field: str, c: str, row: int, col: int
) -> None:
    pattern = a + row_field.replace("{", "{row") + f"_{b}" + col_field.replace("{", "{col") + c
    match = pattern_regex(check_pattern(pattern)).fullmatch(expand(pattern, row, col))
    assert match is not None
    assert (int(match["row"]), int(match["col"])) == (row, col)


@given(st.integers(0, 99), st.integers(0, 99))
def test_padding_is_that_of_format(row: int, col: int) -> None:
    pattern = "v/{row:02d}-{col:03d}.png"
    assert expand(pattern, row, col) == pattern.format(row=row, col=col)
    assert ViewsSpec(rows=3, cols=3, pattern=pattern).file(row, col) == pattern.format(row=row, col=col)


def test_a_repeated_field_must_agree() -> None:
    regex = pattern_regex("{row}/{row}_{col}.png")
    assert regex.fullmatch("3/3_4.png")
    assert not regex.fullmatch("3/2_4.png")


@pytest.mark.parametrize(
    "pattern",
    [
        "views.png", "{row}.png", "{col}.png", "{row}{col}{n}.png", "{row}_{col:}.png", "{row}_{col:2d}.png",
        "{row.__class__}_{col}.png", "{row:99999999999d}_{col}.png", "{row!r}_{col}.png",
        "{{row}}_{col}", "{row}_{col}{",
    ],
)  # fmt: skip
def test_other_patterns_are_refused(pattern: str) -> None:
    with pytest.raises(ValueError, match="must hold"):
        check_pattern(pattern)


@pytest.mark.parametrize("name", ["", "..", "../x", "a/../../x", "/x", "a\\..\\x", "C:x", "\\\\host\\x", "a\0b"])
def test_names_that_leave_the_folder_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match="must"):
        check_inside(name)


@pytest.mark.parametrize("name", ["x", "a/b.png", "a..b.png", "ü/00.png"])
def test_names_inside_the_folder_are_kept(name: str) -> None:
    assert check_inside(name) == name
