"""The cases of an opened block: each truth beside what was made of the case while it was sealed."""

import json
from pathlib import Path

import numpy as np

from eitskin.data import parquet
from eitskin.errors import InputError
from proof import baselines, verdicts
from proof.intervals import band_numbers, rms

SAID_NOTHING = {
    "verdict": "broken off",
    "effects": [],
    "other": {"probability": 0.0, "sentence": None},
}
KINDS = {"confusable": "pair"}  # kinds of a case that are scored as another
METHODS = (*baselines.METHODS, "eitskin", "oracle")


def rows(block: Path) -> list[dict]:
    """One row (`measures`) a case of an opened block, in order: the truth, what was said, how the
    hidden frames (the query, without noise) were predicted, by whom. A case whose diagnosis broke
    off counts as one that said nothing: an alarm where nothing was concealed, a miss elsewhere."""
    return [_row(block, case) for case in names(block / "opened")]


def names(folder: Path) -> list[str]:
    """The names of all opened cases, in order; InputError where there is none."""
    cases = sorted(path.stem for path in folder.glob("case-*.json"))
    if not cases:
        raise InputError(folder, "folder", "no opened case", "case-*.json, as `open` writes them")
    return cases


def read(folder: Path, case: str) -> tuple[dict, dict[str, np.ndarray]]:
    """A case's truth, and its arrays: noise_V (M,) and, of a simulated case, clean_V (N, M) and
    query_clean_V (Q, M)."""
    truth = json.loads((folder / f"{case}.json").read_text("utf-8"))
    with np.load(folder / f"{case}.npz", allow_pickle=False) as file:
        return truth, {name: file[name] for name in file.files}


def _row(block: Path, case: str) -> dict:
    truth, arrays = read(block / "opened", case)
    diagnosis = _json(block / "verdicts" / case / "diagnosis.json")
    compared, best = (_json(block / part / f"{case}.json") for part in ("baselines", "oracle"))
    word, _, decoy = truth["kind"].partition(":")
    row = {
        "case": case,
        "seed": int(case.rpartition("-")[2]),
        "kind": KINDS.get(word, word),
        "group": word,
        "absent": decoy if word == "decoy" else None,
        "generator": truth["generator"],
        "strength": truth["gap_wanted"],
        "truth": truth["effects"],
        "scopes": truth["scopes"],
        "true_gaps": truth["gaps"] or [None] * len(truth["effects"]),
        "outside": truth["outside"],
        "fault": truth.get("fault"),
        "rig": truth.get("rig", []),
        "control": best.get("control"),
        "level": truth["level"],
        "changed": truth["changed"],
        "similarity": truth["similarity"],
        "snr_left": best.get("snr_left") or np.nan,
        "best": best.get("effects"),
        "log_evidence": best.get("log_evidence"),
        "said_log_evidence": best.get("said_log_evidence"),
        "baselines": compared.get("effects", {}),
        "broken": [
            name for name, row in (("baselines", compared), ("oracle", best)) if "failed" in row
        ],
        "said": SAID_NOTHING if "failed" in diagnosis else diagnosis,
        **({"failed": diagnosis["failed"]} if "failed" in diagnosis else {}),
    }
    seconds = block / verdicts.SECONDS / f"{case}.json"
    if seconds.is_file():
        row["seconds"] = _json(seconds)["seconds"]
    if "query_clean_V" not in arrays:
        return {**row, "hidden": hidden({})}
    clean = arrays["query_clean_V"]
    numbers = {"oracle": best.get("rmse_V")}
    if "failed" not in compared:
        with np.load(block / "baselines" / f"{case}.npz", allow_pickle=False) as file:
            numbers |= {name: rms(file[name] - clean) for name in file.files}
    if "failed" not in diagnosis:
        voltage, sd = predicted(block / "verdicts" / case / "predicted.parquet", clean.shape)
        numbers |= {"eitskin": rms(voltage - clean)}
        numbers |= band_numbers(voltage - clean, sd, arrays["noise_V"])
    return {**row, "hidden": hidden(numbers)}


def hidden(numbers: dict) -> dict[str, float]:
    """RMSE by method on hidden frames, and `band_numbers`; NaN where one is not known."""
    keys = (*METHODS, "chi2_per_dof", "within_90")
    return {key: np.nan if numbers.get(key) is None else numbers[key] for key in keys}


def _json(path: Path) -> dict:
    if not path.is_file():
        raise InputError(path, "file", "no such file", "a result of every case")
    return json.loads(path.read_text("utf-8"))


def predicted(path: Path, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Predicted voltages of a query (Q, M) and their standard deviations."""
    table = parquet.read(path, ["voltage_V", "std_V"])
    columns = (table[name].combine_chunks().flatten() for name in table.column_names)
    voltage, sd = (c.to_numpy(zero_copy_only=False).reshape(-1, shape[1]) for c in columns)
    if voltage.shape != shape:
        raise InputError(path, "voltage_V", f"{voltage.shape}", f"{shape}, as the query")
    return voltage, sd
