"""Base of the documents on disk: frozen, validated, unknown fields kept, newer major versions refused."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from lfrig.contracts.errors import BadInput
from lfrig.contracts.files import atomic_write_text

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=0)]
PositiveInt = Annotated[int, Field(gt=0)]


def _near_before_far(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] >= value[1]:
        raise ValueError("must be [near, far] with near < far")
    return value


DepthRange = Annotated[tuple[Positive, Positive], AfterValidator(_near_before_far)]
"""(near, far) [m]."""


class Model(BaseModel):
    """A frozen part of a document. Unknown fields are kept, so newer minor versions survive a round trip."""

    model_config = ConfigDict(frozen=True, extra="allow", populate_by_name=True)


class Document(Model):
    """A whole JSON file whose ``schema`` field says what it is, such as ``"lfrig.capture/1"``."""

    NAME: ClassVar[str]
    MAJOR: ClassVar[int] = 1

    @classmethod
    def schema_id(cls) -> str:
        """The value of the ``schema`` field that this version writes."""
        return f"{cls.NAME}/{cls.MAJOR}"

    @classmethod
    def parse(cls, data: Any, path: Path | str) -> Self:
        """Validate a decoded JSON object.

        Raises
        ------
        BadInput
            Wrong or newer schema, or an invalid field; names the file, the field and a remedy.
        """
        if not isinstance(data, dict):
            raise BadInput("is not a JSON object", path=path, remedy=f"it must hold one {cls.NAME} object")
        _check_schema(str(data.get("schema", "")), cls.NAME, cls.MAJOR, path)
        body = {key: value for key, value in data.items() if key != "schema"}
        try:
            return cls.model_validate(body)
        except ValidationError as error:
            raise _invalid_field(error, path) from None

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read and validate a file; raises `BadInput` with the file's name for anything wrong with it."""
        return cls.parse(read_json(path), path)

    def to_json(self) -> str:
        """The document as indented JSON, ``schema`` first, unset optional fields left out.

        JSON has no NaN and no infinity: in free-form parts (rows of a benchmark) they become ``null``.
        """
        body = _finite(self.model_dump(mode="json", by_alias=True, exclude_none=True))
        body.pop("schema", None)
        return json.dumps({"schema": self.schema_id(), **body}, indent=1, allow_nan=False) + "\n"

    def save(self, path: Path) -> None:
        """Write atomically."""
        atomic_write_text(path, self.to_json())


def read_json(path: Path) -> Any:
    """Decode a JSON file (UTF-8, with or without a byte-order mark); raises `BadInput` that names it."""
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise BadInput("does not exist", path=path, code="missing-file", remedy="check the path") from None
    except (ValueError, RecursionError) as error:  # not UTF-8, not JSON, a number or a nesting without end
        reason = f"is not valid JSON: {error}"
        raise BadInput(reason, path=path, code="not-json", remedy="restore the file") from None
    except OSError as error:
        reason = f"cannot be read: {error.strerror}"
        raise BadInput(reason, path=path, remedy="check the permissions") from None


def _invalid_field(error: ValidationError, path: Path | str) -> BadInput:
    first = error.errors()[0]
    message = first["msg"].removeprefix("Value error, ")
    return BadInput(
        message[:1].lower() + message[1:] if message[1:2].islower() else message,
        path=path,
        field=".".join(str(part) for part in first["loc"]) or None,
        code="invalid-field",
        remedy="correct the field, or leave it out if it is not known",
    )


def _finite(value: Any) -> Any:
    """``value`` with every NaN and infinity replaced by None."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _check_schema(value: str, name: str, major: int, path: Path | str) -> None:
    found, _, version = value.partition("/")
    if found != name:
        shown = repr(value) if value else "missing"
        raise BadInput(
            f"is {shown}, expected '{name}/{major}'",
            path=path,
            field="schema",
            code="unknown-schema",
            remedy="is this the right file?",
        )
    try:
        found_major = int(version.partition(".")[0])
    except ValueError:
        found_major = -1
    if found_major < 1:
        raise BadInput(
            f"has no valid version: {value!r}", path=path, field="schema", code="unknown-schema",
            remedy=f"expected '{name}/{major}'",
        )  # fmt: skip
    if found_major > major:
        raise BadInput(
            f"is {value!r}, newer than this version reads ('{name}/{major}')",
            path=path,
            field="schema",
            code="newer-schema",
            remedy="update lfrig",
        )
