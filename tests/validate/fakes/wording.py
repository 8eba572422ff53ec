"""Messages are tested by what they must say - what, where, the number, the advice -, not by whole sentences.

# what fails names the part that is missing
assert not unsaid(done.stderr, "'mm'", "inputs.F: … 'm' is expected")
# " … " stands for whatever is said in between
with pytest.raises(MapError, match=saying("inputs.F: … give a scale")):
"""

import re


def saying(part: str) -> str:
    """A pattern of what is said in this order."""
    return "(?s)" + ".*".join(map(re.escape, re.split(" ?… ", part)))


def unsaid(text: object, *parts: str) -> list[str]:
    """Of these parts those that a text - or an error - does not contain."""
    return [part for part in parts if not re.search(saying(part), str(text))]
