"""Estimate tested touches of a continuous set as well as physics allows, and score that."""

from eitskin import dataset, limit, splits
from eitskin.errors import reported

with reported(snakemake.log[0]):
    files, params = snakemake.input, snakemake.params
    data = dataset.read(files.dataset)
    part = splits.read(files.split, data.table)
    blocks = ("skin", "accuracy", "effects", "session_frames", "continuous")
    experiment = limit.experiment_of(data, **{block: params[block] for block in blocks})
    found = limit.estimates(experiment, data, part, params.seed, params.samples, params.pairs)
    limit.write(found, snakemake.output.samples)
    limit.write(limit.score(found, data, "continuous", params.seed), snakemake.output.metrics)
