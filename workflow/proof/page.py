"""The score of a block as files: tables and a page in Markdown."""

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.paper.similarity import MEASURES
from proof import causes, judge, score, scoring, sealing
from proof.baselines import NAMING
from proof.lines import over

FEW = 10  # recordings, of which what was reached or not tells little
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


def cases(rows: list[dict]) -> pd.DataFrame:
    """One line a case: what was concealed, how strong, how alike plain simulation and recording
    are by Table II's measures, what the diagnosis said, and whether it was right."""
    return pd.DataFrame([_case(row) for row in rows])


def _case(row: dict) -> dict:
    named = judge.matched(row)
    said, hidden = row["said"], row["hidden"]
    sited = [
        (item, scope)
        for item, scope in zip(row["truth"], row["scopes"], strict=True)
        if scope == "sparse" and judge.site_kind(item)
    ]
    at = [any(judge.sites_right(f, item) for f in said["effects"]) for item, _ in sited]
    return {
        "case": row["case"],
        "generator": row["generator"],
        "kind": row["group"],
        "concealed": _concealed(row),
        "gap_wanted": row["strength"],
        "gap": scoring.smallest_gap(row),
        "noise_share": row["level"],
        "rig": _joined(f"{error['kind']} {error['size']:g}" for error in row["rig"]),
        "changed": row["changed"],
        **{
            f"{measure}_{key}": told[key]
            for measure, told in (row["similarity"] or {}).items()
            for key in ("plain", "change", "moved")
        },
        "verdict": said["verdict"],
        "said": _joined(_where(found) for found in said["effects"]),
        "alternatives": _joined(n for f in said["effects"] for n in f["alternatives"]),
        "right": right(row),
        "cause": "" if right(row) else causes.cause(row),
        "truth_better_by_nats": causes.better_by(row),
        "rightly_named": sum(found is not None for found in named),
        "sites_right": all(at) if at else None,
        "outside_probability": said["other"]["probability"],
        "chi2_per_dof": hidden["chi2_per_dof"],
        "misfit_closed": scoring.misfit_closed(hidden),
        "black_box_over_ours": scoring.against_boxes(row),
        "seconds": row.get("seconds", np.nan),
        "broken": _joined(row["broken"]),
        "sentence": _joined(
            (*(f["sentence"] for f in said["effects"]), said["other"]["sentence"] or ""), " "
        ),
    }


def right(row: dict) -> bool:
    """Whether a verdict is right as a whole: nothing named or flagged that is not there, nothing
    missed; of physics outside the catalogue, that it was noticed; of a fault planted in a real
    recording, whose own faults nobody knows, that it was found, or borne."""
    if "failed" in row:
        return False
    if row["fault"]:
        return scoring.fault_found(row)
    if row["outside"]:
        return score.flagged(row)
    found = sum(one is not None for one in judge.matched(row))
    whole = found == len(row["truth"]) == len(row["said"]["effects"])
    return whole and not score.flagged(row)


def _joined(texts: Iterable[str], by: str = "; ") -> str:
    return by.join(text for text in texts if text)


def _concealed(row: dict) -> str:
    items = [row["fault"]] if row["fault"] else row["truth"]
    return _joined(map(_where, items)) or (row["outside"] or {}).get("law", "")


def _where(item: dict) -> str:
    kind = judge.site_kind({k: v for k, v in item.items() if v != []})
    if kind is None or len(item[kind]) > 6:
        return item["name"]
    return f"{item['name']} ({kind} {' '.join(map(str, item[kind]))})"


def p_values(block: Path, rows: list[dict]) -> pd.DataFrame:
    """Of recordings where nothing is concealed: the share of the atlas' statistics before any
    effect with a p-value up to p, its interval over the recordings, and their number."""
    own = [
        pd.read_csv(block / "verdicts" / row["case"] / "evidence" / "atlas_before.csv")["p"]
        for row in rows
        if row["kind"] == "null" and "failed" not in row
    ]
    levels = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 0.5, 0.7, 0.9)
    lines = []
    for level in levels:
        shares = np.array([(column.dropna() <= level).mean() for column in own])

        def mean(index: np.ndarray, shares: np.ndarray = shares) -> float:
            return float(shares[index].mean())

        told = over("", "", len(shares), mean)
        lines.append({"p": level, **{k: told[k] for k in ("value", "low", "high", "n")}})
    return pd.DataFrame(lines).rename(columns={"value": "share"})


def reliability(rows: list[dict]) -> pd.DataFrame:
    """`score.reliability` without the real recordings: nobody knows what is in them."""
    return score.reliability([row for row in rows if row["kind"] != "real"])


