from __future__ import annotations

import base64
import io
import json
import re
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image as Pillow

from lfrig.contracts.errors import BadInput
from lfrig.contracts.result import ReportDocument
from lfrig.contracts.score import DisparityScore, LightFieldScore, ScoreDocument
from lfrig.processing.depth import DepthMap
from lfrig.processing.export.pfm import read_pfm
from lfrig.processing.export.png import read_png
from lfrig.processing.export.result import report_document
from lfrig.processing.model import LightField
from lfrig.processing.pipeline import ProcessResult
from lfrig.processing.report.depth_page import write_depth_result
from lfrig.processing.report.page import add_score, write_report

VIEWS = LightFieldScore(
    psnr=34.21, ssim=0.951, psnr_with_centre=35.0, ssim_with_centre=0.955, psnr_corners=32.9, ssim_corners=0.93,
    epi_mae=0.012,
)  # fmt: skip
ALL = DisparityScore(
    pixels=5000, mse=0.00123, rmse=0.035, ppe_005=94.1, ppe_010=97.7, badpix_007=3.1, badpix_003=14.0,
    badpix_001=45.0, q25=0.003, rmse_over_range=0.04, unknown=12,
)  # fmt: skip
SCORE = ScoreDocument(
    bf_px_m=0.7, focus_distance_m=0.46, disparity={"all": ALL, "edge": ALL}, views=VIEWS,
    oracles={"z_buffer": VIEWS.model_copy(update={"psnr": 34.62})}, psnr_below_z_buffer_db=0.41,
)  # fmt: skip
VOID = {"img", "meta", "br", "hr", "input"}


