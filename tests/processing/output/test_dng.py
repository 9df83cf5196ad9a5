"""Lenslet DNG: what LibRaw reads is what the camera recorded."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rawpy
import tifffile

from lfrig.bench.lytro_files import SmallShot, shot_file
from lfrig.contracts.errors import BadInput, DiskError, UsageError
from lfrig.contracts.lytro import F01, ILLUM, CameraFigures
from lfrig.processing.export import dng as dng_module
from lfrig.processing.export.content import content_of_raw
from lfrig.processing.export.dng import XYZ_OF_SRGB, color_matrix, neutral, read_sensor, write_dng
from lfrig.processing.export.registry import export
from lfrig.processing.lenslet.colour import colour_matrix
from lfrig.processing.lenslet.metadata import RawMetadata
from lfrig.rig.cli import main
from lfrig.rig.ingest import ingest
from lfrig.rig.session.images import write_png

GAINS = (1.31, 1.0, 1.34)
BLACK_LEVEL, COLOR_MATRIX, AS_SHOT_NEUTRAL = 50714, 50721, 50728


def shot(figures: CameraFigures = ILLUM) -> SmallShot:
    return SmallShot(figures, width=120, height=96)


@pytest.fixture
def lfr(tmp_path: Path) -> Path:
    path = tmp_path / "IMG_0001.LFR"
    path.write_bytes(shot_file(shot()))
    return path


@pytest.fixture
def known(lfr: Path) -> RawMetadata:
    return read_sensor(lfr)[1]


def tags(path: Path) -> dict[int, Any]:
    with tifffile.TiffFile(path) as file:
        return {tag.code: tag.value for tag in file.pages.first.tags}


def fractions(value: tuple[int, ...]) -> np.ndarray:
    return np.array(value[::2]) / np.array(value[1::2])


class TestReadBack:
    @pytest.mark.parametrize(("figures", "pattern"), [(ILLUM, "GRBG"), (F01, "BGGR")])
    def test_sensor_values_are_the_camera_s(self, tmp_path: Path, figures: CameraFigures, pattern: str) -> None:
        source = tmp_path / "a.lfr"
        source.write_bytes(shot_file(shot(figures)))
        out = export(content_of_raw("a", source), "dng", tmp_path / "a.dng")
        with rawpy.imread(str(out)) as raw:
            assert raw.raw_type == rawpy.RawType.Flat
            np.testing.assert_array_equal(raw.raw_image, shot(figures).values())
            assert raw.raw_image_visible.shape == (96, 120)
            assert raw.black_level_per_channel == [figures.black] * 4
            assert raw.white_level == figures.white
            assert "".join(raw.color_desc.decode()[k] for k in raw.raw_pattern.ravel()) == pattern
            np.testing.assert_allclose(raw.camera_whitebalance[:3], GAINS, rtol=1e-5)
            assert raw.other.shutter_speed == pytest.approx(0.008)
            assert raw.other.focal_length == pytest.approx(24.2)
            assert raw.other.aperture == pytest.approx(2.2)
        assert tags(out)[34855] == (80 if figures is ILLUM else 207)

    def test_camera_and_no_orientation(self, tmp_path: Path, lfr: Path) -> None:
        found = tags(export(content_of_raw("a", lfr), "dng", tmp_path / "a.dng"))
        assert (found[271], found[272], found[50708]) == ("Lytro, Inc.", "ILLUM", "Lytro, Inc. ILLUM")
        assert found[50735] == shot().serial
        assert found.get(274, 1) == 1

    def test_the_same_file_gives_the_same_bytes(self, tmp_path: Path, lfr: Path) -> None:
        first, second = (export(content_of_raw("a", lfr), "dng", tmp_path / name) for name in ("1.dng", "2.dng"))
        assert first.read_bytes() == second.read_bytes()
        assert first.stat().st_size < 2 * 96 * 120 + 4096

    @pytest.mark.parametrize("bayer", ["RGGB", "GRBG", "GBRG", "BGGR"])
    def test_black_levels_go_to_their_colours(self, tmp_path: Path, known: RawMetadata, bayer: Any) -> None:
        """A sensor that is black at four levels is black throughout, whatever the pattern."""
        levels = {"r": 60.0, "gr": 64.0, "gb": 67.0, "b": 71.0}
        metadata = replace(known, bayer=bayer, black=tuple(levels.values()))
        red_row = 0 if "R" in bayer[:2] else 1
        values = np.empty((96, 120), np.uint16)
        for row, col in np.ndindex(2, 2):
            letter = bayer[2 * row + col]
            name = letter.lower() if letter != "G" else ("gr" if row == red_row else "gb")
            values[row::2, col::2] = levels[name]
        write_dng(tmp_path / "a.dng", values, metadata)
        with rawpy.imread(str(tmp_path / "a.dng")) as raw:
            image = raw.postprocess(gamma=(1, 1), no_auto_bright=True, output_bps=16, use_camera_wb=True)
        assert image.max() == 0
        write_dng(tmp_path / "b.dng", values + np.uint16(9), metadata)
        with rawpy.imread(str(tmp_path / "b.dng")) as raw:
            image = raw.postprocess(
                gamma=(1, 1),
                no_auto_bright=True,
                output_bps=16,
                user_wb=[1, 1, 1, 1],
                output_color=rawpy.ColorSpace.raw,
            )
        assert len(np.unique(image)) == 1

    def test_fractional_levels(self, tmp_path: Path, known: RawMetadata) -> None:
        metadata = replace(known, black=(63.25, 64.5, 64.75, 65.125), white=(1020.0, 1000.5, 1023.0, 1023.0))
        write_dng(tmp_path / "a.dng", np.zeros((96, 120), np.uint16), metadata)
        found = tags(tmp_path / "a.dng")
        np.testing.assert_array_equal(fractions(found[BLACK_LEVEL]), [64.5, 63.25, 65.125, 64.75])  # G R B G
        assert found[50717] == 1000  # nothing that is saturated in one colour is coloured


class TestColour:
    def test_a_converter_arrives_at_the_camera_s_colours(self, tmp_path: Path, known: RawMetadata) -> None:
        """Balanced and converted by LibRaw, patches have the linear sRGB that the recorded matrix gives."""
        for k, balanced in enumerate(([0.4, 0.4, 0.4], [0.5, 0.3, 0.2], [0.2, 0.35, 0.5])):
            camera = np.array(balanced) / GAINS
            levels = known.black[0] + (known.white[0] - known.black[0]) * camera
            values = np.empty((96, 120), np.uint16)
            for site, letter in enumerate(known.bayer):
                values[site // 2 :: 2, site % 2 :: 2] = round(levels["RGB".index(letter)])
            path = tmp_path / f"{k}.dng"
            write_dng(path, values, known)
            with rawpy.imread(str(path)) as raw:
                image = raw.postprocess(
                    gamma=(1, 1), no_auto_bright=True, output_bps=16, use_camera_wb=True, adjust_maximum_thr=0.0
                )
            expected = 65535 * colour_matrix(known).astype(float) @ np.array(balanced)
            np.testing.assert_allclose(image[20, 20], expected, atol=65535 * 0.002)

    def test_white_of_the_shot_is_d65(self, known: RawMetadata) -> None:
        np.testing.assert_allclose(color_matrix(known) @ np.array(XYZ_OF_SRGB).sum(1), neutral(known), rtol=1e-6)

    def test_tags_are_those_of_the_formulas(self, tmp_path: Path, known: RawMetadata) -> None:
        write_dng(tmp_path / "a.dng", np.zeros((96, 120), np.uint16), known)
        found = tags(tmp_path / "a.dng")
        np.testing.assert_allclose(fractions(found[COLOR_MATRIX]), color_matrix(known).ravel(), atol=1e-6)
        np.testing.assert_allclose(fractions(found[AS_SHOT_NEUTRAL]), [1 / 1.31, 1, 1 / 1.34], atol=1e-6)

    def test_what_was_not_recorded(self, tmp_path: Path, known: RawMetadata) -> None:
        bare = replace(
            known, white_balance=None, colour_matrix=None, make=None, model="", serial=None, iso=None, exposure_s=None,
            f_number=None, focal_length_m=None,
        )  # fmt: skip
        write_dng(tmp_path / "a.dng", np.full((96, 120), 300, np.uint16), bare)
        found = tags(tmp_path / "a.dng")
        np.testing.assert_array_equal(fractions(found[AS_SHOT_NEUTRAL]), 1)
        np.testing.assert_allclose(color_matrix(bare) @ XYZ_OF_SRGB, np.eye(3), atol=1e-9)
        assert not {33434, 33437, 34855, 37386, 50735} & set(found)
        with rawpy.imread(str(tmp_path / "a.dng")) as raw:
            assert raw.raw_image.min() == raw.raw_image.max() == 300

    @pytest.mark.parametrize("matrix", [((1, 0, 0), (1, 0, 0), (0, 0, 1)), ((1, 0, 0), (0, 1, 0), (-1, 0, 0))])
    def test_matrices_that_cannot_be_inverted(self, known: RawMetadata, matrix: Any) -> None:
        found = color_matrix(replace(known, colour_matrix=matrix, white_balance=None))
        np.testing.assert_allclose(found @ XYZ_OF_SRGB, np.eye(3), atol=1e-9)

    @pytest.mark.parametrize("gains", [(100.0, 1e-9, 1e-9, 100.0), (1e-9, 100.0, 100.0, 1e-9)])
    def test_absurd_numbers_still_make_a_file(self, tmp_path: Path, known: RawMetadata, gains: Any) -> None:
        absurd = replace(known, white_balance=gains, exposure_s=1e9, iso=1e6, make="é\0" * 9)
        write_dng(tmp_path / "a.dng", np.zeros((96, 120), np.uint16), absurd)
        found = tags(tmp_path / "a.dng")
        assert (fractions(found[AS_SHOT_NEUTRAL]) > 0).all()
        assert found[34855] == 65535
        assert found[271] == "Lytro"


Told = Callable[..., tuple[int, str, str]]


@pytest.fixture
def lfrig(capfd: pytest.CaptureFixture[str]) -> Told:
    def run(*arguments: str | Path) -> tuple[int, str, str]:
        capfd.readouterr()
        code = main([str(argument) for argument in arguments])
        out, err = capfd.readouterr()
        return code, out, err

    return run


def is_dng_of(path: Path, figures: CameraFigures = ILLUM) -> bool:
    with rawpy.imread(str(path)) as raw:
        return bool(np.array_equal(raw.raw_image, shot(figures).values()))


class TestCommand:
    def test_of_a_file(self, tmp_path: Path, lfr: Path, lfrig: Told) -> None:
        code, out, err = lfrig("export", lfr, "--format", "dng", "--out", tmp_path / "x.dng")
        assert (code, out, err) == (0, f"{tmp_path / 'x.dng'}\n", "")
        assert is_dng_of(tmp_path / "x.dng")

    def test_name_and_folder_without_out(
        self, tmp_path: Path, lfr: Path, lfrig: Told, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        (tmp_path / "here").mkdir()
        monkeypatch.chdir(tmp_path / "here")
        code, out, _ = lfrig("--json", "export", lfr, "--format", "dng")
        assert (code, json.loads(out)) == (0, {"path": "IMG_0001.dng", "format": "dng"})
        assert is_dng_of(Path("IMG_0001.dng"))

    def test_of_a_session_and_of_its_captures(self, tmp_path: Path, lfr: Path, lfrig: Told) -> None:
        session = tmp_path / "s"
        write_png(tmp_path / "p.png", np.zeros((96, 120, 3), np.uint8))
        ingest(session, [lfr, tmp_path / "p.png"])
        sources: list[tuple[Any, ...]] = [
            (session,), (session, "--capture", "000"), (session / "captures" / "000",),
        ]  # fmt: skip
        for k, source in enumerate(sources):
            out = tmp_path / f"{k}.dng"
            code, _, err = lfrig("export", *source, "--format", "dng", "--out", out)
            assert (code, err) == (0, "")
            assert is_dng_of(out)
        assert not (session / "cache").exists()  # nothing was decoded

    def test_which_of_two_must_be_said(self, tmp_path: Path, lfr: Path, lfrig: Told) -> None:
        (tmp_path / "b.lfr").write_bytes(shot_file(SmallShot(width=120, height=96, seed=1)))
        ingest(tmp_path / "s", [lfr, tmp_path / "b.lfr"])
        code, _, err = lfrig("export", tmp_path / "s", "--format", "dng", "--out", tmp_path / "x.dng")
        assert code == 2
        assert "--capture" in err
        assert not (tmp_path / "x.dng").exists()

    def test_captures_without_a_raw_file(self, tmp_path: Path, lfrig: Told) -> None:
        folder = tmp_path / "views"
        for row, col in np.ndindex(3, 3):
            write_png(folder / f"{row}_{col}.png", np.full((16, 20, 3), 50 * row + col, np.uint8))
        ingest(tmp_path / "s", [folder])
        for source in (tmp_path / "s", tmp_path / "s" / "captures" / "000"):
            code, out, err = lfrig("export", source, "--format", "dng", "--out", tmp_path / "x.dng")
            assert (code, out) == (3, "")
            assert "000: has no raw file: it is a light field kept as views — " in err
            assert len(err.splitlines()) == 1
        assert not (tmp_path / "x.dng").exists()

    def test_a_result_has_none(self, result_folder: Path, tmp_path: Path, lfrig: Told) -> None:
        code, _, err = lfrig("export", result_folder, "--format", "dng", "--out", tmp_path / "x.dng")
        assert code == 3
        assert "has no raw file of a plenoptic camera — " in err

    @pytest.mark.parametrize("data", [b"", b"text" * 99, b"\x89PNG\r\n\x1a\n" + bytes(40)])
    def test_files_that_are_no_light_field(self, tmp_path: Path, lfrig: Told, data: bytes) -> None:
        (tmp_path / "a.lfr").write_bytes(data)
        code, out, err = lfrig("export", tmp_path / "a.lfr", "--format", "dng", "--out", tmp_path / "x.dng")
        assert (code, out, len(err.splitlines())) == (3, "", 1)
        assert "a.lfr" in err
        assert sorted(path.name for path in tmp_path.iterdir()) == ["a.lfr"]

    def test_a_torn_file(self, tmp_path: Path, lfr: Path, lfrig: Told) -> None:
        lfr.write_bytes(lfr.read_bytes()[:9000])
        code, _, err = lfrig("export", lfr, "--format", "dng", "--out", tmp_path / "x.dng")
        assert (code, len(err.splitlines())) == (3, 1)
        assert sorted(path.name for path in tmp_path.iterdir()) == [lfr.name]

    def test_other_formats_want_views(self, tmp_path: Path, lfr: Path, lfrig: Told) -> None:
        for name in ("hci", "views", "gif"):
            code, _, err = lfrig("export", lfr, "--format", name, "--out", tmp_path / "x")
            assert code == 3
            assert "is raw and has no views — decode it first" in err
        assert sorted(path.name for path in tmp_path.iterdir()) == [lfr.name]

    def test_capture_folders_alone_go_to_other_formats(self, tmp_path: Path, lfrig: Told) -> None:
        folder = tmp_path / "views"
        for row, col in np.ndindex(3, 3):
            write_png(folder / f"{row}_{col}.png", np.full((16, 20, 3), 50 * row + col, np.uint8))
        ingest(tmp_path / "s", [folder])
        (tmp_path / "s" / "session.json").unlink()
        code, _, _ = lfrig(
            "export", tmp_path / "s" / "captures" / "000", "--format", "npy", "--out", tmp_path / "x"
        )  # fmt: skip
        assert code == 0
        assert np.load(tmp_path / "x" / "views.npy").shape == (3, 3, 16, 20, 3)


class TestFiles:
    def test_the_raw_file_is_never_replaced(self, tmp_path: Path, lfr: Path) -> None:
        before = lfr.read_bytes()
        with pytest.raises(UsageError, match="would replace the file"):
            export(content_of_raw("a", lfr), "dng", tmp_path / "x" / ".." / lfr.name, overwrite=True)
        assert lfr.read_bytes() == before

    def test_an_existing_export_stays_unless_told(self, tmp_path: Path, lfr: Path) -> None:
        out = tmp_path / "x.dng"
        out.write_text("mine")
        with pytest.raises(BadInput, match="exists already"):
            export(content_of_raw("a", lfr), "dng", out)
        assert out.read_text() == "mine"
        export(content_of_raw("a", lfr), "dng", out, overwrite=True)
        assert is_dng_of(out)

    def test_a_full_disk(self, tmp_path: Path, lfr: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def full(*_: object, **__: object) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(tifffile, "imwrite", full)
        with pytest.raises(DiskError):
            export(content_of_raw("a", lfr), "dng", tmp_path / "x.dng")
        assert sorted(path.name for path in tmp_path.iterdir()) == [lfr.name]

    def test_the_module_decodes_nothing(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, lfr: Path) -> None:
        content = content_of_raw("a", lfr)
        dng_module.export_dng(content, tmp_path / "a.dng", dng_module.Monitor())
        assert "views" not in content.__dict__
