"""A broken input as a row of a table, and what the command line must make of it."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from eitskin import cli


@dataclass(frozen=True)
class Broken:
    """`make` writes files into an empty folder, the working directory, and returns the words of a
    command; `says` is what its message must hold: file | place | found | expected."""

    name: str
    make: Callable[[], list[str]]
    says: str

    def refuse(self, printed: Callable) -> None:
        """Assert that the command refuses it in one line and leaves every file as it was."""
        words = [str(word) for word in self.make()]
        before = contents()
        code = cli.main(words)
        out, err = printed()
        assert code == cli.REFUSED, f"exit code {code}\n{out}{err}"
        assert out == "" and err.count("\n") == 1, out + err
        told = re.fullmatch(r"(.+?): (.+?): found (.*), expected (.+)\n", err, re.DOTALL)
        assert told, err
        for part, whole in zip(self.says.split(" | "), told.groups(), strict=True):
            assert part in whole, f"{part!r} is not in {whole!r}: {err}"
        assert contents() == before


def contents() -> dict[str, bytes | None]:
    """Every file below the working directory with its bytes; folders without."""
    return {str(path): path.read_bytes() if path.is_file() else None for path in Path().rglob("*")}
