"""What `import eitskin` offers beside `read`: what the commands do, with arrays in between.

Readings are (N, M): N frames of M channels, in the recording's unit.
"""

import json
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from eitskin import answer_folder
from eitskin.atomic import held_folder
from eitskin.data import check, reconstruct, recording
from eitskin.data.recording import Recording, frames_table
from eitskin.diagnose import parts
from eitskin.diagnose.compare.result import comparison
from eitskin.diagnose.fitting.excerpt import LIMIT_GIB
from eitskin.diagnose.verdict import words
from eitskin.diagnose.verdict.record import Record, record
from eitskin.errors import InputError, refused
from eitskin.physics import outline
from eitskin.physics.skin import Skin
from eitskin.simulators import Simulator
from eitskin.skin_layout import stated_layout

DIAGNOSED = "the folder that eitskin diagnose wrote"
ACROSS = 32  # pixels over the skin
STEP = 1e-3  # relative, of a conductivity; of an effect's parameter, in its typical changes
UNTOUCHED_STAGES = ("skin", "wiring", "instrument")  # of effects that untouched frames show


@dataclass(frozen=True)
class Report:
    """An answer: of a diagnosis or of a comparison. A notebook shows its sentences.

    document: the content of diagnosis.json or comparison.json; sentences: its words; simulator: the
    corrected one, None of a comparison; recording, record, query: what `write` writes.
    """

    document: dict
    sentences: list[str]
    simulator: Simulator | None = None
    recording: Recording | None = field(default=None, repr=False)
    record: Record | None = field(default=None, repr=False)
    query: Recording | None = field(default=None, repr=False)

    @classmethod
    def read(cls, folder: str | Path) -> "Report":
        """The answer that `eitskin diagnose` wrote into a folder. Raises InputError for another."""
        path = Path(folder) / "diagnosis.json"
        try:
            document = json.loads(path.read_text("utf-8"))
        except OSError as error:
            raise refused(error, path, expected=DIAGNOSED) from error
        except ValueError as error:
            raise InputError(path, "file", "no JSON", DIAGNOSED) from error
        return cls(document, words.all_sentences(document), Simulator.read(folder))

    def write(self, folder: str | Path) -> Path:
        """Write what `eitskin diagnose` writes into `folder`; the path of report.html. Raises
        InputError for the answer of a comparison, or one that was read from files."""
        if self.record is None or self.recording is None:
            raise InputError("report", "record", "nothing", "the answer of eitskin.diagnose")
        with held_folder(folder) as held, TemporaryDirectory() as temporary:
            answer_folder.begin(held, self.recording)
            query = None
            if self.query is not None:
                query = Path(temporary) / "query.parquet"
                recording.write(self.query, query)
            return answer_folder.finish(held, self.record, query)

    def _repr_html_(self) -> str:
        """The sentences as HTML, the first one strong."""
        first, *others = map(escape, self.sentences)
        items = "".join(f"<li>{sentence}</li>" for sentence in others)
        return f"<div><p><strong>{first}</strong></p><ul>{items}</ul></div>"


def _check_type(recorded: object) -> None:
    """Raise InputError for what is no Recording, such as a path."""
    if not isinstance(recorded, Recording):
        expected = "what eitskin.read returns"
        raise InputError("recording", "argument", f"a {type(recorded).__name__}", expected)


def simulate(recorded: Recording, simulator: Simulator | None = None) -> np.ndarray:
    """Noise-free readings (N, M) of the frames of a recording or query, by its channels; NaN in
    frames whose touch is stated too poorly to be simulated.

    simulator: by default as believed. Raises InputError where the physics has no solution, and
    without a simulator for a query of unknown scale or at the robot's places.
    """
    _check_type(recorded)
    simulator = simulator or Simulator.believed(recorded)
    model = simulator.model(recorded)
    voltage = model.voltage(np.zeros(len(model.calibrations)), simulator.settings(model.channels))
    return np.where(model.simulable[:, None], voltage, np.nan)


@dataclass(frozen=True)
class Jacobian:
    """Derivatives of readings by a relative rise of the conductivity within discs.

    matrix (M, K): of the untouched skin's readings; discs (K, 3): x_mm, y_mm, radius_mm.
    """

    matrix: np.ndarray
    discs: np.ndarray

    @cached_property
    def is_seen(self) -> np.ndarray:
        """(K,) bool: whether a disc changes any reading."""
        return np.asarray((self.matrix != 0.0).any(axis=0))

    def image(self, change: np.ndarray, strength: float | None = None) -> np.ndarray:
        """(K,): the relative change of the conductivity in each disc that explains a change (M,) of
        the readings: one Gauss-Newton step with a NOSER prior, whose strength generalised
        cross-validation chooses where none is given. NaN readings are left out.
        Raises InputError for another shape."""
        if np.shape(change) != (len(self.matrix),):
            expected = f"({len(self.matrix)},), one frame's change"
            raise InputError("recording", "change", f"shape {np.shape(change)}", expected)
        is_read = np.isfinite(change)
        matrix = self.matrix[np.ix_(is_read, self.is_seen)]
        scale = np.linalg.norm(matrix, 2)
        matrix, change = matrix / scale, change[is_read] / scale
        if strength is None:
            strength = reconstruct.strength(matrix, change[None])
        image = np.zeros(len(self.discs))
        image[self.is_seen] = reconstruct.noser(matrix, strength) @ change
        return image


def pixels(skin: Skin, across: int = ACROSS) -> np.ndarray:
    """(K, 3): x_mm, y_mm, radius_mm of discs as large as the cells of a square grid with `across`
    cells over the skin, at the centres of those that lie on it."""
    centre = reconstruct.skin_pixels(skin, across)
    radius = 2.0 * stated_layout(skin).half_extent_mm / across / np.sqrt(np.pi)
    return np.column_stack([centre.real, centre.imag, np.full(len(centre), radius)])


