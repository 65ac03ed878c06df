"""What a neuro-fuzzy controller and its identifier know of the plant at the start, from its linearisation."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class PlantPrior(NamedTuple):
    """Of the controller's signals and devices, at the least damped swing mode and in time."""

    sign: NDArray[np.float64]  # (signals, devices), of dy/du; 0: none, but for the first signal
    jacobian: NDArray[np.float64]  # (signals, devices), p.u./p.u., over the identifier's horizon
    mode_shape: NDArray[np.complex128]  # (signals,), how each swings beside the first, p.u./p.u.
    z_pole: complex  # the mode's factor from one frame to the next
