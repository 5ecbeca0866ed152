"""What takes long says how far it is and how long it will take."""

from collections.abc import Iterable, Sized

from tqdm import tqdm

QUIET_S = 5.0  # in which nobody wonders


def patient(items: Iterable, doing: str, shown: bool = True) -> Iterable:
    """The items; after QUIET_S a bar on stderr says how many are done and what time is left."""
    total = len(items) if isinstance(items, Sized) else None
    off = None if shown else True  # None: off where nobody watches, as in a log
    return tqdm(items, doing, total, leave=False, delay=QUIET_S, mininterval=1.0, disable=off)
