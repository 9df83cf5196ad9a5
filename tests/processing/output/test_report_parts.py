from __future__ import annotations

import base64
import io
import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from PIL import Image as Pillow

from lfrig.contracts.result import StageReport
from lfrig.processing.model import Camera, Pose
from lfrig.processing.pipeline import ProcessResult
from lfrig.processing.report import charts, overview, pictures, slices, words
from lfrig.processing.report.html import Html, el, json_script, table


def decoded(picture: pictures.Picture, mode: str = "RGBA") -> np.ndarray:
    image = Pillow.open(io.BytesIO(base64.b64decode(picture.uri.partition(",")[2])))
    assert image.size == (picture.width, picture.height)
    return np.asarray(image.convert(mode))


class TestHtml:
    @given(text=st.text())
    def test_text_and_attributes_never_become_markup(self, text: str) -> None:
        from html.parser import HTMLParser

        seen: list[tuple[str, dict[str, str | None]]] = []
        data: list[str] = []

        class Reader(HTMLParser):
            def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
                seen.append((tag, dict(attrs)))

            def handle_data(self, text: str) -> None:
                data.append(text)

        reader = Reader()
        reader.feed(el("p", text, title=text))
        reader.close()
        assert [tag for tag, _ in seen] == ["p"] and seen[0][1] == {"title": text}
        assert "".join(data) == text

    def test_elements_pass_through_and_none_is_left_out(self) -> None:
        inner = el("b", "x & y")
        assert el("p", inner, None, "<", class_="a", data_for="b", hidden=None) == (
            '<p class="a" data-for="b"><b>x &amp; y</b>&lt;</p>'
        )
        assert isinstance(inner, Html)

    def test_json_cannot_close_its_script(self) -> None:
        assert "</script>" not in json_script("x", {"a": "</script><b>"}).removesuffix("</script>")

    def test_tables_name_their_rows(self) -> None:
        assert '<th scope="row">a</th><td>1</td>' in table(["x", "y"], [["a", "1"]])


class TestWords:
    @pytest.mark.parametrize(
        ("value", "shown"),
        [(0.46, "0.460"), (0, "0"), (1234.5, "1234"), (-0.05, "−0.0500"), (0.00012, "0.000120"), (3e-7, "3.00·10⁻⁷"),
         (2.5e6, "2.50·10⁶"), (None, "–"), (math.nan, "–"), (math.inf, "–")],
    )  # fmt: skip
    def test_numbers(self, value: float | None, shown: str) -> None:
        assert words.number(value) == shown

    def test_lengths_choose_their_unit(self) -> None:
        lengths = [words.length(m, metric=True) for m in (0.00067, 0.035, 0.46)]
        assert lengths == ["0.670 mm", "3.50 cm", "0.460 m"]
        assert words.length(0.46, metric=False) == "0.460 units"

    def test_every_pose_method_has_words_and_a_new_one_its_name(self) -> None:
        said = [words.poses(method) for method in ("given", "lf", "colmap", "colmap-turntable", "stars")]
        assert len(set(said)) == 5 and said[-1] == "poses: stars"

    def test_durations_and_sizes(self) -> None:
        assert [words.seconds(s) for s in (0.0123, 1.26, 119.6, 600)] == ["12 ms", "1.3 s", "2 min 00 s", "10 min 00 s"]
        assert [words.memory(mb) for mb in (512.3, 1530)] == ["512 MB", "1.5 GB"]
        assert [words.count(n, "source") for n in (1, 3, 12)] == ["one source", "three sources", "12 sources"]
        assert words.listing(["a", "b", "c"]) == "a, b and c"

    @example(low=1.25, span=0.5, wanted=2)
    @given(low=st.floats(-1e4, 1e4), span=st.floats(1e-3, 1e4), wanted=st.integers(2, 9))
    def test_ticks_are_round_inside_and_about_as_many_as_wanted(self, low: float, span: float, wanted: int) -> None:
        ticks = words.nice_ticks(low, low + span, wanted)
        assert all(low - 1e-6 * span <= tick <= low + span * (1 + 1e-6) for tick in ticks)
        assert wanted // 3 <= len(ticks) <= wanted + 1
        labels = words.tick_labels(ticks)
        assert len(set(labels)) == len(labels)
        for tick, label in zip(ticks, labels, strict=True):
            assert float(label.replace("−", "-")) == pytest.approx(tick, abs=1e-9 * max(1, abs(tick)))


