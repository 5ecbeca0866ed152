"""Independent parts of one computation, on as many cores as there are.

Products of large arrays leave the interpreter to other threads, so that threads are enough. Each
part is computed as it would be alone: the bytes of a result do not depend on how many cores there
are. OMP_NUM_THREADS, where it is set, says how many may be used.
"""

import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import TypeVar

Part = TypeVar("Part")
Result = TypeVar("Result")

_here = threading.local()


def allowed() -> int:
    """How many cores may be used: OMP_NUM_THREADS, of a list its first, else those of this
    process."""
    said = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0].strip()
    return max(int(said), 1) if said.isdecimal() else len(os.sched_getaffinity(0))


def each(of: Callable[[Part], Result], parts: Iterable[Part]) -> list[Result]:
    """A function of every part, in their order. What a part does in parts of its own stays on its
    core."""
    parts = list(parts)
    count = min(allowed(), len(parts))
    if count < 2 or getattr(_here, "busy", False):
        return [of(part) for part in parts]

    def alone(part: Part) -> Result:
        _here.busy = True
        return of(part)

    return list(_pool(count).map(alone, parts))


@lru_cache
def _pool(count: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count)


os.register_at_fork(after_in_child=_pool.cache_clear)
