"""Say in public, salted and hashed, what a block's recordings, queries and truths are."""

from pathlib import Path

from eitskin.provenance import recorded
from proof import sealing

with recorded(snakemake):
    sealing.commit(
        snakemake.wildcards.block,
        snakemake.params.seed,
        snakemake.input.batches,
        Path(snakemake.output.commitments).parent,
        Path(snakemake.output.key).parent,
    )
