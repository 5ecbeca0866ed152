"""The configuration: checked before any work, and refused in one line.

Snakemake reads files given with --configfile before the workflow can, and names neither file nor
line where one is missing or no YAML; `python -m eitskin.configuration FILE ...` does.
"""

import contextlib
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import reduce
from operator import getitem
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
from eitskin.errors import InputError, reported
from eitskin.learn import models
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table, pattern_step
from eitskin.physics.skin import Skin, is_number
from eitskin.schema import Validator, dotted, explained, one_of
from eitskin.simulate.layout import LATTICE, POLAR, check_form, force_levels, touch_grid
from eitskin.simulate.readings import apply_skin, simulate
from eitskin.simulate.sets import CONTINUOUS, sample_settings, sessions

MISSING = object()
COMMAND_LINE = "--config"  # the source of values that no file contains
REFERRED_TO = {"rig.schema.yaml": Path(__file__).parent / "capture" / "rig.schema.yaml"}
PATHS = ("path", "query")  # of a recording
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # of our own schemas: ten times as fast
YTE = "__use_yte__"  # marks a configuration as a template for Snakemake


class _Refusal(Exception):
    """A wrong value in the configuration, before the file that contains it is known."""

    def __init__(self, place: list, actual: object, expected: str):
        self.place, self.actual, self.expected = place, actual, expected


def validate(
    config: dict,
    schema_path: str | Path,
    files: Iterable[str | Path],
    default_source: str = COMMAND_LINE,
) -> None:
    """Check a merged configuration against its schema, its own names, the recordings' paths and the
    physics of its skins, protocols and effects; then expand environment variables in the
    recordings' paths (`${NAME}`).

    files: the YAML files it was read from, later ones overriding earlier ones; default_source: the
    source of values that none of them contains. A key may stand only once in a mapping. Where a
    later file gives a skin an outline, the disc's radius, angles and polar grid of files before it
    are left out. Raises InputError, one line that names the file with the wrong value.
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
        _leave_out_disc(config, files, default_source)
        _refuse_other_form(config)
        contradiction = (
            _unknown_name(config) or _missing_recording(config) or _probe_of_no_rig(config)
        )
        if contradiction is not None:
            raise _Refusal(*contradiction)
        _refuse_unphysical(config)
    except _Refusal as refusal:
        place, actual, expected = refusal.place, refusal.actual, refusal.expected
        file = file_of(place, config, files, default_source)
        raise InputError(file, dotted(place), actual, expected) from None
    for recording in config["recordings"].values():
        for key in recording.keys() & {*PATHS}:
            recording[key] = _expanded(recording[key])


def read(file: str | Path) -> dict:
    """The mapping in a file of the configuration. Raises InputError as `yaml_file.read` does,
    and for a template of Snakemake, which would run code."""
    mapping = yaml_file.read(file)
    if YTE in mapping:
        raise InputError(file, YTE, "a template, which runs code", "plain YAML")
    return mapping


def schema(path: str | Path) -> dict:
    """The schema in a file, completed with the names that the code defines: effects with their
    parameters, formats and orders of recordings, models."""
    document = yaml.load(Path(path).read_bytes(), LOADER)
    effect_schema, properties = document["$defs"]["effect"], document["properties"]
    recording = properties["recordings"]["additionalProperties"]
    effect_schema["properties"]["name"]["enum"] = list(EFFECTS)
    effect_schema["allOf"] = [
        {
            "if": {"properties": {"name": {"const": name}}},
            "then": {"properties": {"parameters": _parameters(effect)}},
        }
        for name, effect in EFFECTS.items()
    ]
    recording["properties"]["format"]["enum"] = importers.format_names()
    recording["properties"]["skin"]["propertyNames"] = {"enum": list(stated.KEYS)}
    recording["properties"]["order"]["enum"] = list(ORDERS)
    kinds = f"^(single:({'|'.join(EFFECTS)})|pair|triple)$"
    properties["loop"]["properties"]["cases"]["propertyNames"]["pattern"] = kinds
    budget_rows = properties["budgets"]["additionalProperties"]["properties"]["rows"]
    networks = [name for name in models.names() if not models.model(name).support_vectors]
    document["$defs"]["models"]["items"]["enum"] = models.names()
    document["$defs"]["tuned"]["items"]["enum"] = networks
    for rows in (properties["training"]["properties"]["rows"], budget_rows):
        rows["propertyNames"]["enum"] = networks
    return document


def canonical(config: dict, schema_path: str | Path) -> dict:
    """A valid configuration in one notation of equal values: keys that the schema names in its
    order, numbers as float, except for whole numbers. The rig is as it was: captures that are not
    complete know it by its text."""
    document = schema(schema_path)
    written = {key: value for key, value in config.items() if key == "rig"}
    return _canonical(config, [document], document) | written


def _canonical(value: Any, rules: list[dict], document: dict) -> Any:
    """A value in one notation; rules: the schemas that it obeys."""
    rules = [rule for named in rules for rule in _applied(named, value, document)]
    if isinstance(value, dict):
        order = [key for rule in rules for key in _keys(rule) if key in value]
        return {
            key: _canonical(value[key], _within(rules, key), document)
            for key in dict.fromkeys([*order, *value])
        }
    if isinstance(value, list):
        inner = [rule["items"] for rule in rules if "items" in rule]
        return [_canonical(part, inner, document) for part in value]
    whole = any("integer" in rule.get("type", ()) for rule in rules)
    return value if whole or not is_number(value) else float(value)


def _applied(rule: dict, value: Any, document: dict) -> Iterator[dict]:
    """A schema and those within it that are of the same value."""
    yield rule
    inner = [*rule.get("allOf", ()), *rule.get("anyOf", ()), *rule.get("oneOf", ())]
    if rule.get("$ref", "").startswith("#/"):
        inner.append(reduce(getitem, rule["$ref"][2:].split("/"), document))
    if "if" in rule and Validator(rule["if"]).is_valid(value):
        inner.append(rule["then"])
    for part in inner:
        yield from _applied(part, value, document)


def _keys(rule: dict) -> Iterable[str]:
    return rule.get("properties", rule.get("propertyNames", {}).get("enum", ()))


def _within(rules: list[dict], key: str) -> list[dict]:
    """The schemas of a key's value."""
    others = [rule.get("additionalProperties") or {} for rule in rules]
    return [
        rule.get("properties", {}).get(key, other)
        for rule, other in zip(rules, others, strict=True)
    ]


