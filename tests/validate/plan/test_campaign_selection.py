"""`-k` reads as pytest's does."""

import pytest

from validate.plan.selection import SelectionError, matches

NAMES = ("three_cart", "softplus_dc+strict", "softplus_dc", "strict_lcp")


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("strict", True),
        ("STRICT", True),
        ("softplus_dc+strict", True),
        ("relaxed", False),
        ("not relaxed", True),
        ("strict and relaxed", False),
        ("strict and not relaxed", True),
        ("relaxed or three", True),
        ("relaxed or gd and strict", False),
        ("(relaxed or strict) and three", True),
        ("not (relaxed or strict)", False),
        ("not not strict", True),
        ("strict or relaxed", True),
        ("relaxed or strict or relaxed", True),
        ("=strict", False),
        ("=strict_lcp", True),
        ("=STRICT_LCP and not =strict", True),
        ('="the ""title"" of it"', True),
        ('="the title"', False),
        ('="strict_lcp"', True),
        ("title", False),
        ('="', False),
    ],
)
def test_expressions(expression, expected):
    assert matches(expression, NAMES, 'The "title" of it') is expected


@pytest.mark.parametrize("expression", ["", "and", "strict and", "not", "(strict", "strict)", "strict relaxed", "or strict", "()"])
def test_mistakes_are_one_sentence(expression):
    with pytest.raises(SelectionError, match="-k") as caught:
        matches(expression, NAMES)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("expression", "parts"),
    [
        ("strict and", ["a name is missing at its end"]),
        ("or strict", ["a name is missing before 'or'"]),
        ("(strict", ["a ')' is missing"]),
        ("strict relaxed", ["'relaxed' was not expected"]),
    ],
)
def test_a_mistake_names_its_place(expression, parts):
    with pytest.raises(SelectionError) as caught:
        matches(expression, NAMES)
    assert all(part in str(caught.value) for part in (repr(expression), *parts))
