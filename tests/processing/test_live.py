"""The pipeline kept between shots: the same as in one go, only what changed is computed, nothing is left half done."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest

from lfrig.contracts.errors import BadInput, GeometryRefused, Interrupted, UsageError
from lfrig.contracts.progress import Monitor
from lfrig.processing import live
from lfrig.processing.live import LiveFusion
from lfrig.processing.model import Photo, Pose, RigPrior
from lfrig.processing.options import PRESETS, ProcessOptions
from lfrig.processing.pipeline import process
from tests.processing import scenes

OPTIONS = ProcessOptions(
    preset="preview", resolution=1.0, target_baseline_m=scenes.BASELINE_M, target_focus_m=scenes.FOCUS_M,
    rows=3, cols=3, threads=1,
)  # fmt: skip


class CancelsAt(Monitor):
    """Cancels itself when a named stage begins."""

    def __init__(self, stage: str) -> None:
        super().__init__()
        self.stage = stage

    def on_start(self, name: str, total: int | None) -> None:
        if name == self.stage:
            self.cancel()


@pytest.fixture(scope="module")
def fields() -> dict[str, live.LightField]:
    return {name: scenes.light_field(name, x) for name, x in (("a", -0.05), ("b", 0.05), ("c", 0.02))}


@pytest.fixture
def fusion(fields) -> LiveFusion:
    made = LiveFusion(RigPrior(), OPTIONS)
    for name in ("a", "b"):
        assert made.add_source(fields[name]) is None
    made.set_target(scenes.photo()[0])
    return made


def geometry(view: live.LiveView) -> bytes:
    return view.light_field.disparity.tobytes() + view.light_field.views.tobytes()


def test_the_same_as_in_one_go(fields, fusion: LiveFusion) -> None:
    whole = process([fields["a"], fields["b"]], scenes.photo()[0], RigPrior(), OPTIONS, Monitor())
    assert fusion.view is not None
    assert geometry(fusion.view) == whole.light_field.disparity.tobytes() + whole.light_field.views.tobytes()


def test_the_order_in_which_things_come_changes_nothing(fields, fusion: LiveFusion) -> None:
    other = LiveFusion(RigPrior(), OPTIONS)
    assert other.set_target(scenes.photo()[0]) is None
    other.add_source(fields["a"])
    made = other.add_source(fields["b"])
    assert made is not None and fusion.view is not None and geometry(made) == geometry(fusion.view)


def test_only_what_changed_is_computed(fields, fusion: LiveFusion, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str] = []
    real = live.find_evidence
    monkeypatch.setattr(
        live, "find_evidence", lambda fs, *a, **k: (seen.extend(f.id for f in fs), real(fs, *a, **k))[1]
    )
    fusion.set_target(scenes.photo(0.01)[0])
    assert seen == []
    made = fusion.add_source(fields["c"])
    assert seen == ["c"] and made is not None
    assert [s.light_field.id for s in made.sources] == ["a", "b", "c"]
    assert made.stages[0].name == "evidence" and made.stages[0].work_skipped == 2


def test_another_frame_costs_synthesis_alone(fusion: LiveFusion) -> None:
    assert fusion.view is not None
    before = fusion.view.light_field
    frame = np.ascontiguousarray(255 - scenes.photo()[0].image)
    shown = fusion.show(frame)
    assert [stage.name for stage in shown.stages] == ["synthesis"]
    assert np.array_equal(shown.light_field.views[1, 1], frame)
    assert np.array_equal(shown.light_field.disparity, before.disparity)
    with pytest.raises(BadInput, match="another shape"):
        fusion.show(np.zeros((50, 20, 3), np.uint8))


@pytest.mark.parametrize("stage", ["evidence", "poses", "fusion", "surface", "refine", "synthesis"])
def test_a_cancel_leaves_everything_as_it_was(fields, fusion: LiveFusion, stage: str) -> None:
    before = fusion.view
    with pytest.raises(Interrupted):
        fusion.add_source(fields["c"], CancelsAt(stage))
    assert fusion.sources == ("a", "b") and fusion.view is before
    assert fusion.add_source(fields["c"]) is not None  # and the next attempt works


def test_a_refusal_leaves_everything_as_it_was(fields, fusion: LiveFusion) -> None:
    before = fusion.view
    with pytest.raises(GeometryRefused):
        fusion.add_source(replace(fields["c"], pose=fields["a"].pose))  # two captures from one place
    behind = replace(scenes.photo()[0], pose=Pose(np.diag([-1.0, 1.0, -1.0]), np.zeros(3)))
    with pytest.raises(GeometryRefused):
        fusion.set_target(behind)
    assert fusion.sources == ("a", "b") and fusion.view is before


def test_a_retake_replaces_and_a_source_can_go(fields, fusion: LiveFusion) -> None:
    fusion.add_source(replace(fields["c"], id="b"))
    assert fusion.sources == ("a", "b") and fusion.view is not None
    assert fusion.view.sources[1].pose.translation[0] == pytest.approx(-0.02, abs=5e-3)
    assert fusion.remove_source("b") is not None and fusion.sources == ("a",)
    with pytest.raises(BadInput, match="no source 'b'"):
        fusion.remove_source("b")


def test_the_number_of_sources_is_bounded(fields, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "MOST_SOURCES", 2)
    fusion = LiveFusion(RigPrior(), OPTIONS)
    fusion.set_target(replace(scenes.photo()[0], turntable_deg=0.0))
    for name, angle in (("a", 350.0), ("b", 40.0), ("c", 5.0)):
        fusion.add_source(replace(fields[name], turntable_deg=angle))
    assert fusion.sources == ("a", "c")  # b is farthest; 350° is 10° away
    assert 0 < fusion.held_bytes < 3 * (fields["a"].views.nbytes + 96 * 72 * 2 * 160)


def test_works_at_half_size_by_default(fields) -> None:
    fusion = LiveFusion(RigPrior(), replace(OPTIONS, resolution=None))
    for name in ("a", "b"):
        fusion.add_source(fields[name])
    view = fusion.set_target(scenes.photo()[0])
    assert PRESETS["preview"].resolution == 0.5
    assert view is not None and view.light_field.views.shape == (3, 3, scenes.HEIGHT // 2, scenes.WIDTH // 2, 3)
    shown = fusion.show(scenes.photo()[0].image)  # a frame of full size is made smaller
    assert np.array_equal(shown.light_field.views, view.light_field.views)


def test_calls_from_several_threads_take_turns(fields, fusion: LiveFusion) -> None:
    frame = scenes.photo()[0].image
    threads = [threading.Thread(target=fusion.show, args=(frame,)) for _ in range(3)]
    threads.append(threading.Thread(target=fusion.add_source, args=(fields["c"],)))
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert fusion.sources == ("a", "b", "c") and fusion.view is not None


def test_nothing_to_show_yet_and_nonsense(fields) -> None:
    fusion = LiveFusion(RigPrior(), OPTIONS)
    with pytest.raises(BadInput, match="no geometry"):
        fusion.show(scenes.photo()[0].image)
    assert fusion.set_target(Photo("t", scenes.photo()[0].image)) is None
    assert fusion.add_source(replace(fields["a"], pose=None, turntable_deg=None)) is None  # alone it cannot be placed
    assert fusion.sources == ("a",) and fusion.view is None
    with pytest.raises(UsageError):
        LiveFusion(RigPrior(), ProcessOptions(preset="nothing"))
