"""`house`: size and structure of the code, as numbers to compare before and after a change.

    python -m benchmarks house            # this checkout
    python -m benchmarks house OTHER      # beside another checkout, for example an older commit

Only files that git tracks are counted. Python is formatted at 100 columns, so that lines compare.
A circle is a set of modules that import each other, in annotations and functions too.
"""

from __future__ import annotations

import ast
import io
import re
import subprocess
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import click
import networkx as nx

from benchmarks import ROOT
from benchmarks.english import dialect, docstrings, headless, prose
from validate.cli.table import table

ROOMS = ("models", "formulations", "validate", "reports")
PRODUCT = (*ROOMS, "touchstone.py", "touchstone_command.py", "touchstone_annexes.py")
# Folders with one file per scene, method, command or page: their size is no sign of disorder.
CATALOGS = frozenset(
    {
        "models/scenes",
        "formulations/methods",
        "validate/cli",
        "validate/stress/cases",
        "reports/pages",
        "reports/templates",
    }
)
# The module in which one run begins.
RUN = "validate.tasks.path"
# Numeric literals that need no name.
USUAL = frozenset({0, 1, 2, 3, 10, 100, -1, 0.5})
LANGUAGES = {
    "C": (".c", ".h"),
    "JavaScript": (".js",),
    "CSS": (".css",),
    "template": (".j2", ".html"),
    "TOML": (".toml",),
}
_NO_CODE = frozenset(
    {
        tokenize.COMMENT,
        tokenize.NL,
        tokenize.NEWLINE,
        tokenize.INDENT,
        tokenize.DEDENT,
        tokenize.ENDMARKER,
    }
)
_C_COMMENT = re.compile(r"/\*.*?\*/|(?<!:)//[^\n]*|<!--.*?-->|\{#.*?#\}", re.DOTALL)
_SHAPE = re.compile(r"\([\w*+ -]+(, ?[\w*+ -]+)*,?\)")
_UNIT = re.compile(r"\[[\w^/ .,-]+\]")
_ERRORS = re.compile(r"[Rr]aises")


@dataclass(frozen=True)
class Tree:
    """The tracked text files of a checkout, and the syntax trees of its product modules."""

    texts: dict[str, str]
    modules: dict[str, ast.Module]

    def product(self, suffixes: tuple[str, ...]) -> list[str]:
        """Return the texts of the product files with these suffixes."""
        return [
            text
            for name, text in self.texts.items()
            if name.split("/")[0] in PRODUCT and name.endswith(suffixes)
        ]


def read(root: Path) -> Tree:
    """Read the tracked files of a checkout."""
    listed = subprocess.run(
        ["git", "ls-files"], cwd=root, capture_output=True, text=True, check=True
    )
    texts = {}
    for name in listed.stdout.splitlines():
        if (root / name).is_file():
            texts[name] = (root / name).read_text(encoding="utf-8", errors="replace")
    modules = {
        name.removesuffix(".py").removesuffix("/__init__").replace("/", "."): ast.parse(text)
        for name, text in texts.items()
        if name.endswith(".py") and name.split("/")[0] in PRODUCT
    }
    return Tree(texts, modules)


