"""Pure tasks, run here one after the other, or by the workers of a dask cluster.

If a worker dies, another repeats its task with the same result. Errors of tasks are raised here.
"""

from __future__ import annotations

import importlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import reduce
from operator import itemgetter
from typing import Any, TypeVar

from truenewton.errors import ClusterFailed, TrueNewtonError

Item = TypeVar("Item")
Own = TypeVar("Own")
Shared = TypeVar("Shared")

FAN = 8  # results that are added at once
PATIENCE = "10s"  # for a scheduler to answer
Client = Any  # a `dask.distributed.Client`


def each(
    function: Callable[[Item], Own], items: Iterable[Item], client: Client | None = None
) -> Iterator[Own]:
    """Yield the result of a function for each item, in order; raise the first error of a function.

    Raises `ClusterFailed` if the workers cannot do it.
    """
    if client is None:
        yield from map(function, items)
        return
    futures = deque(client.map(function, list(items), pure=False))
    while futures:
        yield _result(futures.popleft())


def divided(
    function: Callable[[Item], tuple[Own, Shared]],
    items: Iterable[Item],
    take: Callable[[Own], None],
    add: Callable[[Shared, Shared], Shared],
    client: Client | None = None,
) -> Shared:
    """Return the sum of the second results of a function, and pass each first result to ``take``.

    ``function`` returns two results for an item, ``take`` gets the first ones in order, and ``add``
    adds two second ones; on workers as a tree, so that few results are transferred.
    """
    if client is None:
        total: Shared | None = None
        for item in items:
            own, shared = function(item)
            take(own)
            total = shared if total is None else add(total, shared)
        return total  # type: ignore[return-value]
    both = client.map(function, list(items), pure=False)
    own_parts, parts = (client.map(itemgetter(k), both, pure=False) for k in (0, 1))
    del both
    while len(parts) > 1:
        several = (parts[start : start + FAN] for start in range(0, len(parts), FAN))
        parts = [client.submit(_added, add, some, pure=False) for some in several]
    futures = deque(own_parts)
    del own_parts
    while futures:
        take(_result(futures.popleft()))
    result: Shared = _result(parts[0])
    return result


def _added(add: Callable[[Shared, Shared], Shared], parts: list[Shared]) -> Shared:
    return reduce(add, parts)


def _result(future: Any) -> Any:
    """Return the result of a future; a failure of the cluster becomes `ClusterFailed`."""
    try:
        return future.result()
    except TrueNewtonError:
        raise
    except Exception as error:
        text = str(error).strip().splitlines()
        raise ClusterFailed(
            f"the workers cannot do their part: {type(error).__name__}"
            + (f", {text[0]}" if text else ""),
            remedy="give them the same truenewton, dask and numpy as here, the same files under"
            " the same paths, and memory",
        ) from error


@contextmanager
def connected(address: str | None) -> Iterator[Client | None]:
    """Connect to the scheduler at an address like tcp://host:8786; None without an address.

    Raises `ClusterFailed` if no scheduler answers, or dask is not installed.
    """
    if address is None:
        yield None
        return
    try:
        distributed: Any = importlib.import_module("distributed")
    except ModuleNotFoundError as error:
        raise ClusterFailed(
            f"--cluster needs dask, and there is no {error.name}",
            remedy="install the extra: pip install 'truenewton[cluster]'",
        ) from None
    try:
        client = distributed.Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise ClusterFailed(
            f"no dask scheduler answers at {address}",
            remedy="start one with `dask scheduler`, and give the address that it prints, as"
            " tcp://host:8786",
        ) from error
    try:
        yield client
    finally:
        client.close()
