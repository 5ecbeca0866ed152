"""Which models are trained on which set and split: the rows of Table I."""

from eitskin.simulate.sets import CONTINUOUS

KINDS = {"configurations": "simulated-", "recordings": ""}  # how each kind's data sets are called


def rows(config: dict) -> list[tuple[str, str, str]]:
    """Data set, split and model of each row that `table_1` of a valid configuration asks for.

    A set has a list of splits, on each of which all of `models` are trained, or for each split a
    list of models. The split `continuous` is one of the set derived for it.
    """
    return [
        (f"{prefix}{name}{CONTINUOUS if split == 'continuous' else ''}", split, model)
        for kind, prefix in KINDS.items()
        for name, splits in config["table_1"][kind].items()
        for split in splits
        for model in (splits[split] if isinstance(splits, dict) else config["models"])
    ]
