"""Collect the ablation of choices in training."""

import json
from pathlib import Path

import pandas as pd

from eitskin.paper import ablation
from eitskin.provenance import recorded

with recorded(snakemake):
    files, params, tables = snakemake.input, snakemake.params, snakemake.output
    varied, compared, budget = [], [], {"budget": params.budget}
    for setting_columns, errors in zip(params.varied, files.varied, strict=True):
        varied += ablation.varied_rows(pd.read_csv(errors), setting_columns | budget)
    errors = zip(files.plain, files.informed, strict=True)
    setting_files = zip(files.plain_setting, files.informed_setting, strict=True)
    for setting_columns, pair, choices in zip(params.compared, errors, setting_files, strict=True):
        plain, informed = (json.loads(Path(file).read_text("utf-8"))["told"] for file in choices)
        setting_columns = (
            setting_columns | budget | {"plain_setting": plain, "informed_setting": informed}
        )
        compared += ablation.compared_rows(*map(pd.read_csv, pair), setting_columns)
    ablation.write(varied, compared, tables.varied, tables.compared, tables.markdown)
