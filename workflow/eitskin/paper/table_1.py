"""Table I: every model's metrics in one file, the paper's numbers beside them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.data.dataset import TARGETS
from eitskin.errors import InputError
from eitskin.learn.metrics import COLUMNS, ENSEMBLE, METRICS, MIN_SEEDS, interval
from eitskin.learn.models import PHYSICS_INFORMED

MARKDOWN_ONLY = ("origin", "each")  # of the metrics' columns, for the Markdown alone
TABLE = (
    *(column for column in COLUMNS if column not in (*MARKDOWN_ONLY, "ensemble")),
    "limit",
    "paper",
)
GROUP = ["configuration", "recording", "origin", "split", "budget"]
SYMBOLS = {"r2": "R²", "mae": "MAE"}  # what the Markdown table shows, as the paper's does


def paper(path: str | Path) -> pd.DataFrame:
    """The paper's Table I: recording simulated or real, model, target, metric, value."""
    return pd.read_csv(path)


def collect(
    paths: list[str | Path],
    published: str | Path,
    repeated: Sequence[str],
    limits: Sequence[str | Path] = (),
) -> pd.DataFrame:
    """Rows (TABLE and MARKDOWN_ONLY) of the metrics files and of ensembles, in a fixed order;
    raises InputError without files, or for other columns.

    `paper`, from the file `published`, is filled where the row repeats the paper's experiment: a
    configuration of `repeated` (of `rows.repeated`), split by random frame (a place or session
    split is another experiment). The paper's recording was never published, so that recordings have
    no such number. `limit`, from files of `limit.score`: the error of the posterior mean under the
    set's distributions, where it was computed.
    """
    if not paths:
        raise InputError("table_1", "metrics files", "none", "at least one")
    tables = []
    for path in paths:
        na_values = {"low": "", "high": "", "ensemble": ""}
        kinds = {"each": str}
        table = pd.read_csv(path, keep_default_na=False, na_values=na_values, dtype=kinds)
        if list(table.columns) != list(COLUMNS):
            raise InputError(path, "columns", list(table.columns), f"{list(COLUMNS)}")
        tables.append(table)
    rows = pd.concat([_with_ensemble(table) for table in tables], ignore_index=True)
    rows = rows.merge(
        _limits(limits, "limit").rename(columns={"value": "limit"}),
        on=["configuration", "recording", "split", "target", "metric"],
        how="left",
        validate="many_to_one",
    )
    published_values = paper(published)
    printed = published_values[published_values["recording"] == "simulated"].rename(
        columns={"value": "paper"}
    )
    configurations = pd.DataFrame({"configuration": list(repeated)}, dtype=str)
    printed = printed.assign(split="random").merge(configurations, "cross")
    keys = ["configuration", "recording", "split", "model", "target", "metric"]
    rows = rows.merge(printed, on=keys, how="left", validate="many_to_one")
    order = {
        "split": ["random", "place", "session", "continuous"],
        "model": [
            m + end for m in dict.fromkeys(published_values["model"]) for end in ("", ENSEMBLE)
        ],
        "target": list(TARGETS),
        "metric": list(METRICS),
    }
    sort_columns = ["configuration", "recording", "split", "budget", "model", "target", "metric"]

    def rank(column: pd.Series) -> pd.Series:
        names = order.get(column.name, [])
        return column.map(
            lambda value: f"{names.index(value):03d}" if value in names else f"~{value}"
        )

    return rows.sort_values(sort_columns, key=rank, ignore_index=True)[[*TABLE, *MARKDOWN_ONLY]]


def _with_ensemble(table: pd.DataFrame) -> pd.DataFrame:
    """Rows of a metrics file and, for several seeds, of their ensemble."""
    seeded = table[(table["seeds"] > 1) & table["ensemble"].notna()]
    ensemble_columns = {"model": seeded["model"] + ENSEMBLE, "mean": seeded["ensemble"]}
    return pd.concat(
        [table, seeded.assign(**ensemble_columns, low=float("nan"), high=float("nan"), each="")]
    )


def _limits(paths: Sequence[str | Path], estimate: str) -> pd.DataFrame:
    """configuration, recording, split, target, metric, value of one estimate."""
    columns = ["configuration", "recording", "split", "target", "metric", "value"]
    tables = [pd.read_csv(path) for path in paths]
    if not tables:
        return pd.DataFrame(columns=columns).astype({"value": float})
    rows = pd.concat(tables, ignore_index=True)
    return rows.loc[rows["estimate"] == estimate, columns]


