"""Texts of values: numbers with useful digits, a word and a symbol per verdict, a dash for none.

number(0.00024419)  ->  "2.442×10⁻⁴"   cost(46415.2)  ->  "46 415.20"   number(None)  ->  "–"
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

DASH = "–"
_THIN = "\u202f"
# Double-precision rounding of sums near 1.
ROUNDING = 1e-15
# Smallest cost with a power of ten; a diverged plan may cost 1e200.
_LARGE = 1e9

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
# Terminal escapes, control characters and direction marks, which must not reach a page.
_TERMINAL = re.compile(r"\x1b(\[[0-9;?]*[ -/]*[@-~]|[@-Z\\-_])")
_CONTROL = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ufeff\ud800-\udfff]"
)
# Numbers as programs print them: 1.2e-02, 1e+08, and a signed zero.
_PROGRAM = re.compile(r"(?<![\w.])([-+]?)(\d+(?:\.\d+)?)[eE]([-+]?\d+)(?![\w.]*\w)")
_SIGNED_NOUGHT = re.compile(r"(?<![\w.,)\]-])-0(?:\.0+)?(?![\d.]*\d|\w)")


@dataclass(frozen=True)
class Sign:
    """A word, a symbol and a CSS class, so that colour is never alone."""

    word: str
    symbol: str
    style: str
    meaning: str


def _by_word(*signs: Sign) -> dict[str, Sign]:
    return {sign.word: sign for sign in signs}


VERDICTS = _by_word(
    Sign("holds", "✓", "holds", "every question asked is answered yes for the inputs alone"),
    Sign(
        "holds with feedback",
        "↻",
        "feedback",
        "not for the inputs alone, but with limited LQR feedback around the plan",
    ),
    Sign("violates", "✗", "violates", "at least one question asked is surely answered no"),
    Sign("undecided", "?", "undecided", "no question surely fails, but one could not be decided"),
    Sign("no plan", "○", "noplan", "the method found none; its outcome says why"),
    Sign(
        "not applicable",
        "⊘",
        "noplan",
        "the method does not apply to the scene, or nothing is claimed and nothing asked",
    ),
    Sign(
        "consistent",
        "≈",
        "consistent",
        "nothing is wrong, and the scene asks for nothing: counted with no holds",
    ),
)
ANSWERS = _by_word(
    Sign("yes", "✓", "holds", "every metric of the question is within its limit"),
    Sign("no", "✗", "violates", "a metric of the question is surely beyond its limit"),
    Sign("undecided", "?", "undecided", "the replay's own error leaves it open"),
    Sign("not asked", DASH, "noplan", "the plan claims nothing of it, or the scene waives it"),
)


def verdict(name: str) -> Sign:
    """Return the sign of a verdict."""
    return VERDICTS.get(name, Sign(name, "?", "undecided", "a verdict this page does not know"))


def answer(name: str) -> Sign:
    """Return the sign of an answer."""
    return ANSWERS.get(name, Sign(name, "?", "undecided", "an answer this page does not know"))


def power(exponent: int) -> str:
    """Return a power of ten: 10⁻³."""
    return "10" + str(exponent).translate(_SUPERSCRIPT)


def _grouped(text: str) -> str:
    """Return digits with thin spaces between thousands, and a true minus sign."""
    sign, digits = ("−", text[1:]) if text.startswith("-") else ("", text)
    whole, _, fraction = digits.partition(".")
    if len(whole) > 4:
        whole = f"{int(whole):,}".replace(",", _THIN)
    return sign + whole + ("." + fraction if fraction else "")


def number(value: float | None, digits: int = 4) -> str:
    """Return a number with `digits` significant digits; powers of ten outside 1e-3 .. 1e6."""
    if value is None or not math.isfinite(value):
        return DASH
    if value == 0:
        return "0"
    if 1e-3 <= abs(value) < 1e6:
        places = max(0, digits - 1 - math.floor(math.log10(abs(value))))
        text = f"{value:.{places}f}"
        return _grouped(text.rstrip("0").rstrip(".") if "." in text else text)
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    mantissa = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
    mantissa = mantissa.replace("-", "−")
    return (
        mantissa[:-1] + power(int(exponent))
        if mantissa in ("1", "−1")
        else f"{mantissa}×{power(int(exponent))}"
    )


def cost(value: float | None) -> str:
    """Return a cost with two decimals, as in the paper; large ones with a power of ten."""
    if value is None or not math.isfinite(value):
        return DASH
    return number(value) if abs(value) >= _LARGE else _grouped(f"{value:z.2f}")


def error(value: float | None) -> str:
    """Return an error with two digits, both written: 0.040, 2.0×10⁻⁸."""
    if value is None or value == 0 or not math.isfinite(value):
        return number(value)
    if abs(value) < ROUNDING:
        return f"<{power(-15)}"
    mantissa, exponent = f"{value:.1e}".split("e")
    if -4 <= int(exponent) <= 5:
        return _grouped(f"{float(f'{value:.1e}'):.{max(0, 1 - int(exponent))}f}")
    return f"{mantissa.replace('-', '−')}×{power(int(exponent))}"


def prose(text: str) -> str:
    """Return a sentence with 0.012, 9×10²²⁸ and 0 for 1.2e-02, 9e+228 and -0."""
    return _SIGNED_NOUGHT.sub("0", _PROGRAM.sub(_as_written, text))


def _as_written(match: re.Match[str]) -> str:
    sign, mantissa, exponent = ("−" if match[1] == "-" else match[1]), match[2], int(match[3])
    if not mantissa.strip("0."):
        return "0"
    whole, _, fraction = mantissa.partition(".")
    if -4 <= exponent <= 5 and len(whole) == 1:
        places = max(0, len(fraction) - exponent)
        if (
            exponent <= len(fraction) or not fraction
        ):  # more digits would be invented, except for round numbers
            return sign + _grouped(f"{float(f'{mantissa}e{exponent}'):.{places}f}")
    return f"{sign}{power(exponent)}" if mantissa == "1" else f"{sign}{mantissa}×{power(exponent)}"


def product(value: float | None) -> str:
    """Return a sum of products with two decimals, as in the paper, or two digits below 1."""
    return cost(value) if value is not None and abs(value) >= 1 else error(value)


def small(value: float | None) -> str:
    """Return an eps as a power of ten, if it is one."""
    if value is not None and 0 < value < 1:
        exponent = round(math.log10(value))
        if abs(value / 10.0**exponent - 1) < 1e-9:
            return power(exponent)
    return number(value)


def unit(text: str) -> str:
    """Return N² for N^2, "" without a unit."""
    return (
        ""
        if text in ("", "1")
        else re.sub(r"\^(-?\d+)", lambda found: found[1].translate(_SUPERSCRIPT), clean(text))
    )


def measured(value: float | None, of: str) -> str:
    """Return a value with its unit; several units of a norm in brackets: 0.037 (m, rad)."""
    return with_unit(error(value), of)


def with_unit(text: str, of: str) -> str:
    """Return a number's text with its unit, as `measured`."""
    symbol = unit(of)
    return f"{text} ({symbol})" if "," in symbol else f"{text} {symbol}".strip()


