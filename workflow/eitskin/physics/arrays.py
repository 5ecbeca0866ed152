"""The library of an array, so that one formula serves NumPy and a device of PyTorch."""

from typing import Any

import numpy as np

NUMPY = np.zeros(0)  # a template for arrays of NumPy


def library(array: Any) -> Any:
    """numpy for its own arrays; else the Python array API's view of the array's library
    (array-api-compat)."""
    if isinstance(array, np.ndarray | np.generic):
        return np
    from array_api_compat import array_namespace  # here, as NumPy alone needs none

    return array_namespace(array)


def as_in(values: Any, array: Any) -> Any:
    """Values as an array of the library of `array`, on its device."""
    xp = library(array)
    return np.asarray(values) if xp is np else xp.asarray(values, device=array.device)