def jacobian(
    recorded: Recording, simulator: Simulator | None = None, discs: np.ndarray | None = None
) -> Jacobian:
    """Derivatives (M, K) of the untouched skin's readings by the conductivity, at the recording's
    start.

    discs (K, 3): the basis: x_mm, y_mm, radius_mm of discs in which the conductivity rises, by
    default `pixels`; of the elements of a mesh, `peers.discs`. simulator: by default as believed.
    Each derivative is a central difference of the closed form by the contrast of a disc. Raises
    InputError where the physics has no solution.
    """
    _check_type(recorded)
    simulator = simulator or Simulator.believed(recorded)
    discs = pixels(simulator.skin) if discs is None else np.asarray(discs, float)
    x_mm, y_mm, radius_mm = discs.T
    effects = [
        item
        for item, setting in zip(
            simulator.effects, simulator.settings(recorded.channels), strict=True
        )
        if setting.effect.stage in UNTOUCHED_STAGES and not getattr(setting.effect, "on_contact", 0)
    ]
    instants = np.zeros(len(discs))
    frames = frames_table(instants, instants == 0, x_mm, y_mm, instants + STEP, 2.0 * radius_mm)
    metadata = recorded.metadata | {
        "values": "absolute",
        "voltage": "signed",
        "position_frame": "skin",
    }
    high, low = (
        simulate(
            Recording(frames, None, None, None, metadata),
            replace(
                simulator, skin=replace(simulator.skin, contrast_per_N=contrast), effects=effects
            ),
        )
        for contrast in (1.0, -1.0)
    )
    matrix = (high - low).T / (2.0 * STEP)
    if recorded.metadata["voltage"] == "magnitude":
        untouched = frames_table(np.zeros(1), np.zeros(1, bool))
        untouched_simulator = replace(simulator, effects=effects)
        reading = simulate(Recording(untouched, None, None, None, metadata), untouched_simulator)[0]
        matrix = matrix * np.sign(reading)[:, None]
    return Jacobian(matrix, discs)


def effect_jacobian(recorded: Recording, simulator: Simulator) -> dict[str, np.ndarray]:
    """Derivatives (N, M) of the readings of all frames by every parameter of the simulator's
    effects, per unit of the parameter, by central differences of STEP typical changes.

    The keys are NAME.PARAMETER, of a parameter with a value a site NAME.PARAMETER[SITE]. Raises
    InputError where the physics has no solution.
    """
    _check_type(recorded)
    model = simulator.model(recorded)
    stated_settings = simulator.settings(model.channels)
    coordinates = np.zeros(len(model.calibrations))
    derivatives: dict[str, np.ndarray] = {}
    for index, setting in enumerate(stated_settings):
        for key, parameter in setting.effect.parameters.items():
            value, skin = setting.values[key], model.nominal_skin
            neutral = setting.effect.neutral_at(key, skin, setting.sites)
            is_foreign = parameter.neutral is not None and neutral is None  # to a skin of this kind
            if value is None or parameter.whole or is_foreign:
                continue
            for position in np.ndindex(np.shape(value)):
                ends = []
                for sign in (-1.0, 1.0):
                    end = np.array(value, float)
                    scale = parameter.scale * (abs(end[position]) if parameter.low > 0 else 1.0)
                    end[position] = np.clip(
                        end[position] + sign * STEP * scale, parameter.low, parameter.high
                    )
                    values = setting.values | {key: end if end.ndim else float(end)}
                    settings = [*stated_settings]
                    settings[index] = replace(setting, values=values)
                    ends.append((float(end[position]), model.voltage(coordinates, settings)))
                (low, low_voltage), (high, high_voltage) = ends
                assert setting.sites is not None or not position
                site = f"[{setting.sites[position]}]" if position else ""  # type: ignore[index]
                slope = (high_voltage - low_voltage) / (high - low)
                derivatives[f"{setting.effect.name}.{key}{site}"] = slope
    return derivatives


def diagnose(
    recorded: Recording,
    name: str = "recording",
    query: Recording | None = None,
    anyway: bool = False,
    progress: bool = False,
    memory_GiB: float = LIMIT_GIB,
) -> Report:
    """What the simulation of a recording leaves out, as `eitskin diagnose` says it.

    query: states to predict, in `record.prediction` of the answer; anyway: go on with what the
    check calls unusable. Raises InputError for a query in place of a recording, a skin that
    cannot be simulated, and a recording that is not usable.
    """
    _check_type(recorded)
    recording.voltages(recorded, name)
    outline.refuse(recorded.skin)
    if not anyway:
        for finding in check.check(recorded).of_severity(check.ERROR):
            place = f"check, {finding.topic}"
            raise InputError(name, place, finding.sentence[:-1], "a usable recording")
    diagnosis = parts.diagnose(recorded, progress=progress, memory_GiB=memory_GiB)
    answered = record(diagnosis, name, query)
    simulator = Simulator.from_fit(diagnosis.explanation.fit)
    return Report(
        answered.document,
        words.all_sentences(answered.document),
        simulator,
        recorded,
        answered,
        query,
    )


def compare(
    control: Recording, later: Recording, names: tuple[str, str] = ("control", "later")
) -> Report:
    """What changed between two recordings of a skin, as `eitskin compare` says it, without a model
    of the skin. Raises InputError where they cannot be compared."""
    for recorded, name in zip((control, later), names, strict=True):
        _check_type(recorded)
        recording.voltages(recorded, name)
    document = comparison(control, later, names)
    return Report(document, document["sentences"])
