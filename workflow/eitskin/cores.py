"""Parts of one computation, on as many cores as there are.

Products of large arrays leave the interpreter to other threads, so that for them threads are
enough. What keeps the interpreter busy has a process a part. Each part is computed as it would be
alone: the bytes of a result do not depend on how many cores there are. OMP_NUM_THREADS, where it is
set, says how many may be used.
"""

import io
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

Part = TypeVar("Part")
Result = TypeVar("Result")

_FORK = get_context("fork")
_here = threading.local()
_pools: dict[int, ThreadPoolExecutor] = {}


def allowed() -> int:
    """How many cores may be used: OMP_NUM_THREADS, of a list its first, else those of this
    process."""
    said = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0].strip()
    return max(int(said), 1) if said.isdecimal() else len(os.sched_getaffinity(0))


def seconds() -> float:
    """Processor seconds of this process, and of those that it has forked and that have ended."""
    return sum(os.times()[:4])


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


def forked(
    of: Callable[[Part, Sequence[Result]], Result],
    parts: Iterable[Part],
    shared: Iterable[object] = (),
    behind: int = 1,
) -> list[Result]:
    """A function of every part and of the results so far, in their order, each in a process of its
    own that is forked from this one: what it changes but its result is lost.

    The results so far are those of all parts but the `behind` - 1 just before: so many may run at
    once, and how many do changes no result. shared: objects that results refer to and that are not
    copied on their way back. What a part raises is raised here; RuntimeError where its process
    ended without an answer.
    """
    parts, shared = list(parts), list(shared)
    most = 1 if getattr(_here, "busy", False) else allowed()
    found: list[Any] = []
    late: dict[int, Any] = {}
    running: dict[Connection, tuple[int, BaseProcess]] = {}
    begun = 0
    _end_threads()
    try:
        while len(found) < len(parts):
            while begun < len(parts) and begun < len(found) + behind and len(running) < most:
                known = found[: max(begun + 1 - behind, 0)]
                there, here = _FORK.Pipe(duplex=False)
                arguments = here, of, parts[begun], known, shared, min(most, behind) > 1
                process: BaseProcess = _FORK.Process(target=_answered, args=arguments)
                process.start()
                here.close()
                running[there] = begun, process
                begun += 1
            for connection in wait(list(running)):
                assert isinstance(connection, Connection)
                number, answering = running[connection]
                late[number] = _received(connection, answering, shared)
                del running[connection]
            while len(found) in late:
                found.append(late.pop(len(found)))
    finally:
        for connection, (_, answering) in running.items():
            answering.kill()
            answering.join()
            connection.close()
    return found


def _answered(
    answer: Connection,
    of: Callable[[Part, Sequence[Result]], Result],
    part: Part,
    known: list[Result],
    shared: list[object],
    busy: bool,
) -> None:
    """Sends what a function has of a part, or what it raises."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever waits for the answer ends this process
    _here.busy = busy
    try:
        with threadpool_limits(1):  # a fork of OpenBLAS begins with threads of its own
            result: tuple[Any, BaseException | None] = of(part, known), None
    except Exception as error:
        result = None, error
    written = io.BytesIO()
    _Written(written, shared).dump(result)
    answer.send_bytes(written.getbuffer())


def _received(connection: Connection, process: BaseProcess, shared: list[object]) -> Any:
    try:
        written = connection.recv_bytes()
    except EOFError:
        process.join()
        raise RuntimeError(f"a process ended with code {process.exitcode}, no answer") from None
    finally:
        connection.close()
    process.join()
    result, error = _Read(io.BytesIO(written), shared).load()
    if error is not None:
        raise error
    return result


class _Written(pickle.Pickler):
    """Writes shared objects as their number: a fork has them where they are here."""

    def __init__(self, file: io.BytesIO, shared: list[object]):
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self.number = {id(one): number for number, one in enumerate(shared)}

    def persistent_id(self, obj: object) -> int | None:
        """The number of a shared object."""
        return self.number.get(id(obj))


class _Read(pickle.Unpickler):
    def __init__(self, file: io.BytesIO, shared: list[object]):
        super().__init__(file)
        self.shared = shared

    def persistent_load(self, pid: int) -> object:
        """The shared object of a number."""
        return self.shared[pid]


def _pool(count: int) -> ThreadPoolExecutor:
    if count not in _pools:
        _pools[count] = ThreadPoolExecutor(count)
    return _pools[count]


def _end_threads() -> None:
    """What is forked from a process with threads may wait forever for what they hold."""
    while _pools:
        _pools.popitem()[1].shutdown()


os.register_at_fork(after_in_child=_pools.clear)
