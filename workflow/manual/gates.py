"""The gates of the search as a page, by purpose, in the order in which a candidate meets them."""

from eitskin.diagnose.search.gates import Gate, every

PURPOSES = {
    "scope": "what is sought",
    "cost": "what is worth a fit",
    "evidence": "what enters a set of effects, and what stays",
    "certainty": "what is said without *perhaps*",
}
HEAD = """# The gates

Written by `python -m manual` from `workflow/eitskin/diagnose/search/gates.py`, which has every rule
that admits, drops or demotes an effect, and every threshold. A candidate passes the gates from the
top of that file to its end; here they stand by purpose. A condition passes where it holds; a
statistic passes on the side of the threshold that is named. A nat is a unit of log evidence: one
nat more is a factor of 2.7.

A diagnosis writes each value that it holds against a gate to `evidence/decisions.csv`, and
`eitskin explain FOLDER NAME` says at which gate a name stopped.
"""
TABLE = """| gate | statistic | passes | source of the rule or its threshold | applies to |
|---|---|---|---|---|"""


def page() -> str:
    """The page as Markdown."""
    parts = [HEAD]
    for purpose, subject in PURPOSES.items():
        rows = [_row(gate) for gate in every() if gate.purpose == purpose]
        parts.append("\n".join([f"## {purpose.capitalize()}: {subject}", "", TABLE, *rows, ""]))
    return "\n".join(parts)


def _row(gate: Gate) -> str:
    cells = gate.name, gate.statistic, _side(gate), gate.source, gate.applies_to
    return f"| {' | '.join(cells)} |"


def _side(gate: Gate) -> str:
    """The side of the threshold on which a gate lets pass; a condition is 1 where it holds."""
    if (gate.passes, gate.threshold) == ("at least", 1.0):
        return "where it holds"
    return f"{gate.passes} {gate.threshold_text}"