def _parameters(effect: Effect) -> dict:
    """The schema of an effect's parameters; `settings` checks their bounds."""
    rules: dict[str, dict] = {}
    for key, parameter in effect.parameters.items():
        rules[key] = {"$ref": f"#/$defs/{'optional-value' if parameter.optional else 'value'}"}
        if parameter.whole:
            integer_rule = {"type": "integer", "minimum": parameter.low}
            rules[key] = {**integer_rule, "description": "a whole number"}
    required = [key for key, parameter in effect.parameters.items() if not parameter.optional]
    return {"additionalProperties": False, "required": required, "properties": rules}


def _schema(uri: str) -> Resource:
    """A schema that another one refers to by the name of its file."""
    return Resource.from_contents(yaml.load(REFERRED_TO[uri].read_bytes(), LOADER))


def perturbations(file: str | Path) -> list[dict]:
    """The effects of the configuration `authors` of a file, the paper's perturbations in
    config.yaml. Raises InputError where the file has none."""
    configurations = yaml_file.read(file).get("configurations")
    entry = configurations.get("authors") if isinstance(configurations, dict) else None
    if not isinstance(entry, dict) or not isinstance(entry.get("effects"), list):
        place = "configurations.authors.effects"
        raise InputError(file, place, "nothing", "effects, as in config.yaml")
    return entry["effects"]


def with_continuous(config: dict) -> dict[str, dict]:
    """The configurations, and for each a derived set `-continuous` with continuously distributed
    touches: its key `continuous` holds the radius of the places, the forces and, where stated,
    the `samples`, as `simulate.continuous_samples` takes them.
    With an outline, of the places their margin from the rim."""
    grid, forces = config["touch_grid"], config["forces"]
    region = (
        {"reach_mm": None, "margin_mm": grid["margin_mm"]}
        if "outline" in config["skin"]
        else {"reach_mm": grid["outer"] * config["skin"]["radius_mm"]}
    )
    continuous = {
        **region,
        "probe_mm": grid["probe_mm"],
        "forces": {key: forces[key] for key in ("mean_N", "sd_N", "max_N")},
    }
    sets = {
        name: {**configuration, "continuous": None}
        for name, configuration in config["configurations"].items()
    }
    derived = {}
    for name, configuration in sets.items():
        samples = (
            {"samples": configuration["continuous_samples"]}
            if "continuous_samples" in configuration
            else {}
        )
        derived[name + CONTINUOUS] = {**configuration, "continuous": continuous | samples}
    return sets | derived


