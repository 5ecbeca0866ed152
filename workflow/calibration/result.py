"""What came of one job, kept in a file as soon as it is done."""

import json
import traceback
from collections.abc import Callable
from pathlib import Path

from eitskin.atomic import atomic_path


def keep(path: Path, head: dict, work: Callable[[], dict]) -> None:
    """Write what `work` returns as JSON, unless the file is there; {**head, failed: why} where it
    breaks off."""
    if path.exists():
        return
    try:
        row = work()
    except Exception as error:  # whatever it is, it is a result
        traceback.print_exc()
        row = {**head, "failed": repr(error)}
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(row, ensure_ascii=False) + "\n", "utf-8")
