"""The HCI 4D light field benchmark: ``input_Cam000.png`` … and ``parameters.cfg`` (Honauer et al., ACCV 2016).

File number = row · num_cams_x + col, also when only a part of the views is there (rows and columns 1–7 of 9×9).
The views are sheared so that the focus plane has disparity zero, which is this project's convention and sign:
δ = b F (1/z − 1/z_f) with F = focal_length / sensor_size · resolution. On *cotton* that gives b F = 36.571,
c = 1/4.25; a fit to its ground truth 36.569.
"""

from __future__ import annotations

import configparser
import math
import re
from pathlib import Path

from lfrig.contracts.capture import CameraSpec, OpticsSpec
from lfrig.contracts.errors import BadInput
from lfrig.rig.ingest.candidate import Candidate, Request, full_grid
from lfrig.rig.ingest.view_files import ViewFiles, light_field_document, size_only
from lfrig.rig.session.images import image_size

FORMAT = "hci"
PARAMETERS = "parameters.cfg"
STANDARD_SIDE = 9
"""Views per side where no parameters.cfg says it and the files are no full square."""
_NAME = re.compile(r"input_Cam(\d+)\.png", re.IGNORECASE)


def recognise(path: Path, request: Request) -> Candidate | None:
    """A folder with ``input_CamNNN.png`` files; None for anything else, or when a pattern is given.

    Raises
    ------
    BadInput
        Views are missing, or parameters.cfg does not make sense.
    """
    if not path.is_dir() or request.pattern is not None or request.kind == "photo":
        return None
    numbered = {int(match[1]): entry for entry in path.iterdir() if (match := _NAME.fullmatch(entry.name))}
    if not numbered:
        return None
    parameters = _Parameters(path / PARAMETERS) if (path / PARAMETERS).is_file() else None
    columns = parameters.number("extrinsics", "num_cams_x") if parameters else None
    side = int(columns or _guess_side(set(numbered)))
    views, grid = full_grid({divmod(number, side): file for number, file in numbered.items()}, path, None)
    width, height = image_size(grid[0][0])
    known = parameters.known(width, height) if parameters else {"camera": size_only(grid[0][0])}
    content = tuple(file for line in grid for file in line)
    return ViewFiles(path, FORMAT, light_field_document(views=views, **known), content, grid)


def _guess_side(numbers: set[int]) -> int:
    side = math.isqrt(len(numbers))
    return side if numbers == set(range(side * side)) else STANDARD_SIDE


class _Parameters:
    """A parameters.cfg."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._config = configparser.ConfigParser(interpolation=None)
        try:
            self._config.read_string(path.read_text(encoding="utf-8"))
        except (configparser.Error, UnicodeDecodeError, OSError) as error:
            raise BadInput(
                f"cannot be read: {str(error).splitlines()[0]}", path=path, remedy="restore the file, or remove it"
            ) from None

    def number(self, section: str, key: str) -> float | None:
        """A positive number; None where the file does not say it; raises `BadInput` for anything else."""
        value = self._finite(section, key)
        if value is not None and value <= 0:
            raise self._refuse(section, key, "must be positive")
        return value

    def known(self, width: int, height: int) -> dict[str, object]:
        """Camera, optics and depth range of views of this size, as far as the file says them."""
        focal_mm, sensor_mm = self.number("intrinsics", "focal_length_mm"), self.number("intrinsics", "sensor_size_mm")
        camera = CameraSpec(width=width, height=height)
        if focal_mm is not None and sensor_mm is not None:
            # The sensor's size is that of the longer side. Its resolution is read off the views themselves, so
            # that a resized copy keeps its field of view.
            focal = focal_mm / sensor_mm * max(width, height)
            camera = CameraSpec(width=width, height=height, fx=focal, fy=focal, sigma_f=0.0)
        baseline_mm = self.number("extrinsics", "baseline_mm")
        optics = OpticsSpec(
            baseline_m=None if baseline_mm is None else baseline_mm / 1000.0,
            focus_distance_m=self.number("extrinsics", "focus_distance_m"),
            sigma_baseline=None if baseline_mm is None else 0.0,
        )
        return {"camera": camera, "optics": optics, "depth_range_m": self._depth_range(optics, camera.fx)}

    def _depth_range(self, optics: OpticsSpec, focal: float | None) -> tuple[float, float] | None:
        """(near, far) [m] from the scene's disparity range; None when it reaches infinity or is not known."""
        low, high = self._finite("meta", "disp_min"), self._finite("meta", "disp_max")
        if low is None or high is None or focal is None or optics.baseline_m is None or optics.focus_distance_m is None:
            return None
        far, near = (d / (optics.baseline_m * focal) + 1.0 / optics.focus_distance_m for d in (low, high))
        return (1.0 / near, 1.0 / far) if 0 < far < near else None

    def _finite(self, section: str, key: str) -> float | None:
        text = self._config.get(section, key, fallback=None)
        if text is None:
            return None
        try:
            value = float(text)
        except ValueError:
            raise self._refuse(section, key, f"is no number: {text!r}") from None
        if not math.isfinite(value):
            raise self._refuse(section, key, f"is not finite: {text!r}")
        return value

    def _refuse(self, section: str, key: str, message: str) -> BadInput:
        remedy = "correct it, or remove the line"
        return BadInput(message, path=self.path, field=f"{section}.{key}", code="invalid-field", remedy=remedy)
