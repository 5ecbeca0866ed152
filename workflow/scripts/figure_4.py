"""Draw predicted against true force, and the errors over the skin: figure 4."""

import pandas as pd

from eitskin.data import dataset
from eitskin.errors import reported
from eitskin.paper import figure_4

with reported(snakemake.log[0]):
    files, found, asked = snakemake.output, snakemake.input, snakemake.params
    figure_4.write(
        {m: pd.read_csv(f) for m, f in zip(asked.models, found.metrics, strict=True)},
        dict(zip(asked.models, found.predictions, strict=True)),
        dataset.read(found.dataset),
        asked.skin["radius_mm"],
        asked.skin["electrode_deg"],
        files.svg,
        files.png,
        files.csv,
    )
