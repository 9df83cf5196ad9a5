"""Each foreign format: what is read from its names, numbers and parameters."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfrig.contracts.errors import BadInput
from lfrig.contracts.progress import Monitor
from lfrig.processing.export import registry
from lfrig.rig.ingest import eslf as eslf_module
from lfrig.rig.ingest import ingest, open_light_field
from lfrig.rig.session.images import write_png
from lfrig.rig.session.store import SessionStore
from tests.rig.session_files import H, W, known_document, view, views, write_view_folder

COTTON_CFG = """[intrinsics]
focal_length_mm = 100.0
image_resolution_x_px = 16
image_resolution_y_px = 12
sensor_size_mm = 35.0

[extrinsics]
num_cams_x = {side}
num_cams_y = {side}
baseline_mm = 25.0
focus_distance_m = 4.25

[meta]
scene = cot%ton
disp_min = -0.2
disp_max = 0.3
"""


def hci_folder(folder: Path, side: int, taken: range, cfg: str | None = COTTON_CFG) -> Path:
    """View (r, c) of the light field is the r-th and c-th of ``taken`` rows and columns among side × side."""
    for r, row in enumerate(taken):
        for c, col in enumerate(taken):
            write_png(folder / f"input_Cam{row * side + col:03d}.png", view(r, c))
    if cfg is not None:
        (folder / "parameters.cfg").write_text(cfg.replace("{side}", str(side)))
    return folder


def test_hci_knows_camera_optics_and_depth_range(tmp_path: Path) -> None:
    light_field = open_light_field(hci_folder(tmp_path / "cotton", 5, range(5)))
    assert np.array_equal(light_field.views, views(5, 5))
    assert light_field.camera is not None
    focal = 100 / 35 * W
    assert light_field.camera.focal_px == pytest.approx(focal)
    assert (light_field.camera.cx, light_field.camera.cy) == ((W - 1) / 2, (H - 1) / 2)
    optics = light_field.optics
    assert (optics.baseline_m, optics.focus_distance_m, optics.sigma_baseline) == (0.025, 4.25, 0.0)
    # δ = b F (1/z − 1/z_f): the near end has the larger disparity.
    assert light_field.depth_range_m is not None
    near, far = light_field.depth_range_m
    bf = 0.025 * focal
    assert bf * (1 / near - 1 / 4.25) == pytest.approx(0.3)
    assert bf * (1 / far - 1 / 4.25) == pytest.approx(-0.2)


def test_hci_takes_a_part_of_nine_by_nine(tmp_path: Path) -> None:
    light_field = open_light_field(hci_folder(tmp_path / "hci", 9, range(1, 8)))
    assert np.array_equal(light_field.views, views(7, 7))


@pytest.mark.parametrize(("side", "taken"), [(9, range(1, 8)), (5, range(5)), (9, range(9))])
def test_hci_without_parameters(tmp_path: Path, side: int, taken: range) -> None:
    light_field = open_light_field(hci_folder(tmp_path / "hci", side, taken, None))
    assert np.array_equal(light_field.views, views(len(taken), len(taken)))
    assert light_field.camera is None
    assert light_field.optics.baseline_m is None


def test_hci_of_several_rows_and_columns(tmp_path: Path) -> None:
    for r in range(3):
        for c in range(5):
            write_png(tmp_path / "hci" / f"input_Cam{r * 5 + c:03d}.png", view(r, c))
    (tmp_path / "hci" / "parameters.cfg").write_text("[extrinsics]\nnum_cams_x = 5\nnum_cams_y = 3\n")
    assert np.array_equal(open_light_field(tmp_path / "hci").views, views(3, 5))


@pytest.mark.parametrize(
    ("line", "replacement", "field"),
    [
        ("baseline_mm = 25.0", "baseline_mm = wide", "extrinsics.baseline_mm"),
        ("focus_distance_m = 4.25", "focus_distance_m = 0", "extrinsics.focus_distance_m"),
        ("sensor_size_mm = 35.0", "sensor_size_mm = nan", "intrinsics.sensor_size_mm"),
        ("num_cams_x = {side}", "num_cams_x = -9", "extrinsics.num_cams_x"),
        ("[intrinsics]", "no section", None),
    ],
)
def test_hci_parameters_that_make_no_sense_are_named(
    tmp_path: Path, line: str, replacement: str, field: str | None
) -> None:
    folder = hci_folder(tmp_path / "hci", 3, range(3), COTTON_CFG.replace(line, replacement))
    with pytest.raises(BadInput, match=r"parameters\.cfg") as caught:
        open_light_field(folder)
    assert caught.value.field == field


@pytest.mark.parametrize("line", ["baseline_mm = 25.0", "focus_distance_m = 4.25", "focal_length_mm = 100.0"])
def test_hci_parameters_that_are_not_there_are_unknown(tmp_path: Path, line: str) -> None:
    light_field = open_light_field(hci_folder(tmp_path / "hci", 3, range(3), COTTON_CFG.replace(line, "")))
    unknown = [light_field.optics.baseline_m, light_field.optics.focus_distance_m, light_field.camera]
    assert unknown.count(None) == 1
    assert light_field.depth_range_m is None


def test_hci_with_a_hole_is_refused(tmp_path: Path) -> None:
    folder = hci_folder(tmp_path / "hci", 9, range(1, 8))
    (folder / "input_Cam040.png").unlink()
    with pytest.raises(BadInput, match=r"view \(4, 4\).*1 of 7×7") as caught:
        open_light_field(folder)
    assert caught.value.code == "missing-views"


def test_our_own_hci_export_comes_back(tmp_path: Path) -> None:
    store = SessionStore.create(tmp_path / "s")
    store.add_light_field(views(), known_document())
    original = store.load_light_field("000")
    registry.export(original, "hci", tmp_path / "hci")
    back = open_light_field(tmp_path / "hci")
    assert np.array_equal(back.views, original.views)
    assert back.camera is not None
    assert back.camera.focal_px == pytest.approx(30.0)
    assert back.optics.baseline_m == pytest.approx(0.001)
    assert back.optics.focus_distance_m == pytest.approx(0.5)


def eslf(height: int = 6, width: int = 8) -> np.ndarray:
    """Tiles of 14×14: pixel (14 y + r, 14 x + c) is pixel (x, y) of view (r, c)."""
    picture = np.zeros((14 * height, 14 * width, 3), np.uint8)
    for r in range(14):
        for c in range(14):
            picture[r::14, c::14] = view(r, c, height, width)
    return picture


def test_eslf_gives_the_middle_seven_views(tmp_path: Path) -> None:
    write_png(tmp_path / "IMG_0001_eslf.png", eslf())
    monitor = Monitor()
    (ingested,) = ingest(tmp_path / "s", [tmp_path / "IMG_0001_eslf.png"], monitor=monitor)
    assert (ingested.kind, ingested.format) == ("light_field", "eslf")
    assert any("3..9" in notice.message and notice.code == "eslf-views" for notice in monitor.notices)
    light_field = SessionStore.open(tmp_path / "s").load_light_field("000")
    assert light_field.views.shape == (7, 7, 6, 8, 3)
    for r in range(7):
        for c in range(7):
            assert np.array_equal(light_field.views[r, c], view(r + 3, c + 3, 6, 8))
    assert np.array_equal(open_light_field(tmp_path / "IMG_0001_eslf.png").views, light_field.views)
    assert ingest(tmp_path / "s", [tmp_path / "IMG_0001_eslf.png"])[0].skipped


def test_eslf_of_sixteen_bits(tmp_path: Path) -> None:
    write_png(tmp_path / "eslf.png", eslf().astype(np.uint16) << 8)
    assert np.array_equal(open_light_field(tmp_path / "eslf.png").centre_view, view(6, 6, 6, 8))


def test_eslf_is_known_by_its_size_or_when_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_png(tmp_path / "a.png", eslf())
    assert ingest(tmp_path / "s", [tmp_path / "a.png"])[0].kind == "photo"
    assert ingest(tmp_path / "s", [tmp_path / "a.png"], kind="light_field")[0].format == "eslf"
    assert (eslf_module.POWER_TOOLS_SIZE[0] / 14, eslf_module.POWER_TOOLS_SIZE[1] / 14) == (541, 376)
    monkeypatch.setattr(eslf_module, "POWER_TOOLS_SIZE", (14 * 8, 14 * 6))
    assert open_light_field(tmp_path / "a.png").views.shape == (7, 7, 6, 8, 3)


def test_eslf_of_another_size_is_refused(tmp_path: Path) -> None:
    write_png(tmp_path / "x_eslf.png", eslf()[:-1])
    with pytest.raises(BadInput, match="14×14 tiles") as caught:
        open_light_field(tmp_path / "x_eslf.png")
    assert caught.value.code == "not-an-eslf"


@pytest.mark.parametrize(
    ("pattern", "rows", "cols"),
    [
        ("2067_{row:02d}_{col:02d}.png", range(2, 9), range(2, 9)),
        ("{row}x{col}.png", range(3), range(8, 12)),
        ("view12_r{row}_c{col}_final3.png", range(3), range(3)),
        ("{row}-{col}.png", range(0, 9, 4), range(10, 20, 3)),
    ],
)
def test_sai_numbers_are_found(tmp_path: Path, pattern: str, rows: range, cols: range) -> None:
    folder = write_view_folder(tmp_path / "sai", pattern, rows, cols)
    expected = views(len(rows), len(cols))[:, : len(cols) - 1 + len(cols) % 2]
    assert np.array_equal(open_light_field(folder).views, expected)


def test_sai_counted_row_by_row(tmp_path: Path) -> None:
    for n in range(9):
        write_png(tmp_path / "sai" / f"frame{n + 7}.png", view(*divmod(n, 3)))
    assert np.array_equal(open_light_field(tmp_path / "sai").views, views())


def test_sai_of_a_gantry_ignores_the_camera_positions(tmp_path: Path) -> None:
    for r in range(3):
        for c in range(3):
            name = f"out_{r:02d}_{c:02d}_-{381.9 + 3.7 * c + 0.01 * r:.6f}_{1103.4 + 3.1 * r + 0.02 * c:.6f}.png"
            write_png(tmp_path / "sai" / name, view(r, c))
    assert np.array_equal(open_light_field(tmp_path / "sai").views, views())


def test_sai_with_other_pictures_beside(tmp_path: Path) -> None:
    folder = write_view_folder(tmp_path / "sai", "v_{row}_{col}.png")
    write_png(folder / "thumbnail.png", view(0, 0, 3, 3))
    (folder / "notes_1_2.txt").write_text("text")
    assert np.array_equal(open_light_field(folder).views, views())


def test_sai_pattern(tmp_path: Path) -> None:
    """Columns first, in folders: only a pattern can tell."""
    for r in range(3):
        for c in range(5):
            write_png(tmp_path / "sai" / f"col{c}" / f"{r}.png", view(r, c))
    ingest(tmp_path / "s", [tmp_path / "sai"], pattern="col{col}/{row}.png")
    assert np.array_equal(SessionStore.open(tmp_path / "s").load_light_field("000").views, views(3, 5))
    with pytest.raises(BadInput, match="no file named like"):
        ingest(tmp_path / "t", [tmp_path / "sai"], pattern="row{row}/{col}.png")


def test_a_pattern_wins_over_hci(tmp_path: Path) -> None:
    for r in range(3):
        for c in range(3):
            write_png(tmp_path / "hci" / f"input_Cam{r}{c}.png", view(c, r))
    found = ingest(tmp_path / "s", [tmp_path / "hci"], pattern="input_Cam{col:01d}{row:01d}.png")
    assert found[0].format == "sai"
    assert np.array_equal(SessionStore.open(tmp_path / "s").load_light_field("000").views, views())


def test_a_sai_hole_is_named_as_its_neighbours_are(tmp_path: Path) -> None:
    folder = write_view_folder(tmp_path / "sai", "a7_{row:03d}_{col:02d}.png", range(2, 6), range(2, 6))
    (folder / "a7_004_03.png").unlink()
    with pytest.raises(BadInput, match=r"a7_004_03\.png: is missing \(1 of 4×4") as caught:
        open_light_field(folder)
    assert caught.value.code == "missing-views"


@pytest.mark.parametrize(
    ("names", "code"),
    [
        (["a_0_0", "a_0_1", "a_1_0", "a_1_1"], "too-few-views"),
        (["a", "b", "c"], "no-view-grid"),
        (["a1", "a2", "a3", "a4", "a5"], "no-view-grid"),
        (["a0_0", "a1_1", "a1000000000_2"], "no-view-grid"),
        (["a0_0", "a0_00", "a1_1", "a2_2"], "no-view-grid"),
        (["one_1"], "no-view-grid"),
    ],
)
def test_folders_whose_names_make_no_grid(tmp_path: Path, names: list[str], code: str) -> None:
    for name in names:
        write_png(tmp_path / "sai" / f"{name}.png", view(0, 0))
    with pytest.raises(BadInput, match=re.escape(str(tmp_path / "sai"))) as caught:
        open_light_field(tmp_path / "sai")
    assert caught.value.code == code
    assert "--pattern" in caught.value.remedy


def test_views_that_are_no_png_keep_their_format(tmp_path: Path) -> None:
    from PIL import Image as Pillow

    (tmp_path / "sai").mkdir()
    for r in range(3):
        for c in range(3):
            Pillow.fromarray(view(r, c)).save(tmp_path / "sai" / f"{r}_{c}.BMP")
    ingest(tmp_path / "s", [tmp_path / "sai"])
    store = SessionStore.open(tmp_path / "s")
    assert np.array_equal(store.load_light_field("000").views, views())
    assert (store.capture_folder("000") / "views" / "02_02.bmp").is_file()


def warp_error(light_field: Any, disparity: np.ndarray, row: int, col: int) -> float:
    """Mean grey difference of a view, gathered by the disparity of the centre view, to the centre view."""
    import cv2

    r0, c0 = light_field.centre_index
    y, x = np.mgrid[: light_field.height, : light_field.width].astype(np.float32)
    gathered = cv2.remap(
        light_field.views[row, col], x - (col - c0) * disparity, y - (row - r0) * disparity, cv2.INTER_LINEAR
    )
    return float(np.abs(gathered.astype(float) - light_field.centre_view)[20:-20, 20:-20].mean())


def test_cotton_has_our_sign_and_the_scale_of_its_ground_truth(shared_data: Path) -> None:
    """δ = α / Z + β with α = 36.569, β = −8.6043 fitted to the ground truth (its README)."""
    from lfrig.processing.export.pfm import read_pfm

    folder = shared_data / "hci_cotton"
    light_field = open_light_field(folder)
    assert light_field.views.shape == (7, 7, 512, 512, 3)
    assert light_field.camera is not None
    assert light_field.optics.baseline_m is not None
    assert light_field.optics.focus_distance_m is not None
    bf = light_field.optics.baseline_m * light_field.camera.focal_px
    assert bf == pytest.approx(36.569, abs=0.05)
    assert -bf / light_field.optics.focus_distance_m == pytest.approx(-8.6043, abs=0.005)
    disparity, depth = read_pfm(folder / "gt_disp_lowres.pfm"), read_pfm(folder / "gt_depth_lowres.pfm")
    assert light_field.depth_range_m is not None
    assert light_field.depth_range_m[0] <= depth.min()
    assert depth.max() <= light_field.depth_range_m[1]
    for row, col in ((3, 6), (3, 0), (0, 3), (6, 3)):
        right, wrong = (warp_error(light_field, sign * disparity, row, col) for sign in (1, -1))
        assert right < 1.0 < 4.0 < wrong


def test_illum_2067_is_found_by_its_numbers(shared_data: Path, tmp_path: Path) -> None:
    folder = shared_data / "lytro_illum_2067"
    light_field = open_light_field(folder)
    assert light_field.views.shape == (7, 7, 383, 552, 3)
    ingested = ingest(tmp_path / "s", [folder, folder / "2067_05_05.png"])
    assert [(c.kind, c.format) for c in ingested] == [("light_field", "sai"), ("photo", "photo")]
    store = SessionStore.open(tmp_path / "s")
    assert np.array_equal(store.load_light_field("000").views, light_field.views)
    assert np.array_equal(store.load_photo("001").image, light_field.centre_view)
    kept = (store.capture_folder("000") / "views" / "00_00.png").read_bytes()
    assert kept == (folder / "2067_02_02.png").read_bytes()
