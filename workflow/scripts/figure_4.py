"""Draw predicted against true force, and the errors over the skin: figure 4."""

import pandas as pd

from eitskin.data import dataset
from eitskin.paper import figure_4
from eitskin.provenance import recorded

with recorded(snakemake):
    figures, files, params = snakemake.output, snakemake.input, snakemake.params
    tables = zip(map(pd.read_csv, files.metrics), files.predictions, strict=True)
    figure_4.write(
        dict(zip(params.models, tables, strict=True)),
        dataset.read(files.dataset),
        params.skin,
        figures.svg,
        figures.png,
        figures.csv,
        params.shown,
    )
