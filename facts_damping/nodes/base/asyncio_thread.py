"""An asyncio event loop in a second thread: it serves sockets while the node waits for messages."""

from __future__ import annotations

import asyncio
from threading import Thread
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine
    from concurrent.futures import Future

T = TypeVar("T")


class AsyncioThread:
    """Event loop and its thread. Call `close` at the end."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()

    def begin(self, task: Coroutine[Any, Any, T]) -> Future[T]:
        """Start a task. Its future can also cancel it."""
        return asyncio.run_coroutine_threadsafe(task, self._loop)

    def wait(self, task: Coroutine[Any, Any, T]) -> T:
        """Run a task and wait for its result."""
        return self.begin(task).result()

    def soon(self, act: Callable[..., object], *arguments: Any) -> None:
        """Schedule a call in the loop's thread."""
        self._loop.call_soon_threadsafe(act, *arguments)

    def close(self) -> None:
        """Cancel all running tasks and end the thread."""
        self.wait(_cancel_all())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


async def _cancel_all() -> None:
    this_task = asyncio.current_task()
    others = [task for task in asyncio.all_tasks() if task is not this_task]
    while others:  # a task that is about to finish may miss the first cancellation
        for task in others:
            task.cancel()
        others = list((await asyncio.wait(others, timeout=0.1))[1])
