"""Draw the training, validation and test parts of a dataset."""

from eitskin.data import dataset, splits
from eitskin.errors import reported

with reported(snakemake.log[0]):
    table = dataset.read(snakemake.input[0]).table
    part = splits.assign(table, snakemake.wildcards.split, snakemake.params.seed)
    splits.write(snakemake.output[0], table, part)
