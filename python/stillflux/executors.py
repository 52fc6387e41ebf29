"""Executors for `sweep` where a library's own interface is not that of `concurrent.futures`.

Dask needs none: `sf.sweep(…, executor=client)` with a `distributed.Client`.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from threading import Thread
from typing import Any

from stillflux.frames import needed

__all__ = ["Ray", "joblib"]


def joblib(workers: int | None = None) -> Any:
    """joblib's pool of processes (loky), which also sends functions that cannot be imported."""
    return needed("joblib.externals.loky", "joblib").get_reusable_executor(max_workers=workers)


class Ray:
    """Tasks on a Ray cluster; `ray.init()` is called if it was not. Keywords are those of
    `RemoteFunction.options`, such as `num_cpus=1`."""

    def __init__(self, **options: Any) -> None:
        self._ray = needed("ray", "ray")
        if not self._ray.is_initialized():
            self._ray.init()
        self._options = options

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """A future of the result."""
        remote = self._ray.remote(function)
        if self._options:
            remote = remote.options(**self._options)
        reference = remote.remote(*arguments)
        future: Future[Any] = Future()

        def wait() -> None:
            # A future that was cancelled meanwhile takes neither.
            with suppress(InvalidStateError):
                try:
                    future.set_result(self._ray.get(reference))
                except Exception as error:
                    future.set_exception(error)

        def ended(done: Future[Any]) -> None:
            if done.cancelled():
                self._ray.cancel(reference)

        future.add_done_callback(ended)
        Thread(target=wait, daemon=True).start()
        return future
