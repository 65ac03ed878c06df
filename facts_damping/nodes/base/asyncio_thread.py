"""An event loop beside a node: sockets are served in a thread of their own, while the node waits for messages."""

from __future__ import annotations

import asyncio
from threading import Thread
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine
    from concurrent.futures import Future

T = TypeVar("T")


class AsyncioThread:
    """The loop and its thread, until `close`."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()

    def begin(self, task: Coroutine[Any, Any, T]) -> Future[T]:
        """Begin a task; its future, which cancels it, too."""
        return asyncio.run_coroutine_threadsafe(task, self._loop)

    def wait(self, task: Coroutine[Any, Any, T]) -> T:
        """Do a task, and wait for its end."""
        return self.begin(task).result()

    def soon(self, act: Callable[..., object], *given: Any) -> None:
        """Have something called in the loop."""
        self._loop.call_soon_threadsafe(act, *given)

    def close(self) -> None:
        """Cancel what still goes on, and end the thread."""
        self.wait(_cancel_all())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


async def _cancel_all() -> None:
    own = asyncio.current_task()
    others = [task for task in asyncio.all_tasks() if task is not own]
    while others:  # a task may be about to end of itself, and not hear of it the first time
        for task in others:
            task.cancel()
        others = list((await asyncio.wait(others, timeout=0.1))[1])
