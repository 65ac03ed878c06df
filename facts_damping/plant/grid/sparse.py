"""Linear network equations: dense for small systems, sparse for large ones.

Both give the same bits on every processor (`matrices`). A network of N buses has about three branches per bus, so
elimination in a good order takes about N steps instead of N^3, which pays off above some hundred buses. The order is
SuperLU's (T. A. Davis, J. R. Gilbert, S. I. Larimore, E. G. Ng, A Column Approximate Minimum Degree Ordering Algorithm,
ACM Trans. Mathematical Software 30(3), 2004), which depends only on the positions of entries. SuperLU's elimination
uses BLAS, so elimination is done here, column by column (J. R. Gilbert, T. Peierls, Sparse Partial Pivoting in Time
Proportional to Arithmetic Operations, SIAM J. Sci. Stat. Comput. 9(5), 1988; T. A. Davis, Direct Methods for Sparse
Linear Systems, 2006, 6.3).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling import compiled, entry_point
from facts_damping.compiling.structs import Complex1, Complex2, Float1, Float2, Int1, Int2, Struct
from facts_damping.numerics.matrices import size_of_pivot, solve

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

DENSE = 400  # largest number of buses with dense equations
NONE = -1
SINGULAR, FULL = -1, -2  # return codes of a failed elimination


def _sparse() -> Any:
    """SciPy's sparse matrices, loaded only for large systems: loading takes longer than a run of a small one."""
    from scipy import sparse  # noqa: PLC0415

    return sparse


class Entries(Struct):
    """Entries of a matrix by columns: start of each column, rows, values."""

    begin: Int1
    row: Int1
    value: Float1


class ComplexEntries(Entries):
    """Entries of a complex matrix."""

    value: Complex1  # type: ignore[assignment]


class Triplets(NamedTuple):
    """Entries of a matrix by rows, each place once, without zeros."""

    row: Int1
    column: Int1
    value: Complex1


def summed(columns: int, entries: Iterable[tuple[int, int, complex]]) -> Triplets:
    """Triplets from (row, column, value); values at the same place are added in their order."""
    table = np.array(list(entries), complex).reshape(-1, 3)
    row, column = table[:, :2].real.astype(np.int64).T
    places, which = np.unique(row * columns + column, return_inverse=True)
    total = np.zeros(len(places), complex)
    np.add.at(total, which, table[:, 2])
    nonzero = total != 0
    row, column = np.divmod(places[nonzero], columns)
    return Triplets(row, column, total[nonzero])


def filled(buses: int, at: tuple[Int1, Int1], values: NDArray[Any], size: int | None = None) -> Any:
    """A square matrix, (buses, buses) or (size, size), with values at rows and columns, sparse for many buses."""
    n = buses if size is None else size
    if buses > DENSE:
        return _sparse().csc_array((values, at), (n, n))
    matrix = np.zeros((n, n), values.dtype)
    matrix[at] = values
    return matrix


def joined(parts: list[list[Any]]) -> Any:
    """Assemble a block matrix, dense or sparse like its blocks."""
    if isinstance(parts[0][0], np.ndarray):
        return np.block(parts)
    return _sparse().block_array(parts, format="csc")


class Factors(NamedTuple):
    """L and U of a matrix with ordered columns: `place` of each row, and the `order` of the columns."""

    lower: Any
    upper: Any
    place: Int1
    order: Int1


def factors(a: Any, kind: type) -> Factors:
    """L and U of a matrix, as numbers of a kind. Raises `LinAlgError` if it is singular."""
    a, n = _sparse().csc_array(a), a.shape[0]
    a.sort_indices()
    is_complex = kind is complex
    entries = ComplexEntries if is_complex else Entries
    matrix_entries = entries(a.indptr.astype(np.int64), a.indices.astype(np.int64), a.data.astype(kind))
    order, room = _order(a)
    eliminate = _eliminate_complex if is_complex else _eliminate_real
    place, ended = np.full(n, NONE, np.int64), FULL
    while ended == FULL:
        lower, upper = (
            entries(np.zeros(n + 1, np.int64), np.zeros(room, np.int64), np.zeros(room, kind)) for _ in range(2)
        )
        place[:] = NONE
        ended = eliminate(matrix_entries, order, lower, upper, place, np.zeros(n, kind), np.zeros((4, n), np.int64))
        room *= 2
    if ended == SINGULAR:
        raise np.linalg.LinAlgError("singular matrix")
    return Factors(lower, upper, place, order)


def solve_network(a: Any, b: NDArray[Any]) -> NDArray[Any]:
    """Solve a x = b for a vector or matrix b, a dense or sparse. Raises `LinAlgError` if a is singular."""
    if isinstance(a, np.ndarray):
        return solve(a, b)
    return substitute(factors(a, complex if np.result_type(a.dtype, b, float) == np.complex128 else float), b)


