"""The configuration: refused in one line where it is wrong, before any work."""

import contextlib
import os
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from referencing import Registry, Resource

from eitskin import yaml_file
from eitskin.data import importers, stated
from eitskin.data.channel_order import ORDERS
from eitskin.effects import EFFECTS, on_readings
from eitskin.effects.effect import START, Effect
from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from eitskin.learn import models
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table, pattern_step
from eitskin.physics.skin import Skin
from eitskin.schema import Validator, dotted, explained, one_of
from eitskin.simulate.layout import force_levels
from eitskin.simulate.readings import apply_skin, simulate
from eitskin.simulate.sets import CONTINUOUS, sample_settings

MISSING = object()
GIVEN = "--config"  # where values are from that no file has
REFERRED_TO = {"rig.schema.yaml": Path(__file__).parent / "capture" / "rig.schema.yaml"}
PATHS = ("path", "query")  # of a recording
YTE = "__use_yte__"  # by which Snakemake takes a configuration for a template


class _Refusal(Exception):
    """What is wrong within the configuration; which file holds it is still to be found."""

    def __init__(self, place: list, found: object, expected: str):
        self.place, self.found, self.expected = place, found, expected


def validate(
    config: dict, schema_path: str | Path, files: Iterable[str | Path], rest: str = GIVEN
) -> None:
    """Check a merged configuration against its schema, its own names, the recordings' paths and
    what the physics of its skins, protocols and effects allows; then put the values of environment
    variables into the recordings' paths (`${NAME}`).

    `files` are the YAML files it was read from, later ones overriding earlier ones, `rest` says
    where values are from that none of them has; no key may stand twice in a mapping. Raises
    InputError, one line that names the file which holds the wrong value.
    """
    files = [Path(file) for file in files]
    for file in files:
        read(file)
    registry = Registry(retrieve=_schema)  # type: ignore[call-arg]  # referencing's stub is wrong
    rules = Validator(schema(schema_path), registry=registry)
    errors = list(rules.iter_errors(config))
    try:
        if errors:
            error = min(errors, key=lambda error: _position(config, list(error.absolute_path)))
            raise _Refusal(*explained(error))
        wrong = _unknown_name(config) or _missing_recording(config) or _probe_of_no_rig(config)
        if wrong is not None:
            raise _Refusal(*wrong)
        _refuse_unphysical(config)
    except _Refusal as refusal:
        place, found, expected = refusal.place, refusal.found, refusal.expected
        file = file_of(place, config, files, rest)
        raise InputError(file, dotted(place), found, expected) from None
    for recording in config["recordings"].values():
        for key in recording.keys() & {*PATHS}:
            recording[key] = _expanded(recording[key])


def read(file: str | Path) -> dict:
    """The mapping in a file of the configuration; raises InputError as `yaml_file.read` does, and
    for a template of Snakemake's, which would run code."""
    found = yaml_file.read(file)
    if YTE in found:
        raise InputError(file, YTE, "a template, which runs code", "plain YAML")
    return found


def schema(path: str | Path) -> dict:
    """The schema in a file, with the names that the code knows: effects with their parameters,
    formats and orders of recordings, models."""
    found = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    effect, parts = found["$defs"]["effect"], found["properties"]
    recording = parts["recordings"]["additionalProperties"]
    effect["properties"]["name"]["enum"] = list(EFFECTS)
    effect["allOf"] = [
        {
            "if": {"properties": {"name": {"const": name}}},
            "then": {"properties": {"parameters": _parameters(one)}},
        }
        for name, one in EFFECTS.items()
    ]
    recording["properties"]["format"]["enum"] = importers.format_names()
    recording["properties"]["skin"]["propertyNames"] = {"enum": list(stated.KEYS)}
    recording["properties"]["order"]["enum"] = list(ORDERS)
    kinds = f"^(single:({'|'.join(EFFECTS)})|pair|triple)$"
    parts["loop"]["properties"]["cases"]["propertyNames"]["pattern"] = kinds
    of_budget = parts["budgets"]["additionalProperties"]["properties"]["rows"]
    networks = [name for name in models.names() if not models.model(name).support_vectors]
    found["$defs"]["models"]["items"]["enum"] = models.names()
    found["$defs"]["tuned"]["items"]["enum"] = networks
    for rows in (parts["training"]["properties"]["rows"], of_budget):
        rows["propertyNames"]["enum"] = networks
    return found


