"""What somebody who knows the truth could do: the true set fitted to a recording, after opening.

Its prediction is the best that the catalogue allows, its covariance the Cramér-Rao bound.
"""

import json
from functools import partial
from pathlib import Path

import numpy as np

from eitskin.data import recording
from eitskin.data.recording import Recording
from eitskin.diagnose import diagnosis
from eitskin.diagnose.verdict import conclusion
from eitskin.diagnose.verdict.record import read_query
from proof import ledger, opened
from proof.drawing import draw
from proof.intervals import rms
from proof.planted import NONE
from proof.refit import Refit, entries_of, snr_left


def oracle(refit: Refit, query: Recording, truth: dict, query_clean: np.ndarray) -> dict:
    """{rmse_V, effects, log_evidence}: of the true set fitted, on the query's noise-free readings
    (Q, M), and as a diagnosis would say it; None where physics is none of the catalogue's, or none
    can be fitted."""
    state = refit.with_effects(truth["effects"], truth["scopes"])
    if state is None or truth["outside"]:
        return {"rmse_V": None, "effects": None, "log_evidence": None}
    return {
        "rmse_V": rms(refit.prediction(state, query) - query_clean),
        "effects": entries_of(state, truth["effects"]),
        "log_evidence": state.log_evidence,
    }


def named_refitted(refit: Refit, entries: list[dict], clean: np.ndarray) -> dict:
    """{said_log_evidence, snr_left}: of the effects that a diagnosis named, fitted once more;
    snr_left as `refit.snr_left`; clean (N, M) V: the recording without noise. None where they
    cannot be."""
    state = refit.as_named(entries)
    if state is None:
        return {"said_log_evidence": None, "snr_left": None}
    clean = clean[refit.recorded.frames["frame"].to_numpy()]
    remainder = snr_left(state.fit, state.fit.voltage(), clean)
    return {"said_log_evidence": state.log_evidence, "snr_left": remainder}


def control(kind: str, seed: int, name: str) -> list[dict]:
    """What a diagnosis names in a real recording's excerpt without the fault planted in it."""
    word, source, _ = kind.split(":")
    case = draw(f"{word}:{source}:{NONE}", seed)
    return conclusion.document(diagnosis.diagnose(case.recorded, 1), name)["effects"]


def run(cases: list[str], block: Path, seed: int, code: str) -> None:
    """oracle/CASE.json of every opened case of a block: as `oracle` and `named_refitted` together;
    control where a fault was planted in a real recording, whose hidden readings nobody knows. One
    of the same files by the same code stays."""
    for case in cases:
        truth, arrays = opened.read(block / "opened", case)
        files = {
            "truth": block / "opened" / f"{case}.json",
            **ledger.files_of(block, case),
            "verdict": block / "verdicts" / case / "diagnosis.json",
        }
        provenance, path = ledger.sources(code, **files), block / "oracle" / f"{case}.json"
        if not ledger.stands(path, provenance):
            row = ledger.outcome(partial(_fitted, files, case, truth, arrays, seed))
            ledger.write(path, {**row, "made": provenance})


def _fitted(files: dict[str, Path], case: str, truth: dict, arrays: dict, seed: int) -> dict:
    if "query_clean_V" not in arrays:
        has_fault = truth.get("fault") is not None
        return {"control": control(truth["kind"], truth["seed"], case) if has_fault else None}
    recorded = recording.read(files["recording"])
    refit, query = Refit.of(recorded, seed), read_query(files["query"], recorded)
    row = oracle(refit, query, truth, arrays["query_clean_V"])
    verdict = json.loads(files["verdict"].read_text("utf-8"))
    if "failed" not in verdict:
        row |= named_refitted(refit, verdict["effects"], arrays["clean_V"])
    return row
