"""What has changed since a block was sealed, which is not made again for it."""

from pathlib import Path
from typing import Any

from eitskin import provenance, why


def since_sealed(block: Path, drawn: dict[str, Any]) -> list[str]:
    """Modules that are other now than when a block was drawn, diagnosed, sealed, and those of its
    parameters that are `drawn` otherwise, sorted; none where no record tells.

    block: its folder, from that of the workflow; drawn: parameters of its drawing, by name.
    """
    seal = str(block / "seal.json")
    if seal not in provenance.records():
        return []
    steps = why.chain(seal)
    drawing = [s["parameters"] for s in steps if s.get("rule", "").startswith("conceal_")]
    changed = {key for record in drawing for key in drawn if record[key] != drawn[key]}
    changed |= {
        text.removeprefix("code: ")
        for step in steps
        for text in step["changed"]
        if text.startswith("code: ")
    }
    return sorted(changed)
