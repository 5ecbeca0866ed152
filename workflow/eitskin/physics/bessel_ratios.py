"""Modified Bessel functions of integer order as ratios and logarithms, which never over- or
underflow (Abramowitz & Stegun 9.6, 9.7)."""

import numpy as np
from scipy.special import ive, kve


def inner_steps(n_max: int, k: np.ndarray) -> np.ndarray:
    """(n_max + 1, K): k I_(n+1)(k) / I_n(k), k (K,) 0 or more.

    From the ratios' continued fraction, begun beyond n_max from k I_n' / I_n ~ 1 / q, q = 1 / rho +
    k^2 / (2 rho^4), rho^2 = n^2 + k^2 (Abramowitz & Stegun 9.7.7, 9.7.9).
    """
    top_order = n_max + 40
    rho2 = (top_order + 1.0) ** 2 + k**2
    ratio = 1.0 / (1.0 / np.sqrt(rho2) + 0.5 * k**2 / rho2**2) - (top_order + 1.0)
    steps = np.empty((n_max + 1, len(k)))
    for n in range(top_order, -1, -1):
        ratio = k**2 / (2.0 * (n + 1) + ratio)
        if n <= n_max:
            steps[n] = ratio
    return steps


def cylinder_response(n_max: int, k: np.ndarray) -> np.ndarray:
    """(n_max + 1, K): q_n(k) = I_n(k) / (k I_n'(k)) of the unit cylinder, k (K,) 0 or more.

    Infinite at n = 0, k = 0.
    """
    with np.errstate(divide="ignore"):
        return 1.0 / (np.arange(n_max + 1)[:, None] + inner_steps(n_max, k))


def log_inner(k: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """(n_max + 1, K): ln I_n(k) of inner_steps, k (K,) above 0."""
    log_order_0 = np.log(ive(0, k)) + k
    return log_order_0 + np.vstack([np.zeros_like(k), np.cumsum(np.log(steps[:-1] / k), axis=0)])


def outer_steps(n_max: int, k: np.ndarray) -> np.ndarray:
    """(n_max + 1, K): k K_(n+1)(k) / K_n(k), k (K,) above 0; the product I_n K_n is the inverse of
    its sum with inner_steps (the Wronskian)."""
    steps = np.empty((n_max + 1, len(k)))
    steps[0] = k * kve(1, k) / kve(0, k)
    for n in range(1, n_max + 1):
        steps[n] = k**2 / steps[n - 1] + 2.0 * n
    return steps
