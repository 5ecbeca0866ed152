"""Progress and remaining time of long computations, on stderr."""

import sys
import time
from collections.abc import Iterable, Iterator, Sized
from typing import TypeVar

from tqdm import tqdm

from eitskin.errors import printable

QUIET_S = 5.0  # before a bar appears
LINE_S = 30.0  # from one line of a log to the next

Item = TypeVar("Item")


def patient(items: Iterable[Item], doing: str, shown: bool = True) -> Iterable[Item]:
    """The items; where it is `shown`, stderr says how many are done and what time is left: by a bar
    after QUIET_S, in a log by a line every LINE_S."""
    if not shown:
        return items
    doing = printable(doing)
    total = len(items) if isinstance(items, Sized) else None
    if sys.stderr.isatty():
        return tqdm(items, doing, total, leave=False, delay=QUIET_S, mininterval=1.0)
    return _logged(items, doing, total)


def _logged(items: Iterable[Item], doing: str, total: int | None) -> Iterator[Item]:
    start = last_line = time.monotonic()
    for done, element in enumerate(items):
        time_s = time.monotonic()
        if done and time_s - last_line >= LINE_S:
            words = f"{doing}: {done}"
            if total is not None:
                words += f" of {total}, {_clock((total - done) * (time_s - start) / done)} left"
            print(words, file=sys.stderr, flush=True)
            last_line = time_s
        yield element


def _clock(seconds: float) -> str:
    """Minutes and seconds."""
    return f"{round(seconds) // 60}:{round(seconds) % 60:02d}"
