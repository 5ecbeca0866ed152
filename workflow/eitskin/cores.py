"""Parts of one computation on several cores.

Products of large arrays release the interpreter, so that threads suffice for them. Parts that keep
the interpreter busy run in a process each. Each part is computed as it would be alone: the bytes of
a result do not depend on the number of cores. OMP_NUM_THREADS limits the cores used.
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

MAX_PROCESSES = 2  # at once: each takes memory of its own
WAKING_MS = 500  # longest wait before an interrupt is noticed
PR_SET_PDEATHSIG = 1  # of Linux's prctl
_thread_state = threading.local()


def allowed() -> int:
    """Number of cores that may be used: the first number of OMP_NUM_THREADS, else the affinity
    of this process."""
    setting = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0].strip()
    return max(int(setting), 1) if setting.isdecimal() else len(os.sched_getaffinity(0))


def seconds() -> float:
    """Processor seconds of this process and of its finished children."""
    return sum(os.times()[:4])


def threaded(function: Callable[[Part], Result], parts: Iterable[Part]) -> list[Result]:
    """The results of a function of every part, in order, on threads. Parts within a part run on
    its thread."""
    parts = list(parts)
    count = min(allowed(), len(parts))
    if count < 2 or getattr(_thread_state, "busy", False):
        return [function(part) for part in parts]

    def alone(part: Part) -> Result:
        _thread_state.busy = True
        return function(part)

    return list(_pool(count).map(alone, parts))


def at_once() -> int:
    """How many processes `forked` runs at once; 1 within a part."""
    return 1 if getattr(_thread_state, "busy", False) else min(allowed(), MAX_PROCESSES)


def shares(groups: Iterable[Sequence[Part]]) -> list[list[Part]]:
    """Parts in as many shares of similar size as `forked` may have processes; a group is not
    divided."""
    parts_by_share: list[list[Part]] = [[] for _ in range(MAX_PROCESSES)]
    for group in sorted(groups, key=len, reverse=True):
        min(parts_by_share, key=len).extend(group)
    return [share for share in parts_by_share if share]


def spread(function: Callable[[Part], Result], parts: Iterable[Part]) -> list[Result]:
    """The results of a function of every part, in order, by as many processes as `forked` runs
    at once, or in this process where that is one."""
    parts, count = list(parts), at_once()
    if count < 2:
        return [function(part) for part in parts]
    shares = [parts[offset::count] for offset in range(min(count, len(parts)))]
    share_results = forked(lambda share: [function(part) for part in share], shares)
    return [share_results[n % len(shares)][n // len(shares)] for n in range(len(parts))]


def forked(
    function: Callable[[Part], Result], parts: Iterable[Part], shared: Sequence[Any] = ()
) -> list[Result]:
    """The results of a function of every part, in order, each in a process forked from this one;
    only the result of a part survives. shared: objects of this process that a result may refer to;
    they are returned as the same objects.

    At most MAX_PROCESSES run at once. An exception of a part is raised here; MemoryError where its
    process was killed or could not be forked, RuntimeError where it ended without an answer.
    """
    parts = list(parts)
    limit = at_once()
    busy = getattr(_thread_state, "busy", False) or min(limit, len(parts)) > 1
    results: dict[int, Any] = {}
    running: dict[int, tuple[int, int]] = {}  # by what is read: the part and its process
    started = 0
    try:
        while len(results) < len(parts):
            while started < len(parts) and len(running) < limit:
                with _uninterrupted():
                    answer, process = _forked_process(
                        partial(function, parts[started]), shared, [*running], busy
                    )
                    running[answer] = started, process
                started += 1
            for answer, _ in _readable(running):
                written = _read_all(answer)
                with _uninterrupted():
                    number, process = running.pop(answer)
                    os.close(answer)
                    ended = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
                results[number] = _answer(written, ended, shared)
    finally:
        with _uninterrupted():
            for _, process in running.values():
                os.kill(process, signal.SIGKILL)
            for answer, (_, process) in running.items():
                os.close(answer)
                os.waitpid(process, 0)
    return [results[number] for number in range(len(parts))]


def _forked_process(
    function: Callable[[], Any], shared: Sequence[Any], open_pipes: list[int], busy: bool
) -> tuple[int, int]:
    """Fork a process for one part; returns the pipe of its answer and its number. open_pipes:
    those of other processes, which it must close."""
    _end_threads()
    sys.stdout.flush()
    sys.stderr.flush()
    answer, pipe_end = os.pipe()
    parent = os.getpid()
    try:
        process = os.fork()
    except OSError as error:
        os.close(answer)
        os.close(pipe_end)
        raise MemoryError(f"no process could be forked: {error.strerror}") from error
    if process:
        os.close(pipe_end)
        return answer, process
    code = 1
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever waits for the answer ends this
        _end_with(parent)
        for descriptor in (answer, *open_pipes):
            os.close(descriptor)
        _thread_state.busy = busy
        with os.fdopen(pipe_end, "wb") as file:
            file.write(_outcome(function, shared))
        code = 0
    except BrokenPipeError:
        pass  # nobody waits for it any more
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _end_with(parent: int) -> None:
    """Let this process be killed when its parent ends."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


