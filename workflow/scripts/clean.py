"""Simulate every place and force on the ideal skin."""

from eitskin.provenance import recorded
from eitskin.simulate import sets

with recorded(snakemake):
    blocks = ("skin", "accuracy")
    sets.write_clean(
        snakemake.input.mesh,
        snakemake.input.touch_grid,
        snakemake.output[0],
        **{block: snakemake.params[block] for block in blocks},
    )
