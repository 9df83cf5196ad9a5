"""The scene library. ``TUNING`` scenes may be looked at while parameters are chosen; results are reported on
``REPORTING`` ones, which share no object, texture or optics with them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from lfrig.contracts.errors import BadInput
from lfrig.sim.scene import Scene
from lfrig.sim.scenes import reporting, tuning

SceneBuilder = Callable[[int], Scene]


@dataclass(frozen=True)
class RigOptics:
    """What a half of the library is shot with: ranges that each capture draws from.

    Focal lengths [mm] as engraved on the lens (sensor 10.8 mm wide), focus distances [m], elevation of the
    light-field camera above the table [deg], its distance from the axis [m].
    """

    zoom_mm: tuple[float, float]
    focus_m: tuple[float, float]
    elevation_deg: tuple[float, float]
    distance_m: tuple[float, float]
    target_mm: tuple[float, float]


TUNING_OPTICS = RigOptics((18.0, 22.5), (0.42, 0.54), (25.0, 29.0), (0.445, 0.46), (24.0, 25.5))
REPORTING_OPTICS = RigOptics((18.5, 24.0), (0.40, 0.56), (21.0, 26.0), (0.44, 0.455), (24.5, 26.0))


def _named(*builders: SceneBuilder) -> Mapping[str, SceneBuilder]:
    return {b.__name__: b for b in builders}


TUNING = _named(
    tuning.tabletop, tuning.chequered, tuning.plaster, tuning.reeds, tuning.marbles, tuning.colonnade, tuning.blocks,
    tuning.lanterns, tuning.poster, tuning.atelier,
)  # fmt: skip
REPORTING = _named(
    reporting.desk, reporting.masonry, reporting.studio, reporting.fence, reporting.glaze, reporting.shelf,
    reporting.figurines, reporting.snowfield, reporting.mural,
)  # fmt: skip
SCENES: Mapping[str, SceneBuilder] = {**TUNING, **REPORTING}

LATER = ("atelier",)
"""Scenes that joined the library after the others, in that order: numbered last, so that a new scene changes no
texture of an older one, nor any result that was reported on it."""


def build_scene(name: str, seed: int = 0) -> Scene:
    """The scene ``name``; the seed varies its textures and what stands at random.

    Raises
    ------
    BadInput
        There is no such scene.
    """
    check_scene_name(name)
    # Far apart, so that textures of one scene's neighbouring seeds do not meet those of another.
    return SCENES[name](1000 * seed + 50 * _number(name))


def _number(name: str) -> int:
    """The scene's place in the order in which scenes joined the library."""
    return [*(n for n in SCENES if n not in LATER), *LATER].index(name)


def check_scene_name(name: str) -> None:
    """Raise `BadInput` when there is no such scene."""
    if name not in SCENES:
        raise BadInput(
            f"there is no simulated scene {name!r}",
            field="scene",
            code="unknown-scene",
            remedy=f"one of: {', '.join(SCENES)}",
        )


def optics_of(name: str) -> RigOptics:
    """The optics of the half that the scene belongs to."""
    return TUNING_OPTICS if name in TUNING else REPORTING_OPTICS
