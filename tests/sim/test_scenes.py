"""The scene library: two halves that share nothing, complete depth from everywhere, and what each scene promises."""

from __future__ import annotations

import numpy as np
import pytest

from lfrig.contracts.errors import BadInput
from lfrig.sim import scenes
from lfrig.sim.optics import SimCamera
from lfrig.sim.renderer import render_depth
from lfrig.sim.rig import RIG_DEPTH_RANGE_M, SimulatedRig
from lfrig.sim.scene import Kind, Scene, pack
from lfrig.sim.scenes import (
    REPORTING,
    REPORTING_OPTICS,
    SCENES,
    TUNING,
    TUNING_OPTICS,
    SceneBuilder,
    build_scene,
    optics_of,
)
from tests.sim.small import CENTRE, without_textures

ANGLES_DEG = (-35.0, 0.0, 15.0, 30.0, 45.0, 60.0)


def bare(name: str, monkeypatch: pytest.MonkeyPatch) -> Scene:
    """A scene's geometry."""
    without_textures(monkeypatch)
    return build_scene(name, 0)


def test_halves_are_disjoint_and_large_enough() -> None:
    assert len(TUNING) >= 7
    assert len(REPORTING) >= 7
    assert not set(TUNING) & set(REPORTING)
    assert not {b.__module__ for b in TUNING.values()} & {b.__module__ for b in REPORTING.values()}


def test_halves_share_no_texture(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = without_textures(monkeypatch)
    used = []
    for half in (TUNING, REPORTING):
        asked.clear()
        for name in half:
            build_scene(name, 0)
        used.append(set(map(repr, asked)))
        assert len(used[-1]) > 20
    assert not used[0] & used[1]


def test_halves_are_shot_with_different_optics() -> None:
    assert TUNING_OPTICS != REPORTING_OPTICS
    assert {optics_of(name) for name in TUNING} == {TUNING_OPTICS}
    assert {optics_of(name) for name in REPORTING} == {REPORTING_OPTICS}


@pytest.mark.parametrize("name", SCENES)
def test_every_pixel_has_a_depth_within_the_rigs_range(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    packed = pack(bare(name, monkeypatch))
    rig = SimulatedRig(name, 54, 38)
    near, far = RIG_DEPTH_RANGE_M
    widest, narrowest = optics_of(name).zoom_mm
    for angle in ANGLES_DEG:
        for mount in (rig.light_field_camera(0, angle), rig.target_camera(angle)):
            for zoom in (widest, narrowest):
                camera = SimCamera(
                    mount.width, mount.height, zoom * 50 * mount.width / 541, mount.baseline_m, mount.focus_m,
                    mount.rotation, mount.translation,
                )  # fmt: skip
                depth = render_depth(packed, camera, np.array([[0.0, 0.0], [3.0, -3.0], [-3.0, 3.0]]))
                assert np.isfinite(depth).all()
                assert near < depth.min()
                assert depth.max() < far


@pytest.mark.parametrize("name", sorted(set(SCENES) - {"poster", "mural"}))
def test_scenes_are_deep(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = SimulatedRig(name, 54, 38).light_field_camera(0, 20.0)
    depth = render_depth(pack(bare(name, monkeypatch)), camera, CENTRE)
    assert 1 / depth.min() - 1 / depth.max() > 0.9


def test_some_scenes_are_nearly_one_plane(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("poster", "mural"):
        camera = SimulatedRig(name, 54, 38).light_field_camera(0, 20.0)
        depth = render_depth(pack(bare(name, monkeypatch)), camera, CENTRE)[0].astype(float)
        ys, xs = np.mgrid[: depth.shape[0], : depth.shape[1]]
        basis = np.stack([xs.ravel(), ys.ravel(), np.ones(depth.size)], 1)
        # Planes are affine in inverse depth; the best plane must hold for most pixels.
        w, keep = 1 / depth.ravel(), np.ones(depth.size, bool)
        for _ in range(10):
            plane = basis @ np.linalg.lstsq(basis[keep], w[keep], rcond=None)[0]
            keep = np.abs(w - plane) < max(0.01, float(np.median(np.abs(w - plane))))
        assert (np.abs(w - plane) < 0.02).mean() > 0.5


@pytest.mark.parametrize("name", ["reeds", "fence"])
def test_thin_structures_are_three_to_eight_pixels_wide(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = bare(name, monkeypatch)
    camera = SimulatedRig(name, 541, 376).light_field_camera(0, 20.0)
    rods = [p for p in scene.primitives if p.kind is Kind.CYLINDER and p.size[0] < 0.002]
    depths = [(camera.rotation @ np.array(p.position) + camera.translation)[2] for p in rods]
    widths = [2 * p.size[0] * camera.focal_px / z for p, z in zip(rods, depths, strict=True)]
    assert len(rods) >= 15
    assert min(widths) > 2.5
    assert max(widths) < 9


@pytest.mark.parametrize("name", ["marbles", "glaze"])
def test_glossy_scenes_are_glossy(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert sum(p.material.specular >= 1 for p in bare(name, monkeypatch).primitives) >= 5


def test_seed_moves_what_stands_at_random(monkeypatch: pytest.MonkeyPatch) -> None:
    without_textures(monkeypatch)
    first, again, other = (build_scene("reeds", seed) for seed in (0, 0, 1))
    places = [[p.position for p in scene.primitives] for scene in (first, again, other)]
    assert places[0] == places[1]
    assert places[0] != places[2]


def test_unknown_scene_names_the_known_ones() -> None:
    with pytest.raises(BadInput, match="tabletop"):
        build_scene("nowhere")


def test_new_scenes_change_no_older_one(monkeypatch: pytest.MonkeyPatch) -> None:
    seeds: dict[str, int] = {}

    def builder(name: str) -> SceneBuilder:
        def build(seed: int) -> Scene:
            seeds[name] = seed
            return Scene(name, [])

        return build

    monkeypatch.setattr(scenes, "SCENES", {name: builder(name) for name in SCENES})
    for name in SCENES:
        build_scene(name)
    assert [seeds[name] for name in ("tabletop", "desk", "mural")] == [0, 450, 850]
    assert len(set(seeds.values())) == len(SCENES)
