"""The events of the emulated world, one JSON object in each line."""

import json
import time
from pathlib import Path


class EventLog:
    """Append-only JSONL; every entry has `t`, the machine's monotonic clock in s, and `event`.

    violations: the number of rules the driver has broken so far.
    """

    def __init__(self, path: str | Path):
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        self.path = Path(path)
        self.path.touch()
        self.violations = 0

    def write(self, event: str, **values: object) -> None:
        """Append one entry, given to the operating system before this returns."""
        entry = {"t": round(time.monotonic(), 6), "event": event, **values}
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")

    def violation(self, rule: str, **values: object) -> None:
        """Count and log a rule broken by the driver."""
        self.violations += 1
        self.write("violation", rule=rule, **values)
