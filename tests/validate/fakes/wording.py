"""Messages are tested by what they must say - what, where, the number, the advice -, not by whole sentences.

assert not unsaid(done.stderr, "'mm'", "'m' is expected")      # what fails names the part that is missing
"""


def unsaid(text: object, *parts: str) -> list[str]:
    """Of these parts those that a text - or an error - does not contain."""
    return [part for part in parts if part not in str(text)]
