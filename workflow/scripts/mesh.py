"""Lay out the electrodes, the places and the forces of the simulated set."""

from eitskin.provenance import recorded
from eitskin.simulate import layout

with recorded(snakemake):
    blocks = ("seed", "skin", "protocol", "touch_grid", "forces", "accuracy")
    layout.write(
        snakemake.output.mesh,
        snakemake.output.touch_grid,
        layout.Layout(**{block: snakemake.params[block] for block in blocks}),
    )
