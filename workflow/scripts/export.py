"""A predictor as one file that needs no torch."""

from eitskin.data import baseline, dataset, recording, splits
from eitskin.exported import file
from eitskin.learn import export, model_file
from eitskin.provenance import recorded

with recorded(snakemake):
    files, params = snakemake.input, snakemake.params
    data = dataset.read(files.dataset)
    part = splits.read(files.split, data.table)
    recorded = recording.read(files.recording) if files.recording else None
    skin = recorded.metadata["skin"] if recorded else params.skin
    level = baseline.level(recorded, data.metadata["lost_channels"]) if recorded else None
    model = model_file.read_seeds(files.models)
    exported = export.export(model, data, part, skin, params.epochs, level)
    file.write(exported, snakemake.output[0])
