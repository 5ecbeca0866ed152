"""Estimate test touches of a continuous set by the posterior mean, and score the estimates."""

from eitskin.data import dataset, splits
from eitskin.learn import metrics
from eitskin.limit import posterior_mean, score
from eitskin.provenance import recorded

with recorded(snakemake):
    files, params = snakemake.input, snakemake.params
    data = dataset.read(files.dataset)
    part = splits.read(files.split, data.table)
    blocks = ("skin", "accuracy", "effects", "session_frames", "continuous")
    experiment = posterior_mean.experiment_of(data, **{block: params[block] for block in blocks})
    estimates = posterior_mean.estimates(
        experiment, data, part, params.seed, params.samples, params.pairs
    )
    metrics.write(estimates, snakemake.output.samples)
    metrics.write(score.score(estimates, data, "continuous", params.seed), snakemake.output.metrics)
