"""How often `check` finds a step in time where there is none, and where there is one.

    python -m proof.steps [last seed]

Recordings of kind null, by rigs with errors, of seeds 1 to 150: none is ever used to score a
diagnosis. A planted step is a multiple of the noise, over all channels together: of the channels of
one electrode, of all channels each its own way, or of all by one factor.
"""

import sys
from collections.abc import Iterator

import numpy as np

from eitskin.data.check.steps import steps
from eitskin.data.recording import Recording
from eitskin.quantities import percent
from witness import cases
from witness.cases import Case

LAST_SEED = 150  # 0 false alarms of so many are under 2 % with 95 %
RIGS = (
    "null",
    "null+rig",
    "null+rig:correlated-noise,gain-walk,channel-drift",
    "null+rig:gain-walk,spikes,loud-frames",
)
PLANTED_IN = "null+rig"
PLANTED = ("one electrode", "every channel", "one factor")
SIZES = (10.0, 20.0, 30.0, 40.0, 80.0, 160.0)  # of a step, in noises over all channels
MARGIN = 2  # untouched frames that a step needs on either side


def planted(case: Case, kind: str, size: float, rng: np.random.Generator) -> tuple[Recording, int]:
    """A case's recording with one step, and the first frame after it."""
    recorded = case.recorded
    channels = recorded.channels
    pattern = rng.standard_normal(len(channels))
    if kind == "one electrode":
        pattern *= (channels == rng.integers(cases.N_ELECTRODES)).any(axis=1)
    elif kind == "one factor":
        pattern = case.clean[0] / case.noise_V
    pattern *= case.noise_V * size / np.linalg.norm(pattern)
    rows = np.flatnonzero(~case.states["touch"].to_numpy(bool))
    frame = int(rng.integers(rows[MARGIN - 1] + 1, rows[-MARGIN] + 1))
    voltage = case.voltage.copy()
    voltage[frame:] += pattern
    recorded.voltage = np.abs(voltage) if recorded.metadata["voltage"] == "magnitude" else voltage
    return recorded, frame


def table(last_seed: int) -> Iterator[str]:
    """The lines of the table: false alarms by rig, then what is found by kind and size."""
    seeds = range(1, last_seed + 1)
    yield "no step planted: recordings with a step found"
    for rig in RIGS:
        false_alarms = [seed for seed in seeds if steps(cases.draw(rig, seed).recorded)]
        yield f"  {rig}: {len(false_alarms)} of {last_seed} (seeds {false_alarms})"
    yield f"one step planted in {PLANTED_IN}, found: in the right gap, at the right frame; others"
    counts = {(kind, size): np.zeros(3) for kind in PLANTED for size in SIZES}
    for seed in seeds:
        case = cases.draw(PLANTED_IN, seed)
        for kind, size in counts:
            counts[kind, size] += _located(case, kind, size)
    for (kind, size), count in counts.items():
        shares = map(percent, count / last_seed)
        yield "  {}, {:g} noises: {}, {}; {}".format(kind, size, *shares)


def _located(case: Case, kind: str, size: float) -> tuple[bool, bool, bool]:
    """Whether the step is found between the untouched frames beside it, and at its first frame;
    and whether another is."""
    rng = np.random.default_rng([case.seed, PLANTED.index(kind)])
    recorded, frame = planted(case, kind, size, rng)
    steps_named = steps(recorded)
    bracketing = [step for step in steps_named if step.between[0] < frame <= step.between[1]]
    exact = any(step.frame == frame for step in bracketing)
    return bool(bracketing), exact, len(steps_named) > len(bracketing)


if __name__ == "__main__":
    for line in table(int(sys.argv[1]) if len(sys.argv) > 1 else LAST_SEED):
        print(line, flush=True)
