"""Open a block's truths against the seal over its verdicts."""

from pathlib import Path

from concealed import sealing
from eitskin.errors import reported

with reported(snakemake.log[0]):
    sealing.unlock(Path(snakemake.input.seal).parent, Path(snakemake.input.key).parent)
