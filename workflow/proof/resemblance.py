"""Whether an effect is concealed in the plain sense: how far it moves the measures of Table II."""

import numpy as np

from eitskin.errors import InputError
from eitskin.paper.similarity import MEASURES, Pool
from eitskin.paper.table_2 import LEVEL

ROUNDS = 200  # permutations: 5 beyond either end of the band of 95 %


def moves(
    recorded: np.ndarray,
    plain: np.ndarray,
    mended: np.ndarray,
    noise_V: np.ndarray,
    seed: int,
    rounds: int = ROUNDS,
) -> dict[str, dict[str, float | bool]]:
    """How far MMD, CORAL, NCC and SWD of a recording (N, M) V move once the effect's signature is
    removed: by measure {plain, mended, change, low, high, moved}.

    plain, mended (N, M) V: the owner's simulation of the same states, noise-free, without and with
    the effect; each gets noise of its own, sd noise_V (M,), and the factor that fits it to the
    recording, for the conductivity is calibrated. change: of `plain` against `mended`, a distance
    lost where it is above 0 (for NCC, below); low, high: the 95 % band of permutations in which
    each frame's pair may have changed sides, which is what is seen where there is no effect; moved:
    whether `change` lies outside. Only channels that are whole and vary are compared.
    Raises InputError where none does.
    """
    rng = np.random.default_rng([seed, 6])
    comparable = np.isfinite(recorded).all(axis=0) & (np.ptp(recorded, axis=0) > 0)
    if len(recorded) < 2 or not comparable.any():
        raise InputError("resemblance", "frames", f"{len(recorded)}", "channels that vary")
    simulated = []
    for voltage in (plain, mended):
        part = voltage[:, comparable]
        factor = (part * recorded[:, comparable]).sum() / (part**2).sum()
        noise = noise_V * rng.standard_normal(voltage.shape)
        simulated.append((factor * voltage + noise)[:, comparable])
    count = len(recorded)
    pool = Pool(np.concatenate([recorded[:, comparable], *simulated]), np.arange(count), seed)
    rows_of = [count * (1 + k) + np.arange(count)[:, None] for k in range(2)]
    change, permuted = pool.changes(rows_of[0], rows_of[1], rounds, rng)
    low, high = np.quantile(permuted, (0.5 - LEVEL / 2, 0.5 + LEVEL / 2), axis=0)
    values = [pool.compare(rows.ravel(), pool.real) for rows in rows_of]
    return {
        measure: {
            "plain": float(values[0][k]),
            "mended": float(values[1][k]),
            "change": float(change[k]),
            "low": float(low[k]),
            "high": float(high[k]),
            "moved": bool(change[k] < low[k] or change[k] > high[k]),
        }
        for k, measure in enumerate(MEASURES)
    }
