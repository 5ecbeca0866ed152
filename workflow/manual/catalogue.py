"""The catalogue of effects as a page, in the order in which they enter a simulation."""

from eitskin.effects import EFFECTS
from eitskin.effects.effect import STAGES, Effect, Parameter
from eitskin.quantities import number
from manual.pictures import picture

HEAD = """# The catalogue of effects

Written by `python -m manual` from `workflow/eitskin/effects`, one file an effect. Each is physics
that a simulation may have, by `effects:` in `config.yaml`, and that a diagnosis may name. They
enter in the order of the stages below.

Under each is what it changes in one frame of the twin's skin, `twin: skin:` in `config.yaml`: rows
are drives, columns measuring pairs, grey is not read. Its first parameter with a value that does
nothing is a typical change away from it, as a diagnosis has it. Orange: the reading rises; purple,
and a dash: it falls. Readings of this skin are below 0: one that grows in size falls. Each picture
has colours of its own, those of sizes logarithmic; `make docs` draws them.
"""


def page() -> str:
    """The page in Markdown."""
    parts = [HEAD]
    for stage in STAGES:
        stage_effects = [effect for effect in EFFECTS.values() if effect.stage == stage]
        parts.append(f"## Stage: {stage}\n")
        parts += [_entry(effect) for effect in sorted(stage_effects, key=lambda e: e.name)]
    return "\n".join(parts)


def _entry(effect: Effect) -> str:
    lines = [f"### {effect.name}", "", *_text(effect), ""]
    lines += ["| parameter | unit | does nothing at | from | to |", "|---|---|---|---|---|"]
    lines += [_row(key, parameter) for key, parameter in effect.parameters.items()]
    facts = {
        "Varies with": effect.driver,
        "Sites": ", ".join(effect.sites) or "the whole skin",
        "Skins": _skins_text(effect),
        "Source": effect.source,
        "Looks like": ", ".join(effect.confusable) or "nothing else",
        "Shown by": effect.shown_by,
        "On the bench": effect.mend,
    }
    lines += ["", *(f"- {head}: {text}" for head, text in facts.items()), ""]
    lines += [f"```{{figure}} pictures/{effect.name}.png", f":alt: What {effect.name} changes", ""]
    lines += [picture(effect).caption, "```", ""]
    return "\n".join(lines)


def _skins_text(effect: Effect) -> str:
    """The skins on which it is modelled."""
    outlines = "discs and any outline" if effect.on_outlines else "discs alone"
    return outlines if effect.beside_inner else f"{outlines}, with all electrodes on the rim"


def _text(effect: Effect) -> list[str]:
    text = type(effect).__doc__
    assert text is not None
    return [line.strip() for line in text.strip().splitlines()]


def _row(key: str, parameter: Parameter) -> str:
    neutral_text = "must be given" if parameter.neutral is None else number(parameter.neutral)
    neutral_text = "may be left out" if parameter.optional else neutral_text
    unit = "" if parameter.unit == "1" else parameter.unit
    low, high = number(parameter.low), number(parameter.high)
    return f"| `{key}` | {unit} | {neutral_text} | {low} | {high} |"
