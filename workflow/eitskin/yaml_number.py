"""Numbers that YAML 1.1 reads as text, such as 1e-3: whether a text is one, and how to write it."""

import math


def reads_as_number(text: str) -> bool:
    """Whether a text is that of a finite number."""
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def hint(value: object) -> str:
    """What to write instead of a text that a person means as a number, to follow what is expected;
    nothing for other values. Of a list, that of its first such text."""
    texts = value if isinstance(value, list | tuple) else [value]
    text = next((text for text in texts if isinstance(text, str) and reads_as_number(text)), None)
    return "" if text is None else f"; YAML reads {text} as text: write {yaml_number(text)}"


def yaml_number(text: str) -> str:
    """A number as YAML 1.1 has it: with digits before a point, and a sign in its exponent."""
    mantissa, _, exponent = text.lower().partition("e")
    if not exponent:
        return repr(float(text)) if "." in text else str(int(text))
    mantissa = repr(float(mantissa))
    return f"{mantissa}e{exponent if exponent[0] in '+-' else '+' + exponent}"
