"""Apply one effect of the instrument to the previous stage of a chain."""

from eitskin.errors import reported
from eitskin.simulate import sets

with reported(snakemake.log[0]):
    sets.write_stage(
        snakemake.input[0],
        snakemake.output[0],
        **{block: snakemake.params[block] for block in ("seed", "effect", "position")},
    )
