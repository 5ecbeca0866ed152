"""The names of the loop's cases, and of the sources of training samples."""

BELIEF, AUTHORS, DIAGNOSIS, TRUTH = "belief", "authors", "diagnosis", "truth"
SOURCES = (BELIEF, AUTHORS, DIAGNOSIS, TRUTH)  # the simulators of `loop.sources`
LABELS = "labels"  # no simulator: the labelled frames of the recording alone


def name_of(kind: str, seed: int) -> str:
    """The name of a case in file names."""
    return f"{kind.replace(':', '-')}-{seed}"


def cases_by_name(kinds: dict[str, list[int]]) -> dict[str, tuple[str, int]]:
    """(kind, seed) of every case by its name, from the seeds of each kind."""
    return {name_of(kind, seed): (kind, seed) for kind, seeds in kinds.items() for seed in seeds}
