"""Say in public, salted and hashed, what a block's recordings, queries and truths are."""

from pathlib import Path

from eitskin.errors import reported
from proof import sealing

with reported(snakemake.log[0]):
    sealing.commit(
        snakemake.wildcards.block,
        snakemake.params.seed,
        snakemake.input,
        Path(snakemake.output.commitments).parent,
        Path(snakemake.output.key).parent,
    )