def _parameters(effect: Effect) -> dict:
    """What a schema asks of an effect's parameters; their bounds are `settings`' to check."""
    rules: dict[str, dict] = {}
    for key, parameter in effect.parameters.items():
        rules[key] = {"$ref": f"#/$defs/{'optional-value' if parameter.optional else 'value'}"}
        if parameter.whole:
            whole = {"type": "integer", "minimum": parameter.low}
            rules[key] = {**whole, "description": "a whole number"}
    needed = [key for key, parameter in effect.parameters.items() if not parameter.optional]
    return {"additionalProperties": False, "required": needed, "properties": rules}


def _schema(uri: str) -> Resource:
    """Another schema, which one refers to by its file's name."""
    return Resource.from_contents(yaml.safe_load(REFERRED_TO[uri].read_text(encoding="utf-8")))


def with_continuous(config: dict) -> dict[str, dict]:
    """The configurations and, of each, the set whose touches lie everywhere, `-continuous`: its
    key `continuous` holds the places' radius, the forces and, where it has a size of its own, the
    `samples`, as `simulate.continuous_samples` takes them."""
    grid, forces = config["touch_grid"], config["forces"]
    continuous = {
        "reach_mm": grid["outer"] * config["skin"]["radius_mm"],
        "probe_mm": grid["probe_mm"],
        "forces": {key: forces[key] for key in ("mean_N", "sd_N", "max_N")},
    }
    found = {name: {**one, "continuous": None} for name, one in config["configurations"].items()}
    derived = {}
    for name, one in found.items():
        own = {"samples": one["continuous_samples"]} if "continuous_samples" in one else {}
        derived[name + CONTINUOUS] = {**one, "continuous": continuous | own}
    return found | derived


def _refuse_unphysical(config: dict) -> None:
    """Refuse what the schema cannot judge: skins, protocols, touches, forces, effects."""
    twin = config["twin"]
    sets = {("configurations", name): one for name, one in config["configurations"].items()}
    for place, block, perturbed in (([], config, sets), (["twin"], twin, {("twin",): twin})):
        skin = _skin(block["skin"], [*place, "skin"])
        channels = _channels(block["protocol"], [*place, "protocol"], len(skin.electrode_deg))
        grid = block["touch_grid"]
        if grid["inner"] > grid["outer"]:
            expected = f"at most outer, {grid['outer']}"
            raise _Refusal([*place, "touch_grid", "inner"], grid["inner"], expected)
        drawn = settings if place else sample_settings
        for where, one in perturbed.items():
            at = [*where, "effects"]
            _refuse_effects(one["effects"], at, skin, channels, drawn)
            if skin.points:
                _refuse_on_points(one["effects"], at, block["skin"], channels)
    for name, recording in config["recordings"].items():
        said = recording.get("skin", {})
        with _at_place(["recordings", name, "skin"], {key: [key] for key in said}):
            stated.refuse(said)
    for name, one in config["configurations"].items():
        least, found = 2 * one["session_frames"] + 1, one.get("continuous_samples")
        if found is not None and found < least:
            place = ["configurations", name, "continuous_samples"]
            expected = f"{least} or more: three sessions, to train, validate and test"
            raise _Refusal(place, found, expected)
    low, high = twin["press"]["target_N"]
    if low > high:
        raise _Refusal(["twin", "press", "target_N"], [low, high], "the smaller force first")
    with _at_place(["forces"], {"forces.levels": ["levels"]}):
        force_levels(config["seed"], **config["forces"])


def _skin(skin: dict, place: list) -> Geometry:
    within = {key: [key] for key in skin} | {f"skin.{key}": [key] for key in skin}
    with _at_place(place, within | {"electrodes": ["electrode_width_mm"]}):
        return Geometry.from_skin(Skin.from_metadata(skin))


