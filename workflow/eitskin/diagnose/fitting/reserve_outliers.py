"""Reserved readings that measure nothing: told by reciprocity alone, without any simulation, so
that no fit has a part in which of them count."""

import numpy as np

from eitskin.data.recording import Recording
from eitskin.diagnose.noise.outliers import LOUD, SPIKE, robust_sd
from eitskin.diagnose.noise.reciprocity import parity

BEYOND = 2.0  # times the largest contrast that was kept elsewhere: a strong touch is no spike


def reserve_outliers(
    recording: Recording, reserve_mask: np.ndarray, rejected_mask: np.ndarray | None
) -> np.ndarray:
    """(N, M) bool: reserved readings whose reciprocal contrast is far off, and frames of them in
    which the typical contrast is; reserve_mask, rejected_mask (N, M): reserved readings, and others
    that were rejected (None: none).

    A passive, linear skin leaves contrasts of reciprocal channels at 0 whatever its state, so that
    these show what an instrument does. A contrast counts that is more than SPIKE of its sd from its
    median over frames, and BEYOND times as far as any that was kept elsewhere; all its channels are
    rejected, as it does not tell which is off. None where no channels are reciprocal.
    """
    outliers = np.zeros(reserve_mask.shape, bool)
    odd = parity(recording.channels, recording.metadata["voltage"] == "signed")[0]
    if not odd.shape[1]:
        return outliers
    part = (odd != 0.0).astype(float)
    lost = ~np.isfinite(recording.readings)
    contrasts = np.where(lost, 0.0, recording.readings) @ odd
    contrasts[(lost @ part) > 0] = np.nan
    used = np.isfinite(contrasts).any(axis=0)
    contrasts, part = contrasts[:, used], part[:, used]
    if not used.any():
        return outliers
    scale = robust_sd(contrasts - np.nanmedian(contrasts, axis=0))
    if not (scale > 0.0).all():
        return outliers
    distance = np.abs(contrasts - np.nanmedian(contrasts, axis=0)) / scale
    reserved = reserve_mask @ part > 0
    rejected = np.zeros_like(lost) if rejected_mask is None else rejected_mask
    reference = np.where(reserved | (rejected @ part > 0), np.nan, distance)
    largest = np.nan_to_num(np.fmax.reduce(reference, axis=0, initial=0.0))
    far = reserved & (distance > np.maximum(SPIKE, BEYOND * largest))
    outliers |= far @ part.T > 0
    whole = reserved.all(axis=1)
    size, reference_size = _medians(distance), _medians(reference)
    if np.isfinite(reference_size).any():
        limit = np.fmax(LOUD * np.nanmedian(reference_size), np.nanmax(reference_size))
        outliers[whole & (size > limit)] = True
    return outliers & reserve_mask


def _medians(distance: np.ndarray) -> np.ndarray:
    """(N,): the median of every frame of distances (N, C), NaN where a frame has none."""
    medians = np.full(len(distance), np.nan)
    present = np.isfinite(distance).any(axis=1)
    medians[present] = np.nanmedian(distance[present], axis=1)
    return medians
