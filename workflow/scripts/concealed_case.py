"""Draw one concealed case of an opened block: residual, sentence, corrected fit, truth."""

from pathlib import Path

from eitskin.provenance import recorded
from proof import case_figure

with recorded(snakemake):
    block = Path(snakemake.input.score).parents[1]
    figure_paths = tuple(Path(snakemake.output[suffix]) for suffix in ("svg", "png", "csv"))
    case_figure.write(block, Path(snakemake.input.schema), figure_paths)
