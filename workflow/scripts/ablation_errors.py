"""Errors of one setting's model, seed by seed, on the part that is asked for."""

from eitskin import dataset, metrics, models, predict, splits
from eitskin.errors import reported

with reported(snakemake.log[0]):
    files = snakemake.input
    data = dataset.read(files.dataset)
    part = splits.read(files.split, data.table)
    found = predict.predict_part(models.read(files.model), data, part, snakemake.params.part)
    metrics.write(metrics.by_seed(found, data), snakemake.output[0])
