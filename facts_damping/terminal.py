"""Output for the user: progress and tables on the terminal, JSON in a file or on standard output."""

from __future__ import annotations

import csv
import errno
import io
import itertools
import json
import os
import sys
import threading
import time
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from facts_damping.errors import one_line
from facts_damping.escaping import escaped, shortened
from facts_damping.interruption import interruptions_held

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from typing_extensions import Self

CM, USUAL_PT, PRINT_DPI = 2.54, 10.0, 300  # cm per inch; usual text size of pictures; resolution if a width is given
SILENCE_S = 3.0  # s; a busy line appears after this time without output


def duration(seconds: float) -> str:
    """A duration as text: 42 s, 3 min 20 s, 1 h 21 min."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    if minutes < 10:
        return f"{minutes} min {rest} s"
    minutes = round(whole / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


class Progress:
    """A progress line on standard error, if that is a terminal."""

    shown: ClassVar[Progress | None] = None  # the progress line now on the terminal

    def __init__(self, label: str, unit: str = "ticks", *, shown: bool = True) -> None:
        self._label, self._unit, self._shown = escaped(label), unit, shown and _on_terminal()
        self._began, self._before, self._done, self._of = time.monotonic(), 0, 0, 1

    def __call__(self, done: int, of: int) -> None:
        """Show the progress."""
        self._done, self._of = done, of
        if self._shown:
            Progress.shown = self
            complain(str(self))

    def __str__(self) -> str:
        """The line."""
        elapsed, done, of = time.monotonic() - self._began, self._done, self._of
        bar = "#" * (30 * done // of)
        left = elapsed * (of - done) / (done - self._before) if done > self._before else 0.0
        rest = f", {duration(left)} left" if left >= 1.0 else ""
        return f"\r{self._label} [{bar:<30}] {done}/{of} {self._unit}, {duration(elapsed)}{rest}\033[K"

    def resume(self, done: int) -> None:
        """Set the number done before this start, which does not count in the estimate of remaining time."""
        self._before = done

    def __enter__(self) -> Self:
        """Return the progress, which the end of the block closes."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the line."""
        self.close()

    def close(self) -> None:
        """End the line."""
        if self._shown:
            Progress.shown = None
            complain("\n")


def put(text: str, *, flush: bool = False) -> None:
    """Write to standard output. Raises OSError, also if the user's code has closed or replaced it."""
    try:
        sys.stdout.write(text)
        if flush:
            sys.stdout.flush()
    except OSError:
        raise
    except Exception as error:
        reason = f"closed, or replaced by code of the user ({one_line(error)})"
        raise OSError(errno.EBADF, reason, "standard output") from error


def complain(text: str) -> None:
    """Write to standard error; where the user's code has closed or replaced it, to its file, if that is open."""
    try:
        sys.stderr.write(text)
        sys.stderr.flush()
    except Exception:  # noqa: BLE001 (of what replaces it)
        with suppress(OSError):
            os.write(2, text.encode())


def _on_terminal() -> bool:
    """Whether standard error is a terminal; not if the user's code has closed or replaced it."""
    try:
        return sys.stderr.isatty()
    except Exception:  # noqa: BLE001 (as above)
        return False


def show(text: str) -> None:
    """Print lines on standard output; text from outside cannot control the terminal."""
    clear_line()
    put(escaped(text) + "\n")


def note(text: str) -> None:
    """Print a line of limited length on standard error."""
    clear_line()
    complain(shortened(escaped(text)) + "\n")


_waiting = threading.Event()  # a busy line is shown


