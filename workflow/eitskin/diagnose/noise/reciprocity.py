"""The halves of reciprocity: what reciprocal channels have in common, and how they differ."""

import numpy as np

from eitskin.physics.protocol import tied_channels


def parity(channels: np.ndarray, signed: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal combinations of channels (M, 4): the odd half (M, P), which a passive, linear
    skin leaves at 0 whatever its state, and the even half (M, M - P).

    Channels that reciprocity ties to one value (up to sign; all alike where not `signed`) give
    their mean to the even half and their contrasts (Helmert) to the odd half.
    """
    count = len(channels)
    group, sign = tied_channels(channels)
    if not signed:
        sign[:] = 1.0
    odd, even = [], []
    for label in np.unique(group):
        members = np.flatnonzero(group == label)
        mean = np.zeros(count)
        mean[members] = sign[members] / np.sqrt(len(members))
        even.append(mean)
        for k in range(1, len(members)):
            contrast = np.zeros(count)
            contrast[members[:k]] = sign[members[:k]]
            contrast[members[k]] = -k * sign[members[k]]
            odd.append(contrast / np.sqrt(k * (k + 1)))
    return np.array(odd).reshape(-1, count).T, np.array(even).reshape(-1, count).T
