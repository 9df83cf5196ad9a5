"""The simulated plenoptic camera in its rig: shots show what the views show, and depend on nothing but the seed."""

from __future__ import annotations

import functools
import json
from pathlib import Path

import numpy as np
import pytest

from lfrig.contracts.errors import Interrupted
from lfrig.contracts.progress import Monitor
from lfrig.sim.plenoptic import render
from lfrig.sim.plenoptic.camera import PlenopticCamera, RawShot
from lfrig.sim.plenoptic.sensor import modulation, read_out, white_signal
from lfrig.sim.rig import SimulatedRig
from lfrig.sim.scene import F64
from lfrig.sim.tone import srgb_from_linear
from tests.sim.lenses import all_lenses
from tests.sim.lytro_files import frame_of, sections, unpacked
from tests.sim.small import one_of_each, scene

SCENE = scene(*one_of_each())
W, H = 30, 20


def rig(seed: int = 0, threads: int = 1, cache_dir: Path | None = None) -> SimulatedRig:
    return SimulatedRig(SCENE, W, H, seed=seed, threads=threads, cache_dir=cache_dir)


@functools.cache
def usual() -> RawShot:
    return rig().shoot_raw(1, 15.0)


def develop(shot: RawShot, camera: PlenopticCamera) -> F64:
    """Each pixel's own colour as docs/lenslet.md reads it, sRGB 0..255; NaN under the rims of lenses, [Hs, Ws]."""
    figures = camera.body.figures
    frame, contents = frame_of(sections(shot.raw))
    raw = np.array(unpacked(contents[frame["imageRef"]], figures.bits), float).reshape(camera.body.shape)
    lit = modulation(shot.lattice, camera.body.shape)
    white = read_out(white_signal(lit, camera.body), camera.body, None).astype(float)
    raw, white = ((v - figures.black) / (figures.white - figures.black) for v in (raw, white))
    gains = json.loads(contents[frame["metadataRef"]])["image"]["color"]["whiteBalanceGain"]
    for (y, x), name in zip(((0, 0), (0, 1), (1, 0), (1, 1)), ("gr", "r", "b", "gb"), strict=True):
        cell = np.s_[y::2, x::2]
        white[cell] /= np.quantile(white[cell], 0.999) * gains[name]
    with np.errstate(divide="ignore", invalid="ignore"):
        linear = np.where(lit > 0.5, raw / white, np.nan)
    return np.asarray(255 * srgb_from_linear(np.clip(linear, 0, 1)))


def test_pixels_under_the_middles_of_lenses_show_the_centre_view() -> None:
    camera, shot = PlenopticCamera(rig()), usual()
    assert shot.truth.views is not None
    pixels, view = develop(shot, camera), shot.truth.views[3, 3].astype(float)
    height, width = camera.body.shape
    c, s = np.cos(shot.lattice.rotation_rad), np.sin(shot.lattice.rotation_rad)
    errors = []
    for x, y in all_lenses(shot.lattice, camera.body.shape):
        dx, dy = x - (width - 1) / 2, y - (height - 1) / 2
        vx = (c * dx + s * dy) / shot.lattice.pitch_px + (W - 1) / 2
        vy = (c * dy - s * dx) / shot.lattice.pitch_px + (H - 1) / 2
        if not (1 < vx < W - 2 and 1 < vy < H - 2):
            continue
        column, row = round(x), round(y)
        colour = camera.body.colours[row % 2, column % 2]
        i, j = int(vx), int(vy)
        near = view[j : j + 2, i : i + 2, colour]
        # A lens sees as far as its neighbours' middles: between the darkest and the brightest of the four pixels.
        if np.ptp(near) < 25:
            fx, fy = vx - i, vy - j
            there = (near[0] * (1 - fy) + near[1] * fy) @ [1 - fx, fx]
            errors.append(pixels[row, column] - there)
    assert len(errors) > 60
    assert abs(np.median(errors)) < 1.5
    assert np.median(np.abs(errors)) < 5


def test_shot_is_recorded_as_the_views_of_the_same_shot_are() -> None:
    shot, views = usual(), rig().shoot_light_field(1, 15.0)
    assert shot.document.views is None
    assert shot.document.raw is not None
    assert shot.document.raw.path == "capture.lfr"
    left_out = {"views", "raw"}
    assert shot.document.model_dump(exclude=left_out) == views.document.model_dump(exclude=left_out)
    assert shot.truth.views is not None
    np.testing.assert_array_equal(shot.truth.views, views.pixels)
    np.testing.assert_array_equal(shot.truth.depth_m, views.truth.depth_m)
    assert shot.truth.record.pose == views.truth.record.pose
    assert shot.truth.record.noise_sigma > 0


def test_shot_depends_on_seed_and_index_alone() -> None:
    again = rig(threads=2).shoot_raw(1, 15.0, truth_views=False)
    assert again.raw == usual().raw
    assert again.truth.views is None
    assert rig(seed=1).shoot_raw(1, 15.0, truth_views=False).raw != again.raw


def test_zoom_and_focus_move_the_lattice_a_little() -> None:
    camera = PlenopticCamera(rig())
    first, second = camera.lattice(0), camera.lattice(1)
    assert first.pitch_px != second.pitch_px == pytest.approx(first.pitch_px, rel=1e-3)
    assert first.origin_px != second.origin_px == pytest.approx(first.origin_px, abs=1.0)
    assert first.rotation_rad == second.rotation_rad


def test_quiet_sensor_has_no_noise() -> None:
    quiet = PlenopticCamera(rig(), noise=False)
    shot = quiet.shoot(1, 15.0, truth_views=False)
    assert shot.truth.record.noise_sigma == 0
    assert shot.raw == PlenopticCamera(rig(), noise=False).shoot(1, 15.0, truth_views=False).raw
    assert shot.raw != usual().raw
    assert shot.lattice == usual().lattice


def test_renders_are_cached(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = rig(cache_dir=tmp_path).shoot_raw(1, 15.0, truth_views=False)

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("rendered again")

    monkeypatch.setattr(render, "render_lenslets", refuse)
    assert rig(cache_dir=tmp_path).shoot_raw(1, 15.0, truth_views=False).raw == first.raw
    with pytest.raises(AssertionError, match="again"):
        rig(cache_dir=tmp_path).shoot_raw(2, 15.0, truth_views=False)


def test_shooting_reports_progress_and_can_be_cancelled() -> None:
    class Counter(Monitor):
        done = 0

        def on_advance(self, steps: int) -> None:
            self.done += steps

    counter, camera = Counter(), PlenopticCamera(rig())
    with counter.task("shoot", camera.steps):
        camera.shoot(1, 15.0, counter)
    assert counter.done == camera.steps
    counter.cancel()
    with pytest.raises(Interrupted):
        camera.shoot(1, 15.0, counter)