def substitute(lu: Factors, b: NDArray[Any]) -> NDArray[Any]:
    """Solve L U x = b for a vector or matrix b, in the numbers of the factors."""
    kind, n = lu.lower.value.dtype, len(lu.order)
    x = np.zeros((n, b.size // n if n else 0), kind)
    x[lu.place] = b.reshape(x.shape)
    (_substitute_complex if kind == np.complex128 else _substitute_real)(lu.lower, lu.upper, x)
    solution = np.zeros_like(x)
    solution[lu.order] = x
    return solution.reshape(b.shape)


def _order(a: Any) -> tuple[Int1, int]:
    """Elimination order of the columns, and the approximate number of entries in the factors.

    SuperLU gets a well-conditioned matrix with entries at the same positions.
    """
    from scipy.sparse.linalg import splu  # noqa: PLC0415 (of large systems alone)

    n = a.shape[0]
    csc_array = _sparse().csc_array
    places = csc_array((np.ones(len(a.indices)), a.indices, a.indptr), a.shape)
    known = splu((places + csc_array((np.full(n, 2.0 * n), (range(n), range(n))), a.shape)).tocsc())
    order = np.zeros(n, np.int64)
    order[known.perm_c] = np.arange(n)
    return order, 2 * int(max(known.L.nnz, known.U.nnz)) + n


@compiled
def _reach(rows: Int1, lower: Entries, place: Int1, k: int, room: Int2) -> int:
    """Rows with entries of a column after the elimination so far, into room[0] from the returned index on.

    Depth-first search through the columns of `lower`, so that each column precedes those that it changes.
    """
    reached, stack, following, seen = room[0], room[1], room[2], room[3]
    begin, below = lower.begin, lower.row
    top = reached.size
    for start in rows:
        if seen[start] == k + 1:
            continue
        head = 0
        stack[0] = start
        while head >= 0:
            row = stack[head]
            column = place[row]
            if seen[row] != k + 1:
                seen[row] = k + 1
                following[head] = 0 if column == NONE else begin[column] + 1
            deeper = False
            end = 0 if column == NONE else begin[column + 1]
            for p in range(following[head], end):
                if seen[below[p]] != k + 1:
                    following[head] = p + 1
                    head += 1
                    stack[head] = below[p]
                    deeper = True
                    break
            if not deeper:
                head -= 1
                top -= 1
                reached[top] = row
    return top  # type: ignore[no-any-return]


@compiled
def _eliminate(
    matrix: Entries, order: Int1, lower: Entries, upper: Entries, place: Int1, x: NDArray[Any], room: Int2
) -> int:
    """L and U of a matrix with ordered columns, and the place of each row; SINGULAR, FULL or the number of columns.

    The pivot, the largest entry, is the first entry of a column of L and the last of a column of U.
    """
    n = order.size
    of_lower = of_upper = 0
    for k in range(n):
        if of_lower + n > lower.row.size or of_upper + n > upper.row.size:
            return FULL
        rows = matrix.row[matrix.begin[order[k]] : matrix.begin[order[k] + 1]]
        top = _reach(rows, lower, place, k, room)
        for i in room[0][top:]:
            x[i] = 0.0
        for p in range(matrix.begin[order[k]], matrix.begin[order[k] + 1]):
            x[matrix.row[p]] = matrix.value[p]
        pivot, largest = NONE, 0.0
        for i in room[0][top:]:
            column = place[i]
            if column == NONE:
                if size_of_pivot(x[i]) > largest:
                    pivot, largest = i, size_of_pivot(x[i])
                continue
            upper.row[of_upper], upper.value[of_upper] = column, x[i]
            of_upper += 1
            for p in range(lower.begin[column] + 1, lower.begin[column + 1]):
                x[lower.row[p]] -= lower.value[p] * x[i]
        if pivot == NONE or not largest > 0.0:
            return SINGULAR
        upper.row[of_upper], upper.value[of_upper] = k, x[pivot]
        lower.row[of_lower], lower.value[of_lower] = pivot, 1.0
        of_upper, of_lower = of_upper + 1, of_lower + 1
        place[pivot] = k
        for i in room[0][top:]:
            if place[i] == NONE:
                lower.row[of_lower], lower.value[of_lower] = i, x[i] / x[pivot]
                of_lower += 1
        lower.begin[k + 1], upper.begin[k + 1] = of_lower, of_upper
    for p in range(of_lower):
        lower.row[p] = place[lower.row[p]]
    return n


@compiled
def _substitute(lower: Entries, upper: Entries, x: NDArray[Any]) -> None:
    """Solve L U x = b in place; x contains b, with a column for each right-hand side."""
    n = x.shape[0]
    for k in range(n):
        for p in range(lower.begin[k] + 1, lower.begin[k + 1]):
            for j in range(x.shape[1]):
                x[lower.row[p], j] -= lower.value[p] * x[k, j]
    for k in range(n - 1, -1, -1):
        last = upper.begin[k + 1] - 1
        for j in range(x.shape[1]):
            x[k, j] /= upper.value[last]
        for p in range(upper.begin[k], last):
            for j in range(x.shape[1]):
                x[upper.row[p], j] -= upper.value[p] * x[k, j]


@entry_point
def _eliminate_real(
    matrix: Entries, order: Int1, lower: Entries, upper: Entries, place: Int1, x: Float1, room: Int2
) -> int:
    return _eliminate(matrix, order, lower, upper, place, x, room)


@entry_point
def _substitute_real(lower: Entries, upper: Entries, x: Float2) -> None:
    _substitute(lower, upper, x)


@entry_point
def _eliminate_complex(
    matrix: ComplexEntries,
    order: Int1,
    lower: ComplexEntries,
    upper: ComplexEntries,
    place: Int1,
    x: Complex1,
    room: Int2,
) -> int:
    return _eliminate(matrix, order, lower, upper, place, x, room)


@entry_point
def _substitute_complex(lower: ComplexEntries, upper: ComplexEntries, x: Complex2) -> None:
    _substitute(lower, upper, x)
