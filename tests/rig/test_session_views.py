"""Views into one volume; square pixels; documents to nouns."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

from lfrig.contracts.capture import CameraSpec, OpticsSpec, PoseSpec
from lfrig.contracts.errors import BadInput, Interrupted
from lfrig.contracts.progress import Monitor
from lfrig.contracts.session import RigSpec
from lfrig.rig.session import views as views_module
from lfrig.rig.session.convert import to_camera, to_optics, to_pose, to_rig_prior
from lfrig.rig.session.images import write_png
from lfrig.rig.session.rectify import rectification
from lfrig.rig.session.views import read_views, taken_range, write_views
from tests.rig.session_files import view, views


def grid(folder: Path, rows: int = 3, cols: int = 3) -> list[list[Path]]:
    return [[folder / f"{r}_{c}.png" for c in range(cols)] for r in range(rows)]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_views(tmp_path, views(3, 5), lambda r, c: f"{r}_{c}.png")
    return tmp_path


@pytest.mark.parametrize("threads", [0, 1, 7])
def test_views_are_read_as_written(folder: Path, threads: int) -> None:
    assert np.array_equal(read_views(grid(folder, 3, 5), threads=threads), views(3, 5))


def test_reading_reports_each_view(folder: Path) -> None:
    class Counter(Monitor):
        steps = 0

        def on_advance(self, steps: int) -> None:
            assert threading.current_thread() is threading.main_thread()
            Counter.steps += steps

    read_views(grid(folder, 3, 5), monitor=Counter())
    assert Counter.steps == 15


def test_a_cancel_stops_the_reading(folder: Path) -> None:
    monitor = Monitor()
    seen = []

    def cancel(picture: np.ndarray) -> np.ndarray:
        seen.append(1)
        monitor.cancel()
        return picture

    with pytest.raises(Interrupted):
        read_views(grid(folder, 3, 5), threads=1, monitor=monitor, transform=cancel)
    assert len(seen) < 15


def test_missing_views_are_counted_and_the_first_is_named(folder: Path) -> None:
    (folder / "1_1.png").unlink()
    (folder / "2_4.png").unlink()
    with pytest.raises(BadInput, match=r"1_1\.png.*2 of 15") as caught:
        read_views(grid(folder, 3, 5))
    assert caught.value.code == "missing-views"


def test_mixed_sizes_name_the_odd_one(folder: Path) -> None:
    write_png(folder / "2_2.png", view(0, 0, 12, 17))
    with pytest.raises(BadInput, match=r"2_2\.png: is 17×12 px, but 0_0\.png is 16×12") as caught:
        read_views(grid(folder, 3, 5))
    assert caught.value.code == "mixed-sizes"


def test_of_several_broken_views_the_first_is_named_whatever_the_threads(folder: Path) -> None:
    for name in ("0_3.png", "1_0.png", "2_4.png"):
        (folder / name).write_text("text")
    for threads in (1, 2, 8):
        with pytest.raises(BadInput, match=r"0_3\.png"):
            read_views(grid(folder, 3, 5), threads=threads)


def test_a_volume_beyond_all_bounds_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(views_module, "MAX_VOLUME_BYTES", 15 * 16 * 12 * 3 - 1)
    with pytest.raises(BadInput, match="3×5 views") as caught:
        read_views(grid(folder, 3, 5))
    assert caught.value.code == "too-large"


@pytest.mark.parametrize(
    ("rows", "cols", "expected"),
    [
        (3, 3, (range(3), range(3))),
        (7, 9, (range(7), range(9))),
        (14, 14, (range(3, 10), range(3, 10))),
        (14, 7, (range(13), range(7))),
        (8, 4, (range(7), range(3))),
        (15, 15, (range(15), range(15))),
    ],
)
def test_which_views_are_taken(rows: int, cols: int, expected: tuple[range, range]) -> None:
    assert taken_range(rows, cols) == expected


def test_the_middle_of_what_is_taken_is_that_of_the_stored_grid() -> None:
    for count in range(3, 30):
        taken, _ = taken_range(count, 3 if count == 14 else count)
        assert len(taken) % 2 == 1
        assert taken[len(taken) // 2] == (count - 1) // 2
    assert taken_range(14, 14)[0][3] == 6


def test_a_good_camera_is_not_resampled() -> None:
    for spec in (
        None,
        CameraSpec(width=9, height=7),
        CameraSpec(width=9, height=7, fx=5.0),
        CameraSpec(width=9, height=7, fx=5.0, fy=5.0002, distortion=(0, 0, 0, 0)),
    ):
        assert rectification(spec) is None


def ramp(width: int, height: int) -> np.ndarray:
    """Grey level = 2 x + y, in all channels."""
    y, x = np.mgrid[:height, :width]
    return np.repeat((2 * x + y)[..., None], 3, -1).astype(np.uint8)


@pytest.mark.parametrize(("fx", "fy"), [(60.0, 40.0), (40.0, 60.0)])
def test_pixels_become_square_and_rays_stay(fx: float, fy: float) -> None:
    spec = CameraSpec(width=48, height=32, fx=fx, fy=fy, cx=20.0, cy=17.0, sigma_f=0.1)
    found = rectification(spec)
    assert found is not None
    camera = found.camera
    assert camera.focal_px == max(fx, fy)
    assert (camera.width, camera.height) == (round(48 * 60 / fx), round(32 * 60 / fy))
    assert camera.sigma_focal == 0.1
    square = found.apply(ramp(48, 32)).astype(float)
    assert square.shape == (camera.height, camera.width, 3)
    # A pixel of the new picture shows what the old one showed along the same ray.
    v, u = np.mgrid[4 : camera.height - 4, 4 : camera.width - 4]
    x = (u - camera.cx) / camera.focal_px * fx + 20.0
    y = (v - camera.cy) / camera.focal_px * fy + 17.0
    assert np.abs(square[4:-4, 4:-4, 0] - (2 * x + y)).max() < 1.0


def test_distortion_is_taken_out() -> None:
    k1 = -0.2
    spec = CameraSpec(width=60, height=40, fx=50.0, fy=50.0, distortion=(k1, 0.0, 0.0, 0.0))
    found = rectification(spec)
    assert found is not None
    assert (found.camera.width, found.camera.height, found.camera.focal_px) == (60, 40, 50.0)
    straight = found.apply(ramp(60, 40)).astype(float)[..., 0]
    v, u = np.mgrid[:40, :60]
    x, y = (u - 29.5) / 50.0, (v - 19.5) / 50.0
    scale = 1 + k1 * (x * x + y * y)
    expected = 2 * (x * scale * 50 + 29.5) + (y * scale * 50 + 19.5)
    assert np.abs(straight - expected)[3:-3, 3:-3].max() < 1.0


def test_sixteen_bits_stay_sixteen_bits() -> None:
    found = rectification(CameraSpec(width=8, height=6, fx=10.0, fy=12.0))
    assert found is not None
    assert found.apply(np.full((6, 8, 3), 40000, np.uint16)).dtype == np.uint16


def test_cameras() -> None:
    assert to_camera(None) is None
    assert to_camera(CameraSpec(width=9, height=7)) is None
    centred = to_camera(CameraSpec(width=9, height=7, fx=5.0))
    assert centred is not None
    assert (centred.cx, centred.cy, centred.focal_px, centred.sigma_focal) == (4.0, 3.0, 5.0, 0.0)


def test_exact_rotations_keep_their_bits_and_rounded_ones_are_made_exact() -> None:
    c, s = np.cos(0.7), np.sin(0.7)
    exact = PoseSpec(R=((c, -s, 0), (s, c, 0), (0, 0, 1)), t=(1, 2, 3), sigma_deg=0.5, sigma_m=0.01)
    pose = to_pose(exact)
    assert pose is not None
    assert np.array_equal(pose.rotation, np.array(exact.R))
    assert (list(pose.translation), pose.sigma_deg, pose.sigma_m) == ([1, 2, 3], 0.5, 0.01)
    rounded = to_pose(PoseSpec(R=tuple(tuple(round(v, 4) for v in row) for row in exact.R), t=(0, 0, 0)))
    assert rounded is not None
    assert np.abs(rounded.rotation @ rounded.rotation.T - np.eye(3)).max() < 1e-12
    assert np.abs(rounded.rotation - pose.rotation).max() < 1e-4
    assert to_pose(None) is None


def test_unknown_sigmas_take_their_defaults() -> None:
    assert to_optics(None).sigma_baseline == to_optics(OpticsSpec(baseline_m=0.1)).sigma_baseline == 0.03
    assert to_optics(OpticsSpec(sigma_baseline=0.0)).sigma_baseline == 0.0
    assert to_rig_prior(RigSpec()).turntable_sigma_deg == 0.3
    assert to_rig_prior(RigSpec(turntable_sigma_deg=0.0)).turntable_sigma_deg == 0.0
