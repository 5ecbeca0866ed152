"""Averages of successive frames, as a recording."""

from dataclasses import replace

import numpy as np
import pandas as pd

from eitskin.data.check.measures import NORMAL, column_statistic
from eitskin.data.recording import Recording
from eitskin.data.subset import of_frames

LEAST_FRAMES = 4  # of an average: of fewer hardly one stands out
OUTLYING = 8.0  # standard deviations from a block's median: beyond chance in short blocks too


def averages(recorded: Recording, count: int) -> Recording:
    """Averages of `count` blocks of successive frames, in each of which nobody touches.

    An average has the number, the time and the session of the middle frame of its block, and is
    over the block's frames of that session. Left out are readings that stand out of their block
    (Hampel 1974, J. Am. Stat. Assoc. 69, 383, with the spread of its channel, or of most channels
    where that is larger, in all blocks); of lost readings alone an average is lost. Raises
    ValueError for fewer than LEAST_FRAMES a block.
    """
    total = len(recorded.frames)
    if total < LEAST_FRAMES * count:
        raise ValueError(f"{total} frames are too few for {count} averages")
    sessions = recorded.frames.get("session", pd.Series(0, recorded.frames.index))
    session = pd.factorize(sessions)[0]
    blocks = np.array_split(np.arange(total), count)
    middle = np.array([block[len(block) // 2] for block in blocks])
    blocks = [
        block[session[block] == session[row]] for block, row in zip(blocks, middle, strict=True)
    ]
    is_middle = np.zeros(total, bool)
    is_middle[middle] = True
    return replace(
        of_frames(recorded, is_middle),
        voltage=_block_means(recorded.readings, blocks),
        quadrature=None
        if recorded.quadrature is None
        else _block_means(recorded.quadrature, blocks),
    )


def _block_means(values: np.ndarray, blocks: list[np.ndarray]) -> np.ndarray:
    """(B, M): means of values (N, M) over blocks of rows, without outliers."""
    medians = [column_statistic(np.nanmedian, values[block]) for block in blocks]
    deviations = [
        np.abs(values[block] - median) for block, median in zip(blocks, medians, strict=True)
    ]
    spread = NORMAL * column_statistic(np.nanmedian, np.concatenate(deviations))
    limit = OUTLYING * np.fmax(spread, np.nanmedian(spread))
    plain = [
        np.where(deviation <= limit, values[block], np.nan)
        for block, deviation in zip(blocks, deviations, strict=True)
    ]
    counts = np.array([np.isfinite(rows).sum(axis=0) for rows in plain])
    sums = np.array([np.nansum(rows, axis=0) for rows in plain])
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
