"""The table of the closed loop: errors by source, differences paired over seeds, and a reading."""

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
ENOUGH = 0.15  # of the belief's error, that the truth must save for a case to say much
SHOWN = {"F": "F, N", PLACE: "place (mean of x and y), mm"}
TABLE = (
    *KEYS,
    *("method", "labelled_frames", "variable", "metric", "mean", "low", "high", "unit", "seeds"),
    *("saved", "saved_low", "saved_high", "saved_share", "left_out"),
)

WORTH = ("model", "against", "cases", "saved", "low", "high", "sure", "over_truth")


def collect(files: Files) -> pd.DataFrame:
    """The runs of all files, KEYS before them, with rows of PLACE.

    Raises InputError where there are none, or a file holds something else.
    """
    runs = transfer_table.collect(files, KEYS, "loop")
    by = [*KEYS, "method", "draw", "seed", "labelled_frames", "metric", "left_out"]
    xy = runs[runs["variable"].isin(["x", "y"]) & runs["metric"].isin(["mae", "rmse"])]
    both = xy.groupby(by, sort=False)["value"].agg(["mean", "size"]).reset_index()
    both = both[both["size"] == 2].rename(columns={"mean": "value"}).assign(variable=PLACE)
    return pd.concat([runs, both[runs.columns]], ignore_index=True)


def paired(one: pd.DataFrame, other: pd.DataFrame) -> np.ndarray:
    """(S, 2): values of two methods' runs of the same seeds."""
    joined = one.merge(other, on="seed")
    return joined[["value_x", "value_y"]].to_numpy()


def summarise(runs: pd.DataFrame) -> pd.DataFrame:
    """Rows (TABLE): mean and 95 % interval (Student's t) over seeds, and what is saved against the
    same method from BELIEF: mean and interval of the difference of equal seeds, and its share."""
    rows = []
    group = [*KEYS, "method", "variable", "metric"]
    of = {names: part for names, part in runs.groupby(group, sort=False)}
    for names, part in of.items():
        row = dict(zip(group, names, strict=True))
        row["left_out"] = part["left_out"].iloc[0]
        if not row["left_out"]:
            value = part["value"].to_numpy()
            row |= {"mean": value.mean(), "seeds": len(value)}
            row["low"], row["high"] = interval(value)
            row["labelled_frames"] = int(part["labelled_frames"].iloc[0])
            unit = UNITS["x" if row["variable"] == PLACE else row["variable"]]
            row["unit"] = "1" if row["metric"] == "r2" else unit
            method = ZERO_SHOT if row["source"] == LABELS else row["method"]
            base = of.get((*names[:2], BELIEF, method, *names[4:]))
            if base is not None and row["source"] != BELIEF:
                before, now = paired(base, part).T
                row["saved"] = (before - now).mean()
                row["saved_low"], row["saved_high"] = interval(before - now)
                row["saved_share"] = row["saved"] / before.mean()
        rows.append(row)
    table = pd.DataFrame(rows, columns=list(TABLE))
    counts = ["labelled_frames", "seeds"]
    table[counts] = table[counts].astype("Int64")
    return table


def closed(runs: pd.DataFrame) -> pd.DataFrame:
    """case, model, variable; truth_saves: the share of BELIEF's mean absolute error, zero-shot,
    that TRUTH saves; closed: what DIAGNOSIS saves over what TRUTH saves, of the means over seeds,
    NaN where the truth saves under ENOUGH."""
    rows = []
    kept = runs[(runs["metric"] == "mae") & (runs["method"] == ZERO_SHOT)]
    for (case, model, variable), part in kept.groupby(["case", "model", "variable"], sort=False):
        mean = part.groupby("source")["value"].mean()
        if {BELIEF, DIAGNOSIS, TRUTH} <= set(mean.index):
            most = mean[BELIEF] - mean[TRUTH]
            share = most / mean[BELIEF]
            got = (mean[BELIEF] - mean[DIAGNOSIS]) / most if share >= ENOUGH else np.nan
            rows.append((case, model, variable, share, got))
    return pd.DataFrame(rows, columns=["case", "model", "variable", "truth_saves", "closed"])


def worth(runs: pd.DataFrame, share: pd.DataFrame) -> pd.DataFrame:
    """WORTH: what DIAGNOSIS saves, zero-shot, of the force's mean absolute error against BELIEF and
    AUTHORS over the cases where TRUTH saves ENOUGH; share: `closed`'s table of the same runs.

    The mean over cases of the share saved, its interval (Student's t over cases), the cases whose
    own interval over seeds lies above zero, and the median over cases of DIAGNOSIS' error over
    TRUTH's. NaN where there is no case.
    """
    kept = runs[(runs["metric"] == "mae") & (runs["method"] == ZERO_SHOT)]
    kept = kept[kept["variable"] == "F"]
    much = share[(share["variable"] == "F") & (share["truth_saves"] >= ENOUGH)]
    rows = []
    for model, own in kept.groupby("model", sort=False):
        told = list(much.loc[much["model"] == model, "case"])
        of = {key: part for key, part in own.groupby(["case", "source"], sort=False)}
        ratio = [
            of[case, DIAGNOSIS]["value"].mean() / of[case, TRUTH]["value"].mean() for case in told
        ]
        for rival in (BELIEF, AUTHORS):
            known = [case for case in told if (case, rival) in of]
            pairs = [paired(of[case, rival], of[case, DIAGNOSIS]).T for case in known]
            saved = np.array([1.0 - now.mean() / before.mean() for before, now in pairs])
            sure = sum(interval(before - now)[0] > 0.0 for before, now in pairs)
            mean = saved.mean() if len(saved) else np.nan
            middle = np.median(ratio) if ratio else np.nan
            rows.append((model, rival, len(pairs), mean, *interval(saved), sure, middle))
    return pd.DataFrame(rows, columns=list(WORTH))


