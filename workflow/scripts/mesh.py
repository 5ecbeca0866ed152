"""Lay out the electrodes, the places and the forces of the simulated set."""

from eitskin import mesh
from eitskin.errors import reported

with reported(snakemake.log[0]):
    blocks = ("seed", "skin", "protocol", "touch_grid", "forces", "accuracy")
    mesh.write(
        snakemake.output.mesh,
        snakemake.output.touch_grid,
        **{block: snakemake.params[block] for block in blocks},
    )
