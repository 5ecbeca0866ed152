"""Groups of touches at one place of the skin."""

import numpy as np
import pandas as pd
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from eitskin.data.recording import ONE_PLACE_MM

BLOCKS_ACROSS = 8  # square blocks across a skin touched all over: enough for a split by places


def places(xy: np.ndarray) -> tuple[np.ndarray, str]:
    """Place (N,) int64 of each touch at `xy` (N, 2) in mm, and the rule of the grouping in words.

    Touches within ONE_PLACE_MM of each other, in chains, are one place (single linkage), so that
    jitter never splits a point that is pressed again. Where that gives more chains than half of the
    touches, or one wider than twice that distance, the skin was touched all over: then places are
    the cells of a square grid, BLOCKS_ACROSS over the wider span, so that leaving a place out
    leaves a neighbourhood out; a chain narrower than a cell lies in the cell of its mean.
    """
    chain = _chains(xy)
    side = float(np.ptp(xy, axis=0).max()) / BLOCKS_ACROSS or 1.0
    chained = pd.DataFrame(xy).groupby(chain)
    width = (chained.transform("max") - chained.transform("min")).to_numpy().max(axis=1)
    if chain.max() + 1 <= len(xy) / 2 and width.max() <= 2.0 * ONE_PLACE_MM:
        return chain, f"positions within {ONE_PLACE_MM:g} mm of each other, in chains"
    xy = np.where(width[:, None] <= side, chained.transform("mean").to_numpy(), xy)
    block = np.minimum((xy - xy.min(axis=0)) // side, BLOCKS_ACROSS - 1)
    place = np.unique(block, axis=0, return_inverse=True)[1].astype(np.int64)
    return place, f"square blocks of {side:.1f} mm"


def _chains(xy: np.ndarray) -> np.ndarray:
    """(N,) int64: the chain of each position, numbered by first appearance; neighbours in a chain
    are at most ONE_PLACE_MM apart (single linkage).
    """
    positions, position_index = np.unique(xy, axis=0, return_inverse=True)
    neighbours = cKDTree(positions).query_pairs(ONE_PLACE_MM, output_type="ndarray")
    shape = (len(positions), len(positions))
    links = coo_array((np.ones(len(neighbours)), (neighbours[:, 0], neighbours[:, 1])), shape=shape)
    chain = connected_components(links, directed=False)[1]
    return pd.factorize(chain[position_index])[0].astype(np.int64)
