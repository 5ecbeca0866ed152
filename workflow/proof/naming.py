"""Names of a block's cases: they tell the number and nothing else."""


def names(size: int) -> list[str]:
    """Those of a block of `size`."""
    return [f"case-{number:03d}" for number in range(1, size + 1)]


def batches(size: int, batch: int) -> list[list[str]]:
    """The names, `batch` at a time: a job each."""
    whole = names(size)
    return [whole[i : i + batch] for i in range(0, size, batch)]
