"""The command line: ``lfrig`` and ``python -m lfrig.rig.cli``.

Everything heavy (NumPy, OpenCV, pycolmap, the pipeline) is imported inside the commands, so that ``lfrig --help``
costs typer and rich alone. Rooms:

- ``app``      which commands there are
- ``run``      one invocation: its global options, its output, its monitor
- ``monitor``  progress bars, warnings and the log file
- ``failures`` from any exception to one line, a remedy and an exit code
- ``options``  values that several commands parse alike
- ``session`` ``make`` ``decode`` ``quality`` ``export`` ``bench`` ``doctor`` ``absent``   the commands
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from lfrig.contracts.errors import ExitCode
from lfrig.rig.cli.failures import explain
from lfrig.rig.cli.run import Run, hoist_globals

PIPE_CLOSED = 0
"""Exit code when the reader of stdout has gone: what was asked for was done."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Parameters
    ----------
    argv : sequence of str, optional
        The arguments without the program's name; ``sys.argv[1:]`` by default.

    Returns
    -------
    int
        The exit code (`lfrig.contracts.errors.ExitCode`).
    """
    from lfrig.rig.cli.app import app

    arguments = hoist_globals(sys.argv[1:] if argv is None else argv)
    run = Run(json="--json" in arguments, debug="--debug" in arguments)
    try:
        with run.signals():
            value = app(args=arguments, prog_name="lfrig", standalone_mode=False, obj=run)
        code = value if isinstance(value, int) else 0
        if code == ExitCode.INTERRUPTED:  # what typer makes of a KeyboardInterrupt
            raise KeyboardInterrupt
    except BrokenPipeError:
        _discard_stdout()
        code = PIPE_CLOSED
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else 1
    except BaseException as error:
        code = run.fail(explain(error), error)
        _handled()
    finally:
        run.close()
    return _flush(code)


def _handled() -> None:
    """Let Python exit with our code after a KeyboardInterrupt.

    One that struck while a string was being executed, as dataclasses do at import, leaves CPython 3.11 convinced that
    nobody handled it: ``python -m`` then ends by SIGINT instead of our exit code. Executing any string takes that back.
    """
    exec("pass")


def _flush(code: int) -> int:
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        _discard_stdout()
    return code


def _discard_stdout() -> None:
    """Point stdout at nothing: its reader has gone, which is no failure of ours."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, sys.stdout.fileno())
    os.close(null)
