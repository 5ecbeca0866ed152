"""Errors on the recording of models trained on a source, as trained and aligned."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.data import recording, unit_disc
from eitskin.data.recording import Recording
from eitskin.estimators.sets import Source, source_set
from eitskin.learn import train, transfer, transfer_runs
from eitskin.learn.train import Recipe, Split
from eitskin.simulate.imitation import PressPrior
from eitskin.simulators import Simulator
from loop import sources
from loop.naming import BELIEF, DIAGNOSIS, LABELS, TRUTH


@dataclass(frozen=True)
class Case:
    """A case of the loop: its `folder`, the `target` whose test part is predicted and whose part
    "train" holds the labels, the effects of the source AUTHORS, and the prior of presses."""

    folder: Path
    target: Split
    authors: list[dict]
    prior: PressPrior


def simulator(source: str, recorded: Recording, case: Case) -> Source:
    """The simulator of a source of a case."""
    if source == TRUTH:
        description = json.loads((case.folder / "truth.json").read_text(encoding="utf-8"))
        return sources.truth(description, recorded)
    if source == DIAGNOSIS:
        return Simulator.read(case.folder / "diagnosis")
    nominal = Simulator.calibrated(recorded)
    if source == BELIEF:
        return nominal
    return Simulator(nominal.skin, case.authors, nominal.factor, drawn=True)


def errors(
    case: Case, source: str, model: str, recipe: Recipe, seed: int, draw: int
) -> pd.DataFrame:
    """Rows (`transfer_runs.RUNS`) of a model trained on a source, on the case's test part.

    Each seed has its own source samples and noise, the same for all sources, and trains one
    network; draw: its number. The source `LABELS` trains on the labels alone, as
    `transfer.references`.
    """
    recorded = recording.read(case.folder / "recording.parquet")
    labelled_rows = np.flatnonzero(case.target.part == "train")
    samples = recipe.budget.samples
    assert samples is not None  # the configuration's schema
    if source == LABELS:
        run = transfer.Run(transfer_runs.TRAINED_FEW, draw, seed, len(labelled_rows))
        rows = transfer.trained_on_labelled(case.target, labelled_rows, model, recipe, samples, run)
        return pd.DataFrame(rows, columns=list(transfer_runs.RUNS))
    source_simulator = simulator(source, recorded, case)
    name = f"{source} {seed}"
    source_split = source_set(source_simulator, recorded, samples, seed, case.prior, name)
    trained = train.train_model(source_split, model, recipe, seed)
    electrode_deg = unit_disc.electrode_deg(recorded.skin)
    labels = [labelled_rows]
    rows = transfer.transferred(trained, source_split, case.target, electrode_deg, labels)
    return rows.assign(seed=seed)
