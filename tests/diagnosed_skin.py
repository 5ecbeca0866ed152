"""Folders as a diagnosis leaves them, of simulated recordings: to test and to look at the report.

The recordings, their residuals and the electrodes' rows of the atlas are computed; intervals,
evidence, gaps, rivals, decisions and the next experiment are made up, so that the report has them
to show.
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from scipy.stats import chi2

from eitskin.data import recording
from eitskin.data.recording import Recording, frames_table
from eitskin.diagnose.search import gates
from eitskin.diagnose.search.journal import Decision, Journal
from eitskin.diagnose.verdict.words import effect_sentence
from eitskin.effects import EFFECTS, catalogue_names
from eitskin.effects.effect import SITES
from eitskin.effects.settings import settings, site_counts
from eitskin.physics.forward import Forward
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.simulate.readings import simulate
from simulated_metadata import simulated_metadata

SKIN = Skin(80.0, 3.0, 0.5, tuple(22.5 * np.arange(16)), 5.0, 2e-3, 1e-3, 0.9)
CHANNELS = channel_table(16)
SCHEMA = Path(__file__).parents[1] / "workflow/eitskin/diagnose/diagnosis.schema.yaml"
CONTACT = {"name": "contact-impedance", "electrodes": [7], "parameters": {"ratio": 2.1}}
GAINS = {
    "name": "channel-gain",
    "parameters": {"gain": (1 + 0.001 * np.sin(np.arange(208))).tolist()},
}
KINDS = ("explained", "consistent", "untouched", "unexplained", "partly-explained")
NOISE = 2e-4  # over the median reading
UNMET = "touch-contrast"  # the name that met no gate
RIG = {
    "components": [
        {
            "name": "place-per-press",
            "unit": "mm",
            "sd": 0.41,
            "low": 0.3,
            "high": 0.5,
            "learned": True,
        },
        {
            "name": "gain-walk",
            "unit": "1",
            "sd": 2e-3,
            "low": 1.6e-3,
            "high": 2.5e-3,
            "learned": True,
        },
        {
            "name": "force-per-press",
            "unit": "1",
            "sd": 0.02,
            "low": 0.002,
            "high": 0.2,
            "learned": False,
        },
    ],
    "loud_frames": [17, 90],
    "jumps": [],
    "spikes": {"readings": 12, "share": 5e-4},
}


def diagnosed(folder: Path, kind: str = "explained") -> tuple[Path, Path]:
    """Write the folder of a diagnosis of `kind`, one of KINDS; its path and its recording's."""
    folder.mkdir(parents=True, exist_ok=True)
    draw = np.random.default_rng(7)
    frames, press = _frames(0 if kind == "untouched" else 12, draw)
    truth = {"explained": [CONTACT], "partly-explained": [CONTACT, GAINS], "unexplained": [GAINS]}
    named = {"explained": [CONTACT], "partly-explained": [CONTACT]}
    near = Forward(Geometry.from_skin(SKIN), "train")

    def voltage(items: list[dict]) -> np.ndarray:
        chosen = settings(items, site_counts(CHANNELS), (0, 0))
        return simulate(frames, press, SKIN, CHANNELS, chosen, "train", solved_skin=near)

    clean = voltage(truth.get(kind, []))
    noise_V = np.full(len(CHANNELS), NOISE * np.median(np.abs(clean)))
    recorded = clean + noise_V * draw.normal(size=clean.shape)
    recorded[3, 17] = np.nan
    last = (press >= 0) & (press % 4 == 0)
    before, after = voltage([]), voltage(named.get(kind, []))
    metadata = simulated_metadata(SKIN, CHANNELS)
    path = folder / "recording.parquet"
    recording.write(Recording(frames, recorded, None, None, metadata), path)
    residuals = {
        name: (recorded - v) / noise_V for name, v in (("before", before), ("after", after))
    }
    evidence = folder / "evidence"
    evidence.mkdir(exist_ok=True)
    np.savez(
        evidence / "residuals.npz",
        **residuals,
        noise_V=noise_V,
        noise_source="the odd half of reciprocal pairs, and repeats of untouched frames",
        noise_dof=412.0,
        channels=CHANNELS,
        last=last.astype(int),
        last_before_V=np.where(last[:, None], recorded - before, np.nan),
        last_after_V=np.where(last[:, None], recorded - after, np.nan),
        last_channels=np.isin(CHANNELS[:, 0], (3, 11)) & (kind == "untouched"),
        **{
            name: frames[name]
            for name in ("time_s", "touch", "x_mm", "y_mm", "force_N", "probe_mm")
        },
        press=press,
        recorded_V=recorded,
        before_V=before,
        after_V=after,
        changes=((after - before) / noise_V)[[9]] if kind in named else np.zeros((0, len(noise_V))),
        changed_frame=[9] if kind in named else np.zeros(0, int),
    )
    for name, residual in residuals.items():
        _atlas(residual).to_csv(evidence / f"atlas_{name}.csv", index=False)
    effects = [_contact_effect()] if kind in named else []
    rms = [float(np.sqrt(np.nanmean(residuals[name] ** 2))) for name in ("before", "after")]
    scores = {
        "chi2_per_dof_before": rms[0] ** 2,
        "chi2_per_dof_after": rms[1] ** 2,
        "rms_before_V": rms[0] * noise_V[0],
        "rms_after_V": rms[1] * noise_V[0],
    }
    result = {
        "format": "eit-diagnosis",
        "version": 1,
        "recording": kind,
        "verdict": "consistent" if kind == "untouched" else kind,
        "calibration": {"conductivity_S_per_m": _estimate(0.4991, 0.4987, 0.4996, "S/m")},
        "noise_V": float(np.median(noise_V)),
        "effects": effects,
        "other": _other(kind),
        "unobservable": ["frame-skew", "mains-interference"],
        "fit": {
            "held_out": {"frames": len(frames) - int(last.sum()), **scores},
            "last": {
                "frames": int(last.sum()) or len(frames),
                **scores,
                "chi2_per_dof_before_own_sizes": scores["chi2_per_dof_before"],
            },
        },
    }
    _write_json(folder / "diagnosis.json", result)
    if kind == "explained":
        pq.write_table(_predicted(after[:20], noise_V), folder / "predicted.parquet")
    (folder / "effects.yaml").write_text(yaml.safe_dump({"effects": named.get(kind, [])}))
    _rivals(effects, rms).to_csv(evidence / "rivals.csv", index=False)
    _identifiability(draw, kind).to_csv(evidence / "identifiability.csv", index=False)
    _search(effects, rms).to_csv(evidence / "search.csv", index=False)
    _decisions(effects).to_csv(evidence / "decisions.csv", index=False)
    _write_json(evidence / "experiment.json", _experiment(effects))
    return folder, path