def _channels(protocol: dict, place: list, n_electrodes: int) -> np.ndarray:
    for key in ("drive", "measure"):
        with _at_place([*place, key], {}):
            pattern_step(protocol[key], n_electrodes)
    listed = range(len(protocol.get("channels", ())))
    with _at_place(place, {f"channels[{k}]": ["channels", k] for k in listed}):
        return channel_table(n_electrodes, **protocol)


def _refuse_effects(
    items: list[dict], place: list, skin: Geometry, channels: np.ndarray, drawn: Callable
) -> None:
    """Refuse sites that are not there and values that make no skin, drawn once where drawn."""
    for k, item in enumerate(items):
        parameters = {key: ["parameters", key] for key in item["parameters"]}
        with _at_place([*place, k], {key: [key] for key in item} | parameters):
            skin = apply_skin(skin, drawn([item], site_counts(channels), (0, 0)), START)


def _refuse_on_points(items: list[dict], place: list, skin: dict, channels: np.ndarray) -> None:
    """Refuse what needs electrodes with a width: bodies, and potentials of those that drive."""
    believed = Skin.from_metadata(skin)
    frames = pd.DataFrame({"touch": [False, True], "force_N": [0.0, 1.0], "time_s": [0.0, 1.0]})
    frames = frames.assign(x_mm=[np.nan, 0.0], y_mm=[np.nan, 0.0], probe_mm=[np.nan, 8.0])
    for k, item in enumerate(items):
        chosen = settings([item], site_counts(channels), (0, 0))
        geometry = apply_skin(Geometry.from_skin(believed), chosen, START)
        later = chosen[0].effect.stage in ("wiring", "instrument")
        if geometry.deep or (later and not on_readings(item["name"])):
            try:
                simulate(frames, np.array([-1, 0]), believed, channels, chosen, "train")
            except InputError as error:
                expected = f"{error.expected} ({error.file}.{error.place})"
                raise _Refusal([*place, k], error.found, expected) from error


@contextlib.contextmanager
def _at_place(place: list, within: dict[str, list]) -> Iterator[None]:
    """Turn an InputError into the refusal of what stands at `place` and, there, where `within` has
    the error's own place."""
    try:
        yield
    except InputError as error:
        inner = within.get(error.place, [])
        raise _Refusal([*place, *inner], error.found, error.expected) from error


def _position(config: dict, place: list) -> tuple[int, list[int]]:
    """Depth of a place, then its order in the file: the first of the least deep comes first."""
    node, order = config, []
    for part in place:
        order.append(list(node).index(part) if isinstance(node, dict) else part)
        node = node[part]
    return len(place), order


def _unknown_name(config: dict) -> tuple[list, str, str] | None:
    """A name in a table, a figure, `ablation`, `transfer`, `diagnoses`, `tanks` or `loop` that is
    defined nowhere."""
    recordings = [*config["recordings"], *_rig_names(config)]
    for kind, known in (("configurations", config["configurations"]), ("recordings", recordings)):
        for name, splits in config["table_1"][kind].items():
            if name not in known:
                return ["table_1", kind, name], "an unknown name", one_of(known, name)
            for k, split in enumerate(splits):
                if split not in config["splits"]:
                    place = ["table_1", kind, name, split if isinstance(splits, dict) else k]
                    return place, repr(split), one_of(config["splits"], split)
    for key, known in (("recording", recordings), ("configuration", config["configurations"])):
        if config["figures"][key] not in known:
            found = config["figures"][key]
            return ["figures", key], repr(found), one_of(known, found)
    sets = [f"simulated-{name}" for name in config["configurations"]]
    for place, known in (
        (["table_2", "configurations"], config["configurations"]),
        (["transfer", "sources"], sets),
        (["transfer", "targets"], recordings),
        (["diagnoses"], recordings),
        (["tanks"], recordings),
        (["loop", "recordings"], recordings),
    ):
        for k, name in enumerate(_at(place, config)):
            if name not in known:
                return [*place, k], repr(name), one_of(known, name)
    known = [*(f"simulated-{name}" for name in with_continuous(config)), *recordings]
    for key in ("varied_on", "compared_on"):
        for name, splits in config["ablation"][key].items():
            place = ["ablation", key, name]
            if name not in known:
                return place, "an unknown name", one_of(known, name)
            for k, split in enumerate(splits):
                if split not in config["splits"]:
                    return [*place, k], repr(split), one_of(config["splits"], split)
    for name, row in config["training"].get("rows", {}).items():
        if "widths" in row and not models.model(name).perceptron:
            return ["training", "rows", name, "widths"], row["widths"], "none, as it has its own"
    if config["budget"] not in config["budgets"]:
        return ["budget"], repr(config["budget"]), one_of(config["budgets"], config["budget"])
    for name in config["configurations"]:
        if name.endswith(CONTINUOUS):
            return ["configurations", name], "a derived set's name", f"a name without {CONTINUOUS}"
        for simulated in (f"simulated-{name}", f"simulated-{name}{CONTINUOUS}"):
            if simulated in config["recordings"]:
                return ["recordings", simulated], "a simulated set's name", "another name"
            if simulated in _rig_names(config):
                return ["rig", "name"], f"a simulated set's name, {simulated}", "another name"
    return None