def code_lines(text: str) -> int:
    """Return the number of Python lines with code: no blank lines, comments or docstrings."""
    documented = {
        line
        for node in docstrings(ast.parse(text))
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    lines = {
        line
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
        if token.type not in _NO_CODE
        for line in range(token.start[0], token.end[0] + 1)
    }
    return len(lines - documented)


def _other_lines(texts: Iterable[str]) -> int:
    """Return the number of lines that are neither blank nor comments, in other languages."""
    return sum(
        bool(line.strip()) for text in texts for line in _C_COMMENT.sub("", text).splitlines()
    )


def constants(tree: ast.Module) -> int:
    """Return the number of module-level names whose value contains a numeric literal."""
    count = 0
    for node in tree.body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = sum(isinstance(part, ast.Name) for item in targets for part in ast.walk(item))
            count += names if any(map(_is_number, ast.walk(node.value))) else 0
    return count


def _is_number(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and type(node.value) in (int, float)


def unusual(tree: ast.AST) -> int:
    """Return the number of numeric literals that are not in USUAL."""
    return sum(
        isinstance(node, ast.Constant)
        and type(node.value) in (int, float)
        and node.value not in USUAL
        for node in ast.walk(tree)
    )


def _prose_figures(texts: list[str]) -> dict[str, int]:
    blocks = [block for text in texts for block in prose(text)]
    return {
        "words of docstrings and comments": sum(len(block.split()) for block in blocks),
        "sentences with a headless opening": sum(map(headless, blocks)),
        "tell, say, ask, somebody and the like": sum(map(dialect, blocks)),
    }


def _imports(tree: ast.AST, modules: frozenset[str]) -> Iterator[tuple[str, bool]]:
    """Yield the modules that a tree imports, and whether inside a function."""
    inside = {
        id(part)
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        for part in ast.walk(node)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            for name in node.names:
                wanted = f"{node.module}.{name.name}"
                yield (wanted if wanted in modules else node.module), id(node) in inside
        elif isinstance(node, ast.Import):
            for name in node.names:
                yield name.name, id(node) in inside


def _arrays(trees: Iterable[ast.Module]) -> list[str]:
    """Return the docstrings of public functions that take or return arrays."""
    return [
        ast.get_docstring(node) or ""
        for tree in trees
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        and not node.name.startswith("_")
        and "ndarray" in ast.unparse(node.args) + ast.unparse(node.returns or node.args)
    ]


def sizes(tree: Tree) -> dict[str, int]:
    """Return how much there is: lines, files, constants, words."""
    python = tree.product((".py",))
    lines = {
        "product: Python code lines": sum(map(code_lines, python)),
        **{
            f"product: {language} lines": _other_lines(tree.product(suffixes))
            for language, suffixes in LANGUAGES.items()
        },
    }
    for folder in ("tests", "benchmarks"):
        lines[f"{folder}: Python code lines"] = sum(
            code_lines(text)
            for name, text in tree.texts.items()
            if name.startswith(f"{folder}/") and name.endswith(".py")
        )
    docs = [name for name in tree.texts if name.startswith("docs/") and name.endswith(".md")]
    return lines | {
        "product files": sum(name.split("/")[0] in PRODUCT for name in tree.texts),
        "tracked files": len(tree.texts),
        "names of numeric constants": sum(map(constants, tree.modules.values())),
        "unusual numeric literals": sum(map(unusual, tree.modules.values())),
        **_prose_figures(python),
        "kB of docs and README": sum(
            len(tree.texts[name].encode()) for name in (*docs, "README.md") if name in tree.texts
        )
        // 1000,
        "kB of CHANGELOG": len(tree.texts.get("CHANGELOG.md", "").encode()) // 1000,
    }


def structure(tree: Tree) -> dict[str, str]:
    """Return how the modules of the product hang together."""
    rooms = {
        module: parsed
        for module, parsed in tree.modules.items()
        if module.partition(".")[0] in ROOMS
    }
    imports = {
        module: {pair for pair in _imports(parsed, frozenset(rooms)) if pair[0] in rooms}
        for module, parsed in rooms.items()
    }
    graph = nx.DiGraph(
        [
            (module, other)
            for module, pairs in imports.items()
            for other, _ in pairs
            if other != module
        ]
    )
    folders = Counter(
        Path(name).parent.as_posix()
        for name in tree.texts
        if name.split("/")[0] in ROOMS and not name.endswith(("py.typed", "README.md"))
    )
    largest = max(folders.keys() - CATALOGS, key=lambda folder: folders[folder])
    homes: defaultdict[str, set[str]] = defaultdict(set)
    for module, parsed in rooms.items():
        for node in ast.walk(parsed):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes[node.name].add(module)
    arrays = _arrays(rooms.values())
    circles = [part for part in nx.strongly_connected_components(graph) if len(part) > 1]
    return {
        "loose Python files in validate/": str(
            sum(re.fullmatch(r"validate/[^/]+\.py", name) is not None for name in tree.texts)
        ),
        "largest folder except catalogs": f"{folders[largest]} ({largest})",
        "modules that a run may reach": str(len(nx.descendants(graph, RUN)) + 1),
        "circles (modules in them)": f"{len(circles)} ({sum(map(len, circles))})",
        "imports of our modules inside functions": str(
            sum(hidden for pairs in imports.values() for _, hidden in pairs)
        ),
        "class names with two meanings": str(sum(len(places) > 1 for places in homes.values())),
        "public functions of arrays: docstring with shape, unit, errors": ", ".join(
            f"{100 * sum(bool(pattern.search(text)) for text in arrays) / max(1, len(arrays)):.0f} %"
            for pattern in (_SHAPE, _UNIT, _ERRORS)
        ),
    }


def measure(root: Path = ROOT) -> dict[str, str]:
    """Return each figure of a checkout by its name."""
    tree = read(root)
    return {name: str(value) for name, value in sizes(tree).items()} | structure(tree)


@click.command()
@click.argument("other", required=False, type=click.Path(exists=True, path_type=Path))
def command(other: Path | None) -> int:
    """Print the size and structure of the code, beside those of the checkout OTHER."""
    now = measure()
    if other is None:
        click.echo(table(["", "now"], [list(item) for item in now.items()]))
        return 0
    before = measure(other)
    rows = [[name, before[name], value] for name, value in now.items()]
    click.echo(table(["", str(other), "now"], rows))
    return 0
