"""Draw a skin with a concealed effect: its recording, and more touches for the test."""

from pathlib import Path

from eitskin.provenance import recorded
from loop import case
from loop.imitation import PressPrior

with recorded(snakemake):
    params = snakemake.params
    folder = Path(snakemake.output.recording).parent
    prior = PressPrior(params.forces, params.probe_mm)
    case.write(*params.drawn, folder, case.Size(**params.size), prior)
