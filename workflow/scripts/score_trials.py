"""Score the diagnoses of recordings with known truth."""

from pathlib import Path

from calibration import query_score, score
from calibration.blocks import of_queries
from eitskin.errors import reported

with reported(snakemake.log[0]):
    folder = Path(snakemake.output[0]).parent
    block = snakemake.params.block
    (query_score if of_queries(block) else score).write(folder, block, snakemake.params.size)
