"""Predict the test part of a dataset and measure the errors."""

from eitskin.data import dataset, splits
from eitskin.learn import metrics, model_file, predict
from eitskin.provenance import recorded

with recorded(snakemake):
    files, names = snakemake.input, snakemake.wildcards
    data = dataset.read(files.dataset)
    part = splits.read(files.split, data.table)
    model = model_file.read_seeds(files.models)
    predictions = predict.predict_part(model, data, part)
    table = metrics.evaluate(predictions, data, names.split, names.budget, model.header)
    predict.write(predictions, snakemake.output.predictions)
    metrics.write(table, snakemake.output.metrics)
