"""The viewer in a real browser: headless Chromium, driven by the page's address and by a script in the page."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from lfrig.processing.export.png import read_png
from lfrig.processing.export.result import report_document
from lfrig.processing.pipeline import ProcessResult
from lfrig.processing.report.page import write_report

FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--use-angle=swiftshader", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--hide-scrollbars",
    "--force-device-scale-factor=1", "--host-resolver-rules=MAP * ~NOTFOUND", "--virtual-time-budget=6000",
)  # fmt: skip
WIDTH, HEIGHT = 240, 160


@dataclass(frozen=True)
class Visit:
    """What a page looked like after a while: its elements, <html>'s data attributes, the picture, and the network
    addresses that it asked for.
    """

    elements: str
    state: dict[str, str]
    screenshot: np.ndarray
    requests: list[str]

    @property
    def picture(self) -> np.ndarray:
        """The viewer's pixels of a ``bare`` page."""
        return self.screenshot[:HEIGHT, :WIDTH].astype(float)


@pytest.fixture(scope="session")
def chromium() -> str:
    for name in ("chromium", "chromium-browser", "google-chrome"):
        found = shutil.which(name)
        if found:
            return found
    if os.environ.get("LFRIG_REQUIRE_CHROMIUM") == "1":
        pytest.fail("LFRIG_REQUIRE_CHROMIUM=1, but no Chromium is installed")
    pytest.skip("no Chromium is installed")


@pytest.fixture
def visit(chromium: str, tmp_path: Path) -> Callable[[Path, str], Visit]:
    def go(page: Path, address: str = "", *, still: bool = True) -> Visit:
        # Frames do not keep pace with virtual time: animations are left out, as for people who asked for that.
        flags = [*FLAGS, "--force-prefers-reduced-motion"] if still else FLAGS
        log, picture = tmp_path / "net.json", tmp_path / "page.png"
        run = subprocess.run(
            [chromium, *flags, f"--user-data-dir={tmp_path / 'profile'}", "--window-size=900,700", "--dump-dom",
             f"--screenshot={picture}", f"--log-net-log={log}", f"{page.as_uri()}{address}"],
            capture_output=True, timeout=120, check=True, env={**os.environ, "HOME": str(tmp_path)},
        )  # fmt: skip
        elements = run.stdout.decode()
        opening = re.search(r"<html[^>]*>", elements)
        assert opening is not None
        state = dict(re.findall(r'data-([a-z-]+)="([^"]*)"', opening[0]))
        return Visit(elements, state, read_png(picture), asked_by_pages(log))

    return go


def asked_by_pages(log: Path) -> list[str]:
    """Network addresses that a page, not the browser for itself, asked for."""
    events = json.loads(log.read_text())["events"]
    asked = [event["params"] for event in events if "initiator" in event.get("params", {})]
    return [
        params["url"]
        for params in asked
        if params["initiator"] != "not an origin" and not params["url"].startswith(("file:", "data:", "blob:"))
    ]


@pytest.fixture(scope="module")
def scene(build: Callable[..., ProcessResult]) -> ProcessResult:
    return build(WIDTH, HEIGHT, unknown=False)


