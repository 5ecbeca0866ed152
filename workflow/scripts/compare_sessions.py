"""Compare the sessions of a recording: what they share and what changed between them."""

from eitskin.data import recording
from eitskin.diagnose.comparison import compare, result
from eitskin.diagnose.diagnosis import diagnose
from eitskin.errors import named, reported

with reported(snakemake.log[0]):
    path = snakemake.input[0]
    parts = compare.parts(recording.read(path), path)
    with named(path):
        founds = {
            f"session {name}": diagnose(part, snakemake.params.seed, progress=True)
            for name, part in parts.items()
        }
    result.write(result.result(compare.compare(founds)), snakemake.output[0])
