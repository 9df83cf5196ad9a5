"""The exception tree: every error a user can meet has an exit code, one line of message and a remedy.

Anything else that escapes is a bug of lfrig's and is shown as such.
"""

from __future__ import annotations

from enum import IntEnum
from pathlib import Path


class ExitCode(IntEnum):
    """Exit codes of the command line."""

    OK = 0
    CHECK_FAILED = 1
    USAGE = 2
    BAD_INPUT = 3
    GEOMETRY = 4
    DEVICE = 5
    DISK = 6
    INTERRUPTED = 130


class LfrigError(Exception):
    """Base of all expected errors.

    Parameters
    ----------
    message : str
        One line: what is wrong.
    remedy : str
        One line: what to do about it.
    code : str, optional
        Machine-readable slug, such as ``"too-few-anchors"``; the class has a default.
    path, field : optional
        The file and the field in it that the error is about; they lead the message.
    """

    exit_code: ExitCode = ExitCode.CHECK_FAILED
    default_code = "error"

    def __init__(
        self,
        message: str,
        *,
        remedy: str = "",
        code: str | None = None,
        path: Path | str | None = None,
        field: str | None = None,
    ) -> None:
        self.code = code or self.default_code
        self.remedy = remedy
        self.path = None if path is None else str(path)
        self.field = field
        where = [str(part) for part in (path, field) if part]
        self.message = ": ".join([*where, message])
        super().__init__(self.message)

    def __str__(self) -> str:
        return f"{self.message} ({self.remedy})" if self.remedy else self.message


class CheckFailed(LfrigError):
    """A check that the user asked for did not pass."""

    default_code = "check-failed"


class UsageError(LfrigError):
    """The command line does not make sense."""

    exit_code = ExitCode.USAGE
    default_code = "usage"


class NotInThisVersion(UsageError):
    """A documented command or option that this version does not have yet."""

    default_code = "not-in-this-version"

    def __init__(self, what: str, *, remedy: str = "") -> None:
        super().__init__(f"{what}: not in this version", remedy=remedy)


class ProcessingError(LfrigError):
    """Base of what can go wrong between files and a synthesized light field."""


class BadInput(ProcessingError):
    """A file, a field or an array that cannot be used."""

    exit_code = ExitCode.BAD_INPUT
    default_code = "bad-input"


class GeometryRefused(ProcessingError):
    """Poses, anchors or scale fits that are not trustworthy enough to build on."""

    exit_code = ExitCode.GEOMETRY
    default_code = "geometry-refused"


class RigError(LfrigError):
    """Base of what can go wrong with hardware."""

    exit_code = ExitCode.DEVICE
    default_code = "device"


class LinkError(RigError):
    """The connection to a device failed or was lost."""

    default_code = "link"


class DeviceTimeout(RigError):
    """A device did not answer before its deadline."""

    default_code = "device-timeout"


class CaptureError(RigError):
    """A camera did not deliver the picture that was asked for."""

    default_code = "capture"


class MotionError(RigError):
    """A turntable refused or failed a move."""

    default_code = "motion"


class DiskError(LfrigError):
    """Writing failed: disk full, read-only, no permission."""

    exit_code = ExitCode.DISK
    default_code = "disk"


class Interrupted(LfrigError):
    """The user cancelled; nothing half-made was left behind."""

    exit_code = ExitCode.INTERRUPTED
    default_code = "interrupted"

    def __init__(self, message: str = "interrupted; nothing was changed") -> None:
        super().__init__(message, remedy="run the same command again")
