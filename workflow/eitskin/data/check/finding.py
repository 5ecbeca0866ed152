"""Findings about a recording, and the check that collects them."""

from dataclasses import dataclass

FACT, WARNING, ERROR, UNOBSERVABLE = "fact", "warning", "error", "unobservable"


@dataclass(frozen=True)
class Finding:
    """One finding: topic, severity and sentence.

    `value` is its number, relative unless the topic's function says otherwise; `remedy` are the
    frames to add for what cannot be observed; `frame` is set for a finding at one frame, `stretch`,
    the first and the last frame, for one that leaves these to be diagnosed; `sites` are electrodes,
    or pairs of them, whose readings show no places of touches.
    """

    topic: str
    severity: str
    sentence: str
    value: float | None = None
    remedy: str | None = None
    frame: int | None = None
    stretch: tuple[int, int] | None = None
    sites: tuple[tuple[int, ...], ...] = ()


@dataclass(frozen=True)
class Check:
    """All findings about one recording."""

    findings: tuple[Finding, ...]

    @property
    def ok(self) -> bool:
        """Whether no finding is an error."""
        return not any(finding.severity == ERROR for finding in self.findings)

    def of_topic(self, topic: str) -> list[Finding]:
        """The findings of a topic."""
        return [finding for finding in self.findings if finding.topic == topic]

    def of_severity(self, severity: str) -> list[Finding]:
        """The findings of a severity."""
        return [finding for finding in self.findings if finding.severity == severity]
