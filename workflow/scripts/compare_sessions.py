"""Compare the sessions of a recording: what they share and what changed between them."""

from eitskin import recording
from eitskin.diagnose import compare
from eitskin.diagnose.diagnose import diagnose
from eitskin.errors import reported

with reported(snakemake.log[0]):
    path = snakemake.input[0]
    founds = {
        f"session {name}": diagnose(part, snakemake.params.seed, progress=True)
        for name, part in compare.parts(recording.read(path), path).items()
    }
    output = snakemake.output
    compare.write(compare.compare(founds), output.json, output.page)
