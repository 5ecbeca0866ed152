"""One statement about a recording, how grave it is, and all of them together."""

from dataclasses import dataclass

FACT, WARNING, ERROR, UNOBSERVABLE = "fact", "warning", "error", "unobservable"


@dataclass(frozen=True)
class Finding:
    """One statement: its topic, how grave it is, a sentence, a number where there is one (relative
    unless the topic's function says otherwise), for what cannot be told the frames to add, and of
    what happens at one frame that.
    """

    topic: str
    severity: str
    sentence: str
    value: float | None = None
    remedy: str | None = None
    frame: int | None = None


@dataclass(frozen=True)
class Check:
    """All findings about one recording."""

    findings: tuple[Finding, ...]

    @property
    def ok(self) -> bool:
        """Whether no finding is an error."""
        return not any(finding.severity == ERROR for finding in self.findings)

    def about(self, topic: str) -> list[Finding]:
        """The findings of one topic."""
        return [finding for finding in self.findings if finding.topic == topic]

    def of(self, severity: str) -> list[Finding]:
        """The findings that are as grave as `severity`."""
        return [finding for finding in self.findings if finding.severity == severity]
