"""The table of the closed loop: errors by source, differences paired by seed, and a reading."""

import json
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.data.dataset import UNITS
from eitskin.learn.metrics import interval
from eitskin.learn.transfer_runs import METHODS, TRAINED_FEW, ZERO_SHOT
from eitskin.paper import transfer_table
from eitskin.paper.transfer_table import Files
from eitskin.quantities import percent
from loop.naming import AUTHORS, BELIEF, DIAGNOSIS, LABELS, SOURCES, TRUTH

KEYS = ("case", "model", "source")
PLACE = "place"  # the mean of the errors of x and y
TELLING_SHARE = 0.15  # of the belief's error saved by the truth; below, shares of it are too noisy
SHOWN = {"F": "F, N", PLACE: "place (mean of x and y), mm"}
TABLE = (
    *KEYS,
    *("method", "labelled_frames", "variable", "metric", "mean", "low", "high", "unit", "seeds"),
    *("saved", "saved_low", "saved_high", "saved_share", "left_out"),
)

WORTH = ("model", "against", "cases", "saved", "low", "high", "sure", "over_truth")


def collect(files: Files) -> pd.DataFrame:
    """The runs of all files, preceded by KEYS, with rows of PLACE.

    Raises InputError without files and for a file with other columns.
    """
    runs = transfer_table.collect(files, KEYS, "loop")
    run_columns = [*KEYS, "method", "draw", "seed", "labelled_frames", "metric", "left_out"]
    xy = runs[runs["variable"].isin(["x", "y"]) & runs["metric"].isin(["mae", "rmse"])]
    place_rows = xy.groupby(run_columns, sort=False)["value"].agg(["mean", "size"]).reset_index()
    place_rows = (
        place_rows[place_rows["size"] == 2].rename(columns={"mean": "value"}).assign(variable=PLACE)
    )
    return pd.concat([runs, place_rows[runs.columns]], ignore_index=True)


def paired(runs_a: pd.DataFrame, runs_b: pd.DataFrame) -> np.ndarray:
    """(S, 2): values of two methods' runs of the same seeds."""
    joined = runs_a.merge(runs_b, on="seed")
    return joined[["value_x", "value_y"]].to_numpy()


def summarise(runs: pd.DataFrame) -> pd.DataFrame:
    """Rows (TABLE): mean and 95 % interval (Student's t) over seeds, and the error saved against
    the same method from BELIEF: mean and interval of differences of equal seeds, and its share."""
    rows = []
    group = [*KEYS, "method", "variable", "metric"]
    groups = {names: group_runs for names, group_runs in runs.groupby(group, sort=False)}
    for names, group_runs in groups.items():
        row = dict(zip(group, names, strict=True))
        row["left_out"] = group_runs["left_out"].iloc[0]
        if not row["left_out"]:
            value = group_runs["value"].to_numpy()
            row |= {"mean": value.mean(), "seeds": len(value)}
            row["low"], row["high"] = interval(value)
            row["labelled_frames"] = int(group_runs["labelled_frames"].iloc[0])
            unit = UNITS["x" if row["variable"] == PLACE else row["variable"]]
            row["unit"] = "1" if row["metric"] == "r2" else unit
            method = ZERO_SHOT if row["source"] == LABELS else row["method"]
            belief_runs = groups.get((*names[:2], BELIEF, method, *names[4:]))
            if belief_runs is not None and row["source"] != BELIEF:
                belief_values, source_values = paired(belief_runs, group_runs).T
                row["saved"] = (belief_values - source_values).mean()
                row["saved_low"], row["saved_high"] = interval(belief_values - source_values)
                row["saved_share"] = row["saved"] / belief_values.mean()
        rows.append(row)
    table = pd.DataFrame(rows, columns=list(TABLE))
    counts = ["labelled_frames", "seeds"]
    table[counts] = table[counts].astype("Int64")
    return table


def closed_shares(runs: pd.DataFrame) -> pd.DataFrame:
    """case, model, variable; truth_saves: the share of BELIEF's mean absolute error, zero-shot,
    saved by TRUTH; closed: the error saved by DIAGNOSIS over that saved by TRUTH, from means over
    seeds, NaN where the truth saves less than TELLING_SHARE."""
    rows = []
    error_runs = runs[(runs["metric"] == "mae") & (runs["method"] == ZERO_SHOT)]
    for (case, model, variable), case_runs in error_runs.groupby(
        ["case", "model", "variable"], sort=False
    ):
        mean = case_runs.groupby("source")["value"].mean()
        if {BELIEF, DIAGNOSIS, TRUTH} <= set(mean.index):
            truth_saving = mean[BELIEF] - mean[TRUTH]
            share = truth_saving / mean[BELIEF]
            closed_share = (
                (mean[BELIEF] - mean[DIAGNOSIS]) / truth_saving
                if share >= TELLING_SHARE
                else np.nan
            )
            rows.append((case, model, variable, share, closed_share))
    return pd.DataFrame(rows, columns=["case", "model", "variable", "truth_saves", "closed"])


