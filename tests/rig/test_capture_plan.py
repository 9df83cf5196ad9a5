"""Capture plans: angles as people write them, TOML files, steps."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from lfrig.contracts.errors import BadInput, UsageError
from lfrig.contracts.progress import Monitor
from lfrig.rig.plan import CapturePlan, middle_gap_deg, parse_angles


@pytest.mark.parametrize(
    ("text", "angles"),
    [
        ("0:60:15", (0, 15, 30, 45, 60)),
        ("60:0:-20", (60, 40, 20, 0)),
        ("-15:15:30", (-15, 15)),
        ("5:5:1", (5,)),
        ("0:1:0.1", tuple(round(0.1 * k, 9) for k in range(11))),
        ("0,15,40", (0, 15, 40)),
        ("7.5", (7.5,)),
    ],
)
def test_angles_include_both_ends(text: str, angles: tuple[float, ...]) -> None:
    assert parse_angles(text) == pytest.approx(angles)


@given(st.integers(-180, 180), st.integers(1, 40), st.sampled_from([0.5, 1.0, 7.25, 15.0]))
def test_ranges_step_evenly_from_first_to_last(first: int, steps: int, step: float) -> None:
    last = first + steps * step
    angles = parse_angles(f"{first}:{last}:{step}")
    assert len(angles) == steps + 1
    assert angles[0] == first
    assert angles[-1] == last


@pytest.mark.parametrize(
    "text", ["", "a", "0:60", "0:60:0", "0:60:-15", "0:60:7", "0:inf:5", "nan", "0:1e9:1", "1,,2", "0:60:15:1"]
)
def test_nonsense_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(UsageError, match="0:60:15"):
        parse_angles(text)


def test_plans_are_frozen_and_take_text() -> None:
    plan = CapturePlan(angles_deg="0:30:15", target_deg=20)  # type: ignore[arg-type]
    assert plan.angles_deg == (0, 15, 30)
    with pytest.raises(ValidationError):
        plan.settle_s = 3.0  # type: ignore[misc]
    assert CapturePlan.model_validate(plan.model_dump(mode="json")) == plan


def test_toml(tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text('angles_deg = "0:60:20"\ntarget_deg = 30.0\nsettle_s = 1.5\n', encoding="utf-8")
    assert CapturePlan.load(path) == CapturePlan(angles_deg=(0, 20, 40, 60), target_deg=30.0, settle_s=1.5)


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("angles_deg = []", "angles_deg"),
        ('angles_deg = "0:60"', "angles_deg"),
        ("angles_deg = [0.0, nan]", "angles_deg"),
        ("target_deg = 3.0", "angles_deg"),
        ("angles_deg = [0.0]\nsettle_s = -1", "settle_s"),
        ("angles_deg = [0.0]\nangels = 3", "angels"),
        ("angles_deg = [", "TOML"),
    ],
)
def test_broken_plans_name_the_file_and_the_field(tmp_path: Path, text: str, field: str) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BadInput) as error:
        CapturePlan.load(path)
    assert str(path) in error.value.message
    assert field in error.value.message
    assert error.value.remedy


def test_missing_plan(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="does not exist"):
        CapturePlan.load(tmp_path / "none.toml")


@pytest.mark.parametrize(("angles", "warned"), [("0:60:15", False), ("0:60:20", False), ("0:50:25", True)])
def test_wide_steps_are_warned_of(angles: str, warned: bool) -> None:
    monitor = Monitor()
    CapturePlan(angles_deg=parse_angles(angles)).check_steps(monitor)
    assert [n.code for n in monitor.notices] == (["wide-step"] if warned else [])


def test_steps_beyond_matching_need_force() -> None:
    plan = CapturePlan(angles_deg=(0.0, 40.0, 20.0, 75.0))
    assert plan.widest_step_deg == 35.0
    with pytest.raises(UsageError, match="--force"):
        plan.check_steps(Monitor())
    plan.check_steps(Monitor(), force=True)


def test_default_place_of_the_photo() -> None:
    assert middle_gap_deg((0, 15, 30, 45, 60)) == 37.5
    assert middle_gap_deg((0, 20)) == 10
    assert middle_gap_deg((8,)) == 8
