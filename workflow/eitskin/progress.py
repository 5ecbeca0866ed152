"""What takes long says how far it is and how long it will take."""

import sys
import time
from collections.abc import Iterable, Iterator, Sized
from typing import TypeVar

from tqdm import tqdm

QUIET_S = 5.0  # in which nobody wonders
LINE_S = 30.0  # from one line of a log to the next

Item = TypeVar("Item")


def patient(items: Iterable[Item], doing: str, shown: bool = True) -> Iterable[Item]:
    """The items; where it is `shown`, stderr says how many are done and what time is left: by a bar
    after QUIET_S, in a log by a line every LINE_S."""
    if not shown:
        return items
    total = len(items) if isinstance(items, Sized) else None
    if sys.stderr.isatty():
        return tqdm(items, doing, total, leave=False, delay=QUIET_S, mininterval=1.0)
    return _logged(items, doing, total)


def _logged(items: Iterable[Item], doing: str, total: int | None) -> Iterator[Item]:
    begun = said = time.monotonic()
    for done, item in enumerate(items):
        now = time.monotonic()
        if done and now - said >= LINE_S:
            words = f"{doing}: {done}"
            if total is not None:
                words += f" of {total}, {_clock((total - done) * (now - begun) / done)} left"
            print(words, file=sys.stderr, flush=True)
            said = now
        yield item


def _clock(seconds: float) -> str:
    """Minutes and seconds."""
    return f"{round(seconds) // 60}:{round(seconds) % 60:02d}"
