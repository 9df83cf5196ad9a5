from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfrig.bench.decode import psnr
from lfrig.bench.decode_files import capture_of
from lfrig.bench.decode_scene import PlaneScene, SensorModel, shoot, true_view
from lfrig.contracts.errors import BadInput, Interrupted, UsageError
from lfrig.contracts.lytro import BayerPattern
from lfrig.contracts.progress import Monitor
from lfrig.processing.lenslet import decode as decoder
from lfrig.processing.lenslet.colour import srgb_encode
from lfrig.processing.lenslet.decode import Decoded, decode, view_steps
from lfrig.processing.lenslet.raw import RawCapture
from lfrig.processing.lenslet.reading import BINS, TAPS, reading_weights
from lfrig.processing.lenslet.resample import kernel_weights

SENSOR = SensorModel(420, 330, corner_shading=0.2)
SCENE = PlaneScene(SENSOR.view_size, (0.6, 0.0, 0.0))


def capture(sensor: SensorModel = SENSOR, scene: PlaneScene | None = SCENE, **options: Any) -> RawCapture:
    options = {"noise": False, "subpixels": 1} | options
    return capture_of(sensor, shoot(sensor, scene, 1, **options), shoot(sensor, None, 2, **options))


@pytest.fixture(scope="module")
def plane() -> RawCapture:
    """A plane in front of the focal plane, without noise."""
    return capture()


@pytest.fixture(scope="module")
def grey() -> RawCapture:
    """A uniform grey: a second white image, exposed less."""
    sensor = replace(SENSOR, electrons=4000.0)
    white = shoot(sensor, None, 1, noise=False, subpixels=1)
    return capture_of(sensor, np.rint(64 + 0.4 * (white - 64.0)).astype(np.uint16), white)


def quality(found: Decoded, sensor: SensorModel, scene: PlaneScene, r: int, c: int) -> float:
    centre = found.centre
    return psnr(found.views[r, c], true_view(sensor, scene, c - centre, r - centre))


def test_every_view_is_the_one_that_the_aperture_sees(plane: RawCapture) -> None:
    found = decode(plane)
    assert found.views.shape == (7, 7, 23, 29, 3) and found.centre == 3
    values = {(r, c): quality(found, SENSOR, SCENE, r, c) for r, c in np.ndindex(7, 7)}
    assert min(values.values()) > 40
    # Views the wrong way round are far off: rows, columns, or both.
    for r, c in ((3, 6), (6, 3), (6, 6)):
        assert psnr(found.views[r, c], true_view(SENSOR, SCENE, 3 - c, 3 - r)) < 25
    assert psnr(found.views[3, 6], true_view(SENSOR, SCENE, 0, 3)) < 25


@pytest.mark.parametrize("bayer", ["RGGB", "GRBG", "GBRG", "BGGR"])
def test_any_bayer_pattern(bayer: BayerPattern) -> None:
    sensor = replace(SENSOR, colours=bayer)
    assert quality(decode(capture(sensor)), sensor, SCENE, 3, 3) > 40


@pytest.mark.parametrize(
    ("pitch", "rotation", "vertical"), [(20 / 1.4, -0.02, 1.0), (20 / 1.4, 0.004, 1.01), (11.3, 0.001, 0.995)]
)
def test_any_lattice(pitch: float, rotation: float, vertical: float) -> None:
    sensor = replace(SENSOR, pitch=pitch, rotation=rotation, vertical=vertical, origin=(1.0, -3.0))
    scene = PlaneScene(sensor.view_size, (-0.7, 0.0, 0.0))
    found = decode(capture(sensor, scene))
    assert min(quality(found, sensor, scene, r, c) for r, c in ((3, 3), (2, 4), (5, 1))) > 39


def test_noise_of_shot_and_white_image_is_averaged() -> None:
    found = decode(capture(noise=True))
    assert quality(found, SENSOR, SCENE, 3, 3) > 42


