"""What somebody who knows the truth could do: the true set fitted to a recording, after opening.

Its prediction is the best that the catalogue allows, its covariance the Cramér-Rao bound.
"""

import json
import traceback
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibration.trial import candidate_of, rms, snr_left, with_all
from concealed import truths
from eitskin import recording
from eitskin.atomic import atomic_path
from eitskin.diagnose.candidates import Candidate
from eitskin.diagnose.diagnose import begun, read_query, simulator
from eitskin.diagnose.estimates import estimates
from eitskin.diagnose.excerpt import excerpt
from eitskin.diagnose.search import State
from eitskin.effects.effect import SITES
from eitskin.recording import Recording


def oracle(recorded: Recording, query: Recording, truth: dict, arrays: dict, seed: int) -> dict:
    """{rmse_V, effects}: of the true set fitted, on the query's noise-free readings, and as a
    diagnosis would say it; None where the set is none of the catalogue's or cannot be fitted."""
    recorded = excerpt(recorded)
    _, search = begun(recorded, seed)
    before = search.calibrated()
    state: State | None = before
    if truth["effects"]:
        wanted = [
            starting(candidate_of(search.candidates, item, scope), item)
            for item, scope in zip(truth["effects"], truth["scopes"], strict=True)
        ]
        state = with_all(search, before, wanted)
    if state is None or truth["outside"]:
        return {"rmse_V": None, "effects": None}
    voltage = simulator(state.fit, recorded, query)(state.fit.theta)
    of = {c.name: i for i, c in enumerate(state.effects)}
    told = [_told(state, of[item["name"]]) for item in truth["effects"]]
    return {"rmse_V": rms(voltage - arrays["query_clean_V"]), "effects": told}


def starting(candidate: Candidate, item: dict) -> Candidate:
    """A candidate whose fit starts from the truth where it must start somewhere."""
    given = item.get("parameters", {})
    known = {k: given[k] for k in candidate.start if given.get(k) is not None}
    return replace(candidate, start={**candidate.start, **known})


def _told(state: State, index: int) -> dict:
    candidate = state.effects[index]
    sites = dict.fromkeys(SITES, [])
    if candidate.kind is not None and candidate.scope != "common":
        sites[candidate.kind] = [int(site) for site in candidate.sites]
    return {"name": candidate.name, "parameters": estimates(state.fit, index), **sites}
