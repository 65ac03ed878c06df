"""Initial knowledge of a neuro-fuzzy controller and its identifier about the plant, from its linearisation."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Float2


class PlantPrior(NamedTuple):
    """Properties of the plant for a controller's signals and devices."""

    sign: Float2  # (signals, devices), of dy/du; 0: none, except for the first signal
    jacobian: Float2  # (signals, devices), p.u./p.u., over the identifier's horizon
    mode_shape: NDArray[
        np.complex128
    ]  # (signals,), p.u./p.u., at the least damped electromechanical mode, relative to the first
    z_pole: complex  # the mode's factor from one frame to the next
