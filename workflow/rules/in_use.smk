# What the code of rules finds by name: the effects, formats and models in use, for their fingerprints.
from eitskin.data import importers
from eitskin.effects import catalogue_names, modules
from eitskin.learn import models
from eitskin.physics.skin import Skin
from eitskin.simulate.layout import touch_grid

CATALOGUE = modules(catalogue_names())  # what a diagnosis may name
IMPORTERS = importers.modules()
PLACES = len(touch_grid(Skin.from_metadata(config["skin"]), **config["touch_grid"]))


def of_configuration(key):
    """A param: a key of the configuration of a job."""
    return lambda wildcards: config["configurations"][wildcards.configuration][key]


def of_recording(key):
    """A param: a key of the recording of a job, None where it has none."""
    return lambda wildcards: config["recordings"][wildcards.recording].get(key)


def effects_of(configuration):
    return config["configurations"][configuration]["effects"]


def names_of(effects):
    return [effect["name"] for effect in effects]


def of_model(script):
    """A param: the fingerprint of a script that makes or applies the model of its job."""
    return lambda wildcards: fingerprint(script, models.modules(wildcards.model))


def code_of_import(wildcards):
    """A param: the fingerprint of an import, with the modules and files that read its recording."""
    modules = importers.readers(*READ_FROM[wildcards.recording])
    return fingerprint("import_recording", modules, importers.reader_files(modules))


def memory_MB(wildcards):
    """What making a set takes: of its samples the states, of the frames a few groups of sessions."""
    own = config["configurations"][wildcards.configuration]
    samples = (own["continuous"] or {}).get("samples", PLACES * config["forces"]["levels"])
    return 1000 + samples // 5000
