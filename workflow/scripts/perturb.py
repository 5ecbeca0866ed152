"""Apply one effect of the instrument to the previous stage of a chain."""

from eitskin.provenance import recorded
from eitskin.simulate import sets

with recorded(snakemake):
    sets.write_stage(
        snakemake.input[0],
        snakemake.output[0],
        **{block: snakemake.params[block] for block in ("seed", "effect", "position")},
    )