class _Pickler(pickle.Pickler):
    """Writes shared objects as numbers."""

    def __init__(self, file: IO[bytes], shared: Sequence[Any]):
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self._numbers = {id(instance): number for number, instance in enumerate(shared)}

    def persistent_id(self, instance: Any) -> int | None:
        return self._numbers.get(id(instance))


class _Unpickler(pickle.Unpickler):
    """Reads the output of `_Pickler`."""

    def __init__(self, file: IO[bytes], shared: Sequence[Any]):
        super().__init__(file)
        self._shared = shared

    def persistent_load(self, number: int) -> Any:
        return self._shared[number]


def _outcome(function: Callable[[], Any], shared: Sequence[Any]) -> bytes | memoryview:
    """The pickled result of a function, or its exception."""
    try:
        with threadpool_limits(1):  # a fork of OpenBLAS begins with threads of its own
            file = io.BytesIO()
            _Pickler(file, shared).dump((function(), None))
            return file.getbuffer()
    except Exception as error:
        trace = traceback.format_exc()
        error.add_note(trace)
        try:
            written = pickle.dumps((None, error))
            pickle.loads(written)
        except Exception:
            return pickle.dumps((None, RuntimeError(trace)))
        return written


def _readable(running: dict[int, tuple[int, int]]) -> list[tuple[int, int]]:
    waiting = select.poll()
    for answer in running:
        waiting.register(answer, select.POLLIN)
    # Not for ever: what is interrupted just before it waits learns of it only when it wakes.
    while not (events := waiting.poll(WAKING_MS)):
        pass
    return events


def _read_all(answer: int) -> bytes:
    with os.fdopen(answer, "rb", closefd=False) as file:
        return file.read()


def _answer(written: bytes, exit_code: int, shared: Sequence[Any]) -> Any:
    """The result of a process with this output and exit code."""
    if exit_code == -signal.SIGKILL:
        raise MemoryError("a process was killed, perhaps for want of memory")
    if exit_code:
        raise RuntimeError(f"a process ended with code {exit_code}, no answer")
    value, error = _Unpickler(io.BytesIO(written), shared).load()
    if error is not None:
        raise error
    return value


@contextlib.contextmanager
def _uninterrupted() -> Iterator[None]:
    """Hold back Ctrl-C until a process is registered, or has ended."""
    previous_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous_mask)


def _pool(count: int) -> ThreadPoolExecutor:
    """This thread's pool of threads."""
    pools = vars(_thread_state).setdefault("pools", {})
    if count not in pools:
        pools[count] = ThreadPoolExecutor(count)
    return pools[count]


def _end_threads() -> None:
    """End the threads of the pools: a forked process could wait forever for their locks."""
    pools = vars(_thread_state).get("pools", {})
    while pools:
        pools.popitem()[1].shutdown()


os.register_at_fork(after_in_child=lambda: vars(_thread_state).pop("pools", None))