def _leave_out_disc(config: dict, files: Iterable[str | Path], default_source: str) -> None:
    """Leave out what only a disc has, beside an outline and beside a lattice, unless the file that
    states these states that as well."""

    def source(*place: str) -> str:
        return file_of(list(place), config, files, default_source)

    for place in ((), ("twin",)):
        block = _value_at([*place], config)
        skin, grid = block["skin"], block["touch_grid"]
        if "outline" not in skin:
            continue
        outline_file = source(*place, "skin", "outline")
        for key in ("radius_mm", "electrode_deg"):
            if source(*place, "skin", key) != outline_file:
                skin[key] = None
        lattice_files = {source(*place, "touch_grid", key) for key in LATTICE if key in grid}
        for key in [key for key in POLAR if key in grid]:
            if lattice_files and source(*place, "touch_grid", key) not in lattice_files:
                del grid[key]


def _refuse_other_form(config: dict) -> None:
    """Refuse a disc without its radius or angles, and a touch grid of the other form of skin."""
    for place in ([], ["twin"]):
        block = _value_at(place, config)
        skin, has_outline = block["skin"], "outline" in block["skin"]
        for key in () if has_outline else ("radius_mm", "electrode_deg"):
            if skin[key] is None and not (key == "electrode_deg" and "electrode_xy_mm" in skin):
                raise _Refusal([*place, "skin", key], "null", "a value, or an outline of the skin")
        keys = {key for key in block["touch_grid"] if key != "probe_mm"}
        within = {f"touch_grid.{key}": [key] for key in keys}
        with _at_place([*place, "touch_grid"], within):
            check_form(block["touch_grid"], has_outline)


def _refuse_unphysical(config: dict) -> None:
    """Refuse skins, protocols, touches, forces and effects that the schema cannot check."""
    twin = config["twin"]
    sets = {
        ("configurations", name): configuration
        for name, configuration in config["configurations"].items()
    }
    for place, block, perturbed in (([], config, sets), (["twin"], twin, {("twin",): twin})):
        skin = _skin(block["skin"], [*place, "skin"])
        channels = _channels(block["protocol"], [*place, "protocol"], len(skin.electrode_deg))
        grid = {"probe_mm": 0.0} | block["touch_grid"]
        within = {f"touch_grid.{key}": [key] for key in (*POLAR, *LATTICE)}
        with _at_place([*place, "touch_grid"], within):
            touch_grid(Skin.from_metadata(block["skin"]), **grid)
        if "inner" in grid and grid["inner"] > grid["outer"]:
            expected = f"at most outer, {grid['outer']}"
            raise _Refusal([*place, "touch_grid", "inner"], grid["inner"], expected)
        draw_settings = settings if place else sample_settings
        for set_place, configuration in perturbed.items():
            effects_place = [*set_place, "effects"]
            _refuse_effects(configuration["effects"], effects_place, skin, channels, draw_settings)
            if skin.points:
                _refuse_on_points(configuration["effects"], effects_place, block["skin"], channels)
    for name, recording in config["recordings"].items():
        stated_skin = recording.get("skin", {})
        with _at_place(["recordings", name, "skin"], {key: [key] for key in stated_skin}):
            stated.refuse(stated_skin)
    for name, configuration in config["configurations"].items():
        _refuse_few_sessions(config, name, configuration)
    low, high = twin["press"]["target_N"]
    if low > high:
        raise _Refusal(["twin", "press", "target_N"], [low, high], "the smaller force first")
    with _at_place(["forces"], {"forces.levels": ["levels"]}):
        force_levels(config["seed"], **config["forces"])


