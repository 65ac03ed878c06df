# PYTHON_ARGCOMPLETE_OK
"""The command line of `facts-damping`: from arguments to an exit status."""

from __future__ import annotations

import gc
import importlib
import os
import sys
from contextlib import suppress
from typing import TYPE_CHECKING

from facts_damping import interruption
from facts_damping.cli import options
from facts_damping.cli.parser import parser
from facts_damping.errors import VERBOSE, DegradedError, FactsDampingError, InputError, RecordingError, one_line, traced
from facts_damping.escaping import escaped
from facts_damping.output import picture_files, terminal

if TYPE_CHECKING:
    import argparse

# Matrices have a few hundred rows: NumPy's OpenBLAS threads gain nothing there. If other jobs hold the cores, the
# threads wait for each other: eigenvalues of 150 states then took 87 times as long.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Loaded modules stay in memory; searching them for garbage takes a tenth of a short command's time.
gc.set_threshold(50_000)

DONE, FAILED, BAD_INPUT, DEGRADED = 0, 1, 2, 3
STATUSES: tuple[tuple[type[FactsDampingError], int], ...] = (
    *((InputError, BAD_INPUT), (RecordingError, BAD_INPUT)),
    *((DegradedError, DEGRADED), (FactsDampingError, FAILED)),
)


def main(argv: list[str] | None = None) -> int:
    """Entry point: exit status 0 done, 1 the run failed, 2 bad input, 3 degraded, 130, 143 or 129 interrupted."""
    verbose, streams = os.environ.get(VERBOSE), (sys.stdout, sys.stderr)
    with interruption.handled():
        try:
            return _main(argv)
        except KeyboardInterrupt as error:
            return _fail(interruption.text(str(error)), interruption.status())
        finally:
            sys.stdout, sys.stderr = streams  # the user's code may have replaced them; Python flushes them at its end
            os.environ.pop(VERBOSE, None)
            os.environ.update({} if verbose is None else {VERBOSE: verbose})


def _main(argv: list[str] | None) -> int:
    try:
        _do(_arguments(argv))
        terminal.put("", flush=True)
    except FactsDampingError as error:
        terminal.complain(escaped(traced(error)))
        return _fail(error, next(status for kind, status in STATUSES if isinstance(error, kind)))
    except BrokenPipeError:
        sys.stderr.close()
        return DONE
    except OSError as error:
        return _cannot_write(error)
    return DONE


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    """Parse the arguments; answers shell completion."""
    top = parser()
    if "_ARGCOMPLETE" in os.environ:
        import argcomplete

        argcomplete.autocomplete(top)
    arguments, unknown = top.parse_known_args(argv)
    if unknown:
        options.refuse(unknown, arguments.known())
    return arguments


def _cannot_write(error: OSError) -> int:
    """Report a disk that is full or missing; the rest of standard output is dropped."""
    with suppress(OSError):
        terminal.put("", flush=True)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    where = error.filename or "standard output"
    return _fail(f"{where}: cannot be written: {error.strerror}; allowed: a place with room for it", BAD_INPUT)


def _do(arguments: argparse.Namespace) -> None:
    """Carry out the command. Its module is loaded only now, so that `--help`, `--version` and typos answer fast."""
    from facts_damping.parameters import files

    if arguments.verbose:
        os.environ[VERBOSE] = "1"  # for nodes and workers, too
    interruption.tell(interruption.NOTHING)
    files.check_writable(arguments.json)
    if getattr(arguments, "nodes", False):
        from facts_damping.nodes.launching import forked

        forked.load()  # loads what nodes need while this process loads its own modules
    draws = hasattr(arguments, "width")
    picture_files.set_picture_format(
        picture_files.PictureFormat(arguments.format, arguments.width, arguments.font)
        if draws
        else picture_files.PictureFormat()
    )
    module, _, name = arguments.function.replace(":", ".").rpartition(".")
    with terminal.busy_line(arguments.command):
        getattr(importlib.import_module(module), name)(arguments)


def _fail(reason: object, status: int) -> int:
    for line in getattr(reason, "lines", [reason]):  # of a `ProblemsError`
        terminal.note(f"facts-damping: {one_line(line)}")
    return status


if __name__ == "__main__":
    sys.exit(main())