def with_rig(folder: Path) -> None:
    """Add to a diagnosis in a folder what it may say of the rig, as of a fit that is not accepted:
    its effects are candidates."""
    path = folder / "diagnosis.json"
    said = json.loads(path.read_text(encoding="utf-8")) | {"noise": RIG}
    for effect in said["effects"]:
        effect["certain"] = False
        effect["sentence"] = effect_sentence(effect, EFFECTS[effect["name"]])
        said["verdict"] = "partly-explained"
    for scores in said["fit"].values():
        for key in ("before", "after"):
            scores[f"white_chi2_per_dof_{key}"] = 3.0 * scores[f"chi2_per_dof_{key}"]
    said["fit"]["last"]["chi2_per_dof_before_own_sizes"] /= 2.0
    _write_json(path, said)


def with_every_effect(folder: Path) -> None:
    """Make a diagnosis in a folder name the catalogue, at sites 2 and 5 of each kind."""
    path = folder / "diagnosis.json"
    said = json.loads(path.read_text(encoding="utf-8"))
    sample, said["effects"] = said["effects"][0], []
    for name in sorted(set(EFFECTS) - {"ellipse", "adc-nonlinearity"}):
        effect = EFFECTS[name]
        kind = next(iter(effect.sites), None)
        chosen = {each: [2, 5] if each == kind else [] for each in SITES}
        parameters = {
            key: _estimate(1.5, 1.25, 1.75, one.unit) for key, one in effect.parameters.items()
        }
        new = {"name": name, "driver": effect.driver, "parameters": parameters, "gap": None}
        new |= {"alternatives": [], "scope": "sparse" if kind else "common"}
        said["effects"].append({**sample, **new, **chosen})
    _write_json(path, said)