def _refuse_few_sessions(config: dict, name: str, configuration: dict) -> None:
    """Refuse a simulated set of fewer than three sessions where whole sessions are split."""
    session_frames, grid = configuration["session_frames"], config["touch_grid"]
    least_samples, samples = 2 * session_frames + 1, configuration.get("continuous_samples")
    expected = "three sessions, to train, validate and test"
    places = len(touch_grid(Skin.from_metadata(config["skin"]), **grid))
    levels = config["forces"]["levels"]
    if samples is not None and samples < least_samples:
        place = ["configurations", name, "continuous_samples"]
        raise _Refusal(place, samples, f"{least_samples} or more: {expected}")
    splits = {*config["table_1"]["configurations"].get(name, ())}
    for key in ("varied_on", "compared_on"):
        splits |= {*config["ablation"][key].get(f"simulated-{name}", ())}
    crossed = {configuration["crossed"]} if "session" in splits else set()
    crossed |= {False} if "continuous" in splits and samples is None else set()
    for is_crossed in crossed:
        session, _, _ = sessions(places, levels, session_frames, is_crossed, config["seed"])
        if (n_sessions := int(session[-1]) + 1) < 3:
            place = ["configurations", name, "session_frames"]
            violation = f"{session_frames}: {n_sessions} sessions of {places * levels} samples"
            raise _Refusal(place, violation, f"fewer frames: {expected}")


def _skin(skin: dict, place: list) -> Geometry:
    within = {key: [key] for key in skin} | {f"skin.{key}": [key] for key in skin}
    within["skin.outline.corners_mm"] = ["outline", "corners_mm"]
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
    effects: list[dict], place: list, skin: Geometry, channels: np.ndarray, draw_settings: Callable
) -> None:
    """Refuse missing sites and values that make no skin; random values are drawn once."""
    for k, effect in enumerate(effects):
        parameters = {key: ["parameters", key] for key in effect["parameters"]}
        with _at_place([*place, k], {key: [key] for key in effect} | parameters):
            skin = apply_skin(skin, draw_settings([effect], site_counts(channels), (0, 0)), START)


def _refuse_on_points(effects: list[dict], place: list, skin: dict, channels: np.ndarray) -> None:
    """Refuse effects that need electrodes with a width: bodies, and potentials of driven
    electrodes."""
    believed = Skin.from_metadata(skin)
    frames = pd.DataFrame({"touch": [False, True], "force_N": [0.0, 1.0], "time_s": [0.0, 1.0]})
    centre = believed.rim.centre if believed.rim is not None else 0j
    x_mm, y_mm = [np.nan, centre.real], [np.nan, centre.imag]
    frames = frames.assign(x_mm=x_mm, y_mm=y_mm, probe_mm=[np.nan, 8.0])
    for k, effect in enumerate(effects):
        effect_settings = settings([effect], site_counts(channels), (0, 0))
        geometry = apply_skin(Geometry.from_skin(believed), effect_settings, START)
        is_behind_skin = effect_settings[0].effect.stage in ("wiring", "instrument")
        if geometry.deep or (is_behind_skin and not on_readings(effect["name"])):
            try:
                simulate(frames, np.array([-1, 0]), believed, channels, effect_settings, "train")
            except InputError as error:
                expected = f"{error.expected} ({error.file}.{error.place})"
                raise _Refusal([*place, k], error.actual, expected) from error


@contextlib.contextmanager
def _at_place(place: list, within: dict[str, list]) -> Iterator[None]:
    """Turn an InputError into a refusal at `place`, followed by the keys that `within` maps the
    error's own place to."""
    try:
        yield
    except InputError as error:
        inner = within.get(error.place, [])
        raise _Refusal([*place, *inner], error.actual, error.expected) from error


def _position(config: dict, place: list) -> tuple[int, list[int]]:
    """Depth of a place, then its order in the file: the sort key of errors, least deep first."""
    node, order = config, []
    for part in place:
        order.append(list(node).index(part) if isinstance(node, dict) else part)
        node = node[part]
    return len(place), order


