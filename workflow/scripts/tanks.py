"""Collect the tanks' tables into one."""

import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.errors import InputError
from eitskin.provenance import recorded

with recorded(snakemake):
    if not snakemake.input.tables:
        raise InputError("config.yaml", "tanks", "none", "a recording's name")
    table = pd.concat([pd.read_csv(path) for path in snakemake.input.tables])
    leading_columns = ["recording", "told", "geometry"]
    with atomic_path(snakemake.output[0]) as path:
        table[[*leading_columns, *table.columns.difference(leading_columns, sort=False)]].to_csv(
            path, index=False
        )