@contextmanager
def busy_line(name: str) -> Iterator[None]:
    """Show a line on the terminal after `SILENCE_S` without output, and keep a progress line current.

    The line bypasses `sys.stderr`, whose lock a command may hold.
    """
    began, over = time.monotonic(), threading.Event()

    def refresh() -> None:
        while not over.wait(1.0):
            elapsed, line = time.monotonic() - began, Progress.shown
            if line is not None:
                os.write(2, str(line).encode())
            elif elapsed >= SILENCE_S:
                _waiting.set()
                os.write(2, f"\r{name}: {duration(elapsed)}\033[K".encode())

    if not _on_terminal():
        yield
        return
    thread = threading.Thread(target=refresh, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        clear_line()


def clear_line() -> None:
    """Remove the line of `busy_line`, or of a progress, before other output."""
    if _waiting.is_set() or Progress.shown is not None:
        _waiting.clear()
        with suppress(OSError):
            os.write(2, b"\r\033[K")


def table(
    titles: Sequence[str], rows: Iterable[Sequence[Any]], left: int = 1, *, markdown: bool = False, rule: bool = True
) -> list[str]:
    """Lines of a table for a terminal, or in Markdown; `rule`: a line below the titles.

    The first `left` columns are aligned to the left, the others to the right.
    """
    cells = [list(titles), *([str(cell) for cell in row] for row in rows)]
    if markdown:
        kinds = ["---" if column < left else "--:" for column in range(len(titles))]
        return [f"| {' | '.join(row)} |" for row in (cells[0], kinds, *cells[1:])]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    rules = [["-" * width for width in widths]] if rule else []
    return [
        "  ".join(
            cell.ljust(width) if column < left else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in (cells[0], *rules, *cells[1:])
    ]


def as_csv(titles: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """A table as CSV. A cell that is a named tuple becomes a column for each of its fields, `title, field`."""
    fields = [max((getattr(cell, "_fields", ()) for cell in column), key=len) for column in zip(*rows, strict=True)]
    names = [[f"{title}, {field}" for field in own] or [title] for title, own in zip(titles, fields, strict=True)]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(itertools.chain(*names))
    for row in rows:
        cells = [cell if isinstance(cell, tuple) else (cell,) for cell in row]
        padded = [(*cell, *[""] * (len(own) - len(cell))) for cell, own in zip(cells, names, strict=True)]
        writer.writerow(itertools.chain(*padded))
    return text.getvalue()


def some_of(names: Sequence[str], maximum: int = 8) -> str:
    """Names separated by commas; of many, the first ones and the number of the others."""
    return ", ".join(names[:maximum]) + (f" and {len(names) - maximum} more" if len(names) > maximum else "")


@contextmanager
def naming(target: str) -> Iterator[None]:
    """Add the file's name to errors of writing, which a full disk's error lacks."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, target) from error


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary file beside `path` that replaces it if complete; otherwise nothing is left. Delays interruptions."""
    place = path.resolve()  # target of a link
    beside = place.with_name(place.name + ".new")
    with interruptions_held():
        try:
            with naming(str(path)):
                yield beside
                beside.replace(place)
        except BaseException:
            beside.unlink(missing_ok=True)
            raise


def write_whole(path: Path, text: str) -> None:
    """Write a file whole or not at all; devices are written directly."""
    if path.exists() and not path.is_file():
        with naming(str(path)):
            path.write_text(text, encoding="utf-8")
        return
    with replacing(path) as beside:
        beside.write_text(text, encoding="utf-8")


class PictureFormat(NamedTuple):
    """Format of pictures: file format, width in cm, usual text size in points; None: as drawn."""

    format: str = "png"
    width_cm: float | None = None
    font_pt: float | None = None


DEFAULT_FORMAT = PictureFormat()
_look: ContextVar[PictureFormat] = ContextVar("_look", default=DEFAULT_FORMAT)


def set_picture_format(look: PictureFormat) -> None:
    """Set the format of all later pictures."""
    _look.set(look)


def save_picture(figure: Any, path: Path, **options: Any) -> Path:
    """Write a Matplotlib figure, whole or not at all; `path`: name as PNG. Returns the path written."""
    look = _look.get()
    place = path.with_suffix(f".{look.format}")
    if look.font_pt is not None:
        for text in figure.findobj(lambda one: hasattr(one, "set_fontsize")):
            text.set_fontsize(text.get_fontsize() * look.font_pt / USUAL_PT)
    if look.width_cm is not None:
        width, height = figure.get_size_inches()
        figure.set_size_inches(look.width_cm / CM, height * look.width_cm / CM / width)
        options["dpi"] = PRINT_DPI
    kept = options if look.format == "png" else {name: options[name] for name in options.keys() & {"dpi"}}
    with replacing(place) as beside:
        figure.savefig(beside, format=look.format, **kept)
    return place


def write_json(target: str | None, content: Any) -> None:
    """Write JSON to a file, or to standard output for `-`."""
    if target is not None:
        write_text(target, json.dumps(finite(content), indent=2, allow_nan=False) + "\n")


def write_text(target: str, text: str) -> None:
    """Write text to a file, or to standard output for `-`; unprintable characters are escaped on a terminal."""
    if target != "-":
        write_whole(Path(target), text)
    else:
        put(escaped(text) if os.isatty(1) else text)


def finite(content: Any) -> Any:
    """Content with None in place of numbers that JSON lacks."""
    if isinstance(content, dict):
        return {key: finite(value) for key, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [finite(value) for value in content]
    if isinstance(content, float) and content - content != 0.0:
        return None
    return content


@contextmanager
def script_apart() -> Iterator[None]:
    """Prevent `multiprocessing` from running the caller's script again in each process that is started."""
    main = vars(sys.modules["__main__"])
    kept = {name: value for name, value in main.items() if name in ("__file__", "__spec__")}
    main.update(dict.fromkeys(kept))
    try:
        yield
    finally:
        main.update(kept)