def test_native_and_numpy_agree(plane: RawCapture, monkeypatch: pytest.MonkeyPatch) -> None:
    hot = np.array([[100, 100], [102, 100], [0, 0], [419, 329], [1, 200]], np.int32)
    shot = replace(plane, hot_pixels=hot)
    native = decode(shot, linear=True)
    monkeypatch.setenv("LFRIG_NATIVE", "0")
    twin = decode(shot, linear=True)
    assert native.linear is not None and twin.linear is not None
    np.testing.assert_allclose(native.linear, twin.linear, atol=2e-5)
    assert np.abs(native.views.astype(int) - twin.views).max() <= 1
    assert (native.views != twin.views).mean() < 0.001
    assert np.abs(native.weight.astype(int) - twin.weight).max() <= 1


def test_the_number_of_threads_changes_no_bit(plane: RawCapture) -> None:
    one, many = decode(plane, threads=1, linear=True), decode(plane, threads=5, linear=True)
    for name in ("views", "weight", "linear"):
        assert (getattr(one, name) == getattr(many, name)).all()


def test_a_uniform_light_is_uniform_in_every_view(grey: RawCapture) -> None:
    views = decode(grey).views
    assert np.ptp(views.astype(int)) <= 3
    # Its level is that of the light, 0.4 of the white image's, which was exposed to 0.9.
    assert np.median(views) == pytest.approx(255 * srgb_encode(np.array(0.4 * 0.9)), abs=2.5)


def test_weight_is_modulation(grey: RawCapture) -> None:
    found = decode(grey)
    inner = found.weight[:, :, 4:-4, 4:-4].astype(float) / 255
    assert inner[3, 3].max() == pytest.approx(1, abs=0.03)
    radius = np.hypot(*np.mgrid[-3:4, -3:4]) / (SENSOR.pitch / 2)
    falloff = inner.mean((2, 3)) / inner[3, 3].mean()
    np.testing.assert_allclose(falloff, 1 - 0.35 * radius**2, atol=0.04)


def test_listed_hot_pixels_leave_no_trace(plane: RawCapture) -> None:
    rng = np.random.default_rng(0)
    hot = np.stack([rng.integers(0, 420, 60), rng.integers(0, 330, 60)], -1).astype(np.int32)
    spoilt = plane.sensor.copy()
    spoilt[hot[:, 1], hot[:, 0]] = 1023
    mended = decode(replace(plane, sensor=spoilt, hot_pixels=hot))
    assert min(quality(mended, SENSOR, SCENE, r, c) for r, c in np.ndindex(7, 7)) > 39
    # That it took mending: unlisted, they show.
    plain = decode(replace(plane, sensor=spoilt))
    assert np.abs(plain.views.astype(int) - mended.views).max() > 60


def test_highlights_are_white_and_keep_their_light(grey: RawCapture) -> None:
    sensor = np.minimum(64 + 3.2 * (grey.sensor.astype(float) - 64), 1023)
    metadata = replace(grey.metadata, black=(64.0,) * 4)
    found = decode(replace(grey, sensor=np.rint(sensor).astype(np.uint16), metadata=metadata), linear=True)
    assert found.linear is not None
    centre = np.s_[3, 3, 8:-8, 8:-8]
    # Green is clipped and red is not: without care that is magenta.
    assert found.views[centre].min() >= 252 and np.ptp(found.views[centre].astype(int), -1).max() <= 3
    assert found.linear[centre].max() > 1.05
    assert found.weight[centre].max() < 140  # all of green, half of the pixels, is clipped
    assert decode(grey).weight[centre].min() > 180


def test_views_beyond_the_lenses_rims_weigh_next_to_nothing(grey: RawCapture) -> None:
    inner = decode(grey, views=15).weight[:, :, 4:-4, 4:-4].mean((2, 3))
    radius = np.hypot(*np.mgrid[-7:8, -7:8])
    assert inner[radius > SENSOR.pitch / 2 + 1.5].max() < 10
    assert inner[radius < SENSOR.pitch / 2 - 2.5].min() > 150


