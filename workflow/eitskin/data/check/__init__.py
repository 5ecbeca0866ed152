"""What a recording holds, how good it is, and what it cannot tell; in plain words.

`measures`, `wiring`, `missing`, `plausibility`, `response`, `clipping`, `compliance`, `exchanged`
and `steps` hold what is measured and how grave it is; `sentences` what is said of it, `suspicions`
what is said only where something looks wrong. Errors are what makes a recording useless as it
stands: a wrong channel order, readings that no passive skin gives, readings that never change.
"""

from pathlib import Path

from eitskin.atomic import atomic_path
from eitskin.data.check import sentences, suspicions
from eitskin.data.check.finding import ERROR, FACT, UNOBSERVABLE, WARNING, Check
from eitskin.data.recording import Recording
from eitskin.errors import InputError
from eitskin.progress import patient
from eitskin.quantities import plain

__all__ = ["ERROR", "FACT", "UNOBSERVABLE", "WARNING", "Check", "check", "text", "write"]

EXAMINED = (  # of a recording with readings
    suspicions.constant,
    suspicions.unseen,
    sentences.lost,
    sentences.clipped,
    sentences.noise,
    sentences.drift,
    suspicions.steps_in_time,
    sentences.reciprocity,
    suspicions.exchanged_channels,
    suspicions.weak_drives,
    sentences.channel_order,
    sentences.polarity,
    sentences.numbering,
    sentences.unobservable,
)


def check(recording: Recording, progress: bool = False) -> Check:
    """Every finding about a recording or query (`recording.validate`d); progress: a bar on stderr
    where it takes long."""
    findings = sentences.contents(recording) + sentences.skin(recording)
    findings += sentences.outline(recording) + sentences.repeated(recording)
    findings += suspicions.units(recording)
    if recording.voltage is not None:
        nothing = sentences.dead(recording)
        if nothing:
            return Check((*findings, *nothing))
        for examine in patient(EXAMINED, "checking", progress):
            findings += examine(recording)
    return Check(tuple(findings))


def text(result: Check) -> str:
    """The check as plain words, a sentence a line, ending with a verdict."""
    sections = {
        FACT: "What it holds",
        WARNING: "What to look at",
        ERROR: "What makes it unusable as it stands",
        UNOBSERVABLE: "What it cannot tell, and what to add so that it could",
    }
    lines = []
    for severity, title in sections.items():
        found = result.of(severity)
        if found:
            lines.append(f"{title}:")
        for finding in found:
            remedy = f" Add: {finding.remedy}." if finding.remedy else ""
            lines.append(f"  {finding.topic}: {finding.sentence}{remedy}")
    lines.append("Usable." if result.ok else "Not usable as it stands.")
    return plain("\n".join(lines) + "\n")


def write(result: Check, path: str | Path, file: str | Path) -> None:
    """Write the check of the recording `file` as plain words.

    Raises InputError naming the first error, with those words as its note, where the recording is
    unusable; then nothing is written, so that nothing can be learned from it.
    """
    for finding in result.of(ERROR):
        expected = "a usable recording"
        refusal = InputError(file, f"check, {finding.topic}", finding.sentence[:-1], expected)
        refusal.add_note(text(result))
        raise refusal
    with atomic_path(path) as temporary:
        temporary.write_text(text(result), encoding="utf-8")
