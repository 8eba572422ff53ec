"""Docstrings as they are written here, made what griffe's numpydoc reader understands: bare examples, and `name : meaning` on one line."""

import re

from griffe import Extension, Object

_EXAMPLE = re.compile(r"(?:^>>> .*\n?(?:^(?!>>>|\s*$).*\n?)*)+", re.MULTILINE)
_HEADER = re.compile(r"^(?:Parameters|Raises)\n-{3,}\n", re.MULTILINE)
_MEANING = re.compile(r"^([\w, ]+) : (.+)$(?!\n[ \t]+\S)", re.MULTILINE)


class Docstrings(Extension):
    """Fences each run of lines that begins with `>>>`.

    Puts a meaning into the line below its name.
    """

    def on_object(self, *, obj: Object, **kwargs: object) -> None:
        """Change the text before it is parsed."""
        if obj.docstring is None:
            return
        text = _EXAMPLE.sub(
            lambda found: f"```pycon\n{found[0].rstrip()}\n```\n", obj.docstring.value
        )
        first = _HEADER.search(text)
        if first is not None:
            text = text[: first.start()] + _MEANING.sub(r"\1\n    \2", text[first.start() :])
        obj.docstring.value = text
