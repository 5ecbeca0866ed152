"""Judge a one-sided misfit's law on drives left out."""

from eitskin.atomic import atomic_path
from eitskin.data import recording
from eitskin.errors import reported
from studies.ground_return import judge, sentence

with reported(snakemake.log[0]):
    table = judge(recording.read(snakemake.input[0]), snakemake.params.seed)
    with atomic_path(snakemake.output.table) as path:
        table.to_csv(path, index=False)
    with atomic_path(snakemake.output.sentence) as path:
        path.write_text(sentence(table) + "\n", encoding="utf-8")
