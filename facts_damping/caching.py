"""Values that runs of one process share, by the content that they were made from."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

T = TypeVar("T")
K = TypeVar("K", bound="Hashable")

MAX_SHARED = 256  # largest number of values of a kind per process; some kB each


def shared(cache: dict[K, T], key: K, make: Callable[[], T], maximum: int = MAX_SHARED) -> T:
    """The cached value of a key, made if missing; the oldest value is dropped when the cache is full."""
    if key not in cache:
        if len(cache) >= maximum:
            cache.pop(next(iter(cache)), None)
        cache[key] = make()
    return cache[key]
