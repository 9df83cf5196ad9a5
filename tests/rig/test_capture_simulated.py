"""From the simulated rig to a session on disk, with its truth."""

from __future__ import annotations

import functools
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfrig.contracts.errors import BadInput, Interrupted, UsageError
from lfrig.contracts.progress import Monitor
from lfrig.contracts.truth import TruthDocument
from lfrig.rig import sim_capture
from lfrig.rig.journal import read_journal
from lfrig.rig.session.images import read_image
from lfrig.rig.session.store import SessionStore
from lfrig.rig.sim_capture import capture_simulated
from lfrig.rig.truth import load_capture_truth
from lfrig.sim.shoot import shoot

SCENE, SIZE, ANGLES, TARGET = "plaster", (48, 32), (0.0, 15.0), 8.0


def capture(path: Path, **options: Any) -> SessionStore:
    wanted = {"scene": SCENE, "size": SIZE, "angles_deg": ANGLES, "target_deg": TARGET, "record": "views"} | options
    return capture_simulated(path, **wanted)


@functools.cache
def _captured(root: Path) -> Path:
    capture(root / "session", noise_sigma=2.0)
    return root


@pytest.fixture(scope="session")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a captured session; tests must not change it."""
    return _captured(tmp_path_factory.mktemp("simulated"))


@pytest.fixture
def store(root: Path) -> SessionStore:
    return SessionStore.open(root / "session")


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_session_holds_what_was_shot(store: SessionStore) -> None:
    captures = store.captures()
    assert list(captures) == ["000", "001", "002"]
    assert [c.kind for c in captures.values()] == ["light_field", "light_field", "photo"]
    assert [c.turntable_deg for c in captures.values()] == [0.0, 15.0, 8.0]
    assert all(c.pose is None for c in captures.values())
    assert store.load_light_field("001").views.shape == (7, 7, 32, 48, 3)
    prior = store.rig_prior()
    assert prior.light_field_from_plate is not None
    assert prior.target_from_plate is not None
    assert prior.depth_range_m is not None


def test_session_is_the_one_in_memory(store: SessionStore) -> None:
    memory = shoot(SCENE, *SIZE, ANGLES, TARGET, noise_sigma=2.0)
    assert store.document.rig == memory.rig
    np.testing.assert_array_equal(store.load_light_field("001").views, memory.captures["001"].pixels)
    np.testing.assert_array_equal(store.load_photo("002").image, memory.target.pixels)
    for name, document in store.captures().items():
        assert document == memory.captures[name].document
    assert TruthDocument.load(store.truth_path / "truth.json").captures == memory.truth.captures


def test_truth_lies_beside_the_session(store: SessionStore) -> None:
    assert sorted(p.name for p in store.truth_path.iterdir()) == ["captures", "truth.json"]
    document = TruthDocument.load(store.truth_path / "truth.json")
    assert (document.scene, document.seed) == (SCENE, 0)
    for name, record in document.captures.items():
        depth = np.load(store.truth_path / "captures" / name / "depth.npy")
        assert depth.dtype == np.float32
        assert depth.shape == (record.camera.height, record.camera.width)
        assert record.noise_sigma == 2.0
        assert record.views is not None
        truth = load_capture_truth(store.truth_path, name)
        assert truth.views is not None
        assert truth.views.shape[2:4] == depth.shape


def test_photo_is_the_true_centre_view_up_to_noise(store: SessionStore) -> None:
    centre = read_image(store.truth_path / "captures" / "002" / "views" / "03_03.png").astype(int)
    photo = store.load_photo("002").image.astype(int)
    inside = (centre > 10) & (centre < 245)
    assert (photo - centre)[inside].std() == pytest.approx(2.0, rel=0.1)


def test_journal_lies_in_the_session(store: SessionStore) -> None:
    events = [r["event"] for r in read_journal(store.path / "journal.jsonl")]
    assert events[0] == "run"
    assert events[-1] == "done"
    assert events.count("ingested") == 3


def test_same_seed_same_bytes(root: Path, tmp_path: Path) -> None:
    capture(tmp_path / "session", noise_sigma=2.0)
    for part in ("session", "session.truth"):
        first, again = content(root / part), content(tmp_path / part)
        first.pop("journal.jsonl", None)
        again.pop("journal.jsonl", None)  # it holds times
        assert first == again


def test_light_fields_without_noise_are_their_own_truth(tmp_path: Path) -> None:
    store = capture(tmp_path / "s", angles_deg=(0.0,), size=(24, 16))
    document = TruthDocument.load(store.truth_path / "truth.json")
    assert document.captures["000"].views is None
    assert document.captures["001"].views is not None
    assert [p.name for p in (store.truth_path / "captures" / "000").iterdir()] == ["depth.npy"]


def test_given_poses_are_recorded(tmp_path: Path) -> None:
    store = capture(tmp_path / "s", angles_deg=(0.0,), size=(24, 16), poses="given")
    truth = TruthDocument.load(store.truth_path / "truth.json").captures
    for name, document in store.captures().items():
        assert document.pose == truth[name].pose
        assert document.pose is not None
        assert document.pose.sigma_deg == 0


def test_without_a_photo(tmp_path: Path) -> None:
    store = capture(tmp_path / "s", angles_deg=(0.0,), target_deg=None, size=(24, 16))
    assert [c.kind for c in store.captures().values()] == ["light_field"]


def test_more_can_be_shot_into_the_same_session(tmp_path: Path) -> None:
    for angle in (0.0, 15.0):
        store = capture(tmp_path / "s", angles_deg=(angle,), target_deg=None, size=(24, 16))
    assert store.document.captures == ["000", "001"]
    assert list(TruthDocument.load(store.truth_path / "truth.json").captures) == ["000", "001"]


@pytest.mark.parametrize("other", [{"seed": 1}, {"scene": "chequered"}])
def test_other_scenes_and_seeds_need_another_session(root: Path, other: dict[str, Any]) -> None:
    before = content(root)
    with pytest.raises(BadInput, match="another session"):
        capture(root / "session", **other)
    assert content(root) == before


def test_captures_of_a_real_rig_are_not_mixed_with(root: Path, tmp_path: Path) -> None:
    shutil.copytree(root / "session", tmp_path / "session")
    with pytest.raises(BadInput, match="not the simulator's"):
        capture(tmp_path / "session")


@pytest.mark.parametrize(("wrong", "error"), [({"scene": "nowhere"}, BadInput), ({"size": "huge"}, UsageError)])
def test_wrong_wishes_make_no_session(tmp_path: Path, wrong: dict[str, Any], error: type[Exception]) -> None:
    with pytest.raises(error):
        capture(tmp_path / "s", **wrong)
    assert list(tmp_path.iterdir()) == []


def test_cancel_keeps_whole_captures_with_their_truth(tmp_path: Path) -> None:
    class AfterTheFirst(Monitor):
        rendered = 0

        def on_start(self, name: str, total: int | None) -> None:
            if name.startswith("render"):
                self.rendered += 1
                if self.rendered == 2:
                    self.cancel()

    with pytest.raises(Interrupted, match="1 of 3"):
        capture(tmp_path / "s", size=(24, 16), monitor=AfterTheFirst())
    store = SessionStore.open(tmp_path / "s")
    assert list(store.captures()) == ["000"]
    assert list(TruthDocument.load(store.truth_path / "truth.json").captures) == ["000"]
    assert read_journal(store.path / "journal.jsonl")[-1]["event"] == "aborted"
    assert [p.name for p in (store.path / "captures").iterdir()] == ["000"]


def test_an_interrupt_between_a_capture_and_its_truth_leaves_neither(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(sim_capture, "_write_truth", interrupted)
        with pytest.raises(Interrupted, match="0 of 3"):
            capture(tmp_path / "s", size=(24, 16))
    assert SessionStore.open(tmp_path / "s").captures() == {}
    assert list((tmp_path / "s" / "captures").iterdir()) == []
    store = capture(tmp_path / "s", size=(24, 16))
    truth = TruthDocument.load(store.truth_path / "truth.json")
    assert list(store.captures()) == list(truth.captures) == ["000", "001", "002"]