def worth(runs: pd.DataFrame, share: pd.DataFrame) -> pd.DataFrame:
    """WORTH: the share of the force's mean absolute error, zero-shot, that DIAGNOSIS saves against
    BELIEF and AUTHORS, over the cases where TRUTH saves TELLING_SHARE; share: the table of
    `closed_shares` of the same runs.

    The mean over cases and its interval (Student's t over cases), the number of cases whose
    interval over seeds lies above zero, and the median over cases of the error of DIAGNOSIS over
    that of TRUTH. NaN without cases.
    """
    error_runs = runs[(runs["metric"] == "mae") & (runs["method"] == ZERO_SHOT)]
    error_runs = error_runs[error_runs["variable"] == "F"]
    telling_cases = share[(share["variable"] == "F") & (share["truth_saves"] >= TELLING_SHARE)]
    rows = []
    for model, model_runs in error_runs.groupby("model", sort=False):
        case_names = list(telling_cases.loc[telling_cases["model"] == model, "case"])
        runs_by_case = {
            key: part for key, part in model_runs.groupby(["case", "source"], sort=False)
        }
        ratio = [
            runs_by_case[case, DIAGNOSIS]["value"].mean()
            / runs_by_case[case, TRUTH]["value"].mean()
            for case in case_names
        ]
        for rival in (BELIEF, AUTHORS):
            compared_cases = [case for case in case_names if (case, rival) in runs_by_case]
            pairs = [
                paired(runs_by_case[case, rival], runs_by_case[case, DIAGNOSIS]).T
                for case in compared_cases
            ]
            saved_shares = np.array(
                [
                    1.0 - diagnosis_values.mean() / rival_values.mean()
                    for rival_values, diagnosis_values in pairs
                ]
            )
            certain_count = sum(
                interval(rival_values - diagnosis_values)[0] > 0.0
                for rival_values, diagnosis_values in pairs
            )
            mean = saved_shares.mean() if len(saved_shares) else np.nan
            median_ratio = np.median(ratio) if ratio else np.nan
            rows.append(
                (
                    model,
                    rival,
                    len(pairs),
                    mean,
                    *interval(saved_shares),
                    certain_count,
                    median_ratio,
                )
            )
    return pd.DataFrame(rows, columns=list(WORTH))


def effects_of_cases(folders: dict[str, str | Path]) -> pd.DataFrame:
    """case, concealed, named: the effects of each case's truth.json (empty for a real recording)
    and those of its diagnosis.json, with their parameters."""
    rows = []
    for case, folder in folders.items():
        truth = Path(folder) / "truth.json"
        true_effects = json.loads(truth.read_text("utf-8"))["effects"] if truth.exists() else []
        diagnosis = json.loads((Path(folder) / "diagnosis" / "diagnosis.json").read_text("utf-8"))
        diagnosed_effects = [
            {
                **effect,
                "parameters": {
                    k: parameter["value"] for k, parameter in effect["parameters"].items()
                },
            }
            for effect in diagnosis["effects"]
        ]
        rows.append(
            (case, _listed(true_effects), _listed(diagnosed_effects) or diagnosis["verdict"])
        )
    return pd.DataFrame(rows, columns=["case", "concealed", "named"])


def _listed(effects: list[dict]) -> str:
    def value(number: float | list[float] | None) -> str:
        if isinstance(number, list):
            return f"{len(number)} values" if len(number) > 2 else ", ".join(map(value, number))
        return "null" if number is None else f"{number:.3g}"

    texts = []
    for effect in effects:
        parameters = effect.get("parameters", {}).items()
        values = ", ".join(f"{key} {value(number)}" for key, number in parameters)
        texts.append(f"{effect['name']} ({values})" if values else effect["name"])
    return "; ".join(texts)


def write(
    files: Files, folders: dict[str, str | Path], csv: str | Path, markdown: str | Path
) -> None:
    """Write the table to `csv` (columns TABLE) and with its reading to `markdown`."""
    runs = collect(files)
    table = summarise(runs)
    with atomic_path(csv) as temporary:
        table.to_csv(temporary, index=False, float_format="%.6g")
    with atomic_path(markdown) as temporary:
        temporary.write_text(to_markdown(table, runs, effects_of_cases(folders)), encoding="utf-8")


