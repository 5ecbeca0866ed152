"""Judge geometries on reciprocal pairs left out; a drawing's worth by leaving it out too."""

import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.data import recording
from eitskin.provenance import recorded
from proof.tank_geometry import judge, sentence, without_drawing

with recorded(snakemake):
    recorded = recording.read(snakemake.input[0])
    variants = {"as its owner believes": recorded}
    if recorded.skin.electrode_width_mm is not None:
        variants["without the drawing"] = without_drawing(recorded)
    tables, sentences = [], []
    for beliefs, variant in variants.items():
        table = judge(variant, snakemake.params.seed)
        tables.append(table.assign(recording=snakemake.wildcards.recording, told=beliefs))
        sentences.append(f"{snakemake.wildcards.recording}, {beliefs}: {sentence(table)}")
    with atomic_path(snakemake.output.table) as path:
        pd.concat(tables).to_csv(path, index=False)
    with atomic_path(snakemake.output.sentence) as path:
        path.write_text("\n".join(sentences) + "\n", encoding="utf-8")
