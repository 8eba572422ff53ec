"""Count sentences of docstrings, comments and Markdown that break the rules of plain English.

for finding in violations(Path("models/scene/scene.py")): print(finding)
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

HEADLESS_OPENING = "headless opening"
LISTED_WORD = "listed word"
LONG_SENTENCE = "long sentence"
LONG_FIRST_LINE = "long first line"
SHARED_COMMENT = "shared comment"
# Longest sentence [words].
LONGEST_SENTENCE = 30
# Longest first line of a docstring, with indentation and quotes [characters].
LONGEST_FIRST_LINE = 100
_SENTENCE = re.compile(r"(?:^|(?<=[.!?:;])\s+|\n\s*\n\s*)(?=\w)")
_FULL_STOP = re.compile(r"(?<=[.!?])\s+(?=[A-Z`(])")
_HEADLESS = re.compile(
    r"(What|Of|So (many|much)|Where|That|Which|Who|Whatever|Whoever|Whether|By (how|what|which))\b"
)
# Words of the figure of `python -m benchmarks house`.
_DIALECT = re.compile(
    r"\b(tells?|told|says?|said|asks?|asked|somebody|anybody|nobody|whoever|others)\b",
    re.IGNORECASE,
)
_LISTED = re.compile(
    r"\b(tells?|told|says?|said|somebody|anybody|nobody|whoever|anew|afresh|dear|dearer|mend(s|ed)?"
    r"|so (many|much) (?!as\b)|by so)\b",
    re.IGNORECASE,
)
# Lines of Markdown without sentences: headings, tables, HTML, rules.
_NO_SENTENCE = re.compile(r"\s*(#|\||<|---|!\[)")
_LIST_ITEM = re.compile(r"\s*([-*]|\d+\.) ")
# First line of an example.
_EXAMPLE = re.compile(r">>>|```|[\w.]+\(.*\)  +#|\w+(, \w+)* = ")
# Names of parameters above their description.
_NAMES = re.compile(r"\*{0,2}\w+(, \*{0,2}\w+)*( : .*)?")
_CODE = re.compile(r"`[^`]*`")


@dataclass(frozen=True)
class Passage:
    """A paragraph of a docstring, a comment or a page, and its first line."""

    path: Path
    line: int
    text: str


@dataclass(frozen=True)
class Finding:
    """A broken rule, with the sentence."""

    path: Path
    line: int
    rule: str
    text: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.text}"


def docstrings(tree: ast.AST) -> Iterator[ast.Expr]:
    """Yield the docstring statements of a module."""
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
            and ast.get_docstring(node) is not None
        ):
            statement = node.body[0]
            assert isinstance(statement, ast.Expr)
            yield statement


def _comments(text: str) -> Iterator[tuple[int, str]]:
    """Yield the first line and the text of each block of comments."""
    block: list[str] = []
    first = last = 0
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type != tokenize.COMMENT:
            continue
        behind_code = token.line[: token.start[1]].strip() != ""
        if block and (behind_code or token.start[0] != last + 1):
            yield first, " ".join(block)
            block = []
        first = first if block else token.start[0]
        block.append(token.string.lstrip("# "))
        last = token.start[0]
    if block:
        yield first, " ".join(block)


def prose(text: str) -> list[str]:
    """Return the docstrings of a module and its blocks of comments."""
    written = [_text_of(node) for node in docstrings(ast.parse(text))]
    return written + [comment for _, comment in _comments(text)]


def _text_of(node: ast.Expr) -> str:
    assert isinstance(node.value, ast.Constant)
    return str(node.value.value)


def headless(text: str) -> int:
    """Return the number of sentences, or parts of one, that begin with a headless clause."""
    parts = _SENTENCE.split(text.strip())
    return sum(_HEADLESS.match(part) is not None for part in parts if part)


def dialect(text: str) -> int:
    """Return the number of words like tell, say, ask and somebody."""
    return len(_DIALECT.findall(text))


def _paragraphs(lines: Sequence[str], first: int, indent: int) -> Iterator[tuple[int, str]]:
    """Yield first line and text of each paragraph, list item and description of a parameter.

    Examples (deeper than `indent`, or code), headings and names of parameters are left out.
    """
    block: list[str] = []
    start = first
    deep = example = described = False
    for number, line in enumerate([*lines, ""], first):
        words = line.strip()
        before, deep = deep, len(line) - len(line.lstrip()) > indent
        item = _LIST_ITEM.match(line) is not None
        if words and not words.strip("-"):
            block = []
            continue
        if block and (not words or item or (before and not deep)):
            yield start, " ".join(block)
            block = []
        example = bool(words) and (example or (not block and _EXAMPLE.match(words) is not None))
        if not words or example:
            continue
        if not deep and not block and _NAMES.fullmatch(words):
            described = True
        elif block or item or not deep or described:
            start = start if block else number
            block.append(words)
            described = False


def violations(path: Path) -> list[Finding]:
    """Return the broken rules of a Python or Markdown file, in order of its lines."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return list(_in_sentences(_markdown(path, text)))
    tree = ast.parse(text)
    documented = list(docstrings(tree))
    written = [Passage(path, line, words) for line, words in _comments(text)]
    for node in documented:
        lines = _text_of(node).splitlines()
        written += [
            Passage(path, line, words)
            for line, words in _paragraphs(lines, node.lineno, node.col_offset)
        ]
    lines = text.splitlines()
    broken = [
        *_in_sentences(written),
        *_long_first_lines(path, lines, documented),
        *_shared_comments(path, lines, tree),
    ]
    return sorted(broken, key=lambda finding: finding.line)