def to_markdown(table: pd.DataFrame, runs: pd.DataFrame, cases: pd.DataFrame) -> str:
    """The concealed and the diagnosed effects of every case and the errors saved; then, for each
    model and variable, the sources side by side, and the alignments with the same labels."""
    share = closed_shares(runs)
    lines = [
        "# The loop closed",
        "",
        "Mean absolute errors on the recording's test part of models trained on a simulation, mean",
        "[95 % interval] over seeds; each seed has training samples, noise and weights of its own,",
        "samples and noise the same for every source. *saved* is the belief's error minus the",
        "diagnosis', paired by seed; *closed* is that over what the truth saves, given where the",
        f"truth saves {percent(TELLING_SHARE)} or more.",
        "",
        "| case | concealed | named by the diagnosis |",
        "|---|---|---|",
        *(f"| {c.case} | {c.concealed or 'unknown'} | {c.named} |" for c in cases.itertuples()),
        "",
        *_worth(worth(runs, share)),
    ]
    errors = table[(table["metric"] == "mae") & (table["left_out"] == "")]
    for model in table["model"].unique():
        for variable, title in SHOWN.items():
            variable_errors = errors[(errors["model"] == model) & (errors["variable"] == variable)]
            variable_shares = share[(share["model"] == model) & (share["variable"] == variable)]
            if len(variable_errors):
                lines += [
                    "",
                    f"## {model}, {title}",
                    "",
                    *_sources(variable_errors, variable_shares),
                    "",
                ]
                lines += ["Aligned with the labels that the diagnosis had, or less:", ""]
                lines += _alignments(variable_errors)
    missing = table[table["left_out"] != ""]
    for row in missing.drop_duplicates(["case", "method", "variable", "left_out"]).itertuples():
        omission = ", ".join(filter(None, [row.case, row.method, row.variable]))
        lines.append(f"- left out, {omission}: {row.left_out}")
    return "\n".join(lines) + "\n"


def _worth(worth_rows: pd.DataFrame) -> list[str]:
    lines = [
        "Of the force's error, over the cases where the truth saves"
        f" {percent(TELLING_SHARE)} or more of it:",
        "",
        "| model | against | cases | saved, mean [95 % over cases] | cases whose own interval over"
        " seeds lies above zero | error over the truth's, median |",
        "|---" * 6 + "|",
    ]
    for row in worth_rows.itertuples():
        share = "" if np.isnan(row.saved) else percent(row.saved)
        if np.isfinite(row.low):
            share += f" [{percent(row.low)}, {percent(row.high)}]"
        ratio = "" if np.isnan(row.over_truth) else f"{row.over_truth:.2f}"
        cells = (row.model, row.against, row.cases, share, row.sure, ratio)
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return lines


def _cell(rows: pd.DataFrame, mean: str = "mean", low: str = "low", high: str = "high") -> str:
    if rows.empty:
        return ""
    row = rows.iloc[0]
    text = f"{row[mean]:.2f}"
    return text if np.isnan(row[low]) else f"{text} [{row[low]:.2f}, {row[high]:.2f}]"


def _sources(variable_errors: pd.DataFrame, variable_shares: pd.DataFrame) -> list[str]:
    columns = [*SOURCES, LABELS]
    lines = [
        "| case | " + " | ".join([*columns, "saved", "truth saves", "closed"]) + " |",
        "|---" * (len(columns) + 4) + "|",
    ]
    for case in variable_errors["case"].unique():
        plain = variable_errors[
            (variable_errors["case"] == case)
            & variable_errors["method"].isin([ZERO_SHOT, TRAINED_FEW])
        ]
        rows_by_source = {source: plain[plain["source"] == source] for source in columns}
        cells = [_cell(rows_by_source[source]) for source in columns]
        cells.append(_cell(rows_by_source[DIAGNOSIS], "saved", "saved_low", "saved_high"))
        row = variable_shares[variable_shares["case"] == case]
        for key in ("truth_saves", "closed"):
            is_known = len(row) and np.isfinite(row[key].iloc[0])
            cells.append(percent(row[key].iloc[0]) if is_known else "")
        lines.append(f"| {case} | " + " | ".join(cells) + " |")
    return lines


def _alignments(variable_errors: pd.DataFrame) -> list[str]:
    methods = [m for m in METHODS if m in set(variable_errors["method"]) and m != TRAINED_FEW]
    lines = [
        "| case | source | " + " | ".join(methods) + " |",
        "|---" * (len(methods) + 2) + "|",
    ]
    for case in variable_errors["case"].unique():
        for source in (BELIEF, AUTHORS, DIAGNOSIS):
            part = variable_errors[
                (variable_errors["case"] == case) & (variable_errors["source"] == source)
            ]
            cells = [_cell(part[part["method"] == method]) for method in methods]
            if any(cells):
                lines.append(f"| {case} | {source} | " + " | ".join(cells) + " |")
    return lines
