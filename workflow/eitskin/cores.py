"""Parts of one computation, on as many cores as there are.

Products of large arrays leave the interpreter to other threads, so that for them threads are
enough. What keeps the interpreter busy has a process a part. Each part is computed as it would be
alone: the bytes of a result do not depend on how many cores there are. OMP_NUM_THREADS, where it is
set, says how many may be used.
"""

import contextlib
import ctypes
import io
import os
import pickle
import select
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import IO, Any, TypeVar

from threadpoolctl import threadpool_limits

Part = TypeVar("Part")
Result = TypeVar("Result")

AT_ONCE = 2  # processes
WAKING_MS = 500
PR_SET_PDEATHSIG = 1  # of Linux's prctl
_here = threading.local()


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


def at_once() -> int:
    """How many processes `forked` has at once: one in what is a part itself."""
    return 1 if getattr(_here, "busy", False) else min(allowed(), AT_ONCE)


def shares(groups: Iterable[Sequence[Part]]) -> list[list[Part]]:
    """Parts in as many shares as `forked` may have processes, of about as many each; what stands in
    one group stays together."""
    found: list[list[Part]] = [[] for _ in range(AT_ONCE)]
    for group in sorted(groups, key=len, reverse=True):
        min(found, key=len).extend(group)
    return [share for share in found if share]


def spread(of: Callable[[Part], Result], parts: Iterable[Part]) -> list[Result]:
    """A function of every part, in their order: shared among as many processes as `forked` has at
    once, or in this one where that is one."""
    parts, count = list(parts), at_once()
    if count < 2:
        return [of(part) for part in parts]
    shares = [parts[first::count] for first in range(min(count, len(parts)))]
    found = forked(lambda share: [of(part) for part in share], shares)
    return [found[n % len(shares)][n // len(shares)] for n in range(len(parts))]


def forked(
    of: Callable[[Part], Result], parts: Iterable[Part], shared: Sequence[Any] = ()
) -> list[Result]:
    """A function of every part, in their order, each in a process of its own that is forked from
    this one: what it changes but its result is lost. shared: objects of this process that a result
    may refer to; in what is returned they are the same objects.

    At most AT_ONCE run at once: each takes memory of its own. What a part raises is raised here;
    MemoryError where its process was killed or could not begin, RuntimeError where it ended without
    an answer.
    """
    parts = list(parts)
    most = at_once()
    busy = getattr(_here, "busy", False) or min(most, len(parts)) > 1
    found: dict[int, Any] = {}
    running: dict[int, tuple[int, int]] = {}  # by what is read: the part and its process
    begun = 0
    try:
        while len(found) < len(parts):
            while begun < len(parts) and len(running) < most:
                with _uninterrupted():
                    answer, process = _begun(partial(of, parts[begun]), shared, [*running], busy)
                    running[answer] = begun, process
                begun += 1
            for answer, _ in _readable(running):
                written = _read_all(answer)
                with _uninterrupted():
                    number, process = running.pop(answer)
                    os.close(answer)
                    ended = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
                found[number] = _answer(written, ended, shared)
    finally:
        with _uninterrupted():
            for _, process in running.values():
                os.kill(process, signal.SIGKILL)
            for answer, (_, process) in running.items():
                os.close(answer)
                os.waitpid(process, 0)
    return [found[number] for number in range(len(parts))]


def _begun(
    of: Callable[[], Any], shared: Sequence[Any], others: list[int], busy: bool
) -> tuple[int, int]:
    """What a forked process's answer is read from, and its number; others: what those of others
    are read from, which it must not hold open."""
    _end_threads()
    sys.stdout.flush()
    sys.stderr.flush()
    answer, there = os.pipe()
    parent = os.getpid()
    try:
        process = os.fork()
    except OSError as error:
        os.close(answer)
        os.close(there)
        raise MemoryError(f"no process could be forked: {error.strerror}") from error
    if process:
        os.close(there)
        return answer, process
    code = 1
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever waits for the answer ends this
        _end_with(parent)
        for held in (answer, *others):
            os.close(held)
        _here.busy = busy
        with os.fdopen(there, "wb") as file:
            file.write(_told(of, shared))
        code = 0
    except BrokenPipeError:
        pass  # nobody waits for it any more
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _end_with(parent: int) -> None:
    """This process is killed when the one that forked it ends, however that does."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


class _Pickler(pickle.Pickler):
    """Writes shared objects by their numbers."""

    def __init__(self, file: IO[bytes], shared: Sequence[Any]):
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self._numbers = {id(one): number for number, one in enumerate(shared)}

    def persistent_id(self, one: Any) -> int | None:
        return self._numbers.get(id(one))


class _Unpickler(pickle.Unpickler):
    """Reads what `_Pickler` has written."""

    def __init__(self, file: IO[bytes], shared: Sequence[Any]):
        super().__init__(file)
        self._shared = shared

    def persistent_load(self, number: int) -> Any:
        return self._shared[number]


def _told(of: Callable[[], Any], shared: Sequence[Any]) -> bytes | memoryview:
    """What a function returns, or what it raises, as bytes."""
    try:
        with threadpool_limits(1):  # a fork of OpenBLAS begins with threads of its own
            file = io.BytesIO()
            _Pickler(file, shared).dump((of(), None))
            return file.getbuffer()
    except Exception as error:
        where = traceback.format_exc()
        error.add_note(where)
        try:
            written = pickle.dumps((None, error))
            pickle.loads(written)
        except Exception:
            return pickle.dumps((None, RuntimeError(where)))
        return written


def _readable(running: dict[int, tuple[int, int]]) -> list[tuple[int, int]]:
    waiting = select.poll()
    for answer in running:
        waiting.register(answer, select.POLLIN)
    # Not for ever: what is interrupted just before it waits learns of it only when it wakes.
    while not (found := waiting.poll(WAKING_MS)):
        pass
    return found


def _read_all(answer: int) -> bytes:
    with os.fdopen(answer, "rb", closefd=False) as file:
        return file.read()


def _answer(written: bytes, ended: int, shared: Sequence[Any]) -> Any:
    """What a process that ended so has told."""
    if ended == -signal.SIGKILL:
        raise MemoryError("a process was killed, perhaps for want of memory")
    if ended:
        raise RuntimeError(f"a process ended with code {ended}, no answer")
    result, error = _Unpickler(io.BytesIO(written), shared).load()
    if error is not None:
        raise error
    return result


@contextlib.contextmanager
def _uninterrupted() -> Iterator[None]:
    """Ctrl-C waits until what has begun is known, or has ended."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _pool(count: int) -> ThreadPoolExecutor:
    """Of this thread's own."""
    pools = vars(_here).setdefault("pools", {})
    if count not in pools:
        pools[count] = ThreadPoolExecutor(count)
    return pools[count]


def _end_threads() -> None:
    """What is forked from a process with threads may wait forever for what they hold."""
    pools = vars(_here).get("pools", {})
    while pools:
        pools.popitem()[1].shutdown()


os.register_at_fork(after_in_child=lambda: vars(_here).pop("pools", None))
