"""Diagnose a batch of recordings with known truth; what is done already stays."""

from pathlib import Path

import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.provenance import recorded
from proof import trial

with recorded(snakemake):
    trials = [(kind, seed) for kind, seed in snakemake.params.trials]
    trial.run(trials, Path(snakemake.output[0]).parents[1] / "trials")
    with atomic_path(snakemake.output[0]) as path:
        pd.DataFrame(trials, columns=["kind", "seed"]).to_csv(path, index=False)
