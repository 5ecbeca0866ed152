"""Checks of a recording: its contents, its quality and what it cannot show, in plain words.

`kinds`, `measures`, `wiring`, `missing`, `plausibility`, `response`, `clipping`, `compliance`,
`exchange`, `unlabelled`, `second_touches`, `placeholders`, `copies`, `loads` and `steps` measure
and grade; `sentences` puts it into words, `suspicions` only where something looks wrong. Errors
make a recording unusable as it is: values of another kind than stated, a wrong channel order,
readings that no passive skin gives, readings that never change, places in another order than their
presses.
"""

from pathlib import Path

from eitskin.atomic import atomic_path
from eitskin.data import subset
from eitskin.data.check import sentences, suspicions, wiring
from eitskin.data.check.finding import ERROR, FACT, UNOBSERVABLE, WARNING, Check, Finding
from eitskin.data.check.placeholders import measured
from eitskin.data.recording import Recording
from eitskin.errors import InputError
from eitskin.progress import patient
from eitskin.quantities import plain

__all__ = ["ERROR", "FACT", "UNOBSERVABLE", "WARNING", "Check", "check", "text", "write"]

EXAMINATIONS = (  # of a recording with readings
    suspicions.constant_frames,
    suspicions.copied_frames,
    suspicions.lost_forces,
    suspicions.load_cell_zero,
    suspicions.unseen_touches,
    suspicions.unlabelled_touches,
    suspicions.second_touch,
    sentences.lost_readings,
    sentences.clipped_channels,
    sentences.noise,
    sentences.drift,
    suspicions.steps_in_time,
    sentences.reciprocity,
    suspicions.exchanged_channels,
    suspicions.weak_drives,
    sentences.channel_order,
    sentences.polarity,
    sentences.places,
    sentences.numbering,
    sentences.unobservable,
)

OF_PLACES = (sentences.places, sentences.numbering)  # without sites whose readings are wrong

NO_DISC = "Usable to be compared with another recording, not to be diagnosed."

ON_ALL_FRAMES = (  # of a recording of any length; others look at a sample of a long one
    suspicions.constant_frames,
    suspicions.unlabelled_touches,
    suspicions.steps_in_time,
    sentences.lost_readings,
    sentences.unobservable,
)


def check(recording: Recording, progress: bool = False) -> Check:
    """All findings about a valid recording or query; `progress` shows a bar on stderr."""
    findings = sentences.contents(recording) + sentences.skin(recording)
    findings += sentences.outline(recording) + sentences.repeated_channels(recording)
    sampled = subset.sample(recording)
    if recording.voltage is None:
        return Check((*findings, *suspicions.units(sampled)))
    readings = measured(sampled)
    refusals = sentences.dead_channels(recording) or suspicions.kind_of_values(readings)
    if refusals:
        return Check((*findings, *refusals))
    findings += suspicions.units(sampled)
    findings += sentences.sampled_frames(recording, sampled)
    findings += suspicions.stand_ins(sampled) + suspicions.unplugged(sampled)
    if readings is not sampled:
        recording = readings if sampled is recording else measured(recording)
    for examine in patient(EXAMINATIONS, "checking", progress):
        if examine is sentences.numbering and _is_refuted(findings):
            continue  # then touches light up anywhere
        examined = recording if examine in ON_ALL_FRAMES else readings
        if examine in OF_PLACES:
            sites = [site for finding in findings for site in finding.sites]
            examined = wiring.showing_places(examined, sites)
        findings += examine(examined)
    return Check(tuple(findings))


def _is_refuted(findings: list[Finding]) -> bool:
    """Whether the order of channels or that of places is wrong."""
    topics = {finding.topic for finding in findings if finding.severity == ERROR}
    return not topics.isdisjoint({"order", "places"})


def text(report: Check) -> str:
    """The report in plain words, one sentence a line, ending with a verdict."""
    sections = {
        FACT: "What it holds",
        WARNING: "What to look at",
        ERROR: "What makes it unusable as it stands",
        UNOBSERVABLE: "What it cannot tell, and what to add so that it could",
    }
    lines = []
    for severity, title in sections.items():
        severe_findings = report.of_severity(severity)
        if severe_findings:
            lines.append(f"{title}:")
        for finding in severe_findings:
            remedy = f" Add: {finding.remedy}." if finding.remedy else ""
            lines.append(f"  {finding.topic}: {finding.sentence}{remedy}")
    usable = NO_DISC if report.of_topic("outline") else "Usable."
    lines.append(usable if report.ok else "Not usable as it stands.")
    return plain("\n".join(lines) + "\n")


def write(report: Check, path: str | Path, file: str | Path) -> None:
    """Write the report of the recording `file` to `path` in plain words.

    Raises InputError naming the first error, with the text as its note, where the recording is
    unusable; then nothing is written, so that no later rule uses it.
    """
    for finding in report.of_severity(ERROR):
        expectation = "a usable recording"
        refusal = InputError(file, f"check, {finding.topic}", finding.sentence[:-1], expectation)
        refusal.add_note(text(report))
        raise refusal
    with atomic_path(path) as temporary:
        temporary.write_text(text(report), encoding="utf-8")
