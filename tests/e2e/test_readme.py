"""The session that the README tells a newcomer to write by hand is processed as it is."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lfrig.sim.shoot import shoot

pytestmark = pytest.mark.slow


def documents_in(readme: Path) -> list[dict]:
    """The JSON objects of its folder listing."""
    [listing] = re.findall(r"```\nSESSION/\n(.*?)```", readme.read_text(encoding="utf-8"), re.DOTALL)
    decoder = json.JSONDecoder()
    starts = [match.start() for match in re.finditer(r'\{"schema"', listing)]
    return [decoder.raw_decode(listing[start:])[0] for start in starts]


def test_the_session_of_the_readme(lfrig, repository: Path, tmp_path: Path) -> None:
    session_json, left, wanted = documents_in(repository / "README.md")
    right = left | {"turntable_deg": -left["turntable_deg"]}
    folder = tmp_path / "SESSION"
    scene = shoot("figurines", 270, 188, (left["turntable_deg"], right["turntable_deg"]), 0.0, truth_views=False)
    for capture, (name, document) in zip(
        scene.captures.values(), {"left": left, "right": right, "wanted": wanted}.items(), strict=True
    ):
        home = folder / "captures" / name
        (home / "views").mkdir(parents=True)
        height, width = capture.pixels.shape[-3:-1]
        camera = {"width": width, "height": height, "fx": capture.document.camera.fx}
        assert set(document["camera"]) == set(camera)  # what the README asks for, with this camera's own numbers
        (home / "capture.json").write_text(json.dumps(document | {"camera": camera}), encoding="utf-8")
        if document["kind"] == "photo":
            Image.fromarray(capture.pixels).save(home / document["image"], quality=95)
            continue
        for row, col in np.ndindex(document["views"]["rows"], document["views"]["cols"]):
            Image.fromarray(capture.pixels[row, col]).save(home / document["views"]["pattern"].format(row=row, col=col))
    (folder / "session.json").write_text(json.dumps(session_json), encoding="utf-8")

    assert lfrig("info", folder).code == 0
    outcome = lfrig("process", folder)
    assert outcome.code == 0, outcome.err
    assert (folder / "results" / "wanted-fast" / "report.html").is_file()
    assert "[no-scale]" in outcome.err  # nothing says how large anything is