def markdown(rows: list[dict], lines: pd.DataFrame, methods: pd.DataFrame, command: str) -> str:
    """The page: § 5's table, strata, baselines, what is concealed in plain sense too, misses."""
    asked = lines[(lines["rows"] == "all") & (lines["gate"] != "")]
    beside = lines[(lines["rows"] == "all") & (lines["gate"] == "")]
    frames = f"`{command}`: {len(rows)} recordings, 95 % intervals."
    parts = [
        frames,
        "",
        *_table(
            ("recordings", "what", "measured", "95 %", "n", "ceiling", "gate", "", "target", ""),
            [
                (
                    *(*_measured(line), _number(line["ceiling"], True)),
                    *(line["gate"], _met(line["gate_met"], line["n"])),
                    *(line["target"], _met(line["target_met"], line["n"])),
                )
                for line in asked.to_dict("records")
            ],
        ),
        "",
        "*Ceiling*: Φ(gap / 2), the best that any test between two names can do, in the mean.",
        "Beside it, without a gate:",
        "",
        *_table(
            ("recordings", "what", "measured", "95 %", "n", "ceiling"),
            [
                (*_measured(line), _number(line["ceiling"], True))
                for line in beside.to_dict("records")
            ],
        ),
        "",
        "By generator, kind and gap wanted (in brackets, of how many recordings); flagged: as"
        " physics outside the catalogue, of those that have it:",
        "",
        *_table(("recordings", "number", *STRATA), _strata(rows, lines)),
        "",
        "The same recordings by other methods; misfit closed and RMSE on hidden frames, medians"
        " over recordings with an effect:",
        "",
        *_table(
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


def _table(head: tuple, lines: list[tuple]) -> list[str]:
    made = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return made + ["| " + " | ".join(map(str, line)) + " |" for line in lines]


def _measured(line: dict) -> tuple:
    share = _share(line)
    ends = [_number(line[end], share) for end in ("low", "high")]
    value = _number(line["value"], share)
    return line["of"], line["what"], value, " to ".join(ends) if all(ends) else "", line["n"]


def _share(line: dict) -> bool:
    return line["hits"] is not None and not np.isnan(line["hits"])


def _met(met: bool | None, count: int) -> str:
    if met is None:
        return "no recording"
    if count < FEW:
        return f"{'reached' if met else 'not reached'}, of {count}"
    return "reached" if met else "**missed**"


def _number(value: float, share: bool) -> str:
    return "" if value is None else score.number(float(value), share)


def _strata(rows: list[dict], lines: pd.DataFrame) -> list[tuple]:
    made = []
    for name, members in scoring.strata(rows).items():
        own = lines[lines["rows"] == name]
        cells = []
        for start in STRATA.values():
            found = own[own["what"].str.startswith(start)].to_dict("records")
            if not found:
                cells.append("")
                continue
            line = found[0]
            cells.append(f"{_number(line['value'], _share(line))} ({line['n']})")
        made.append((name, len(members), *cells))
    return made


def _method(line: dict) -> tuple:
    naming = line["method"] in (*NAMING, "eitskin")
    shares = [_number(line[key], True) if naming else "-" for key in ("false_alarms", "right_name")]
    sets = [
        _number(line[f"f1_{kind}"], False) if naming else "-"
        for kind in ("single", "pair", "triple")
    ]
    rest = [_number(line[key], False) for key in ("misfit_closed", "rmse_over_ours")]
    return line["method"], *shares, *sets, *rest


def _plain(rows: list[dict]) -> list[str]:
    """Cases with an effect of which no measure of Table II tells, beside their verdicts."""
    own = [
        row
        for row in rows
        if row["truth"]
        and row["similarity"]
        and not any(told["moved"] for told in row["similarity"].values())
    ]
    if not own:
        return []
    text = (
        f"Concealed in the plain sense too, {len(own)} recordings with an effect: MMD, CORAL, NCC"
        " and SWD between plain simulation and recording, and what they change by when the effect"
        " is put in, which for all four is no more than noise makes of it:"
    )
    lines = [
        (
            row["case"],
            _joined(_where(item) for item in row["truth"]),
            _number(scoring.smallest_gap(row), False),
            *(
                f"{_number(row['similarity'][key]['plain'], False)}"
                f" ({row['similarity'][key]['change']:+.2g})"
                for key in MEASURES
            ),
            row["said"]["verdict"],
            _joined(_where(found) for found in row["said"]["effects"]) or "nothing",
        )
        for row in own
    ]
    head = ("case", "concealed", "gap", *map(str.upper, MEASURES), "verdict", "said")
    return [text, "", *_table(head, lines), ""]


def _misses(rows: list[dict]) -> list[str]:
    own = [row for row in rows if not right(row)]
    if not own:
        return ["Every verdict was right.", ""]
    why = [causes.cause(row) for row in own]
    lines = [
        (
            row["case"],
            row["generator"],
            row["group"],
            _concealed(row) or "nothing",
            _number(scoring.smallest_gap(row), False),
            row["said"]["verdict"],
            _joined(_where(found) for found in row["said"]["effects"]) or "nothing",
            _number(causes.better_by(row), False),
            cause,
        )
        for row, cause in zip(own, why, strict=True)
    ]
    head = ("case", "generator", "kind", "concealed", "gap", "verdict", "said", "nats", "cause")
    text = (
        f"Verdicts that were not right as a whole, {len(own)} of {len(rows)}; nats: by which the"
        " truth, fitted after the opening, explains the recording better than what was said:"
    )
    return [
        text,
        "",
        *_table(("cause", "recordings"), Counter(why).most_common()),
        "",
        *_table(head, lines),
        "",
    ]


def write(block: Path, folder: Path, command: str) -> None:
    """Score an opened block, all of it as it was sealed and promised, into a folder: score.csv and
    .md, cases.csv, baselines.csv, and what each figure of `figures` shows."""
    sealing.check_opened(block)
    rows = scoring.rows(block)
    lines, methods = scoring.whole(rows), scoring.by_method(rows)
    told = [row for row in rows if "failed" not in row]
    tables = {
        "score": lines,
        "cases": cases(rows),
        "baselines": methods,
        "accuracy": scoring.by_gap(rows),
        "misfit_closed": scoring.closed(rows),
        "confusion": score.confusion(score.effects(told)),
        "reliability": reliability(told),
        "p_values": p_values(block, rows),
    }
    for name, made in tables.items():
        with atomic_path(folder / f"{name}.csv") as path:
            made.to_csv(path, index=False, float_format="%.6g")
    with atomic_path(folder / "score.md") as path:
        path.write_text(markdown(rows, lines, methods, command), "utf-8")
