"""Open a block's truths against the seal over its verdicts."""

from pathlib import Path

from eitskin.provenance import recorded
from proof import sealing

with recorded(snakemake):
    sealing.unlock(Path(snakemake.input.seal).parent, Path(snakemake.input.key).parent)
