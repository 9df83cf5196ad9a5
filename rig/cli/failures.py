"""From any exception to what the user is told: a message, a remedy, an exit code."""

from __future__ import annotations

import errno
from pathlib import Path

from lfrig.contracts.errors import Interrupted, LfrigError, UsageError

_DISK = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EACCES, errno.EPERM, errno.EROFS}


class Unexpected(LfrigError):
    """A bug of lfrig's."""

    default_code = "internal"


class OutOfMemory(LfrigError):
    """The machine has not enough memory for the work."""

    default_code = "out-of-memory"


def explain(error: BaseException) -> LfrigError:
    """The `LfrigError` that says what ``error`` means to the user."""
    if isinstance(error, LfrigError):
        return error
    if isinstance(error, KeyboardInterrupt):
        return Interrupted()
    if isinstance(error, OSError) and error.errno in _DISK:
        return _disk(error)
    if isinstance(error, MemoryError):
        return OutOfMemory("not enough memory", remedy="use fewer sources or smaller views")
    usage = _usage(error)
    if usage is not None:
        return usage
    return Unexpected(
        f"unexpected {type(error).__name__}: {error}",
        remedy="this is a fault of lfrig's: run the command again with --debug and report what it prints",
    )


def one_line(text: str) -> str:
    """``text`` with every run of white space as one blank."""
    return " ".join(text.split())


def _disk(error: OSError) -> LfrigError:
    from lfrig.contracts.files import disk_errors

    try:
        with disk_errors(Path(error.filename or ".")):
            raise error
    except LfrigError as told:
        return told


def _usage(error: BaseException) -> UsageError | None:
    """A parse error of the command line; told by its shape, because typer carries its own copy of click or not."""
    if getattr(error, "exit_code", None) != UsageError.exit_code or not hasattr(error, "format_message"):
        return None
    context = getattr(error, "ctx", None)
    command = context.command_path if context is not None else "lfrig"
    return UsageError(one_line(error.format_message()).rstrip("."), remedy=f"see `{command} --help`")