class TestPictures:
    @pytest.mark.parametrize("name", ["viridis", "magma", "inferno", "cividis"])
    def test_maps_grow_evenly_lighter(self, name: str) -> None:
        colours = pictures.lookup_table(name).astype(float) / 255
        linear = np.where(colours < 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
        lightness = np.cbrt(linear @ [0.2126, 0.7152, 0.0722])
        assert colours.shape == (256, 3) and (np.diff(lightness[::8]) > 0).all()

    def test_diverging_map_is_neutral_in_the_middle(self) -> None:
        colours = pictures.lookup_table("balance").astype(int)
        assert np.ptp(colours[127]) < 8
        assert colours[0, 2] > colours[0, 0] + 50 and colours[-1, 0] > colours[-1, 2] + 50

    def test_values_get_their_colour_and_unknown_ones_none(self) -> None:
        values = np.array([[0.0, 0.5, 1.0], [2.0, -1.0, np.nan]], np.float32)
        pixels = decoded(pictures.coloured(values, pictures.Scale(0, 1)))
        colours = pictures.lookup_table("viridis")
        assert (pixels[..., 3] == [[255, 255, 255], [255, 255, 0]]).all()
        for (row, col), index in {(0, 0): 0, (0, 1): 127, (0, 2): 254, (1, 0): 254, (1, 1): 0}.items():
            np.testing.assert_array_equal(pixels[row, col, :3], colours[index])

    def test_wide_pictures_are_reduced(self) -> None:
        assert pictures.photograph(np.zeros((50, 1000, 3), np.uint8), 500).width == 500
        assert pictures.coloured(np.zeros((50, 1000), np.float32), pictures.Scale(0, 1), 300).width == 250

    def test_scale_ignores_wild_tails_and_survives_nothing(self) -> None:
        values = np.r_[np.linspace(0, 1, 2000), 1e6, np.nan].astype(np.float32)
        scale = pictures.robust_scale(values)
        assert 0 <= scale.low < 0.02 and 0.98 < scale.high < 1.01
        constant = pictures.robust_scale(np.full(9, 0.3, np.float32))
        assert constant.high > constant.low
        assert pictures.robust_scale(np.full(9, np.nan, np.float32)) == pictures.Scale(0, 1)


class TestSlices:
    def test_lively_row_crosses_the_object(self) -> None:
        disparity = np.zeros((60, 80), np.float32)
        disparity[25:35, 20:40] = 1.0
        confidence = np.ones_like(disparity)
        assert 25 <= slices.lively_row(disparity, confidence) < 35
        assert 18 <= slices.lively_column(disparity, confidence) <= 42
        disparity[:3] = np.random.default_rng(0).normal(size=(3, 80))  # a wild border does not win
        assert 25 <= slices.lively_row(disparity, confidence) < 35

    def test_doubtful_edges_do_not_count(self) -> None:
        disparity = np.zeros((60, 80), np.float32)
        disparity[10:20, 20:40], disparity[40:50, 20:40] = 1.0, 1.0
        confidence = np.ones_like(disparity)
        confidence[:30] = 0.1
        assert 40 <= slices.lively_row(disparity, confidence) < 50

    def test_epi_leans_left_for_near_points(self) -> None:
        views = np.zeros((3, 5, 4, 20, 3), np.uint8)
        for col in range(5):
            views[1, col, 2, 10 - (col - 2)] = 255  # δ = 1
        epi = slices.horizontal_epi(views, 2)
        assert epi.shape == (5, 20, 3)
        np.testing.assert_array_equal(epi[..., 0].argmax(1), [12, 11, 10, 9, 8])
        assert slices.vertical_epi(views, 10).shape == (4, 3, 3)

    def test_planes_are_those_that_occur(self, result: ProcessResult) -> None:
        evidence = result.sources[0].source.evidence
        planes = slices.telling_planes(evidence, 5)
        shown = evidence.planes_px[0] + evidence.planes_px[1] * np.array(planes)
        assert len(planes) >= 3
        assert shown.min() >= evidence.disparity.min() - 0.05 and shown.max() <= evidence.disparity.max() + 0.05
        assert (slices.plane(evidence, planes[0]) > 0.1).any()

    def test_row_slice_has_the_nearest_plane_on_top(self, result: ProcessResult) -> None:
        evidence = result.sources[0].source.evidence
        sheet = slices.along_row(evidence, 30)
        assert sheet.shape == (25, 96)
        found = evidence.planes_px[0] + evidence.planes_px[1] * (24 - sheet.argmax(0))
        np.testing.assert_allclose(found, evidence.disparity[30], atol=0.026)


class TestCharts:
    def test_second_scale_stands_where_its_values_are(self) -> None:
        bar = charts.colour_bar(pictures.Scale(0.0, 1.0), "px", lambda x: 1 / (1 + x), "m")
        import re

        places = {float(t): float(x) for x, t in re.findall(r'<text x="([\d.]+)" y="12"[^>]*>([\d.]+)</text>', bar)}
        below = {float(t): float(x) for x, t in re.findall(r'<text x="([\d.]+)" y="46"[^>]*>([\d.]+)</text>', bar)}
        assert {0.6, 0.8, 1.0} <= set(places)
        left, right = below[0.0], below[1.0]
        for metres, x in places.items():
            assert x == pytest.approx(left + (right - left) * (1 / metres - 1), abs=0.5)

    def test_longest_stage_has_the_longest_bar(self) -> None:
        import re

        stages = [
            StageReport(name=name, wall_s=wall, cpu_s=2 * wall, peak_rss_mb=100)
            for name, wall in (("a", 1.0), ("b", 4.0))
        ]
        chart = charts.stage_chart(stages)
        widths = {k: [] for k in ("wall", "cpu")}
        for width, kind in re.findall(r'width="([\d.]+)"[^>]*class="(wall|cpu)"', chart):
            widths[kind].append(float(width))
        assert widths["cpu"][1] == pytest.approx(4 * widths["cpu"][0])
        assert widths["wall"][1] == pytest.approx(widths["cpu"][1] / 2)


class TestOverview:
    def pose(self, angle_deg: float, turn: np.ndarray | None = None) -> Pose:
        a = np.deg2rad(angle_deg)
        centre = np.array([0.5 * np.cos(a), 0.5 * np.sin(a), 0.2])
        forward = -centre / np.linalg.norm(centre)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward]) @ (np.eye(3) if turn is None else turn)
        return Pose(rotation, -rotation @ (centre if turn is None else turn.T @ centre))

    def test_up_is_the_turntables_axis_and_forward_the_targets_view(self) -> None:
        camera = Camera.centred(96, 64, 200)
        points = [overview.Standpoint(str(a), camera, self.pose(a), target=a == 20) for a in (0, 20, 40)]
        up, forward, right = overview.axes(points)
        np.testing.assert_allclose(up, [0, 0, 1])
        a = np.deg2rad(20)
        np.testing.assert_allclose(forward, [-np.cos(a), -np.sin(a), 0], atol=1e-12)
        np.testing.assert_allclose(right, np.cross(forward, up))

    def test_any_frame_gives_a_level_frame(self) -> None:
        turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
        turn *= np.linalg.det(turn)
        camera = Camera.centred(96, 64, 200)
        points = [overview.Standpoint(str(a), camera, self.pose(a, turn)) for a in (0, 30)]
        frame = np.stack(overview.axes(points))
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-9)
        np.testing.assert_allclose(np.linalg.det(np.stack([frame[2], frame[1], frame[0]])), 1)

    def test_cloud_lies_on_the_surface(self, result: ProcessResult) -> None:
        surface = result.light_field.surface
        camera, pose = result.target_camera, result.target_pose
        cloud = overview.point_cloud(camera, pose, surface.inverse_depth, surface.confidence, result.target.image8)
        depth = cloud.points @ pose.rotation[2] + pose.translation[2]
        assert len(cloud.points) == np.isfinite(surface.inverse_depth).sum()
        assert depth.min() == pytest.approx(0.40, abs=0.01) and depth.max() == pytest.approx(0.66, abs=0.01)

    def test_nothing_known_still_draws_the_cameras(self) -> None:
        camera = Camera.centred(96, 64, 200)
        empty = overview.Cloud(np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
        drawing = overview.overview([overview.Standpoint("only", camera, self.pose(0))], empty, metric=False)
        assert drawing.count("<polygon") == 2 and "units" in drawing and "nan" not in drawing
