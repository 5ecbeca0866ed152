"""The score of a block as files: tables and a page in Markdown."""

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.paper.similarity import MEASURES
from proof import causes, judge, measures, opened, sealed_score, sealing
from proof.baselines import NAMING
from proof.claims import Rows, where
from proof.intervals import mean
from proof.markdown import is_share, measured_cells, number, table

FEW = 10  # recordings, of which what was reached or not tells little
P_LEVELS = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 0.5, 0.7, 0.9)  # some three a decade
STRATA = {  # columns of the page's second table: what they are called there, and their line
    "detected": "something noticed",
    "named ≥ 8": "right name or declared class, gap ≥ 8",
    "named 3-5": "right name or declared class, gap 3 to 5",
    "F1 pairs": "F1 of the set",
    "closed": "misfit closed",
    "χ²/dof": "χ²/dof",
    "false alarms": "false alarm",
    "flagged": "flagged",
    "falsely flagged": "falsely flagged",
}


def cases(rows: Rows) -> pd.DataFrame:
    """One line a case: what was concealed, how strong, how alike plain simulation and recording
    are by Table II's measures, what the diagnosis said, and whether it was right."""
    return pd.DataFrame([_case(row) for row in rows])


def _case(row: dict) -> dict:
    diagnosis, hidden, is_right = row["said"], row["hidden"], causes.is_right(row)
    entries = diagnosis["effects"]
    sites = [
        any(judge.sites_right(entry, true_effect) for entry in entries)
        for true_effect, scope in zip(row["truth"], row["scopes"], strict=True)
        if scope == "sparse" and judge.site_kind(true_effect)
    ]
    sentences = (*(e["sentence"] for e in entries), diagnosis["other"]["sentence"] or "")
    return {
        "case": row["case"],
        "generator": row["generator"],
        "kind": row["group"],
        "concealed": _concealed(row),
        "gap_wanted": row["strength"],
        "gap": measures.smallest_gap(row),
        "noise_share": row["level"],
        "rig": _joined(f"{error['kind']} {error['size']:g}" for error in row["rig"]),
        "changed": row["changed"],
        **{
            f"{measure}_{key}": similarity[key]
            for measure, similarity in (row["similarity"] or {}).items()
            for key in ("plain", "change", "moved")
        },
        "verdict": diagnosis["verdict"],
        "said": _joined(map(_sited_name, entries)),
        "alternatives": _joined(name for entry in entries for name in entry["alternatives"]),
        "right": is_right,
        "cause": "" if is_right else causes.cause(row),
        "truth_better_by_nats": causes.better_by(row),
        "rightly_named": measures.right_names(row),
        "sites_right": all(sites) if sites else None,
        "outside_probability": diagnosis["other"]["probability"],
        "chi2_per_dof": hidden["chi2_per_dof"],
        "misfit_closed": measures.misfit_closed(row),
        "black_box_over_ours": measures.boxes_over_ours(row),
        "seconds": row.get("seconds", np.nan),
        "broken": _joined(row["broken"]),
        "sentence": _joined(sentences, " "),
    }


def _joined(texts: Iterable[str], separator: str = "; ") -> str:
    return separator.join(text for text in texts if text)


def _concealed(row: dict) -> str:
    effects = [row["fault"]] if row["fault"] else row["truth"]
    return _joined(map(_sited_name, effects)) or (row["outside"] or {}).get("law", "")


def _sited_name(effect: dict) -> str:
    """An effect's name, with its sites where they are few."""
    kind = judge.site_kind({key: value for key, value in effect.items() if value != []})
    if kind is None or len(effect[kind]) > 6:
        return effect["name"]
    return f"{effect['name']} ({kind} {' '.join(map(str, effect[kind]))})"


def p_values(block: Path, rows: Rows) -> pd.DataFrame:
    """Of recordings where nothing is concealed: the share of the atlas' statistics before any
    effect with a p-value up to p, its interval over the recordings, and their number."""
    columns = [
        pd.read_csv(block / "verdicts" / row["case"] / "evidence" / "atlas_before.csv")["p"]
        for row in rows
        if row["kind"] == "null" and not measures.is_broken(row)
    ]
    lines = []
    for level in P_LEVELS:
        measured = mean(np.array([(column.dropna() <= level).mean() for column in columns]))
        line = {"p": level, "share": measured["value"]}
        lines.append(line | {key: measured[key] for key in ("low", "high", "n")})
    return pd.DataFrame(lines)


def markdown(rows: Rows, lines: pd.DataFrame, methods: pd.DataFrame, command: str) -> str:
    """The page: the claims' table, strata, baselines, what is concealed in plain sense too,
    misses."""
    of_all = lines[lines["rows"] == "all"]
    claims, beside = (of_all[(of_all["gate"] != "") == gated] for gated in (True, False))
    parts = [
        f"`{command}`: {len(rows)} recordings, 95 % intervals.",
        "",
        *table(
            ("recordings", "what", "measured", "95 %", "n", "ceiling", "gate", "", "target", ""),
            [
                (
                    *(*measured_cells(line), number(line["ceiling"], True)),
                    *(line["gate"], _met(line["gate_met"], line["n"])),
                    *(line["target"], _met(line["target_met"], line["n"])),
                )
                for line in claims.to_dict("records")
            ],
        ),
        "",
        "*Ceiling*: Φ(gap / 2), the best that any test between two names can do, in the mean.",
        "Beside it, without a gate:",
        "",
        *table(
            ("recordings", "what", "measured", "95 %", "n", "ceiling"),
            [
                (*measured_cells(line), number(line["ceiling"], True))
                for line in beside.to_dict("records")
            ],
        ),
        "",
        "By generator, kind and gap wanted (in brackets, of how many recordings); flagged: as"
        " physics outside the catalogue, of those that have it:",
        "",
        *table(("recordings", "number", *STRATA), _strata(rows, lines)),
        "",
        "The same recordings by other methods; misfit closed and RMSE on hidden frames, medians"
        " over recordings with an effect:",
        "",
        *table(
            (
                *("method", "false alarms", "right name, singles", "F1 singles", "pairs"),
                *("triples", "misfit closed", "RMSE over ours"),
            ),
            [_method(line) for line in methods.to_dict("records")],
        ),
        "",
        *_plain(rows),
        *_misses(rows),
    ]
    return "\n".join(parts) + "\n"