def _frames(presses: int, draw: np.random.Generator) -> tuple[pd.DataFrame, np.ndarray]:
    """Six untouched frames, then presses of an untouched frame and six that load and unload."""
    force = np.concatenate([np.zeros(6), np.tile([0.0, 1.0, 3.0, 6.0, 9.0, 5.0, 2.0], presses)])
    press = np.concatenate([np.full(6, -1), np.repeat(np.arange(presses), 7)])
    press[force == 0] = -1
    radius, angle = 65.0 * np.sqrt(draw.uniform(0.05, 1, presses)), draw.uniform(0, 6.3, presses)
    at = np.where(press >= 0, press, 0)
    place = (radius * np.exp(1j * angle))[at] if presses else np.zeros(len(force), complex)
    frames = frames_table(
        0.5 * np.arange(len(force)), force > 0, place.real, place.imag, force, probe_mm=10.0
    )
    return frames, press


def _predicted(voltage: np.ndarray, noise_V: np.ndarray) -> pa.Table:
    columns = {"voltage_V": voltage, "std_V": np.tile(0.1 * noise_V, (len(voltage), 1))}
    lists = {
        name: pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])
        for name, values in columns.items()
    }
    return pa.table({"time_s": 0.5 * np.arange(len(voltage)), **lists})


def _estimate(value: float, low: float, high: float, unit: str) -> dict:
    return {"value": value, "low": low, "high": high, "unit": unit}


def _contact_effect() -> dict:
    return {
        "name": "contact-impedance",
        "alternatives": ["electrode-width"],
        "scope": "sparse",
        "electrodes": [7],
        "drives": [],
        "measures": [],
        "channels": [],
        "driver": "static",
        "parameters": {"ratio": _estimate(2.104, 2.087, 2.121, "1")},
        "share": 0.997,
        "evidence": {"elpd_gain": 4120.0, "elpd_se": 61.3, "p_value": 1e-5},
        "gap": 11.2,
        "sentence": "Electrode 7 has 2.1 times the contact impedance that the simulation assumes.",
    }


def _other(kind: str) -> dict:
    likely = kind in ("unexplained", "partly-explained")
    return {
        "probability": 0.98 if likely else 0.02,
        "electrodes": [],
        "drives": [3, 4] if likely else [],
        "measures": [],
        "driver": "static" if likely else None,
        "law": "proportional to the reading" if likely else None,
        "sentence": "Something static scales single channels by up to 0.1 %." if likely else None,
    }


def _atlas(residual: np.ndarray) -> pd.DataFrame:
    """Chi2 of each electrode's channels, of their mean over frames; q by Benjamini, Hochberg."""
    square = np.nanmean(residual, axis=0) ** 2 * np.isfinite(residual).sum(axis=0)
    uses = [(electrode == CHANNELS).any(axis=1) for electrode in range(16)]
    dof = np.array([use.sum() for use in uses])
    value = np.array([square[use].sum() for use in uses])
    p = chi2.sf(value, dof)
    order = np.argsort(p)
    q = np.empty(16)
    q[order] = np.minimum.accumulate((p[order] * 16 / np.arange(1, 17))[::-1])[::-1]
    return pd.DataFrame(
        {
            "statistic": "electrode",
            "site": [f"electrode {k}" for k in range(16)],
            "value": value,
            "dof": dof,
            "p": p,
            "q": q,
            "free_p": p,
            "sentence": [
                f"Channels that use electrode {k} are off the same way." for k in range(16)
            ],
        }
    )


