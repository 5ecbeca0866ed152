"""The glossary of the reports as a page."""

from eitskin.diagnose.report.glossary import TERMS

HEAD = """# Glossary

Written by `python -m manual` from `workflow/eitskin/diagnose/report/glossary.py`: the words of a
report, which links each of them at its first mention. The names of effects are in the
[catalogue](effects.md), the rules by which they are named in the [gates](gates.md).
"""


def page() -> str:
    """The page as Markdown."""
    terms = sorted(TERMS, key=lambda term: term.name.lower())
    return "\n".join([HEAD, *(f"- **{term.name}**: {term.meaning}" for term in terms), ""])
