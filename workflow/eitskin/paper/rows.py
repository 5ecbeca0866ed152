"""The rows of Table I, a model trained on a set and split each, and the configurations that repeat
the paper's experiment."""

import hashlib
import json

from eitskin.simulate.sets import CONTINUOUS

KINDS = {"configurations": "simulated-", "recordings": ""}  # prefix of each kind's data sets
SHARED = ("skin", "protocol", "touch_grid", "forces")  # keys common to all configurations
OF_CONTINUOUS = ("continuous", "continuous_samples")  # keys of the set derived from a configuration
PAPER = {  # `digest` of the paper's experiment in the project's config.yaml
    "authors": "0756c4fda4f1f8c88d8731766571f0d711e5d38b92725a92f4dfd850ed8f226b",
    "text": "b078f3c1ce6f95a6c3b9f88eba57abaa3ec7297c55214d2c63749be4b00738e9",
}


def rows(config: dict) -> list[tuple[str, str, str]]:
    """Data set, split and model of each row of `table_1` of a valid configuration.

    A set has a list of splits, on each of which all `models` are trained, or a list of models for
    each split. The split `continuous` is that of the derived continuous set.
    """
    return [
        (f"{prefix}{name}{CONTINUOUS if split == 'continuous' else ''}", split, model)
        for kind, prefix in KINDS.items()
        for name, splits in config["table_1"][kind].items()
        for split in splits
        for model in (splits[split] if isinstance(splits, dict) else config["models"])
    ]


def digest(config: dict, name: str) -> str:
    """The digest of all settings of a simulated configuration, except for seed and accuracy: equal
    for equal values, independent of their order and of 80 or 80.0."""
    configuration = config["configurations"][name]
    simulated = {key: config[key] for key in SHARED}
    simulated["configuration"] = {
        key: configuration[key] for key in configuration if key not in OF_CONTINUOUS
    }
    normalised = json.loads(json.dumps(simulated), parse_int=float)
    return hashlib.sha256(json.dumps(normalised, sort_keys=True).encode()).hexdigest()


def repeated(config: dict) -> list[str]:
    """The configurations in Table I that simulate the paper's experiment, with the strengths of its
    authors' code or of its text, recognised by their content, not their name."""
    return [
        name
        for name in config["table_1"]["configurations"]
        if digest(config, name) in PAPER.values()
    ]
