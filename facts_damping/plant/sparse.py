"""Linear equations of a network: dense ones of small systems, of large ones sparse (SuperLU, as SciPy has it).

Dense ones give the same bits on every processor (`matrices`). A network of N buses has some three branches a bus, so
elimination in a good order takes about N steps instead of N^3: from some hundred buses on, that counts for more.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import block_array, csc_array

from facts_damping.matrices import solve

if TYPE_CHECKING:
    from numpy.typing import NDArray

DENSE = 400  # buses, up to which a network's equations are dense


def as_needed(matrix: NDArray[Any], buses: int) -> Any:
    """A matrix of a network of so many buses, sparse where that is large."""
    return matrix if buses <= DENSE else csc_array(matrix)


def joined(parts: list[list[Any]]) -> Any:
    """Blocks of a matrix as one, dense or sparse as they are."""
    if isinstance(parts[0][0], np.ndarray):
        return np.block(parts)
    return block_array(parts, format="csc")


def solve_network(a: Any, b: NDArray[Any]) -> NDArray[Any]:
    """The x of a x = b, for a vector or a matrix b, a dense or sparse. Raises `LinAlgError` where a is singular."""
    if isinstance(a, np.ndarray):
        return solve(a, b)
    from scipy.sparse.linalg import splu  # noqa: PLC0415 (of large systems alone)

    kind = np.result_type(a.dtype, b, float)
    try:
        found = splu(a.astype(kind)).solve(np.ascontiguousarray(b, kind))
    except RuntimeError as error:  # as SuperLU calls it
        raise np.linalg.LinAlgError("singular matrix") from error
    return np.asarray(found)
