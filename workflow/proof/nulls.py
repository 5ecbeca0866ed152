"""How surprising the best candidate is said to be where nothing is left out.

A skin is simulated once and recorded REPEATS times by each kind of rig; none is searched.
"""

import time
import traceback
from dataclasses import replace

from eitskin import cores
from eitskin.diagnose import diagnosis
from eitskin.diagnose.fitting.tangents import Tangents
from eitskin.diagnose.search.screen import Null
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
REPEATS = 5
KEPT = 3  # tangents whose derivatives later recordings may share
SMALL = 0.1  # p below which a recording has derivatives of its own


def trial(seed: int, repeats: int = REPEATS) -> dict:
    """One skin's row: `nulls`, a dict for each recording of it.

    A recording has {rig, number, sizes (of its errors), seconds, cpu_seconds} and what the score
    tests about its calibration make of it: p_value, global, and p_local of the best candidate, its
    name, and `learned`, the sizes of the rig's errors. One that breaks off has {failed: why}.
    """
    case = cases.draw("null", seed)
    tests = ScoreTests(seed)
    found = []
    for rig, errors in RIGS.items():
        for number in range(repeats):
            made = cases.again(case, errors, number)
            row = {"rig": rig, "number": number}
            row["sizes"] = {error.kind: error.size for error in made.rig}
            began = time.perf_counter(), cores.seconds()
            try:
                row |= tests.best(made, rig)
            except (MemoryError, OSError):  # of the machine, not of the recording
                raise
            except Exception as error:  # whatever it is, it is a result
                traceback.print_exc()
                row["failed"] = repr(error)
            row["seconds"] = time.perf_counter() - began[0]
            row["cpu_seconds"] = cores.seconds() - began[1]
            found.append(row)
    return {"level": case.level, "nulls": found}


class ScoreTests:
    """Score tests of recordings of one skin. Their derivatives are shared where readings are near
    enough and p is not small, which changes it by about 1 %; what chance gives is drawn once for
    every rig, which changes p as much as any other draw does."""

    def __init__(self, seed: int):
        self.seed = seed
        self.tangents: dict[tuple, Tangents] = {}
        self.drawn: dict[str, Null] = {}

    def best(self, case: Case, rig: str) -> dict:
        """{p_value, p_local, name, learned} of the best of all candidates about the calibration of
        a recording, which is as far as a diagnosis goes before it fits an effect."""
        recorded = case.recorded
        _, search, _ = diagnosis.begun(recorded, self.seed)
        search.tangents.update(self.tangents)
        search.null = self.drawn.get(rig)
        state = search.calibrated()
        best = min(search.scores(state), key=lambda score: score.p_value)
        tangents = search.linearised(state)
        if tangents.source is not tangents and search.global_p(best.p_value) < SMALL:
            # Where touches are far from where they are said to be, derivatives differ as well.
            own = replace(search, tangents={}, met={}, scored={})
            best = min(own.scores(state), key=lambda score: score.p_value)
        elif tangents.source is tangents and len(self.tangents) < KEPT:
            self.tangents["shared", len(self.tangents)] = tangents
        assert search.null is not None  # scores draw it
        self.drawn[rig] = search.null
        return {
            "p_value": search.global_p(best.p_value),
            "p_local": best.p_value,
            "name": best.candidate.name,
            "learned": {name: size for name, size in state.sizes.items() if size > 0.0},
        }
