"""Draw a skin with a concealed effect: its recording, and more touches for the test."""

from pathlib import Path

from eitskin.provenance import recorded
from eitskin.simulate.imitation import PressPrior
from loop import case

with recorded(snakemake):
    params = snakemake.params
    folder = Path(snakemake.output.recording).parent
    prior = PressPrior(params.forces, params.probe_mm)
    case.write(*params.drawn, folder, case.Size(**params.size), prior)