def test_borders_are_filled_from_inside_and_weigh_less(grey: RawCapture) -> None:
    found = decode(grey)
    assert found.weight[3, 0, 4:-4, 0].mean() < 0.8 * found.weight[3, 0, 4:-4, 4].mean()
    assert np.ptp(found.views[:, :, :, (0, -1)].astype(int)) <= 3


def test_a_shot_without_white_image_is_decoded_with_a_warning(plane: RawCapture) -> None:
    smooth = PlaneScene(SENSOR.view_size, (0.1, 0, 0), sigma_px=6, contrast=0.08)
    monitor = Monitor()
    found = decode(replace(capture(scene=smooth), white=None, rule="none"), monitor=monitor)
    assert [notice.code for notice in found.notices] == ["lattice-from-shot"] == [n.code for n in monitor.notices]
    assert found.lattice.pitch_px == pytest.approx(SENSOR.pitch, abs=0.01)
    assert quality(found, SENSOR, smooth, 3, 3) > 22


def test_without_recorded_white_balance_the_white_image_serves(plane: RawCapture) -> None:
    found = decode(replace(plane, metadata=replace(plane.metadata, white_balance=None)))
    assert [notice.code for notice in found.notices] == ["no-white-balance"]
    assert quality(found, SENSOR, SCENE, 3, 3) > 40