def told(folders: dict[str, str | Path]) -> pd.DataFrame:
    """case, concealed, named: the effects of each case's truth.json (empty for a real recording)
    and those of its diagnosis.json, with their parameters."""
    rows = []
    for case, folder in folders.items():
        truth = Path(folder) / "truth.json"
        there = json.loads(truth.read_text("utf-8"))["effects"] if truth.exists() else []
        said = json.loads((Path(folder) / "diagnosis" / "diagnosis.json").read_text("utf-8"))
        named = [
            {**e, "parameters": {k: p["value"] for k, p in e["parameters"].items()}}
            for e in said["effects"]
        ]
        rows.append((case, _listed(there), _listed(named) or said["verdict"]))
    return pd.DataFrame(rows, columns=["case", "concealed", "named"])


def _listed(effects: list[dict]) -> str:
    def value(given: float | list[float] | None) -> str:
        if isinstance(given, list):
            return f"{len(given)} values" if len(given) > 2 else ", ".join(map(value, given))
        return "null" if given is None else f"{given:.3g}"

    texts = []
    for effect in effects:
        parameters = effect.get("parameters", {}).items()
        inside = ", ".join(f"{key} {value(given)}" for key, given in parameters)
        texts.append(f"{effect['name']} ({inside})" if inside else effect["name"])
    return "; ".join(texts)


def write(
    files: Files, folders: dict[str, str | Path], csv: str | Path, markdown: str | Path
) -> None:
    """Write the table to `csv` (columns TABLE) and, read, to `markdown`."""
    runs = collect(files)
    table = summarise(runs)
    with atomic_path(csv) as temporary:
        table.to_csv(temporary, index=False, float_format="%.6g")
    with atomic_path(markdown) as temporary:
        temporary.write_text(to_markdown(table, runs, told(folders)), encoding="utf-8")


def to_markdown(table: pd.DataFrame, runs: pd.DataFrame, cases: pd.DataFrame) -> str:
    """What was concealed and named, and what the names were worth; for each model and variable the
    sources side by side, then what alignments make of the belief's models with the same labels."""
    share = closed(runs)
    lines = [
        "# The loop closed",
        "",
        "Mean absolute errors on the recording's test part of models trained on a simulation, mean",
        "[95 % interval] over seeds; each seed has training samples, noise and weights of its own,",
        "samples and noise the same for every source. *saved* is the belief's error minus the",
        "diagnosis', paired by seed; *closed* is that over what the truth saves, given where the",
        f"truth saves {percent(ENOUGH)} or more.",
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
            own = errors[(errors["model"] == model) & (errors["variable"] == variable)]
            told = share[(share["model"] == model) & (share["variable"] == variable)]
            if len(own):
                lines += ["", f"## {model}, {title}", "", *_sources(own, told), ""]
                lines += ["Aligned with the labels that the diagnosis had, or less:", ""]
                lines += _alignments(own)
    missing = table[table["left_out"] != ""]
    for row in missing.drop_duplicates(["case", "method", "variable", "left_out"]).itertuples():
        what = ", ".join(filter(None, [row.case, row.method, row.variable]))
        lines.append(f"- left out, {what}: {row.left_out}")
    return "\n".join(lines) + "\n"


def _worth(found: pd.DataFrame) -> list[str]:
    lines = [
        "Of the force's error, over the cases where the truth saves"
        f" {percent(ENOUGH)} or more of it:",
        "",
        "| model | against | cases | saved, mean [95 % over cases] | cases whose own interval over"
        " seeds lies above zero | error over the truth's, median |",
        "|---" * 6 + "|",
    ]
    for row in found.itertuples():
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


def _sources(own: pd.DataFrame, told: pd.DataFrame) -> list[str]:
    columns = [*SOURCES, LABELS]
    lines = [
        "| case | " + " | ".join([*columns, "saved", "truth saves", "closed"]) + " |",
        "|---" * (len(columns) + 4) + "|",
    ]
    for case in own["case"].unique():
        plain = own[(own["case"] == case) & own["method"].isin([ZERO_SHOT, TRAINED_FEW])]
        of = {source: plain[plain["source"] == source] for source in columns}
        cells = [_cell(of[source]) for source in columns]
        cells.append(_cell(of[DIAGNOSIS], "saved", "saved_low", "saved_high"))
        row = told[told["case"] == case]
        for key in ("truth_saves", "closed"):
            known = len(row) and np.isfinite(row[key].iloc[0])
            cells.append(percent(row[key].iloc[0]) if known else "")
        lines.append(f"| {case} | " + " | ".join(cells) + " |")
    return lines


def _alignments(own: pd.DataFrame) -> list[str]:
    methods = [m for m in METHODS if m in set(own["method"]) and m != TRAINED_FEW]
    lines = [
        "| case | source | " + " | ".join(methods) + " |",
        "|---" * (len(methods) + 2) + "|",
    ]
    for case in own["case"].unique():
        for source in (BELIEF, AUTHORS, DIAGNOSIS):
            part = own[(own["case"] == case) & (own["source"] == source)]
            cells = [_cell(part[part["method"] == method]) for method in methods]
            if any(cells):
                lines.append(f"| {case} | {source} | " + " | ".join(cells) + " |")
    return lines
