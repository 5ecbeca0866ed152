"""Draw a skin with a concealed effect: its recording, and more touches for the test."""

from pathlib import Path

from eitskin.errors import reported
from loop import case
from loop.imitation import PressPrior

with reported(snakemake.log[0]):
    params = snakemake.params
    folder = Path(snakemake.output.recording).parent
    prior = PressPrior(params.forces, params.probe_mm)
    case.write(*params.drawn, folder, case.Size(**params.size), prior)
