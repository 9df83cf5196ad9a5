from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lfrig.bench import decode as bench
from lfrig.bench.decode_scene import PlaneScene, SensorModel, shoot, to_linear, true_view
from lfrig.contracts.errors import UsageError
from lfrig.processing.lenslet.lattice import HexLattice

SENSOR = SensorModel(300, 240)


def test_the_lens_above_a_point_is_the_nearest() -> None:
    x, y = (np.random.default_rng(0).uniform(20, 200, 500) for _ in range(2))
    view_x, _, du, dv = SENSOR.lens_of(x, y)
    # Within a regular hexagon of inradius half a pitch, in the lattice's axes.
    assert np.hypot(du, dv).max() <= SENSOR.pitch / np.sqrt(3) + 1e-9
    across = np.abs([du, du / 2 + dv * np.sqrt(3) / 2, du / 2 - dv * np.sqrt(3) / 2]).max(0)
    assert across.max() <= SENSOR.pitch / 2 + 1e-6
    # A step to the next lens along a row is one view pixel.
    step = SENSOR.pitch * np.array([np.cos(SENSOR.rotation), np.sin(SENSOR.rotation)])
    assert SENSOR.lens_of(x + step[0], y + step[1])[0] - view_x == pytest.approx(1)


def test_the_sensors_middle_is_the_views_middle() -> None:
    sensor = SensorModel(301, 241, origin=(150.0, 120.0))
    view_x, view_y, du, dv = (float(v[0]) for v in sensor.lens_of(np.array([150.0]), np.array([120.0])))
    assert (du, dv) == pytest.approx((0, 0))
    width, height = sensor.view_size
    assert (view_x, view_y) == pytest.approx(((width - 1) / 2, (height - 1) / 2))


def test_disparity_moves_points_against_the_offset() -> None:
    scene = PlaneScene((60, 40), (0.25, 0.02, -0.01))
    x, y = np.array([31.3]), np.array([17.8])
    delta = 0.25 + 0.02 * x - 0.01 * y
    for du, dv in ((3, 0), (-2, 3)):
        here = scene.encoded(x, y, 0.0, 0.0, 1)
        there = scene.encoded(x - du * delta, y - dv * delta, float(du), float(dv), 1)
        assert there == pytest.approx(here, abs=2e-3)
    assert scene.disparity_map()[18, 31] == pytest.approx(0.25 + 0.62 - 0.18)


def test_texture_is_bounded_and_has_its_width() -> None:
    scene = PlaneScene((120, 90))
    view = true_view(SensorModel(120 * 14, 90 * 14, 14.0), scene, 0, 0)
    assert view.min() >= 0.05 and view.max() <= 0.95 and 0.1 < view.std() < 0.2
    # Noise blurred by σ correlates as exp(−d²/4σ²).
    grey = view[..., 1] - view[..., 1].mean()
    correlation = (grey[:, 3:] * grey[:, :-3]).mean() / grey.var()
    assert correlation == pytest.approx(np.exp(-9 / 25), abs=0.05)


def test_sensor_values_follow_the_radiometry() -> None:
    white = shoot(SENSOR, None, 0, noise=False)
    assert white.min() >= 64 and white.max() == pytest.approx(64 + 959 * 0.9, abs=15)
    noisy = shoot(SENSOR, None, 0).astype(float) - white
    green = np.s_[0::2, 0::2]
    expected = np.sqrt((white[green] - 64.0) / 959 / 4000 + (3 / 4000) ** 2) * 959
    assert (noisy[green] / expected).std() == pytest.approx(1, abs=0.05)
    assert to_linear(np.array([0.5], np.float32)) == pytest.approx(0.21404, abs=1e-4)


def test_the_miss_of_a_lattice_is_measured() -> None:
    exact = HexLattice(SENSOR.origin, SENSOR.pitch, SENSOR.rotation)
    assert bench.rms_miss(SENSOR, exact) < 1e-9
    off = HexLattice((SENSOR.origin[0] + 0.3, SENSOR.origin[1] - 0.4), SENSOR.pitch, SENSOR.rotation)
    assert bench.rms_miss(SENSOR, off) == pytest.approx(0.5)


def test_psnr_leaves_the_border_out() -> None:
    truth = np.full((40, 50, 3), 0.5, np.float32)
    view = np.full((40, 50, 3), 128, np.uint8)
    view[:8] = view[-8:] = view[:, :8] = view[:, -8:] = 0
    assert bench.psnr(view, truth) == pytest.approx(-20 * np.log10(0.5 / 255), abs=1e-6)


def test_bounds_of_the_full_sensor_are_kept_for_it() -> None:
    rows = [
        {"kind": "quality", "sensor": "Illum", "noise": True, "psnr_centre": 44.0, "psnr_corner": 40.0},
        {"kind": "quality", "sensor": "F01", "noise": True, "psnr_centre": 30.0, "psnr_corner": 30.0},
        {"kind": "lattice", "rms_px": 0.06, "pitch_error_px": 1e-3},
        {"kind": "disparity", "disparity_px": 0.4, "bias_px": -0.02},
        {"kind": "cost", "stage": "read", "cpu_s": 2.0},
        {"kind": "cost", "stage": "lattice", "cpu_s": 1.0},
        {"kind": "cost", "stage": "views", "cpu_s": 1.5},
        {"kind": "cost", "stage": bench.PEAK, "peak_rss_mb": 500.0},
    ]
    crop = {check.name: check.ok for check in bench.acceptance(rows, full=False)}
    assert list(crop.values()) == [True, False, False, False]
    full = {check.name: check.ok for check in bench.acceptance(rows, full=True)}
    assert full["pitch error [px]"] is False and full["file to 7×7 views [CPU s]"] is False
    assert full["lattice [CPU s]"] and full["peak memory [MiB]"]


def test_sizes_are_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError):
        bench.run(tmp_path, size="huge")


@pytest.mark.slow
def test_the_benchmark_end_to_end(tmp_path: Path) -> None:
    document = bench.run(tmp_path, size="tiny", pitches=["Illum"], threads=1)
    kinds = [row["kind"] for row in document.rows]
    assert [kinds.count(kind) for kind in ("quality", "lattice", "disparity", "cost")] == [2, 3, 5, 4]
    checks = {check.name: check for check in document.checks}
    assert checks["PSNR of the centre view [dB]"].ok and checks["lattice RMS [px]"].ok
    # 29×23 views: few pixels are left within their border, so disparity is judged on the crop and the full sensor.
    assert max(check.value for name, check in checks.items() if name.startswith("disparity")) < 0.05
    assert (tmp_path / bench.PICTURE).stat().st_size > 500
    assert "| read |" in (tmp_path / "decode.md").read_text(encoding="utf-8")