def _met(met: bool | None, count: int) -> str:
    if met is None:
        return "no recording"
    if count < FEW:
        return f"of {count}, too few to tell"
    return "reached" if met else "**missed**"


def _strata(rows: Rows, lines: pd.DataFrame) -> list[tuple]:
    strata = []
    for name, members in sealed_score.strata(rows).items():
        stratum = lines[lines["rows"] == name]
        cells = []
        for start in STRATA.values():
            matches = stratum[stratum["what"].str.startswith(start)].to_dict("records")
            cells.append("")
            if matches:
                line = matches[0]
                cells[-1] = f"{number(line['value'], is_share(line))} ({line['n']})"
        strata.append((name, len(members), *cells))
    return strata


def _method(line: dict) -> tuple:
    names_effects = line["method"] in (*NAMING, "eitskin")
    shares = [(key, True) for key in ("false_alarms", "right_name")]
    sets = [(f"f1_{kind}", False) for kind in ("single", "pair", "triple")]
    naming = [number(line[key], share) if names_effects else "-" for key, share in shares + sets]
    return (
        line["method"],
        *naming,
        *(number(line[key], False) for key in ("misfit_closed", "rmse_over_ours")),
    )


def _plain(rows: Rows) -> list[str]:
    """Cases with an effect of which no measure of Table II tells, beside their verdicts."""
    unmoved = [
        row
        for row in rows
        if row["truth"]
        and row["similarity"]
        and not any(similarity["moved"] for similarity in row["similarity"].values())
    ]
    if not unmoved:
        return []
    text = (
        f"Concealed in the plain sense too, {len(unmoved)} recordings with an effect: MMD, CORAL,"
        " NCC and SWD between plain simulation and recording, and what they change by when the"
        " effect is put in, which for all four is no more than noise makes of it:"
    )
    lines = [
        (
            row["case"],
            _joined(map(_sited_name, row["truth"])),
            number(measures.smallest_gap(row), False),
            *(
                f"{number(row['similarity'][key]['plain'], False)}"
                f" ({row['similarity'][key]['change']:+.2g})"
                for key in MEASURES
            ),
            row["said"]["verdict"],
            _joined(map(_sited_name, row["said"]["effects"])) or "nothing",
        )
        for row in unmoved
    ]
    head = ("case", "concealed", "gap", *map(str.upper, MEASURES), "verdict", "said")
    return [text, "", *table(head, lines), ""]


def _misses(rows: Rows) -> list[str]:
    misses = [row for row in rows if not causes.is_right(row)]
    if not misses:
        return ["Every verdict was right.", ""]
    lines = [
        (
            row["case"],
            row["generator"],
            row["group"],
            _concealed(row) or "nothing",
            number(measures.smallest_gap(row), False),
            row["said"]["verdict"],
            _joined(map(_sited_name, row["said"]["effects"])) or "nothing",
            number(causes.better_by(row), False),
            causes.cause(row),
        )
        for row in misses
    ]
    head = ("case", "generator", "kind", "concealed", "gap", "verdict", "said", "nats", "cause")
    text = (
        f"Verdicts that were not right as a whole, {len(misses)} of {len(rows)}; nats: by which the"
        " truth, fitted after the opening, explains the recording better than what was said:"
    )
    counts = Counter(causes.cause(row) for row in misses).most_common()
    return [
        *(text, "", *table(("cause", "recordings"), counts)),
        *("", *table(head, lines), ""),
    ]


def write(block: Path, folder: Path, command: str) -> None:
    """Score an opened block, all of it as it was sealed and promised, into a folder: score.csv and
    .md, cases.csv, baselines.csv, and what each figure of `figures` shows."""
    sealing.check_opened(block)
    rows = opened.rows(block)
    lines, methods = sealed_score.scored(rows), sealed_score.by_method(rows)
    diagnosed = where(lambda row: not measures.is_broken(row))(rows)
    tables = {
        "score": lines,
        "cases": cases(rows),
        "baselines": methods,
        "accuracy": sealed_score.by_gap(rows),
        "misfit_closed": sealed_score.closed(rows),
        "confusion": measures.confusion(measures.effects(diagnosed)),
        "reliability": measures.reliability(rows),
        "p_values": p_values(block, rows),
    }
    for name, lines in tables.items():
        with atomic_path(folder / f"{name}.csv") as path:
            lines.to_csv(path, index=False, float_format="%.6g")
    with atomic_path(folder / "score.md") as path:
        path.write_text(markdown(rows, tables["score"], methods, command), "utf-8")