class Page(HTMLParser):
    """The elements of a page; checks that they nest."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, f"</{tag}> closes another element"

    def handle_data(self, data: str) -> None:
        if not self.open or self.open[-1] not in {"script", "style"}:
            self.text.append(data)

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]

    @property
    def words(self) -> str:
        return " ".join(" ".join(self.text).split())


@pytest.fixture(scope="module")
def text(result: ProcessResult, tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("page")
    write_report(folder, result, report_document(result, session="bench & co"))
    return (folder / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(text: str) -> Page:
    return Page(text)


def light_field(text: str) -> dict[str, object]:
    block = re.search(r'<script type="application/json" id="light-field">(.*?)</script>', text, re.DOTALL)
    assert block is not None
    data = json.loads(block[1])
    assert isinstance(data, dict)
    return data


def decoded(uri: str) -> np.ndarray:
    return np.asarray(Pillow.open(io.BytesIO(base64.b64decode(uri.partition(",")[2]))))


class TestPage:
    def test_nothing_comes_from_outside(self, page: Page, text: str) -> None:
        for _, attributes in page.elements:
            for name in ("src", "href", "xlink:href", "action", "data", "poster", "srcset"):
                assert (attributes.get(name) or "data:").startswith("data:")
            assert "url(" not in (attributes.get("style") or "")
        outside = re.sub(r"data:[a-z/]+;base64,[A-Za-z0-9+/=]+", "", text)
        assert not re.search(r"https?://|@import|//[a-z]+\.[a-z]", outside)
        policy = next(meta["content"] for meta in page.all("meta") if "http-equiv" in meta)
        assert policy is not None and "default-src 'none'" in policy and "http" not in policy

    def test_names_cannot_become_markup(self, page: Page, text: str) -> None:
        assert page.all("b") == []
        assert "<b>shot</b> & 'co'" in page.words and "bench & co" in page.words
        assert "<b>shot" not in text

    def test_every_picture_says_what_it_shows(self, page: Page) -> None:
        assert all(picture["alt"] for picture in page.all("img"))
        for drawing in page.all("svg"):
            assert drawing.get("aria-label") or drawing.get("aria-hidden") == "true"

    def test_ids_are_unique(self, page: Page) -> None:
        ids = [attributes["id"] for tag, attributes in page.elements if "id" in attributes and tag != "lineargradient"]
        assert len(ids) == len(set(ids))

    def test_summary_says_what_was_made_of_what(self, page: Page) -> None:
        assert "The photo 900 (96 × 64) was raised into a light field of 7 × 7 views" in page.words
        assert "three light fields, 5° to 19° away; poses as given" in page.words
        assert "took 3.2 s (5.8 s CPU, NumPy only)" in page.words

    def test_warnings_and_skips_are_told(self, page: Page) -> None:
        assert "One warning" in page.words and "The disparity range of 001 is narrow: <0.2 px" in page.words
        assert "evidence 18 planes 7 28 %" in page.words
        assert "synthesis 48 views 0 nothing" in page.words

    def test_sources_show_fit_and_slices(self, page: Page) -> None:
        assert "94 % of 120 anchors" in page.words and "0.0079 px" in page.words  # residual / a
        alts = [str(picture["alt"]) for picture in page.all("img")]
        assert sum(alt.startswith("probability of δ") for alt in alts) >= 9
        assert sum(alt.startswith("probability over x") for alt in alts) == 3

    def test_gauge_results_show_no_metres(self, result: ProcessResult, tmp_path: Path) -> None:
        gauge = replace(result, metric=False)
        write_report(tmp_path, gauge, report_document(gauge, session=None))
        page = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
        assert "gauge units" in page.words
        assert not re.search(r"\d m\b", page.words.replace("· F", ""))

    def test_a_full_size_page_stays_small(self, build: Callable[..., ProcessResult], tmp_path: Path) -> None:
        result = build(270, 188)
        write_report(tmp_path, result, report_document(result, session=None))
        # A quarter of full size; 4 MB at 541 × 376.
        assert (tmp_path / "report.html").stat().st_size < 1_000_000

    def test_nothing_known_still_gives_a_page(self, build: Callable[..., ProcessResult], tmp_path: Path) -> None:
        result = build(48, 32)
        field = result.light_field
        nan = np.full_like(field.disparity, np.nan)
        surface = replace(field.surface, inverse_depth=nan, sigma=nan, confidence=np.zeros_like(nan))
        empty = replace(result, light_field=replace(field, disparity=nan, surface=surface), sources=(), stages=())
        write_report(tmp_path, empty, report_document(empty, session=None))
        assert "0.0 %" in Page((tmp_path / "report.html").read_text(encoding="utf-8")).words


class TestViewerData:
    def test_atlas_holds_every_view_in_order(self, text: str, result: ProcessResult) -> None:
        data = light_field(text)
        assert (data["rows"], data["cols"], data["width"], data["height"]) == (7, 7, 96, 64)
        sheet = decoded(str(data["atlas"])).astype(float)
        tiles = sheet.reshape(7, 64, 7, 96, 3).transpose(0, 2, 1, 3, 4)
        views = result.light_field.views.astype(float)
        for row, col in ((0, 0), (0, 6), (3, 3), (5, 1)):
            errors = np.abs(tiles[row, col] - views).mean((2, 3, 4))
            assert np.unravel_index(np.argmin(errors), errors.shape) == (row, col)
            assert errors[row, col] < 6  # compressed noise

    def test_disparity_is_readable_to_a_256th(self, text: str, result: ProcessResult) -> None:
        data = light_field(text)
        low, high = float(str(data["low"])), float(str(data["high"]))
        levels = decoded(str(data["disparity"])).astype(float)
        disparity = np.clip(result.light_field.disparity, low, high)
        known = np.isfinite(disparity)
        error = np.abs(low + (high - low) * levels / 255 - disparity)[known]
        assert error.max() <= (high - low) / 510 + 1e-6

    def test_large_views_are_reduced_and_say_so(
        self, result: ProcessResult, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        from lfrig.processing.report import viewer

        monkeypatch.setattr(viewer, "ATLAS_PIXELS", 49 * 48 * 32)
        write_report(tmp_path, result, report_document(result, session=None))
        data = light_field((tmp_path / "report.html").read_text(encoding="utf-8"))
        assert (data["width"], data["height"], data["perPixel"]) == (48, 32, 2.0)
        assert decoded(str(data["atlas"])).shape == (7 * 32, 7 * 48, 3)
        assert float(str(data["high"])) == pytest.approx(np.nanmax(result.light_field.disparity) / 2, rel=0.05)


class TestScore:
    @pytest.fixture
    def folder(self, text: str, tmp_path: Path) -> Path:
        (tmp_path / "report.html").write_text(text, encoding="utf-8")
        return tmp_path

    def error_map(self) -> np.ndarray:
        error = np.linspace(-0.2, 0.2, 64 * 96, dtype=np.float32).reshape(64, 96)
        error[:5, :5] = np.nan
        return error

    def test_section_stands_between_the_oracles(self, folder: Path) -> None:
        add_score(folder, SCORE, self.error_map())
        words = Page((folder / "report.html").read_text(encoding="utf-8")).words
        assert "97.7 % of the disparities are right within 0.1 px" in words
        assert "0.41 dB below what exact geometry would give" in words
        assert re.search(r"this result 34\.21 dB .*exact geometry, z-buffered 34\.62 dB", words)

    def test_scoring_twice_is_scoring_once(self, folder: Path) -> None:
        add_score(folder, SCORE, self.error_map())
        once = (folder / "report.html").read_text(encoding="utf-8")
        add_score(folder, SCORE, self.error_map())
        assert (folder / "report.html").read_text(encoding="utf-8") == once
        add_score(folder, SCORE.model_copy(update={"psnr_below_z_buffer_db": -0.3}), self.error_map())
        again = (folder / "report.html").read_text(encoding="utf-8")
        assert "0.30 dB above" in again and "0.41 dB below" not in again

    def test_the_rest_of_the_page_is_untouched(self, folder: Path, text: str) -> None:
        add_score(folder, SCORE, self.error_map())
        scored = (folder / "report.html").read_text(encoding="utf-8")
        assert re.sub(r"(<!-- score: begin -->).*(<!-- score: end -->)", r"\1\2", scored, flags=re.DOTALL) == text

    def test_share_of_pixels_is_read_off_the_map(self, folder: Path) -> None:
        add_score(folder, SCORE, np.full((64, 96), 0.03, np.float32))
        words = Page((folder / "report.html").read_text(encoding="utf-8")).words
        assert re.search(r"0\.0 % .*100\.0 % .*100\.0 %", words)

    def test_a_page_without_a_place_is_refused_and_kept(self, tmp_path: Path) -> None:
        (tmp_path / "report.html").write_text("<html>mine</html>")
        with pytest.raises(BadInput, match=r"report\.html: has no place for a score"):
            add_score(tmp_path, SCORE, self.error_map())
        assert (tmp_path / "report.html").read_text() == "<html>mine</html>"

    def test_no_page_is_no_error(self, tmp_path: Path) -> None:
        add_score(tmp_path, SCORE, self.error_map())
        assert list(tmp_path.iterdir()) == []


class TestDepthPage:
    @pytest.fixture
    def depth(self, result: ProcessResult) -> tuple[LightField, DepthMap]:
        source = result.sources[1].source
        evidence = source.evidence
        disparity = evidence.disparity.copy()
        disparity[0, 0] = np.nan
        return source.light_field, DepthMap(disparity, evidence.confidence, evidence, (-0.6, 0.6))

    def test_arrays_previews_and_page(self, depth: tuple[LightField, DepthMap], tmp_path: Path) -> None:
        light_field_, depth_map = depth
        write_depth_result(tmp_path, light_field_, depth_map)
        np.testing.assert_array_equal(read_pfm(tmp_path / "disparity.pfm"), depth_map.disparity)
        np.testing.assert_array_equal(np.load(tmp_path / "confidence.npy"), depth_map.confidence)
        np.testing.assert_array_equal(read_png(tmp_path / "centre.png"), light_field_.centre_view)
        preview = read_png(tmp_path / "disparity.png")
        assert preview.shape == (64, 96, 3) and (preview[0, 0] == 0).all()
        page = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
        assert "lfrig · disparity of one light field" in page.words and "5 × 5" in page.words
        assert len(page.all("canvas")) == 1

    def test_without_optics_there_are_no_metres(self, depth: tuple[LightField, DepthMap], tmp_path: Path) -> None:
        light_field_, depth_map = depth
        write_depth_result(tmp_path, LightField("bare", light_field_.views), depth_map)
        data = light_field((tmp_path / "report.html").read_text(encoding="utf-8"))
        assert data["bf"] is None and data["focusDistance"] is None


def test_report_document_is_what_the_page_was_made_of(result: ProcessResult) -> None:
    report = report_document(result, session="bench")
    assert ReportDocument.parse(json.loads(report.to_json()), "report.json") == report