def write(
    paths: list[str | Path],
    published: str | Path,
    repeated: Sequence[str],
    limits: Sequence[str | Path],
    csv: str | Path,
    markdown: str | Path,
) -> None:
    """Write the rows of `collect` to `csv` (columns TABLE) and as a `markdown` table, which has the
    limit with skin and gains known as well.
    """
    rows = collect(paths, published, repeated, limits)
    with atomic_path(csv) as temporary:
        rows[list(TABLE)].to_csv(temporary, index=False, float_format="%.6g")
    with atomic_path(markdown) as temporary:
        known_limits = _limits(limits, "limit_known")
        temporary.write_text(to_markdown(rows, known_limits), encoding="utf-8")


def to_markdown(rows: pd.DataFrame, known_limits: pd.DataFrame) -> str:
    """A section for each dataset, split and budget, with one line for each model: mean [low, high]
    (paper), or every seed's value in place of an interval.

    Where there is a limit, one line of it and one of `known_limits`, with skin and gains known.
    """
    lines = [
        "# Table I",
        "",
        "Mean over seeds [95 % interval over seeds; of fewer than five each seed's value] on the",
        "test part; in brackets of their own the paper's number, where the row repeats its",
        "experiment. -ensemble: the mean of the seeds' estimates. x, y and depth in mm, F in N.",
        "One model minus another: of the same seeds, paired, with its 95 % interval; R² is better",
        "where it is larger, MAE where it is smaller.",
        "Limit: the posterior mean given the physics and the distributions drawn from, on some of",
        "the tested samples.",
    ]
    shown = rows[rows["metric"].isin(SYMBOLS)]
    for (configuration, recording, origin, split, budget), group in shown.groupby(
        GROUP, sort=False
    ):
        title = f"{recording}, {configuration}" if configuration else f"{recording} ({origin})"
        trained, epochs, seeds, tested = (
            "/".join(f"{value:,}" for value in sorted(group[column].unique()))
            for column in ("trained_samples", "epochs", "seeds", "tested_samples")
        )
        columns = group[["target", "metric"]].drop_duplicates().itertuples(index=False)
        columns = [tuple(column) for column in columns]
        lines += [
            "",
            f"## {title} · split by {split} · budget {budget}",
            "",
            f"trained on {trained} samples · epochs {epochs} · seeds {seeds} · tested on {tested}",
            "",
            "| model | " + " | ".join(f"{SYMBOLS[m]} {t}" for t, m in columns) + " |",
            "|---" * (len(columns) + 1) + "|",
        ]
        for model, cells in group.groupby("model", sort=False):
            cell = cells.set_index(["target", "metric"])
            lines.append(f"| {model} | " + " | ".join(_cell(cell.loc[c]) for c in columns) + " |")
        for model, difference in _latent_loss_differences(group).items():
            cells = " | ".join(_signed(*difference[column]) for column in columns)
            lines.append(f"| {model} | {cells} |")
        if group["limit"].notna().all():
            known_rows = known_limits[
                (known_limits["configuration"] == configuration) & (known_limits["split"] == split)
            ]
            for name, values in (
                ("limit", cell["limit"]),
                (
                    "limit, skin and gains known",
                    known_rows.set_index(["target", "metric"])["value"],
                ),
            ):
                cells = " | ".join(f"{values[c]:.3f}" for c in columns)
                lines.append(f"| {name} | {cells} |")
    return "\n".join(lines) + "\n"


def _latent_loss_differences(group: pd.DataFrame) -> dict[str, dict[tuple[str, str], np.ndarray]]:
    """By names of two models, and target and metric: the difference of a physics-informed model and
    the same network without the latent loss, with the ends of its interval over seeds (3,), where
    both have the same number of seeds, at least MIN_SEEDS."""
    seed_values = {
        (row.model, row.target, row.metric): np.array([float(text) for text in row.each.split(";")])
        for row in group[group["each"] != ""].itertuples(index=False)
    }
    differences: dict[str, dict[tuple[str, str], np.ndarray]] = {}
    for (model, *column), values in seed_values.items():
        plain = model.removeprefix(PHYSICS_INFORMED)
        plain_values = seed_values.get((plain, *column))
        if plain == model or plain_values is None or len(values) < MIN_SEEDS:
            continue
        if len(values) == len(plain_values):
            difference = values - plain_values
            model_differences = differences.setdefault(f"{model} minus {plain}", {})
            model_differences[tuple(column)] = np.array([difference.mean(), *interval(difference)])
    return differences


def _signed(mean: float, low: float, high: float) -> str:
    return f"{mean:+.3f} [{low:+.3f}, {high:+.3f}]"


def _cell(row: pd.Series) -> str:
    text = f"{row['mean']:.3f}"
    if pd.notna(row["low"]):
        text += f" [{row['low']:.3f}, {row['high']:.3f}]"
    elif row["seeds"] > 1 and row["each"]:
        text += (
            " ["
            + "; ".join(f"{float(seed_value):.3f}" for seed_value in row["each"].split(";"))
            + "]"
        )
    return text + (f" ({row['paper']:g})" if pd.notna(row["paper"]) else "")
