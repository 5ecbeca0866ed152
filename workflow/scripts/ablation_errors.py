"""Errors of one setting's model, seed by seed, on one part."""

from eitskin.data import dataset, splits
from eitskin.errors import InputError
from eitskin.learn import metrics, model_file, predict
from eitskin.provenance import recorded

with recorded(snakemake):
    files = snakemake.input
    data = dataset.read(files.dataset)
    part = splits.read(files.split, data.table)
    model, part_name = model_file.read_seeds(files.models), snakemake.params.part
    if part_name == "validation" and not model.header["budget"]["validated"]:
        stated, expected = "false", "true, as settings are chosen on the validation part"
        raise InputError("config.yaml", "budgets, validated", stated, expected)
    predictions = predict.predict_part(model, data, part, part_name)
    metrics.write(metrics.by_seed(predictions, data), snakemake.output[0])