def test_the_lattice_is_fitted_once_per_white_image(
    plane: RawCapture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = decode(plane, lattice_cache=tmp_path)
    [kept] = tmp_path.iterdir()
    assert kept.stat().st_size < 1024

    def fail(*args: object, **options: object) -> None:
        raise AssertionError("fitted again")

    fit = decoder.fit_lattice
    monkeypatch.setattr(decoder, "fit_lattice", fail)
    assert (decode(plane, lattice_cache=tmp_path).views == first.views).all()
    assert plane.white is not None
    with pytest.raises(AssertionError, match="fitted again"):
        decode(replace(plane, white=replace(plane.white, sha1="1" * 40)), lattice_cache=tmp_path)
    monkeypatch.setattr(decoder, "fit_lattice", fit)
    for damage in ("", "{}", '{"schema": "lfrig.lattice/9"}', kept.read_text()[:-20]):
        kept.write_text(damage)
        assert (decode(plane, lattice_cache=tmp_path).views == first.views).all()
        assert kept.read_text() != damage


def test_more_views_where_the_lenses_have_them(plane: RawCapture) -> None:
    seven, all_of_them, eslf = decode(plane, views=7), decode(plane, views=15), decode(plane, views=14)
    assert all_of_them.views.shape[:2] == (15, 15) and all_of_them.centre == 7
    assert eslf.views.shape[:2] == (14, 14) and eslf.centre == 6
    # Of 14×14, row and column 6 are the centre: steps −6 to 7.
    assert (eslf.views == all_of_them.views[1:, 1:]).all()
    assert np.abs(seven.views.astype(int) - all_of_them.views[4:11, 4:11]).max() <= 4  # the white image unsmoothed
    assert quality(all_of_them, SENSOR, SCENE, 7, 12) > 35


def test_the_steps_of_views() -> None:
    assert view_steps(7) == [-3, -2, -1, 0, 1, 2, 3]
    assert view_steps(14)[0] == -6 and view_steps(14)[-1] == 7 and len(view_steps(14)) == 14
    assert view_steps(15) == list(range(-7, 8))
    with pytest.raises(UsageError):
        view_steps(9)


def test_lenses_too_small_for_the_views(plane: RawCapture) -> None:
    sensor = replace(SENSOR, pitch=10.004)
    with pytest.raises(UsageError) as refusal:
        decode(capture(sensor), views=15)
    assert refusal.value.code == "too-many-views"


def test_a_white_image_of_another_sensor(plane: RawCapture) -> None:
    assert plane.white is not None
    with pytest.raises(BadInput) as refusal:
        decode(replace(plane, white=replace(plane.white, sensor=plane.white.sensor[:-2])))
    assert refusal.value.code == "wrong-size"


def test_a_white_image_that_is_none(plane: RawCapture) -> None:
    assert plane.white is not None
    noise = np.random.default_rng(0).integers(100, 900, plane.sensor.shape).astype(np.uint16)
    with pytest.raises(BadInput) as refusal:
        decode(replace(plane, white=replace(plane.white, sensor=noise)))
    assert refusal.value.code == "lattice-residual"


def test_a_cancel_is_noticed(plane: RawCapture) -> None:
    monitor = Monitor()
    monitor.cancel()
    with pytest.raises(Interrupted):
        decode(plane, monitor=monitor)


def test_camera_and_optics_follow_the_lenses_as_they_are() -> None:
    sensor = replace(SENSOR, pitch=20 / 1.4 * 1.004)
    shot = capture(sensor, PlaneScene(sensor.view_size))
    nominal = replace(shot.metadata, lens_pitch_m=2e-5)
    found = decode(replace(shot, metadata=nominal))
    told, truth = decode(shot), sensor.pitch
    assert found.camera is not None and told.camera is not None
    assert found.lattice.pitch_px == pytest.approx(truth, abs=1e-3)
    # One view pixel is one pitch wide: a wider pitch is a shorter focal length, of the same field of view.
    assert found.camera.focal_px == pytest.approx(told.camera.focal_px, rel=1e-4)
    assert found.optics.baseline_m == pytest.approx(0.02 / (2 * truth), rel=1e-4)
    assert (found.camera.cx, found.camera.cy) == ((found.camera.width - 1) / 2, (found.camera.height - 1) / 2)


@settings(max_examples=30)
@given(st.floats(0, 0.999), st.floats(0, 0.999), st.floats(0.98, 1.02))
def test_weights_of_the_lenses(a: float, b: float, vertical: float) -> None:
    lenses, weights = kernel_weights(np.array([[a, b]]), vertical)
    assert weights.sum() == pytest.approx(1, abs=1e-5)
    assert len({tuple(lens) for lens in lenses[0]}) == len(lenses[0])
    # A plane passes almost unchanged: what is read is where it is said to be.
    assert weights[0] @ lenses[0] == pytest.approx([a, b], abs=0.02)
    assert np.hypot(*(lenses[0] - [a, b]).T)[weights[0].argmax()] < 0.9


def test_weights_of_a_reading_use_the_lens_itself() -> None:
    offsets = np.array([[0, 0], [4, 0], [-3, 3]], np.float32)
    radius = 5.0
    weights = reading_weights((1, 0, 2, 1), offsets, radius)
    assert weights.shape == (4, BINS, BINS, 3, len(TAPS), 4)
    np.testing.assert_allclose(weights[..., :3].sum(-2), 1, atol=1e-5)
    np.testing.assert_allclose(weights[..., 0, :, 3].sum(-1), 1, atol=1e-5)  # all of it inside the lens
    assert 0.3 < weights[..., 1, :, 3].sum(-1).mean() < 0.9
    cell = np.array([[1, 0], [2, 1]])
    within = (np.arange(BINS) + 0.5) / BINS - 0.5
    for phase, by, bx, v in [(0, 0, 7, 0), (1, 3, 3, 1), (2, 5, 0, 2), (3, 7, 7, 1)]:
        used = weights[phase, by, bx, v]
        colours = cell[(phase // 2 + TAPS[:, 1]) % 2, (phase % 2 + TAPS[:, 0]) % 2]
        for channel in range(3):
            sums = [used[colours == colour, channel].sum() for colour in range(3)]
            assert sums == pytest.approx([float(colour == channel) for colour in range(3)], abs=1e-5)
        distance = np.hypot(*(offsets[v] - [within[bx], within[by]] + TAPS).T)
        assert (used[distance > radius + 1.5] == 0).all()