@pytest.fixture(scope="module")
def page(scene: ProcessResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("viewer")
    write_report(folder, scene, report_document(scene, session=None))
    return folder / "report.html"


def scripted(page: Path, folder: Path, script: str) -> Path:
    """The page with a script that acts once the viewer is ready."""
    text = page.read_text(encoding="utf-8")
    wait = f"""<script>
      const pointer = (type, x, y, pointerId = 1) =>
        canvas.dispatchEvent(new PointerEvent(type, {{clientX: x, clientY: y, pointerId, bubbles: true}}));
      let canvas, box;
      const timer = setInterval(() => {{
        if (!document.documentElement.dataset.viewer) return;
        clearInterval(timer);
        canvas = document.querySelector(".viewer canvas");
        canvas.scrollIntoView({{behavior: "instant"}});
        box = canvas.getBoundingClientRect();
        {script}
      }}, 50);
    </script></body>"""
    path = folder / "scripted.html"
    path.write_text(text.replace("</body>", wait), encoding="utf-8")
    return path


def closest_view(picture: np.ndarray, views: np.ndarray) -> tuple[int, int]:
    errors = np.abs(views.astype(float) - picture).mean((2, 3, 4))
    row, col = np.unravel_index(int(np.argmin(errors)), errors.shape)
    return int(row), int(col)


class TestReady:
    def test_it_starts_and_asks_the_network_for_nothing(self, page: Path, visit: Callable[..., Visit]) -> None:
        seen = visit(page)
        assert seen.state["viewer"] in {"webgl2", "canvas"}
        assert seen.requests == []

    def test_it_sways_only_for_those_who_like_motion(self, page: Path, visit: Callable[..., Visit]) -> None:
        assert 'data-do="sway" aria-pressed="true"' in visit(page, still=False).elements
        assert 'data-do="sway" aria-pressed="true"' not in visit(page).elements

    def test_a_request_would_have_been_noticed(self, tmp_path: Path, visit: Callable[..., Visit]) -> None:
        leaky = tmp_path / "leaky.html"
        leaky.write_text('<!doctype html><img src="http://example.invalid/x.png">')
        assert visit(leaky).requests == ["http://example.invalid/x.png"]

    def test_the_policy_stops_a_request(self, page: Path, tmp_path: Path, visit: Callable[..., Visit]) -> None:
        asking = scripted(page, tmp_path, 'new Image().src = "http://example.invalid/x.png";')
        assert visit(asking).requests == []

    def test_a_broken_atlas_leaves_the_still_picture(
        self, page: Path, tmp_path: Path, visit: Callable[..., Visit]
    ) -> None:
        broken = tmp_path / "broken.html"
        text = page.read_text(encoding="utf-8")
        broken.write_text(
            re.sub(r'"atlas":"data:[^"]*"', '"atlas":"data:image/png;base64,AAAA"', text), encoding="utf-8"
        )
        assert visit(broken).state["viewer"] == "failed"


@pytest.mark.parametrize("renderer", ["webgl2", "canvas"])
class TestPictures:
    def test_the_address_chooses_the_view(
        self, renderer: str, page: Path, scene: ProcessResult, visit: Callable[..., Visit]
    ) -> None:
        views = scene.light_field.views
        aside = visit(page, f"#view=2,-1&bare&renderer={renderer}")
        assert aside.state["viewer"] == renderer and aside.state["viewpoint"] == "2.00,-1.00"
        assert closest_view(aside.picture, views) == (2, 5)
        assert np.abs(aside.picture - views[2, 5]).mean() < 4  # the atlas is compressed
        middle = visit(page, f"#view=0,0&bare&renderer={renderer}")
        assert closest_view(middle.picture, views) == (3, 3)
        assert np.abs(aside.picture - middle.picture).mean() > 4

    def test_an_open_aperture_blurs_all_but_the_focus(
        self, renderer: str, page: Path, scene: ProcessResult, visit: Callable[..., Visit]
    ) -> None:
        disparity, centre = scene.light_field.disparity, scene.light_field.views[3, 3].astype(float)
        near, far = float(disparity.max()), float(np.median(disparity))
        margin = (slice(12, -12), slice(12, -12))
        ball, wall = (np.abs(disparity - d)[margin] < 0.15 for d in (near, far))
        errors = {}
        for name, focus in (("ball", near - 0.05), ("wall", far)):
            seen = visit(page, f"#view=0,0&aperture=3&focus={focus:.3f}&bare&renderer={renderer}").picture
            difference = np.abs(seen - centre).mean(-1)[margin]
            errors[name] = (difference[ball].mean(), difference[wall].mean())
        assert errors["ball"][0] < 0.65 * errors["wall"][0]
        assert errors["wall"][1] < 0.65 * errors["ball"][1]


class TestHands:
    def test_dragging_moves_the_viewpoint(self, page: Path, tmp_path: Path, visit: Callable[..., Visit]) -> None:
        drag = """
          const x = box.left + box.width / 2, y = box.top + box.height / 2;
          pointer("pointerdown", x, y);
          for (let i = 1; i <= 10; i++) pointer("pointermove", x - 0.02 * i * box.width, y + 0.01 * i * box.height);
          pointer("pointerup", x - 0.2 * box.width, y + 0.1 * box.height);"""
        seen = visit(scripted(page, tmp_path, drag), "#view=0,0")
        x, y = (float(value) for value in seen.state["viewpoint"].split(","))
        # What is near follows the pointer: left and down, so the eye goes right and up.
        assert x == pytest.approx(2.4 * 3 * 0.2, abs=0.05) and y == pytest.approx(-2.4 * 3 * 0.1, abs=0.05)
        assert seen.state["aperture"] == "0.00"  # a drag is no click

    def test_clicking_focuses_there(
        self, page: Path, scene: ProcessResult, tmp_path: Path, visit: Callable[..., Visit]
    ) -> None:
        row, col = 88, 108  # on the ball
        click = f"""
          const x = box.left + box.width * {(col + 0.5) / WIDTH}, y = box.top + box.height * {(row + 0.5) / HEIGHT};
          pointer("pointerdown", x, y); pointer("pointerup", x, y);"""
        seen = visit(scripted(page, tmp_path, click), "#view=0,0")
        focus = float(seen.state["focus"])
        assert focus == pytest.approx(float(scene.light_field.disparity[row, col]), abs=0.03)
        assert float(seen.state["aperture"]) > 2

    def test_keys_and_wheel(self, page: Path, tmp_path: Path, visit: Callable[..., Visit]) -> None:
        keys = """
          const how = {bubbles: true, cancelable: true};
          const press = (key) => canvas.dispatchEvent(new KeyboardEvent("keydown", {key, ...how}));
          const roll = () => canvas.dispatchEvent(new WheelEvent("wheel", {deltaY: -1, ...how}));
          roll();              // not in use yet: the page scrolls, the aperture stays
          canvas.focus();
          roll(); press("+");
          for (let i = 0; i < 4; i++) press("ArrowRight");
          press("ArrowUp");"""
        seen = visit(scripted(page, tmp_path, keys), "#view=0,0")
        assert (seen.state["viewpoint"], seen.state["aperture"]) == ("1.00,-0.25", "0.50")

    def test_two_fingers_open_the_aperture(self, page: Path, tmp_path: Path, visit: Callable[..., Visit]) -> None:
        pinch = """
          const at = (part) => [box.left + part * box.width, box.top + 0.5 * box.height];
          pointer("pointerdown", ...at(0.4), 1); pointer("pointerdown", ...at(0.5), 2);
          pointer("pointermove", ...at(0.75), 2);
          pointer("pointerup", ...at(0.75), 2); pointer("pointerup", ...at(0.4), 1);"""
        seen = visit(scripted(page, tmp_path, pinch), "#view=1,1")
        assert float(seen.state["aperture"]) == pytest.approx(0.25 * 6, abs=0.02)
        assert seen.state["viewpoint"] == "1.00,1.00"