def _markdown(path: Path, text: str) -> list[Passage]:
    lines = text.splitlines()
    fenced = False
    for number, line in enumerate(lines):
        fenced ^= line.lstrip().startswith("```")
        if fenced or line.startswith("    ") or _NO_SENTENCE.match(line):
            lines[number] = ""
    return [Passage(path, line, words) for line, words in _paragraphs(lines, 1, 0)]


def _in_sentences(written: Sequence[Passage]) -> Iterator[Finding]:
    """Yield headless openings, listed words and long sentences."""
    for passage in written:
        for sentence in _FULL_STOP.split(passage.text):
            words = _LIST_ITEM.sub("", _CODE.sub("code", sentence))
            if _HEADLESS.match(words) and not words.rstrip().endswith("?"):
                yield Finding(passage.path, passage.line, HEADLESS_OPENING, sentence)
            if _LISTED.search(words):
                yield Finding(passage.path, passage.line, LISTED_WORD, sentence)
            if len(words.split()) > LONGEST_SENTENCE:
                yield Finding(passage.path, passage.line, LONG_SENTENCE, sentence)


def _long_first_lines(
    path: Path, lines: Sequence[str], documented: Sequence[ast.Expr]
) -> Iterator[Finding]:
    for node in documented:
        line = lines[node.lineno - 1]
        if len(line) > LONGEST_FIRST_LINE:
            yield Finding(path, node.lineno, LONG_FIRST_LINE, line.strip())


def _shared_comments(path: Path, lines: Sequence[str], tree: ast.Module) -> Iterator[Finding]:
    """Yield comments above several numeric constants."""
    numbers = {
        node.lineno
        for node in tree.body
        if isinstance(node, ast.Assign | ast.AnnAssign) and _is_numeric(node.value)
    }
    for number in sorted(numbers):
        if (
            number > 1
            and lines[number - 2].startswith("#")
            and number + 1 in numbers
            and "#" not in lines[number] + lines[number - 1]
        ):
            yield Finding(path, number, SHARED_COMMENT, lines[number - 2])


def _is_numeric(node: ast.expr | None) -> bool:
    return node is not None and any(
        isinstance(part, ast.Constant) and type(part.value) in (int, float)
        for part in ast.walk(node)
    )
