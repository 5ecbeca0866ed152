"""Errors on the recording of models trained on a source, as they are and aligned."""

import json
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.data import recording
from eitskin.data.dataset import Dataset
from eitskin.data.recording import Recording
from eitskin.learn import train, transfer, transfer_runs
from eitskin.learn.train import Recipe, Split
from loop import sources
from loop.naming import BELIEF, DIAGNOSIS, LABELS, TRUTH


def simulator(
    source: str, recorded: Recording, folder: str | Path, authors: list[dict]
) -> sources.Simulator | sources.Truth:
    """The simulator of a source of the case in `folder`; `authors`: the effects of AUTHORS."""
    folder = Path(folder)
    if source == TRUTH:
        told = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
        return sources.truth(told, recorded)
    if source == DIAGNOSIS:
        found = folder / "diagnosis"
        said = json.loads((found / "diagnosis.json").read_text(encoding="utf-8"))
        return sources.diagnosed(found / "effects.yaml", said)
    believed = sources.belief(recorded)
    if source == BELIEF:
        return believed
    return sources.Simulator(believed.skin, authors, believed.factor, drawn=True)


def errors(
    source: str,
    model: str,
    folder: str | Path,
    target: Dataset,
    part: np.ndarray,
    recipe: Recipe,
    seed: int,
    draw: int,
    authors: list[dict],
    forces: dict,
    probe_mm: float,
) -> pd.DataFrame:
    """Rows (`transfer_runs.RUNS`) of a model on the test part of `target`, for a seed.

    A seed has source samples and noise of its own, the same for all sources, and trains one
    network; the rows "train" of `part` are the labels that methods with labels use. `LABELS`
    trains on these alone, as `transfer.references`.
    """
    recorded = recording.read(Path(folder) / "recording.parquet")
    few = np.flatnonzero(part == "train")
    samples = recipe.budget.samples
    assert samples is not None  # the configuration's schema
    if source == LABELS:
        run = transfer.Run(transfer_runs.TRAINED_FEW, draw, seed, len(few))
        split = Split(target, part)
        rows = transfer.trained_on_labelled(split, few, model, recipe, samples, run)
        return pd.DataFrame(rows, columns=list(transfer_runs.RUNS))
    taught = simulator(source, recorded, folder, authors)
    name = f"{source} {seed}"
    made, parts = sources.source_set(taught, recorded, samples, seed, forces, probe_mm, name)
    source_split = Split(made, parts)
    trained = train.train_model(source_split, model, recipe, seed)
    angles = recorded.skin.electrode_deg
    electrode_deg = None if angles is None else list(angles)
    rows = transfer.transferred(trained, source_split, Split(target, part), electrode_deg, [few])
    return rows.assign(seed=seed)
