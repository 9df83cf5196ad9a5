"""A raw light field as it comes from file and calibration: sensor values, white image, hot pixels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lfrig.contracts.errors import BadInput
from lfrig.contracts.progress import Monitor
from lfrig.processing.lenslet.calibration import I32, Calibration, Match, WhiteImage, parse_hot_pixels, white_image
from lfrig.processing.lenslet.container import Container, read_container
from lfrig.processing.lenslet.contents import Frame, missing, part, raw_frame
from lfrig.processing.lenslet.metadata import RawMetadata, parse_metadata, read_metadata
from lfrig.processing.lenslet.unpack import U16, check_size, held_values, unpack, unpack_partial

__all__ = ["RawCapture", "WhiteImage", "read_raw"]

IMAGE_FIELD = "imageRef"
WHITE_FIELD = "modulationDataRef"
HOT_PIXELS_FIELD = "hotPixelRef"
MIN_PARTIAL_SHARE = 1 / 16
"""Of the sensor values a torn file must hold to be worth reading, which also bounds memory by the file's size."""


@dataclass(frozen=True, eq=False)
class RawCapture:
    """A raw light field.

    ``sensor`` is uint16 [Hs, Ws] as recorded. ``white`` was chosen by ``rule``: ``"exact"``, ``"nearest"`` (zoom, then
    focus, of the same camera), ``"embedded"`` (in the shot's own file), or ``"none"`` with no white image at all.
    ``zoom_steps`` and ``focus_steps`` say how far from the shot's it was taken. ``hot_pixels`` is int32 [N, 2]
    (x, y). ``problems`` names what a partial read left out and what of the calibration could not be used.
    """

    path: Path
    metadata: RawMetadata
    sensor: U16
    white: WhiteImage | None
    rule: str
    hot_pixels: I32
    zoom_steps: int | None = None
    focus_steps: int | None = None
    problems: tuple[str, ...] = ()


def read_raw(
    path: Path | str, *, calibration: Path | str | None = None, partial: bool = False, monitor: Monitor | None = None
) -> RawCapture:
    """Read a shot and the white image that fits it best.

    Parameters
    ----------
    path : Path
        .lfr or .lfp file.
    calibration : Path, optional
        Calibration archive (tar, folder, or one white image's .RAW).
    partial : bool
        Take what is whole of a torn file; missing sensor values are 0, and `RawCapture.problems` says so.
    monitor : Monitor, optional
        Warned with code ``white-image-not-exact`` or ``no-white-image``, ``calibration-ignored`` (parts of it that
        cannot be used), ``bad-hot-pixels``, ``partial-file``.

    Raises
    ------
    BadInput
        Whatever is wrong with the file or with the calibration as a whole; a single white image or list of hot
        pixels that cannot be used is passed over with a warning.
    """
    monitor = monitor or Monitor()
    container = read_container(path, partial=partial)
    known = Calibration.open(calibration) if calibration is not None else None
    monitor.advance(0)
    return assemble(container, known, monitor)


def assemble(container: Container, known: Calibration | None, monitor: Monitor) -> RawCapture:
    """`read_raw` of what was opened already; a container opened with ``partial`` is read as far as it goes."""
    frame = raw_frame(container)
    metadata = read_metadata(container, frame)
    sensor = _sensor(container, frame, metadata)
    monitor.advance(0)
    problems: list[str] = []
    white, match = _white(container, frame, metadata, known, problems)
    rule = match.rule if match else "embedded" if white else "none"
    _warn_of_rule(container.path, metadata, known, white, match, monitor)
    if problems:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        monitor.warn("calibration-ignored", f"{problems[0]}{more}")
    hot_pixels = _hot_pixels(container, frame, metadata, known, monitor)
    if container.problems:
        monitor.warn("partial-file", f"{container.path}: {'; '.join(container.problems)}")
    return RawCapture(
        container.path, metadata, sensor, white, rule, hot_pixels, match.zoom_steps if match else None,
        match.focus_steps if match else None, (*container.problems, *problems),
    )  # fmt: skip


def check_payload(container: Container, frame: Frame, metadata: RawMetadata) -> None:
    """Raise `BadInput` where the sensor's bytes are missing or not as many as the metadata need; unpacks nothing."""
    section = container.find(frame.image_ref)
    if section is None:
        raise missing(container.path, IMAGE_FIELD)
    check_size(section.length, metadata, container.path, IMAGE_FIELD)


