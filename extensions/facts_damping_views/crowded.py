"""Labels in a crowded picture: those that can be read."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure
    from matplotlib.text import Text
    from matplotlib.transforms import Bbox


def thin_out(figure: Figure, texts: Sequence[Text]) -> None:
    """Hide each text that would cover one before it."""
    figure.draw_without_rendering()  # places are known only now
    shown: list[Bbox] = []
    for text in texts:
        box = text.get_window_extent()
        if any(box.overlaps(other) for other in shown):
            text.set_visible(False)
        else:
            shown.append(box)
