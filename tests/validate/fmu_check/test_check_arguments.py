"""Arguments of `touchstone.check`."""

from typing import Any

import pytest
from wording import unsaid

import touchstone as ts
from models.errors import TouchstoneError


@pytest.mark.parametrize(
    ("path", "options", "parts"),
    [
        ("no_such.fmu", {}, ("no_such.fmu",)),
        (None, {}, ("fmu: None",)),
        ("a.fmu", {"seconds": -1}, ("seconds: -1", "positive")),
    ],
)
def test_check_wrong_arguments_one_sentence(path: Any, options: Any, parts: tuple[str, ...]):
    with pytest.raises(TouchstoneError) as caught:
        ts.check(path, **options)
    assert not unsaid(str(caught.value), *parts)
