"""What is to be shot: plate angles, the target's angle, and how long each device may take."""

from __future__ import annotations

import itertools
import math
import tomllib
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, ValidationError, field_validator

from lfrig.contracts.errors import BadInput, UsageError
from lfrig.contracts.progress import Monitor
from lfrig.contracts.schema import Finite, Model, NonNegative, Positive

MAX_CAPTURES = 1000
USUAL_STEP_DEG = 20.0
LARGEST_STEP_DEG = 30.0
"""Steps of 10–15° are recommended, up to 20° normal, up to 30° possible with losses; beyond, matching fails."""
ANGLES_REMEDY = "give FIRST:LAST:STEP (both ends are shot), such as 0:60:15, or a list such as 0,15,40"


class CapturePlan(Model):
    """A frozen capture plan; the journal's header keeps a copy, so that what was meant is known afterwards.

    ``angles_deg`` are the light fields' plate angles in order of shooting; ``target_deg`` the photo's, None = no photo.
    """

    angles_deg: Annotated[tuple[Finite, ...], Field(min_length=1, max_length=MAX_CAPTURES)]
    target_deg: Finite | None = None
    settle_s: NonNegative = 0.5
    home_timeout_s: Positive = 180.0
    move_timeout_s: Positive = 60.0
    camera_timeout_s: Positive = 60.0

    @field_validator("angles_deg", mode="before")
    @classmethod
    def _parse_text(cls, value: Any) -> Any:
        return parse_angles(value) if isinstance(value, str) else value

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a TOML file with the fields of this class, such as ``angles_deg = "0:60:15"``.

        Raises
        ------
        BadInput
            Missing, no TOML, an unknown or invalid field.
        """
        try:
            fields = tomllib.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise BadInput("does not exist", path=path, code="missing-file", remedy="check the path") from None
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise BadInput(f"is not a TOML file: {error}", path=path, remedy="correct it") from None
        unknown = sorted(set(fields) - set(cls.model_fields))
        if unknown:
            raise BadInput("is not a field of a plan", path=path, field=unknown[0], code="invalid-field",
                           remedy=f"a plan has {', '.join(cls.model_fields)}")  # fmt: skip
        try:
            return cls.model_validate(fields)
        except UsageError as error:
            raise BadInput(error.message, path=path, field="angles_deg", code="invalid-field",
                           remedy=error.remedy) from None  # fmt: skip
        except ValidationError as error:
            first = error.errors()[0]
            field = ".".join(str(part) for part in first["loc"])
            raise BadInput(first["msg"], path=path, field=field, code="invalid-field", remedy="correct it") from None

    @property
    def widest_step_deg(self) -> float:
        """Largest gap between neighbouring light fields, 0 for one."""
        ordered = sorted(self.angles_deg)
        return max((b - a for a, b in itertools.pairwise(ordered)), default=0.0)

    def check_steps(self, monitor: Monitor, *, force: bool = False) -> None:
        """Warn of steps above 20°; refuse steps above 30° unless forced.

        Raises
        ------
        UsageError
            A step is too wide.
        """
        step = self.widest_step_deg
        if step > LARGEST_STEP_DEG and not force:
            raise UsageError(
                f"a step of {step:g}° is too wide for neighbouring light fields to be matched",
                code="step-too-wide", remedy="choose steps of 10–20°, or give --force",
            )  # fmt: skip
        if step > USUAL_STEP_DEG:
            monitor.warn("wide-step", f"the widest step is {step:g}°; 10–20° gives more matches and better depth")


def parse_angles(text: str) -> tuple[float, ...]:
    """``"0:60:15"`` → (0, 15, 30, 45, 60), both ends included; ``"0,15,40"`` is taken as it is.

    Raises
    ------
    UsageError
        Not numbers, a step that does not lead from the first to the last, or more than 1000 angles.
    """
    try:
        if ":" not in text:
            angles = tuple(float(part) for part in text.split(","))
        else:
            first, last, step = (float(part) for part in text.split(":"))
            angles = _range(first, last, step)
    except ValueError:
        raise UsageError(f"angles {text!r} make no sense", code="bad-angles", remedy=ANGLES_REMEDY) from None
    if not all(math.isfinite(angle) for angle in angles) or len(angles) > MAX_CAPTURES:
        raise UsageError(f"angles {text!r} make no sense", code="bad-angles", remedy=ANGLES_REMEDY)
    return angles


def _range(first: float, last: float, step: float) -> tuple[float, ...]:
    if not all(map(math.isfinite, (first, last, step))):
        raise ValueError("not finite")
    if first == last:
        return (first,)
    if step == 0 or (last - first) / step < 0 or (last - first) / step > MAX_CAPTURES:
        raise ValueError("the step does not lead from first to last")
    steps = round((last - first) / step)
    if abs(first + steps * step - last) > 1e-6 * max(1.0, abs(last)):
        raise ValueError("the last angle is not a whole number of steps away")
    return (*(round(first + k * step, 9) for k in range(steps)), last)


def middle_gap_deg(angles_deg: tuple[float, ...]) -> float:
    """An angle between the two middle light fields: the default place for the target photo."""
    ordered = sorted(angles_deg)
    middle = (len(ordered) - 1) // 2
    return ordered[middle] if len(ordered) == 1 else (ordered[middle] + ordered[middle + 1]) / 2
