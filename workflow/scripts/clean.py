"""Simulate every place and force on the ideal skin."""

from eitskin import simulate
from eitskin.errors import reported

with reported(snakemake.log[0]):
    blocks = ("skin", "accuracy")
    simulate.write_clean(
        snakemake.input.mesh,
        snakemake.input.touch_grid,
        snakemake.output[0],
        **{block: snakemake.params[block] for block in blocks},
    )