def _unknown_name(config: dict) -> tuple[list, str, str] | None:
    """The first undefined name in a table, a figure, `ablation`, `transfer`, `diagnoses`,
    `tanks` or `loop`."""
    recordings = [*config["recordings"], *_rig_names(config)]
    for kind, names in (("configurations", config["configurations"]), ("recordings", recordings)):
        for name, splits in config["table_1"][kind].items():
            if name not in names:
                return ["table_1", kind, name], "an unknown name", one_of(names, name)
            for k, split in enumerate(splits):
                if split not in config["splits"]:
                    place = ["table_1", kind, name, split if isinstance(splits, dict) else k]
                    return place, repr(split), one_of(config["splits"], split)
    for key, names in (("recording", recordings), ("configuration", config["configurations"])):
        if config["figures"][key] not in names:
            source = config["figures"][key]
            return ["figures", key], repr(source), one_of(names, source)
    sets = [f"simulated-{name}" for name in config["configurations"]]
    for place, names in (
        (["table_2", "configurations"], config["configurations"]),
        (["transfer", "sources"], sets),
        (["transfer", "targets"], recordings),
        (["diagnoses"], recordings),
        (["tanks"], recordings),
        (["loop", "recordings"], recordings),
    ):
        for k, name in enumerate(_value_at(place, config)):
            if name not in names:
                return [*place, k], repr(name), one_of(names, name)
    names = [*(f"simulated-{name}" for name in with_continuous(config)), *recordings]
    for key in ("varied_on", "compared_on"):
        for name, splits in config["ablation"][key].items():
            place = ["ablation", key, name]
            if name not in names:
                return place, "an unknown name", one_of(names, name)
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
    """Names of the recordings that the attached rig captures."""
    return [config["rig"]["name"]] if "rig" in config else []


def any_of(names: Iterable[str]) -> str:
    """A regular expression of these names alone, of none one that matches nothing. It is decided
    letter by letter: alternatives take as long as there are names. Letters that go on alike share
    a class, as Snakemake reads the whole expression with every path: of numbered names it is short.
    """
    if not (names := set(names)):
        return "(?!)"
    rests: dict[str, list[str]] = {}
    for name in sorted(names - {""}):
        rests.setdefault(name[0], []).append(name[1:])
    letters: dict[str, list[str]] = {}
    for letter, rest in rests.items():
        letters.setdefault(any_of(rest), []).append(re.escape(letter))
    branches = [
        (alike[0] if len(alike) == 1 else f"[{''.join(alike)}]") + rest
        for rest, alike in letters.items()
    ]
    branches += [""] * ("" in names)
    return branches[0] if len(branches) == 1 else f"(?:{'|'.join(branches)})"


def captured_path(name: str) -> str:
    """Path of the recording that a rig has captured under a name."""
    return f"results/recordings/{name}.parquet"


def _missing_recording(config: dict) -> tuple[list, str, str] | None:
    """The first recording or query whose file neither exists nor is made by the workflow or the
    attached rig."""
    for name, recording in config["recordings"].items():
        for key in [key for key in PATHS if key in recording]:
            try:
                path = _expanded(recording[key])
            except KeyError as unset:
                actual = f"{recording[key]!r}, but {unset.args[0]} is not set"
                return ["recordings", name, key], actual, "an environment variable that is set"
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


def file_of(
    place: list, config: dict, files: Iterable[str | Path], default_source: str = COMMAND_LINE
) -> str:
    """The last file that contains the value at `place`; for a missing key the first that
    contains the mapping it is missing from, or within a list that list; else `default_source`."""
    files = [Path(file) for file in files]
    value = _value_at(place, config)
    if value is MISSING and files:
        if any(isinstance(part, int) for part in place):
            return file_of(place[:-1], config, files, default_source)
        holding_files = [file for file in files if _value_at(place[:-1], read(file)) is not MISSING]
        return str(holding_files[0]) if holding_files else default_source
    for file in reversed(files):
        file_value = _value_at(place, read(file))
        if repr(file_value) == repr(value) or (
            isinstance(file_value, dict) and isinstance(value, dict)
        ):
            return str(file)
    return default_source


def _value_at(place: list, node: Any) -> Any:
    """The value at `place` within nested mappings and lists, or MISSING."""
    for part in place:
        if part not in (node if isinstance(node, dict) else _indices(node)):
            return MISSING
        node = node[part]
    return node


if __name__ == "__main__":
    with reported("logs/configuration.log"):
        for file in sys.argv[1:]:
            read(file)
