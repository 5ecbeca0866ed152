"""Errors of one setting's model, seed by seed, on the part that is asked for."""

from eitskin.data import dataset, splits
from eitskin.errors import InputError, reported
from eitskin.learn import metrics, model_file, predict

with reported(snakemake.log[0]):
    files = snakemake.input
    data = dataset.read(files.dataset)
    part = splits.read(files.split, data.table)
    model, asked = model_file.read_seeds(files.models), snakemake.params.part
    if asked == "validation" and not model.header["budget"]["validated"]:
        found, expected = "false", "true, as settings are chosen on the validation part"
        raise InputError("config.yaml", "budgets, validated", found, expected)
    found = predict.predict_part(model, data, part, asked)
    metrics.write(metrics.by_seed(found, data), snakemake.output[0])