def _rig_names(config: dict) -> list[str]:
    """What the rig that is attached captures, where one is."""
    return [config["rig"]["name"]] if "rig" in config else []


def captured_path(name: str) -> str:
    """Where the recording lies that a rig has captured under a name."""
    return f"results/recordings/{name}.parquet"


def _missing_recording(config: dict) -> tuple[list, str, str] | None:
    """A recording's or query's file that is neither there nor made by the workflow itself, nor to
    be captured by the rig that is attached."""
    for name, recording in config["recordings"].items():
        for key in [key for key in PATHS if key in recording]:
            try:
                path = _expanded(recording[key])
            except KeyError as unset:
                found = f"{recording[key]!r}, but {unset.args[0]} is not set"
                return ["recordings", name, key], found, "an environment variable that is set"
            capture = path == captured_path(name)
            if capture and name in _rig_names(config):
                continue
            if (capture or not path.startswith("results/")) and not _is_there(path):
                return ["recordings", name, key], f"no file {path!r}", "a recording's path"
    return None


def _is_there(path: str) -> bool:
    try:
        return Path(path).exists()
    except OSError:  # a name too long, a folder that may not be looked into
        return False


def _probe_of_no_rig(config: dict) -> tuple[list, str, str] | None:
    if "mounted_mm" in config and "rig" not in config:
        return ["mounted_mm"], f"{config['mounted_mm']:g} mm", "a rig that the probe is on"
    return None


def _expanded(path: str) -> str:
    """The path with `${NAME}` replaced by the environment's value; KeyError where it has none."""
    return re.sub(r"\$\{(\w+)\}", lambda name: os.environ[name[1]], path)


def _indices(node: object) -> range:
    return range(len(node)) if isinstance(node, list) else range(0)


def file_of(place: list, config: dict, files: Iterable[str | Path], rest: str = GIVEN) -> str:
    """The last file that holds what stands at `place`; for a missing key the first that holds what
    it is missing from, within a list the one that the list is of; where none does, `rest`."""
    files = [Path(file) for file in files]
    found = _at(place, config)
    if found is MISSING and files:
        if any(isinstance(part, int) for part in place):
            return file_of(place[:-1], config, files, rest)
        holding = [file for file in files if _at(place[:-1], read(file)) is not MISSING]
        return str(holding[0]) if holding else rest
    for file in reversed(files):
        held = _at(place, read(file))
        if repr(held) == repr(found) or (isinstance(held, dict) and isinstance(found, dict)):
            return str(file)
    return rest


def _at(place: list, node: Any) -> Any:
    """What stands at `place` within nested mappings and lists, or MISSING."""
    for part in place:
        if part not in (node if isinstance(node, dict) else _indices(node)):
            return MISSING
        node = node[part]
    return node
