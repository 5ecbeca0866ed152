"""Errors of one setting's model, seed by seed, on the part that is asked for."""

from eitskin.data import dataset, splits
from eitskin.errors import reported
from eitskin.learn import metrics, model_file, predict

with reported(snakemake.log[0]):
    files = snakemake.input
    data = dataset.read(files.dataset)
    part = splits.read(files.split, data.table)
    found = predict.predict_part(
        model_file.read_seeds(files.models), data, part, snakemake.params.part
    )
    metrics.write(metrics.by_seed(found, data), snakemake.output[0])