def _sensor(container: Container, frame: Frame, metadata: RawMetadata) -> U16:
    section = container.find(frame.image_ref)
    if section is None:
        raise missing(container.path, IMAGE_FIELD)
    payload = container.data(section)
    if not container.partial:
        return unpack(payload, metadata, container.path, IMAGE_FIELD)
    count, held = metadata.width * metadata.height, held_values(len(payload), metadata)
    if held < MIN_PARTIAL_SHARE * count:
        raise BadInput(
            f"holds {held} of {count} sensor values", path=container.path, field=IMAGE_FIELD, code="truncated",
            remedy="copy the file from the camera again",
        )  # fmt: skip
    if held < count:
        rows = metadata.height - held // metadata.width
        container.problems.append(f"{IMAGE_FIELD}: the last {rows} of {metadata.height} rows are missing")
    return unpack_partial(payload, metadata)


def _white(
    container: Container, frame: Frame, shot: RawMetadata, known: Calibration | None, problems: list[str]
) -> tuple[WhiteImage | None, Match | None]:
    """The best white image that can be read; None without a match: it is the shot's own, or there is none."""
    if known is not None:
        problems += known.problems
        for match in known.matches(shot):
            try:
                return known.load(match.entry), match
            except BadInput as error:
                problems.append(error.message)
    if frame.modulation_ref is None:
        return None, None
    try:
        return _embedded(container, frame, shot), None
    except BadInput as error:
        problems.append(error.message)
        return None, None


def _embedded(container: Container, frame: Frame, shot: RawMetadata) -> WhiteImage:
    metadata = shot
    described = container.find(frame.modulation_metadata_ref)
    if described is not None:
        metadata = parse_metadata(container.json(described), {}, container.path)
        if (metadata.width, metadata.height) != (shot.width, shot.height):
            raise BadInput(
                f"is {metadata.width}×{metadata.height} px, the shot {shot.width}×{shot.height}", path=container.path,
                field=WHITE_FIELD, code="wrong-size", remedy="give --calibration",
            )  # fmt: skip
    payload = part(container, frame.modulation_ref, WHITE_FIELD)
    return white_image(payload, metadata, container.path, WHITE_FIELD, WHITE_FIELD)


def _hot_pixels(
    container: Container, frame: Frame, shot: RawMetadata, known: Calibration | None, monitor: Monitor
) -> I32:
    """The calibration's list, else the file's own; one that cannot be used is passed over."""
    try:
        found = known.hot_pixels(shot) if known is not None else np.empty((0, 2), np.int32)
        if not len(found) and container.find(frame.hot_pixel_ref) is not None:
            payload = part(container, frame.hot_pixel_ref, HOT_PIXELS_FIELD)
            found = parse_hot_pixels(payload, shot, container.path, HOT_PIXELS_FIELD)
    except BadInput as error:
        monitor.warn("bad-hot-pixels", f"{error.message}; hot pixels are not corrected")
        return np.empty((0, 2), np.int32)
    return found


def _warn_of_rule(
    path: Path, shot: RawMetadata, known: Calibration | None, white: WhiteImage | None, match: Match | None,
    monitor: Monitor,
) -> None:  # fmt: skip
    told = notice_of_rule(shot, known, match, embedded=white is not None and match is None)
    if told is not None:
        monitor.warn(told[0], f"{path}: {told[1]}")


def notice_of_rule(
    shot: RawMetadata, known: Calibration | None, match: Match | None, *, embedded: bool
) -> tuple[str, str] | None:
    """(code, message) that says which white image serves a shot when it is not the exact one; else None."""
    if match is not None:
        if match.rule == "exact" or match.zoom_steps == match.focus_steps == 0:
            return None
        distance = f"zoom {_steps(match.zoom_steps)}, focus {_steps(match.focus_steps)}"
        message = f"no white image is exactly this shot's; the camera's nearest is used: {match.entry.name}, {distance}"
        return "white-image-not-exact", message
    why = "no calibration was given"
    if known is not None:
        cameras = ", ".join(known.serials) or "an unknown camera"
        why = f"{known.path} has none for it (it is of {cameras}, the shot of {shot.serial or 'an unknown camera'})"
    if embedded:
        return "white-image-not-exact", f"{why}; the white image in the shot's own file is used"
    return "no-white-image", f"{why}: no white image, so the lenses must be found in the shot itself"


def _steps(steps: int | None) -> str:
    return "unknown" if steps is None else f"{steps:+d} steps"
