"""Lay out the electrodes, the places and the forces of the simulated set."""

from eitskin.errors import reported
from eitskin.simulate import layout

with reported(snakemake.log[0]):
    blocks = ("seed", "skin", "protocol", "touch_grid", "forces", "accuracy")
    layout.write(
        snakemake.output.mesh,
        snakemake.output.touch_grid,
        layout.Layout(**{block: snakemake.params[block] for block in blocks}),
    )
