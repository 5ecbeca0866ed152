"""Draw one concealed case of an opened block: residual, sentence, corrected fit, truth."""

from pathlib import Path

from concealed import case_figure
from eitskin.errors import reported

with reported(snakemake.log[0]):
    block = Path(snakemake.input.score).parents[1]
    out = tuple(Path(snakemake.output[suffix]) for suffix in ("svg", "png", "csv"))
    case_figure.write(block, Path(snakemake.input.schema), out)
