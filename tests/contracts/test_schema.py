"""Documents on disk: what is written is read back; what cannot be used is refused with its file and field."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfrig.contracts.bench import BenchDocument, Check
from lfrig.contracts.capture import (
    CameraSpec,
    CaptureDocument,
    ExposureSpec,
    OpticsSpec,
    OriginSpec,
    PoseSpec,
    RawSpec,
    ViewsSpec,
)
from lfrig.contracts.errors import BadInput, ExitCode
from lfrig.contracts.result import ReportDocument, SourceReport, StageReport, TargetReport, WarningReport
from lfrig.contracts.schema import Document, Model
from lfrig.contracts.score import DisparityScore, LightFieldScore, ScoreDocument
from lfrig.contracts.session import CameraMount, RigCameras, RigSpec, SessionDocument

finite = st.floats(-1e9, 1e9)
positive = st.floats(1e-6, 1e6)
sigma = st.floats(0, 10)
text = st.text(max_size=12)
vector = st.tuples(finite, finite, finite)


def maybe(strategy: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.none() | strategy


def built(kind: type[Model], **given: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    """A document whose plain required fields are made up by their type, floats finite."""
    by_type = {float: sigma, int: st.integers(0, 10**6), str: text, bool: st.booleans()}
    made_up = {n: by_type[f.annotation] for n, f in kind.model_fields.items() if f.is_required() and n not in given}
    return st.builds(kind, **made_up, **given)


@st.composite
def rotations(draw: st.DrawFn) -> tuple[tuple[float, float, float], ...]:
    quaternion = np.add(draw(st.tuples(*[st.floats(-1, 1)] * 4)), (2.5, 0, 0, 0))
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    rotation = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return tuple(tuple(float(v) for v in row) for row in rotation)


poses = st.builds(PoseSpec, R=rotations(), t=vector, sigma_deg=sigma, sigma_m=sigma)
depth_ranges = st.tuples(positive, positive).filter(lambda r: r[0] < r[1])
cameras = st.builds(
    CameraSpec,
    width=st.integers(1, 10000),
    height=st.integers(1, 10000),
    fx=maybe(positive),
    fy=maybe(positive),
    cx=maybe(finite),
    cy=maybe(finite),
    sigma_f=maybe(sigma),
    distortion=maybe(st.sampled_from([(), (0.1, -0.2, 0.0, 1e-3), (0.1,) * 5, (0.0,) * 8])),
)
captures = st.builds(
    CaptureDocument,
    kind=st.just("light_field"),
    time=maybe(text),
    views=st.builds(
        ViewsSpec,
        rows=st.integers(3, 20),
        cols=st.integers(3, 20),
        pattern=st.sampled_from(["views/{row:02d}_{col:02d}.png", "a{row}b{col}.jpg", "{col:03d}/{row}.png"]),
    ),
    raw=maybe(st.builds(RawSpec, path=st.just("capture.lfr"), sha256=maybe(text))),
    camera=maybe(cameras),
    optics=maybe(
        st.builds(OpticsSpec, baseline_m=maybe(positive), focus_distance_m=maybe(positive), sigma_baseline=maybe(sigma))
    ),
    exposure=maybe(
        st.builds(
            ExposureSpec,
            time_s=maybe(positive),
            iso=maybe(positive),
            white_balance=maybe(vector),
        )
    ),
    depth_range_m=maybe(depth_ranges),
    turntable_deg=maybe(finite),
    pose=maybe(poses),
    origin=maybe(st.builds(OriginSpec, name=text, format=maybe(text), sha256=maybe(text))),
)
mounts = st.builds(CameraMount, camera_from_plate=maybe(poses))
sessions = st.builds(
    SessionDocument,
    captures=st.lists(st.integers(0, 999).map("{:03d}".format), unique=True, max_size=6),
    rig=st.builds(
        RigSpec,
        cameras=st.builds(RigCameras, light_field=maybe(mounts), target=maybe(mounts)),
        camera_from_plate=maybe(poses),
        turntable_sigma_deg=maybe(sigma),
        depth_range_m=maybe(depth_ranges),
    ),
)
counts = st.integers(0, 10**6)
reports = st.builds(
    ReportDocument,
    preset=text,
    version=text,
    session=maybe(text),
    target=st.builds(
        TargetReport,
        id=text,
        baseline_m=positive,
        focus_distance_m=positive,
        fx=positive,
        width=counts,
        height=counts,
        rows=counts,
        cols=counts,
        pose=maybe(poses),
        metric=st.booleans(),
    ),
    stages=st.lists(st.builds(StageReport, name=text, wall_s=sigma, cpu_s=sigma, peak_rss_mb=sigma), max_size=2),
    sources=st.lists(
        st.builds(
            SourceReport,
            id=text,
            a=finite,
            c=finite,
            residual=sigma,
            inliers=sigma,
            anchors=counts,
            angle_residual_deg=maybe(finite),
            pose=maybe(poses),
        ),
        max_size=2,
    ),
    warnings=st.lists(st.builds(WarningReport, code=text, message=text), max_size=2),
)
light_field_scores = built(LightFieldScore)
scores = st.builds(
    ScoreDocument,
    bf_px_m=finite,
    focus_distance_m=finite,
    disparity=st.dictionaries(text, built(DisparityScore), max_size=2),
    views=maybe(light_field_scores),
    oracles=st.dictionaries(text, light_field_scores, max_size=2),
    notes=st.lists(text, max_size=2),
)
benches = st.builds(
    BenchDocument,
    name=text,
    commit=maybe(text),
    machine=st.dictionaries(text, text, max_size=2),
    rows=st.lists(st.dictionaries(text, finite | text | st.booleans(), max_size=3), max_size=2),
    checks=st.lists(built(Check, direction=st.sampled_from(["<=", ">="])), max_size=2),
)
documents = st.one_of(captures, sessions, reports, scores, benches)


@settings(max_examples=50)
@given(documents)
def test_a_document_reads_back_as_it_was_written(document: Document) -> None:
    written = document.to_json()
    again = type(document).parse(json.loads(written), "x.json")
    assert again == document
    assert again.to_json() == written
    assert written.startswith('{\n "schema": "' + document.schema_id())


@given(captures, st.dictionaries(st.from_regex(r"x_[a-z]{1,5}", fullmatch=True), st.integers() | text, max_size=3))
def test_unknown_fields_survive_a_round_trip(document: CaptureDocument, extra: dict[str, Any]) -> None:
    data = json.loads(document.to_json()) | extra
    data["views"] |= extra
    again = json.loads(CaptureDocument.parse(data, "x.json").to_json())
    assert again == data


PHOTO = {"schema": "lfrig.capture/1", "kind": "photo", "image": "photo.png"}


def refusal(data: Any, kind: type[Document] = CaptureDocument) -> BadInput:
    with pytest.raises(BadInput) as caught:
        kind.parse(data, "folder/capture.json")
    assert caught.value.exit_code == ExitCode.BAD_INPUT
    assert caught.value.message.startswith("folder/capture.json: ")
    assert caught.value.remedy
    assert "\n" not in str(caught.value)
    return caught.value


@pytest.mark.parametrize(
    ("schema", "code"),
    [
        ("lfrig.capture/2", "newer-schema"),
        ("lfrig.capture/17.3", "newer-schema"),
        ("lfrig.session/1", "unknown-schema"),
        ("lfrig.capture", "unknown-schema"),
        ("lfrig.capture/", "unknown-schema"),
        ("lfrig.capture/0", "unknown-schema"),
        ("lfrig.capture/one", "unknown-schema"),
        ("lfrig.capture/" + "9" * 5000, "unknown-schema"),
        (None, "unknown-schema"),
        (1, "unknown-schema"),
    ],
)
def test_other_schemas_are_refused(schema: Any, code: str) -> None:
    error = refusal(PHOTO | {"schema": schema})
    assert (error.code, error.field) == (code, "schema")


def test_a_missing_schema_is_named() -> None:
    assert "missing" in refusal({"kind": "photo", "image": "a.png"}).message


def test_a_newer_minor_version_is_read() -> None:
    document = CaptureDocument.parse(PHOTO | {"schema": "lfrig.capture/1.4", "brand_new": 7}, "x")
    assert document.model_extra == {"brand_new": 7}


@pytest.mark.parametrize("data", [[], "text", 3, None])
def test_json_that_is_no_object_is_refused(data: Any) -> None:
    assert "JSON object" in refusal(data).message


IDENTITY = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]


@pytest.mark.parametrize(
    ("patch", "field"),
    [
        ({"pose": {"R": IDENTITY, "t": [0, 0, math.nan]}}, "pose.t.2"),
        ({"pose": {"R": [[1, 0, 0], [0, math.inf, 0], [0, 0, 1]], "t": [0, 0, 0]}}, "pose.R.1.1"),
        ({"pose": {"R": [[1, 0, 0], [0, 1, 0], [0, 0, 2]], "t": [0, 0, 0]}}, "pose"),
        ({"pose": {"R": [[1, 0, 0], [0, 1, 0], [0, 0, -1]], "t": [0, 0, 0]}}, "pose"),
        ({"pose": {"R": IDENTITY, "t": [0, 0]}}, "pose.t.2"),
        ({"pose": {"R": IDENTITY, "t": [0, 0, 0], "sigma_deg": -1}}, "pose.sigma_deg"),
        ({"turntable_deg": math.nan}, "turntable_deg"),
        ({"depth_range_m": [0.8, 0.3]}, "depth_range_m"),
        ({"depth_range_m": [0, 0.3]}, "depth_range_m.0"),
        ({"camera": {"width": 0, "height": 4}}, "camera.width"),
        ({"camera": {"width": 4, "height": 4, "fx": -3}}, "camera.fx"),
        ({"camera": {"width": 4, "height": 4, "distortion": [1, 2]}}, "camera.distortion"),
        ({"optics": {"baseline_m": 0}}, "optics.baseline_m"),
        ({"image": "../photo.png"}, "image"),
        ({"image": "/etc/passwd"}, "image"),
        ({"image": "C:\\photo.png"}, "image"),
        ({"raw": {"path": "a/../../b.lfr"}}, "raw.path"),
        ({"kind": "video"}, "kind"),
        ({"views": {"rows": 2, "cols": 7}}, "views.rows"),
        ({"views": {"rows": 7, "cols": 10**9}}, "views.cols"),
    ],
)
def test_bad_fields_are_named(patch: dict[str, Any], field: str) -> None:
    error = refusal(PHOTO | patch)
    assert error.field == field
    assert error.code == "invalid-field"


@pytest.mark.parametrize("missing", [{"kind": "photo"}, {"kind": "light_field"}])
def test_a_capture_without_pixels_is_refused(missing: dict[str, Any]) -> None:
    assert "needs the field" in refusal({"schema": "lfrig.capture/1"} | missing).message


def test_rounded_rotations_are_accepted() -> None:
    c, s = round(math.cos(0.3), 4), round(math.sin(0.3), 4)
    pose = PoseSpec.model_validate({"R": [[c, -s, 0], [s, c, 0], [0, 0, 1]], "t": [0, 0, 0]})
    assert pose.R[0][0] == c


@pytest.mark.parametrize(
    "capture_id", ["", ".", "..", "../000", "a/b", "a\\b", "000,001", ".hidden", " 000", "a\nb", "a\0b"]
)
def test_capture_ids_that_are_no_folder_names_are_refused(capture_id: str) -> None:
    error = refusal({"schema": "lfrig.session/1", "captures": [capture_id]}, SessionDocument)
    assert error.field == "captures"


def test_a_capture_listed_twice_is_refused() -> None:
    error = refusal({"schema": "lfrig.session/1", "captures": ["000", "000"]}, SessionDocument)
    assert "twice" in error.message


def test_both_spellings_of_the_light_field_mount() -> None:
    pose = {"R": IDENTITY, "t": [0, 0, 0.5]}
    direct = RigSpec.model_validate({"camera_from_plate": pose})
    nested = RigSpec.model_validate({"cameras": {"light_field": {"camera_from_plate": pose}}})
    assert direct.light_field_mount() == nested.light_field_mount() == PoseSpec.model_validate(pose)
    assert nested.target_mount() is None


def test_documents_cannot_be_changed() -> None:
    document = CaptureDocument.parse(PHOTO, "x")
    with pytest.raises(ValueError, match="frozen"):
        document.image = "other.png"  # type: ignore[misc]
    assert isinstance(document, Model)


def test_what_json_cannot_hold_becomes_null() -> None:
    bench = BenchDocument(name="b", rows=[{"bad": math.nan, "list": [1.0, math.inf]}])
    assert json.loads(bench.to_json())["rows"] == [{"bad": None, "list": [1.0, None]}]


@pytest.mark.parametrize(("direction", "ok"), [("<=", True), (">=", False)])
def test_checks_decide_themselves(direction: Any, ok: bool) -> None:
    assert Check.of("c", 1.0, direction, 2.0, "why").ok is ok
    assert Check.of("c", 2.0, direction, 2.0, "why").ok


@pytest.mark.parametrize(
    ("content", "code"),
    [
        (b"{", "not-json"),
        (b"\xff\xfe{}", "not-json"),
        (b"", "not-json"),
        (b"[" * 100_000, "not-json"),
        (b'{"schema": ' + b"1" * 5000 + b"}", "not-json"),
    ],
)
def test_files_that_are_no_json_are_refused(tmp_path: Path, content: bytes, code: str) -> None:
    (tmp_path / "c.json").write_bytes(content)
    with pytest.raises(BadInput) as caught:
        CaptureDocument.load(tmp_path / "c.json")
    assert caught.value.code == code
    assert str(tmp_path / "c.json") in caught.value.message


def test_missing_files_and_folders_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "none.json", tmp_path):
        with pytest.raises(BadInput, match=str(path)):
            CaptureDocument.load(path)


def test_a_byte_order_mark_does_no_harm(tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text(json.dumps(PHOTO), encoding="utf-8-sig")
    assert CaptureDocument.load(tmp_path / "c.json").image == "photo.png"


def test_saving_replaces_the_file(tmp_path: Path) -> None:
    path = tmp_path / "s.json"
    SessionDocument(captures=["000"]).save(path)
    SessionDocument(captures=["000", "001"]).save(path)
    assert SessionDocument.load(path).captures == ["000", "001"]
    assert [entry.name for entry in tmp_path.iterdir()] == ["s.json"]
