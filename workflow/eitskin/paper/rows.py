"""Which models are trained on which set and split: the rows of Table I; which of them repeat the
paper's experiment."""

import hashlib
import json

from eitskin.simulate.sets import CONTINUOUS

KINDS = {"configurations": "simulated-", "recordings": ""}  # how each kind's data sets are called
SHARED = ("skin", "protocol", "touch_grid", "forces")  # by all configurations
OF_CONTINUOUS = ("continuous", "continuous_samples")  # of the set derived from a configuration
PAPER = {  # `digest` of the paper's experiment, as the project's config.yaml has it
    "authors": "0756c4fda4f1f8c88d8731766571f0d711e5d38b92725a92f4dfd850ed8f226b",
    "text": "b078f3c1ce6f95a6c3b9f88eba57abaa3ec7297c55214d2c63749be4b00738e9",
}


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


def digest(config: dict, name: str) -> str:
    """Of all that a configuration of a valid `config` simulates, but for the seed and the accuracy:
    equal for equal values, whatever their order and whether 80 or 80.0 is written."""
    own = config["configurations"][name]
    told = {key: config[key] for key in SHARED}
    told["configuration"] = {key: own[key] for key in own if key not in OF_CONTINUOUS}
    same = json.loads(json.dumps(told), parse_int=float)
    return hashlib.sha256(json.dumps(same, sort_keys=True).encode()).hexdigest()


def repeated(config: dict) -> list[str]:
    """The configurations in Table I that simulate the paper's experiment, with its authors'
    strengths or its text's: those whose content is the shipped one's, whatever they are called."""
    return [n for n in config["table_1"]["configurations"] if digest(config, n) in PAPER.values()]
