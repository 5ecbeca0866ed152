"""A converter's rounding: the width of its steps, and the error that does not scatter."""

import numpy as np

ROUNDING = 12**-0.5  # of a converter's step: the sd of an even distribution over it
DITHERED = 0.01  # of the noise: what rounding does to all frames alike is negligible below it
EQUAL = 1e-9  # of the largest reading: values closer are one
STEP_TOLERANCE = 0.05  # of a step, that a gap between values may be from whole ones
GAP_QUANTILE = 0.1  # of gaps between values: that is one step; wider gaps hold several
TERMS = 199  # of a Fourier series whose terms fall by k^-2: the rest holds 0.3 % of it


def converter_step(voltage: np.ndarray) -> float:
    """Width of the steps between the values that readings (N, M) take, where half of them or more
    repeat the value of another and gaps are whole steps; else 0.

    Rounded to steps much wider than the noise, untouched frames have the same error each time:
    their scatter does not show it.
    """
    readings = voltage[np.isfinite(voltage)]
    values = np.unique(readings)
    values = values[np.append(True, np.diff(values) > EQUAL * np.abs(values).max(initial=0.0))]
    if len(values) < 2 or 2 * len(values) > len(readings):
        return 0.0
    gaps = np.diff(values)
    step = float(np.quantile(gaps, GAP_QUANTILE))
    fraction = np.abs(gaps / step - np.round(gaps / step))
    return step if np.mean(fraction < STEP_TOLERANCE) > 1.0 - GAP_QUANTILE else 0.0


def lasting_rounding_sd(step: float, sd: float) -> float:
    """Sd of the mean of what rounding to steps does to a reading at rest, whose scatter is `sd`
    with the rounding in it; 0 where that is negligible beside the scatter.

    Under noise of sd s a value x has the mean error sum_k (-1)^k step / (pi k) sin(2 pi k x / step)
    exp(-2 pi^2 k^2 s^2 / step^2); x is even over a step (Widrow, Kollar, Quantization Noise, 2008).
    """
    if step == 0.0:
        return 0.0
    noise = max((sd / step) ** 2 - ROUNDING**2, 0.0)
    k2 = np.arange(1, TERMS + 1) ** 2
    power = np.sum(np.exp(-4.0 * np.pi**2 * k2 * noise) / k2)
    rounding_sd = step * float(np.sqrt(power / 2.0) / np.pi)
    return rounding_sd if rounding_sd > DITHERED * sd else 0.0
