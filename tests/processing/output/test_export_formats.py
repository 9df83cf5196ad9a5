from __future__ import annotations

import configparser
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image as Pillow

from lfrig.contracts.errors import (
    BadInput,
    Interrupted,
    LfrigError,
    NotInThisVersion,
    ProcessingError,
    UsageError,
)
from lfrig.contracts.progress import Monitor
from lfrig.processing.export.content import content_of_light_field, content_of_result
from lfrig.processing.export.gif import MIN_WIDTH, export_gif
from lfrig.processing.export.hci import blender_angles
from lfrig.processing.export.pfm import read_pfm
from lfrig.processing.export.png import read_png
from lfrig.processing.export.registry import FORMATS, FROM_RAW, export
from lfrig.processing.export.result import load_result
from lfrig.processing.export.sweep import Sweep, circle, fill_unknown
from lfrig.processing.pipeline import ProcessResult

OF_RESULTS = sorted(set(FORMATS) - FROM_RAW)


def rotation(axis: int, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    matrix = np.eye(3)
    i, j = [k for k in range(3) if k != axis]
    sign = -1 if axis == 1 else 1
    matrix[np.ix_([i, j], [i, j])] = [[c, -sign * s], [sign * s, c]]
    return matrix


def files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


class TestEveryFormat:
    @pytest.mark.parametrize("name", OF_RESULTS)
    def test_writes_something_and_leaves_nothing_else(self, name: str, result_folder: Path) -> None:
        before = files(result_folder)
        path = export(result_folder, name)
        assert path.parent == result_folder / "exports"
        assert path.is_dir() == (FORMATS[name].suffix == "")
        assert {key: data for key, data in files(result_folder).items() if not key.startswith("exports")} == before
        assert list(result_folder.rglob(".*")) == []
        assert [p.name for p in path.parent.iterdir()] == [path.name]

    @pytest.mark.parametrize("name", OF_RESULTS)
    def test_an_existing_export_stays_unless_told(self, name: str, result_folder: Path, tmp_path: Path) -> None:
        out = tmp_path / f"out{FORMATS[name].suffix}"
        out.write_text("mine")
        with pytest.raises(BadInput, match="exists already"):
            export(result_folder, name, out)
        assert out.read_text() == "mine"

    @pytest.mark.parametrize("name", OF_RESULTS)
    def test_a_cancel_leaves_the_old_file(self, name: str, result_folder: Path, tmp_path: Path) -> None:
        class Impatient(Monitor):
            def on_advance(self, steps: int) -> None:
                self.cancel()

        monitor = Impatient()
        out = tmp_path / "keep" / f"out{FORMATS[name].suffix}"
        out.parent.mkdir()
        kept = out if FORMATS[name].suffix else out / "kept"
        kept.parent.mkdir(exist_ok=True)
        kept.write_text("mine")
        with pytest.raises(Interrupted):
            export(result_folder, name, out, overwrite=True, monitor=monitor)
        assert [p.name for p in out.parent.iterdir()] == [out.name] and kept.read_text() == "mine"

    def test_overwrite_replaces(self, result_folder: Path, tmp_path: Path) -> None:
        out = tmp_path / "views"
        out.mkdir()
        (out / "old.txt").write_text("old")
        export(result_folder, "views", out, overwrite=True)
        assert not (out / "old.txt").exists() and len(list(out.iterdir())) == 49


class TestRefusals:
    def test_planned_formats_say_so(self, result_folder: Path) -> None:
        with pytest.raises(NotInThisVersion, match="quilt: not in this version"):
            export(result_folder, "quilt")

    def test_unknown_formats_list_the_known(self, result_folder: Path) -> None:
        with pytest.raises(UsageError, match=r"unknown format .*hci"):
            export(result_folder, "bmp")

    @pytest.mark.parametrize("where", ["", "views", "disparity.pfm", ".."])
    def test_the_result_itself_is_never_replaced(self, where: str, result_folder: Path) -> None:
        before = files(result_folder)
        with pytest.raises(UsageError, match="would replace the result"):
            export(result_folder, "hci", result_folder / where, overwrite=True)
        assert files(result_folder) == before

    def test_a_light_field_without_disparity_has_no_pfm(self, result: ProcessResult, tmp_path: Path) -> None:
        with pytest.raises(BadInput, match="has no disparity map") as error:
            export(result.sources[1].source.light_field, "pfm", tmp_path / "out")
        assert "process" in error.value.remedy and list(tmp_path.iterdir()) == []

    def test_a_damaged_view_stops_the_copy(self, result_folder: Path, tmp_path: Path) -> None:
        (result_folder / "views" / "00_04.png").write_bytes(b"")
        with pytest.raises(BadInput, match=r"00_04\.png"):
            export(result_folder, "views", tmp_path / "out")
        assert not (tmp_path / "out").exists()


class TestViewsAndArrays:
    def test_views_of_a_result_are_the_same_files(self, result_folder: Path, tmp_path: Path) -> None:
        export(result_folder, "views", tmp_path / "out")
        assert files(tmp_path / "out") == files(result_folder / "views")

    def test_views_of_a_capture(self, result: ProcessResult, tmp_path: Path) -> None:
        light_field = result.sources[1].source.light_field
        export(light_field, "views", tmp_path / "out")
        np.testing.assert_array_equal(read_png(tmp_path / "out" / "04_01.png"), light_field.views[4, 1])

    def test_maps_agree_with_the_result(self, result: ProcessResult, result_folder: Path, tmp_path: Path) -> None:
        export(result_folder, "pfm", tmp_path / "pfm")
        export(result_folder, "npy", tmp_path / "npy")
        names = {"disparity", "disparity_sigma", "depth_m", "confidence"}
        assert {p.stem for p in (tmp_path / "pfm").iterdir()} == names
        assert {p.stem for p in (tmp_path / "npy").iterdir()} == names | {"views"}
        for name in names:
            np.testing.assert_array_equal(
                read_pfm(tmp_path / "pfm" / f"{name}.pfm"), np.load(tmp_path / "npy" / f"{name}.npy")
            )
        depth, inverse = np.load(tmp_path / "npy" / "depth_m.npy"), result.light_field.surface.inverse_depth
        np.testing.assert_allclose(depth * inverse, np.where(np.isfinite(inverse), 1, np.nan), rtol=1e-6)
        np.testing.assert_array_equal(np.load(tmp_path / "npy" / "views.npy"), result.light_field.views)


class TestHci:
    def test_geometry_follows_from_the_parameters(self, result: ProcessResult, result_folder: Path) -> None:
        out = export(result_folder, "hci")
        parser = configparser.ConfigParser()
        parser.read(out / "parameters.cfg")
        intrinsics, extrinsics = parser["intrinsics"], parser["extrinsics"]
        focal_px = (
            intrinsics.getfloat("focal_length_mm")
            / intrinsics.getfloat("sensor_size_mm")
            * max(intrinsics.getint("image_resolution_x_px"), intrinsics.getint("image_resolution_y_px"))
        )
        depth, disparity = read_pfm(out / "gt_depth_lowres.pfm"), read_pfm(out / "gt_disp_lowres.pfm")
        known = np.isfinite(depth)
        bf = focal_px * extrinsics.getfloat("baseline_mm") / 1e3
        expected = bf * (1 / depth[known] - 1 / extrinsics.getfloat("focus_distance_m"))
        np.testing.assert_allclose(disparity[known], expected, atol=1e-5)
        np.testing.assert_array_equal(disparity, result.light_field.disparity)
        meta = parser["meta"]
        assert meta.getfloat("disp_min") <= np.nanmin(disparity) < np.nanmax(disparity) <= meta.getfloat("disp_max")

    def test_our_own_ingest_reads_it_back(self, result: ProcessResult, result_folder: Path) -> None:
        from lfrig.rig.ingest import open_light_field

        light_field, request = open_light_field(export(result_folder, "hci")), result.light_field.request
        np.testing.assert_array_equal(light_field.views, result.light_field.views)
        assert light_field.optics.baseline_m == pytest.approx(request.baseline_m)
        assert light_field.optics.focus_distance_m == pytest.approx(request.focus_distance_m)
        assert light_field.camera is not None
        assert light_field.camera.focal_px == pytest.approx(result.light_field.camera.focal_px)

    def test_views_are_numbered_by_row(self, result: ProcessResult, result_folder: Path) -> None:
        out = export(result_folder, "hci")
        assert len(list(out.glob("input_Cam*.png"))) == 49
        np.testing.assert_array_equal(read_png(out / "input_Cam010.png"), result.light_field.views[1, 3])

    def test_what_is_unknown_is_left_out(self, result: ProcessResult, tmp_path: Path) -> None:
        light_field = result.sources[1].source.light_field
        bare = type(light_field)("bare", light_field.views)
        out = export(bare, "hci", tmp_path / "out")
        text = (out / "parameters.cfg").read_text()
        assert "num_cams_x = 5" in text
        assert not any(word in text for word in ("baseline", "focal", "focus", "center_cam", "disp_min", "nan", "None"))
        assert not list(out.glob("gt_*"))

    def test_camera_angles_are_blenders(self) -> None:
        rng = np.random.default_rng(0)
        for _ in range(20):
            ours = np.linalg.qr(rng.normal(size=(3, 3)))[0]
            ours *= np.linalg.det(ours)
            x, y, z = blender_angles(ours)
            blender = rotation(2, z) @ rotation(1, y) @ rotation(0, x)  # XYZ Euler: x is applied first
            np.testing.assert_allclose(blender @ [0, 0, -1], ours[2], atol=1e-9)  # it looks along −z
            np.testing.assert_allclose(blender @ [0, 1, 0], -ours[1], atol=1e-9)  # with y up


class TestSweep:
    def test_circle_stays_inside_the_aperture(self) -> None:
        path = circle((7, 5), 16)
        np.testing.assert_allclose((path[:, 0] / 3) ** 2 + (path[:, 1] / 2) ** 2, 1)

    def test_a_viewpoint_on_a_view_is_that_view(self, result_folder: Path, result: ProcessResult) -> None:
        sweep = Sweep(content_of_result(load_result(result_folder)))
        np.testing.assert_array_equal(sweep.picture(-2, 3), result.light_field.views[1, 6])

    def test_between_views_motion_is_smooth(self, build: Callable[..., ProcessResult], tmp_path: Path) -> None:
        result = build(96, 64, unknown=False)
        content = replace(
            content_of_light_field(result.sources[1].source.light_field),
            load_views=lambda: result.light_field.views,
            disparity=result.light_field.disparity,
        )
        every_second = replace(content, load_views=lambda: result.light_field.views[::2, ::2])
        # Of every second view, with twice the disparity, the ones left out come back.
        sweep = Sweep(replace(every_second, disparity=2 * result.light_field.disparity))
        left, truth, right = (result.light_field.views[3, col].astype(float) for col in (2, 3, 4))
        error = np.abs(sweep.picture(0, 0) - truth).mean()
        blend = np.abs((left + right) / 2 - truth).mean()
        assert error < 0.5 * blend

    def test_without_disparity_the_nearest_view_is_shown(self, result: ProcessResult) -> None:
        light_field = result.sources[1].source.light_field
        sweep = Sweep(content_of_light_field(light_field))
        np.testing.assert_array_equal(sweep.picture(0.4, -1.6), light_field.views[2, 0])

    def test_unknown_disparity_takes_the_nearest_value(self) -> None:
        disparity = np.full((5, 9), np.nan, np.float32)
        disparity[2, 0], disparity[2, 8] = 1.0, 2.0
        filled = fill_unknown(disparity)
        np.testing.assert_array_equal(filled[:, :4], 1.0)
        np.testing.assert_array_equal(filled[:, 5:], 2.0)
        np.testing.assert_array_equal(fill_unknown(np.full((2, 2), np.nan, np.float32)), 0.0)


class TestAnimations:
    def test_gif_loops_through_the_circle(self, result_folder: Path, tmp_path: Path) -> None:
        out = export(result_folder, "gif", tmp_path / "loop.gif")
        with Pillow.open(out) as gif:
            assert (gif.size, gif.n_frames, gif.info["loop"]) == ((96, 64), 30, 0)
            first = np.asarray(gif.convert("RGB")).astype(int)
        expected = Sweep(content_of_result(load_result(result_folder))).picture(0, 3)
        assert np.abs(first - expected).mean() < 8  # 256 colours and dither, but the same picture

    def test_gif_shrinks_to_its_bound(self, build: Callable[..., ProcessResult], tmp_path: Path) -> None:
        light_field = build(200, 128).sources[0].source.light_field
        content, out = content_of_light_field(light_field), tmp_path / "small.gif"
        export_gif(content, out, Monitor())
        bound = out.stat().st_size // 2
        export_gif(content, out, Monitor(), max_bytes=bound)
        with Pillow.open(out) as gif:
            assert out.stat().st_size <= bound and MIN_WIDTH <= gif.size[0] < 200

    def test_webm_decodes_to_even_frames(self, build: Callable[..., ProcessResult], tmp_path: Path) -> None:
        light_field = build(65, 43).sources[0].source.light_field
        out = export(light_field, "webm", tmp_path / "loop.webm")
        reader = cv2.VideoCapture(str(out), cv2.CAP_FFMPEG)
        count, shape = 0, ()
        while True:
            ok, frame = reader.read()
            if not ok:
                break
            count, shape = count + 1, frame.shape
        reader.release()
        assert (count, shape) == (72, (42, 64, 3))
        assert out.read_bytes()[:4] == b"\x1aE\xdf\xa3"  # EBML, what a browser looks for

    def test_webm_without_codec_says_what_to_do(
        self, result_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
    ) -> None:
        class NoWriter:
            fourcc = staticmethod(cv2.VideoWriter.fourcc)

            def __init__(self, *arguments: object) -> None: ...

            def isOpened(self) -> bool:
                return False

        monkeypatch.setattr(cv2, "VideoWriter", NoWriter)
        with pytest.raises(ProcessingError, match="cannot encode VP9") as error:
            export(result_folder, "webm", tmp_path / "loop.webm")
        assert "gif" in error.value.remedy and not list(tmp_path.glob("*.webm"))

    def test_webm_that_does_not_decode_is_an_error(
        self, result_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        real = cv2.VideoWriter

        class LosesFrames:
            fourcc = staticmethod(real.fourcc)

            def __init__(self, *arguments: object) -> None:
                self.writer, self.frames = real(*arguments), 0

            def isOpened(self) -> bool:
                return bool(self.writer.isOpened())

            def write(self, frame: np.ndarray) -> None:
                self.frames += 1
                if self.frames < 60:
                    self.writer.write(frame)

            def release(self) -> None:
                self.writer.release()

        monkeypatch.setattr(cv2, "VideoWriter", LosesFrames)
        with pytest.raises(LfrigError, match="59 of 72 frames"):
            export(result_folder, "webm", tmp_path / "loop.webm")
        assert not list(tmp_path.glob("*.webm"))

    def test_nothing_is_printed(self, result_folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
        export(result_folder, "webm")
        assert capfd.readouterr() == ("", "")
