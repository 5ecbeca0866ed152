"""`python -m proof.other_probability results/other_probability` finds what the p-value of a
remainder is worth, from development recordings of rigs with errors: `remainder.WEIGHT` and `MOST`.

Each is diagnosed unless its row lies in the folder already. Recordings with physics outside the
catalogue count as much as the blocks to be reported have of them.
"""

import json
import sys
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from eitskin.diagnose.verdict.remainder import PRIOR, log_bayes_factor
from proof.blocks import ORDINARY_SIZES
from proof.trial import file_of, run
from witness.outside import OUTSIDE
from witness.strengths import DRAWN

SEEDS = range(31, 33)
PLAN = [
    *((f"outside:{law}+rig", seed) for seed in SEEDS for law in OUTSIDE),
    *((f"single:{name}+rig", SEEDS[0]) for name in DRAWN),
    *(("null+rig", seed) for seed in range(101, 137)),
]
CAPS = (3.0, 4.0, 5.0, 6.0, 8.0, 12.0)  # nats, tried as the most that a Bayes factor counts


def fitted(
    factor: np.ndarray, foreign: np.ndarray, share: float
) -> list[tuple[float, float, float]]:
    """(cap, weight, log likelihood) for each of CAPS: the weight of a Bayes factor's logarithm
    (n,), capped, in the log odds that physics was foreign (n,), the prior odds given; share: of all
    recordings, that has some."""
    weights = np.where(foreign, share / foreign.mean(), (1.0 - share) / (1.0 - foreign.mean()))
    prior = np.log(PRIOR / (1.0 - PRIOR))

    def cost(weight: np.ndarray, cap: float) -> float:
        odds = prior + weight[0] * np.minimum(factor, cap)
        return float((weights * np.logaddexp(0.0, np.where(foreign, -odds, odds))).sum())

    fits = [(cap, minimize(cost, [0.5], (cap,))) for cap in CAPS]
    return [(cap, float(optimum.x[0]), -float(optimum.fun)) for cap, optimum in fits]


def main(folder: Path) -> None:
    """Make the rows that are missing, and print the fits."""
    run(PLAN, folder)
    rows = [json.loads(file_of(folder, *trial).read_text("utf-8")) for trial in PLAN]
    rows = [row for row in rows if "failed" not in row]
    factor = np.array([log_bayes_factor(row["other_p"]) for row in rows])
    foreign = np.array([bool(row["outside"]) for row in rows])
    full = ORDINARY_SIZES["full"]
    number = {key: n * (len(DRAWN) if key == "single" else 1) for key, n in full.items()}
    share = number["outside"] / sum(number.values())
    print(f"{len(rows)} recordings, {foreign.sum()} with something; counted as {share:.3f} of all")
    for cap, weight, likelihood in fitted(factor, foreign, share):
        print(f"most {cap:g}: weight {weight:.2f}, log likelihood {likelihood:.2f}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
