"""Draw who is taken for whom, and whether "other" means its probability."""

from pathlib import Path

from calibration import figures
from eitskin.errors import reported

with reported(snakemake.log[0]):
    figures.write(Path(snakemake.output[0]).parent)