def _rivals(effects: list[dict], rms: list[float]) -> pd.DataFrame:
    rows = [
        ("", "", rms[1] ** 2, 0.0, np.nan),
        ("contact-impedance", "nothing", rms[0] ** 2, -4120.0, np.nan),
        ("contact-impedance", "electrode-width", 1.01 * rms[1] ** 2, -1.3, 2.1),
        ("contact-impedance", "electrode-position", 0.4 * rms[0] ** 2, -1650.0, 11.2),
        ("contact-impedance", "electrode-open", 80.0 * rms[0] ** 2, -9e4, np.nan),
    ]
    columns = ["effect", "instead", "chi2_per_dof", "elpd_difference", "gap"]
    return pd.DataFrame(rows if effects else [], columns=columns)


def _identifiability(draw: np.random.Generator, kind: str) -> pd.DataFrame:
    rows = []
    for name, effect in sorted(EFFECTS.items()):
        hidden = name in ("frame-skew", "mains-interference") or (
            kind == "untouched" and effect.stage in ("touch", "clock")
        )
        rival = effect.confusable[0] if effect.confusable and not hidden else ""
        gap = float(draw.choice([1.4, 4.2, 9.0, 60.0])) if rival else np.nan
        words = "Press at one place with slow and fast loading." if hidden or gap < 5 else ""
        rows.append((name, 0.0 if hidden else 80.0 * draw.random(), rival, gap, not hidden, words))
    columns = ["name", "snr", "nearest", "gap", "observable", "experiment"]
    return pd.DataFrame(rows, columns=columns)


def _search(effects: list[dict], rms: list[float]) -> pd.DataFrame:
    rows = [
        (1, "add", "electrode-width", "electrodes 7", 1.2e4, -6150.0, 1e-5),
        (2, "swap", "contact-impedance", "electrodes 7", 1.1e4, -6149.0, 1e-5),
    ]
    columns = ["step", "action", "effect", "sites", "chi2", "log_evidence", "p_value"]
    return pd.DataFrame(rows if effects else [], columns=columns)


def _decisions(effects: list[dict]) -> pd.DataFrame:
    """Every name that is no effect stops at one of three gates, but UNMET."""
    beside = " ".join(effect["name"] for effect in effects)
    names = sorted({*catalogue_names()} - {UNMET, *beside.split()})
    decisions = []
    for rank, name in enumerate(names, start=1):
        kind = next(iter(EFFECTS[name].sites), "")
        place = {"kind": kind, "sites": "2 5" if kind else "", "beside": beside, "place": ""}
        for gate, value in (
            (gates.NAMES, float(rank)),
            (gates.EVIDENCE, 4.0 - rank),
            (gates.PREDICTION, -0.7),
        ):
            admitted = gate.admits(value)
            shared = {"round": 1, "name": name, "gate": gate.name, "detail": ""}
            decisions.append(Decision(**shared, **place, value=value, admitted=admitted))
            if not admitted:
                break
    return Journal(decisions=decisions).table()


def _experiment(effects: list[dict]) -> dict:
    if not effects:
        return {"sentence": "No two names need to be told apart.", "pairs": []}
    pair = {
        "a": "contact-impedance",
        "b": "electrode-width",
        "gap_now": 2.1,
        "gap_then": 14.6,
        "recipe": "Record 20 frames that also read the voltages of the driven electrodes.",
    }
    sentence = "Reading the driven electrodes' own voltages tells width from impedance."
    return {"sentence": sentence, "pairs": [pair]}


def _write_json(path: Path, content: dict) -> None:
    path.write_text(json.dumps(content, indent=1), encoding="utf-8")
