"""What goes wrong on a rig, put into a good case of five captures: the list that the gate of the pose stage must catch.

Every fault says which captures are to blame, and leaves the truth of the others as it was.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lfrig.bench.poses_priors import PoseCase, draw_case
from lfrig.bench.poses_scene import PhotoShot, SceneShots
from lfrig.bench.poses_wall import photo_with_still_wall, wall_texture, with_still_wall
from lfrig.processing.model import U8
from lfrig.sim.rig import FULL_WIDTH
from lfrig.sim.tone import add_noise

STEPS_DEG = (0.0, 15.0, 30.0, 45.0, 60.0)
PHOTO_DEG = 25.0
BEHIND_DEG = 200.0
"""Plate angle at which the photo shows the other side of everything."""

BLUR_PX = 3.0
"""Of the defocused capture, at full width."""

FOCAL_ERROR = 0.15
SECOND_SHOT_NOISE = 1.0


@dataclass(frozen=True, eq=False)
class Subject:
    """What a fault is put into: the good case, its captures, how to take more, and another scene's photo."""

    case: PoseCase
    shots: SceneShots
    seed: int
    stranger: Callable[[], PhotoShot]


@dataclass(frozen=True)
class Fault:
    """``culprits`` are the captures that a message must name (empty: all of them are to blame)."""

    key: str
    title: str
    culprits: tuple[str, ...]
    put: Callable[[Subject], PoseCase]


def _source(case: PoseCase, index: int, **changes: object) -> PoseCase:
    """The case with something else recorded in one source."""
    sources = list(case.sources)
    sources[index] = replace(sources[index], **changes)  # type: ignore[arg-type]
    return replace(case, sources=sources)


def _angles(case: PoseCase, change: Callable[[int, float], float]) -> PoseCase:
    sources = [replace(s, turntable_deg=change(k, s.turntable_deg or 0.0)) for k, s in enumerate(case.sources)]
    return replace(case, sources=sources)


def swapped(first: int, second: int) -> Callable[[Subject], PoseCase]:
    """Two captures carry each other's angle."""

    def put(subject: Subject) -> PoseCase:
        said = [source.turntable_deg or 0.0 for source in subject.case.sources]
        said[first], said[second] = said[second], said[first]
        return _angles(subject.case, lambda k, _: said[k])

    return put


def angle_off(capture: int, error_deg: float) -> Callable[[Subject], PoseCase]:
    """One angle is wrong."""
    return lambda subject: _angles(subject.case, lambda k, said: said + (error_deg if k == capture else 0.0))


def stretched(factor: float) -> Callable[[Subject], PoseCase]:
    """All angles are wrong by a factor: the steps per degree, or the direction."""
    return lambda subject: _angles(subject.case, lambda _, said: factor * said)


def shot_twice(capture: int, again: int) -> Callable[[Subject], PoseCase]:
    """The plate did not turn before ``again``: it shows what ``capture`` shows."""

    def put(subject: Subject) -> PoseCase:
        shot = subject.case.shots[capture]
        views = add_noise(shot.views, SECOND_SHOT_NOISE, [subject.seed, 7])
        shots = list(subject.case.shots)
        shots[again] = replace(shot, views=views)
        camera = subject.case.sources[capture].camera
        return replace(_source(subject.case, again, views=views, camera=camera), shots=shots)

    return put


def focal_off(capture: int) -> Callable[[Subject], PoseCase]:
    """One focal length is recorded far from what it was."""

    def put(subject: Subject) -> PoseCase:
        camera = subject.case.sources[capture].camera
        assert camera is not None
        return _source(subject.case, capture, camera=replace(camera, focal_px=camera.focal_px * (1 + FOCAL_ERROR)))

    return put


def defocused(capture: int) -> Callable[[Subject], PoseCase]:
    """All views of one capture are blurred."""

    def put(subject: Subject) -> PoseCase:
        shot = subject.case.shots[capture]
        blurred = shot.reseen(blur(shot.views, BLUR_PX * shot.views.shape[3] / FULL_WIDTH), subject.shots.threads)
        shots = [blurred if k == capture else s for k, s in enumerate(subject.case.shots)]
        return replace(_source(subject.case, capture, views=blurred.views), shots=shots)

    return put


def still_wall(subject: Subject) -> PoseCase:
    """A textured wall stands still behind the turning plate."""
    texture = wall_texture(subject.seed)
    shots = [with_still_wall(subject.shots, angle, texture) for angle in STEPS_DEG]
    photo = photo_with_still_wall(subject.shots, PHOTO_DEG, texture)
    sources = [replace(s, views=shot.views) for s, shot in zip(subject.case.sources, shots, strict=True)]
    return replace(
        subject.case, sources=sources, shots=shots, photo=photo, target=replace(subject.case.target, image=photo.image)
    )


def another_scene(expected: bool) -> Callable[[Subject], PoseCase]:
    """The photo shows another scene; ``expected``: the rig says where it was taken."""

    def put(subject: Subject) -> PoseCase:
        drawn = draw_case(subject.case.shots, subject.stranger(), subject.seed, photo_expected=expected)
        return replace(drawn, photo=None)

    return put


def from_behind(expected: bool) -> Callable[[Subject], PoseCase]:
    """The photo shows the side of the scene that no source sees."""
    return lambda subject: draw_case(
        subject.case.shots, subject.shots.photo(BEHIND_DEG), subject.seed, photo_expected=expected
    )


def blur(views: U8, sigma_px: float) -> U8:
    """Gaussian blur of every view of [rows, cols, H, W, 3]."""
    import cv2

    out = np.empty_like(views)
    for row, col in np.ndindex(views.shape[:2]):
        out[row, col] = cv2.GaussianBlur(views[row, col], (0, 0), sigma_px)
    return out


FAULTS: Sequence[Fault] = (
    Fault("swapped", "two captures 30° apart swapped", ("001", "003"), swapped(1, 3)),
    Fault("swapped-next", "two neighbours swapped", ("001", "002"), swapped(1, 2)),
    Fault("angle-3", "one angle wrong by 3°", ("001",), angle_off(1, 3.0)),
    Fault("angle-6", "one angle wrong by 6°", ("001",), angle_off(1, 6.0)),
    Fault("angle-12", "one angle wrong by 12°", ("001",), angle_off(1, 12.0)),
    Fault("angle-end", "the last angle wrong by 12°", ("004",), angle_off(4, 12.0)),
    Fault("stretched", "all angles × 1.3", (), stretched(1.3)),
    Fault("reversed", "all angles of the wrong sign", (), stretched(-1.0)),
    Fault("twice", "the plate did not turn: one view shot twice", ("002", "003"), shot_twice(2, 3)),
    Fault("focal", "one focal length + 15 %", ("001",), focal_off(1)),
    Fault("defocused", "one capture out of focus", ("001",), defocused(1)),
    Fault("wall", "a textured wall stands still", (), still_wall),
    Fault("stranger", "photo of another scene", ("photo",), another_scene(False)),
    Fault("stranger-expected", "photo of another scene, its pose recorded", ("photo",), another_scene(True)),
    Fault("behind", "photo from behind", ("photo",), from_behind(False)),
    Fault("behind-expected", "photo from behind, its pose recorded", ("photo",), from_behind(True)),
)


def good_case(shots: SceneShots, seed: int) -> PoseCase:
    """Five captures at 15° and a photo among them, as a careful operator shoots them."""
    return draw_case([shots.light_field(angle) for angle in STEPS_DEG], shots.photo(PHOTO_DEG), seed)
