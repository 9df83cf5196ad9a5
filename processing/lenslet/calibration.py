"""White images: what a calibration holds, and which of them fits a shot.

The rule: the one whose geometry correction the shot names (``exact``) → the same camera's nearest by zoom, then focus
(``nearest``) → the one in the shot's own file (``embedded``) → ``none``, and the lens lattice must be found in the shot
itself. It is never a dead end and never silent: what is not exact warns with the rule and the distance.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.errors import BadInput
from lfrig.contracts.lytro import HOT_PIXELS_NAME, MANIFEST_NAME, REFERENCE_PREFIX
from lfrig.processing.lenslet.archive import Archive, open_archive
from lfrig.processing.lenslet.bounded_json import parse_json_object
from lfrig.processing.lenslet.container import ContainerLimits
from lfrig.processing.lenslet.contents import frames
from lfrig.processing.lenslet.metadata import RawMetadata, parse_metadata
from lfrig.processing.lenslet.unpack import U16, unpack

I32 = NDArray[np.int32]
MIN_WHITE_LEVEL = 0.05
"""Mean of a usable white image as a share of the sensor's range; below it is a black frame or a failed exposure."""
_LIMITS = ContainerLimits()
_HASHED_BYTES = 1 << 20


@dataclass(frozen=True, eq=False)
class WhiteImage:
    """A picture of a uniform light: ``sensor`` uint16 [Hs, Ws], ``sha1`` (40 hex digits) of its packed bytes.

    ``metadata`` is its own, or the shot's where it has none; ``name`` says where it came from.
    """

    sensor: U16
    sha1: str
    metadata: RawMetadata
    name: str


@dataclass(frozen=True)
class WhiteEntry:
    """A white image of a calibration: its files' names there, its metadata, the geometry correction it belongs to."""

    name: str
    raw: str
    metadata: RawMetadata
    geometry_ref: str | None


@dataclass(frozen=True)
class Match:
    """How a white image fits a shot; distances in motor steps, None where either does not say."""

    entry: WhiteEntry
    rule: str
    zoom_steps: int | None
    focus_steps: int | None


class Calibration:
    """White images and hot pixels of one camera.

    Attributes
    ----------
    path : Path
    entries : tuple of WhiteEntry
        By name.
    problems : list of str
        Files that could not be used.
    """

    def __init__(self, archive: Archive) -> None:
        self.path = archive.path
        self.problems: list[str] = []
        self._archive = archive
        self.entries = tuple(self._entries())
        if not self.entries:
            why = f" ({self.problems[0]})" if self.problems else ""
            raise BadInput(
                f"holds no white image{why}", path=self.path, code="no-white-image",
                remedy="give the camera's caldata-….tar",
            )  # fmt: skip

    @classmethod
    def open(cls, path: Path | str) -> Calibration:
        """Open a tar, a folder, or one white image's .RAW; raises `BadInput` (`open_archive`'s, ``no-white-image``)."""
        return cls(open_archive(path))

    @property
    def serials(self) -> tuple[str, ...]:
        """Serial numbers of the cameras that the white images name."""
        return tuple(sorted({entry.metadata.serial for entry in self.entries if entry.metadata.serial}))

    def matches(self, shot: RawMetadata) -> list[Match]:
        """White images that could serve the shot, the best first; see the rule above."""
        fitting = [entry for entry in self.entries if _fits(entry.metadata, shot)]
        found = [_match(entry, shot) for entry in fitting]
        return sorted(found, key=lambda match: (match.rule != "exact", *_distance(match), match.entry.name))

    def load(self, entry: WhiteEntry) -> WhiteImage:
        """Read a white image.

        Raises
        ------
        BadInput
            ``wrong-size``; ``dark-white-image`` for a black frame.
        """
        payload = self._archive.read(entry.raw)
        return white_image(payload, entry.metadata, self.path, entry.raw, entry.name)

    def hot_pixels(self, shot: RawMetadata) -> I32:
        """Known hot pixels, int32 [N, 2] (x, y); none where the calibration has no list. Raises `BadInput`."""
        name = next((name for name in self._archive.sizes if _base(name) == HOT_PIXELS_NAME), None)
        if name is None:
            return np.empty((0, 2), np.int32)
        return parse_hot_pixels(self._archive.read(name), shot, self.path, name)

    def _entries(self) -> Iterator[WhiteEntry]:
        by_base = {(_folder(name), _base(name)): name for name in self._archive.sizes}
        hashes = self._manifest()
        for (folder, base), raw in sorted(by_base.items()):
            stem, dot, suffix = base.rpartition(".")
            text = by_base.get((folder, f"{stem}.TXT"))
            if suffix != "RAW" or not dot or text is None:
                continue
            try:
                metadata = self._metadata(text)
            except BadInput as error:
                self.problems.append(error.message)
                continue
            yield WhiteEntry(stem, raw, metadata, hashes.get(stem) or self._hash(by_base.get((folder, f"{stem}.GCT"))))

    def _metadata(self, name: str) -> RawMetadata:
        table = self._json(name)
        where = f"{self.path}: {name}"
        found = next((frame for frame in frames(table) if frame.metadata), None)
        if found is not None:
            return parse_metadata(found.metadata, found.private_metadata, where)
        return parse_metadata(table, {}, where)

    def _manifest(self) -> dict[str, str]:
        """Geometry references by the name, without suffix, of the file they stand for."""
        name = next((name for name in self._archive.sizes if _base(name) == MANIFEST_NAME.upper()), None)
        if name is None:
            return {}
        try:
            listed = self._json(name).get("calibrationFiles")
        except BadInput as error:
            self.problems.append(error.message)
            return {}
        pairs = [
            (entry.get("name"), entry.get("hash"))
            for entry in (listed if isinstance(listed, list) else [])
            if isinstance(entry, dict)
        ]
        return {
            _base(name).rpartition(".")[0]: _reference(reference)
            for name, reference in pairs
            if isinstance(name, str) and isinstance(reference, str) and _base(name).endswith(".GCT")
        }

    def _hash(self, name: str | None) -> str | None:
        if name is None or self._archive.sizes[name] > _HASHED_BYTES:
            return None
        return REFERENCE_PREFIX + hashlib.sha1(self._archive.read(name)).hexdigest()

    def _json(self, name: str) -> dict[str, Any]:
        if self._archive.sizes[name] > _LIMITS.json_bytes:
            raise BadInput("is too large", path=self.path, field=name, code="too-large", remedy="copy it again")
        return parse_json_object(self._archive.read(name), self.path, name, _LIMITS.json_depth)


