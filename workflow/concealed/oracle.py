"""What somebody who knows the truth could do: the true set fitted to a recording, after opening.

Its prediction is the best that the catalogue allows, its covariance the Cramér-Rao bound.
"""

import json
import math
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from calibration.intervals import rms
from calibration.trial import candidate_of, snr_left, with_all
from concealed import cache, opened, planted
from eitskin.data import recording
from eitskin.data.recording import Recording
from eitskin.diagnose import diagnosis
from eitskin.diagnose.diagnosis import begun, simulator
from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.fitting.estimates import estimates
from eitskin.diagnose.fitting.excerpt import excerpt
from eitskin.diagnose.search.search import Search
from eitskin.diagnose.search.state import State
from eitskin.diagnose.verdict import result
from eitskin.diagnose.verdict.result import read_query
from eitskin.effects.effect import SITES
from eitskin.physics.solver import EffortExceeded

MOST_SOLVED = 4_000  # sheets, for the fit of one set


@dataclass(frozen=True)
class Refit:
    """A recording, thinned as a diagnosis thins it, to which any set of effects can be fitted;
    `nothing`: with none of them."""

    recorded: Recording
    search: Search
    nothing: State

    @classmethod
    def of(cls, recorded: Recording, seed: int) -> "Refit":
        """As a diagnosis with this seed begins."""
        thinned = excerpt(recorded)
        _, search, _ = begun(thinned, seed)
        return cls(thinned, replace(search, share=math.inf), search.calibrated())

    def with_effects(self, items: list[dict], scopes: list[str]) -> State | None:
        """The state with these effects; None where one of them cannot be fitted, or where all
        take more than MOST_SOLVED."""
        pairs = zip(items, scopes, strict=True)
        wanted = [starting(candidate_of(self.search.candidates, *pair), pair[0]) for pair in pairs]
        if not wanted:
            return self.nothing
        near = self.search.problem.model.near
        try:
            with near.within(near.effort + MOST_SOLVED):
                return with_all(self.search, self.nothing, wanted)
        except EffortExceeded:
            return None

    def as_said(self, said: list[dict]) -> State | None:
        """The state with the effects that a diagnosis named."""
        return self.with_effects([_item(one) for one in said], [one["scope"] for one in said])


def oracle(refit: Refit, query: Recording, truth: dict, query_clean: np.ndarray) -> dict:
    """{rmse_V, effects, log_evidence}: of the true set fitted, on the query's noise-free readings
    (Q, M), and as a diagnosis would say it; None where physics is none of the catalogue's, or none
    can be fitted."""
    state = refit.with_effects(truth["effects"], truth["scopes"])
    if state is None or truth["outside"]:
        return {"rmse_V": None, "effects": None, "log_evidence": None}
    voltage = simulator(state.fit, refit.recorded, query)(state.fit.theta)
    of = {c.name: i for i, c in enumerate(state.effects)}
    told = [_told(state, of[item["name"]]) for item in truth["effects"]]
    return {
        "rmse_V": rms(voltage - query_clean),
        "effects": told,
        "log_evidence": state.log_evidence,
    }


def said_fitted(refit: Refit, said: list[dict], clean: np.ndarray) -> dict:
    """{said_log_evidence, snr_left}: of the effects that a diagnosis named, fitted once more;
    snr_left as `calibration.trial.snr_left`; clean (N, M) V: the recording without noise. None
    where they cannot be."""
    state = refit.as_said(said)
    if state is None:
        return {"said_log_evidence": None, "snr_left": None}
    kept = clean[refit.recorded.frames["frame"].to_numpy()]
    left = snr_left(state.fit, state.fit.voltage(), kept)
    return {"said_log_evidence": state.log_evidence, "snr_left": left}


def _item(said: dict) -> dict:
    values = {key: estimate["value"] for key, estimate in said["parameters"].items()}
    sites = {kind: said[kind] for kind in SITES if said[kind]}
    return {"name": said["name"], "parameters": values, **sites}


def starting(candidate: Candidate, item: dict) -> Candidate:
    """A candidate whose fit starts from the truth where it must start somewhere."""
    given = item.get("parameters", {})
    known = {k: given[k] for k in candidate.start if given.get(k) is not None}
    return replace(candidate, start={**candidate.start, **known})


def _told(state: State, index: int) -> dict:
    candidate = state.effects[index]
    sites: dict[str, list[int]] = {kind: [] for kind in SITES}
    if candidate.kind is not None and candidate.scope != "common":
        sites[candidate.kind] = [int(site) for site in candidate.own_sites]
    return {"name": candidate.name, "parameters": estimates(state.fit, index), **sites}


def control(kind: str, seed: int, name: str) -> list[dict]:
    """What a diagnosis names in a real recording's excerpt without the fault planted in it."""
    word, of, _ = kind.split(":")
    case = planted.draw(f"{word}:{of}:{planted.NONE}", seed)
    recorded = case.recorded
    return result.result(diagnosis.diagnose(recorded, 1), name)["effects"]


def run(cases: list[str], block: Path, seed: int, code: str) -> None:
    """oracle/CASE.json of every opened case of a block: as `oracle` and `said_fitted` together;
    control where a fault was planted in a real recording, whose hidden readings nobody knows. One
    of the same files by the same code stays."""
    for case in cases:
        truth, arrays = opened.read(block / "opened", case)
        files = {
            "truth": block / "opened" / f"{case}.json",
            "recording": block / "recordings" / f"{case}.parquet",
            "query": block / "queries" / f"{case}.parquet",
            "verdict": block / "verdicts" / case / "diagnosis.json",
        }
        made, path = cache.made_of(code, **files), block / "oracle" / f"{case}.json"
        if not cache.stands(path, made, False):
            cache.write(path, made, partial(_one, files, case, truth, arrays, seed))


def _one(files: dict[str, Path], case: str, truth: dict, arrays: dict, seed: int) -> dict:
    if "query_clean_V" not in arrays:
        known = truth.get("fault") is None
        return {"control": None if known else control(truth["kind"], truth["seed"], case)}
    recorded = recording.read(files["recording"])
    refit, query = Refit.of(recorded, seed), read_query(files["query"], recorded)
    row = oracle(refit, query, truth, arrays["query_clean_V"])
    said = json.loads(files["verdict"].read_text("utf-8"))
    if "failed" not in said:
        row |= said_fitted(refit, said["effects"], arrays["clean_V"])
    return row
