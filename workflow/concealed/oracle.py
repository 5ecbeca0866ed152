"""What somebody who knows the truth could do: the true set fitted to a recording, after opening.

Its prediction is the best that the catalogue allows, its covariance the Cramér-Rao bound.
"""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from calibration.trial import candidate_of, rms, snr_left, with_all
from concealed import kept, opened, planted
from eitskin import recording
from eitskin.diagnose import diagnose
from eitskin.diagnose.candidates import Candidate
from eitskin.diagnose.diagnose import begun, read_query, simulator
from eitskin.diagnose.estimates import estimates
from eitskin.diagnose.excerpt import excerpt
from eitskin.diagnose.search import State
from eitskin.effects.effect import SITES
from eitskin.recording import Recording


def oracle(recorded: Recording, query: Recording, truth: dict, query_clean: np.ndarray, seed: int):
    """{rmse_V, effects}: of the true set fitted, on the query's noise-free readings (Q, M), and as
    a diagnosis would say it; None where physics is none of the catalogue's, or none can be fitted.
    """
    recorded = excerpt(recorded)
    _, search = begun(recorded, seed)
    state: State | None = search.calibrated()
    if truth["effects"]:
        wanted = [
            starting(candidate_of(search.candidates, item, scope), item)
            for item, scope in zip(truth["effects"], truth["scopes"], strict=True)
        ]
        state = with_all(search, state, wanted)
    if state is None or truth["outside"]:
        return {"rmse_V": None, "effects": None}
    voltage = simulator(state.fit, recorded, query)(state.fit.theta)
    of = {c.name: i for i, c in enumerate(state.effects)}
    told = [_told(state, of[item["name"]]) for item in truth["effects"]]
    return {"rmse_V": rms(voltage - query_clean), "effects": told}


def left(recorded: Recording, said: list[dict], clean: np.ndarray, seed: int) -> float | None:
    """`calibration.trial.snr_left` of the effects that a diagnosis named, fitted once more; clean
    (N, M) V: the recording without noise. None where they cannot be."""
    recorded = excerpt(recorded)
    _, search = begun(recorded, seed)
    state: State | None = search.calibrated()
    if said:
        wanted = [candidate_of(search.candidates, _item(one), one["scope"]) for one in said]
        state = with_all(search, state, wanted)
    if state is None:
        return None
    return snr_left(state.fit, clean[recorded.frames["frame"].to_numpy()])


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
        sites[candidate.kind] = [int(site) for site in candidate.sites]
    return {"name": candidate.name, "parameters": estimates(state.fit, index), **sites}


def control(kind: str, seed: int, name: str) -> list[dict]:
    """What a diagnosis names in a real recording's excerpt without the fault planted in it."""
    word, of, _ = kind.split(":")
    case = planted.draw(f"{word}:{of}:{planted.NONE}", seed)
    recorded = Recording(case.states, case.voltage, None, None, case.metadata)
    return diagnose.result(diagnose.diagnose(recorded, 1), name)["effects"]


def run(cases: list[str], block: Path, seed: int, code: str) -> None:
    """oracle/CASE.json of every opened case of a block: {rmse_V, effects}, as `oracle`; snr_left
    where physics outside the catalogue is present; control where a fault was planted in a real
    recording, whose hidden readings nobody knows. One of the same files by the same code stays."""
    for case in cases:
        truth, arrays = opened.read(block / "opened", case)
        files = {
            "truth": block / "opened" / f"{case}.json",
            "recording": block / "recordings" / f"{case}.parquet",
            "query": block / "queries" / f"{case}.parquet",
            "verdict": block / "verdicts" / case / "diagnosis.json",
        }
        made, path = kept.made_of(code, **files), block / "oracle" / f"{case}.json"
        if not kept.stands(path, made, False):
            kept.write(path, made, partial(_one, files, case, truth, arrays, seed))


def _one(files: dict[str, Path], case: str, truth: dict, arrays: dict, seed: int) -> dict:
    if "query_clean_V" not in arrays:
        known = truth.get("fault") is None
        return {"control": None if known else control(truth["kind"], truth["seed"], case)}
    recorded = recording.read(files["recording"])
    query = read_query(files["query"], recorded)
    row = oracle(recorded, query, truth, arrays["query_clean_V"], seed)
    said = json.loads(files["verdict"].read_text("utf-8"))
    if truth["outside"] and "failed" not in said:
        row["snr_left"] = left(recorded, said["effects"], arrays["clean_V"], seed)
    return row
