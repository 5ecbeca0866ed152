"""Errors of a simulation's model on a recording's test part, as trained and adapted."""

from eitskin.data import dataset, recording, splits, unit_disc
from eitskin.learn import metrics, model_file, transfer, transfer_runs
from eitskin.learn.train import Split
from eitskin.provenance import recorded

with recorded(snakemake):
    files = snakemake.input
    source, target = dataset.read(files.source), dataset.read(files.target)
    source_part = splits.read(files.source_split, source.table)
    part = splits.read(files.split, target.table)
    angles = unit_disc.electrode_deg(recording.read(files.recording).skin)
    seeds = range(snakemake.params.seed, snakemake.params.seed + transfer_runs.DRAWS)
    draws = [transfer_runs.labelled(target.table, part, seed) for seed in seeds]
    sides = Split(source, source_part), Split(target, part)
    model = model_file.read_seeds(files.models)
    rows = transfer.transferred(model, *sides, angles, draws)
    metrics.write(rows, snakemake.output[0])
