"""Numbers with units as text for readers."""

import math
from collections.abc import Sequence

import numpy as np

from eitskin.errors import printable

MINUS, NONE = "\N{MINUS SIGN}", "\N{EN DASH}"
NO_BREAK = "\N{NO-BREAK SPACE}"
PREFIXED = ("V", "S", "S/N", "A", "Ω")
PREFIXES = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M"}
SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: float | None, digits: int = 3) -> str:
    """A number with so many significant digits, as a person writes it; a dash for none."""
    if value is None or math.isnan(value):
        return NONE
    if math.isinf(value):
        return "∞" if value > 0 else f"{MINUS}∞"
    if value == round(value) and abs(value) < 1e6:
        return _signed(str(round(value)))
    exponent = math.floor(math.log10(abs(value)))
    if -4 < exponent < max(5, digits + 1):
        return _signed(f"{value:.{max(0, digits - 1 - exponent)}f}")
    return _by_ten(value, digits)


def chance(p: float) -> str:
    """A probability; one below the range of float64 is not written as 0."""
    return "<10⁻³⁰⁰" if p == 0 else number(p, 2)


def percent(share: float, decimals: int = 0) -> str:
    """A share in per cent, with so many decimals; of one that these would make 0, that it is
    less."""
    limit = 0.5 * 10.0**-decimals
    if share != 0.0 and abs(100 * share) < limit:
        return f"less than {limit:g} %"
    return f"{100 * share:.{decimals}f} %"


def counted(count: int, noun: str) -> str:
    """`1 frame`, `2 frames`, `2 presses`."""
    ending = "" if count == 1 else "es" if noun.endswith(("s", "ch")) else "s"
    return f"{count} {noun}{ending}"


def decimal(value: float, decimals: int, sign: bool = False) -> str:
    """A number with so many decimals, 0 without a sign; `sign`: with + where it is positive."""
    rounded = round(value, decimals) + 0.0  # of -0.0 makes 0.0
    return _signed(f"{rounded:{'+' if sign and rounded else ''}.{decimals}f}")


def power(value: float) -> str:
    """A round number of an axis: 0.5, 20, 10³."""
    if 1e-3 < value < 999:
        return f"{value:.6g}"
    return _by_ten(value, 1).removeprefix("1·")


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """A number with its unit, by thousands where the unit takes a prefix."""
    factor, name = _scale(value, unit)
    return f"{number(value / factor, digits)}{name}"


def interval(value: float, low: float, high: float, unit: str) -> str:
    """`value (90 %: low to high) unit`, degrees after each number, with as many digits as the
    interval justifies."""
    if not np.isfinite([value, low, high]).all():
        return _within([number(bound) for bound in (value, low, high)], _spaced(unit))
    factor, name = _scale(max(abs(value), abs(low), abs(high)), unit)
    span = max(value - low, high - value) / factor
    if span == 0:
        return f"{number(value / factor, 4)}{name}, held"
    decimals = _decimals(span)
    return _within([_rounded(bound / factor, decimals) for bound in (value, low, high)], name)


def _within(texts: list[str], name: str) -> str:
    if name == "°":
        texts, name = [f"{text}°" for text in texts], ""
    return f"{texts[0]} (90 %: {texts[1]} to {texts[2]}){name}"


def prefixed(value: float, unit: str) -> tuple[float, str]:
    """The factor of the prefix that suits a value, and the unit with it; 1 where it takes none."""
    if unit not in PREFIXED or value == 0 or not math.isfinite(value):
        return 1.0, unit
    power = min(max(3 * math.floor(math.log10(abs(value)) / 3), min(PREFIXES)), max(PREFIXES))
    return 10.0**power, f"{PREFIXES[power]}{unit}"


def written_alike(a: float, b: float, span: float) -> bool:
    """Whether two numbers have the same text at the digits that an interval with this span to
    its farther side justifies; for a span of 0 or NaN, whether they are equal."""
    if not 0.0 < span < math.inf:
        return a == b
    decimals = _decimals(span)
    return round(a, decimals) == round(b, decimals)


def plain(text: str) -> str:
    """Lines for terminals and grep: with plain spaces alone, and nothing that a terminal obeys."""
    return "\n".join(map(printable, text.replace(NO_BREAK, " ").split("\n")))


def listed(items: Sequence[object]) -> str:
    """`a`, `a and b`, `a, b and c`."""
    texts = [str(element) for element in items]
    return " and ".join(filter(None, [", ".join(texts[:-1]), *texts[-1:]]))


def _decimals(span: float) -> int:
    """Decimals that an interval with this span to its farther side justifies."""
    return 1 - math.floor(math.log10(span))


def _by_ten(value: float, digits: int) -> str:
    mantissa, _, tens = f"{value:.{digits - 1}e}".partition("e")
    return f"{_signed(mantissa)}·10{str(int(tens)).translate(SUPERSCRIPT)}"


def _rounded(value: float, decimals: int) -> str:
    """A number with so many decimals, 0 without a sign; a very small one with a power of ten."""
    if decimals > 6:
        digits = decimals + 1 + (math.floor(math.log10(abs(value))) if value else 0)
        return number(value, max(digits, 1))
    return _signed(f"{round(value, decimals) + 0.0:.{max(decimals, 0)}f}")


def _signed(text: str) -> str:
    return text.replace("-", MINUS)


def _scale(value: float, unit: str) -> tuple[float, str]:
    """The factor of the prefix that suits `value`, and the unit with it and a space."""
    factor, name = prefixed(value, unit)
    return factor, _spaced(name)


def _spaced(unit: str) -> str:
    return "" if unit == "1" else unit if unit == "°" else f"{NO_BREAK}{unit}"