def white_image(payload: memoryview, metadata: RawMetadata, path: Path, field: str, name: str) -> WhiteImage:
    """Unpack a white image and refuse a dark one; raises as `Calibration.load`."""
    sensor = unpack(payload, metadata, path, field)
    black, white = np.mean(metadata.black), np.mean(metadata.white)
    level = (float(sensor[::3, ::3].mean()) - black) / (white - black)
    if level < MIN_WHITE_LEVEL:
        raise BadInput(
            f"is dark ({100 * level:.1f} % of the sensor's range)", path=path, field=field, code="dark-white-image",
            remedy="give another white image",
        )  # fmt: skip
    return WhiteImage(sensor, hashlib.sha1(payload).hexdigest(), metadata, name)


def parse_hot_pixels(data: memoryview, shot: RawMetadata, path: Path, field: str) -> I32:
    """Decode a list of hot pixels: u32 count, count × i16 x, count × i16 y, little-endian → int32 [N, 2] (x, y).

    Raises
    ------
    BadInput
        Its length is not that of its count, or a pixel is outside of the sensor.
    """
    count = struct.unpack_from("<I", data)[0] if len(data) >= 4 else 0
    if len(data) != 4 + 4 * count:
        raise BadInput(
            f"its {len(data)} bytes are no list of hot pixels", path=path, field=field, code="bad-hot-pixels",
            remedy="copy it again",
        )  # fmt: skip
    places = np.frombuffer(data, "<i2", offset=4).reshape(2, count).T.astype(np.int32)
    if count and not (places.min() >= 0 and (places.max(0) < (shot.width, shot.height)).all()):
        raise BadInput(
            "names pixels outside of the sensor", path=path, field=field, code="bad-hot-pixels",
            remedy="is it the same camera's?",
        )  # fmt: skip
    return places


def _fits(white: RawMetadata, shot: RawMetadata) -> bool:
    same_sensor = (white.width, white.height, white.bayer) == (shot.width, shot.height, shot.bayer)
    return same_sensor and (white.serial is None or shot.serial is None or white.serial == shot.serial)


def _match(entry: WhiteEntry, shot: RawMetadata) -> Match:
    white = entry.metadata
    exact = entry.geometry_ref is not None and entry.geometry_ref == shot.geometry_correction_ref
    return Match(
        entry,
        "exact" if exact else "nearest",
        _difference(white.zoom_step, shot.zoom_step),
        _difference(white.focus_step, shot.focus_step),
    )


def _difference(a: int | None, b: int | None) -> int | None:
    return None if a is None or b is None else a - b


def _distance(match: Match) -> tuple[float, float, float]:
    """Zoom first, then focus; of equal ones the longer exposure. What is unknown comes last."""
    unknown = float("inf")
    zoom = unknown if match.zoom_steps is None else abs(match.zoom_steps)
    focus = unknown if match.focus_steps is None else abs(match.focus_steps)
    return zoom, focus, -(match.entry.metadata.exposure_s or 0.0)


def _base(name: str) -> str:
    return PurePosixPath(name.replace("\\", "/")).name.upper()


def _folder(name: str) -> str:
    return str(PurePosixPath(name).parent)


def _reference(value: str) -> str:
    value = value.strip().lower()
    return value if value.startswith(REFERENCE_PREFIX) else REFERENCE_PREFIX + value
