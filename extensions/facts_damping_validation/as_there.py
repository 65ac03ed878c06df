"""Models with some blocks as another program has them, for comparisons with it."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from facts_damping.machine_controls.block_models import MODELS
from facts_damping.machine_controls.blocks import Block

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from facts_damping.machine_controls.blocks import Model

DIVIDES = Block("V_divisor", "limiter", "Vd", (), 0.01)  # ANDES divides powers by the voltage of the terminals


@contextmanager
def models_with(blocks: Mapping[str, tuple[Block, ...]], **models: Model) -> Iterator[None]:
    """In the block, models have these blocks in the place of those of their names, or are `models`."""
    before = dict(MODELS)
    try:
        for name, others in blocks.items():
            names = {block.name for block in others}
            rest = (block for block in MODELS[name].blocks if block.name not in names)
            MODELS[name] = MODELS[name]._replace(blocks=(*rest, *others))
        MODELS.update(models)
        yield
    finally:
        MODELS.update(before)
