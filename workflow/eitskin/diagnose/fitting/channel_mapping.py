"""Effects fitted at the drives, measuring pairs or channels of a recording, in readings by other
channels.

What electrodes, skin and touch do holds for any channel. A gain or an offset holds at its site: for
the same drive (source, sink), the same pair (plus, minus), the same channel.
"""

from dataclasses import replace

import numpy as np

from eitskin.effects.effect import Setting, site_of

# The columns of a channel table (source, sink, plus, minus) that are a site of this kind.
SITE_COLUMNS = {"drives": slice(0, 2), "measures": slice(2, 4), "channels": slice(0, 4)}


def mapped_setting(
    setting: Setting,
    recording_channels: np.ndarray,
    query_channels: np.ndarray,
    unmapped_share: float = 0.0,
) -> Setting:
    """A setting at a recording's channels (M, 4) as one at a query's channels (Q, 4).

    At sites that the recording does not have the value is the neutral one plus `unmapped_share`
    times the root mean square of the deviations from neutral over the recording's sites. A setting
    of electrodes, or without sites, is returned as it is.
    """
    if setting.kind not in SITE_COLUMNS or np.array_equal(recording_channels, query_channels):
        return setting
    row = _matching_rows(setting.kind, recording_channels, query_channels)
    values = dict(setting.values)
    for key, value in setting.values.items():
        if np.ndim(value):
            neutral = setting.effect.parameters[key].neutral
            by_channel = setting.at_channels(key, recording_channels)
            sites = np.unique(site_of(setting.kind, recording_channels), return_index=True)[1]
            spread = np.sqrt(np.mean((by_channel[sites] - neutral) ** 2))
            values[key] = np.where(row < 0, neutral + unmapped_share * spread, by_channel[row])
    return replace(setting, kind="channels", sites=np.arange(len(query_channels)), values=values)


def unmapped_channels(
    setting: Setting, recording_channels: np.ndarray, query_channels: np.ndarray
) -> np.ndarray:
    """Rows, ascending, of a query's channels (Q, 4) whose drive, pair or channel, whichever the
    setting is at, is none of the recording's channels (M, 4)."""
    if setting.kind not in SITE_COLUMNS:
        return np.array([], dtype=int)
    return np.flatnonzero(_matching_rows(setting.kind, recording_channels, query_channels) < 0)


def _matching_rows(
    kind: str, recording_channels: np.ndarray, query_channels: np.ndarray
) -> np.ndarray:
    """(Q,): for each of a query's channels a row of the recording's channels at the same site, -1
    where there is none."""
    recording_sites, query_sites = (
        table[:, SITE_COLUMNS[kind]] for table in (recording_channels, query_channels)
    )
    matches = (recording_sites[None] == query_sites[:, None]).all(axis=2)
    return np.where(matches.any(axis=1), matches.argmax(axis=1), -1)
