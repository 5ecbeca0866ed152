"""Open a block's truths against the seal over its verdicts."""

from pathlib import Path

from eitskin.errors import reported
from proof import sealing

with reported(snakemake.log[0]):
    sealing.unlock(Path(snakemake.input.seal).parent, Path(snakemake.input.key).parent)
