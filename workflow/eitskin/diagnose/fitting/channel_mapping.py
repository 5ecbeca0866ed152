"""Effects found at drives, measuring pairs or channels of one table, in readings by another one.

What electrodes, skin and touch do holds for any channel. A gain or an offset holds where it was
found: for the same drive (source, sink), the same pair (plus, minus), the same channel.
"""

from dataclasses import replace

import numpy as np

from eitskin.effects.effect import Setting, site_of

NAMED_BY = {"drives": slice(0, 2), "measures": slice(2, 4), "channels": slice(0, 4)}


def carried(
    setting: Setting, recorded: np.ndarray, asked: np.ndarray, unlike: float = 0.0
) -> Setting:
    """A setting of channels recorded (M, 4) as one of channels asked for (Q, 4).

    Where nothing was found it does nothing, or differs from that by `unlike` times what sites of
    the recording do, in the root of their mean square.
    """
    if setting.kind not in NAMED_BY or np.array_equal(recorded, asked):
        return setting
    row = _rows(setting.kind, recorded, asked)
    values = dict(setting.values)
    for key, value in setting.values.items():
        if np.ndim(value):
            neutral = setting.effect.parameters[key].neutral
            there = setting.at_channels(key, recorded)
            sites = np.unique(site_of(setting.kind, recorded), return_index=True)[1]
            spread = np.sqrt(np.mean((there[sites] - neutral) ** 2))
            values[key] = np.where(row < 0, neutral + unlike * spread, there[row])
    return replace(setting, kind="channels", sites=np.arange(len(asked)), values=values)


def unknown(setting: Setting, recorded: np.ndarray, asked: np.ndarray) -> np.ndarray:
    """Which of the channels asked for (Q, 4) are at no drive, pair or channel of those recorded
    (M, 4), whichever the setting is found at: rows, ascending."""
    if setting.kind not in NAMED_BY:
        return np.array([], dtype=int)
    return np.flatnonzero(_rows(setting.kind, recorded, asked) < 0)


def _rows(kind: str, recorded: np.ndarray, asked: np.ndarray) -> np.ndarray:
    """(Q,): a row of the channels recorded (M, 4) at the same site as each asked for, -1: none."""
    own, wanted = (table[:, NAMED_BY[kind]] for table in (recorded, asked))
    same = (own[None] == wanted[:, None]).all(axis=2)
    return np.where(same.any(axis=1), same.argmax(axis=1), -1)
