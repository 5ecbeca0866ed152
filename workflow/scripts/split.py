"""Draw the training, validation and test parts of a dataset."""

from eitskin.data import dataset, splits
from eitskin.provenance import recorded

with recorded(snakemake):
    table = dataset.read(snakemake.input[0]).table
    part = splits.assign(table, snakemake.wildcards.split, snakemake.params.seed)
    splits.write(snakemake.output[0], table, part)
