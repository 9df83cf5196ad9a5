"""Whether the solved geometry is what the pictures show: patches of every source, carried by its own depth into the
other pictures, must look alike there.

The pose stage is judged by what it was made from; this check is not. A capture at the wrong place, or a photo of
something else, finds its patches nowhere, however small the residuals of the matches that were kept (those may be a
few that happen to fit). The share of patches that are found names the picture that does not belong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.errors import GeometryRefused
from lfrig.contracts.progress import Monitor
from lfrig.processing.geometry import project, projection
from lfrig.processing.kernels.correlation import shifted_correlations
from lfrig.processing.model import F32, F64, U8, Camera, Photo, Pose, Source
from lfrig.processing.patch import patch_window
from lfrig.processing.tone import NO_TEXTURE_GREY

if TYPE_CHECKING:
    from lfrig.processing.poses.work import PoseWork

MAX_PATCHES = 300
MIN_PATCHES = 24
"""With fewer textured patches in common two pictures are not judged."""

RADIUS = 5
BLUR_PX = 1.2
"""At `WIDTH` px: the geometry may be a pixel or two off and patches still look alike."""

WIDTH = 541
MIN_CONFIDENCE = 0.4
ALIKE = 0.5
"""Zero-mean normalised cross-correlation from which patches are the same."""

ASIDE_PX, MIN_ASIDE_PX = 12.0, 8.0
"""At `WIDTH` px, and at least (patches have one size in small pictures too): where patches are compared again, in eight
directions, to see how many look alike by chance."""

REFUSE_ADVANTAGE, REFUSE_SHARE = 0.03, 0.3
HALF_ADVANTAGE = 0.0
"""Of the worse half, near or far: a wall or a floor that repeats may fit at a wrong place; what stands before it does
not. Not enough to refuse by: columns and glossy patterns come down to 0.01 where everything is right."""

TIED_ADVANTAGE, TIED_SHARE = 0.1, 0.3
"""Of the worse half, from either of which two pictures are tied by what is near *and* what is far. On the tuning
scenes, nearest neighbours at right places have advantages of 0.13 to 0.5 (among equal columns 0, and a share of 0.34),
pictures that have only a wall in common, at the wrong one of its periods, −0.15 to 0.06 and shares up to 0.26."""

DOUBTFUL_ADVANTAGE, DOUBTFUL_SHARE = 0.08, 0.5
"""On the tuning scenes, best partner of a capture: right geometry has an advantage of 0.24 to 0.75 (0.11 for a glossy
pattern that repeats, seen by two sources 35° apart), wrong one −0.05 to 0.02 and a share below 0.25."""


PHOTO_ADVANTAGE, PHOTO_PART = 0.15, 0.5
"""Of the photo's worse half, and that as a part of what sources have among themselves (their median). On the tuning
scenes a photo in its place has 0.9 to 1.7 times the sources' advantage, one from behind, held by a table and a backdrop
that look the same from there, 0.23 times."""


@dataclass(frozen=True)
class Agreement:
    """Of source i's patches in source j, or in the photo (last column): ``share`` float64 [N, N + 1] that are found
    where they should be, and its ``advantage`` over the best of eight places aside. NaN where too few are in view.
    ``half`` is the same for whichever half of the patches, the nearer or the farther, does worse.
    """

    share: F64
    advantage: F64
    half: Agreement | None = None

    def of_photo(self) -> tuple[float, float]:
        """Share and advantage with the source that fits the photo best; NaN when no source has enough to tell."""
        return self._best(np.s_[:, -1:])

    def of_source(self, index: int) -> tuple[float, float]:
        """The same with whichever other source fits best, in either direction."""
        rows, cols = self._best(np.s_[index, :-1]), self._best(np.s_[:, index])
        return max((rows, cols), key=lambda found: np.nan_to_num(found[1], nan=-np.inf))

    def standing(self, index: int) -> tuple[float, float]:
        """What speaks for a source: its advantage among the sources, then with the photo; unknown counts as much."""
        return (
            float(np.nan_to_num(self.of_source(index)[1], nan=1.0)),
            float(np.nan_to_num(self.advantage[index, -1], nan=1.0)),
        )

    def groups(self) -> list[list[int]]:
        """Sources that hang together, the photo between them included; one that cannot be judged hangs with all."""
        count = len(self.advantage)
        linked = (self.advantage >= DOUBTFUL_ADVANTAGE) | (self.share >= DOUBTFUL_SHARE)
        rows = {tuple(v for v in group if v < count) for group in self._joined(linked)}
        return [list(group) for group in sorted(rows) if group]

    def tied_groups(self) -> list[list[int]]:
        """Pictures (the photo is N) that near and far things alike tie together, whatever their other ties say."""
        return self._joined(self._tied())

    def ties_photo(self) -> bool:
        """Whether some source is tied to the photo, near and far alike."""
        return bool(self._tied()[:, -1].any())

    def _tied(self) -> NDArray[np.bool_]:
        half = self.half or self
        return np.asarray((half.advantage >= TIED_ADVANTAGE) | (half.share >= TIED_SHARE), np.bool_)

    def _joined(self, linked: NDArray[np.bool_]) -> list[list[int]]:
        """Connected pictures by links [N, N + 1]; a source that cannot be judged is linked to all."""
        count = len(linked)
        table = np.eye(count + 1, dtype=bool)
        table[:count] |= linked
        table[:count][~np.isfinite(self.advantage).any(1)] = True
        table |= table.T
        for _ in range(count):
            table = (table.astype(np.int64) @ table) > 0
        return [list(group) for group in sorted({tuple(np.flatnonzero(row).tolist()) for row in table})]

    def _best(self, part: Any) -> tuple[float, float]:
        share, advantage = self.share[part].ravel(), self.advantage[part].ravel()
        if not np.isfinite(advantage).any():
            return float("nan"), float("nan")
        best = int(np.nanargmax(advantage))
        return float(share[best]), float(advantage[best])


def measure_agreement(
    sources: Sequence[Source], photo: Photo, camera: Camera, pose: Pose, work: PoseWork | None = None
) -> Agreement:
    """Compare the patches of every source with every other picture; ``work`` remembers what was compared, as long as
    the two stand as they stood.
    """
    from lfrig.processing.poses.work import PoseWork  # the pose stage asks this module, too

    work = PoseWork() if work is None else work
    held = [*(s.light_field.views for s in sources), photo.image]
    pictures = [
        work.once("agreement", (s.light_field.views,), partial(_prepared, s.light_field.centre_view, s.camera.width))
        for s in sources
    ]
    pictures.append(_prepared(photo.image8, camera.width))
    places = [*((s.camera, s.pose) for s in sources), (camera, pose)]
    plain = [float(picture.std()) < NO_TEXTURE_GREY for picture in pictures]
    found = np.full((4, len(sources), len(sources) + 1), np.nan)
    for i, source in enumerate(sources):
        known = held[i], source.evidence.confidence
        patches = work.once("patches", known, partial(_patches, source, pictures[i]))
        for j, there in enumerate(places):
            if j != i and not plain[j]:
                compare = partial(_compare, source, patches, pictures[i], there, pictures[j])
                found[:, i, j] = work.once(f"agree {_standing(source, there)}", (*known, held[j]), compare)
    return Agreement(found[0], found[1], Agreement(found[2], found[3]))


def _standing(source: Source, there: tuple[Camera, Pose]) -> str:
    """Where the corners of a source lie in another picture, near and far, to a pixel: text that is equal as long as
    nothing moved by more than patches would notice.
    """
    camera, disparity = source.camera, source.evidence.disparity
    w = source.scale.inverse_depth(np.array([disparity.min(), disparity.max()], np.float32))
    x, y = (np.array([0, side - 1], np.float32) for side in (camera.width, camera.height))
    xs, ys, ws = (np.asarray(a, np.float32) for a in np.meshgrid(x, y, w))
    u, v, _ = project(*projection(camera, source.pose, *there), xs, ys, ws)
    return " ".join(f"{place:.0f}" for place in np.r_[u.ravel(), v.ravel()])


def check_agreement(
    sources: Sequence[Source],
    photo: Photo,
    camera: Camera,
    pose: Pose,
    monitor: Monitor,
    work: PoseWork | None = None,
) -> Agreement:
    """Measure, and act on it; ``work`` as for `measure_agreement`.

    Raises
    ------
    GeometryRefused
        A source whose patches are in no other source, or a photo that has none of any source's.
    """
    agreement = measure_agreement(sources, photo, camera, pose, work)
    half = agreement.half or agreement
    names = [source.light_field.id for source in sources]
    # Of two captures that contradict each other, the one that the photo contradicts too is named.
    for k in sorted(range(len(names)), key=agreement.standing):
        _judge(
            agreement.of_source(k), half.of_source(k), f"capture {names[k]}", "any other capture", monitor,
            code="capture-disagrees",
            remedy="check its angle or pose and that nothing on the plate moved, or leave it out with --sources",
        )  # fmt: skip
    doubted = _judge(
        agreement.of_photo(), half.of_photo(), f"photo {photo.id}", "any source", monitor, code="photo-disagrees",
        remedy="take the photo of the same scene from between the sources, and check its pose if one is recorded",
    )  # fmt: skip
    if not doubted:
        _doubt_photo(half, f"photo {photo.id}", monitor)
    groups = agreement.groups()
    if len(groups) > 1:
        listed = " and ".join(", ".join(names[k] for k in group) for group in groups)
        monitor.warn(
            "pose-doubtful",
            f"captures {listed} agree among themselves but not with each other; check their angles or poses, or add a "
            "capture between them",
        )
    return agreement


def _doubt_photo(half: Agreement, who: str, monitor: Monitor) -> None:
    """Doubt a photo that fits the sources far worse, near or far, than they fit each other."""
    share, advantage = half.of_photo()
    among = [half.of_source(k)[1] for k in range(len(half.share))]
    usual = float(np.nanmedian(among)) if np.isfinite(among).any() else float("nan")
    if advantage < min(PHOTO_ADVANTAGE, PHOTO_PART * usual):
        monitor.warn(
            "pose-doubtful",
            f"{who}: {share:.0%} of the near or of the far patches look alike where its pose puts them, "
            f"{advantage:+.0%} against places aside; captures among each other have {usual:+.0%}. Check that it was "
            "taken from between them (what repeats around the plate looks the same from behind)",
        )


def _judge(
    whole: tuple[float, float],
    half: tuple[float, float],
    who: str,
    others: str,
    monitor: Monitor,
    *,
    code: str,
    remedy: str,
) -> bool:
    """Refuse what is found no better than by chance; doubt what is found hardly better, or in one half only. Returns
    whether it was doubted.
    """
    share, advantage = whole
    said = f"{who}: {share:.0%} of the patches that it should share with {others} look alike where the poses put them"
    if advantage < REFUSE_ADVANTAGE and share < REFUSE_SHARE:
        raise GeometryRefused(f"{said}, no more than anywhere else", code=code, remedy=remedy)
    hint = "check its pose (shiny or repeating things may also be the reason)"
    if advantage < DOUBTFUL_ADVANTAGE and share < DOUBTFUL_SHARE:
        monitor.warn("pose-doubtful", f"{said}, hardly more than elsewhere; {hint}")
    elif half[1] < HALF_ADVANTAGE and half[0] < REFUSE_SHARE:
        monitor.warn("pose-doubtful", f"{said}, but only the near or only the far ones; {hint}")
    else:
        return False
    return True


def _prepared(picture: U8, width: int) -> F32:
    """Grey picture float32 [H, W], blurred in proportion to its size."""
    import cv2

    grey = cv2.cvtColor(np.ascontiguousarray(picture), cv2.COLOR_RGB2GRAY).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), max(0.6, BLUR_PX * width / WIDTH)), np.float32)


def _patches(source: Source, grey: F32) -> F32:
    """Pixels of textured patches whose depth is known, float32 [N, P, 2] (x, y)."""
    import cv2

    sure = (source.evidence.confidence > MIN_CONFIDENCE).astype(np.uint8)
    sure[: RADIUS + 1] = sure[-RADIUS - 1 :] = 0
    sure[:, : RADIUS + 1] = sure[:, -RADIUS - 1 :] = 0
    corners = cv2.goodFeaturesToTrack(grey, MAX_PATCHES, 0.01, 2.0 * RADIUS, mask=sure, blockSize=7)
    if corners is None:
        return np.zeros((0, 1, 2), np.float32)
    return np.asarray(np.rint(corners) + patch_window(RADIUS), np.float32)


def _compare(
    source: Source, patches: F32, grey: F32, there: tuple[Camera, Pose], picture: F32
) -> tuple[float, float, float, float]:
    """Of the patches in view of another picture: the share that look alike there and its advantage over places aside;
    and both for the half, near or far, that does worse.
    """
    xs, ys = patches[..., 0], patches[..., 1]
    rows, columns = ys.astype(np.intp), xs.astype(np.intp)
    inverse = source.scale.inverse_depth(source.evidence.disparity[rows, columns])
    u, v, _ = project(*projection(source.camera, source.pose, *there), xs, ys, inverse)
    height, width = picture.shape
    with np.errstate(invalid="ignore"):
        inside = ((u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)).all(1)
    if inside.sum() < MIN_PATCHES:
        return (float("nan"),) * 4
    turns = np.arange(8) * (np.pi / 4)
    aside = max(ASIDE_PX * width / WIDTH, MIN_ASIDE_PX) * np.c_[np.cos(turns), np.sin(turns)]
    here = grey[rows[inside], columns[inside]]
    places = np.broadcast_to(np.r_[np.zeros((1, 2)), aside][:, None], (9, len(here), 2))
    alike = shifted_correlations(here, picture, u[inside], v[inside], places, threads=1) > ALIKE
    depth = inverse[inside].mean(1)
    near = depth > np.median(depth)
    whole = _verdict(alike)
    halves = [_verdict(alike[:, part]) for part in (near, ~near) if 2 * part.sum() >= MIN_PATCHES]
    return *whole, *min(halves, key=lambda half: half[1], default=whole)


def _verdict(alike: NDArray[np.bool_]) -> tuple[float, float]:
    """Share and advantage of patches [9, N] compared in their places and in eight aside."""
    share = alike.mean(1)
    return float(share[0]), float(share[0] - share[1:].max())
