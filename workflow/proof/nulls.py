"""How surprising the best candidate is said to be where nothing is left out.

A skin is simulated once and recorded REPEATS times by each kind of rig; none is searched.
"""

from functools import partial

from proof import ledger
from proof.refit import ScoreTests
from witness import cases
from witness.cases import Case

# What follows + in the kind of a case, by the name of the rig; the first has white noise alone.
RIGS = {
    "white-noise": "",
    "correlated-noise": "rig:correlated-noise",
    "common-noise": "rig:common-noise",
    "channel-drift": "rig:channel-drift",
    "amplitude-per-frame": "rig:amplitude-per-frame",
    "gain-walk": "rig:gain-walk",
    "magnitudes": "rig:quadrature,quantisation",
    "place-per-frame": "rig:place-per-frame",
    "place-per-press": "rig:place-per-press",
    "force": "rig:force-per-frame,force-per-press",
}
REPEATS = 5  # recordings of a skin by each rig: 2,000 of 40 skins


def trial(case: Case, repeats: int = REPEATS) -> dict:
    """The row of a skin with nothing left out: `nulls`, a dict for each recording of it.

    A recording has {rig, number, sizes (of its errors), seconds, cpu_seconds} and what the score
    tests about its calibration make of it: p_value, global, and p_local of the best candidate, its
    name, and `learned`, the sizes of the rig's errors. One that breaks off has {failed: why}.
    """
    tests = ScoreTests(case.seed)
    nulls = []
    for rig, errors in RIGS.items():
        for number in range(repeats):
            recording = cases.again(case, errors, number)
            sizes = {error.kind: error.size for error in recording.rig}
            work = partial(tests.best, recording.recorded, rig)
            best, seconds = ledger.timed(partial(ledger.outcome, work))
            nulls.append({"rig": rig, "number": number, "sizes": sizes, **best, **seconds})
    return {"level": case.level, "nulls": nulls}