def capital(text: str) -> str:
    """Return a sentence with a capital first letter."""
    return text[:1].upper() + text[1:]


def seconds(value: float | None) -> str:
    """Return seconds with two decimals, fewer if long, two significant digits if short."""
    if value is None:
        return DASH
    return (
        number(value, 2)
        if value < 0.0995
        else _grouped(f"{value:.2f}" if value < 99.5 else f"{value:.0f}")
    )


def percent(value: float | None) -> str:
    """Return a relative difference, with its sign."""
    if value is None or not math.isfinite(value):
        return DASH
    if abs(value) < 5e-5:
        return "0.00" + _THIN + "%"
    text = f"{abs(value) * 100:.2f}" if abs(value) < 0.0995 else f"{abs(value) * 100:.0f}"
    return ("−" if value < 0 else "+") + text + _THIN + "%"


def times(ratio: float) -> str:
    """Return a factor: 34 times, 1.5 times."""
    return f"{ratio:.0f} times" if ratio >= 9.5 else f"{ratio:.1f} times"


def ratio(value: float) -> str:
    """Return a ratio of costs in four characters: 1, 1.03, 2.4, 56."""
    return (
        "1"
        if value < 1.0005
        else f"{value:.2f}"
        if value < 9.995
        else f"{value:.0f}"
        if value < 999.5
        else ">999"
    )


def exact(value: float) -> str:
    """Return a number with ten digits, for programs; files have all digits."""
    return f"{value:.10g}"


def plain(value: object) -> str:
    """Return an option's value."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return _grouped(str(value))
    if isinstance(value, float):
        return number(value, 6)
    if isinstance(value, (list, tuple)):
        return ", ".join(plain(item) for item in value) or "none"
    return clean(str(value))


def spaced(name: str) -> str:
    """Return time limit for time_limit."""
    return clean(name).replace("_", " ")


def clean(text: str) -> str:
    """Return text without terminal codes and control characters, before escaping."""
    if text.isprintable():  # fast, and false for all of them
        return text
    return _CONTROL.sub("", _TERMINAL.sub("", text.replace("\r\n", "\n").replace("\r", "\n")))


def tail(text: str, limit: int = 8000) -> str:
    """Return the end of a log, cut at a line."""
    text = clean(text).rstrip()
    if len(text) <= limit:
        return text
    text = text[-limit:]
    return "…\n" + text[text.find("\n") + 1 :]


def count(amount: int, one: str, many: str | None = None) -> str:
    """Return an amount with its noun: 1 run, 2 runs."""
    return f"{amount} {one if amount == 1 else many or one + 's'}"


def listing(words: list[str]) -> str:
    """Return a, b and c."""
    return (
        words[0]
        if len(words) == 1
        else ", ".join(words[:-1]) + " and " + words[-1]
        if words
        else ""
    )
