"""Pictures as files: format, width and size of text."""

from __future__ import annotations

from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.output.writing import replacing

if TYPE_CHECKING:
    from pathlib import Path

CM, USUAL_PT, PRINT_DPI = 2.54, 10.0, 300  # cm per inch; usual text size of pictures; resolution if a width is given


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
        for text in figure.findobj(lambda artist: hasattr(artist, "set_fontsize")):
            text.set_fontsize(text.get_fontsize() * look.font_pt / USUAL_PT)
    if look.width_cm is not None:
        width, height = figure.get_size_inches()
        figure.set_size_inches(look.width_cm / CM, height * look.width_cm / CM / width)
        options["dpi"] = PRINT_DPI
    accepted = options if look.format == "png" else {name: options[name] for name in options.keys() & {"dpi"}}
    with replacing(place) as beside:
        figure.savefig(beside, format=look.format, **accepted)
    return place
