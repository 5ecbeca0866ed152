"""What the loop is run on: cases by name, and what a model may learn from."""

BELIEF, AUTHORS, DIAGNOSIS, TRUTH = "belief", "authors", "diagnosis", "truth"
SOURCES = (BELIEF, AUTHORS, DIAGNOSIS, TRUTH)  # simulators, as `loop.sources` has them
LABELS = "labels"  # no simulator: the recording's labelled frames alone


def name_of(kind: str, seed: int) -> str:
    """A case's name in file names."""
    return f"{kind.replace(':', '-')}-{seed}"


def named(kinds: dict[str, list[int]]) -> dict[str, tuple[str, int]]:
    """(kind, seed) of every case by its name, of the seeds of each kind."""
    return {name_of(kind, seed): (kind, seed) for kind, seeds in kinds.items() for seed in seeds}
